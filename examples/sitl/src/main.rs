//! The demo vehicle as a host program: the same application as the firmware in QEMU, with sockets instead of UARTs.

mod flash;
#[cfg(test)]
mod metadata;
mod plan;
mod tcp;
mod udp;

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{self, Duration};

use clap::Parser;
use mavstack::network::LinkError;
use mavstack::wpl::HomeRow;
use mavstack::{Instant, LinkId};
use mavstack_console::{Console, Tap, Tlog};
use mavstack_demo::connect::{HowToConnect, OtherLinks};
use mavstack_demo::{App, COMPANION, LINKS, LogMemory, Mavlink, SATELLITE, TELEMETRY};

use flash::FileFlash;
use tcp::Port;
use udp::Datagrams;

/// The vehicle. Its stack is boxed because it is large for a stack frame.
type SitlApp = App<Box<Mavlink>>;

type Store = mavstack::storage::Store<FileFlash>;

/// Length of the storage file, in bytes. It leaves room for larger plans, so that later versions can use the same file.
const STORAGE_LEN: u32 = 512 * 1024;
const _: () = assert!(STORAGE_LEN >= 4 * Store::region_len::<Mavlink>());

/// The flight logs. A reboot of the vehicle keeps them.
static LOGS: LogMemory = LogMemory::new();

/// Period of the flight loop.
const PERIOD: Duration = Duration::from_millis(1);
/// Interval between updates of the status line.
const STATUS_PERIOD: mavstack::Duration = mavstack::Duration::from_secs(1);

/// Run the demo vehicle on this machine.
///
/// The vehicle (system 1, component 1) has three links, each on a TCP port of this machine. A port accepts one client at a
/// time. The defaults are 5770 for telemetry, 5771 for a companion computer and 5772 for a satellite modem.
///
/// The vehicle forwards between the telemetry and companion links. The satellite link carries commands and their answers.
/// MAV_CMD_CONTROL_HIGH_LATENCY 1 starts HIGH_LATENCY2 there, every 67 s by default (MAV_2_HL_FREQ); 0 stops it. With
/// MAV_HL_LOSS_T above 0 it also starts that many seconds after the last ground station was lost. STAT_HL_BYTES and
/// STAT_HL_CREDITS count the cost.
///
/// The companion link accepts a signing key by SETUP_SIGNING. From then on it is the only link that accepts unsigned frames.
///
/// Capacities: 1,000 mission items, 256 fence items, 64 rally points. A reboot command restarts the vehicle and keeps the
/// connections. Press Ctrl-C to stop.
#[derive(Parser)]
#[command(name = "cargo sitl")]
struct Arguments {
    /// First of three consecutive TCP ports.
    #[arg(long, value_name = "PORT", default_value_t = 5770, value_parser = clap::value_parser!(u16).range(1..=65533))]
    port_base: u16,
    /// Send telemetry over UDP to this address instead of listening on TCP. QGroundControl listens on the default address.
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:14550", value_parser = resolve)]
    udp: Option<SocketAddr>,
    /// Store the signing key, the parameters and the plans in this file, as a flight controller does in flash. They are
    /// restored at the next start. Only its owner can read the file. An existing file with other content is refused.
    /// Without this option nothing is stored.
    #[arg(long, value_name = "FILE")]
    storage: Option<PathBuf>,
    /// Load this plan at the start: a mission, geofence or rally points in the text format of QGroundControl, Mission Planner
    /// and MAVProxy ("QGC WPL").
    #[arg(long, value_name = "FILE")]
    plan: Option<PathBuf>,
    /// Log the links' traffic to this file (".tlog", as Mission Planner and MAVProxy write it). While a client is connected,
    /// each frame that the vehicle's decoder takes, and each frame that the vehicle sends, is logged with its time. That
    /// includes frames that the vehicle then refuses. A frame with an unknown id is logged only if its sender was heard before,
    /// and a frame or silence follows: the vehicle also takes one whose signature is right, but only the vehicle has the key.
    /// MAVExplorer and pymavlink read the file. Messages with keys or passwords are omitted, and signatures are overwritten
    /// with zeros. An existing log is replaced; any other existing file is refused.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Treat the first row of the plan as an item. By default it is the home position, as in missions saved by ground stations.
    #[arg(long, requires = "plan")]
    no_home: bool,
}

fn resolve(address: &str) -> Result<SocketAddr, String> {
    let mut found =
        address.to_socket_addrs().map_err(|error| format!("{error}; use HOST:PORT, for example 127.0.0.1:14550"))?;
    match found.next() {
        Some(address) if address.port() == 0 => Err("port 0 cannot receive; use 1 to 65535".to_owned()),
        Some(address) => Ok(address),
        None => Err("the host name has no address".to_owned()),
    }
}

/// Logs both directions of a link. The default logs nothing.
#[derive(Default)]
struct Log {
    received: Tap,
    sent: Tap,
}

impl Log {
    fn new(tlog: &Arc<Tlog>) -> Self {
        let tap = || Tap::new(Some(Arc::clone(tlog)));
        Self { received: tap(), sent: tap() }
    }

    /// Discards incomplete frames. Call it when the client changes.
    fn restart(&mut self) {
        self.received.restart();
        self.sent.restart();
    }
}

/// The transport of the telemetry link.
enum Telemetry {
    Tcp(Port),
    Udp(Datagrams),
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The vehicle and its storage.
struct Device {
    app: SitlApp,
    store: Option<Store>,
}

impl Device {
    /// Boots the vehicle with the contents of its storage.
    fn boot(arguments: &Arguments, console: &Console) -> Result<Self, String> {
        let mut device = Self { app: App::new(Box::new(Mavlink::VACANT)), store: None };
        let app = &mut device.app;
        app.keep_logs(&LOGS);
        if let Some(path) = &arguments.storage {
            let store = device.store.insert(Store::new(FileFlash::open(path, STORAGE_LEN)?, 0..STORAGE_LEN));
            if let Err(errors) = app.restore(Instant::ZERO, store) {
                console.print_error(format_args!("{}: not all could be read: {errors}", path.display()));
            }
        }
        if let Some(path) = &arguments.plan {
            let home_row = if arguments.no_home { HomeRow::None } else { HomeRow::First };
            let items = plan::read(path, home_row)?;
            console.print(format_args!("{}: {} items", path.display(), items.len()));
            plan::load(app, items).map_err(|fault| format!("{}: {fault}", path.display()))?;
        }
        Ok(device)
    }

    /// Runs the vehicle until `stop` is set or a reboot was requested. Simulated time starts at 0.
    fn fly(&mut self, stop: &AtomicBool, console: &Console, telemetry: &mut Telemetry, others: &mut [(LinkId, Port)]) {
        let mut shown = Instant::ZERO;
        let app = &mut self.app;
        let boot = time::Instant::now();
        // This machine's clock serves as the vehicle's real-time clock.
        if let Ok(since_1970) = time::SystemTime::now().duration_since(time::UNIX_EPOCH) {
            let unix_usec = u64::try_from(since_1970.as_micros()).unwrap_or(0);
            app.set_calendar(Instant::ZERO, unix_usec);
        }
        while !stop.load(Ordering::Relaxed) && !app.wants_reboot() {
            let began = boot.elapsed();
            let now = Instant::from_micros(u64::try_from(began.as_micros()).unwrap_or(u64::MAX));
            app.control(now);
            while app.simulates_hang() && !stop.load(Ordering::Relaxed) {
                thread::sleep(PERIOD);
            }
            match telemetry {
                Telemetry::Tcp(port) => serve(app, now, TELEMETRY, port),
                Telemetry::Udp(datagrams) => datagrams.serve(app, now, TELEMETRY),
            }
            for (link, port) in &mut *others {
                serve(app, now, *link, port);
            }
            if let Some(store) = &mut self.store {
                app.persist(now, store);
            }
            if now >= shown.after(STATUS_PERIOD) {
                shown = now;
                console.show(app.status(now));
            }
            thread::sleep(PERIOD.saturating_sub(boot.elapsed().saturating_sub(began)));
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), String> {
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    ctrlc::set_handler(move || stopped.store(true, Ordering::Relaxed)).map_err(|error| format!("signals: {error}"))?;

    let console = Console::new();
    let base = arguments.port_base;
    // Open the ports before any file. A busy port is the most likely error, and the files may then belong to a running vehicle.
    let mut telemetry = match arguments.udp {
        Some(peer) => Telemetry::Udp(Datagrams::open(peer)?),
        None => Telemetry::Tcp(Port::open(base, console.clone())?),
    };
    let open = |link, port| Ok::<_, String>((link, Port::open(port, console.clone())?));
    let mut others = [open(COMPANION, base + 1)?, open(SATELLITE, base + 2)?];
    if let Some(path) = &arguments.log {
        let tlog = Tlog::create(path)?;
        match &mut telemetry {
            Telemetry::Tcp(port) => port.log = Log::new(&tlog),
            Telemetry::Udp(datagrams) => datagrams.log = Log::new(&tlog),
        }
        for (_, port) in &mut others {
            port.log = Log::new(&tlog);
        }
    }
    let mut device = Device::boot(arguments, &console)?;
    const { assert!(LINKS == 3) };

    println!("The vehicle is running. Connect a ground station:\n");
    println!("{}\n", arguments.udp.map_or(HowToConnect::Tcp(base), HowToConnect::Udp));
    println!("{}\n\nPress Ctrl-C to stop.\n", OtherLinks { companion: base + 1, satellite: base + 2 });

    loop {
        device.fly(&stop, &console, &mut telemetry, &mut others);
        if stop.load(Ordering::Relaxed) {
            break;
        }
        // Connections stay open, as on a UART.
        console.print("The vehicle reboots.");
        device = Device::boot(arguments, &console)?;
    }
    console.end();
    println!("The vehicle has stopped.");
    Ok(())
}

fn serve(app: &mut SitlApp, now: Instant, link: LinkId, port: &mut Port) {
    match app.serve(now, link, port) {
        Ok(()) => {}
        Err(LinkError::Closed) => port.hang_up("disconnected"),
        Err(error) => port.hang_up(&error.to_string()),
    }
    if port.accept() {
        app.parts().0.restart_link(link);
    }
}
