//! Several components in one firmware: rules K-10, K-11, and H-1, H-5, C-3, Q-2, Q-4, R-1, R-2, S-15, S-16 for each of them.

use std::collections::BTreeMap;

use crate::support::*;
use mavstack::command::CommandPolicy;
use mavstack::config::{StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::message::ComponentId;
use mavstack::{
    Address, Command, CommandClient, CommandReply, CommandRule, Commands, Component, Components, Context, Fill,
    LinkConfig, LinkId, Message, Outcome, OutgoingCommand, Peer, PlanChange, Plans, Progress, Recipient, Stream,
    Telemetry, Vehicle, VehicleState,
};

const GIMBAL: Address = Address::new(1, 154);
const CAMERA: Address = Address::new(1, 100);
/// A component of the same system that is not in this firmware.
const COMPANION: Address = Address::new(1, 191);

const POINT: u16 = 1;
const CALIBRATE: u16 = 2;
const ASK: u16 = 3;
const ELSEWHERE: u16 = 4;
const RELAY: u16 = 5;
const SERVO: u16 = 6;
const OLD: u16 = 7;
/// Tokens from here on are commands that nobody answers.
const UNANSWERED: u16 = 100;

/// An autopilot with a gimbal and a camera of its own.
#[derive(Default)]
struct Copter {
    is_gimbal_stuck: bool,
    /// The commands that the hooks got: those of the autopilot, and those of the other components.
    own: Vec<MavCmd>,
    others: Vec<(u8, MavCmd, u8)>,
    replies: Vec<(u16, CommandReply)>,
}

impl Vehicle for Copter {
    fn state(&self) -> Option<VehicleState> {
        TestVehicle::new().state
    }
}

impl Commands for Copter {
    const POLICIES: &'static [CommandPolicy] =
        &[CommandPolicy::new(rules::DO_REPEAT_SERVO).once(), CommandPolicy::new(rules::DO_REPEAT_RELAY).once()];

    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        self.own.push(command.id);
        if command.id == MavCmd::DO_WINCH { cx.start() } else { MavResult::ACCEPTED.into() }
    }

    fn cancel_command(&mut self, _: &mut Context<'_>, command: MavCmd, _: Peer) -> bool {
        command == MavCmd::DO_WINCH
    }
}

impl Components for Copter {
    const COMPONENTS: &'static [Component] =
        &[Component::new(GIMBAL.component, MavType::GIMBAL), Component::new(CAMERA.component, MavType::CAMERA)];

    fn component_state(&self, component: ComponentId) -> Option<MavState> {
        let is_stuck = component == GIMBAL.component && self.is_gimbal_stuck;
        (!is_stuck).then_some(MavState::STANDBY)
    }

    fn component_command(&mut self, cx: &mut Context<'_>, component: ComponentId, command: &Command) -> Outcome {
        self.others.push((component.wire(), command.id, command.from.address.component.wire()));
        match command.id {
            MavCmd::DO_WINCH | MavCmd::DO_REPEAT_RELAY => cx.start(),
            MavCmd::DO_GRIPPER => MavResult::DENIED.into(),
            _ => MavResult::ACCEPTED.into(),
        }
    }
}

impl CommandClient for Copter {
    fn command_for(&mut self, token: u16) -> Option<OutgoingCommand> {
        match token {
            ASK => Some(OutgoingCommand::request_message::<GimbalDeviceInformation>(0)),
            CALIBRATE => Some(OutgoingCommand::long(MavCmd::DO_WINCH, [0.0; 7])),
            RELAY => Some(OutgoingCommand::long(MavCmd::DO_REPEAT_RELAY, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0])),
            SERVO => Some(OutgoingCommand::long(MavCmd::DO_REPEAT_SERVO, [1.0, 1_500.0, 3.0, 4.0, 0.0, 0.0, 0.0])),
            OLD => Some(OutgoingCommand::long(MavCmd::REQUEST_CAMERA_INFORMATION, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
            UNANSWERED.. => Some(OutgoingCommand::long(MavCmd(31_000 + token), [0.0; 7])),
            _ => Some(OutgoingCommand::long(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, [-90.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
        }
    }

    fn command_answered(&mut self, _: &mut Context<'_>, token: u16, reply: CommandReply) {
        self.replies.push((token, reply));
    }
}

impl Plans for Copter {
    const MISSION_COMMANDS: &'static [CommandRule] = &[];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Telemetry for Copter {
    const STREAMS: &'static [Stream] = &[
        Stream::of::<BatteryStatus>().every(millis(500)),
        Stream::of::<BatteryStatus>().of_component(GIMBAL.component).every(millis(250)),
        Stream::of::<GimbalDeviceAttitudeStatus>().of_component(GIMBAL.component),
    ];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        match id {
            // The number of the battery tells who was asked.
            BatteryStatus::ID => out.put(&BatteryStatus { id: out.component().wire(), ..BatteryStatus::UNKNOWN }),
            GimbalDeviceAttitudeStatus::ID => out.put(&GimbalDeviceAttitudeStatus::default()),
            _ => false,
        }
    }
}

#[derive(mavstack::Stack)]
#[stack(
    vehicle: Copter,
    links: 2,
    plans: { mission: 4 },
    streams,
    commands: { slots: 3 },
    command_client: { slots: 12 },
    components,
    forwarding,
)]
struct Manifold;

type Sky = World<2, Manifold>;

fn sky() -> Sky {
    let uart = LinkConfig::uart(115_200).with_streams(StreamProfile::Off).with_own_system(true);
    let mut world = Sky::of(Setup { links: [uart; 2], ..Setup::new() });
    world.run_for(millis(100));
    world
}

/// Returns what a link has sent of message `M`: from which component, with which sequence number, and the message.
fn sent<M: Message>(world: &Sky, link: usize) -> Vec<(u8, u8, M)> {
    let frames = world.gcs[link].received.iter();
    frames.filter_map(|frame| Some((frame.header.source.component.wire(), frame.header.seq, frame.decode()?))).collect()
}

/// Sends a command to a component of the vehicle's system, and returns who answered it, and what.
fn command(world: &mut Sky, to: u8, id: MavCmd, params: [f32; 7]) -> Vec<(u8, MavResult)> {
    world.gcs[0].forget();
    let message = CommandLong { target_component: to, ..world.gcs[0].long(id, params) };
    world.gcs[0].send(&message);
    world.run_for(millis(50));
    sent::<CommandAck>(world, 0).into_iter().map(|(from, _, ack)| (from, ack.result)).collect()
}

fn request<M: Message>(world: &mut Sky, to: u8) -> Vec<(u8, MavResult)> {
    command(world, to, MavCmd::REQUEST_MESSAGE, [M::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
}

/// K-10, H-1: each component has a heartbeat of its own, once a second, on each link.
#[test]
fn each_component_has_heartbeats() {
    let mut world = sky();
    world.run_for(secs(10));
    for link in 0..2 {
        let beats = sent::<Heartbeat>(&world, link);
        for (from, r#type, autopilot) in [
            (1, MavType::QUADROTOR, MavAutopilot::GENERIC),
            (154, MavType::GIMBAL, MavAutopilot::INVALID),
            (100, MavType::CAMERA, MavAutopilot::INVALID),
        ] {
            let its: Vec<_> = beats.iter().filter(|(sender, ..)| *sender == from).map(|(.., beat)| beat).collect();
            let state = MavState::STANDBY;
            assert!(
                its.iter().all(|beat| (beat.r#type, beat.autopilot, beat.system_status) == (r#type, autopilot, state))
            );
            assert_eq!(its.len(), 11, "component {from}");
        }
    }
}

/// K-10: components are left out only if the vehicle declares that they may be.
#[test]
fn components_stay_if_they_are_not_optional() {
    let mut world = sky();
    world.stack.leave_out_components();
    world.gcs[0].forget();
    world.run_for(secs(2));
    let from: Vec<_> = sent::<Heartbeat>(&world, 0).into_iter().map(|(from, ..)| from).collect();
    assert_eq!(from, [1, 154, 100, 1, 154, 100]);
}

/// K-10, S-16: each component counts its own frames on each link, so no receiver sees a gap.
#[test]
fn each_component_has_sequence_numbers() {
    let mut world = sky();
    let mut next = BTreeMap::<u8, u8>::new();
    let mut frames = 0;
    for number in 0..600 {
        let to = [1, 154, 154, 100][number % 4];
        world.gcs[0].forget();
        let message = CommandLong { target_component: to, ..world.gcs[0].long(MavCmd::USER_1, [0.0; 7]) };
        world.gcs[0].send(&message);
        world.run_for(millis(20));
        for frame in &world.gcs[0].received {
            frames += 1;
            let from = frame.header.source.component.wire();
            if let Some(next) = next.get(&from) {
                assert_eq!(frame.header.seq, *next, "component {from}");
            }
            next.insert(from, frame.header.seq.wrapping_add(1));
        }
    }
    assert!(frames > 600 && next.len() == 3);
}

/// K-10, H-5: the heartbeats of all components stop with the flight loop, and one component's with its fault.
#[test]
fn heartbeats_stop() {
    let mut world = sky();
    world.vehicle.is_gimbal_stuck = true;
    world.run_for(millis(200));
    world.gcs[0].forget();
    world.run_for(secs(3));
    let from = |world: &Sky| sent::<Heartbeat>(world, 0).into_iter().map(|(from, ..)| from).collect::<Vec<_>>();
    assert_eq!(from(&world), [1, 100, 1, 100, 1, 100]);
    assert_eq!(request::<Heartbeat>(&mut world, 154), [(154, MavResult::DENIED)]);
    assert_eq!(request::<Heartbeat>(&mut world, 100), [(100, MavResult::ACCEPTED)]);
    assert_eq!(from(&world), [100]);

    world.loop_runs = false;
    world.run_for(secs(2));
    world.gcs[0].forget();
    world.run_for(secs(10));
    assert_eq!(from(&world), Vec::<u8>::new());
    assert_eq!(request::<Heartbeat>(&mut world, 100), [(100, MavResult::DENIED)]);
}

/// K-10, C-3: a command reaches the component to which it is addressed, and that one answers. One to all is the autopilot's.
#[test]
fn each_component_has_commands() {
    let mut world = sky();
    assert_eq!(command(&mut world, 154, MavCmd::USER_1, [0.0; 7]), [(154, MavResult::ACCEPTED)]);
    assert_eq!(command(&mut world, 100, MavCmd::DO_GRIPPER, [0.0; 7]), [(100, MavResult::DENIED)]);
    assert_eq!(command(&mut world, 1, MavCmd::USER_2, [0.0; 7]), [(1, MavResult::ACCEPTED)]);
    assert_eq!(command(&mut world, 0, MavCmd::USER_3, [0.0; 7]), [(1, MavResult::ACCEPTED)]);
    assert_eq!(command(&mut world, 191, MavCmd::USER_4, [0.0; 7]), []);
    assert_eq!(world.vehicle.own, [MavCmd::USER_2, MavCmd::USER_3]);
    assert_eq!(world.vehicle.others, [(154, MavCmd::USER_1, 190), (100, MavCmd::DO_GRIPPER, 190)]);
}

/// K-10: the autopilot's services are not those of the other components.
#[test]
fn other_components_have_no_plans() {
    let mut world = sky();
    let list = MissionRequestList { target_system: 1, target_component: 154, ..MissionRequestList::default() };
    world.gcs[0].send(&list);
    let protocol = request::<ProtocolVersion>(&mut world, 154);
    assert_eq!(protocol, [(154, MavResult::ACCEPTED)], "the hook's answer");
    world.run_for(secs(1));
    assert_eq!((sent::<MissionCount>(&world, 0), sent::<ProtocolVersion>(&world, 0)), (vec![], vec![]));
    world.gcs[0].send(&MissionRequestList { target_component: 1, ..list });
    world.run_for(secs(1));
    assert_eq!(sent::<MissionCount>(&world, 0).len(), 1);
}

/// K-10, C-20 to C-23: a component's long-running command is reported and cancelled at its address.
#[test]
fn long_commands_are_answered_by_their_component() {
    let mut world = sky();
    assert_eq!(command(&mut world, 154, MavCmd::DO_WINCH, [0.0; 7]), [(154, MavResult::IN_PROGRESS)]);
    world.stack.long_commands_mut().progress(MavCmd::DO_WINCH, 40);
    world.gcs[0].forget();
    world.run_for(millis(500));
    let progress = sent::<CommandAck>(&world, 0);
    assert!(progress.iter().all(|(from, ..)| *from == 154) && progress.iter().any(|(.., ack)| ack.progress == 40));
    world.gcs[0].forget();
    let cancel = CommandCancel { command: MavCmd::DO_WINCH, target_system: 1, target_component: 154 };
    world.gcs[0].send(&CommandCancel { target_component: 191, ..cancel });
    world.run_for(millis(50));
    assert!(world.stack.long_commands().is_running(MavCmd::DO_WINCH), "it was another component's");
    world.gcs[0].send(&cancel);
    world.run_for(millis(50));
    let [.., (from, _, ack)] = &sent::<CommandAck>(&world, 0)[..] else { panic!() };
    assert_eq!((*from, ack.result), (154, MavResult::CANCELLED));
}

/// K-10, C-12: the same command to two components is no duplicate.
#[test]
fn equal_commands_to_two_components_are_two_commands() {
    let mut world = sky();
    let params = [1.0, 1_500.0, 1.0, 1.0, 0.0, 0.0, 0.0];
    for to in [154, 100, 154] {
        command(&mut world, to, MavCmd::DO_REPEAT_SERVO, params);
    }
    let got: Vec<_> = world.vehicle.others.iter().map(|(to, ..)| *to).collect();
    assert_eq!(got, [154, 100], "the third is a retransmission of the first");
}

/// K-10, Q-2, Q-4: each component has streams and messages on request of its own.
#[test]
fn each_component_has_streams() {
    let mut world = sky();
    let batteries = |world: &Sky| {
        let all = sent::<BatteryStatus>(world, 0);
        assert!(all.iter().all(|(from, _, battery)| *from == battery.id), "the hook learns who sends");
        [1, 154].map(|who| all.iter().filter(|(from, ..)| *from == who).count())
    };
    assert_eq!(request::<BatteryStatus>(&mut world, 154), [(154, MavResult::ACCEPTED)]);
    assert_eq!(batteries(&world), [0, 1]);
    assert_eq!(request::<BatteryStatus>(&mut world, 1), [(1, MavResult::ACCEPTED)]);
    assert_eq!(batteries(&world), [1, 0]);
    assert_eq!(request::<BatteryStatus>(&mut world, 0), [(1, MavResult::ACCEPTED)]);
    assert_eq!(batteries(&world), [1, 1], "a request to all components");
    // The autopilot has no attitude of a gimbal.
    request::<GimbalDeviceAttitudeStatus>(&mut world, 1);
    assert_eq!(sent::<GimbalDeviceAttitudeStatus>(&world, 0), []);
    request::<GimbalDeviceAttitudeStatus>(&mut world, 154);
    assert!(matches!(sent::<GimbalDeviceAttitudeStatus>(&world, 0)[..], [(154, ..)]));

    let interval = |micros: f32| [BatteryStatus::ID as f32, micros, 0.0, 0.0, 0.0, 0.0, 0.0];
    command(&mut world, 154, MavCmd::SET_MESSAGE_INTERVAL, interval(100_000.0));
    world.run_for(millis(500));
    world.gcs[0].forget();
    world.run_for(secs(2));
    assert_eq!(batteries(&world), [0, 20]);
    command(&mut world, 1, MavCmd::SET_MESSAGE_INTERVAL, interval(500_000.0));
    command(&mut world, 154, MavCmd::SET_MESSAGE_INTERVAL, interval(-1.0));
    world.run_for(millis(500));
    world.gcs[0].forget();
    world.run_for(secs(2));
    assert_eq!(batteries(&world), [4, 0]);
}

/// K-10, S-15, R-8: a frame with the address of one of our components is an echo. It is neither handled nor a conflict.
#[test]
fn echoes_of_components_are_dropped() {
    let mut world = sky();
    let before = world.stack.link_counters(LinkId(0)).unwrap().own_address;
    let message = world.gcs[0].long(MavCmd::USER_1, [0.0; 7]);
    for _ in 0..5 {
        world.gcs[0].send_from(GIMBAL, &message);
    }
    world.run_for(millis(50));
    assert_eq!(world.vehicle.own, []);
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().own_address - before, 5);
    assert_eq!(sent::<Statustext>(&world, 0), [], "no conflict is reported");
}

/// K-10, H-14: the frames of the other components do not hide echoes of the autopilot's own.
#[test]
fn echoes_of_the_autopilot_are_recognised_beside_other_components() {
    let mut world = sky();
    world.run_for(secs(5));
    let own: Vec<_> = world.gcs[0].received.iter().map(|frame| frame.raw.clone()).collect();
    assert!(own.len() > 10);
    for frame in own {
        world.gcs[0].send_raw(&frame);
    }
    world.run_for(secs(1));
    assert_eq!(sent::<Statustext>(&world, 0), [], "an echo is no conflict");
}

/// K-10, R-2: a frame for one of our components is not forwarded; one for another component of the system is.
#[test]
fn frames_for_our_components_are_not_forwarded() {
    let mut world = sky();
    world.gcs[1].send_from(COMPANION, &Heartbeat::default());
    world.run_for(millis(50));
    for target_component in [154, 191] {
        let message = CommandLong { target_component, ..world.gcs[0].long(MavCmd::USER_1, [0.0; 7]) };
        world.gcs[0].send(&message);
        world.run_for(millis(100));
    }
    let forwarded: Vec<_> =
        sent::<CommandLong>(&world, 1).into_iter().map(|(.., sent)| sent.target_component).collect();
    assert_eq!(forwarded, [191]);
}

/// K-11: the firmware's own command to one of its components is carried out once, and leaves on no link.
#[test]
fn own_command_stays_inside() {
    let mut world = sky();
    for to in [Recipient::Type(MavType::GIMBAL), GIMBAL.into()] {
        assert!(world.stack.send_command(to, POINT));
        world.run_for(millis(20));
    }
    let done = |result| CommandReply::Done { result, result_param2: 0 };
    assert_eq!(world.vehicle.replies, [(POINT, done(MavResult::ACCEPTED)); 2]);
    assert_eq!(world.vehicle.others, [(154, MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, 1); 2]);
    assert!(world.stack.send_command(CAMERA, ASK));
    world.run_for(secs(5));
    assert_eq!(world.vehicle.replies[2..], [(ASK, done(MavResult::DENIED))], "it would be sent on a link");
    for link in 0..2 {
        assert_eq!(sent::<CommandLong>(&world, link), []);
        assert_eq!(sent::<CommandAck>(&world, link), []);
    }
    // A component of another firmware is found on its link as before.
    world.gcs[1].send_from(COMPANION, &Heartbeat::default());
    world.run_for(millis(50));
    assert!(world.stack.send_command(COMPANION, ELSEWHERE));
    world.run_for(millis(50));
    assert_eq!((sent::<CommandLong>(&world, 1).len(), sent::<CommandLong>(&world, 0).len()), (1, 0));
}

/// K-11: the firmware's own long-running command reports its progress and its end inside.
#[test]
fn own_command_reports_progress() {
    let mut world = sky();
    assert!(world.stack.send_command(Recipient::Type(MavType::GIMBAL), CALIBRATE));
    world.run_for(millis(20));
    assert_eq!(world.vehicle.replies, [(CALIBRATE, CommandReply::InProgress(255))]);
    for percent in [10, 20] {
        world.stack.long_commands_mut().progress(MavCmd::DO_WINCH, percent);
        world.run_for(secs(20));
    }
    assert!(world.vehicle.replies.contains(&(CALIBRATE, CommandReply::InProgress(20))));
    world.stack.long_commands_mut().finish(MavCmd::DO_WINCH, MavResult::FAILED);
    world.run_for(secs(20));
    let end = (CALIBRATE, CommandReply::Done { result: MavResult::FAILED, result_param2: 0 });
    let ends: Vec<_> =
        world.vehicle.replies.iter().filter(|(_, reply)| matches!(reply, CommandReply::Done { .. })).collect();
    assert_eq!(ends, [&end]);
    assert_eq!(sent::<CommandAck>(&world, 0), []);
}

/// K-11, K-5: the firmware's own command can be cancelled.
#[test]
fn own_command_is_cancelled() {
    let mut world = sky();
    assert!(world.stack.send_command(Recipient::Type(MavType::GIMBAL), CALIBRATE));
    world.run_for(secs(3));
    assert!(world.stack.cancel_sent_command(CALIBRATE));
    world.run_for(secs(1));
    let end = (CALIBRATE, CommandReply::Done { result: MavResult::CANCELLED, result_param2: 0 });
    assert_eq!(world.vehicle.replies.last(), Some(&end));
    assert!(!world.stack.long_commands().is_running(MavCmd::DO_WINCH));
    assert_eq!((sent::<CommandCancel>(&world, 0), sent::<CommandAck>(&world, 0)), (vec![], vec![]));
}

/// K-11: inside the firmware nothing is lost, so an equal command is another command, also one that must not run twice by a link.
#[test]
fn own_commands_are_not_taken_for_duplicates() {
    let mut world = sky();
    let done = (SERVO, CommandReply::Done { result: MavResult::ACCEPTED, result_param2: 0 });
    for _ in 0..3 {
        assert!(world.stack.send_command(GIMBAL, SERVO));
        world.run_for(millis(500));
    }
    assert_eq!(world.vehicle.replies, [done; 3]);
    assert_eq!(world.vehicle.others.len(), 3);
    for (token, command) in [(CALIBRATE, MavCmd::DO_WINCH), (RELAY, MavCmd::DO_REPEAT_RELAY)] {
        for pause in [millis(500), secs(6), millis(500)] {
            world.vehicle.replies.clear();
            assert!(world.stack.send_command(GIMBAL, token));
            world.run_for(millis(500));
            assert!(world.stack.long_commands_mut().finish(command, MavResult::ACCEPTED), "it runs");
            world.run_for(pause);
            let end = (token, CommandReply::Done { result: MavResult::ACCEPTED, result_param2: 0 });
            assert_eq!(world.vehicle.replies.last(), Some(&end));
        }
    }
}

/// K-11, D-4: the end of the firmware's own command is told by the next poll, which is due at once.
#[test]
fn end_of_an_own_command_is_due_at_once() {
    let mut world = sky();
    assert!(world.stack.send_command(GIMBAL, CALIBRATE));
    world.run_for(secs(2));
    world.stack.long_commands_mut().finish(MavCmd::DO_WINCH, MavResult::ACCEPTED);
    let now = world.now();
    assert_eq!(world.stack.next_deadline(now), now);
}

/// K-11: every slot of the client can have an own command.
#[test]
fn own_commands_may_have_any_slot() {
    let mut world = sky();
    world.gcs[1].send_from(COMPANION, &Heartbeat::default());
    world.run_for(millis(50));
    for token in 0..8 {
        assert!(world.stack.send_command(COMPANION, UNANSWERED + token));
    }
    world.run_for(millis(5));
    assert!(world.stack.send_command(GIMBAL, CALIBRATE));
    world.run_for(millis(50));
    world.stack.long_commands_mut().finish(MavCmd::DO_WINCH, MavResult::ACCEPTED);
    world.run_for(secs(1));
    let end = (CALIBRATE, CommandReply::Done { result: MavResult::ACCEPTED, result_param2: 0 });
    assert!(world.vehicle.replies.contains(&end));
}

/// K-11: an own request for a message is refused in each form, because the message would be sent on a link.
#[test]
fn own_request_for_a_message_is_refused() {
    let mut world = sky();
    for token in [ASK, OLD] {
        assert!(world.stack.send_command(CAMERA, token));
        world.run_for(millis(200));
        let end = (token, CommandReply::Done { result: MavResult::DENIED, result_param2: 0 });
        assert_eq!(world.vehicle.replies.last(), Some(&end));
    }
    assert_eq!(world.vehicle.others, []);
}

/// K-10, C-23: COMMAND_CANCEL to one component does not cancel another's command.
#[test]
fn only_the_addressed_component_cancels() {
    let mut world = sky();
    let cancel = CommandCancel { command: MavCmd::DO_WINCH, target_system: 1, target_component: 0 };
    for (runs, others) in [(1, [100, 154]), (154, [1, 100])] {
        assert_eq!(command(&mut world, runs, MavCmd::DO_WINCH, [0.0; 7]), [(runs, MavResult::IN_PROGRESS)]);
        for target_component in others {
            world.gcs[0].send(&CommandCancel { target_component, ..cancel });
            world.run_for(millis(50));
            assert!(world.stack.long_commands().is_running(MavCmd::DO_WINCH), "{target_component} cancels {runs}'s");
        }
        world.gcs[0].send(&CommandCancel { target_component: runs, ..cancel });
        world.run_for(secs(5));
        assert!(!world.stack.long_commands().is_running(MavCmd::DO_WINCH));
    }
}

/// K-10, Q-6: each component tells the intervals of its own streams.
#[test]
fn each_component_tells_its_intervals() {
    let mut world = sky();
    let battery = BatteryStatus::ID as f32;
    for (to, micros) in [(154, 1_000_000.0), (1, 200_000.0)] {
        command(&mut world, to, MavCmd::SET_MESSAGE_INTERVAL, [battery, micros, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    for (to, interval_us) in [(154, 1_000_000), (1, 200_000)] {
        for (id, params) in [
            (MavCmd::GET_MESSAGE_INTERVAL, [battery, 0.0]),
            (MavCmd::REQUEST_MESSAGE, [MessageInterval::ID as f32, battery]),
        ] {
            let [first, second] = params;
            let ack = command(&mut world, to, id, [first, second, 0.0, 0.0, 0.0, 0.0, 0.0]);
            assert_eq!(ack, [(to, MavResult::ACCEPTED)]);
            let told: Vec<_> =
                sent::<MessageInterval>(&world, 0).into_iter().map(|(from, _, told)| (from, told)).collect();
            assert_eq!(told, [(to, MessageInterval { interval_us, message_id: BatteryStatus::ID as u16 })]);
        }
    }
    // What the autopilot alone sends.
    let mission = [MissionCurrent::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(command(&mut world, 1, MavCmd::SET_MESSAGE_INTERVAL, mission), [(1, MavResult::ACCEPTED)]);
    assert_eq!(command(&mut world, 154, MavCmd::SET_MESSAGE_INTERVAL, mission), [(154, MavResult::DENIED)]);
    let unknown = [Attitude::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(command(&mut world, 154, MavCmd::GET_MESSAGE_INTERVAL, unknown), [(154, MavResult::DENIED)]);
}

/// K-10, S-10: on a MAVLink 1 link each component sends MAVLink 1 with its own sequence number.
#[test]
fn components_send_mavlink_1_too() {
    let uart = LinkConfig::uart(115_200).with_streams(StreamProfile::Off).with_version(TxVersion::V1);
    let mut world = Sky::of(Setup { links: [uart; 2], ..Setup::new() });
    world.run_for(secs(3));
    let mut next = BTreeMap::<u8, u8>::new();
    for frame in &world.gcs[0].received {
        assert_eq!(frame.header.version, Version::V1);
        let from = frame.header.source.component.wire();
        let seq = next.entry(from).or_default();
        assert_eq!(frame.header.seq, *seq);
        *seq += 1;
    }
    assert!(next.len() == 3 && next.values().all(|frames| *frames >= 3));
}

/// K-10, G-4, H-17: a half-sent heartbeat of a component is dropped when the link restarts. The next frame is the autopilot's
/// heartbeat, and those behind it are the components' own.
#[test]
fn restart_in_the_middle_of_a_components_frame() {
    let mut world = sky();
    world.run_for(millis(1_885));
    let now = world.now() + millis(20);
    world.pulse.tick();
    world.stack.poll(now, &mut world.vehicle);
    let mut sources = Vec::new();
    for _ in 0..5 {
        let frame = world.stack.transmit(now, LinkId(0), &mut world.vehicle).to_vec();
        sources.push(frame[6]);
        if frame[6] == 154 && sources.len() == 2 {
            world.stack.transmitted(LinkId(0), 5);
            world.stack.restart_link(LinkId(0));
        } else {
            world.stack.transmitted(LinkId(0), frame.len());
        }
    }
    assert_eq!(sources, [1, 154, 1, 154, 100]);
}
