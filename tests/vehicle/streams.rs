//! Streams: rules, D-4, H-8, L-4, D-1.

use crate::support::*;
use mavstack::config::{LinkClass, StreamProfile};
use mavstack::dialect::*;
use mavstack::{Duration, Fill, Instant, LinkConfig, Message, Stream, Telemetry, Vehicle, VehicleState};
use proptest::prelude::*;

const ONBOARD: StreamProfile = StreamProfile::Onboard;

fn set_interval<const N: usize>(world: &mut World<N>, link: usize, id: u32, micros: f32) {
    world.gcs[link].command_long(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, micros, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(world.expect::<CommandAck>(link, millis(1_000)).result, MavResult::ACCEPTED);
}

fn request_stream<const N: usize>(world: &mut World<N>, group: MavDataStream, rate: u16, start_stop: u8) {
    world.gcs[0].send(&RequestDataStream {
        req_message_rate: rate,
        target_system: 1,
        target_component: 1,
        req_stream_id: group,
        start_stop,
    });
    world.run_for(millis(10));
}

/// Returns how many ATTITUDE, GLOBAL_POSITION_INT, SYS_STATUS and BATTERY_STATUS are received within `time`. It settles first,
/// because a new link is taken for busy.
fn counts<const N: usize>(world: &mut World<N>, link: usize, time: Duration) -> [usize; 4] {
    world.run_for(millis(150));
    world.gcs[link].forget();
    world.run_for(time);
    let gcs = &world.gcs[link];
    [
        gcs.count_of::<Attitude>(),
        gcs.count_of::<GlobalPositionInt>(),
        gcs.count_of::<SysStatus>(),
        gcs.count_of::<BatteryStatus>(),
    ]
}

/// Each link has the default streams of its profile; L-4: a high-latency link has none, whatever its profile.
#[test]
fn only_normal_links_stream_by_their_profiles() {
    let links = [
        LinkConfig::uart(115_200).with_streams(ONBOARD),
        LinkConfig::uart(115_200),
        LinkConfig::uart(115_200).with_streams(StreamProfile::Off),
        LinkConfig::uart(115_200).with_streams(ONBOARD).with_class(LinkClass::HighLatency),
    ];
    let mut world = World::new(Setup { links, ..Setup::new() });
    assert_eq!(counts(&mut world, 0, secs(10)), [500, 100, 20, 0]);
    for link in 1..4 {
        let others = world.gcs[link].received.iter().filter(|frame| frame.header.id != Heartbeat::ID).count();
        assert_eq!(others, 0, "link {link}");
    }
    assert_eq!(world.gcs[3].received.len(), 0);
}

/// an interval is set, stopped, and restored to its default.
#[test]
fn interval_takes_effect() {
    let links = [LinkConfig::uart(115_200).with_streams(ONBOARD); 2];
    let mut world = World::new(Setup { links, ..Setup::new() });
    set_interval(&mut world, 0, Attitude::ID, -1.0);
    set_interval(&mut world, 0, GlobalPositionInt::ID, 40_000.0);
    set_interval(&mut world, 0, BatteryStatus::ID, 250_000.0);
    assert_eq!(counts(&mut world, 0, secs(10)), [0, 250, 20, 40]);
    assert_eq!(counts(&mut world, 1, secs(10)), [500, 100, 20, 0], "the other link has its own");
    set_interval(&mut world, 0, Attitude::ID, 0.0);
    set_interval(&mut world, 0, BatteryStatus::ID, 0.0);
    assert_eq!(counts(&mut world, 0, secs(10)), [500, 250, 20, 0]);
}

/// Sends commands that wait on the same link, and returns the answers.
fn results(world: &mut World<1>, commands: &[(MavCmd, [f32; 2])]) -> Vec<MavResult> {
    let stalled_until = world.now() + millis(50);
    world.uarts[0].stall_writes_until(stalled_until);
    for &(command, [param1, param2]) in commands {
        world.gcs[0].command_long(command, [param1, param2, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    world.run_for(millis(200));
    world.gcs[0].all::<CommandAck>().into_iter().map(|(_, ack)| ack.result).collect()
}

/// one message with an index can be pending: another index is TEMPORARILY_REJECTED, the same one is sent once.
#[test]
fn one_message_with_an_index_can_be_pending() {
    const DONE: MavResult = MavResult::ACCEPTED;
    const LATER: MavResult = MavResult::TEMPORARILY_REJECTED;
    let battery = |index: f32| (MavCmd::REQUEST_MESSAGE, [BatteryStatus::ID as f32, index]);
    let location = |index: f32| (MavCmd::REQUEST_MESSAGE, [OpenDroneIdLocation::ID as f32, index]);
    let mut world = World::new(Setup::<1>::new());
    world.run_for(millis(10));
    assert_eq!(
        results(&mut world, &[battery(1.0), location(1.0), battery(1.0), battery(0.0)]),
        [DONE, LATER, DONE, DONE]
    );
    let mut packs: Vec<u8> = world.gcs[0].all::<BatteryStatus>().into_iter().map(|(_, status)| status.id).collect();
    packs.sort();
    assert_eq!((packs, world.gcs[0].count_of::<OpenDroneIdLocation>()), (vec![0, 1], 0));
    world.gcs[0].forget();
    assert_eq!(results(&mut world, &[location(1.0), location(2.0), location(1.0)]), [DONE, LATER, DONE]);
    assert_eq!(world.gcs[0].count_of::<OpenDroneIdLocation>(), 1);
}

/// pending requests for intervals are limited; a further one is TEMPORARILY_REJECTED, not left unanswered.
#[test]
fn interval_requests_without_room_are_rejected_for_now() {
    const IDS: [u32; 5] = [Attitude::ID, GlobalPositionInt::ID, SysStatus::ID, BatteryStatus::ID, SystemTime::ID];
    // An answer takes about 20 ms.
    let down = Wire { bytes_per_second: 1_000, tx_fifo: 4, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }];
    let mut world = World::new(Setup { lines, ..Setup::<1>::new() });
    world.run_for(millis(100));
    for (number, id) in IDS.into_iter().enumerate() {
        if number == 4 {
            // An answer was sent, and freed its slot for this one; the MESSAGE_INTERVALs follow all answers.
            world.run_for(millis(40));
        }
        world.gcs[0].command_long(MavCmd::GET_MESSAGE_INTERVAL, [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    world.run_for(millis(400));
    let acks: Vec<_> = world.gcs[0].all::<CommandAck>().into_iter().map(|(_, ack)| ack.result).collect();
    let [done, later] = [MavResult::ACCEPTED, MavResult::TEMPORARILY_REJECTED];
    assert_eq!(acks, [done, done, done, done, later]);
    let told: Vec<_> = world.gcs[0].all::<MessageInterval>();
    let told: Vec<_> = told.into_iter().map(|(_, interval)| u32::from(interval.message_id)).collect();
    assert_eq!(told, IDS[..4]);
}

/// without declared modes CURRENT_MODE is not a stream.
#[test]
fn current_mode_needs_declared_modes() {
    let mut world = World::new(Setup::<1>::new());
    let ask = |world: &mut World<1>, command, id, micros| {
        world.gcs[0].command_long(command, [id as f32, micros, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.expect::<CommandAck>(0, millis(100)).result
    };
    assert_eq!(ask(&mut world, MavCmd::SET_MESSAGE_INTERVAL, CurrentMode::ID, 500_000.0), MavResult::DENIED);
    for (id, micros) in [(CurrentMode::ID, 0), (Heartbeat::ID, 1_000_000)] {
        assert_eq!(ask(&mut world, MavCmd::GET_MESSAGE_INTERVAL, id, 0.0), MavResult::ACCEPTED);
        let told: MessageInterval = world.expect(0, millis(100));
        assert_eq!((u32::from(told.message_id), told.interval_us), (id, micros));
    }
}

/// A vehicle that fills in another message than the requested one.
#[derive(Default)]
struct Mistaken;

impl Vehicle for Mistaken {
    fn state(&self) -> Option<VehicleState> {
        TestVehicle::new().state
    }
}

impl Telemetry for Mistaken {
    const STREAMS: &'static [Stream] = &[Stream::of::<Attitude>().onboard(millis(20)), Stream::of::<SysStatus>()];

    fn fill(&mut self, _: u32, out: &mut Fill<'_>) -> bool {
        out.put(&SysStatus::default())
    }
}

without_commands!(Mistaken);

#[derive(mavstack::Stack)]
#[stack(vehicle: Mistaken, links: 1, streams)]
struct OfTheMistaken;

/// a message other than the requested one is not sent, neither as a stream nor on request; the request is refused. A stream that
/// was due and never filled is listed and counted.
#[test]
fn wrong_message_of_the_vehicle_is_not_sent() {
    let links = [LinkConfig::uart(115_200).with_streams(ONBOARD)];
    let mut world = World::<1, OfTheMistaken>::of(Setup { links, ..Setup::new() });
    for (id, result) in [(Attitude::ID, MavResult::DENIED), (SysStatus::ID, MavResult::ACCEPTED)] {
        world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(world.expect::<CommandAck>(0, millis(100)).result, result);
    }
    world.run_for(secs(1));
    assert_eq!((world.gcs[0].count_of::<Attitude>(), world.gcs[0].count_of::<SysStatus>()), (0, 1));
    assert_eq!(world.stack.streams_never_filled().map(Stream::id).collect::<Vec<_>>(), [Attitude::ID]);
    let mut counted = None;
    world.stack.counters(|counter| {
        if counter.name == "never_filled" {
            counted = Some(counter.value);
        }
    });
    assert_eq!(counted, Some(1));
    assert_eq!(World::new(Setup::<1>::new()).stack.streams_never_filled().count(), 0, "none was due");
}

/// groups; ALL means every message of a group; 0 or a rate of 0 stops; anything else is ignored.
#[test]
fn data_stream_requests_set_groups() {
    let mut world = World::new(Setup::<1>::new());
    request_stream(&mut world, MavDataStream::ALL, 4, 1);
    assert_eq!(counts(&mut world, 0, secs(10)), [40, 40, 40, 0], "BATTERY_STATUS is in no group");
    request_stream(&mut world, MavDataStream::EXTRA1, 20, 1);
    request_stream(&mut world, MavDataStream::POSITION, 7, 0);
    assert_eq!(counts(&mut world, 0, secs(10)), [200, 0, 40, 0]);
    request_stream(&mut world, MavDataStream::EXTRA1, 50, 2);
    request_stream(&mut world, MavDataStream::RAW_SENSORS, 50, 1);
    request_stream(&mut world, MavDataStream(99), 50, 1);
    assert_eq!(counts(&mut world, 0, secs(10)), [200, 0, 40, 0], "invalid requests change nothing");
    request_stream(&mut world, MavDataStream::ALL, 0, 1);
    assert_eq!(counts(&mut world, 0, secs(10)), [0; 4]);
    assert_eq!(world.gcs[0].count_of::<CommandAck>(), 0, "REQUEST_DATA_STREAM is not answered");
    assert_eq!(world.vehicle.calls, [], "the vehicle does not see it");
}

/// H-8: by option, streams wait for a peer on their own link and stop when it times out; heartbeats and answers do not.
#[test]
fn streams_wait_for_a_peer_by_option() {
    let mut setup = Setup { links: [LinkConfig::uart(115_200).with_streams(ONBOARD); 2], ..Setup::new() };
    setup.config.streams_wait_for_peer = true;
    let mut world = World::new(setup);
    world.gcs[1].heartbeat_period = Some(secs(1));
    assert_eq!(counts(&mut world, 0, secs(10)), [0; 4]);
    assert!(world.gcs[0].count_of::<Heartbeat>() >= 9);
    assert!(world.gcs[1].count_of::<Attitude>() >= 495);
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [Attitude::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.expect::<Attitude>(0, millis(100));
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.run_for(millis(100));
    assert_eq!(counts(&mut world, 0, secs(10)), [500, 100, 20, 0]);
    world.gcs[0].heartbeat_period = None;
    world.run_for(secs(6));
    assert_eq!(counts(&mut world, 0, secs(2)), [0; 4]);
    // Waiting streams do not wake the driver.
    let now = world.now();
    assert!(world.stack.next_deadline(now) > now);
}

/// RADIO_STATUS with a full buffer throttles streams, but no heartbeat and no answer. It expires after five seconds.
#[test]
fn radio_with_a_full_buffer_throttles_streams() {
    let links = [LinkConfig::uart(115_200).with_streams(ONBOARD)];
    let mut world = World::new(Setup { links, ..Setup::new() });
    world.run_for(millis(100));
    let radio = mavstack::Address::new(51, 68);
    world.gcs[0].send_from(radio, &RadioStatus { txbuf: 10, ..RadioStatus::default() });
    world.run_for(millis(100));
    let [attitude, position, ..] = counts(&mut world, 0, secs(4));
    assert!((48..=52).contains(&attitude) && (24..=26).contains(&position), "{attitude} {position}");
    assert_eq!(world.gcs[0].count_of::<Heartbeat>(), 4);
    world.run_for(secs(1));
    assert_eq!(counts(&mut world, 0, secs(4))[0], 200);
    // The vehicle sees the message too.
    let is_radio = |call: &Call| matches!(call, Call::Message { id: RadioStatus::ID, .. });
    assert_eq!(world.vehicle.calls.iter().filter(|call| is_radio(call)).count(), 1);
}

/// Q-8, D-4: streams exceed the link's rate. The link keeps to its rate, every stream gets its turn, and heartbeats and answers
/// are late by at most a frame and a poll, although the line's buffer holds a second's worth.
#[test]
fn overload_delays_only_streams() {
    for baud in [9_600, 57_600] {
        let links = [LinkConfig::uart(baud).with_streams(ONBOARD)];
        let lines = [LineConfig::radio(baud, Duration::ZERO)];
        let mut world = World::new(Setup { links, lines, ..Setup::new() });
        for id in [Attitude::ID, GlobalPositionInt::ID, SysStatus::ID, BatteryStatus::ID] {
            set_interval(&mut world, 0, id, 1_000.0);
        }
        world.run_for(secs(1));
        world.gcs[0].forget();
        // The longest stream is 54 bytes, an answer 22, a heartbeat 21; another answer or heartbeat may come first.
        let patience = 2 + (54 + 22 + 21) * 10_000 / u64::from(baud);
        let begun = world.now();
        for round in 0..200 {
            world.run_for(millis(37 + round % 13));
            let asked = world.now();
            world.gcs[0].command_long(MavCmd::NAV_LAND, [0.0; 7]);
            // The uplink takes time too.
            let up = 45 * 10_000 / u64::from(baud) + 1;
            world.expect::<CommandAck>(0, millis(up + patience));
            assert!((world.now() - asked).as_millis() <= up + patience);
        }
        let heartbeats: Vec<_> = world.gcs[0].all::<Heartbeat>().into_iter().map(|(at, _)| at).collect();
        for pair in heartbeats.windows(2) {
            let late = (pair[1] - pair[0]).as_millis().abs_diff(1_000);
            assert!(late <= patience, "{baud}: a heartbeat {late} ms off");
        }
        let bytes: usize = world.gcs[0].received.iter().map(|frame| frame.payload.len() + 12).sum();
        let seconds = (world.now() - begun).as_micros() as f64 / 1e6;
        let share = bytes as f64 / (seconds * f64::from(baud) / 10.0);
        assert!((0.8..=1.01).contains(&share), "{baud}: {share} of the line is used");
        let [a, b, c, d] = [Attitude::ID, GlobalPositionInt::ID, SysStatus::ID, BatteryStatus::ID]
            .map(|id| world.gcs[0].received.iter().filter(|frame| frame.header.id == id).count());
        let (least, most) = (a.min(b).min(c).min(d), a.max(b).max(c).max(d));
        assert!(most - least <= 1, "{baud}: {a} {b} {c} {d}");
    }
}

/// D-4: an upload is not slowed down by streams that fill the rest of the link.
#[test]
fn upload_has_precedence_over_streams() {
    let run = |streams| {
        let links = [LinkConfig::uart(57_600).with_streams(streams)];
        let lines = [LineConfig::radio(57_600, millis(5))];
        let mut world =
            World::<1, Tested<mavstack::plan_memory!(mission: 100)>>::of(Setup { links, lines, ..Setup::new() });
        world.run_for(secs(1));
        let start = world.now();
        let ack = world.upload(0, &plan(100, 0)).unwrap();
        assert_eq!(ack.r#type, MavMissionResult::ACCEPTED);
        (world.now() - start).as_millis()
    };
    let (alone, with_streams) = (run(StreamProfile::Off), run(ONBOARD));
    // At most one frame of 54 bytes (9 ms) is in transmission when a request becomes due.
    assert!(with_streams <= alone + 100 * 10, "{with_streams} ms, alone {alone} ms");
}

/// A driver that sleeps until the next deadline sends the same as one that polls every millisecond.
#[test]
fn sleeping_driver_keeps_the_rates() {
    let links = [LinkConfig::uart(57_600).with_streams(ONBOARD)];
    let mut world = World::new(Setup { links, ..Setup::new() });
    world.run_for(millis(200));
    world.gcs[0].forget();
    let passes = world.sleep_for(secs(100));
    let gcs = &world.gcs[0];
    let counts = [gcs.count_of::<Attitude>(), gcs.count_of::<GlobalPositionInt>(), gcs.count_of::<SysStatus>()];
    for (count, wanted) in counts.into_iter().zip([5_000i32, 1_000, 200]) {
        assert!((count as i32 - wanted).abs() <= 1, "{counts:?}");
    }
    assert!(passes < 13_000, "{passes} passes for 6,300 frames");
}

proptest! {
    #![proptest_config(cases(12))]

    /// over 100 s the average rate is within 1 % of MESSAGE_INTERVAL, at irregular polls.
    #[test]
    fn average_rate_is_kept_over_jittered_polls(
        micros in 5_000u32..400_000,
        step in 500u64..3_000,
        jitter in 0u64..3_000,
        seed: u64,
        start in 0u64..1 << 33,
    ) {
        let setup = Setup {
            step: Duration::from_micros(step),
            jitter: Duration::from_micros(jitter),
            seed,
            start: Instant::from_micros(start),
            ..Setup::<1>::new()
        };
        let mut world = World::new(setup);
        set_interval(&mut world, 0, Attitude::ID, micros as f32);
        world.gcs[0].forget();
        world.run_for(secs(100));
        let count = world.gcs[0].count_of::<Attitude>() as f64;
        let wanted = 100e6 / f64::from(micros);
        prop_assert!((count - wanted).abs() <= wanted * 0.01 + 1.0, "{count} in 100 s, not {wanted}");
    }
}
