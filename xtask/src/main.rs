//! `cargo xtask`: what a contributor runs from day to day. Proofs and figures are `cargo measure`, in `xtask/measure`.
//!
//! `cargo qemu` is `cargo run --package xtask -- qemu`; the aliases are in `.cargo/config.toml`.

mod boards;
mod book;
mod bridge;
#[path = "../../fuzz/src/corpus.rs"]
mod corpus;
mod cross;
mod dialects;
mod doctor;
mod faults;
mod figures;
mod fuzz;
mod integration;
mod jitter;
mod log;
mod paced;
mod publish;
mod qemu;
mod rp2040js;
mod semver;
mod trace;

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use xtask_common::{emulator, firmware, python, system, toolchain};

use firmware::App;
use integration::Target;
use toolchain::Choice;

/// Tools for working on mavstack. `cargo measure` has the proofs and figures.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Install everything that the other commands would install on demand.
    ///
    /// That is: compiler targets, QEMU, the ground stations' libraries, a nightly toolchain, cargo-fuzz. Run this before you run
    /// several commands at the same time. Only `boards --run` and `book` need more, which they install themselves: Node.js and rp2040js,
    /// and mdBook.
    Setup,
    Qemu(Qemu),
    Integration(Integration),
    Faults(Faults),
    Jitter(Jitter),
    Fuzz(Fuzz),
    Cross(Cross),
    Boards(Boards),
    Dialects(Dialects),
    Trace(Trace),
    /// Build the guides as a book with search, in target/book.
    ///
    /// `docs/SUMMARY.md` lists its pages. mdBook is installed into the target folder if it is missing.
    Book,
    PublishCheck(PublishCheck),
    Semver(Semver),
}

/// Run the demo vehicle on an emulated Cortex-M4.
///
/// The vehicle (system 1, component 1) has three serial ports. Each is a TCP port of this machine that accepts one client at a
/// time. By default: 5760 for telemetry (UART0), 5761 for a companion computer (UART1), 5762 for a satellite modem (UART2).
///
/// The vehicle forwards between the first two ports, so a ground station and a companion computer can talk to each other. The
/// satellite link carries commands, their answers, and HIGH_LATENCY2. MAV_CMD_CONTROL_HIGH_LATENCY 1 starts HIGH_LATENCY2 and 0
/// stops it; MAV_2_HL_FREQ sets its interval, by default 67 s. It also starts by itself when no ground station was heard for
/// MAV_HL_LOSS_T seconds. STAT_HL_BYTES and STAT_HL_CREDITS count its cost. SETUP_SIGNING sets a signing key, on the companion's
/// port only; after that, only this port accepts unsigned frames.
///
/// `--app ethernet` has a network in place of UART0. The vehicle broadcasts heartbeats until a ground station answers: one that
/// listens on UDP port 14550 of this machine finds it without any configuration. Up to three more stations send to the first port,
/// which is then a UDP port. The apps with a network need Rust 1.91 or later.
///
/// What is missing (the compiler's target, the emulator) is installed first if that is possible; otherwise the command to install
/// it is printed. Press Ctrl-C to stop.
#[derive(Args)]
struct Qemu {
    /// The firmware: the same vehicle on different frameworks.
    #[arg(long, default_value = "loop")]
    app: App,
    /// First of the three TCP ports.
    #[arg(long, value_name = "PORT", default_value_t = 5760, value_parser = clap::value_parser!(u16).range(1..=65533))]
    port_base: u16,
    /// Send telemetry over UDP to this address, not over TCP. QGroundControl listens on the default address. With `--app ethernet`,
    /// the vehicle broadcasts to this port.
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:14550", value_parser = resolve)]
    udp: Option<SocketAddr>,
    /// Run without the camera and the gimbal, components 100 and 154: for clients that take any heartbeat for the vehicle's. Commands
    /// and mission items for them are then unsupported.
    #[arg(long)]
    no_components: bool,
    /// Log the links' traffic to this file in the ".tlog" format of Mission Planner and MAVProxy.
    ///
    /// While a client is connected, each frame that the vehicle's decoder takes, and each frame that the vehicle sends, is logged
    /// with its time. That includes frames that the vehicle then refuses. A frame with an unknown id is logged only if its sender
    /// was heard before, and a frame or silence follows: the vehicle also takes one whose signature is right, but only the vehicle
    /// has the key. MAVExplorer and pymavlink read the file. Messages with keys or passwords are left out, and signatures are
    /// overwritten with zeros. An existing log of that name is replaced; any other file is refused.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Connect the board's Ethernet as this option `-nic` of QEMU says, such as `tap,ifname=tap0,script=no`. By default it reaches this
    /// machine only. With `--app ethernet`.
    #[arg(long, value_name = "OPTION")]
    nic: Option<String>,
    /// Accept QMP commands for the emulator on this TCP port: `system_reset` is the vehicle's reset button.
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    qmp: Option<u16>,
    /// The Rust toolchain for the build; by default the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Build the firmwares in `examples/boards`, each with its HAL.
///
/// Checks the load address of each, and prints its size.
#[derive(Args)]
struct Boards {
    /// Also run the firmwares of the micro:bit, the STM32F405 and the STM32F100 in QEMU, and those of the RP2040 in rp2040js, under
    /// pymavlink. This needs Node.js 18 or later, and rp2040js from the npm registry.
    #[arg(long)]
    run: bool,
    /// Examine the six emulated boards with `mavstack-check doctor`, which must find nothing, and one that is made faulty in ten ways,
    /// each of which it must name. Sizes are not compared.
    #[arg(long, conflicts_with = "run")]
    doctor: bool,
}

/// Build the library for three kinds of microcontroller, with no feature and with all features.
#[derive(Args)]
struct Cross {
    /// The Rust toolchain for the build; by default the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Test the demo vehicle with real ground stations: pymavlink, MAVSDK and MAVProxy.
///
/// They are installed from PyPI, in pinned versions, into a Python environment in the target directory. With a compiler before Rust
/// 1.91, the tests of the firmwares with a network are skipped; with `CI` set they fail.
#[derive(Args)]
struct Integration {
    /// Where the vehicle runs.
    #[arg(long, default_value = "all")]
    target: Target,
    /// One file of tests, such as `test_ethernet.py`; by default all.
    #[arg(long, value_name = "NAME")]
    file: Option<String>,
    /// How long the tests with a high load take.
    #[arg(long, value_name = "SECONDS", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=120))]
    load_seconds: u32,
    /// The Rust toolchain for the firmware; by default the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Run the fuzz targets: coverage-guided random bytes.
///
/// fuzz/README.md describes the targets. What is missing (a nightly toolchain, cargo-fuzz) is installed first. Each target is a program of its own. A crash fails, and so
/// does an input that takes a second.
#[derive(Args)]
struct Fuzz {
    /// The targets; by default all.
    #[arg(value_name = "TARGET")]
    targets: Vec<String>,
    /// How long each target runs.
    #[arg(long, default_value_t = 60)]
    seconds: u32,
    /// How many executions each target runs, instead of a time.
    #[arg(long, value_name = "COUNT", conflicts_with = "seconds")]
    executions: Option<u64>,
    /// Run nothing: minimise the checked-in corpora, with the inputs that runs on this machine have found.
    #[arg(long)]
    minimise: bool,
}

/// Compare the conformance statement, docs/conformance.md, with the code and the tests.
///
/// A comment in the code and a test must name each implemented rule, and each rule that something names must exist.
#[derive(Args)]
struct Trace {
    /// Print the files whose comments cite each rule.
    #[arg(long)]
    places: bool,
    /// Print the tests that cite each rule.
    #[arg(long)]
    tests: bool,
}

/// Check that the crates could be published.
///
/// Publishes nothing. Checks contents and metadata, builds the documentation, and does Cargo's dry run, which builds each package.
#[derive(Args)]
struct PublishCheck {
    /// Build nothing. `cargo measure nightly packages` does everything.
    #[arg(long)]
    no_build: bool,
}

/// Compare the public interface of the libraries with an earlier one, by cargo-semver-checks.
///
/// Fails if it breaks code that used the earlier one, unless the version says so.
#[derive(Args)]
struct Semver {
    /// The commit or tag to compare with; by default the last tag.
    #[arg(long, value_name = "REVISION")]
    baseline: Option<String>,
}

/// Generate, compile and check a whole other dialect: ardupilotmega.
///
/// Its definitions come with pymavlink. Every message is compared with pymavlink's own table.
#[derive(Args)]
struct Dialects {
    /// The Rust toolchain for the microcontroller; by default the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Inject faults into the demo vehicle, in the emulator: the fault matrix.
///
/// Links that lose bytes or stall; ground stations that die, or come in pairs; resets at every item of an upload and at every write
/// to flash; flash that fails; a flight loop that hangs; clocks that wrap; replays; floods; a stack that is too small. Each scenario
/// prints a line with its figures.
#[derive(Args)]
struct Faults {
    /// One scenario; by default all. An unknown name prints the list.
    #[arg(value_name = "SCENARIO")]
    scenario: Option<String>,
    /// The Rust toolchain for the firmware; by default the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Measure how late flight starts, beside the stack and while storage erases.
///
/// In a loop, RTIC and Embassy, flight runs at 1 kHz for 10 s, and MAVLink in another task: "stack" with two ground stations that flood
/// it, "delay" with a delay loop in place of the stack. Fails if the stack adds more than one tick of the timer.
///
/// In RTIC and Embassy, with storage: in the emulator, flight runs at 1 kHz for 20 s. Two lines are full, an erase keeps the processor busy for 2 s, and a write for
/// 1 ms. "jobs": storage is a task of the lowest priority, which runs its jobs without the lock. "persist": storage holds the lock,
/// for comparison. Fails if flight is late by more than 100 µs with jobs.
#[derive(Args)]
struct Jitter {
    /// The Rust toolchain for the firmware; by default the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

fn resolve(address: &str) -> Result<SocketAddr, String> {
    let mut found =
        address.to_socket_addrs().map_err(|error| format!("{error} (expected, for example, 127.0.0.1:14550)"))?;
    match found.next() {
        Some(address) if address.port() == 0 => Err("port 0 cannot be sent to; use 1 to 65535".to_owned()),
        Some(address) => Ok(address),
        None => Err("no such host".to_owned()),
    }
}

fn setup() -> system::Result {
    toolchain::prepare(None, &toolchain::TARGETS)?;
    emulator::prepare()?;
    python::environment()?;
    fuzz::prepare()
}

fn main() -> ExitCode {
    let result = match Arguments::parse().task {
        Task::Setup => setup(),
        Task::Qemu(arguments) => {
            let Qemu { app, port_base, udp, no_components, log, nic, qmp, toolchain } = arguments;
            let options = qemu::Options { port_base, qmp, nic: nic.as_deref(), no_components };
            qemu::run(app, udp, log.as_deref(), options, toolchain)
        }
        Task::Integration(Integration { target, file, load_seconds, toolchain }) => {
            integration::run_tests(&integration::Options { target, file, load_seconds }, toolchain)
        }
        Task::Faults(arguments) => faults::play(arguments.scenario.as_deref(), arguments.toolchain),
        Task::Jitter(arguments) => jitter::measure(arguments.toolchain),
        Task::Fuzz(Fuzz { targets, seconds, executions, minimise }) => {
            fuzz::fuzz(&fuzz::Options { seconds, executions, minimises: minimise, targets })
        }
        Task::Cross(arguments) => cross::build_all(arguments.toolchain),
        Task::Boards(Boards { doctor: true, .. }) => doctor::examine_all(),
        Task::Boards(Boards { run, .. }) => boards::build_all(run),
        Task::Dialects(arguments) => dialects::run(arguments.toolchain),
        Task::Trace(Trace { places, tests }) => trace::run(trace::Printed { places, tests }),
        Task::Book => book::build(),
        Task::PublishCheck(PublishCheck { no_build }) => publish::check(!no_build),
        Task::Semver(Semver { baseline }) => semver::check(baseline.as_deref()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
