//! The vehicle under real ground-station software: pymavlink, MAVSDK and MAVProxy, driven by pytest.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use clap::ValueEnum;

use crate::emulator::{self, Emulator};
use crate::firmware::{self, App};
use crate::python::{self, CLIENTS};
use crate::qemu::{self, Telemetry};
use crate::system::{Result, cargo, is_ci, root, run, target_dir};
use crate::toolchain::{self, Choice};

/// Where the vehicle runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Target {
    /// In QEMU.
    Qemu,
    /// On this machine.
    Sitl,
    /// Both, side by side.
    All,
}

/// What is tested.
pub struct Options {
    /// Where the vehicle runs.
    pub target: Target,
    /// One file of tests; all of them if `None`.
    pub file: Option<String>,
    /// How long the tests with a high load take.
    pub load_seconds: u32,
}

/// Ports in a row: the vehicle's links, the emulator's QMP, and the same of a vehicle that a test
/// starts itself.
const PORTS: u16 = 8;
const QMP: u16 = 3;
const SPARE: u16 = 4;

/// The test files by group: the group's name, whether telemetry uses UDP, and its files. Each group has vehicles of its own. The
/// TCP groups take equally long, and neither has all the tests that upload much: the vehicle limits how often plans are stored.
const GROUPS: [(&str, bool, &[&str]); 3] = [
    (
        "TCP 1",
        false,
        &[
            "test_pymavlink.py",
            "test_plans.py",
            "test_messages.py",
            "test_params.py",
            "test_metadata.py",
            "test_events.py",
            "test_files.py",
            "test_logs.py",
            "test_commands.py",
            "test_mavsdk.py",
            "test_mavsdk_flight.py",
            "test_satellite.py",
            // It leaves the vehicle away from home.
            "test_receiver.py",
        ],
    ),
    (
        "TCP 2",
        false,
        &[
            "test_payload.py",
            "test_progress.py",
            "test_modes.py",
            "test_partners.py",
            "test_operators.py",
            "test_qgc_connect.py",
            "test_mavproxy.py",
            "test_mavproxy_flight.py",
            "test_routing.py",
            "test_signing.py",
            "test_power.py",
            "test_differential.py",
            "test_station.py",
            "test_faults.py",
            "test_plan_file.py",
            "test_log.py",
            "test_far.py",
            "test_frameworks.py",
            "test_ethernet.py",
            "test_lan.py",
        ],
    ),
    ("UDP", true, &["test_udp.py"]),
];
/// Tests of other firmwares, which run only in the emulator.
const IN_QEMU: [&str; 3] = ["test_frameworks.py", ETHERNET[0], ETHERNET[1]];
/// The tests of the firmwares with a network, which need a later compiler than everything else.
const ETHERNET: [&str; 2] = ["test_ethernet.py", "test_lan.py"];

/// `cargo xtask integration`.
pub fn run_tests(options: &Options, choice: Option<Choice>) -> Result {
    let target = options.target;
    let is_known = |only: &String| GROUPS.iter().any(|(_, _, files)| files.contains(&only.as_str()));
    if let Some(file) = options.file.as_ref().filter(|file| !is_known(file)) {
        return Err(format!("{file} is no file of tests in {CLIENTS}"));
    }
    let stop = qemu::stop_signal()?;
    let python = python::environment()?;
    let mut programs = Vec::new();
    for (this, name) in [(Target::Sitl, "sitl"), (Target::Qemu, "qemu")] {
        if target == Target::All || target == this {
            let program = if this == Target::Qemu {
                Program::for_qemu(
                    choice,
                    is_ci() || options.file.as_deref().is_some_and(|file| ETHERNET.contains(&file)),
                )?
            } else {
                Program::for_sitl()?
            };
            programs.push((name, program));
        }
    }
    // All groups run in parallel, each with a vehicle of its own: most of the time the tests wait.
    let mut runs = Vec::new();
    for (group, over_udp, files) in GROUPS {
        let files: Vec<_> =
            files.iter().filter(|file| options.file.as_ref().is_none_or(|only| only == *file)).collect();
        for &(target, ref program) in &programs {
            let files: Vec<_> = files.iter().filter(|file| program.runs(file)).collect();
            if files.is_empty() {
                continue;
            }
            let name = format!("{target}, {group}");
            let port = free_ports()?;
            let udp = over_udp.then_some(SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
            let folder = target_dir().join(format!("integration-{target}-{}", group.replace(' ', "-")));
            let log = folder.with_extension("log");
            println!("The vehicle's log ({name}): {}", log.display());
            let log = File::create(&log).map_err(|error| format!("{}: {error}", log.display()))?;
            let vehicle = program.start(port, udp, log)?;
            // The companion's port, to leave telemetry to the tests.
            wait_for(port + 1)?;
            let mut clients = Command::new(&python);
            clients
                .args(["-m", "pytest", "-v", "-p", "no:cacheprovider"])
                .args(["--target", target, "--port-base", &port.to_string()])
                .args(["--spare-port-base", &(port + SPARE).to_string()])
                .args(["--load-seconds", &options.load_seconds.to_string()])
                .args(program.options(port))
                .args(files)
                .env("PYTHONDONTWRITEBYTECODE", "1")
                .env("PYTHONUNBUFFERED", "1")
                // pymavlink's message definitions: MAVLink 2 of common.
                .env("MAVLINK20", "1")
                .env("MAVLINK_DIALECT", "common")
                .envs(home(&folder)?)
                .current_dir(root().join(CLIENTS))
                .stdout(Stdio::piped());
            let mut clients = clients.spawn().map_err(|error| format!("{}: {error}", python.display()))?;
            let label = name.clone();
            let printer = clients.stdout.take().map(|output| thread::spawn(move || print(&label, output)));
            runs.push((name, Process(clients), printer, vehicle));
        }
    }
    if runs.is_empty() {
        return Err("these tests do not run on this target".to_owned());
    }
    let mut failed = Vec::new();
    for (name, clients, printer, _vehicle) in runs {
        let succeeds = wait(clients, &stop)?;
        if let Some(printer) = printer {
            // The printer has then printed everything.
            let _ = printer.join();
        }
        if !succeeds {
            failed.push(name);
        }
    }
    if failed.is_empty() { Ok(()) } else { Err(format!("tests failed: {}", failed.join("; "))) }
}

/// Returns the environment of clients with an empty home of their own in `folder`: MAVSDK caches files there, which groups must not share,
/// and MAVProxy reads the user's settings. Cargo and rustup stay in the user's home.
fn home(folder: &Path) -> Result<Vec<(&'static str, PathBuf)>> {
    let fails = |error| format!("{}: {error}", folder.display());
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(fails)?;
    }
    fs::create_dir_all(folder).map_err(fails)?;
    let mut variables = vec![("HOME", std::path::absolute(folder).map_err(fails)?)];
    if let Some(home) = std::env::home_dir() {
        let is_unset = |(name, _): &(&str, _)| std::env::var_os(name).is_none();
        let tools = [("CARGO_HOME", home.join(".cargo")), ("RUSTUP_HOME", home.join(".rustup"))];
        variables.extend(tools.into_iter().filter(is_unset));
    }
    Ok(variables)
}

/// Prints what the tests say, with their name before each line.
fn print(name: &str, output: ChildStdout) {
    for line in BufReader::new(output).lines().map_while(std::result::Result::ok) {
        println!("{name}: {line}");
    }
}

/// A child that does not outlive us.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // Both fail only when it has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns whether it succeeds; an error if we were told to stop.
fn wait(mut process: Process, stop: &mpsc::Receiver<()>) -> Result<bool> {
    loop {
        if let Some(status) = process.0.try_wait().map_err(|error| error.to_string())? {
            return Ok(status.success());
        }
        if stop.recv_timeout(Duration::from_millis(100)).is_ok() {
            return Err("stopped".to_owned());
        }
    }
}

/// A vehicle that can be started.
enum Program {
    Qemu {
        firmware: PathBuf,
        /// Whether the firmwares with a network are built too.
        has_network: bool,
    },
    Sitl {
        program: PathBuf,
        /// The example `foreign` of the station for tests.
        station: PathBuf,
    },
}

/// A running vehicle, ended when dropped.
enum Vehicle {
    Qemu { _emulator: Emulator },
    Sitl { _process: Process },
}

impl Program {
    /// Builds all firmwares. Those with a network are left out if the compiler is too old, unless they `must` be tested.
    fn for_qemu(choice: Option<Choice>, must: bool) -> Result<Self> {
        emulator::prepare()?;
        let choice = toolchain::prepare(choice, &[toolchain::TARGET])?;
        let mut has_network = true;
        // The others are for the tests that start them.
        for app in App::ALL {
            match app.check_rust(choice) {
                Ok(()) => {}
                Err(error) if must => return Err(error),
                Err(error) => {
                    println!("Skipped: {error}.");
                    has_network = false;
                    continue;
                }
            }
            let path = firmware::build(choice, app, true)?;
            firmware::print_size(&format!("Firmware ({})", app.name()), &firmware::read(&path)?)?;
        }
        Ok(Self::Qemu { firmware: firmware::build(choice, App::Loop, true)?, has_network })
    }

    /// Whether it has what the tests in this file use.
    fn runs(&self, file: &str) -> bool {
        match self {
            Self::Qemu { has_network, .. } => *has_network || !ETHERNET.contains(&file),
            Self::Sitl { .. } => !IN_QEMU.contains(&file),
        }
    }

    fn for_sitl() -> Result<Self> {
        const PACKAGE: &str = "mavstack-sitl";
        const STATION: &str = "foreign";
        run(Command::new(cargo()).args(["build", "--package", PACKAGE]).current_dir(root()))?;
        let station = ["build", "--package", "mavstack-station", "--example", STATION];
        run(Command::new(cargo()).args(station).current_dir(root()))?;
        let folder = target_dir().join("debug");
        Ok(Self::Sitl { program: folder.join(PACKAGE), station: folder.join("examples").join(STATION) })
    }

    fn start(&self, port: u16, udp: Option<SocketAddr>, log: File) -> Result<Vehicle> {
        match self {
            Self::Qemu { firmware, .. } => {
                let table = crate::log::table(&firmware::read(firmware)?)?;
                let options = qemu::Options { port_base: port, qmp: Some(port + QMP), nic: None, no_components: false };
                let (emulator, output) = qemu::start(firmware, Telemetry::new(App::Loop, udp)?, options, None)?;
                thread::spawn(move || {
                    // The log is closed, which is no reason to stop the vehicle.
                    crate::log::read(&table, output, |line| drop(writeln!(&log, "{line}")), |_| {});
                });
                Ok(Vehicle::Qemu { _emulator: emulator })
            }
            Self::Sitl { program, .. } => {
                let child = Command::new(program)
                    .args(["--port-base", &port.to_string()])
                    .args(udp.map(|peer| format!("--udp={peer}")))
                    .stdin(Stdio::null())
                    .stdout(log)
                    .spawn()
                    .map_err(|error| format!("{}: {error}", program.display()))?;
                Ok(Vehicle::Sitl { _process: Process(child) })
            }
        }
    }

    /// How a test resets the vehicle at `port`, or starts another one that it may kill, and the station for tests.
    fn options(&self, port: u16) -> Vec<OsString> {
        match self {
            Self::Qemu { .. } => {
                let ourselves = std::env::current_exe().unwrap_or_default().into();
                vec!["--qmp-port".into(), (port + QMP).to_string().into(), "--xtask".into(), ourselves]
            }
            Self::Sitl { program, station } => {
                vec!["--program".into(), program.into(), "--station".into(), station.into()]
            }
        }
    }
}

/// The first of several consecutive free ports.
fn free_ports() -> Result<u16> {
    let is_free = |port| {
        let address = (Ipv4Addr::LOCALHOST, port);
        TcpListener::bind(address).is_ok() && UdpSocket::bind(address).is_ok()
    };
    (15_760..16_760)
        .step_by(10)
        .find(|&base| (base..base + PORTS).all(is_free))
        .ok_or_else(|| format!("no {PORTS} free ports in a row from 15760 to 16760"))
}

/// Until the vehicle listens.
fn wait_for(port: u16) -> Result {
    let deadline = Instant::now() + Duration::from_secs(20);
    while Instant::now() < deadline {
        if TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_ok() {
            return Ok(());
        }
        thread::sleep(Duration::from_millis(100));
    }
    Err(format!("the vehicle does not listen on port {port}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_tests_is_in_one_group() {
        let entries = std::fs::read_dir(root().join(CLIENTS)).expect("the tests");
        let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
        let mut files: Vec<_> = names.filter(|name| name.starts_with("test_")).collect();
        let mut grouped: Vec<_> =
            GROUPS.iter().flat_map(|(_, _, files)| *files).map(|file| (*file).to_owned()).collect();
        files.sort_unstable();
        grouped.sort_unstable();
        assert_eq!(files, grouped);
    }
}
