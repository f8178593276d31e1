//! What looks healthy is healthy: a stack that was not begun is silent, and one whose `poll` is forgotten stops its heartbeats.
//! Rules H-17, H-18.

use crate::support::*;
use mavstack::dialect::*;
use mavstack::io::{DatagramSocket, UdpLinks};
use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::network::LinkError;
use mavstack::{
    Command, CommandRule, Commands, Context, FlightMode, Frame, Instant, Item, LinkId, ModeRequest, Modes, Outcome,
    Parameters, PeerEvent, PlanChange, PlanType, Plans, Progress, StackOf, Stream, Telemetry, Vehicle, VehicleState,
};

const LINK: LinkId = LinkId(0);

/// A vehicle none of whose hooks may be called.
struct Untouched;

impl Vehicle for Untouched {
    fn state(&self) -> Option<VehicleState> {
        panic!("a hook was called")
    }

    fn peer(&mut self, _: &mut Context<'_>, _: PeerEvent) {
        panic!("a hook was called")
    }

    fn message(&mut self, _: &mut Context<'_>, _: &Frame<'_>, _: LinkId) -> bool {
        panic!("a hook was called")
    }
}

impl Commands for Untouched {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        panic!("a hook was called")
    }
}

impl Modes for Untouched {
    const MODES: &'static [FlightMode] = &[FlightMode::new(4, "Hold")];

    fn set_mode(&mut self, _: &mut Context<'_>, _: &'static FlightMode, _: &ModeRequest) -> Outcome {
        panic!("a hook was called")
    }
}

impl Telemetry for Untouched {
    const STREAMS: &'static [Stream] = &[Stream::of::<Attitude>().every(millis(100))];

    fn fill(&mut self, _: u32, _: &mut mavstack::Fill<'_>) -> bool {
        panic!("a hook was called")
    }
}

impl Plans for Untouched {
    const MISSION_COMMANDS: &'static [CommandRule] = &[rules::NAV_WAYPOINT];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {
        panic!("a hook was called")
    }

    fn progress(&self) -> Progress {
        panic!("a hook was called")
    }
}

mavstack::parameters! {
    struct Tuning { SPEED: f32 = 1.0, 0.0..=2.0, "m/s"; }
}

impl Parameters for Untouched {
    type Table = Tuning;
}

mavstack::events! {
    struct OurEvents in "untouched" {
        events { Turned(Info) {} = "Turned"; }
    }
}

#[derive(mavstack::Stack)]
#[stack(
    vehicle: Untouched,
    links: 1,
    plans: { mission: 8 },
    parameters: Tuning,
    streams,
    modes,
    events: { history: 8 },
    operator_control,
    manual_control,
)]
struct Vacant {
    time: mavstack::clock::Time,
}

/// A socket whose datagrams must not be taken.
struct Full;

impl DatagramSocket for Full {
    type Endpoint = u8;

    fn receive(&mut self, _: &mut [u8]) -> Option<(usize, u8)> {
        panic!("a datagram was taken")
    }

    fn is_ready(&mut self) -> bool {
        true
    }

    fn send(&mut self, _: &[u8], _: u8) -> bool {
        panic!("a datagram was sent")
    }
}

/// H-18: a stack that was not begun takes and sends nothing, by any entry point, and calls no hook. A driver that sleeps is not
/// woken.
#[test]
fn stack_that_was_not_begun_takes_and_sends_nothing() {
    let mut stack = Box::new(StackOf::<Vacant>::VACANT);
    let mut vehicle = Untouched;
    let (mut uart, ground) = Line::new(&Clock::default(), LineConfig::default(), 1).ends();
    let mut gcs = Gcs::new(ground);
    let (target_system, target_component) = (1, 1);
    let mut udp: UdpLinks<u8, 1> = UdpLinks::new([LINK]);
    udp.set_broadcast(Some(7));
    for ms in (0..6_000).step_by(10) {
        let now = Instant::from_millis(ms);
        let frames = [
            gcs.frame_from(STATION, &Gcs::heartbeat()),
            gcs.frame_from(STATION, &MissionCount { count: 3, target_system, target_component, ..Default::default() }),
            gcs.frame_from(STATION, &MissionCount { count: 3, ..Default::default() }),
            gcs.frame_from(STATION, &gcs.long(MavCmd::NAV_LAND, [0.0; 7])),
            gcs.frame_from(STATION, &Ping::default()),
        ]
        .concat();
        gcs.send_raw(&frames);
        gcs.poll(now);
        let waiting = uart.readable();
        stack.text(now, MavSeverity::CRITICAL, "Hello");
        stack.event(now, &Turned {});
        stack.announce::<Attitude>();
        stack.time.ask(LINK);
        stack.mission_item_reached(now, 1);
        assert!(stack.load_plan(now, PlanType::Mission, [Item::default()], &mut vehicle).is_err());
        stack.poll(now, &mut vehicle);
        assert_eq!(stack.poll_link(now, LINK, &mut uart, &mut vehicle), Err(LinkError::NotBegun));
        stack.poll_udp(now, &mut udp, &mut Full, &mut vehicle);
        assert_eq!(stack.receive(now, LINK, &frames, &mut vehicle), 0);
        assert_eq!(stack.receiver(now, LINK, &mut vehicle)(&frames), 0);
        assert!(stack.receive_buffer(LINK).is_empty());
        stack.received(now, LINK, frames.len(), &mut vehicle);
        assert_eq!(stack.transmit(now, LINK, &mut vehicle), [0_u8; 0]);
        stack.transmitted(LINK, 20);
        stack.restart_link(LINK);
        assert!(!stack.has_ground_station(now) && stack.operator(now).is_none() && stack.mission().items().is_empty());
        assert_eq!((stack.next_deadline(now), stack.link_deadline(now, LINK)), (Instant::NEVER, Instant::NEVER));
        assert_eq!((uart.readable(), uart.written()), (waiting, 0), "{ms} ms");
    }
    assert_eq!(stack.peers(Instant::from_millis(6_000)).count(), 0);
    assert_eq!(stack.link_counters(LINK).map(|counters| (counters.tx_frames, counters.tx_bytes)), Some((0, 0)));
}

fn heartbeats(world: &World<1>) -> usize {
    world.gcs[0].count_of::<Heartbeat>()
}

/// H-18: while `poll` is forgotten no heartbeat is sent, and what the firmware asks about the ground station is judged when it
/// asks. Answers go on. The next poll brings the heartbeats back.
#[test]
fn forgotten_poll_stops_the_heartbeats_and_keeps_no_station_alive() {
    let mut world = World::new(Setup::<1>::new());
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.run_for(millis(5_300));
    assert!(world.stack.has_ground_station(world.now()));
    world.gcs[0].heartbeat_period = None;
    let last = world.stack.peers(world.now()).find_map(|info| info.last_heartbeat()).expect("a station");
    let (polled, before) = (world.now(), heartbeats(&world));
    for _ in 0..20_000 {
        let now = world.now() + millis(1);
        world.clock.set(now);
        world.pulse.tick();
        world.stack.poll_link(now, LINK, &mut world.uarts[0], &mut world.vehicle).unwrap();
        world.gcs[0].poll(now);
        let is_alive = now - last < secs(5);
        assert_eq!(world.stack.has_ground_station(now), is_alive, "{now:?}");
        assert_eq!(world.stack.has_controller(now, ControlSource::System(SystemId::new(255))), is_alive);
        assert_eq!(world.stack.peers(now).filter(|info| info.is_alive).count(), usize::from(is_alive));
        assert_eq!(world.stack.peers(now).filter(|info| info.is_living_station()).count(), usize::from(is_alive));
        let is_due = world.stack.next_deadline(now) == now;
        assert!(is_due || now - polled < millis(500), "it must be polled");
    }
    assert_eq!(heartbeats(&world), before, "the next was due 700 ms after the last poll");
    let now = world.now();
    world.gcs[0].command_long(MavCmd::NAV_LAND, [0.0; 7]);
    world.gcs[0].poll(now);
    world.stack.poll_link(now, LINK, &mut world.uarts[0], &mut world.vehicle).unwrap();
    world.gcs[0].poll(now);
    assert_eq!((world.gcs[0].count_of::<CommandAck>(), heartbeats(&world)), (1, before));
    world.step();
    assert_eq!(heartbeats(&world), before + 1, "at once");
    world.run_for(millis(3_500));
    assert_eq!(heartbeats(&world), before + 4);
}

/// H-18: a heartbeat that is due is sent up to `max_loop_gap` after the last poll, and not later.
#[test]
fn heartbeat_needs_a_recent_poll() {
    for (late, is_sent) in [(0, true), (499, true), (500, true), (501, false), (5_000, false)] {
        let mut world = World::new(Setup::<1>::new());
        world.run_for(millis(2_600));
        // The next heartbeat is due at 3,000 ms.
        let polled = Instant::from_millis(3_000);
        world.clock.set(polled);
        world.pulse.tick();
        world.stack.poll(polled, &mut world.vehicle);
        let now = polled + millis(late);
        world.clock.set(now);
        world.pulse.tick();
        let before = world.stack.link_counters(LINK).unwrap().tx_frames;
        world.stack.poll_link(now, LINK, &mut world.uarts[0], &mut world.vehicle).unwrap();
        assert_eq!(world.stack.link_counters(LINK).unwrap().tx_frames - before, u32::from(is_sent), "{late} ms");
        // A firmware that was stopped, by an erase for example, sends it in its next pass.
        world.run_for(millis(5));
        assert_eq!(world.stack.link_counters(LINK).unwrap().tx_frames - before, 1, "{late} ms");
    }
}

/// H-18: a firmware that sleeps until `next_deadline` keeps its heartbeats, and sleeps no longer than `max_loop_gap`.
#[test]
fn sleeping_firmware_keeps_its_heartbeats() {
    let mut world = World::new(Setup::<1>::new());
    let mut passes = 0;
    while world.now() < Instant::from_millis(60_500) {
        let now = world.now();
        let due = world.stack.next_deadline(now);
        assert!(due <= now + millis(500), "{due:?} at {now:?}");
        world.step_to(due.max(now + millis(1)));
        passes += 1;
    }
    assert_eq!(heartbeats(&world), 61);
    assert!(passes < 400, "{passes} passes in a minute");
}

/// H-18, O-5: the system in control is judged when the firmware asks, too.
#[test]
fn operator_is_judged_at_the_call() {
    let mut stack: Box<StackOf<Controlled>> = Box::new(StackOf::<Controlled>::VACANT);
    let pulse: &mavstack::Pulse = Box::leak(Box::new(mavstack::Pulse::new()));
    stack.begin(mavstack::Config::new(VEHICLE, pulse), [mavstack::LinkConfig::uart(57_600)]);
    let (mut vehicle, mut gcs) = (TestVehicle::new(), World::new(Setup::<1>::new()).gcs.remove(0));
    let now = Instant::from_millis(1_000);
    stack.poll(now, &mut vehicle);
    let request = gcs.long(MavCmd(32_100), [1.0, 0.0, 10.0, 255.0, 0.0, 0.0, 0.0]);
    for frame in [gcs.frame_from(STATION, &Gcs::heartbeat()), gcs.frame_from(STATION, &request)] {
        assert_eq!(stack.receive(now, LINK, &frame, &mut vehicle), frame.len());
    }
    let owner = Some(SystemId::new(255));
    for (after, expected) in [(0, owner), (4_999, owner), (5_000, None), (60_000, None)] {
        let now = now + millis(after);
        assert_eq!((stack.operator(now), stack.allows_takeover(now)), (expected, expected.is_none()), "{after} ms");
    }
    stack.operator_control_mut().set_release_on_loss(false);
    assert_eq!(stack.operator(now + secs(60)), owner, "control is kept");
}

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 1, commands: { slots: 2 }, operator_control)]
struct Controlled;
