//! `mavstack-check`: examines a vehicle's board.
#![forbid(unsafe_code)]

#[path = "program/address.rs"]
mod address;
#[path = "program/render.rs"]
mod render;
#[path = "program/transport.rs"]
mod transport;

use std::io::{IsTerminal, Write, stderr, stdout};
use std::process::ExitCode;
use std::time::Instant;

use clap::{Args, Parser, Subcommand};
use mavstack_check::{Depth, Options, Outcome, Permission, Report, Step, examine};

use address::LineAddress;
use render::{Colours, Document};
use transport::Connection;

/// Check a vehicle that speaks MAVLink.
#[derive(Parser)]
#[command(name = "mavstack-check", version)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    Doctor(Doctor),
}

/// Examine your own board over its link, and report what is wrong, with cause and remedy.
///
/// It takes about a minute. It sends nothing until a heartbeat says that the vehicle is disarmed, and nothing more once one says that it is
/// armed. It requests messages, fills the line for some seconds, and connects as QGroundControl, MAVSDK and MAVProxy do. It changes the
/// least significant bit of one parameter, and the rate of one stream on this link. It restores both, and reads them back. It never arms,
/// erases or reboots. Close all ground stations first: they share the line.
///
/// Exit code: 0 if nothing was found, 1 if something was, 2 if the line could not be opened, is silent or failed.
#[derive(Args)]
struct Doctor {
    /// The line: serial:PORT:BAUD, such as serial:/dev/ttyACM0:115200 or serial:COM3:57600; tcp:HOST:PORT; udpin:HOST:PORT, which waits
    /// for the vehicle, such as udpin:0.0.0.0:14550; udpout:HOST:PORT, which sends first and needs --disarmed.
    #[arg(value_name = "ADDRESS")]
    address: LineAddress,
    /// Baud rate of the UART or radio behind a TCP or UDP port. Without it, full lines and slow links are judged by answer times only.
    #[arg(long, value_name = "BAUD", value_parser = clap::value_parser!(u32).range(300..=20_000_000))]
    baud: Option<u32>,
    /// Also upload a plan: the vehicle's own mission again. If it has none, another one is uploaded and cleared.
    #[arg(long)]
    write: bool,
    /// The vehicle is disarmed, or cannot move: send requests even if no heartbeat says so.
    #[arg(long)]
    disarmed: bool,
    /// Only look for ten seconds, and change nothing.
    #[arg(long, conflicts_with = "write")]
    quick: bool,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
    /// Show no progress.
    #[arg(long, short)]
    quiet: bool,
}

impl Doctor {
    fn run(&self) -> Result<Report, String> {
        if matches!(self.address, LineAddress::UdpOut(_)) && !self.disarmed {
            return Err("udpout sends before the vehicle has said that it is disarmed: make sure that it is, and add --disarmed".into());
        }
        let mut connection = Connection::open(&self.address).map_err(|error| format!("{}: {error}", self.address))?;
        let line_rate = self.baud.or(self.address.baud()).map(|baud| baud / 10);
        let started = Instant::now();
        let mut progress = |step: Step| {
            if !self.quiet {
                // A closed stderr is no reason to stop.
                let _ = writeln!(stderr(), "[{:3} s] {step}", started.elapsed().as_secs());
            }
        };
        let depth = match (self.quick, self.write) {
            (true, _) => Depth::Quick,
            (false, false) => Depth::Full,
            (false, true) => Depth::WithPlan,
        };
        let permission = if self.disarmed { Permission::User } else { Permission::Heartbeat };
        Ok(examine(&mut connection, &Options { line_rate, depth, permission }, &mut progress))
    }

    fn print(&self, report: &Report) -> std::io::Result<()> {
        if self.json {
            let text = serde_json::to_string_pretty(report).map_err(std::io::Error::other)?;
            return writeln!(stdout(), "{text}");
        }
        let is_terminal = stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
        let colours = if is_terminal { Colours::On } else { Colours::Off };
        write!(stdout(), "{}", Document { report, colours })
    }
}

fn main() -> ExitCode {
    let Task::Doctor(doctor) = Arguments::parse().task;
    let report = match doctor.run() {
        Ok(report) => report,
        Err(error) => {
            eprintln!("error: {error}");
            return ExitCode::from(2);
        }
    };
    if let Err(error) = doctor.print(&report) {
        eprintln!("error: the report could not be written: {error}");
    }
    ExitCode::from(match report.outcome {
        Outcome::Sound => 0,
        Outcome::Findings => 1,
        Outcome::Silent | Outcome::Failed => 2,
    })
}
