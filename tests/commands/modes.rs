//! AVAILABLE_MODES, CURRENT_MODE and AVAILABLE_MODES_MONITOR: rules, S-10, L-4, D-3, and the standard
//! modes of the MAVLink guide.

use crate::support::pilot::*;
use crate::support::*;
use mavstack::config::{LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::{LinkConfig, LinkId, Message, VehicleState};
use proptest::prelude::*;

pub(super) const NAN: f32 = f32::NAN;
pub(super) const INF: f32 = f32::INFINITY;
pub(super) const ACCEPTED: MavResult = MavResult::ACCEPTED;
pub(super) const DENIED: MavResult = MavResult::DENIED;
pub(super) const SET: MavCmd = MavCmd::DO_SET_MODE;
pub(super) const SET_STANDARD: MavCmd = MavCmd::DO_SET_STANDARD_MODE;
pub(super) const CUSTOM: f32 = 1.0;

/// Returns the indices of the received AVAILABLE_MODES, in order.
fn indices<const N: usize, const W: u8>(world: &Piloted<N, W>, link: usize) -> Vec<u8> {
    world.gcs[link].all::<AvailableModes>().iter().map(|(_, mode)| mode.mode_index).collect()
}

/// all modes are sent, each once, in the table's order, with every field of the table.
#[test]
fn all_modes_are_sent() {
    let mut world = world::<2, PX4>();
    assert_eq!(request(&mut world, 1, AVAILABLE, 0.0), ACCEPTED);
    world.run_for(secs(1));
    let told: Vec<_> = world.gcs[1].all::<AvailableModes>().into_iter().map(|(_, mode)| mode).collect();
    assert_eq!(told.len(), MODES.len());
    for (i, (told, mode)) in told.iter().zip(MODES).enumerate() {
        assert_eq!(usize::from(told.mode_index), i + 1);
        assert_eq!(usize::from(told.number_modes), MODES.len());
        assert_eq!((told.custom_mode, told.standard_mode), (mode.custom_mode, mode.standard_mode));
        assert_eq!(told.properties, mode.properties);
        assert_eq!(told.mode_name.as_str(), Some(mode.name));
    }
    assert_eq!(told[2].mode_name.wire()[34], 0, "QGroundControl drops the last byte");
    assert!(indices(&world, 0).is_empty(), "only on the link of the request");
}

/// H-4: with declared modes, 0 is a mode too.
#[test]
fn mode_0_is_a_mode_too() {
    let mut world = world::<1, MANY>();
    assert_eq!(world.vehicle.state, Some(VehicleState::new(false)));
    let heartbeat = world.expect::<Heartbeat>(0, secs(1));
    assert_eq!((heartbeat.base_mode, heartbeat.custom_mode), (MavModeFlag::CUSTOM_MODE_ENABLED, 0));
}

/// an index requests one mode, and an absent index all of them. An index beyond the table is DENIED.
#[test]
fn one_mode_can_be_requested() {
    let mut world = world::<1, PX4>();
    for (index, told) in [
        (1.0, Some(1)),
        (3.0, Some(3)),
        (7.0, Some(7)),
        (8.0, None),
        (33.0, None),
        (255.0, None),
        (256.0, None),
        (257.0, None),
        (-1.0, None),
        (1.5, None),
        (INF, None),
    ] {
        world.gcs[0].forget();
        let result = request(&mut world, 0, AVAILABLE, index);
        assert_eq!(result, if told.is_some() { ACCEPTED } else { DENIED }, "{index}");
        world.run_for(millis(100));
        assert_eq!(indices(&world, 0), Vec::from_iter(told), "{index}");
    }
    world.gcs[0].forget();
    assert_eq!(request(&mut world, 0, AVAILABLE, NAN), ACCEPTED);
    world.run_for(millis(100));
    assert_eq!(indices(&world, 0), [1, 2, 3, 4, 5, 6, 7]);
}

/// the response target is checked. Other message ids are not accepted.
#[test]
fn requests_are_checked() {
    fn check<const W: u8>() {
        let mut world = world::<1, W>();
        for id in [AVAILABLE, CURRENT, MONITOR] {
            for (target, result) in [(0.0, ACCEPTED), (1.0, ACCEPTED), (2.0, ACCEPTED), (NAN, ACCEPTED), (3.0, DENIED)]
            {
                let params = [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, target];
                assert_eq!(command(&mut world, 0, MavCmd::REQUEST_MESSAGE, &params), result, "{id} for {target}");
            }
        }
        for id in [434.0, 438.0, 435.5, -435.0, NAN] {
            assert_eq!(command(&mut world, 0, MavCmd::REQUEST_MESSAGE, &[id]), DENIED, "{id}");
        }
    }
    check::<PX4>();
    check::<QUIET>();
}

/// the table is constant, so its sequence number is constant and the monitor is sent on request only. Each row carries
/// the monitor's sequence number, so a ground station knows that its list is current (mavlink#2557).
#[test]
fn sequence_number_of_the_table_is_constant() {
    let mut world = world::<1, PX4>();
    world.expect_no::<AvailableModesMonitor>(0, secs(30));
    assert_eq!(request(&mut world, 0, MONITOR, 0.0), ACCEPTED);
    let seq = world.expect::<AvailableModesMonitor>(0, millis(50)).seq;
    assert_eq!(seq, 0);
    world.expect_no::<AvailableModesMonitor>(0, secs(30));
    assert_eq!(request(&mut world, 0, AVAILABLE, 0.0), ACCEPTED);
    world.run_for(millis(100));
    let rows = world.gcs[0].all::<AvailableModes>();
    assert_eq!(rows.len(), 7);
    assert!(rows.iter().all(|(_, row)| row.seq == seq));
}

/// CURRENT_MODE is sent every two seconds on each normal link, also if the driver sleeps until `next_deadline`.
#[test]
fn current_mode_is_sent_every_two_seconds() {
    let mut world = world::<2, PX4>();
    world.vehicle.enter(RETURN);
    world.vehicle.intended = HOLD;
    let wakes = world.sleep_for(secs(60));
    assert!(wakes < 1_000, "woken {wakes} times");
    for link in [0, 1] {
        let told = world.gcs[link].all::<CurrentMode>();
        assert!((30..=31).contains(&told.len()), "{}", told.len());
        for (_, mode) in &told {
            assert_eq!((mode.custom_mode, mode.intended_custom_mode), (RETURN, HOLD));
            assert_eq!(mode.standard_mode, MavStandardMode::SAFE_RECOVERY);
        }
        for pair in told.windows(2) {
            let gap = pair[1].0 - pair[0].0;
            assert!((1_900..=2_100).contains(&gap.as_millis()), "{} ms", gap.as_millis());
        }
    }
}

/// CURRENT_MODE is sent at once when the mode changes, once per change on each link.
#[test]
fn change_of_mode_is_sent_at_once() {
    let mut world = world::<2, PX4>();
    world.run_for(millis(2_300));
    // The last mode is not in the table.
    for (mode, standard) in [
        (POSITION, MavStandardMode::POSITION_HOLD),
        (HOLD, MavStandardMode::NON_STANDARD),
        (MISSION, MavStandardMode::MISSION),
        (12_345, MavStandardMode::NON_STANDARD),
    ] {
        world.gcs.iter_mut().for_each(Gcs::forget);
        world.vehicle.enter(mode);
        world.run_for(millis(100));
        for link in [0, 1] {
            let told = world.gcs[link].all::<CurrentMode>();
            let told: Vec<_> = told.iter().map(|(_, told)| (told.custom_mode, told.standard_mode)).collect();
            assert_eq!(told, [(mode, standard)]);
        }
    }
    // The driver sleeps. The change wakes the stack, which then has something to send.
    world.vehicle.enter(HOLD);
    let now = world.now();
    world.stack.poll(now, &mut world.vehicle);
    assert_eq!(world.stack.next_deadline(now), now);
}

/// While the vehicle reports a fault, the mode is unknown: nothing is sent and requests are refused. A change is sent after the
/// fault has ended.
#[test]
fn mode_is_not_sent_during_a_fault() {
    let mut world = world::<1, PX4>();
    world.run_for(millis(2_300));
    world.gcs[0].forget();
    let state = world.vehicle.state.take();
    assert_eq!(request(&mut world, 0, CURRENT, 0.0), DENIED);
    assert_eq!(request(&mut world, 0, AVAILABLE, 1.0), ACCEPTED, "the table is known");
    world.expect_no::<CurrentMode>(0, secs(10));
    world.vehicle.state = state;
    world.vehicle.enter(MISSION);
    assert_eq!(world.expect::<CurrentMode>(0, millis(10)).custom_mode, MISSION);
}

/// CURRENT_MODE can be requested with any index.
#[test]
fn current_mode_is_sent_on_request() {
    let mut world = world::<1, PX4>();
    world.vehicle.enter(HOLD);
    world.run_for(millis(2_300));
    for index in [0.0, 5.0, NAN] {
        world.gcs[0].forget();
        assert_eq!(request(&mut world, 0, CURRENT, index), ACCEPTED);
        assert_eq!(world.expect::<CurrentMode>(0, millis(10)).custom_mode, HOLD);
        assert_eq!(world.gcs[0].count_of::<CurrentMode>(), 1);
    }
}

/// the interval of CURRENT_MODE can be read and not changed; the other two messages have none.
#[test]
fn interval_of_current_mode_is_fixed() {
    let mut world = world::<1, PX4>();
    let set = |world: &mut Piloted<1>, micros: f32| {
        command(world, 0, MavCmd::SET_MESSAGE_INTERVAL, &[CURRENT as f32, micros])
    };
    assert_eq!(set(&mut world, 100_000.0), ACCEPTED, "raised to the fixed interval");
    assert_eq!(set(&mut world, 0.0), ACCEPTED);
    assert_eq!(set(&mut world, -1.0), DENIED);
    for (id, interval) in [(CURRENT, 2_000_000), (AVAILABLE, 0), (MONITOR, 0)] {
        assert_eq!(request(&mut world, 0, 244, id as f32), ACCEPTED);
        let told: MessageInterval = world.expect(0, millis(50));
        assert_eq!((u32::from(told.message_id), told.interval_us), (id, interval));
    }
    world.run_for(millis(500));
    world.gcs[0].forget();
    world.run_for(secs(20));
    assert_eq!(world.gcs[0].count_of::<CurrentMode>(), 10);
}

/// S-10: MAVLink 1 cannot carry these ids: requests are refused and nothing is sent until the link sends v2 (V-1).
#[test]
fn mode_messages_are_not_sent_over_mavlink_1() {
    let v1 = LinkConfig::uart(115_200).with_version(TxVersion::V1);
    let links = [v1, v1.with_version(TxVersion::Auto)];
    let mut world = Piloted::<2>::of(Setup { links, ..Setup::new() });
    world.gcs.iter_mut().for_each(|gcs| gcs.version = mavstack::frame::Version::V1);
    for link in [0, 1] {
        for id in [AVAILABLE, CURRENT, MONITOR] {
            assert_eq!(request(&mut world, link, id, 0.0), DENIED, "{id}");
        }
        assert_eq!(command(&mut world, link, SET, &[CUSTOM, 4.0, 3.0]), ACCEPTED, "the command itself fits v1");
        world.gcs[link].send(&set_mode(1, HOLD));
        assert_eq!(world.expect::<CommandAck>(link, millis(10)).result, ACCEPTED);
        // the message has no interval on such a link.
        assert_eq!(request(&mut world, link, 244, CURRENT as f32), ACCEPTED);
        assert_eq!(world.expect::<MessageInterval>(link, millis(50)).interval_us, 0);
    }
    world.gcs.iter_mut().for_each(Gcs::forget);
    world.vehicle.enter(HOLD);
    world.run_for(secs(10));
    for gcs in &world.gcs {
        assert!(gcs.received.iter().all(|frame| [Heartbeat::ID, CommandAck::ID].contains(&frame.header.id)));
        assert!(gcs.count_of::<Heartbeat>() >= 10);
    }
    world.gcs[1].version = mavstack::frame::Version::V2;
    assert_eq!(request(&mut world, 1, AVAILABLE, 0.0), ACCEPTED);
    world.run_for(secs(10));
    assert_eq!(indices(&world, 1), [1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(world.gcs[1].count_of::<CurrentMode>(), 5);
}

/// L-4: over a high-latency link a command can set the mode; nothing else is sent, and SET_MODE is ignored.
#[test]
fn high_latency_link_carries_commands_only() {
    high_latency_link::<PX4>();
    high_latency_link::<QUIET>();
}

fn high_latency_link<const W: u8>() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency).with_streams(StreamProfile::Onboard);
    let mut world = Piloted::<1, W>::of(Setup { links: [satellite], ..Setup::new() });
    assert_eq!(command(&mut world, 0, SET, &[CUSTOM, 4.0, 3.0]), ACCEPTED);
    assert_eq!(command(&mut world, 0, SET_STANDARD, &[1.0]), ACCEPTED);
    for id in [AVAILABLE, CURRENT, MONITOR] {
        assert_eq!(request(&mut world, 0, id, 0.0), DENIED, "{id}");
    }
    world.gcs[0].send(&set_mode(1, RETURN));
    world.vehicle.enter(HOLD);
    world.run_for(secs(20));
    assert_eq!(asked(&mut world), [HOLD, POSITION]);
    assert_eq!(world.gcs[0].received.len(), 5, "only the answers");
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().out_of_place, 1);
}

/// D-3: a backpressured link loses neither answers nor modes.
#[test]
fn backpressure_loses_nothing() {
    let mut world = world::<1, MANY>();
    world.run_for(millis(500));
    world.gcs[0].forget();
    world.uarts[0].stall_writes_until(world.now() + secs(3));
    let params = |id: u32, index: f32| seven(&[id as f32, index]);
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, params(AVAILABLE, 9.0));
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, params(AVAILABLE, 0.0));
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, params(MONITOR, 0.0));
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, params(CURRENT, 0.0));
    world.run_for(millis(2_900));
    world.vehicle.enter(17);
    world.run_for(secs(2));
    let acks = world.gcs[0].all::<CommandAck>();
    assert!(acks.len() == 4 && acks.iter().all(|(_, ack)| ack.result == ACCEPTED));
    assert_eq!(indices(&world, 0), Vec::from_iter(1..=32), "each once, because none was sent in between");
    assert_eq!(world.gcs[0].count_of::<AvailableModesMonitor>(), 1);
    let modes = world.gcs[0].all::<CurrentMode>();
    assert!(modes.iter().all(|(_, mode)| mode.custom_mode == 17), "the mode at the time of sending");
    assert!((1..=2).contains(&modes.len()));
}

/// Two ground stations share a link. If one requests the modes while they are being sent to the other, all of them follow, up
/// to the last: that is how QGroundControl detects the end.
#[test]
fn request_during_a_list_gets_the_whole_list() {
    let lines = [LineConfig::radio(9_600, millis(0))];
    let links = [LinkConfig::uart(9_600)];
    let mut world = Piloted::<1, MANY>::of(Setup { lines, links, ..Setup::new() });
    request(&mut world, 0, AVAILABLE, 0.0);
    assert!(world.run_until(secs(5), |world| indices(world, 0).contains(&10)));
    assert_eq!(request(&mut world, 0, AVAILABLE, 0.0), ACCEPTED);
    world.run_for(secs(10));
    let told = indices(&world, 0);
    let (front, all) = told.split_at(told.len() - 32);
    assert_eq!(front, Vec::from_iter(1..=front.len() as u8), "until the second request");
    assert!(front.len() < 20);
    assert_eq!(all, Vec::from_iter(1..=32));
}

/// Without declared modes, the vehicle gets the commands and the message, and no modes can be requested.
#[test]
fn a_vehicle_without_modes() {
    let mut world = World::new(Setup::<1>::new());
    for id in [SET, SET_STANDARD] {
        world.gcs[0].command_long(id, seven(&[CUSTOM, 4.0, 3.0]));
        assert_eq!(world.expect::<CommandAck>(0, millis(10)).result, MavResult::UNSUPPORTED);
    }
    let ids: Vec<_> = world.vehicle.commands().iter().map(|command| command.id).collect();
    assert_eq!(ids, [SET, SET_STANDARD]);
    world.vehicle.calls.clear();
    world.gcs[0].send(&set_mode(1, HOLD));
    world.expect_no::<CommandAck>(0, millis(100));
    assert!(matches!(world.vehicle.calls[..], [Call::Message { id: 11, .. }]));
    for id in [AVAILABLE, CURRENT, MONITOR] {
        world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, seven(&[id as f32]));
        assert_eq!(world.expect::<CommandAck>(0, millis(10)).result, DENIED);
    }
    world.vehicle.state.as_mut().unwrap().custom_mode = 99;
    world.run_for(secs(10));
    assert_eq!(world.gcs[0].count_of::<CurrentMode>(), 0);
}

/// A step of the property.
#[derive(Clone, Debug)]
enum Step {
    Request { index: u8 },
    SetMode { custom_mode: u32 },
    Enter { custom_mode: u32 },
    Stall { millis: u64 },
    Wait { millis: u64 },
}

fn any_step() -> impl Strategy<Value = Step> {
    prop_oneof![
        2 => Just(Step::Request { index: 0 }),
        4 => (1u8..40).prop_map(|index| Step::Request { index }),
        1 => (0u32..40).prop_map(|custom_mode| Step::SetMode { custom_mode }),
        1 => (0u32..40).prop_map(|custom_mode| Step::Enter { custom_mode }),
        1 => (0u64..300).prop_map(|millis| Step::Stall { millis }),
        4 => (0u64..200).prop_map(|millis| Step::Wait { millis }),
    ]
}

proptest! {
    #![proptest_config(cases(96))]

    /// Whatever is requested and however slow the link is, each request is answered, each requested mode is sent after its
    /// request, and no mode is sent more often than it was requested.
    #[test]
    fn each_requested_mode_is_sent_and_not_too_often(steps in prop::collection::vec(any_step(), 1..40)) {
        let lines = [LineConfig::radio(19_200, millis(0))];
        let links = [LinkConfig::uart(19_200)];
        let mut world = Piloted::<1, MANY>::of(Setup { lines, links, ..Setup::new() });
        // By mode: the time of the last request, and the number of requests.
        let mut last = [None; 33];
        let mut often = [0; 33];
        let mut questions = 0;
        for step in steps {
            match step {
                Step::Request { index } => {
                    questions += 1;
                    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, seven(&[AVAILABLE as f32, index.into()]));
                    prop_assert!(world.run_until(secs(2), |world| world.gcs[0].count_of::<CommandAck>() == questions));
                    // Modes that arrive from now on were sent after the request.
                    for index in (1..=32).filter(|&each| index == 0 || each == usize::from(index)) {
                        last[index] = Some(world.now());
                        often[index] += 1;
                    }
                }
                Step::SetMode { custom_mode } => {
                    questions += 1;
                    world.gcs[0].send(&set_mode(1, custom_mode));
                    prop_assert!(world.run_until(secs(2), |world| world.gcs[0].count_of::<CommandAck>() == questions));
                }
                Step::Enter { custom_mode } => world.vehicle.enter(custom_mode),
                Step::Stall { millis: time } => world.uarts[0].stall_writes_until(world.now() + millis(time)),
                Step::Wait { millis: time } => world.run_for(millis(time)),
            }
        }
        world.run_for(secs(5));
        prop_assert_eq!(world.gcs[0].count_of::<CommandAck>(), questions);
        let told = world.gcs[0].all::<AvailableModes>();
        for index in 1..=32 {
            let of_it = told.iter().filter(|(_, mode)| usize::from(mode.mode_index) == index);
            let times: Vec<_> = of_it.map(|(at, _)| *at).collect();
            prop_assert!(times.len() <= often[index], "mode {} was sent {} times", index, times.len());
            if let Some(asked) = last[index] {
                prop_assert!(times.last().is_some_and(|&at| at >= asked), "mode {} was not sent", index);
            }
        }
        // The current mode was sent.
        let mode = world.vehicle.state.unwrap().custom_mode;
        prop_assert_eq!(world.gcs[0].all::<CurrentMode>().last().unwrap().1.custom_mode, mode);
    }
}
