//! `cargo xtask pictures`: the README's pictures, from real runs, as SVG in `docs/pictures`.
//!
//! - `flight.svg`: the path that the demo firmware flew in QEMU, over its plans. MAVSDK flies it (`.ci/integration/flight.py`), and
//!   everything that is drawn comes from the log of the frames.
//! - `compare.svg`: this library beside others, from the figures of `cargo measure compare`.

mod comparison;
mod flight;
mod svg;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use clap::Args;
use xtask_common::python::{self, CLIENTS};
use xtask_common::system::{Result, root, run, target_dir};

use crate::figures;
use comparison::Comparison;
use flight::Flight;

/// Draw the README's pictures: a flight of the firmware in QEMU, and this library beside others.
///
/// MAVSDK flies the demo vehicle in QEMU for some three minutes, and the log of that flight is drawn. What is missing (the compiler's
/// target, the emulator, MAVSDK) is installed first. The comparison is drawn from the figures of `cargo measure compare`.
#[derive(Args)]
pub struct Pictures {
    /// Draw this log of a flight; without this option the vehicle flies first.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Draw only the comparison, without a flight.
    #[arg(long, conflicts_with = "log")]
    compare: bool,
}

/// Where the pictures are.
const FOLDER: &str = "docs/pictures";

/// `cargo xtask pictures`.
pub fn draw(arguments: &Pictures) -> Result {
    let folder = root().join(FOLDER);
    write(&folder.join("compare.svg"), &Comparison::parse(&figures::read()?)?.draw())?;
    if arguments.compare {
        return Ok(());
    }
    let log = arguments.log.clone().map_or_else(fly, Ok)?;
    let bytes = std::fs::read(&log).map_err(|error| format!("{}: {error}", log.display()))?;
    write(&folder.join("flight.svg"), &Flight::read(&bytes)?.draw())
}

fn write(path: &Path, picture: &str) -> Result {
    std::fs::write(path, picture).map_err(|error| format!("{}: {error}", path.display()))?;
    println!("{}: {} bytes", path.display(), picture.len());
    Ok(())
}

/// A vehicle in QEMU, ended when dropped.
struct Vehicle(Child);

impl Drop for Vehicle {
    fn drop(&mut self) {
        // Both fail only when it has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Flies the firmware in QEMU, and returns the log.
fn fly() -> Result<PathBuf> {
    const PORT: u16 = 5790;
    let log = target_dir().join("flight.tlog");
    let python = python::environment()?;
    let ourselves = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut vehicle = Command::new(ourselves);
    vehicle.args(["qemu", "--port-base", &PORT.to_string(), "--log"]).arg(&log);
    let child = vehicle.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().map_err(|error| error.to_string())?;
    let mut vehicle = Vehicle(child);
    let mut output = vehicle.0.stdout.take().map(BufReader::new).ok_or("the vehicle has no output")?;
    let mut line = String::new();
    while !line.contains("Press Ctrl-C to stop") {
        line.clear();
        if output.read_line(&mut line).map_err(|error| error.to_string())? == 0 {
            return Err("the vehicle has not started".to_owned());
        }
    }
    // Its output is read to the end, or the vehicle would wait for us.
    std::thread::spawn(move || output.lines().map_while(std::result::Result::ok).for_each(drop));
    let mut pilot = Command::new(python);
    pilot.arg("flight.py").arg(format!("tcpout://127.0.0.1:{PORT}")).current_dir(root().join(CLIENTS));
    pilot.env("MAVLINK20", "1").env("MAVLINK_DIALECT", "common").env("PYTHONDONTWRITEBYTECODE", "1");
    run(&mut pilot)?;
    Ok(log)
}
