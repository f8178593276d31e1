//! The project's own tools: the vehicle in QEMU, its size, and the tests with real ground stations.
//!
//! `cargo qemu` is `cargo run --package xtask -- qemu`; the aliases are in `.cargo/config.toml`.

mod boards;
mod bridge;
mod compare;
mod compare_firmware;
#[path = "../../fuzz/src/corpus.rs"]
mod corpus;
mod coverage;
mod dialects;
mod faults;
mod firmware;
mod fuzz;
mod integration;
mod log;
mod miri;
mod mutants;
mod nightly;
mod options;
mod panic_free;
mod publish;
mod qemu;
mod size;
mod stack;
mod system;
mod thumb;
mod toolchain;
mod trace;
mod work;

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

use firmware::App;
use integration::Target;
use toolchain::Choice;

#[derive(Parser)]
#[command(name = "cargo xtask", about = "The tools of the project mavstack.")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Install everything that the other commands would otherwise install on demand: compiler targets, QEMU, ground stations, a
    /// nightly toolchain, cargo-fuzz. Run this before running several of them at the same time.
    Setup,
    Qemu(Qemu),
    Size(Size),
    Cross(Cross),
    /// Build the boards' firmwares, each with its HAL; check where they are loaded, and print their sizes.
    Boards,
    Integration(Integration),
    Fuzz(Fuzz),
    Dialects(Dialects),
    Compare(Compare),
    Coverage(Coverage),
    /// Run the library's tests in Miri, which sees undefined behaviour, of the libraries that it uses too. What is missing (a nightly
    /// toolchain, Miri) is installed first; where it cannot be had, that is said, and nothing is run.
    Miri,
    Mutants(Mutants),
    /// Check that the crates could be published: contents, metadata, documentation, a dry run.
    PublishCheck,
    Trace(Trace),
    PanicFree(PanicFree),
    Stack(Stack),
    Work(Work),
    Faults(Faults),
    Nightly(Nightly),
}

/// Build the firmware and run it on an emulated Cortex-M4.
///
/// The vehicle (system 1, component 1) has three serial ports, each on a TCP port of this machine that takes one client
/// at a time. Without options: 5760 for telemetry (UART0), 5761 for a companion computer (UART1), 5762 for a satellite modem
/// (UART2).
///
/// A ground station on the first and a companion computer on the second talk to each other through the vehicle. By satellite
/// go commands and their answers and, from MAV_CMD_CONTROL_HIGH_LATENCY 1 to 0, HIGH_LATENCY2 every 67 s or as MAV_2_HL_FREQ
/// has it; also by itself, when no ground station was heard for MAV_HL_LOSS_T seconds. What that cost is in STAT_HL_BYTES and
/// STAT_HL_CREDITS. A signing key is taken by SETUP_SIGNING on the companion's port; then frames without a signature are
/// heard there only.
///
/// What is missing (the compiler's target, the emulator) is installed first where that is possible, else the command to
/// do so is printed. Ctrl-C ends the emulator.
#[derive(Args)]
struct Qemu {
    /// The firmware: the same vehicle on different ground.
    #[arg(long, default_value = "loop")]
    app: App,
    /// First of the three TCP ports.
    #[arg(long, value_name = "PORT", default_value_t = 5760, value_parser = clap::value_parser!(u16).range(1..=65533))]
    port_base: u16,
    /// Telemetry over UDP instead of TCP, sent there; QGroundControl listens on the default by itself.
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:14550", value_parser = resolve)]
    udp: Option<SocketAddr>,
    /// Log the links' traffic to this file, as Mission Planner and MAVProxy do (".tlog"): each frame that the vehicle's decoder
    /// accepts or that the vehicle sends, with its time, while a client is connected. MAVExplorer and pymavlink read it. Messages
    /// with keys or passwords are left out, and signatures are overwritten with zeros. An existing log of that name is replaced;
    /// any other file is refused.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Let others control the emulator by QMP on this TCP port: `system_reset` is the vehicle's reset button.
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    qmp: Option<u16>,
    /// Which Rust toolchain to build with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Print how much flash and RAM the library takes on three kinds of microcontroller, and the demo vehicle's firmware; fails where
/// docs/sizing.md says otherwise.
///
/// A size that moved by more than 1 %, whichever way, fails until it is accepted. What the optimizer inlines is part of a size: a
/// change anywhere can move single rows by some per cent, small ones the most, and up in one column and down in the next. Nothing is
/// averaged away, for it is what would be flashed; accept it where the other rows stay.
#[derive(Args)]
struct Size {
    /// Write the sizes into docs/sizing.md instead: they are meant. What changed is printed, for the changelog.
    #[arg(long)]
    accept: bool,
    /// List the largest functions and constants of each firmware too, for Cortex-M4F at opt-level s.
    #[arg(long, value_name = "COUNT", num_args = 0..=1, default_value_t = 0, default_missing_value = "20")]
    symbols: usize,
    /// What each option adds instead, as in docs/sizing.md: some forty firmwares, which take minutes. Whole vehicles that moved
    /// by more than 1 % fail until they are accepted.
    #[arg(long, conflicts_with = "symbols")]
    options: bool,
    /// Which Rust toolchain to build with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Build the library for three kinds of microcontroller, with no feature and with all of them.
#[derive(Args)]
struct Cross {
    /// Which Rust toolchain to build with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Test the vehicle with real ground-station software: pymavlink, MAVSDK and MAVProxy.
///
/// They come from PyPI, in pinned versions, into a Python environment under the target directory.
#[derive(Args)]
struct Integration {
    /// Where the vehicle runs.
    #[arg(long, default_value = "all")]
    target: Target,
    /// Which Rust toolchain to build the firmware with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Throw bytes at the library, guided by what code they reach: fuzz/README.md says what is tried, and what must hold.
///
/// What is missing (a nightly toolchain, cargo-fuzz) is installed first. Each target runs by itself; a crash, or an input that
/// takes a second, fails.
#[derive(Args)]
struct Fuzz {
    /// Which targets; all, when none is named.
    #[arg(value_name = "TARGET")]
    targets: Vec<String>,
    /// For how long each of them runs.
    #[arg(long, default_value_t = 60)]
    seconds: u32,
    /// How often each of them runs, instead of for how long: for the night.
    #[arg(long, value_name = "COUNT", conflicts_with = "seconds")]
    executions: Option<u64>,
    /// Run nothing: minimise the checked-in corpora, from the inputs that runs on this machine have found.
    #[arg(long)]
    minimise: bool,
}

/// Compare the statement of conformance, docs/conformance.md, with the tests.
///
/// Each rule of behaviour that is implemented must be named by a test, and each that a test names must be there.
#[derive(Args)]
struct Trace {
    /// Write the tests' names into the statement.
    #[arg(long)]
    write: bool,
}

/// Generate, compile and check a whole dialect of others: ardupilotmega.
///
/// Its definitions come with pymavlink, and every message is held against pymavlink's own table.
#[derive(Args)]
struct Dialects {
    /// Which Rust toolchain to build for the microcontroller with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Measure other MAVLink libraries beside this one, on the same frames; fails where one of them is ahead.
///
/// They are mavlink, mavio and the C library of mavgen, which is generated and compiled for it. Time is the processor's, the median
/// of rounds in which all take turns; instructions are counted by valgrind. Then streams of a bad line: what each finds. And
/// the C library's firmware beside ours. Takes some minutes.
#[derive(Args)]
struct Compare {
    /// How often each is measured.
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u16).range(1..))]
    rounds: u16,
    /// Which Rust toolchain to build the firmware with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Prove that the demo vehicle's firmware, with the whole library in it, cannot panic: it links without a panic handler.
///
/// At opt-level s and 3, with overflow checks on in the library, with and without a log. `core::fmt`, an allocator and arithmetic in
/// f64 are errors too.
#[derive(Args)]
struct PanicFree {
    /// Which Rust toolchain to build with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Prove how much stack the library's calls and the demo vehicle's firmware can take at most, and on which way.
///
/// From the machine code: what calls what, and each function's frame. A call through a pointer, or a function that comes back to
/// itself, is an error.
#[derive(Args)]
struct Stack {
    /// Which Rust toolchain to build with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Count the instructions of a poll, in the emulator, while others send the worst that there is.
#[derive(Args)]
struct Work {
    /// Which Rust toolchain to build with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Measure which lines and branches of the library its tests reach; fails below what they reached once.
///
/// What is missing (a nightly toolchain, cargo-llvm-cov) is installed first. Builds and runs all tests of the library, which takes
/// a while.
#[derive(Args)]
struct Coverage {
    /// Name the lines that are not reached, and those with branches that are not taken.
    #[arg(long)]
    missing: bool,
}

/// Run what takes too long for every change: coverage, mutants, Miri, long fuzzing, comparisons. For the night.
///
/// Each step's result and output stay in target/nightly, with the tested commit. A step that has passed at this commit is
/// skipped, so an interrupted run can be resumed. Failures are reported at the end and do not stop the other steps.
#[derive(Args)]
struct Nightly {
    /// Only the steps whose names begin so.
    #[arg(value_name = "STEP")]
    steps: Vec<String>,
    /// Run steps again that have passed at this commit.
    #[arg(long)]
    again: bool,
    /// Run nothing: print the steps and their results at this commit.
    #[arg(long, conflicts_with = "again")]
    list: bool,
}

/// Play what may go wrong, in the emulator, and check what has to hold then: the fault matrix.
///
/// Lines that lose bytes and that stall, ground stations that die or come in pairs, resets at every item and at every step of
/// the flash, flash that fails, a flight loop that hangs, clocks that wrap, replays, floods, a stack that is too small. Each
/// scenario prints a line with its figures.
#[derive(Args)]
struct Faults {
    /// One of them; all, when none is named. An unknown name lists them.
    #[arg(value_name = "SCENARIO")]
    scenario: Option<String>,
    /// Which Rust toolchain to build with; without this option the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

/// Change the library in one place at a time: which changes do the tests not notice? Fails when one is not listed in
/// xtask/mutants.txt, with a reason.
///
/// What is missing (cargo-mutants) is installed first. A change takes seconds, all of them hours: for the night.
#[derive(Args)]
struct Mutants {
    /// Which of signing, frame, mission, storage; all, when none is named.
    #[arg(value_name = "AREA")]
    areas: Vec<String>,
    /// Only a part of them: the K-th of N, from 0.
    #[arg(long, value_name = "K/N")]
    shard: Option<String>,
    /// Only those in lines that this file changes, the output of `git diff`.
    #[arg(long, value_name = "FILE")]
    in_diff: Option<PathBuf>,
}

fn resolve(address: &str) -> Result<SocketAddr, String> {
    let mut found = address.to_socket_addrs().map_err(|error| format!("{error} (it looks like 127.0.0.1:14550)"))?;
    match found.next() {
        Some(address) if address.port() == 0 => Err("nobody listens on port 0".to_owned()),
        Some(address) => Ok(address),
        None => Err("no such host".to_owned()),
    }
}

fn setup() -> system::Result {
    toolchain::prepare(None, &toolchain::TARGETS)?;
    qemu::prepare()?;
    integration::environment()?;
    fuzz::prepare()
}

fn main() -> ExitCode {
    let result = match Arguments::parse().task {
        Task::Qemu(arguments) => {
            let Qemu { app, port_base, udp, log, qmp, toolchain } = arguments;
            qemu::run(app, port_base, udp, qmp, log.as_deref(), toolchain)
        }
        Task::Setup => setup(),
        Task::Size(Size { options: true, accept, toolchain, .. }) => options::report(toolchain, accept),
        Task::Size(Size { options: false, accept, symbols, toolchain }) => {
            size::report(toolchain, size::Options { accepts: accept, symbols })
        }
        Task::Cross(arguments) => firmware::cross(arguments.toolchain),
        Task::Boards => boards::build_all(),
        Task::Integration(arguments) => integration::run_tests(arguments.target, arguments.toolchain),
        Task::Compare(arguments) => compare::run_all(arguments.rounds, arguments.toolchain),
        Task::Coverage(arguments) => coverage::measure(arguments.missing),
        Task::Miri => miri::run_tests(),
        Task::Mutants(Mutants { areas, shard, in_diff }) => {
            mutants::survive(&mutants::Options { areas, shard, in_diff })
        }
        Task::Fuzz(Fuzz { targets, seconds, executions, minimise }) => {
            fuzz::fuzz(&fuzz::Options { seconds, executions, minimises: minimise, targets })
        }
        Task::Dialects(arguments) => dialects::run(arguments.toolchain),
        Task::PublishCheck => publish::check(),
        Task::Trace(arguments) => trace::run(arguments.write),
        Task::PanicFree(arguments) => panic_free::prove(arguments.toolchain),
        Task::Stack(arguments) => stack::prove(arguments.toolchain),
        Task::Nightly(Nightly { steps, again, list }) => {
            nightly::run(&nightly::Options { names: steps, again, lists: list })
        }
        Task::Work(arguments) => work::measure(arguments.toolchain),
        Task::Faults(arguments) => faults::play(arguments.scenario.as_deref(), arguments.toolchain),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
