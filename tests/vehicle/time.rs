//! PING, TIMESYNC and SYSTEM_TIME: rules T-1 to T-4.

use crate::support::*;
use mavstack::__private::NoPlans;
use mavstack::clock::WallClock;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::{Address, Duration, Instant, LinkConfig, LinkId, Peer};
use proptest::prelude::*;

const LINK: LinkId = LinkId(0);

/// A world whose vehicle declares the service.
type Clocked<const N: usize> = World<N, Tested<NoPlans, 8, Timed>>;

/// A world whose peer is `delay` away in each direction; it starts some time after boot.
fn world<const N: usize>(delay: Duration) -> Clocked<N> {
    let lines = [LineConfig::both(Wire { latency: delay, ..Wire::default() }); N];
    let mut world = Clocked::of(Setup { lines, start: Instant::from_millis(5_000_000), ..Setup::new() });
    world.run_for(millis(2));
    world
}

/// T-1: a PING to everyone is returned unchanged to its sender, on its link.
#[test]
fn ping_is_answered() {
    let mut world = world::<2>(millis(0));
    let ping = Ping { time_usec: 0x0102_0304_0506_0708, seq: 77, ..Ping::default() };
    world.gcs[1].send_from(OTHER_STATION, &ping);
    let pong: Ping = world.expect(1, millis(10));
    assert_eq!(pong, Ping { target_system: 254, target_component: 190, ..ping });
    world.expect_no::<Ping>(0, secs(1));
    world.expect_no::<Ping>(1, millis(1));
    assert_eq!(world.vehicle.calls, [], "the vehicle does not see it");
}

/// T-1: a PING with a target is an answer, and is not answered.
#[test]
fn answer_to_a_ping_is_not_answered() {
    let mut world = world::<1>(millis(0));
    for (target_system, target_component) in [(1, 1), (1, 0), (0, 1), (255, 190), (2, 1)] {
        world.gcs[0].send(&Ping { seq: 5, target_system, target_component, ..Ping::default() });
    }
    world.expect_no::<Ping>(0, secs(1));
}

/// T-2: a request gets our time since boot and its own time back, whatever the peer's clock reads.
#[test]
fn timesync_is_answered() {
    let mut world = world::<2>(millis(0));
    for ts1 in [1, -1, 0, i64::MIN, i64::MAX, 123_456_789_012] {
        for (target_system, target_component) in [(0, 0), (1, 1), (1, 0)] {
            let before = world.now();
            world.gcs[0].send(&Timesync { tc1: 0, ts1, target_system, target_component });
            let answer: Timesync = world.expect(0, millis(10));
            assert_eq!((answer.ts1, answer.target_system, answer.target_component), (ts1, 255, 190));
            let (first, last) = (before.as_micros() * 1_000, world.now().as_micros() * 1_000);
            assert!((first as i64..=last as i64).contains(&answer.tc1), "{} ns", answer.tc1);
        }
    }
    world.expect_no::<Timesync>(1, millis(10));
}

/// T-2: requests to other systems, and answers, are not answered.
#[test]
fn timesync_of_others_is_ignored() {
    let mut world = world::<1>(millis(0));
    for (target_system, target_component) in [(2, 1), (1, 2), (255, 190)] {
        world.gcs[0].send(&Timesync { tc1: 0, ts1: 5, target_system, target_component });
    }
    for tc1 in [1, -1, i64::MAX] {
        for ts1 in [5, 0] {
            world.gcs[0].send(&Timesync { tc1, ts1, ..Timesync::default() });
        }
    }
    world.expect_no::<Timesync>(0, secs(1));
    assert_eq!(world.stack.time.take_sample(), None);
}

/// T-2: an answer that is sent at time 0 is not a request.
#[test]
fn answer_at_boot_is_not_a_request() {
    let setup = Setup::<1>::new();
    let mut world = Clocked::of(Setup { step: Duration::from_micros(0), ..setup });
    world.gcs[0].send(&Timesync { tc1: 0, ts1: 5, ..Timesync::default() });
    for _ in 0..5 {
        world.step();
    }
    assert_eq!(world.now(), Instant::ZERO);
    assert_eq!(world.gcs[0].take::<Timesync>().unwrap().1.tc1, 1);
}

/// T-2: our own request, and its result: only of the matching answer, and once.
#[test]
fn vehicle_can_request_the_time() {
    let mut world = world::<2>(millis(20));
    world.stack.time.ask(LinkId(1));
    world.stack.time.ask(LinkId(7));
    let question: Timesync = world.expect(1, millis(100));
    assert_eq!((question.tc1, question.target_system, question.target_component), (0, 0, 0));
    world.expect_no::<Timesync>(0, millis(1));
    // The peer's clock is three seconds slow.
    let his = question.ts1 + 21_000_000 - 3_000_000_000;
    let answer = Timesync { tc1: his, ts1: question.ts1, target_system: 1, target_component: 1 };
    world.gcs[1].send(&Timesync { ts1: question.ts1 + 1, ..answer });
    world.gcs[0].send(&answer);
    world.gcs[1].send(&Timesync { target_system: 9, ..answer });
    world.run_for(millis(50));
    assert_eq!(world.stack.time.take_sample(), None);
    let (asked, answered) = (question.ts1 / 1_000, world.now());
    world.gcs[1].send(&answer);
    world.run_for(millis(50));
    let sample = world.stack.time.take_sample().unwrap();
    assert_eq!(sample.from, Peer { address: STATION, link: LinkId(1) });
    assert!(sample.at > answered && sample.at <= world.now());
    let round_trip = sample.at.as_micros() - asked as u64;
    assert_eq!(sample.round_trip_ns, round_trip as i64 * 1_000);
    assert_eq!(sample.offset_ns, his - (question.ts1 + round_trip as i64 * 500));
    assert_eq!(world.stack.time.take_sample(), None);
    world.expect_no::<Timesync>(1, secs(2));
}

/// T-2: a stranger on the same radio answers first, 20 times of 20: none of the station's answers was taken, now all are. The stranger's
/// are taken once the station has been silent for ten seconds.
#[test]
fn a_stranger_displaces_no_answers() {
    let mut world = world::<1>(millis(0));
    let mut ask = |from: &[Address]| {
        world.stack.time.ask(LINK);
        let question: Timesync = world.expect(0, millis(100));
        for from in from {
            let answer = Timesync { tc1: 7, ts1: question.ts1, target_system: 1, target_component: 1 };
            world.gcs[0].send_from(*from, &answer);
            world.run_for(millis(20));
        }
        world.run_for(millis(500));
        world.stack.time.take_sample().map(|sample| sample.from.address)
    };
    assert_eq!(ask(&[STATION]), Some(STATION));
    for round in 0..20 {
        assert_eq!(ask(&[OTHER_STATION, STATION]), Some(STATION), "round {round}");
    }
    let answered: Vec<_> = (0..30).map(|_| ask(&[OTHER_STATION])).collect();
    let first = answered.iter().position(Option::is_some).expect("it is taken at last");
    assert!((15..25).contains(&first) && answered[first] == Some(OTHER_STATION), "{answered:?}");
}

/// T-3: a high-latency link carries no time messages.
#[test]
fn high_latency_link_carries_no_time() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = Clocked::of(Setup { links: [satellite], ..Setup::new() });
    world.stack.time.ask(LINK);
    world.gcs[0].send(&Ping::default());
    world.gcs[0].send(&Timesync::default());
    world.run_for(secs(3));
    assert_eq!(world.gcs[0].received, []);
    assert_eq!(world.stack.link_counters(LINK).unwrap().out_of_place, 2);
}

/// Without the service, the vehicle gets the messages.
#[test]
fn without_the_service_the_vehicle_gets_the_messages() {
    let mut world = World::new(Setup::<1>::new());
    world.gcs[0].send(&Ping::default());
    world.gcs[0].send(&Timesync::default());
    world.run_for(secs(1));
    let is_message = |call: &Call| matches!(call, Call::Message { id: 4 | 111, .. });
    assert_eq!(world.vehicle.calls.iter().filter(|call| is_message(call)).count(), 2);
    assert_eq!(world.gcs[0].count_of::<Ping>() + world.gcs[0].count_of::<Timesync>(), 0);
}

/// T-4, D-1: SYSTEM_TIME carries the time since boot, and the wall clock once it is known, both at the time of sending. The
/// first wraps, the second does not.
#[test]
fn system_time_carries_the_wall_clock_once_known() {
    const NOON: u64 = 1_767_268_800_000_000;
    // Ten seconds before the 32-bit milliseconds wrap.
    let start = Instant::from_millis((1 << 32) - 10_000);
    let mut world = World::new(Setup::<1> { start, ..Setup::new() });
    world.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, [2.0, 1e6, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.run_for(secs(5));
    // The receiver does not know the time either.
    world.vehicle.clock.set(world.now(), 0);
    world.run_for(millis(500));
    let set = world.now();
    world.vehicle.clock.set(set, NOON);
    world.run_for(secs(15));
    let times = world.gcs[0].all::<SystemTime>();
    assert!((20..=21).contains(&times.len()), "{} in 20.5 s", times.len());
    for (at, time) in times {
        let (unix, boot) = (time.time_unix_usec, u64::from(time.time_boot_ms));
        assert_eq!(boot, at.as_millis() % (1 << 32));
        assert_eq!(unix, if at > set { NOON + (at - set).as_micros() } else { 0 });
    }
    // The clock is set again, and back.
    world.vehicle.clock.set(world.now(), 1);
    assert_eq!(world.vehicle.clock.unix_usec(world.now() + millis(3)), Some(3_001));
    assert_eq!(WallClock::new().unix_usec(world.now()), None);
}

proptest! {
    #![proptest_config(cases(64))]

    /// T-1, T-2: on a link with or without backpressure, each accepted request is answered once, by a message that is not a
    /// request, and each other request is counted.
    #[test]
    fn every_request_is_answered_or_counted(
        frames in prop::collection::vec((any::<bool>(), any::<bool>(), any::<bool>(), 0u64..30), 1..60),
        stall in 0u64..600,
    ) {
        let mut world = world::<1>(millis(0));
        world.uarts[0].stall_writes_until(world.now() + millis(stall));
        let (mut questions, mut number) = (0, 0);
        for (is_ping, is_question, other, wait) in frames {
            number += 1;
            let from = if other { OTHER_STATION } else { STATION };
            let target: Address = if is_question { Address::new(0, 0) } else { VEHICLE };
            let (target_system, target_component) = (target.system.wire(), target.component.wire());
            if is_ping {
                world.gcs[0].send_from(from, &Ping { time_usec: 0, seq: number, target_system, target_component });
            } else {
                let tc1 = i64::from(!is_question);
                world.gcs[0].send_from(from, &Timesync { tc1, ts1: number.into(), target_system, target_component });
            }
            questions += u32::from(is_question);
            world.run_for(millis(wait));
        }
        world.run_for(secs(1));
        let gcs = &world.gcs[0];
        let pings = gcs.all::<Ping>();
        let syncs = gcs.all::<Timesync>();
        prop_assert!(pings.iter().all(|(_, ping)| ping.target_system != 0));
        prop_assert!(syncs.iter().all(|(_, sync)| sync.tc1 != 0 && sync.target_system != 0));
        let mut numbers: Vec<_> = pings.iter().map(|(_, ping)| i64::from(ping.seq)).collect();
        numbers.extend(syncs.iter().map(|(_, sync)| sync.ts1));
        numbers.sort_unstable();
        numbers.dedup();
        prop_assert_eq!(numbers.len(), pings.len() + syncs.len(), "none is repeated");
        let dropped = world.stack.link_counters(LINK).unwrap().no_answer_slot;
        prop_assert_eq!(numbers.len() as u32 + dropped, questions);
        prop_assert!(questions == 0 || !numbers.is_empty());
    }
}
