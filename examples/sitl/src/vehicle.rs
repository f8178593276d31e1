//! A vehicle of the program: the application, its storage and its links.

use std::path::PathBuf;
use std::sync::Arc;
use std::time;

use mavstack::network::LinkError;
use mavstack::{Instant, LinkId, Pulse, StackOf};
use mavstack_console::{Console, Tlog};
use mavstack_demo::{App, COMPANION, LogMemory, Mavlink, PORTS, SATELLITE, TELEMETRY};

use crate::flash::FileFlash;
use crate::plan::Plan;
use crate::tcp::Port;
use crate::udp::Datagrams;
use crate::{Arguments, Log};

/// The application. Its stack is boxed because it is large for a stack frame.
pub type SitlApp = App<Box<StackOf<Mavlink>>>;

type Store = mavstack::storage::Store<FileFlash>;

/// Length of the storage file, in bytes. It leaves room for larger plans, so that later versions can use the same file.
const STORAGE_LEN: u32 = 512 * 1024;
const _: () = assert!(STORAGE_LEN >= 4 * Store::region_len::<Mavlink>());

/// Interval between updates of the status line.
const STATUS_PERIOD: mavstack::Duration = mavstack::Duration::from_secs(1);

/// The transport of the telemetry link.
enum Telemetry {
    Tcp(Port),
    Udp(Datagrams),
}

/// The links of a vehicle.
pub struct Links {
    telemetry: Telemetry,
    others: [(LinkId, Port); 2],
}

impl Links {
    /// Opens the ports of the vehicle with this index.
    pub fn open(arguments: &Arguments, index: u8, console: &Console) -> Result<Self, String> {
        const { assert!(PORTS == 3) };
        let base = arguments.port(index).ok_or("there are no ports beyond 65535")?;
        let open = |port| Port::open(port, console.clone());
        let telemetry = match arguments.udp {
            Some(peer) => Telemetry::Udp(Datagrams::open(peer)?),
            None => Telemetry::Tcp(open(base)?),
        };
        Ok(Self { telemetry, others: [(COMPANION, open(base + 1)?), (SATELLITE, open(base + 2)?)] })
    }

    /// Logs all traffic.
    pub fn log_to(&mut self, tlog: &Arc<Tlog>) {
        match &mut self.telemetry {
            Telemetry::Tcp(port) => port.log = Log::new(tlog),
            Telemetry::Udp(datagrams) => datagrams.log = Log::new(tlog),
        }
        for (_, port) in &mut self.others {
            port.log = Log::new(tlog);
        }
    }

    /// Moves bytes. Never blocks.
    fn serve(&mut self, app: &mut SitlApp, now: Instant) {
        match &mut self.telemetry {
            Telemetry::Tcp(port) => serve(app, now, TELEMETRY, port),
            Telemetry::Udp(datagrams) => datagrams.serve(app, now, TELEMETRY),
        }
        for (link, port) in &mut self.others {
            serve(app, now, *link, port);
        }
    }
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

/// State that survives a reboot.
#[derive(Clone, Copy)]
struct Kept {
    pulse: &'static Pulse,
    logs: &'static LogMemory,
}

/// The application from one boot to the next, and its storage.
struct Device {
    app: SitlApp,
    store: Option<Store>,
    /// When it was booted. Its time starts at 0 then.
    boot: time::Instant,
    /// When its status was last shown.
    shown: Instant,
}

impl Device {
    /// Boots with the contents of the storage, but with the system id `system` if there is one.
    fn boot(
        arguments: &Arguments,
        index: u8,
        kept: Kept,
        system: Option<u8>,
        console: &Console,
    ) -> Result<Self, String> {
        let app = App::in_fleet(Box::new(StackOf::<Mavlink>::VACANT), kept.pulse, arguments.first() + index);
        let mut device = Self { app, store: None, boot: time::Instant::now(), shown: Instant::ZERO };
        let app = &mut device.app;
        app.keep_logs(kept.logs);
        if arguments.no_components {
            app.leave_out_components();
        }
        if let Some(path) = &arguments.storage {
            let path = numbered(path, index);
            let store = device.store.insert(Store::new(FileFlash::open(&path, STORAGE_LEN)?, 0..STORAGE_LEN));
            if let Err(errors) = app.restore(Instant::ZERO, store) {
                console.print_error(format_args!("{}: not all could be read: {errors}", path.display()));
            }
        }
        if let Some(system) = system {
            app.set_system(system);
        }
        if let Some(path) = &arguments.plan {
            let plan = Plan::read(path, arguments.no_home)?;
            if index == 0 {
                console.print(format_args!("{}: {plan}", path.display()));
            }
            plan.load(app).map_err(|fault| format!("{}: {fault}", path.display()))?;
        }
        // This machine's clock serves as the vehicle's real-time clock.
        if let Ok(since_1970) = time::SystemTime::now().duration_since(time::UNIX_EPOCH) {
            let unix_usec = u64::try_from(since_1970.as_micros()).unwrap_or(0);
            app.set_calendar(Instant::ZERO, unix_usec);
        }
        Ok(device)
    }
}

/// Returns the name of a vehicle's storage file.
fn numbered(path: &std::path::Path, index: u8) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    if index > 0 {
        name.push(format!(".{}", u16::from(index) + 1));
    }
    name.into()
}

/// A vehicle, over all its boots.
pub struct Vehicle {
    index: u8,
    kept: Kept,
    links: Links,
    device: Device,
}

impl Vehicle {
    /// Boots the vehicle with this index.
    pub fn boot(arguments: &Arguments, index: u8, links: Links, console: &Console) -> Result<Self, String> {
        let kept = Kept { pulse: Box::leak(Box::new(Pulse::new())), logs: Box::leak(Box::new(LogMemory::new())) };
        let system = arguments.prescribes_systems().then_some(arguments.first() + index);
        Ok(Self { index, kept, links, device: Device::boot(arguments, index, kept, system, console)? })
    }

    /// Returns its system id.
    pub fn system(&self) -> u8 {
        self.device.app.stack().address().system.wire()
    }

    /// Runs one pass of its main loop, or reboots it if that was requested. A vehicle whose flight loop hangs does nothing.
    pub fn step(&mut self, arguments: &Arguments, console: &Console) -> Result<(), String> {
        let Device { app, store, boot, shown } = &mut self.device;
        if app.wants_reboot() {
            console.print(format_args!("The vehicle {} reboots.", app.stack().address().system.wire()));
            // The parameter may have been changed since the start, and not yet stored.
            let system = app.next_system().filter(|_| arguments.prescribes_systems());
            // Connections stay open, as on a UART.
            self.device = Device::boot(arguments, self.index, self.kept, system, console)?;
            return Ok(());
        }
        if app.simulates_hang() {
            return Ok(());
        }
        let now = Instant::from_micros(u64::try_from(boot.elapsed().as_micros()).unwrap_or(u64::MAX));
        app.control(now);
        if app.simulates_hang() {
            return Ok(());
        }
        self.links.serve(app, now);
        if let Some(store) = store {
            app.persist(now, store);
        }
        if self.index == 0 && now >= *shown + STATUS_PERIOD {
            *shown = now;
            console.show(app.status(now));
        }
        Ok(())
    }
}
