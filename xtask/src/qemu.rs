//! `cargo qemu`: the demo vehicle on an emulated Cortex-M4.

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::Path;
use std::process::{ChildStdout, Stdio};
use std::sync::{Arc, mpsc};

use mavstack_console::{Console, Tlog};
use mavstack_demo::connect::{HowToConnect, OtherLinks};

use crate::emulator::{self, BOARD, Emulator, Ended};
use crate::firmware::App;
use crate::system::Result;
use crate::toolchain::{self, Choice};
use crate::{bridge, firmware, log};

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
    // A busy port is the most likely mistake, so it is found before the long build.
    check_ports(port_base, udp.is_some())?;
    emulator::prepare()?;
    let choice = toolchain::prepare(choice, &[toolchain::TARGET])?;
    let path = firmware::build(choice, app, true)?;
    let elf = firmware::read(&path)?;
    firmware::print_size("Firmware", &elf)?;
    let table = log::table(&elf)?;

    let tlog = log.map(Tlog::create).transpose()?;
    let console = Console::new();
    let stop = stop_signal()?;
    let (mut emulator, output) = start(&path, port_base, udp, qmp, tlog)?;
    println!("QEMU runs the firmware ({}) on {BOARD} (Cortex-M4F). Connect a ground station:\n", app.name());
    let telemetry = udp.map_or(HowToConnect::Tcp(port_base), HowToConnect::Udp);
    println!("{telemetry}\n");
    println!("{}\n", OtherLinks { companion: port_base + 1, satellite: port_base + 2 });
    if let Some(port) = qmp {
        println!("The emulator itself: QMP on TCP port {port}.");
    }
    println!("The vehicle's log follows. Press Ctrl-C to stop.\n");

    std::thread::scope(|scope| {
        let printer =
            scope.spawn(|| log::read(&table, output, |line| console.print(line), |status| console.show(status)));
        let ended = emulator.wait(&stop);
        drop(emulator);
        // Its last lines, which may hold a panic's location, have then been printed.
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

/// Returns a receiver that gets a message at Ctrl-C and SIGTERM, which then no longer end this program. Call it once.
pub fn stop_signal() -> Result<mpsc::Receiver<()>> {
    let (sender, receiver) = mpsc::channel();
    ctrlc::set_handler(move || sender.send(()).unwrap_or(())).map_err(|error| format!("signals: {error}"))?;
    Ok(receiver)
}

fn check_ports(base: u16, udp: bool) -> Result {
    for port in base + u16::from(udp)..base + PORTS {
        if let Err(error) = TcpListener::bind((Ipv4Addr::LOCALHOST, port)) {
            return Err(format!("TCP port {port} cannot be used ({error}); take others with --port-base"));
        }
    }
    Ok(())
}

/// Starts the firmware at `elf`, and returns the emulator with the firmware's log, encoded. The emulator takes QMP commands on TCP
/// port `qmp`, a reset of the processor among them. The links' traffic is logged to `tlog`.
pub fn start(
    elf: &Path,
    port_base: u16,
    udp: Option<SocketAddr>,
    qmp: Option<u16>,
    tlog: Option<Arc<Tlog>>,
) -> Result<(Emulator, ChildStdout)> {
    let mut command = emulator::command();
    command.args(["-machine", BOARD, "-display", "none", "-monitor", "none"]);
    for (uart, port) in (port_base..).take(PORTS.into()).enumerate() {
        let failed = |error: std::io::Error| format!("the emulator's TCP port {port}: {error}");
        // Where this program relays, the emulator connects to it.
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
    emulator::start(&mut command)
}
