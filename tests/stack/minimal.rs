//! A vehicle that implements only what it must: requests for everything else are refused, not left unanswered. Rules M-25, D-3,
//! C-1, C-23, C-32, Q-1, Q-4, Q-5, J-2, T-5, H-14.

use crate::support::*;
use mavstack::command::CommandPolicy;
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::{
    Command, Commands, Context, FlightMode, Instant, LinkId, Message, ModeRequest, Modes, Outcome, StackOf, Stream,
    Telemetry, Vehicle, VehicleState,
};

#[derive(mavstack::Stack)]
#[stack(vehicle: Minimal, links: 1, streams, modes, commands: { slots: 2 })]
struct Least;

#[derive(mavstack::Stack)]
#[stack(vehicle: Minimal, links: 1)]
struct Streamless;

#[derive(mavstack::Stack)]
#[stack(vehicle: Minimal, links: 1, streams, modes, texts: 0)]
struct Silent;

/// Declares a command, a mode and a message, and otherwise uses the traits' defaults.
#[derive(Default)]
struct Minimal;

impl Vehicle for Minimal {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false).with_mode(4))
    }
}

impl Commands for Minimal {
    const POLICIES: &'static [CommandPolicy] = &[CommandPolicy::new(rules::PREFLIGHT_CALIBRATION)];

    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        match command.id {
            MavCmd::PREFLIGHT_CALIBRATION => cx.start(),
            MavCmd::DO_JUMP => {
                assert!(cx.mission_item_reached(3));
                MavResult::ACCEPTED.into()
            }
            _ => MavResult::UNSUPPORTED.into(),
        }
    }
}

impl Modes for Minimal {
    const MODES: &'static [FlightMode] = &[FlightMode::new(4, "Hold")];

    fn set_mode(&mut self, _: &mut Context<'_>, _: &'static FlightMode, _: &ModeRequest) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Telemetry for Minimal {
    const STREAMS: &'static [Stream] = &[Stream::of::<Attitude>()];
}

fn world() -> World<1, Least> {
    World::of(Setup::new())
}

/// Sends a command and returns the answer.
fn result(world: &mut World<1, Least>, command: MavCmd, params: [f32; 7]) -> MavResult {
    world.gcs[0].forget();
    world.gcs[0].command_long(command, params);
    let ack: CommandAck = world.expect(0, millis(100));
    assert_eq!(ack.command, command);
    ack.result
}

/// M-25: every request about plans without memory is refused; other plan messages get no answer.
#[test]
fn without_plans_only_requests_are_answered() {
    let mut world = world();
    let (target_system, target_component) = (1, 1);
    let mission_type = MavMissionType::FENCE;
    let answers = |world: &mut World<1, Least>| {
        world.run_for(millis(100));
        let acks = world.gcs[0].all::<MissionAck>();
        world.gcs[0].forget();
        acks.into_iter().map(|(_, ack)| (ack.r#type, ack.mission_type)).collect::<Vec<_>>()
    };
    let refused = (MavMissionResult::UNSUPPORTED, mission_type);

    world.gcs[0].send(&MissionRequestList { target_system, target_component, mission_type });
    assert_eq!(answers(&mut world), [refused]);
    let count = MissionCount { target_system, target_component, mission_type, count: 3, ..MissionCount::default() };
    world.gcs[0].send(&count);
    assert_eq!(answers(&mut world), [refused]);
    world.gcs[0].send(&MissionClearAll { target_system, target_component, mission_type });
    assert_eq!(answers(&mut world), [refused]);

    let r#type = MavMissionResult::ACCEPTED;
    world.gcs[0].send(&MissionAck { target_system, target_component, mission_type, r#type, ..MissionAck::default() });
    world.gcs[0].send(&MissionItemInt { target_system, target_component, mission_type, ..MissionItemInt::default() });
    world.gcs[0].send(&MissionSetCurrent { target_system, target_component, seq: 0 });
    assert_eq!(answers(&mut world), []);
}

/// D-3: refusals without room on a backpressured link are counted; the others are sent once it recovers.
#[test]
fn refusals_stay_pending_on_a_backpressured_link() {
    let mut world = world();
    let until = world.now() + secs(2);
    world.uarts[0].stall_writes_until(until);
    let list = |mission_type| MissionRequestList { target_system: 1, target_component: 1, mission_type };
    for station in 0..40 {
        world.gcs[0].send_from(mavstack::Address::new(200 + station, 190), &list(MavMissionType::MISSION));
        world.run_for(millis(10));
    }
    let uncounted = world.stack.link_counters(LinkId(0)).expect("exists").no_answer_slot;
    assert!((1..40).contains(&uncounted), "{uncounted}");
    world.run_for(secs(4));
    assert_eq!(world.gcs[0].count_of::<MissionAck>() as u32, 40 - uncounted);
}

/// C-1, C-32: a mode that is declared, but never entered.
#[test]
fn mode_without_a_hook_is_unsupported() {
    let mut world = world();
    let params = [f32::from(MavModeFlag::CUSTOM_MODE_ENABLED.0), 4.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(result(&mut world, MavCmd::DO_SET_MODE, params), MavResult::UNSUPPORTED);
    world.gcs[0].forget();
    world.gcs[0].send(&pilot::set_mode(MavModeFlag::CUSTOM_MODE_ENABLED.0, 4));
    assert_eq!(world.expect::<CommandAck>(0, millis(100)).result, MavResult::UNSUPPORTED);
}

/// a message that the vehicle never fills is not available.
#[test]
fn message_without_a_hook_is_refused() {
    let mut world = world();
    let params = [Attitude::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_ne!(result(&mut world, MavCmd::REQUEST_MESSAGE, params), MavResult::ACCEPTED);
    world.run_for(secs(1));
    assert_eq!(world.gcs[0].count_of::<Attitude>(), 0);
}

/// a vehicle without streams accepts a request for HEARTBEAT's interval, keeps it unchanged, and cannot be told to
/// stop HEARTBEAT. For other messages the stack answers. Q-1: HEARTBEAT can be requested.
#[test]
fn vehicle_without_streams_keeps_its_heartbeat() {
    let (yes, no) = (MavResult::ACCEPTED, MavResult::DENIED);
    let mut world: World<1, Streamless> = World::of(Setup::new());
    for (command, params, result) in [
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, 100_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], yes),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, 0.0, f32::NAN, 0.0, 0.0, 0.0, f32::NAN], yes),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0], no),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0], no),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], no),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0], no),
        (MavCmd::SET_MESSAGE_INTERVAL, [30.0, 100_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], MavResult::UNSUPPORTED),
        (MavCmd::REQUEST_MESSAGE, [0.0; 7], yes),
    ] {
        world.gcs[0].command_long(command, params);
        assert_eq!(world.expect::<CommandAck>(0, millis(100)).result, result, "{command:?} {params:?}");
    }
    world.run_for(secs(1));
    world.gcs[0].forget();
    world.run_for(secs(10));
    assert_eq!(world.gcs[0].count_of::<Heartbeat>(), 10);
}

/// C-23: by default every station is in control, and a command cannot be cancelled.
#[test]
fn command_that_cannot_be_cancelled_continues() {
    let mut world = world();
    let params = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(result(&mut world, MavCmd::PREFLIGHT_CALIBRATION, params), MavResult::IN_PROGRESS);
    let command = MavCmd::PREFLIGHT_CALIBRATION;
    world.gcs[0].send(&CommandCancel { command, target_system: 1, target_component: 1 });
    world.run_for(secs(3));
    assert!(world.stack.long_commands_mut().is_running(command));
    assert!(world.gcs[0].all::<CommandAck>().iter().all(|(_, ack)| ack.result == MavResult::IN_PROGRESS));
    world.stack.long_commands_mut().finish(command, MavResult::ACCEPTED);
    world.gcs[0].forget();
    assert_eq!(world.expect::<CommandAck>(0, secs(1)).result, MavResult::ACCEPTED);
}

/// J-2: manual control has no effect without the service.
#[test]
fn manual_control_has_no_effect() {
    let mut world = world();
    world.gcs[0].send(&ManualControl { target: 1, x: 500, ..ManualControl::default() });
    world.run_for(millis(100));
    let counters = world.stack.rx_counters(LinkId(0)).expect("exists");
    assert_eq!((counters.frames, world.gcs[0].count_of::<CommandAck>()), (1, 0));
}

/// One call shows all counters: each field of those that have a getter, under its name.
#[test]
fn counters_are_shown_in_one_call() {
    let mut world = world();
    world.gcs[0].send(&ManualControl { target: 1, x: 500, ..ManualControl::default() });
    world.gcs[0].send_raw(&[0x55; 3]);
    world.run_for(secs(2));
    let mut shown = std::collections::BTreeMap::new();
    world.stack.counters(|counter| {
        let link = counter.link.map(|link| link.0);
        assert_eq!(shown.insert((link, counter.of, counter.name), counter.value), None, "shown once");
    });
    let rx = world.stack.rx_counters(LinkId(0)).expect("exists");
    let of_decoder = |name| shown[&(Some(0), "RxCounters", name)];
    assert_eq!((of_decoder("frames"), of_decoder("skipped")), (rx.frames, rx.skipped));
    assert_eq!((rx.frames, rx.skipped), (1, 3));
    let sent = world.stack.link_counters(LinkId(0)).expect("exists").tx_frames;
    assert!(sent >= 2);
    assert_eq!(shown[&(Some(0), "LinkCounters", "tx_frames")], sent);
    assert_eq!(shown[&(None, "StackCounters", "dropped_texts")], world.stack.dropped_texts());
    let fields = format!("{rx:?}").matches(": ").count();
    assert_eq!(shown.keys().filter(|(_, of, _)| *of == "RxCounters").count(), fields);
}

/// `default()` equals `new()`.
#[test]
fn default_equals_new() {
    use mavstack::__private::CommandSlots;
    #[cfg(feature = "signing")]
    use mavstack::__private::SigningStreams;
    fn shown<T: std::fmt::Debug>(default: T, new: T) {
        assert_eq!(format!("{default:?}"), format!("{new:?}"));
    }
    shown(mavstack::Pulse::default(), mavstack::Pulse::new());
    shown(CommandSlots::<2>::default(), CommandSlots::new());
    shown(mavstack::network::ForwardQueues::<2>::default(), mavstack::network::ForwardQueues::new());
    shown(mavstack::Text::<8>::default(), mavstack::Text::new(""));
    shown(mavstack::io::SerialQueues::<8, 8>::default(), mavstack::io::SerialQueues::new());
    #[cfg(feature = "signing")]
    shown(SigningStreams::<4>::default(), SigningStreams::new());
}

/// Without plans no item is reported as reached, whatever a hook says. `tests/api` shows that storage for what is not declared
/// does not compile.
#[test]
fn item_of_no_plan_is_not_reported() {
    let mut world = world();
    assert_eq!(result(&mut world, MavCmd::DO_JUMP, [0.0; 7]), MavResult::ACCEPTED);
    world.run_for(secs(2));
    assert_eq!(world.gcs[0].count_of::<MissionItemReached>(), 0);
}

/// T-5, H-14: a stack without room for texts sends none. It still handles another vehicle with our address.
#[test]
fn no_text_is_sent_without_room_for_texts() {
    let Setup { config, links, .. } = Setup::<1>::new();
    let mut stack = StackOf::<Silent>::new(config, links);
    let mut vehicle = Minimal;
    let mut gcs = Receiver::default();
    for step in 0..50 {
        let now = Instant::from_millis(step * 100);
        config.pulse.unwrap().tick();
        stack.poll(now, &mut vehicle);
        stack.text(now, MavSeverity::EMERGENCY, "never sent");
        let mut frame = [0; MAX_FRAME_LEN];
        let len = encode(&Heartbeat::default(), Version::V2, VEHICLE, 100, &mut frame).unwrap();
        assert_eq!(stack.receive(now, LinkId(0), &frame[..len], &mut vehicle), len);
        loop {
            let sent = stack.transmit(now, LinkId(0), &mut vehicle);
            if sent.is_empty() {
                break;
            }
            gcs.receive(sent);
            let len = sent.len();
            stack.transmitted(LinkId(0), len);
        }
    }
    assert_eq!(stack.link_counters(LinkId(0)).unwrap().own_address, 50);
    let ids: Vec<u8> = gcs.checked().iter().map(|raw| raw[7]).collect();
    assert_eq!(ids.iter().filter(|id| **id == Heartbeat::ID as u8).count(), 5);
    assert!(!ids.contains(&(Statustext::ID as u8)), "{ids:?}");
}
