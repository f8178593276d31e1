//! The high-latency link: rules L-1 to L-23, C-12 over two links, H-5.

use crate::support::*;
use crate::{World, run, satellite};
use mavstack::config::{LinkClass, TxVersion};
use mavstack::dialect::{
    AutopilotVersion, CommandAck, Heartbeat, HighLatency2, MavAutopilot, MavCmd, MavResult, MavType, ProtocolVersion,
};
use mavstack::high_latency::{HighLatencyConfig, HighLatencyCounters, HighLatencyMode, HighLatencySample};
use mavstack::{Duration, Instant, LinkConfig, LinkId, Message, PeerEvent};

const TELEM: usize = 0;
const SAT: usize = 1;
const PERIOD: Duration = secs(20);
const CONFIG: HighLatencyConfig = HighLatencyConfig { period: PERIOD, ..HighLatencyConfig::DEFAULT };

const SATELLITE: LinkConfig = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);

/// A telemetry radio and a satellite modem.
fn world(config: HighLatencyConfig) -> World<2> {
    with_links([LinkConfig::uart(57_600), SATELLITE], config)
}

fn with_links<const N: usize>(links: [LinkConfig; N], config: HighLatencyConfig) -> World<N> {
    let mut world = World::of(Setup { links, ..Setup::new() });
    world.stack.high_latency.set_config(config);
    world
}

/// Sends a MAV_CMD_CONTROL_HIGH_LATENCY with this parameter 1 and returns the answer.
fn control<const N: usize>(world: &mut World<N>, link: usize, enable: f32) -> MavResult {
    world.gcs[link].command_long(MavCmd::CONTROL_HIGH_LATENCY, [enable, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let ack: CommandAck = world.expect(link, millis(100));
    assert_eq!(ack.command, MavCmd::CONTROL_HIGH_LATENCY);
    ack.result
}

/// Returns the HIGH_LATENCY2 that a link received since the last call.
fn reports<const N: usize>(world: &mut World<N>, link: usize) -> Vec<(Instant, HighLatency2)> {
    std::iter::from_fn(|| world.gcs[link].take::<HighLatency2>()).collect()
}

fn count<const N: usize>(world: &mut World<N>, link: usize) -> usize {
    reports(world, link).len()
}

fn times(reports: &[(Instant, HighLatency2)]) -> Vec<u64> {
    reports.iter().map(|(at, _)| at.as_millis()).collect()
}

/// L-2, L-3, L-10, L-11: messages are off by default. A START over the satellite is answered there; a message follows at once,
/// then one per period, until a STOP. Neither a heartbeat nor anything else is sent.
#[test]
fn start_and_stop_over_the_satellite() {
    let mut world = world(CONFIG);
    run(&mut world, secs(60));
    assert_eq!(world.uarts[SAT].written(), 0);
    assert_eq!(control(&mut world, SAT, 1.0), MavResult::ACCEPTED);
    let begin = world.now().as_millis();
    run(&mut world, secs(50));
    let sent = reports(&mut world, SAT);
    assert_eq!(times(&sent), [begin, begin + 20_000, begin + 40_000]);
    assert_eq!(control(&mut world, SAT, 0.0), MavResult::ACCEPTED);
    run(&mut world, secs(60));
    assert_eq!(count(&mut world, SAT), 0);
    assert_eq!(world.gcs[SAT].received.len(), 5, "three messages, two answers");
    assert_eq!(count(&mut world, TELEM), 0, "never on a normal link");
    assert_eq!(world.gcs[TELEM].count_of::<Heartbeat>(), 171);
}

/// L-10, L-11, L-15: the command over the normal link is answered there and applies to the satellite; both links run at once.
/// Each command may be sent twice: a second START sends another message, ten seconds after the first (L-17).
#[test]
fn start_and_stop_over_the_radio_twice() {
    let mut world = world(CONFIG);
    assert_eq!(control(&mut world, TELEM, 1.0), MavResult::ACCEPTED);
    run(&mut world, secs(5));
    assert_eq!(count(&mut world, SAT), 1);
    assert_eq!(control(&mut world, TELEM, 1.0), MavResult::ACCEPTED);
    run(&mut world, secs(4));
    assert_eq!(count(&mut world, SAT), 0);
    run(&mut world, secs(20));
    assert_eq!(count(&mut world, SAT), 1);
    run(&mut world, secs(2));
    assert_eq!(count(&mut world, SAT), 1, "a period after the second one");
    assert!(world.gcs[TELEM].count_of::<Heartbeat>() >= 25);
    for _ in 0..2 {
        assert_eq!(control(&mut world, TELEM, 0.0), MavResult::ACCEPTED);
    }
    run(&mut world, secs(60));
    assert_eq!(count(&mut world, SAT), 0);
    assert_eq!(world.gcs[SAT].received.len(), 3, "no answers over the satellite");
}

/// C-12, L-15: one START over both links, retransmitted by its sender, is carried out once and answered each time, even if the
/// satellite delivers it half a minute later. After a STOP it starts again.
#[test]
fn duplicate_start_sends_no_other_message() {
    let mut world = world(CONFIG);
    assert_eq!(control(&mut world, TELEM, 1.0), MavResult::ACCEPTED);
    run(&mut world, secs(2));
    let mut again = world.gcs[TELEM].long(MavCmd::CONTROL_HIGH_LATENCY, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    again.confirmation = 1;
    world.gcs[TELEM].send(&again);
    assert_eq!(world.expect::<CommandAck>(TELEM, millis(100)).result, MavResult::ACCEPTED);
    run(&mut world, secs(13));
    assert_eq!(control(&mut world, SAT, 1.0), MavResult::ACCEPTED);
    run(&mut world, secs(4));
    assert_eq!(count(&mut world, SAT), 1);
    run(&mut world, secs(2));
    assert_eq!(count(&mut world, SAT), 1, "on time: no duplicate moved it");
    assert_eq!(control(&mut world, TELEM, 0.0), MavResult::ACCEPTED);
    assert_eq!(control(&mut world, SAT, 1.0), MavResult::ACCEPTED);
    // Ten seconds after the last message (L-17).
    run(&mut world, secs(11));
    assert_eq!(count(&mut world, SAT), 1);
    // A START from another station, or a minute later, is not a duplicate.
    world.gcs[TELEM].address = OTHER_STATION;
    assert_eq!(control(&mut world, TELEM, 1.0), MavResult::ACCEPTED);
    run(&mut world, secs(11));
    assert_eq!(count(&mut world, SAT), 1);
}

/// L-10, C-9: the only valid parameters are 0 and 1.
#[test]
fn other_parameters_are_denied_and_change_nothing() {
    for was_on in [false, true] {
        let mut world = world(CONFIG);
        if was_on {
            control(&mut world, SAT, 1.0);
            run(&mut world, secs(1));
        }
        count(&mut world, SAT);
        for bad in [f32::NAN, 0.5, 2.0, -1.0, 0.999_999_9, f32::INFINITY, f32::NEG_INFINITY, f32::MIN_POSITIVE] {
            assert_eq!(control(&mut world, SAT, bad), MavResult::DENIED, "{bad}");
            assert_eq!(control(&mut world, TELEM, bad), MavResult::DENIED, "{bad}");
            assert_eq!(satellite(&mut world).is_on(), was_on, "{bad}");
        }
        assert_eq!(count(&mut world, SAT), 0);
    }
}

/// L-12: the command is UNSUPPORTED without a high-latency link or without the service.
#[test]
fn command_is_unsupported_without_high_latency_link() {
    let mut world = with_links([LinkConfig::uart(57_600)], CONFIG);
    for enable in [1.0, 0.0, 7.0] {
        assert_eq!(control(&mut world, TELEM, enable), MavResult::UNSUPPORTED);
    }
    let mut world =
        crate::support::World::<2>::new(Setup { links: [LinkConfig::uart(57_600), SATELLITE], ..Setup::new() });
    world.gcs[SAT].command_long(MavCmd::CONTROL_HIGH_LATENCY, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(world.expect::<CommandAck>(SAT, secs(5)).result, MavResult::UNSUPPORTED);
    world.run_for(secs(60));
    assert_eq!(world.gcs[SAT].received.len(), 1);
}

/// L-13: the command applies to all high-latency links, also when it is sent to all components. To all systems it is DENIED
/// (L-17).
#[test]
fn command_applies_to_all_high_latency_links() {
    let mut world = with_links([SATELLITE, LinkConfig::uart(57_600), SATELLITE], CONFIG);
    for (target_system, target_component) in [(1, 0), (1, 1)] {
        let mut start = world.gcs[1].long(MavCmd::CONTROL_HIGH_LATENCY, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        start.target_system = target_system;
        start.target_component = target_component;
        world.gcs[1].send(&start);
        run(&mut world, secs(11));
        assert_eq!([0, 1, 2].map(|link| count(&mut world, link)), [1, 0, 1]);
    }
    run(&mut world, PERIOD);
    assert_eq!([0, 1, 2].map(|link| count(&mut world, link)), [1, 0, 1]);
}

/// L-23, L-21: a busy modem gets one message when it is ready, with the samples until then. The next one follows a whole period
/// later. No sample in between is lost.
#[test]
fn busy_modem_gets_its_message_later() {
    let mut world = world(CONFIG);
    control(&mut world, TELEM, 1.0);
    run(&mut world, secs(1));
    count(&mut world, SAT);
    let ready = Instant::from_millis(70_000);
    world.uarts[SAT].stall_writes_until(ready);
    let mut sampled = Vec::new();
    for round in 0..70 {
        let now = world.now();
        sampled.push(now.as_millis() as u32);
        let climb_rate = if round == 30 { -7.0 } else { 1.0 };
        let airspeed = if round < 35 { 10.0 } else { 20.0 };
        let sample = HighLatencySample { climb_rate, airspeed, altitude: round as f32, ..HighLatencySample::UNKNOWN };
        satellite(&mut world).sample(now, &sample);
        run(&mut world, secs(1));
    }
    run(&mut world, secs(25));
    let sent = reports(&mut world, SAT);
    let (first, second) = (sent[0].0.as_millis(), sent[1].0.as_millis());
    assert!((70_000..70_500).contains(&first), "{first}");
    assert_eq!((second, sent.len()), (first + 20_000, 2));
    let told = sent[0].1;
    assert_eq!((told.climb_rate, told.altitude, told.timestamp), (-70, 68, sampled[68]));
    assert!((74..=76).contains(&told.airspeed), "the mean of all samples: {}", told.airspeed);
}

/// L-21: a message carries means and extremes since the previous one, and the last value of other fields. Then they start
/// again.
#[test]
fn each_message_covers_the_time_since_the_previous_one() {
    let mut world = world(CONFIG);
    control(&mut world, TELEM, 1.0);
    run(&mut world, millis(10));
    let tell = |world: &mut World<2>, values: &[f32]| {
        count(world, SAT);
        for value in values {
            let now = world.now();
            let v = *value;
            satellite(world).sample(
                now,
                &HighLatencySample {
                    airspeed: v,
                    airspeed_sp: v,
                    groundspeed: v,
                    windspeed: v,
                    throttle: v,
                    battery: v,
                    temperature_air: v,
                    eph: v,
                    epv: v,
                    climb_rate: -v,
                    heading: v,
                    ..HighLatencySample::UNKNOWN
                },
            );
            run(world, secs(1));
        }
        run(world, PERIOD);
        let sent = reports(world, SAT);
        assert_eq!(sent.len(), 1);
        sent[0].1
    };
    let told = tell(&mut world, &[2.0, 12.0, 4.0]);
    assert_eq!([told.airspeed, told.airspeed_sp, told.groundspeed, told.windspeed], [30; 4]);
    assert_eq!((told.throttle, told.battery, told.temperature_air), (6, 6, 6));
    assert_eq!((told.eph, told.epv, told.climb_rate, told.heading), (120, 120, -120, 2));
    world.run_for(millis(1));
    let told = tell(&mut world, &[1.0]);
    assert_eq!((told.airspeed, told.battery, told.eph, told.climb_rate), (5, 1, 10, -10), "no earlier sample");
    // Without a new sample the last one is sent again, with its old timestamp.
    let again = tell(&mut world, &[]);
    assert_eq!(again, told);
}

/// L-21: while messages are off, only the latest samples are kept for the first one.
#[test]
fn first_message_omits_old_samples() {
    let mut world = world(CONFIG);
    for second in 0..60 {
        let now = world.now();
        let eph = if second < 20 { 20.0 } else { 1.0 };
        satellite(&mut world).sample(now, &HighLatencySample { eph, ..HighLatencySample::UNKNOWN });
        run(&mut world, secs(1));
    }
    control(&mut world, TELEM, 1.0);
    run(&mut world, millis(100));
    assert_eq!(reports(&mut world, SAT)[0].1.eph, 10);
}

/// L-21: two modems send the same values, even if one is late.
#[test]
fn two_modems_send_the_same_values() {
    let mut world = with_links([SATELLITE, SATELLITE], CONFIG);
    satellite(&mut world).start();
    for round in 1..=4u8 {
        let until = world.now() + millis(1_500);
        world.uarts[1].stall_writes_until(until);
        let now = world.now();
        let eph = if round == 2 { 9.0 } else { 1.0 };
        for eph in [eph, 0.5] {
            satellite(&mut world).sample(now, &HighLatencySample { eph, ..HighLatencySample::UNKNOWN });
        }
        run(&mut world, PERIOD);
        let expected = if round == 2 { 90 } else { 10 };
        for link in 0..2 {
            let sent = reports(&mut world, link);
            assert_eq!(sent.iter().map(|(_, told)| told.eph).collect::<Vec<_>>(), [expected], "{round}, link {link}");
        }
    }
}

/// L-3, H-5: the message says that the vehicle is alive, so it is not sent while the flight loop is stalled, nor in a fault.
#[test]
fn message_stops_when_heartbeats_stop() {
    let mut world = world(CONFIG);
    control(&mut world, TELEM, 1.0);
    run(&mut world, secs(1));
    assert_eq!(count(&mut world, SAT), 1);
    world.loop_runs = false;
    run(&mut world, secs(60));
    assert_eq!(count(&mut world, SAT), 0, "the flight loop is stalled");
    world.loop_runs = true;
    run(&mut world, secs(1));
    assert_eq!(count(&mut world, SAT), 1);
    let state = world.vehicle.state.take();
    run(&mut world, secs(60));
    assert_eq!(count(&mut world, SAT), 0, "a fault");
    world.vehicle.state = state;
    run(&mut world, secs(1));
    assert_eq!(count(&mut world, SAT), 1);
}

/// L-22: the identity is the configured one, and the mode is the heartbeat's, in each of its two parts.
#[test]
fn message_has_identity_and_mode() {
    for (custom_mode, expected) in [(HighLatencyMode::Low16, 0x0102), (HighLatencyMode::High16, 0x0304)] {
        let mut setup = Setup::<1> { links: [SATELLITE], ..Setup::new() };
        setup.config.r#type = MavType::FIXED_WING;
        setup.config.autopilot = MavAutopilot::PX4;
        let mut world = World::of(setup);
        world.vehicle.state.as_mut().unwrap().custom_mode = 0x0304_0102;
        world.stack.high_latency.set_config(HighLatencyConfig { custom_mode, ..CONFIG });
        satellite(&mut world).start();
        world.run_for(millis(5));
        let told = reports(&mut world, 0)[0].1;
        assert_eq!((told.r#type, told.autopilot), (MavType::FIXED_WING, MavAutopilot::PX4));
        assert_eq!(told.custom_mode, expected);
    }
}

/// Every frame is counted at its cost. In MAVLink 1 a message is exactly one credit.
#[test]
fn costs_are_counted() {
    for (version, len, credits) in [(TxVersion::V1, 50, 1), (TxVersion::V2, 51, 2)] {
        let mut world = with_links([LinkConfig::uart(57_600), SATELLITE.with_version(version)], CONFIG);
        control(&mut world, TELEM, 1.0);
        run(&mut world, secs(50));
        assert_eq!(count(&mut world, SAT), 3);
        let counters = satellite(&mut world).counters();
        let expected = counted::<HighLatencyCounters>(|counters| {
            counters.reports = 3;
            counters.messages = 3;
            counters.bytes = 3 * len;
            counters.credits = 3 * credits
        });
        assert_eq!(counters, expected);
        assert_eq!(control(&mut world, SAT, 0.0), MavResult::ACCEPTED);
        let counters = satellite(&mut world).counters();
        assert_eq!((counters.reports, counters.messages, counters.credits), (3, 4, 3 * credits + 1));
        assert_eq!(u64::from(counters.bytes), world.uarts[SAT].written());
    }
}

/// L-2, Q-1: HIGH_LATENCY2 can be requested on its own link while it is on, and nowhere else. No other message can.
#[test]
fn message_can_be_requested_only_on_its_link_while_on() {
    let mut world = world(CONFIG);
    let ask = |world: &mut World<2>, link: usize, id: u32, target: f32| {
        world.gcs[link].command_long(MavCmd::REQUEST_MESSAGE, [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, target]);
        let answer = world.expect::<CommandAck>(link, millis(100)).result;
        run(world, secs(1));
        (answer, count(world, SAT) + count(world, TELEM))
    };
    assert_eq!(ask(&mut world, SAT, HighLatency2::ID, 0.0), (MavResult::DENIED, 0), "off");
    satellite(&mut world).start();
    run(&mut world, secs(1));
    assert_eq!(count(&mut world, SAT), 1);
    assert_eq!(ask(&mut world, SAT, HighLatency2::ID, 0.0), (MavResult::ACCEPTED, 1));
    assert_eq!(ask(&mut world, SAT, HighLatency2::ID, 3.0), (MavResult::DENIED, 0));
    assert_eq!(ask(&mut world, TELEM, HighLatency2::ID, 0.0), (MavResult::DENIED, 0));
    for other in [AutopilotVersion::ID, ProtocolVersion::ID, 30, 234] {
        assert_eq!(ask(&mut world, SAT, other, 0.0), (MavResult::DENIED, 0), "{other}");
    }
    run(&mut world, secs(12));
    assert_eq!(count(&mut world, SAT), 0, "the period starts at the requested message");
}

/// L-3: a peer that commands over a satellite is listed and never times out. Its heartbeats there mean nothing.
#[test]
fn peers_over_satellite_are_listed_and_never_time_out() {
    let mut world = world(CONFIG);
    control(&mut world, SAT, 1.0);
    world.gcs[SAT].send(&Gcs::heartbeat());
    run(&mut world, secs(100));
    control(&mut world, SAT, 1.0);
    let heard = world.now();
    run(&mut world, secs(100));
    assert_eq!(world.vehicle.peer_events(), []);
    let info = world.stack.peers(world.now()).next().expect("a peer");
    assert_eq!((info.peer.link, info.is_alive, info.last_heartbeat()), (LinkId(1), false, None));
    assert!(heard - info.last_heard() < millis(10));
    // On the radio, the same station is alive and can time out.
    world.gcs[TELEM].send(&Gcs::heartbeat());
    run(&mut world, secs(10));
    let events = world.vehicle.peer_events();
    assert!(
        matches!(events[..], [PeerEvent::Found(a), PeerEvent::Lost(b)] if a == b && a.link == LinkId(0)),
        "{events:?}"
    );
}

/// L-16: the vehicle sees the class of a command's link. Without a signature its age is unknown.
#[test]
fn vehicle_sees_that_a_command_came_by_satellite() {
    let mut world = world(CONFIG);
    for (link, class) in [(TELEM, LinkClass::Normal), (SAT, LinkClass::HighLatency)] {
        world.gcs[link].command_long(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.expect::<CommandAck>(link, millis(100));
        let command = *world.vehicle.commands().last().unwrap();
        assert_eq!((command.class, command.age), (class, None));
    }
}

/// D-3: a message that was interrupted when the port was closed is sent again, whole.
#[test]
fn interrupted_message_is_sent_again() {
    let down = Wire { bytes_per_second: 1_000, tx_fifo: 4, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }];
    let mut world = World::of(Setup { links: [SATELLITE], lines, ..Setup::<1>::new() });
    world.stack.high_latency.set_config(CONFIG);
    satellite(&mut world).start();
    world.run_for(millis(20));
    world.uarts[0].set_closed(true);
    run(&mut world, secs(1));
    world.uarts[0].set_closed(false);
    world.stack.restart_link(LinkId(0));
    world.gcs[0] = Gcs::new(world.gcs[0].end.clone());
    world.run_for(secs(1));
    assert_eq!(count(&mut world, 0), 1);
    assert_eq!(satellite(&mut world).counters().reports, 1);
}
