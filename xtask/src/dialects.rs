//! `cargo xtask dialects`: a whole dialect of others through the generator and the compiler, held against the reference
//! implementation's own table. Its XML comes with pymavlink; none of it is kept here.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use mavstack_dialect::{Options, generate, load};

use crate::python;
use crate::system::{Result, cargo, root, target_dir};
use crate::toolchain::{self, Choice, TARGET};

/// The one with most messages that is flown.
const NAME: &str = "ardupilotmega";

/// Bytes of a row, and of the index in front of all rows.
const ROW: usize = 8;
const INDEX: usize = 66;

/// Behind the package's name. Two packages of one name would be one to Cargo, in one target directory.
const MANIFEST: &str = r#"
version = "0.0.0"
edition = "2024"
publish = false

[lib]
name = "whole_dialect"
path = "lib.rs"

[[bin]]
name = "rows"
path = "rows.rs"

[workspace]
"#;

/// Prints the rows of the table as `mavparse_rows.py` does, as far as a table has them.
const ROWS: &str = r#"use mavstack::message::Dialect;

fn main() {
    for row in whole_dialect::dialect::Whole::MESSAGES.rows() {
        let offset = |at: Option<u8>| at.map_or(String::new(), |at| at.to_string());
        let (system, component) = (offset(row.target_system()), offset(row.target_component()));
        println!("{},{},{},{},{system},{component}", row.id(), row.crc_extra(), row.base_len(), row.max_len());
    }
}
"#;

/// Generates, compiles for this machine and the microcontroller, and compares, the whole and what is beside common.
pub fn run(choice: Option<Choice>) -> Result {
    let python = python::environment()?;
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let definition = definitions(&python)?.join(format!("{NAME}.xml"));
    let expected = expected(&python)?;
    for beside_common in [false, true] {
        let folder = target_dir().join("dialects").join(if beside_common { "beside" } else { "whole" });
        let (count, generation) = write_package(&folder, &definition, beside_common)?;
        // What it builds on is built first, so that the time is the declarations' own.
        build(&folder, choice, &["--package", "mavstack"])?;
        let [host, firmware] = build(&folder, choice, &[])?;
        let printed = output(Command::new(folder.join("target/release/rows")))?;
        let rows: Vec<_> = printed.lines().collect();
        let missing = expected.iter().find(|row| !agrees(row, &rows));
        if let Some(row) = missing {
            return Err(format!("{NAME}: pymavlink has {row}, and the table has not"));
        }
        println!(
            "{NAME}{}: {} messages of pymavlink agree; {count} written in {}, compiled in {} for this machine and {} for \
             {TARGET}; a table of {} rows, {} bytes of flash",
            if beside_common { ", what common has not" } else { ", whole" },
            expected.len(),
            seconds(generation),
            seconds(host),
            seconds(firmware),
            rows.len(),
            rows.len() * ROW + INDEX,
        );
    }
    Ok(())
}

/// Where pymavlink keeps its definitions.
fn definitions(python: &Path) -> Result<PathBuf> {
    let program = "import os, pymavlink; print(os.path.join(os.path.dirname(pymavlink.__file__), 'dialects', 'v20'))";
    let mut command = Command::new(python);
    command.args(["-c", program]);
    Ok(output(command)?.trim().into())
}

/// What pymavlink's parser says of the dialect: id, digest, least and greatest length, where the targets stand.
fn expected(python: &Path) -> Result<Vec<String>> {
    let mut command = Command::new(python);
    command.arg(root().join("dialect/tests/mavparse_rows.py"));
    let text = output(command)?;
    let of_dialect = text.lines().filter_map(|line| line.strip_prefix(NAME)?.strip_prefix(','));
    let row = |line: &str| {
        let mut cells = line.split(',');
        let id = cells.next()?;
        let rest: Vec<_> = cells.skip(1).take(5).collect();
        Some(format!("{id},{}", rest.join(",")))
    };
    let rows: Vec<_> = of_dialect.filter_map(row).collect();
    if rows.is_empty() { Err(format!("pymavlink has no {NAME}")) } else { Ok(rows) }
}

/// Whether the table has this row. It may know more extensions than pymavlink, whose definitions are older than ours; these
/// may be targets.
fn agrees(expected: &str, rows: &[&str]) -> bool {
    let cells = |row: &str| row.split(',').map(|cell| cell.parse().ok()).collect::<Vec<Option<u16>>>();
    let wanted = cells(expected);
    let [id, crc_extra, base_len, max_len, targets @ ..] = wanted.as_slice() else { return false };
    rows.iter().map(|row| cells(row)).any(|row| match row.as_slice() {
        [id_, crc_extra_, base_len_, max_len_, targets_ @ ..] => {
            let is_same = (id, crc_extra, base_len) == (id_, crc_extra_, base_len_);
            let is_newer = max_len_ > max_len && targets.iter().all(Option::is_none);
            is_same && max_len_ >= max_len && (targets == targets_ || is_newer)
        }
        _ => false,
    })
}

/// A package of nothing but the declarations. Returns how many messages they are, and how long the generator took.
fn write_package(folder: &Path, definition: &Path, beside_common: bool) -> Result<(usize, Duration)> {
    let began = Instant::now();
    let dialect = load(definition, &[]).map_err(|error| error.to_string())?;
    let options = Options { name: "Whole".into(), beside_common, ..Options::for_file(definition) };
    let text = generate(&dialect, &options).map_err(|error| error.to_string())?;
    let took = began.elapsed();
    let name = if beside_common { "beside-common" } else { "whole-dialect" };
    let mut manifest = format!("# Made by `cargo xtask dialects`.\n[package]\nname = \"{name}\"{MANIFEST}");
    let path = root().to_string_lossy().replace('\\', "/");
    let _ = write!(manifest, "\n[dependencies]\nmavstack = {{ path = \"{path}\" }}\n");
    let lib = "#![no_std]\n\npub mod dialect;\n";
    let io = |error: std::io::Error| format!("{}: {error}", folder.display());
    std::fs::create_dir_all(folder).map_err(io)?;
    let files = [("Cargo.toml", manifest.as_str()), ("lib.rs", lib), ("rows.rs", ROWS), ("dialect.rs", text.as_str())];
    for (name, text) in files {
        std::fs::write(folder.join(name), text).map_err(io)?;
    }
    // The versions that are tested here, without asking for others.
    std::fs::copy(root().join("Cargo.lock"), folder.join("Cargo.lock")).map_err(io)?;
    Ok((text.matches("::message! {").count(), took))
}

/// Builds for this machine, and the library for the microcontroller; how long each took.
fn build(folder: &Path, choice: Choice, arguments: &[&str]) -> Result<[Duration; 2]> {
    let target = folder.join("target");
    let mut host = Command::new(cargo());
    host.arg("build").current_dir(folder);
    let mut firmware = toolchain::cargo_build(choice, TARGET);
    firmware.current_dir(folder);
    if arguments.is_empty() {
        firmware.arg("--lib");
    }
    let mut took = [Duration::ZERO; 2];
    for (command, took) in [&mut host, &mut firmware].into_iter().zip(&mut took) {
        command.args(["--quiet", "--release"]).args(arguments).env("CARGO_TARGET_DIR", &target);
        let began = Instant::now();
        crate::system::run(command)?;
        *took = began.elapsed();
    }
    Ok(took)
}

fn output(mut command: Command) -> Result<String> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.output().map_err(|error| format!("{name} could not be started: {error}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!("{name} failed: {}", String::from_utf8_lossy(&output.stderr)))
}

fn seconds(time: Duration) -> String {
    format!("{:.1} s", time.as_secs_f64())
}
