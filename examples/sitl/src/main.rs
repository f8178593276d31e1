//! The demo vehicle on the host: the same application as the firmware in QEMU, with sockets for UARTs.

mod flash;
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
use mavstack::dialect::ComponentMetadata;
use mavstack::wpl::HomeRow;
use mavstack::{Durability, Instant, LinkError, LinkId, ParamStore, ParamTable, PlanStore, SigningStore, plan_memory};
use mavstack_console::{Console, Tap, Tlog};
use mavstack_demo::connect::{HowToConnect, OtherLinks};
use mavstack_demo::{App, COMPANION, LINKS, SATELLITE, TELEMETRY, Tuning};

use flash::FileFlash;
use tcp::Port;
use udp::Datagrams;

/// Room for long plans: the host has the memory.
type SitlPlans = plan_memory!(mission: MISSION, fence: FENCE, rally: RALLY);
const MISSION: usize = 1000;
const FENCE: usize = 256;
const RALLY: usize = 64;

type Store = PlanStore<FileFlash>;
type Settings = ParamStore<FileFlash>;
type Key = SigningStore<FileFlash>;

/// How often the flight loop goes round.
const PERIOD: Duration = Duration::from_millis(1);
/// How often it is looked whether its status has changed.
const STATUS_PERIOD: mavstack::Duration = mavstack::Duration::from_secs(1);

/// Run the demo vehicle on this machine.
///
/// The vehicle (system 1, component 1) has three links, each on a TCP port of this machine that takes one client at a
/// time; a second one is turned away. Without options: 5770 for telemetry, 5771 for a companion computer, 5772 for a
/// satellite modem. A fourth port, 5773, offers over HTTP what QGroundControl needs to show the parameters with their units
/// and ranges.
///
/// A ground station on the first port and a companion computer on the second talk to each other through the vehicle. By
/// satellite go commands and their answers and, from MAV_CMD_CONTROL_HIGH_LATENCY 1 to 0, HIGH_LATENCY2 every 67 s or as
/// MAV_2_HL_FREQ has it; also by itself, when no ground station was heard for MAV_HL_LOSS_T seconds. What that cost is in
/// STAT_HL_BYTES and STAT_HL_CREDITS.
///
/// A signing key is taken by SETUP_SIGNING on the companion's port; then frames without a signature are heard there only.
///
/// Room for plans: 1,000 mission items, 256 fence items, 64 rally points. A reboot that a ground station asks for starts the
/// vehicle anew; who is connected stays so. Ctrl-C ends it.
#[derive(Parser)]
#[command(name = "cargo sitl")]
struct Arguments {
    /// First of the TCP ports.
    #[arg(long, value_name = "PORT", default_value_t = 5770, value_parser = clap::value_parser!(u16).range(1..=65532))]
    port_base: u16,
    /// Telemetry over UDP instead of TCP, sent there; QGroundControl listens on the default by itself.
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:14550", value_parser = resolve)]
    udp: Option<SocketAddr>,
    /// Keep the plans in this file, and in two beside it the parameters (its name ends in ".params") and the signing key
    /// (".key", for its owner only), as a flight controller does in flash: they are there again at the next start. Any other
    /// existing file is refused. Without this option they are forgotten.
    #[arg(long, value_name = "FILE")]
    storage: Option<PathBuf>,
    /// Start with this plan, a mission, geofence or rally points: a text file as QGroundControl, Mission Planner and
    /// MAVProxy save it ("QGC WPL").
    #[arg(long, value_name = "FILE")]
    plan: Option<PathBuf>,
    /// Log the links' traffic to this file, as Mission Planner and MAVProxy do (".tlog"): each frame that the vehicle's decoder
    /// accepts or that the vehicle sends, with its time, while a client is connected. MAVExplorer and pymavlink read it. Messages
    /// with keys or passwords are left out, and signatures are overwritten with zeros. An existing log of that name is replaced;
    /// any other file is refused.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// The first row of the plan is an item; else, as in missions that ground stations save, it is the home position.
    #[arg(long, requires = "plan")]
    no_home: bool,
}

fn resolve(address: &str) -> Result<SocketAddr, String> {
    let mut found = address.to_socket_addrs().map_err(|error| format!("{error} (it looks like 127.0.0.1:14550)"))?;
    match found.next() {
        Some(address) if address.port() == 0 => Err("nobody listens on port 0".to_owned()),
        Some(address) => Ok(address),
        None => Err("no such host".to_owned()),
    }
}

/// What passes over a link is logged here, or nowhere.
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

    /// Somebody else speaks from here on.
    fn restart(&mut self) {
        self.received.restart();
        self.sent.restart();
    }
}

/// What the telemetry link goes over.
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

/// The vehicle and what it keeps its plans, its parameters and its key in.
struct Device {
    // Large for a stack frame, and there is one.
    app: Box<App<SitlPlans>>,
    settings: Option<Settings>,
    store: Option<Store>,
    key: Option<Key>,
}

impl Device {
    /// As after power-on.
    fn switch_on(
        arguments: &Arguments,
        console: &Console,
        metadata: Option<&'static ComponentMetadata>,
    ) -> Result<Self, String> {
        let mut device = Self { app: Box::new(App::new()), settings: None, store: None, key: None };
        let app = &mut device.app;
        if let Some(metadata) = metadata {
            app.parts().1.set_metadata(metadata);
        }
        if let Some(path) = &arguments.storage {
            let beside = |ending| {
                let mut name = path.clone().into_os_string();
                name.push(ending);
                PathBuf::from(name)
            };
            let (params, signing) = (beside(".params"), beside(".key"));
            let params_len = Settings::region_len(Tuning::INFO.len());
            let plans_len = Store::region_len(MISSION, FENCE, RALLY);
            // Check all files before creating any.
            FileFlash::check(path, plans_len)?;
            FileFlash::check(&params, params_len)?;
            FileFlash::check(&signing, Key::REGION_LEN)?;
            let flash = FileFlash::open(&params, params_len, false)?;
            let settings = device.settings.insert(Settings::new(flash, 0..params_len));
            if let Err(error) = app.restore_parameters(Instant::ZERO, settings) {
                console.complain(format_args!("{}: not all parameters could be read ({error:?})", params.display()));
            }
            let flash = FileFlash::open(&signing, Key::REGION_LEN, true)?;
            let key = device.key.insert(Key::new(flash, 0..Key::REGION_LEN));
            if let Err(error) = app.restore_signing(Instant::ZERO, key) {
                console.complain(format_args!("{}: the signing key could not be read ({error:?})", signing.display()));
            }
            let flash = FileFlash::open(path, plans_len, false)?;
            let store = device.store.insert(Store::new(flash, 0..plans_len));
            if let Err(error) = app.restore(Instant::ZERO, store, Durability::Durable) {
                console.complain(format_args!("{}: not all plans could be read ({error:?})", path.display()));
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

    /// Flies until `stop`, which is no reboot, or until somebody asks for one. Time begins anew.
    fn fly(&mut self, stop: &AtomicBool, console: &Console, telemetry: &mut Telemetry, others: &mut [(LinkId, Port)]) {
        let mut shown = Instant::ZERO;
        let app = &mut self.app;
        let boot = time::Instant::now();
        // This machine's clock is the vehicle's own.
        if let Ok(since_1970) = time::SystemTime::now().duration_since(time::UNIX_EPOCH) {
            let unix_usec = u64::try_from(since_1970.as_micros()).unwrap_or(0);
            app.parts().1.set_calendar(Instant::ZERO, unix_usec);
        }
        while !stop.load(Ordering::Relaxed) && !app.wants_reboot() {
            let began = boot.elapsed();
            let now = Instant::from_micros(u64::try_from(began.as_micros()).unwrap_or(u64::MAX));
            app.control(now);
            while app.hangs() && !stop.load(Ordering::Relaxed) {
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
            if let Some(settings) = &mut self.settings {
                app.persist_parameters(now, settings);
            }
            if let Some(key) = &mut self.key {
                app.persist_signing(now, key);
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
    // First of all: a busy port is the likeliest mistake, and another vehicle's files are to stay as they are then.
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
    // Without it ground stations show bare numbers, and that is all.
    let metadata = metadata::serve(base + 3)
        .inspect_err(|error| eprintln!("Ground stations get no units and ranges of parameters: {error}"))
        .ok();
    let mut device = Device::switch_on(arguments, &console, metadata)?;
    const { assert!(LINKS == 3) };

    println!("The vehicle is switched on. Connect a ground station:\n");
    println!("{}\n", arguments.udp.map_or(HowToConnect::Tcp(base), HowToConnect::Udp));
    println!("{}\n\nCtrl-C ends it.\n", OtherLinks { companion: base + 1, satellite: base + 2 });

    loop {
        device.fly(&stop, &console, &mut telemetry, &mut others);
        if stop.load(Ordering::Relaxed) {
            break;
        }
        // Who is connected stays so, as on a UART.
        console.print("The vehicle restarts.");
        device = Device::switch_on(arguments, &console, metadata)?;
    }
    console.end();
    println!("The vehicle is switched off.");
    Ok(())
}

fn serve(app: &mut App<SitlPlans>, now: Instant, link: LinkId, port: &mut Port) {
    match app.serve(now, link, port) {
        Ok(()) => {}
        Err(LinkError::Closed) => port.hang_up("disconnected"),
        Err(error) => port.hang_up(&error.to_string()),
    }
    if port.accept() {
        app.parts().0.restart_link(link);
    }
}
