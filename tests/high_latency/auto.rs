//! The high-latency link that switches itself on: L-14, what stops it, and the most that it can cost.

use crate::support::*;
use crate::{World, run, satellite};
use mavstack::config::LinkClass;
use mavstack::dialect::{CommandAck, Heartbeat, HighLatency2, MavCmd, MavResult, MavType};
use mavstack::high_latency::{HighLatencyConfig, HighLatencySample};
use mavstack::{Address, Duration, LinkConfig};
use proptest::prelude::*;

const TELEM: usize = 0;
const SAT: usize = 1;
const PERIOD: Duration = secs(20);
const CONFIG: HighLatencyConfig =
    HighLatencyConfig { period: PERIOD, on_link_loss_after: Some(secs(3)), ..HighLatencyConfig::DEFAULT };

/// A telemetry radio with a ground station, and a satellite modem.
fn world(config: HighLatencyConfig) -> World<2> {
    let links = [LinkConfig::uart(57_600), LinkConfig::uart(9_600).with_class(LinkClass::HighLatency)];
    let mut world = World::of(Setup { links, ..Setup::new() });
    world.stack.high_latency.set_config(config);
    world.gcs[TELEM].heartbeat_period = Some(secs(1));
    world
}

/// Returns the number of HIGH_LATENCY2 received since the last call.
fn count(world: &mut World<2>) -> usize {
    std::iter::from_fn(|| world.gcs[SAT].take::<HighLatency2>()).count()
}

fn control(world: &mut World<2>, link: usize, enable: f32) {
    world.gcs[link].command_long(MavCmd::CONTROL_HIGH_LATENCY, [enable, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(world.expect::<CommandAck>(link, millis(100)).result, MavResult::ACCEPTED);
}

fn lose(world: &mut World<2>) {
    world.gcs[TELEM].heartbeat_period = None;
}

fn regain(world: &mut World<2>) {
    world.gcs[TELEM].heartbeat_period = Some(secs(1));
}

/// L-14: when the last ground station on a normal link is lost, messages start after the configured time. When a ground station
/// reconnects, they stop.
#[test]
fn link_loss_switches_it_on_and_reconnection_off() {
    let mut world = world(CONFIG);
    run(&mut world, secs(30));
    lose(&mut world);
    // The peer times out five seconds after its last heartbeat; the delay is three more.
    run(&mut world, secs(6));
    assert_eq!(count(&mut world), 0);
    run(&mut world, secs(3));
    assert_eq!((count(&mut world), satellite(&mut world).is_on_by_itself()), (1, true));
    run(&mut world, secs(40));
    assert_eq!(count(&mut world), 2);
    regain(&mut world);
    run(&mut world, secs(60));
    assert_eq!((count(&mut world), satellite(&mut world).is_on()), (0, false));
}

/// L-14, L-16: a duplicate START does not make an automatic start permanent, and its answer does not say so. A second START
/// does.
#[test]
fn duplicate_start_does_not_make_it_permanent() {
    let answer = |world: &mut World<2>| {
        let start = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        world.gcs[SAT].command_long(MavCmd::CONTROL_HIGH_LATENCY, start);
        world.expect::<CommandAck>(SAT, millis(100)).result
    };
    for again in [false, true] {
        let mut world = world(CONFIG);
        run(&mut world, secs(5));
        control(&mut world, TELEM, 1.0);
        control(&mut world, TELEM, 0.0);
        lose(&mut world);
        run(&mut world, secs(15));
        assert!(satellite(&mut world).is_on_by_itself());
        assert_eq!(answer(&mut world), MavResult::TEMPORARILY_REJECTED);
        if again {
            assert_eq!(answer(&mut world), MavResult::ACCEPTED);
        }
        regain(&mut world);
        run(&mut world, secs(5));
        assert_eq!(satellite(&mut world).is_on(), again);
    }
}

/// L-14: it also starts if the driver sleeps until `next_deadline` and the radio is backpressured.
#[test]
fn link_loss_wakes_a_sleeping_driver() {
    let mut world = world(CONFIG);
    run(&mut world, secs(30));
    lose(&mut world);
    let end = world.now() + secs(12);
    world.uarts[TELEM].stall_writes_until(end);
    while !satellite(&mut world).is_on() {
        let now = world.now();
        let next = world.stack.next_deadline(now).min(world.uarts[TELEM].next_arrival()).max(now + millis(1));
        assert!(next < end, "asleep since {now:?}, until {next:?}");
        world.step_to(next);
    }
}

/// It does not start without the option, before any ground station was heard, when another kind of peer is lost, or when the
/// ground station reconnects before the delay is over.
#[test]
fn it_stays_off_without_a_lost_ground_station() {
    let mut world = world(HighLatencyConfig { on_link_loss_after: None, ..CONFIG });
    run(&mut world, secs(5));
    lose(&mut world);
    run(&mut world, secs(60));
    assert!(!satellite(&mut world).is_on(), "the option is off");

    let mut world = self::world(CONFIG);
    lose(&mut world);
    run(&mut world, secs(60));
    let companion = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..Gcs::heartbeat() };
    world.gcs[TELEM].send_from(Address::new(1, 191), &companion);
    world.gcs[SAT].send(&Gcs::heartbeat());
    run(&mut world, secs(60));
    assert!(!satellite(&mut world).is_on(), "no ground station on a normal link was lost");

    regain(&mut world);
    run(&mut world, secs(5));
    for _ in 0..5 {
        lose(&mut world);
        run(&mut world, millis(6_500));
        regain(&mut world);
        run(&mut world, secs(2));
    }
    assert_eq!((satellite(&mut world).is_on(), count(&mut world)), (false, 0), "short losses");
}

/// A START while it is on by itself makes it permanent: only a STOP ends it. After a STOP it stays off until the next loss.
#[test]
fn commands_override_the_automatic_start() {
    let mut world = world(CONFIG);
    run(&mut world, secs(5));
    lose(&mut world);
    run(&mut world, secs(10));
    assert!(satellite(&mut world).is_on_by_itself());
    control(&mut world, SAT, 1.0);
    assert!(satellite(&mut world).is_on() && !satellite(&mut world).is_on_by_itself());
    regain(&mut world);
    run(&mut world, secs(30));
    assert!(satellite(&mut world).is_on(), "commanded");
    lose(&mut world);
    run(&mut world, secs(30));
    control(&mut world, SAT, 0.0);
    run(&mut world, secs(60));
    assert!(!satellite(&mut world).is_on(), "stopped, and not lost again since");
    regain(&mut world);
    run(&mut world, secs(5));
    lose(&mut world);
    run(&mut world, secs(10));
    assert!(satellite(&mut world).is_on_by_itself());
}

/// Whatever the radio does, at most one message is sent per period.
#[test]
fn intermittent_radio_costs_one_message_per_period() {
    let mut world = world(HighLatencyConfig { on_link_loss_after: Some(Duration::ZERO), ..CONFIG });
    run(&mut world, secs(5));
    let mut rng = crate::support::Rng::new(3);
    let begin = world.now();
    while world.now() - begin < secs(1_000) {
        lose(&mut world);
        run(&mut world, millis(5_200 + rng.below(3_000)));
        regain(&mut world);
        run(&mut world, millis(1_000 + rng.below(500)));
    }
    let sent: Vec<_> = std::iter::from_fn(|| world.gcs[SAT].take::<HighLatency2>()).map(|(at, _)| at).collect();
    assert!(sent.len() >= 10, "{}", sent.len());
    assert!(sent.windows(2).all(|pair| pair[1] - pair[0] >= PERIOD), "{sent:?}");
}

/// L-14: one message is sent after the start, once there is a sample to report, and no other.
#[test]
fn it_is_announced_once() {
    let mut world = world(HighLatencyConfig { announce_once: true, ..CONFIG });
    run(&mut world, secs(30));
    assert_eq!(count(&mut world), 0, "no sample yet");
    let now = world.now();
    satellite(&mut world).sample(now, &HighLatencySample { altitude: 500.0, ..HighLatencySample::UNKNOWN });
    run(&mut world, secs(60));
    let (_, told) = world.gcs[SAT].take::<HighLatency2>().expect("one");
    assert_eq!((told.altitude, count(&mut world), satellite(&mut world).is_on()), (500, 0, false));
    control(&mut world, SAT, 1.0);
    run(&mut world, secs(30));
    assert_eq!(count(&mut world), 2);
}

/// A STOP before the modem is ready cancels the announcement.
#[test]
fn announcement_can_be_cancelled() {
    let mut world = world(HighLatencyConfig { announce_once: true, ..CONFIG });
    let until = world.now() + secs(10);
    world.uarts[SAT].stall_writes_until(until);
    let now = world.now();
    satellite(&mut world).sample(now, &HighLatencySample::UNKNOWN);
    run(&mut world, secs(5));
    control(&mut world, TELEM, 0.0);
    run(&mut world, secs(60));
    assert_eq!(count(&mut world), 0);
}

/// A step of the property.
#[derive(Clone, Debug)]
enum Step {
    Run(u64),
    Start(usize),
    Stop(usize),
    Lose,
    Regain,
    /// The modem accepts nothing for this many seconds.
    Stall(u64),
    /// Whether the vehicle is in a fault.
    Fault(bool),
}

fn any_step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (1u64..30).prop_map(Step::Run),
        2 => (0usize..2).prop_map(Step::Start),
        1 => (0usize..2).prop_map(Step::Stop),
        1 => Just(Step::Lose),
        1 => Just(Step::Regain),
        1 => (1u64..60).prop_map(Step::Stall),
        1 => any::<bool>().prop_map(Step::Fault),
    ]
}

proptest! {
    #![proptest_config(cases(200))]

    /// L-11, L-14, L-23: two messages are less than a period apart only if a START was received between them. None is sent
    /// while it is off or in a fault. One is sent when it is on and the modem is ready.
    #[test]
    fn messages_are_sent_when_due_and_never_more_often(steps in prop::collection::vec(any_step(), 1..40)) {
        let mut world = world(CONFIG);
        let (mut starts, mut stalled_until) = (Vec::new(), world.now());
        let mut last_sent = None;
        let healthy = world.vehicle.state;
        for step in steps {
            let begin = world.now();
            match step {
                Step::Start(link) => {
                    starts.push(begin);
                    let start = world.gcs[link].long(MavCmd::CONTROL_HIGH_LATENCY, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
                    world.gcs[link].send(&start);
                }
                Step::Stop(link) => {
                    let stop = world.gcs[link].long(MavCmd::CONTROL_HIGH_LATENCY, [0.0; 7]);
                    world.gcs[link].send(&stop);
                }
                Step::Lose => lose(&mut world),
                Step::Regain => regain(&mut world),
                Step::Stall(seconds) => {
                    stalled_until = begin + secs(seconds);
                    world.uarts[SAT].stall_writes_until(stalled_until);
                }
                Step::Fault(is_faulty) => world.vehicle.state = healthy.filter(|_| !is_faulty),
                Step::Run(_) => {}
            }
            // The frame of this step is handled.
            run(&mut world, millis(5));
            let seconds = if let Step::Run(seconds) = step { seconds } else { 0 };
            let settled = world.now();
            let was_on = satellite(&mut world).is_on();
            run(&mut world, secs(seconds));
            let sent: Vec<_> = std::iter::from_fn(|| world.gcs[SAT].take::<HighLatency2>()).map(|(at, _)| at).collect();
            for &at in &sent {
                let is_asked = |last| starts.iter().any(|start| *start >= last && *start <= at);
                prop_assert!(last_sent.is_none_or(|last| at - last >= PERIOD || is_asked(last)), "{last_sent:?}, {at:?}");
                last_sent = Some(at);
            }
            let is_on = satellite(&mut world).is_on();
            let is_calm = satellite(&mut world).is_on_by_itself() || was_on == is_on;
            if sent.iter().any(|at| *at > settled) && is_calm {
                prop_assert!(was_on || is_on);
                prop_assert!(world.vehicle.state.is_some());
            }
            // If nothing blocked for a whole period, a message was sent.
            let is_free = world.now() - settled.max(stalled_until) > PERIOD.max(secs(21));
            if was_on && is_on && world.vehicle.state.is_some() && is_free {
                prop_assert!(!sent.is_empty(), "on since before {settled:?}");
            }
        }
    }
}

/// L-23: a new period applies after the next message. What is on stays on.
#[test]
fn period_can_be_changed_while_on() {
    let mut world = world(CONFIG);
    control(&mut world, TELEM, 1.0);
    run(&mut world, secs(5));
    assert_eq!(count(&mut world), 1);
    let config = HighLatencyConfig { period: secs(2), on_link_loss_after: None, ..CONFIG };
    satellite(&mut world).set_config(config);
    run(&mut world, secs(14));
    assert_eq!(count(&mut world), 0, "the next one is due after the old period");
    run(&mut world, secs(10));
    assert!((4..=5).contains(&count(&mut world)));
    lose(&mut world);
    run(&mut world, secs(10));
    assert!(satellite(&mut world).is_on() && !satellite(&mut world).is_on_by_itself());
}
