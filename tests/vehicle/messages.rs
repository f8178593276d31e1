//! Messages on request: rules, O-6, L-4, S-10, D-3.

use crate::support::*;
use mavstack::__private::Declares;
use mavstack::config::{LinkClass, TxVersion};
use mavstack::dialect::*;
use mavstack::{LinkConfig, Message, plan_memory};

/// Sends REQUEST_MESSAGE, SET_MESSAGE_INTERVAL or GET_MESSAGE_INTERVAL, and returns the answer.
fn ask<const N: usize, D: Declares<Vehicle: Default>>(
    world: &mut World<N, D>,
    link: usize,
    command: MavCmd,
    params: [f32; 7],
) -> MavResult {
    world.gcs[link].command_long(command, params);
    let ack: CommandAck = world.expect(link, millis(100));
    assert_eq!(ack.command, command);
    ack.result
}

fn request<const N: usize>(world: &mut World<N>, id: u32, index: f32) -> MavResult {
    ask(world, 0, MavCmd::REQUEST_MESSAGE, [id as f32, index, 0.0, 0.0, 0.0, 0.0, 0.0])
}

/// Returns the interval in MESSAGE_INTERVAL, requested in the new and in the old way.
fn interval<const N: usize, D: Declares<Vehicle: Default>>(world: &mut World<N, D>, link: usize, id: u32) -> i32 {
    let old = ask(world, link, MavCmd::GET_MESSAGE_INTERVAL, [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let first: MessageInterval = world.expect(link, millis(100));
    let new = ask(world, link, MavCmd::REQUEST_MESSAGE, [244.0, id as f32, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let second: MessageInterval = world.expect(link, millis(100));
    assert_eq!((old, new), (MavResult::ACCEPTED, MavResult::ACCEPTED));
    assert_eq!((first.message_id, first), (id as u16, second));
    first.interval_us
}

/// a message that the vehicle can fill is sent once, on the link of the request, after the ACK.
#[test]
fn requested_message_is_sent_once_on_its_link() {
    let mut world = World::new(Setup::<2>::new());
    for command_int in [false, true] {
        world.gcs.iter_mut().for_each(Gcs::forget);
        if command_int {
            world.gcs[0].command_int(MavCmd::REQUEST_MESSAGE, [Attitude::ID as f32, 0.0, 0.0, 0.0]);
        } else {
            world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [Attitude::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        world.run_for(secs(3));
        let ids: Vec<_> = world.gcs[0].received.iter().map(|frame| frame.header.id).filter(|&id| id != 0).collect();
        assert_eq!(ids, [CommandAck::ID, Attitude::ID]);
        let (at, attitude) = world.gcs[0].all::<Attitude>()[0];
        assert_eq!(
            (u64::from(attitude.time_boot_ms), attitude.yaw),
            (at.as_millis(), 1.0),
            "the content at the time of sending"
        );
        assert_eq!(world.gcs[1].count_of::<Attitude>(), 0);
    }
    assert_eq!(world.vehicle.commands(), [], "the stack answers without the vehicle");
}

/// a message that the vehicle cannot fill now, or an instance that it lacks, is refused and not sent.
#[test]
fn unavailable_message_is_refused() {
    let mut world = World::new(Setup::<1>::new());
    assert_eq!(request(&mut world, HomePosition::ID, 0.0), MavResult::DENIED);
    world.expect_no::<HomePosition>(0, millis(100));
    world.vehicle.has_home = true;
    assert_eq!(request(&mut world, HomePosition::ID, f32::NAN), MavResult::ACCEPTED);
    assert_eq!(world.expect::<HomePosition>(0, millis(100)).z, 3.0);
    // The request command older than REQUEST_MESSAGE.
    assert_eq!(ask(&mut world, 0, MavCmd::GET_HOME_POSITION, [f32::NAN; 7]), MavResult::ACCEPTED);
    assert_eq!(world.expect::<HomePosition>(0, millis(100)).z, 3.0);
    world.vehicle.has_home = false;
    assert_eq!(ask(&mut world, 0, MavCmd::GET_HOME_POSITION, [0.0; 7]), MavResult::DENIED);
    for (index, id) in [(0.0, Some(0)), (1.0, Some(1)), (f32::NAN, Some(0)), (2.0, None), (-1.0, None), (0.5, None)] {
        let expected = if id.is_some() { MavResult::ACCEPTED } else { MavResult::DENIED };
        assert_eq!(request(&mut world, BatteryStatus::ID, index), expected, "index {index}");
        world.run_for(millis(50));
        assert_eq!(world.gcs[0].take::<BatteryStatus>().map(|(_, status)| status.id), id, "index {index}");
    }
}

/// Q-2, D-3: requests on a backpressured link stay pending. Two with different indices do not fit, so the second one is
/// TEMPORARILY_REJECTED.
#[test]
fn backpressure_delays_requested_messages() {
    let mut world = World::new(Setup::<1>::new());
    world.run_for(millis(10));
    world.uarts[0].stall_writes_until(mavstack::Instant::from_millis(500));
    for (id, index) in [(Attitude::ID, 0.0), (BatteryStatus::ID, 1.0), (BatteryStatus::ID, 1.0)] {
        world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [id as f32, index, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    world.gcs[0].command_long(MavCmd::GET_MESSAGE_INTERVAL, [30.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.run_for(secs(1));
    let results: Vec<_> = world.gcs[0].all::<CommandAck>().into_iter().map(|(_, ack)| ack.result).collect();
    assert_eq!(results, [MavResult::ACCEPTED; 4]);
    let gcs = &world.gcs[0];
    let counts = (gcs.count_of::<Attitude>(), gcs.count_of::<BatteryStatus>(), gcs.count_of::<MessageInterval>());
    assert_eq!(counts, (1, 1, 1));
    world.uarts[0].stall_writes_until(mavstack::Instant::from_millis(2_000));
    for index in [1.0, 0.0] {
        world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [BatteryStatus::ID as f32, index, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    world.run_for(secs(2));
    assert_eq!(world.gcs[0].count_of::<BatteryStatus>(), 3, "index 0 has its own slot");
}

/// L-4: a high-latency link refuses requests. S-10: a v1 link refuses messages that v1 cannot carry.
#[test]
fn link_refuses_messages_that_it_cannot_carry() {
    let links = [
        LinkConfig::uart(2_400).with_class(LinkClass::HighLatency),
        LinkConfig::uart(57_600).with_version(TxVersion::V1),
        LinkConfig::uart(57_600),
    ];
    let mut world = World::new(Setup { links, ..Setup::new() });
    let id = OpenDroneIdLocation::ID as f32;
    let params = |id| [id, 100_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for command in [MavCmd::SET_MESSAGE_INTERVAL, MavCmd::GET_MESSAGE_INTERVAL] {
        assert_eq!(ask(&mut world, 0, command, params(30.0)), MavResult::DENIED);
    }
    let zero = |id| [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let results = [0, 1, 2].map(|link| ask(&mut world, link, MavCmd::REQUEST_MESSAGE, zero(id)));
    assert_eq!(results, [MavResult::DENIED, MavResult::DENIED, MavResult::ACCEPTED]);
    world.run_for(secs(2));
    let counts = [0, 1, 2].map(|link| world.gcs[link].count_of::<OpenDroneIdLocation>());
    assert_eq!(counts, [0, 0, 1]);
    assert!(world.gcs[0].received.iter().all(|frame| frame.header.id == CommandAck::ID));
    // The message is not streamed on a v1 link either, and MESSAGE_INTERVAL says so.
    for (link, result, told) in [(1, MavResult::DENIED, 0), (2, MavResult::ACCEPTED, 100_000)] {
        assert_eq!(ask(&mut world, link, MavCmd::SET_MESSAGE_INTERVAL, params(id)), result);
        assert_eq!(interval(&mut world, link, OpenDroneIdLocation::ID), told);
    }
}

/// every form of an interval, and the result.
#[test]
fn interval_is_set_clamped_or_refused() {
    let (yes, no) = (MavResult::ACCEPTED, MavResult::DENIED);
    let id = Attitude::ID as f32;
    for (params, result, told) in [
        ([id, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], yes, 20_000),
        // 30 Hz as MAVSDK encodes it.
        ([id, 33_333.332, f32::NAN, f32::NAN, 0.0, 0.0, f32::NAN], yes, 33_333),
        ([id, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0], yes, 1_000),
        ([id, 0.1, 0.0, 0.0, 0.0, 0.0, 2.0], yes, 1_000),
        ([id, 3e9, 0.0, 0.0, 0.0, 0.0, 0.0], yes, 60_000_000),
        ([id, f32::INFINITY, 0.0, 0.0, 0.0, 0.0, 0.0], yes, 60_000_000),
        ([id, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0], yes, -1),
        ([id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], yes, -1),
        ([id, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        ([id, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        ([id, f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        ([id, f32::NEG_INFINITY, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        ([id, 20_000.0, 1.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        ([id, 20_000.0, 0.0, 0.0, 0.0, 0.0, 3.0], no, -1),
        ([id + 0.5, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        ([f32::NAN, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        // A message that the vehicle lacks, an undefined one, and one that is only an answer.
        ([32.0, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        ([60_000.0, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
        ([148.0, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], no, -1),
    ] {
        let mut world = World::new(Setup::<1>::new());
        assert_eq!(ask(&mut world, 0, MavCmd::SET_MESSAGE_INTERVAL, params), result, "{params:?}");
        assert_eq!(interval(&mut world, 0, Attitude::ID), told, "{params:?}");
    }
}

/// an interval belongs to one link, whichever client uses it.
#[test]
fn interval_is_per_link() {
    let mut world = World::new(Setup::<2>::new());
    let params = [Attitude::ID as f32, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(ask(&mut world, 1, MavCmd::SET_MESSAGE_INTERVAL, params), MavResult::ACCEPTED);
    assert_eq!([0, 1].map(|link| interval(&mut world, link, Attitude::ID)), [-1, 20_000]);
}

/// the interval of a message that is not a stream is 0. An id that MESSAGE_INTERVAL cannot hold, or an invalid one, is
/// refused.
#[test]
fn interval_of_other_messages_is_zero() {
    let mut world = World::new(Setup::<1>::new());
    for id in [32, 148, 60_000, MissionCurrent::ID] {
        assert_eq!(interval(&mut world, 0, id), 0, "message {id}");
    }
    for id in [65_536.0, -1.0, 30.5, f32::NAN, f32::INFINITY] {
        let params = [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(ask(&mut world, 0, MavCmd::GET_MESSAGE_INTERVAL, params), MavResult::DENIED, "message {id}");
    }
    world.expect_no::<MessageInterval>(0, millis(100));
}

/// HEARTBEAT cannot be stopped and MISSION_CURRENT keeps its interval of a second; MESSAGE_INTERVAL says so.
#[test]
fn messages_of_the_stack_keep_their_intervals() {
    let mut world = World::<1, Tested<plan_memory!(mission: 4)>>::of(Setup::new());
    for id in [Heartbeat::ID, MissionCurrent::ID] {
        for (micros, result) in
            [(-1.0, MavResult::DENIED), (0.0, MavResult::ACCEPTED), (100_000.0, MavResult::ACCEPTED)]
        {
            let params = [id as f32, micros, 0.0, 0.0, 0.0, 0.0, 0.0];
            assert_eq!(ask(&mut world, 0, MavCmd::SET_MESSAGE_INTERVAL, params), result, "message {id}, {micros}");
        }
        assert_eq!(interval(&mut world, 0, id), 1_000_000, "message {id}");
    }
    world.gcs[0].forget();
    world.run_for(secs(10));
    assert_eq!((world.gcs[0].count_of::<Heartbeat>(), world.gcs[0].count_of::<MissionCurrent>()), (10, 10));
}

/// Q-1, H-5: HEARTBEAT can be requested while heartbeats are sent, also from a vehicle without streams; not on a high-latency
/// link. At most one extra heartbeat is sent every 200 ms (H-16).
#[test]
fn heartbeat_can_be_requested() {
    let satellite = LinkConfig::uart(2_400).with_class(LinkClass::HighLatency);
    let mut world = World::new(Setup { links: [LinkConfig::uart(57_600), satellite], ..Setup::new() });
    world.run_for(millis(1_500));
    world.gcs[0].forget();
    assert_eq!(request(&mut world, Heartbeat::ID, 0.0), MavResult::ACCEPTED);
    assert_eq!(request(&mut world, Heartbeat::ID, f32::NAN), MavResult::ACCEPTED);
    world.run_for(millis(300));
    let times: Vec<u64> = world.gcs[0].all::<Heartbeat>().into_iter().map(|(at, _)| at.as_millis()).collect();
    assert_eq!((times.len(), times[1] - times[0]), (2, 200), "{times:?}");
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0]);
    let no_such_target: CommandAck = world.expect(0, millis(100));
    assert_eq!(no_such_target.result, MavResult::DENIED);
    let zero = [0.0; 7];
    assert_eq!(ask(&mut world, 1, MavCmd::REQUEST_MESSAGE, zero), MavResult::DENIED);
    world.loop_runs = false;
    world.run_for(secs(1));
    world.gcs[0].forget();
    assert_eq!(request(&mut world, Heartbeat::ID, 0.0), MavResult::DENIED, "the flight loop hangs");
    world.run_for(secs(1));
    assert_eq!(world.gcs[0].count_of::<Heartbeat>(), 0);
}

/// MISSION_CURRENT can be requested only if the vehicle has missions.
#[test]
fn mission_current_can_be_requested() {
    let params = [MissionCurrent::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let mut world = World::<1, Tested<plan_memory!(mission: 4)>>::of(Setup::new());
    world.run_for(millis(100));
    world.gcs[0].forget();
    assert_eq!(ask(&mut world, 0, MavCmd::REQUEST_MESSAGE, params), MavResult::ACCEPTED);
    world.expect::<MissionCurrent>(0, millis(50));
    let mut world = World::<1>::new(Setup::new());
    assert_eq!(ask(&mut world, 0, MavCmd::REQUEST_MESSAGE, params), MavResult::DENIED);
}

/// O-6: an announced message is sent at once, once on every normal link, streamed there or not; not by satellite, and not while
/// it is unavailable.
#[test]
fn announced_message_is_sent_once_on_every_normal_link() {
    let satellite = LinkConfig::uart(2_400).with_class(LinkClass::HighLatency);
    let links = [LinkConfig::uart(57_600), LinkConfig::uart(57_600), satellite];
    let mut world = World::new(Setup { links, ..Setup::new() });
    world.run_for(millis(500));
    for (has_home, count) in [(false, 0), (true, 1), (true, 2)] {
        world.vehicle.has_home = has_home;
        let now = world.now();
        world.stack.announce::<HomePosition>();
        world.stack.announce::<HomePosition>();
        assert_eq!(world.stack.next_deadline(now), now, "a sleeping driver is woken");
        world.run_for(millis(20));
        let counts = [0, 1, 2].map(|link| world.gcs[link].count_of::<HomePosition>());
        assert_eq!(counts, [count, count, 0]);
    }
}

/// MESSAGE_INTERVAL carries the actual interval: longer while a radio's buffer is full.
#[test]
fn message_interval_carries_the_actual_interval() {
    let links = [LinkConfig::uart(115_200).with_streams(mavstack::config::StreamProfile::Onboard)];
    let mut world = World::new(Setup { links, ..Setup::new() });
    let radio = mavstack::Address::new(51, 68);
    for (txbuf, slower) in [(10, 60_000), (40, 80_000), (70, 80_000), (95, 60_000), (99, 20_000)] {
        for _ in 0..9 {
            // Some radios send a hundred a second. One in 100 ms counts.
            world.gcs[0].send_from(radio, &RadioStatus { txbuf, ..RadioStatus::default() });
            world.run_for(millis(10));
        }
        assert_eq!(interval(&mut world, 0, Attitude::ID), 20_000 + slower, "txbuf {txbuf}");
        assert_eq!(interval(&mut world, 0, Heartbeat::ID), 1_000_000, "it is not throttled");
        assert_eq!(interval(&mut world, 0, BatteryStatus::ID), -1, "off is off");
        world.run_for(millis(100));
    }
    world.run_for(secs(6));
    assert_eq!(interval(&mut world, 0, Attitude::ID), 20_000, "the radio reports nothing any more");
}
