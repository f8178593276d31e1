//! The demo vehicle as a host program, or a fleet of them: the same application as the firmware in QEMU, with sockets instead of UARTs.

mod flash;
#[cfg(test)]
mod metadata;
mod plan;
mod tcp;
mod udp;
mod vehicle;

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::Parser;
use mavstack_console::{Console, Tap, Tlog};
use mavstack_demo::connect::{HowToConnect, OtherLinks};

use vehicle::{Links, Vehicle};

/// Period of the flight loop.
const PERIOD: Duration = Duration::from_millis(1);

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
///
/// With --count it is a fleet: vehicles with system ids in a row, ten metres apart, each with three ports of its own. The status line is
/// the first vehicle's.
#[derive(Parser)]
#[command(name = "mavstack-sitl", version)]
struct Arguments {
    /// Run this many vehicles.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=254))]
    count: u8,
    /// System id of the first vehicle, by default 1. The others have the ids after it. This option and --count replace the stored
    /// MAV_SYS_ID; a single vehicle without this option keeps it.
    #[arg(long, value_name = "ID", value_parser = clap::value_parser!(u8).range(1..=254))]
    system: Option<u8>,
    /// First of three consecutive TCP ports. The ports of each further vehicle are ten above those of the one before.
    #[arg(long, value_name = "PORT", default_value_t = 5770, value_parser = clap::value_parser!(u16).range(1..=65533))]
    port_base: u16,
    /// Send telemetry over UDP to this address instead of listening on TCP. QGroundControl listens on the default address. Each vehicle
    /// sends from a port of its own.
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:14550", value_parser = resolve)]
    udp: Option<SocketAddr>,
    /// Store the signing key, the parameters and the plans in this file, as a flight controller does in flash. They are
    /// restored at the next start. Only its owner can read the file. An existing file with other content is refused.
    /// Each further vehicle has a file with its number behind the name: FILE.2, FILE.3. Without this option nothing is stored.
    #[arg(long, value_name = "FILE")]
    storage: Option<PathBuf>,
    /// Run without the camera and the gimbal, components 100 and 154: for clients that take any heartbeat for the vehicle's. Commands
    /// and mission items for them are then unsupported.
    #[arg(long)]
    no_components: bool,
    /// Load this plan at the start: a mission, geofence or rally points in the text format of QGroundControl, Mission Planner
    /// and MAVProxy ("QGC WPL"). Its first row is the home position if it has index 0, frame 0 and command 16 or 0, and an item
    /// otherwise; the program prints which.
    #[arg(long, value_name = "FILE")]
    plan: Option<PathBuf>,
    /// Log the links' traffic to this file (".tlog", as Mission Planner and MAVProxy write it). While a client is connected,
    /// each frame that the vehicle's decoder takes, and each frame that the vehicle sends, is logged with its time. That
    /// includes frames that the vehicle then refuses. A frame with an unknown id is logged only if its sender was heard before,
    /// and a frame or silence follows: the vehicle also takes one whose signature is right, but only the vehicle has the key.
    /// MAVExplorer and pymavlink read the file. Messages with keys or passwords are omitted, and signatures are overwritten
    /// with zeros. An existing log is replaced; any other existing file is refused. All vehicles share it.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Treat the first row of the plan as an item, even if it looks like a home position.
    #[arg(long, requires = "plan")]
    no_home: bool,
}

impl Arguments {
    /// Checks what concerns several arguments.
    fn check(&self) -> Result<(), String> {
        let (count, first) = (self.count, self.first());
        let last = u16::from(first) + u16::from(count) - 1;
        if last > 254 {
            return Err(format!("{count} vehicles from system id {first} need ids up to {last}; the last one is 254"));
        }
        if self.port(self.count - 1).is_none() {
            return Err(format!("{count} vehicles need ports beyond 65535; choose lower ones with --port-base"));
        }
        Ok(())
    }

    /// Returns the system id of the first vehicle. A stored one may take precedence.
    fn first(&self) -> u8 {
        self.system.unwrap_or(1)
    }

    /// Returns whether the command line sets the system ids. Stored ids would leave gaps in a fleet.
    fn prescribes_systems(&self) -> bool {
        self.system.is_some() || self.count > 1
    }

    /// Returns the first port of a vehicle, by its index.
    fn port(&self, index: u8) -> Option<u16> {
        self.port_base.checked_add(10 * u16::from(index)).filter(|port| *port <= 65_533)
    }

    /// Prints how to connect to the vehicles. `system`: the system id of the first one.
    fn print_how_to_connect(&self, system: u8) {
        let base = self.port_base;
        if self.count == 1 {
            println!("The vehicle is running. Connect a ground station:\n");
        } else {
            let last = system + (self.count - 1);
            println!("{} vehicles are running, systems {system} to {last}. Connect a ground station:\n", self.count);
        }
        println!("{}\n", self.udp.map_or(HowToConnect::Tcp(base), HowToConnect::Udp));
        println!("{}\n", OtherLinks { system, companion: base + 1, satellite: base + 2 });
        if self.count > 1 {
            println!("The ports of each further vehicle are ten above those of the one before.\n");
        }
        println!("Press Ctrl-C to stop.\n");
    }
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

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), String> {
    arguments.check()?;
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    ctrlc::set_handler(move || stopped.store(true, Ordering::Relaxed)).map_err(|error| format!("signals: {error}"))?;

    let console = Console::new();
    // Open all ports before any file. A busy port is the most likely error, and the files may then belong to a running vehicle.
    let links =
        (0..arguments.count).map(|index| Links::open(arguments, index, &console)).collect::<Result<Vec<_>, _>>()?;
    let tlog = arguments.log.as_deref().map(Tlog::create).transpose()?;
    let mut fleet = Vec::new();
    for (index, mut links) in (0..arguments.count).zip(links) {
        if let Some(tlog) = &tlog {
            links.log_to(tlog);
        }
        fleet.push(Vehicle::boot(arguments, index, links, &console)?);
    }
    arguments.print_how_to_connect(fleet.first().map_or(arguments.first(), Vehicle::system));

    // Vehicles next to each other share a thread; there is a thread for each core.
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let share = fleet.len().div_ceil(threads);
    let result: Result<(), String> = thread::scope(|scope| {
        let workers: Vec<_> =
            fleet.chunks_mut(share).map(|vehicles| scope.spawn(|| fly(vehicles, arguments, &stop, &console))).collect();
        workers
            .into_iter()
            .try_for_each(|worker| worker.join().unwrap_or_else(|_| Err("a vehicle has panicked".into())))
    });
    console.end();
    result.inspect(|()| {
        println!("{}", if arguments.count == 1 { "The vehicle has stopped." } else { "The vehicles have stopped." })
    })
}

/// Stops the program when dropped: also when a vehicle panics.
struct StopAtEnd<'a>(&'a AtomicBool);

impl Drop for StopAtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Runs some of the vehicles until the program is stopped, or one of them fails: then the others stop too.
fn fly(vehicles: &mut [Vehicle], arguments: &Arguments, stop: &AtomicBool, console: &Console) -> Result<(), String> {
    let _stop = StopAtEnd(stop);
    let mut failed = Ok(());
    while failed.is_ok() && !stop.load(Ordering::Relaxed) {
        let began = Instant::now();
        for vehicle in &mut *vehicles {
            failed = failed.and_then(|()| vehicle.step(arguments, console));
        }
        thread::sleep(PERIOD.saturating_sub(began.elapsed()));
    }
    failed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_one_vehicle_stops_the_others() {
        let stop = AtomicBool::new(false);
        let result = thread::scope(|scope| {
            let worker = scope.spawn(|| {
                let _stop = StopAtEnd(&stop);
                panic!("a vehicle");
            });
            worker.join()
        });
        assert!(result.is_err() && stop.into_inner());
    }
}
