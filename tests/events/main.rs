//! Events: what a vehicle reports, and how a ground station gets all of it.

#[path = "../support/mod.rs"]
mod support;

mod checks;
mod delivery;
mod loss;
mod requests;

use mavstack::dialect::*;
use mavstack::events::HealthReport;
use mavstack::{Address, Context, Fill, HealthChecks, LinkConfig, LinkId, Stream, Telemetry};
use mavstack_station::{Client, events::Follow};
use support::*;

mavstack::events! {
    /// The events of a rover.
    struct RoverEvents in "rover" {
        enums {
            /// Why the rover returns.
            Reason: u8 {
                /// low battery
                LOW_BATTERY = 0,
                /// a command
                COMMAND = 1,
            }
            /// Wheels.
            Wheels: bitmask u16 {
                /// left
                LEFT = 1,
                /// right
                RIGHT = 2,
            }
        }
        modes Groups {
            /// Manual
            MANUAL = [1, 2],
            /// Automatic
            AUTO = [4],
        }
        components Parts {
            /// Battery
            BATTERY,
            /// GPS
            GPS,
            /// Motor
            MOTOR,
        }
        arming_checks {
            /// Wait for satellites.
            NoFix(Error) { satellites: u8 } = "No fix, {3} satellites";
            Gusty(Warning) = "Gusty";
        }
        health_checks {
            MotorHot(Critical) { motor: u8, temperature: f32 } = "Motor {3} hot: {4:.0C}";
        }
        events {
            /// A count.
            Counted(Info) { number: u32 } = "{1} counted";
            /// It drives to where it has started.
            Returning(Warning, Debug) { reason: Reason, distance: f32, wheels: Wheels, offset: i16 } = "Returning: {1}";
            Full(Emergency, Disabled) { a: u64, b: i64, c: i32, d: i8, e: u32 } = "Full";
            Parked(Notice) = "Parked";
        }
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Rover, links: 2, events: { history: 20, checks })]
struct Reporting;

/// A failing check.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fails {
    NoFix(Groups, u8),
    Gusty,
    MotorHot(u8, f32),
}

/// A vehicle whose checks are those of the test.
#[derive(Default)]
struct Rover {
    fails: Vec<Fails>,
    cannot_run: Groups,
    run_checks: Option<MavResult>,
}

plain_vehicle!(Rover);

impl HealthChecks for Rover {
    type Events = RoverEvents;

    fn checks(&self, _: &Context<'_>, report: &mut HealthReport<'_>) {
        report.present(Parts::GPS | Parts::MOTOR);
        for check in &self.fails {
            match *check {
                Fails::NoFix(modes, satellites) => report.fails(modes, Parts::GPS, &NoFix { satellites }),
                Fails::Gusty => report.fails(Groups::EMPTY, Parts::NONE, &Gusty),
                Fails::MotorHot(motor, temperature) => {
                    let check = MotorHot { motor, temperature };
                    report.fails(Groups::MANUAL | Groups::AUTO, Parts::MOTOR, &check);
                }
            }
        }
        report.cannot_run(self.cannot_run);
    }

    fn run_checks(&mut self, cx: &mut Context<'_>) -> MavResult {
        cx.text(MavSeverity::INFO, "Checked");
        self.run_checks.unwrap_or(MavResult::ACCEPTED)
    }
}

impl Telemetry for Rover {
    const STREAMS: &'static [Stream] = TestVehicle::STREAMS;

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        TestVehicle::new().fill(id, out)
    }
}

type Site = World<2, Reporting>;

/// A client that receives events in order and requests what is missing.
type Receiver = Talk<Follow>;

fn receiver(client: Client, address: Address) -> Receiver {
    Talk::new(client, address, Follow::new())
}

/// One on each link.
fn receivers() -> [Receiver; 2] {
    [receiver(Client::QGroundControl, STATION), receiver(Client::Mavsdk, OTHER_STATION)]
}

/// A vehicle with two fast links, after its first report of the checks.
fn site() -> Site {
    lossy(LineConfig::default(), 1)
}

/// The same with lines that have faults.
fn lossy(line: LineConfig, seed: u64) -> Site {
    let mut site = Site::of(Setup { links: [LinkConfig::uart(115_200); 2], lines: [line; 2], seed, ..Setup::new() });
    site.run_for(millis(100));
    site
}

/// Records events with these numbers.
fn count(site: &mut Site, numbers: std::ops::Range<u32>) {
    let now = site.now();
    for number in numbers {
        site.stack.event(now, &Counted { number });
    }
}

/// Returns the numbers of the events that a ground station has received.
fn counted(site: &Site, link: usize) -> Vec<u32> {
    let events = site.gcs[link].all::<Event>();
    let events = events.iter().filter(|(_, event)| event.id == id_of::<Counted>());
    events.map(|(_, event)| number_of(event)).collect()
}

fn number_of(event: &Event) -> u32 {
    u32::from_le_bytes(*event.arguments.first_chunk().unwrap())
}

fn id_of<E: mavstack::events::DeclaredEvent>() -> u32 {
    E::INFO.id()
}
