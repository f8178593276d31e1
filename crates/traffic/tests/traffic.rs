//! The service in a stack with two links, by the public interface.

use mavstack::dialect::{AdsbFlags, AdsbVehicle, CommandAck, CommandLong, MavCmd, MavResult, MavSeverity};
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::prelude::*;
use mavstack_traffic::{Aircraft, FORGOTTEN_AFTER, Position, Traffic, TrafficHooks};

const STATION: Address = Address::new(255, 190);
const RECEIVER: Address = Address::new(1, 156);
const HERE: Position = Position { lat: 470_000_000, lon: 80_000_000, altitude: 500_000 };

#[derive(Default)]
struct Drone {
    found: Vec<u32>,
    lost: Vec<u32>,
}

impl Vehicle for Drone {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Drone {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl TrafficHooks for Drone {
    fn position(&self) -> Option<Position> {
        Some(HERE)
    }

    fn aircraft_found(&mut self, cx: &mut Context<'_>, aircraft: &Aircraft) {
        self.found.push(aircraft.report.ICAO_address);
        cx.text(MavSeverity::NOTICE, "Aircraft near");
    }

    fn aircraft_lost(&mut self, _: &mut Context<'_>, aircraft: &Aircraft) {
        self.lost.push(aircraft.report.ICAO_address);
    }
}

#[derive(Stack)]
#[stack(vehicle: Drone, links: 2)]
struct Mavlink {
    traffic: Traffic<3>,
}

struct World {
    stack: StackOf<Mavlink>,
    drone: Drone,
    pulse: &'static Pulse,
    now: Instant,
    seq: u8,
}

impl World {
    fn new() -> Self {
        let pulse = Box::leak(Box::new(Pulse::new()));
        let stack = StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), pulse), [LinkConfig::unlimited(); 2]);
        let mut world = Self { stack, drone: Drone::default(), pulse, now: Instant::from_millis(1_000), seq: 0 };
        world.run(Duration::from_millis(20));
        world
    }

    fn receive<M: Message>(&mut self, link: LinkId, from: Address, message: &M) {
        let mut frame = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, from, self.seq, &mut frame).expect("every message fits");
        self.seq = self.seq.wrapping_add(1);
        self.stack.receive(self.now, link, &frame[..len], &mut self.drone);
    }

    /// Lets time pass, and returns the payloads of the messages `M` that a link sends.
    fn sent<M: Message>(&mut self, link: LinkId, time: Duration) -> Vec<M> {
        let mut sent = Vec::new();
        let end = self.now + time;
        while self.now < end {
            self.pulse.tick();
            self.stack.poll(self.now, &mut self.drone);
            for at in [LinkId(0), LinkId(1)] {
                let bytes = self.stack.transmit(self.now, at, &mut self.drone).to_vec();
                if let (true, [0xFD, len, _, _, _, _, _, a, b, c, rest @ ..]) = (at == link, &bytes[..])
                    && u32::from_le_bytes([*a, *b, *c, 0]) == M::ID
                {
                    sent.push(M::decode(&rest[..usize::from(*len)]));
                }
                self.stack.transmitted(at, bytes.len());
            }
            self.now += Duration::from_millis(10);
        }
        sent
    }

    fn run(&mut self, time: Duration) {
        self.sent::<CommandAck>(LinkId(0), time);
    }

    /// An aircraft `north` m to the north.
    fn report(&mut self, address: u32, north: i32) {
        let report = AdsbVehicle {
            ICAO_address: address,
            lat: HERE.lat + north * 90,
            lon: HERE.lon,
            altitude: HERE.altitude,
            flags: AdsbFlags::VALID_COORDS,
            ..AdsbVehicle::UNKNOWN
        };
        self.receive(LinkId(1), RECEIVER, &report);
    }

    fn ask(&mut self, link: LinkId) {
        let param1 = AdsbVehicle::ID as f32;
        let request = CommandLong {
            command: MavCmd::REQUEST_MESSAGE,
            param1,
            target_system: 1,
            target_component: 1,
            ..Default::default()
        };
        self.receive(link, STATION, &request);
    }
}

#[test]
fn the_nearest_are_kept() {
    let mut world = World::new();
    for (address, north) in [(1, 4_000), (2, 3_000), (3, 2_000), (4, 9_000), (5, 1_000)] {
        world.report(address, north);
    }
    assert_eq!((&world.drone.found[..], &world.drone.lost[..]), (&[1, 2, 3, 5][..], &[1][..]));
    let mut known: Vec<_> = world.stack.traffic.aircraft().map(|known| known.report.ICAO_address).collect();
    known.sort_unstable();
    assert_eq!(known, [2, 3, 5]);
    assert_eq!(world.stack.traffic.nearest().map(|nearest| nearest.report.ICAO_address), Some(5));
    assert!(world.stack.traffic.nearest().is_some_and(|nearest| nearest.distance.abs_diff(1_000) < 10));
    let counters = world.stack.traffic.counters();
    assert_eq!((counters.too_far, counters.evicted), (1, 1));
}

#[test]
fn a_known_aircraft_is_updated() {
    let mut world = World::new();
    world.report(1, 4_000);
    world.report(1, 2_000);
    assert_eq!(world.drone.found, [1]);
    assert!(world.stack.traffic.nearest().is_some_and(|nearest| nearest.distance.abs_diff(2_000) < 20));
}

#[test]
fn an_aircraft_without_an_address_is_counted() {
    let mut world = World::new();
    world.report(0, 100);
    assert!(world.stack.traffic.nearest().is_none());
    assert_eq!(world.stack.traffic.counters().without_address, 1);
}

#[test]
fn a_silent_aircraft_is_forgotten() {
    let mut world = World::new();
    world.report(1, 100);
    let forgotten = world.now + FORGOTTEN_AFTER;
    while world.now < forgotten {
        assert!(world.stack.next_deadline(world.now) <= forgotten);
        assert!(world.drone.lost.is_empty());
        world.run(Duration::from_millis(10));
    }
    world.run(Duration::from_millis(10));
    assert_eq!(world.drone.lost, [1]);
    assert!(world.stack.traffic.nearest().is_none());
}

/// the answer is sent on the link on which the request was received.
#[test]
fn who_asks_gets_all() {
    let mut world = World::new();
    world.report(7, 100);
    world.report(8, 200);
    world.run(Duration::from_secs(3));
    world.ask(LinkId(0));
    assert_eq!(world.stack.next_deadline(world.now), world.now);
    let sent = world.sent::<AdsbVehicle>(LinkId(0), Duration::from_secs(1));
    let addresses: Vec<_> = sent.iter().map(|report| report.ICAO_address).collect();
    assert_eq!(addresses, [7, 8]);
    assert!(sent.iter().all(|report| report.tslc == 3), "s since they were heard");
    world.ask(LinkId(1));
    assert_eq!(world.sent::<AdsbVehicle>(LinkId(0), Duration::from_secs(1)).len(), 0);
}

#[test]
fn what_was_asked_before_a_link_is_opened_again_is_not_sent() {
    let mut world = World::new();
    world.report(7, 100);
    world.ask(LinkId(0));
    world.stack.restart_link(LinkId(0));
    assert_eq!(world.sent::<AdsbVehicle>(LinkId(0), Duration::from_secs(1)).len(), 0);
}

#[test]
fn a_table_may_have_255_places() {
    #[derive(Stack)]
    #[stack(vehicle: Drone, links: 1)]
    struct Large {
        traffic: Traffic<255>,
    }
    let pulse = Box::leak(Box::new(Pulse::new()));
    let mut stack = Box::new(StackOf::<Large>::new(Config::new(Address::new(1, 1), pulse), [LinkConfig::unlimited()]));
    stack.poll(Instant::from_millis(1_000), &mut Drone::default());
    assert!(stack.traffic.nearest().is_none());
}

#[test]
fn without_aircraft_a_request_is_denied() {
    let mut world = World::new();
    world.ask(LinkId(0));
    let acks = world.sent::<CommandAck>(LinkId(0), Duration::from_secs(1));
    assert_eq!(acks.iter().map(|ack| ack.result).collect::<Vec<_>>(), [MavResult::DENIED]);
}
