//! `cargo qemu`: the demo vehicle on an emulated Cortex-M4.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
use std::path::Path;
use std::process::{ChildStdout, Stdio};
use std::sync::{Arc, mpsc};

use mavstack_console::{Console, Tlog};
use mavstack_demo::connect::{FurtherStations, HowToConnect, OtherLinks};

use crate::emulator::{self, BOARD, Emulator, Ended};
use crate::firmware::App;
use crate::system::Result;
use crate::toolchain::{self, Choice};
use crate::{bridge, firmware, log};

/// Serial ports of the vehicle.
const PORTS: u16 = 3;
/// The vehicle's UDP port on its Ethernet.
const VEHICLE_PORT: u16 = 14_550;
/// Where the firmware looks for the UDP port of ground stations, and for whether it runs without components: `OPTIONS` in
/// `examples/qemu/src/flash.rs`, behind the logs.
const STATION_PORT: u32 = 0x2110_0000;
const NO_COMPONENTS: u32 = STATION_PORT + 4;

/// The transport of the telemetry link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Telemetry {
    /// UART0 is a TCP port.
    Tcp,
    /// Frames from UART0 are sent to this address, and back.
    Udp(SocketAddr),
    /// The board's Ethernet. The vehicle broadcasts to this UDP port of this machine.
    Ethernet(u16),
}

impl Telemetry {
    /// Returns the transport for this firmware and the option `--udp`.
    pub fn new(app: App, udp: Option<SocketAddr>) -> Result<Self> {
        match udp {
            None if app.has_network() => Ok(Self::Ethernet(VEHICLE_PORT)),
            Some(peer) if app.has_network() => match peer.ip() {
                IpAddr::V4(Ipv4Addr::LOCALHOST) => Ok(Self::Ethernet(peer.port())),
                other => Err(format!("the emulated Ethernet reaches this machine only: use 127.0.0.1, not {other}")),
            },
            None => Ok(Self::Tcp),
            Some(peer) => Ok(Self::Udp(peer)),
        }
    }
}

/// How to run the emulator.
#[derive(Clone, Copy, Debug)]
pub struct Options<'a> {
    /// The first of the TCP ports.
    pub port_base: u16,
    /// The TCP port for QMP commands, a reset of the processor among them.
    pub qmp: Option<u16>,
    /// The emulator's network, to which the board's Ethernet is connected; by default this machine only.
    pub nic: Option<&'a str>,
    /// The vehicle runs without its camera and its gimbal.
    pub no_components: bool,
}

/// `cargo qemu`.
pub fn run(
    app: App,
    udp: Option<SocketAddr>,
    log: Option<&Path>,
    options: Options<'_>,
    choice: Option<Choice>,
) -> Result {
    let Options { port_base, qmp, nic, .. } = options;
    let telemetry = Telemetry::new(app, udp)?;
    if nic.is_some() && !app.has_network() {
        return Err(format!("`{}` has no network: use --nic with --app ethernet", app.name()));
    }
    if log.is_some() && app.has_network() {
        return Err("--log logs the UARTs, but telemetry is on Ethernet: log it in the ground station".to_owned());
    }
    // A busy port is the most likely mistake, so it is found before the long build.
    check_ports(port_base, telemetry)?;
    emulator::prepare()?;
    let choice = toolchain::prepare(choice, &[toolchain::TARGET])?;
    let path = firmware::build(choice, app, true)?;
    let elf = firmware::read(&path)?;
    firmware::print_size("Firmware", &elf)?;
    let table = log::table(&elf)?;

    let tlog = log.map(Tlog::create).transpose()?;
    let console = Console::new();
    let stop = stop_signal()?;
    let (mut emulator, output) = start(&path, telemetry, options, tlog)?;
    println!("QEMU runs the firmware ({}) on {BOARD} (Cortex-M4F). Connect a ground station:\n", app.name());
    match telemetry {
        Telemetry::Tcp => println!("{}\n", HowToConnect::Tcp(port_base)),
        Telemetry::Udp(peer) => println!("{}\n", HowToConnect::Udp(peer)),
        Telemetry::Ethernet(station) if nic.is_some() => {
            println!("UDP port {station} of any machine on the network of the board.\n");
        }
        Telemetry::Ethernet(station) => {
            println!("{}\n", HowToConnect::Udp((Ipv4Addr::LOCALHOST, station).into()));
            println!("{}\n", FurtherStations { port: port_base });
        }
    }
    println!("{}\n", OtherLinks { system: 1, companion: port_base + 1, satellite: port_base + 2 });
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

fn check_ports(base: u16, telemetry: Telemetry) -> Result {
    if matches!(telemetry, Telemetry::Ethernet(_))
        && let Err(error) = UdpSocket::bind((Ipv4Addr::LOCALHOST, base))
    {
        return Err(format!("UDP port {base} cannot be used ({error}); take others with --port-base"));
    }
    for port in base + u16::from(telemetry != Telemetry::Tcp)..base + PORTS {
        if let Err(error) = TcpListener::bind((Ipv4Addr::LOCALHOST, port)) {
            return Err(format!("TCP port {port} cannot be used ({error}); take others with --port-base"));
        }
    }
    Ok(())
}

/// Starts the firmware at `elf`, and returns the emulator with the firmware's log, encoded. The links' traffic is logged to `tlog`.
pub fn start(
    elf: &Path,
    telemetry: Telemetry,
    options: Options<'_>,
    tlog: Option<Arc<Tlog>>,
) -> Result<(Emulator, ChildStdout)> {
    let Options { port_base, qmp, nic, no_components } = options;
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
        let serial = match (telemetry, &tlog) {
            (Telemetry::Ethernet(_), _) if uart == 0 => {
                command.args(["-serial", "null"]);
                continue;
            }
            (Telemetry::Udp(peer), _) if uart == 0 => {
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
    if let Telemetry::Ethernet(station) = telemetry {
        // The forwarded port is bound to the loopback interface. The vehicle sends from it, too, so nothing leaves this machine.
        let this_machine = format!("user,hostfwd=udp:127.0.0.1:{port_base}-:{VEHICLE_PORT}");
        command.args(["-nic", nic.unwrap_or(&this_machine)]);
        command.args(["-device", &format!("loader,addr={STATION_PORT:#x},data={station},data-len=4")]);
    }
    if no_components {
        command.args(["-device", &format!("loader,addr={NO_COMPONENTS:#x},data=1,data-len=4")]);
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
