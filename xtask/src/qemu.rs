//! The firmware on an emulated Cortex-M4.

use std::io::{BufRead, BufReader};
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use mavstack_console::{Console, Tlog};
use mavstack_demo::connect::{HowToConnect, OtherLinks};

use crate::firmware::App;
use crate::system::{self, Result, apt_install, has, succeeds};
use crate::toolchain::{self, Choice};
use crate::{bridge, firmware, log};

const QEMU: &str = "qemu-system-arm";
pub const BOARD: &str = "mps2-an386";
/// Serial ports of the vehicle.
const PORTS: u16 = 3;

/// `cargo qemu`.
pub fn run(
    app: App,
    port_base: u16,
    udp: Option<SocketAddr>,
    qmp: Option<u16>,
    log: Option<&Path>,
    choice: Option<Choice>,
) -> Result {
    // Before the long work: a busy port is the likeliest mistake.
    check_ports(port_base, udp.is_some())?;
    prepare()?;
    let choice = toolchain::prepare(choice, &[toolchain::TARGET])?;
    let path = firmware::build(choice, app, true)?;
    let elf = firmware::read(&path)?;
    firmware::print_size("Firmware", &elf)?;
    let table = log::table(&elf)?;

    let tlog = log.map(Tlog::create).transpose()?;
    let console = Console::new();
    let stop = system::stop_signal()?;
    let (mut emulator, output) = Emulator::start(&path, port_base, udp, qmp, tlog)?;
    println!("QEMU runs the firmware ({}) on {BOARD} (Cortex-M4F). Connect a ground station:\n", app.name());
    let telemetry = udp.map_or(HowToConnect::Tcp(port_base), HowToConnect::Udp);
    println!("{telemetry}\n");
    println!("{}\n", OtherLinks { companion: port_base + 1, satellite: port_base + 2 });
    if let Some(port) = qmp {
        println!("The emulator itself: QMP on TCP port {port}.");
    }
    println!("The vehicle's log follows; Ctrl-C ends it.\n");

    std::thread::scope(|scope| {
        let printer =
            scope.spawn(|| log::read(&table, output, |line| console.print(line), |status| console.show(status)));
        let ended = emulator.wait(&stop);
        drop(emulator);
        // Its last words, a panic's place among them, were printed then.
        let _ = printer.join();
        console.end();
        match ended? {
            Ended::Stopped => {
                println!("The emulator was ended.");
                Ok(())
            }
            Ended::ByItself(status) => Err(format!("the emulator ended by itself ({status})")),
        }
    })
}

/// QEMU must be there.
pub fn prepare() -> Result {
    if has(QEMU) {
        return Ok(());
    }
    let elsewhere = "QEMU for Arm systems (Fedora: `dnf install qemu-system-arm`, Arch: `pacman -S qemu-system-arm`, \
                     macOS: `brew install qemu`)";
    apt_install("the emulator QEMU", &[QEMU], elsewhere)
}

fn check_ports(base: u16, udp: bool) -> Result {
    for port in base + u16::from(udp)..base + PORTS {
        if let Err(error) = TcpListener::bind((Ipv4Addr::LOCALHOST, port)) {
            return Err(format!("TCP port {port} cannot be used ({error}); take others with --port-base"));
        }
    }
    Ok(())
}

/// The emulator's command, to be ended with us also when we are killed, as far as the system has means for that: Linux.
pub fn emulator() -> Command {
    let dies_with_us = ["--pdeathsig", "KILL"];
    let mut command = if succeeds("setpriv", &[&dies_with_us[..], &["true"]].concat()) {
        let mut command = Command::new("setpriv");
        command.args(dies_with_us).arg(QEMU);
        command
    } else {
        Command::new(QEMU)
    };
    // Ctrl-C on the terminal is for us: else it would seem to end by itself.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}

/// How an emulator ended.
pub enum Ended {
    /// We were asked to stop.
    Stopped,
    /// It ended: the firmware panicked, or QEMU failed.
    ByItself(std::process::ExitStatus),
}

/// A running QEMU; ended when dropped.
pub struct Emulator(Child);

impl Emulator {
    /// Starts the firmware at `elf`; what it returns besides is the firmware's log, encoded. On TCP port `qmp` it can be
    /// told to reset the processor, in the emulator's own protocol. What passes over the links goes into `tlog`.
    pub fn start(
        elf: &Path,
        port_base: u16,
        udp: Option<SocketAddr>,
        qmp: Option<u16>,
        tlog: Option<Arc<Tlog>>,
    ) -> Result<(Self, ChildStdout)> {
        let mut command = emulator();
        command.args(["-machine", BOARD, "-display", "none", "-monitor", "none"]);
        for (uart, port) in (port_base..).take(PORTS.into()).enumerate() {
            let failed = |error: std::io::Error| format!("the emulator's TCP port {port}: {error}");
            // Where we stand between, the emulator calls us.
            let between = || {
                let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(failed)?;
                let called = format!("tcp:{}", listener.local_addr().map_err(failed)?);
                Result::Ok((listener, called))
            };
            let serial = match (udp, &tlog) {
                (Some(peer), _) if uart == 0 => {
                    let (listener, called) = between()?;
                    bridge::start_udp(listener, peer, tlog.clone())?;
                    called
                }
                (_, Some(tlog)) => {
                    let (listener, called) = between()?;
                    let port = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(failed)?;
                    bridge::start_tcp(listener, port, Arc::clone(tlog));
                    called
                }
                _ => format!("tcp:127.0.0.1:{port},server=on,wait=off"),
            };
            // Without `nodelay` the emulator's single bytes wait for acknowledgements, 40 ms each.
            command.args(["-serial", &format!("{serial},nodelay=on")]);
        }
        if let Some(port) = qmp {
            command.args(["-qmp", &format!("tcp:127.0.0.1:{port},server=on,wait=off")]);
        }
        command
            .args(["-chardev", "stdio,id=log,signal=off"])
            .args(["-semihosting-config", "enable=on,target=native,chardev=log"])
            .arg("-kernel")
            .arg(elf)
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        start(&mut command)
    }

    /// Waits for its end or ours.
    pub fn wait(&mut self, stop: &mpsc::Receiver<()>) -> Result<Ended> {
        loop {
            if let Some(status) = self.0.try_wait().map_err(|error| format!("the emulator is lost: {error}"))? {
                return Ok(Ended::ByItself(status));
            }
            if stop.recv_timeout(Duration::from_millis(100)).is_ok() {
                return Ok(Ended::Stopped);
            }
        }
    }
}

/// Starts the emulator whose `command` this is, with its output.
pub fn start(command: &mut Command) -> Result<(Emulator, ChildStdout)> {
    let mut child = command.spawn().map_err(|error| format!("{QEMU} could not be started: {error}"))?;
    let output = child.stdout.take();
    // From here on it is ended whatever happens.
    let emulator = Emulator(child);
    output.map(|output| (emulator, output)).ok_or_else(|| "the emulator has no output".to_owned())
}

/// The lines that a firmware says. A thread reads them, so that one that says nothing any more is found out.
pub struct Lines(mpsc::Receiver<String>);

impl Lines {
    /// No firmware of ours is silent for so long, on a machine that has other things to do too.
    const PATIENCE: Duration = Duration::from_secs(300);

    pub fn of(output: ChildStdout) -> Self {
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            // Nobody listens any more when it took too long.
            BufReader::new(output).lines().map_while(std::result::Result::ok).try_for_each(|line| sender.send(line))
        });
        Self(lines)
    }

    /// The next one; `None` behind the last.
    pub fn next(&self) -> Result<Option<String>> {
        match self.0.recv_timeout(Self::PATIENCE) {
            Ok(line) => Ok(Some(line)),
            Err(RecvTimeoutError::Disconnected) => Ok(None),
            Err(RecvTimeoutError::Timeout) => Err(format!("the firmware says nothing for {:?}", Self::PATIENCE)),
        }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        // Both fail only when it has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
