//! A vehicle that implements no more than it has to: whoever asks it for what it leaves out is told so, and not left waiting.
//! Rules M-25, D-3, C-1, C-23, C-32, Q-1, J-2, T-5, H-14.

use crate::support::*;
use mavstack::command::CommandPolicy;
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::{
    Command, Commands, Context, FlightMode, Instant, LinkId, Message, ModeRequest, Modes, Outcome, Stream, Telemetry,
    Vehicle, VehicleState,
};

mavstack::stack! {
    struct Least for Minimal { links: 1, streams, modes, commands: { slots: 2 } }
}

mavstack::stack! {
    struct Silent for Minimal { links: 1, streams, modes, texts: 0 }
}

/// It declares a command, a mode and a message, and otherwise relies on the traits' defaults.
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
                assert!(cx.item_reached(3));
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

/// What a command is answered.
fn result(world: &mut World<1, Least>, command: MavCmd, params: [f32; 7]) -> MavResult {
    world.gcs[0].forget();
    world.gcs[0].command_long(command, params);
    let ack: CommandAck = world.expect(0, millis(100));
    assert_eq!(ack.command, command);
    ack.result
}

/// M-25: whatever is asked of plans that have no memory; what asks nothing gets no answer.
#[test]
fn without_plans_each_question_is_refused_and_nothing_else_is_answered() {
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

/// D-3: questions that a stalled line cannot be owed answers to are counted, and the others answered when it goes on.
#[test]
fn refusals_wait_for_the_line() {
    let mut world = world();
    let until = world.now().after(secs(2));
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

/// C-1, C-32: a mode that is declared and never entered.
#[test]
fn a_mode_that_nobody_enters_is_unsupported() {
    let mut world = world();
    let params = [f32::from(MavModeFlag::CUSTOM_MODE_ENABLED.0), 4.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(result(&mut world, MavCmd::DO_SET_MODE, params), MavResult::UNSUPPORTED);
    world.gcs[0].forget();
    world.gcs[0].send(&pilot::set_mode(MavModeFlag::CUSTOM_MODE_ENABLED.0, 4));
    assert_eq!(world.expect::<CommandAck>(0, millis(100)).result, MavResult::UNSUPPORTED);
}

/// there is no such message now, and there never is.
#[test]
fn a_message_that_nobody_fills_is_refused() {
    let mut world = world();
    let params = [Attitude::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_ne!(result(&mut world, MavCmd::REQUEST_MESSAGE, params), MavResult::ACCEPTED);
    world.run_for(secs(1));
    assert_eq!(world.gcs[0].count_of::<Attitude>(), 0);
}

/// C-23: everybody is in control, and a command that cannot be given up goes on.
#[test]
fn a_command_that_cannot_be_cancelled_goes_on() {
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

/// J-2: sticks are not for a vehicle that takes none.
#[test]
fn sticks_move_nothing() {
    let mut world = world();
    world.gcs[0].send(&ManualControl { target: 1, x: 500, ..ManualControl::default() });
    world.run_for(millis(100));
    let counters = world.stack.rx_counters(LinkId(0)).expect("exists");
    assert_eq!((counters.frames, world.gcs[0].count_of::<CommandAck>()), (1, 0));
}

/// Memory by its default is memory by its `new`.
#[test]
fn defaults_are_new() {
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

/// Without plans no item is reached, whatever a hook says. That storage for what is not declared does not compile, `tests/api`
/// shows.
#[test]
fn an_item_that_nobody_has_is_not_reported() {
    let mut world = world();
    assert_eq!(result(&mut world, MavCmd::DO_JUMP, [0.0; 7]), MavResult::ACCEPTED);
    world.run_for(secs(2));
    assert_eq!(world.gcs[0].count_of::<MissionItemReached>(), 0);
}

/// T-5, H-14: a stack without room for texts sends none, whatever happens; what else it does with a stranger who has our address
/// it does.
#[test]
fn without_room_for_texts_there_are_none() {
    let Setup { config, links, .. } = Setup::<1>::new();
    let mut stack = Silent::new(config, links);
    let mut vehicle = Minimal;
    let mut gcs = Receiver::default();
    for step in 0..50 {
        let now = Instant::from_millis(step * 100);
        config.pulse.unwrap().tick();
        stack.poll(now, &mut vehicle);
        stack.send_text(now, MavSeverity::EMERGENCY, "nobody hears this");
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
