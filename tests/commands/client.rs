//! The vehicle's own commands to other components: rules K-1 to K-5, K-7, C-3, L-4, D-3.

use std::collections::BTreeMap;

use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::{
    Address, Command, CommandClient, CommandReply, Commands, Context, Duration, LinkConfig, LinkId, Outcome,
    OutgoingCommand, ParamAnswer, Peer, Recipient, Telemetry, Text, Vehicle, VehicleState,
};
use proptest::prelude::*;

pub(super) const GIMBAL: Address = Address::new(1, 154);
pub(super) const AUTHORISER: Address = Address::new(10, 1);
/// Two links, a companion and its backup, and a satellite.
pub(super) const COMPANION: usize = 1;
const BACKUP: usize = 0;
const SATELLITE: usize = 2;

pub(super) const POINT: u16 = 1;
pub(super) const REQUEST: u16 = 2;
const GO: u16 = 3;
pub(super) const NOTHING: u16 = 4;
const STREAM: u16 = 5;
const STOP: u16 = 6;
/// Tokens from here on are equal commands.
pub(super) const EQUAL: u16 = 100;
/// Tokens from here on are commands of four kinds.
const VARIED: u16 = 1_000;
const KINDS: [MavCmd; 4] = [MavCmd::DO_SET_SERVO, PITCHYAW, MavCmd::REQUEST_MESSAGE, MavCmd::SET_MESSAGE_INTERVAL];

/// A vehicle that sends commands, and tries each again that is not sent while `is_stubborn`.
#[derive(Default)]
pub(super) struct Carrier {
    pub(super) replies: Vec<(u16, CommandReply)>,
    is_stubborn: bool,
    made: BTreeMap<u16, u32>,
    /// The parameters that were read: their tokens, and the values or why there is none.
    pub(super) params: Vec<(u16, Result<f32, &'static str>)>,
}

impl Vehicle for Carrier {
    fn state(&self) -> Option<VehicleState> {
        TestVehicle::new().state
    }
}

impl Commands for Carrier {
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        let is_sent = command.id == MavCmd::USER_1 && cx.send_command(Recipient::Type(MavType::GIMBAL), POINT);
        if is_sent { MavResult::ACCEPTED } else { MavResult::UNSUPPORTED }.into()
    }
}

impl CommandClient for Carrier {
    fn command_for(&mut self, token: u16) -> Option<OutgoingCommand> {
        *self.made.entry(token).or_default() += 1;
        match token {
            POINT => {
                Some(OutgoingCommand::long(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, [-30.0, 45.0, 0.5, 0.25, 2.0, 0.0, 0.0]))
            }
            REQUEST => Some(OutgoingCommand::request_message::<GimbalDeviceInformation>(0)),
            STREAM => Some(OutgoingCommand::set_message_interval::<GimbalDeviceAttitudeStatus>(Some(millis(100)))),
            STOP => Some(OutgoingCommand::set_message_interval::<GimbalDeviceAttitudeStatus>(None)),
            GO => {
                let (frame, place) = (MavFrame::GLOBAL, [473_977_420, 85_455_940]);
                Some(OutgoingCommand::int(MavCmd::DO_REPOSITION, frame, [-1.0, 0.0, 0.0, f32::NAN], place, 500.0))
            }
            VARIED.. => Some(OutgoingCommand::long(KINDS[usize::from(token % 4)], [0.0; 7])),
            EQUAL.. => {
                Some(OutgoingCommand::long(MavCmd::DO_SET_SERVO, [1.0, f32::from(token), 0.0, 0.0, 0.0, 0.0, 0.0]))
            }
            _ => None,
        }
    }

    fn command_answered(&mut self, cx: &mut Context<'_>, token: u16, reply: CommandReply) {
        self.replies.push((token, reply));
        if self.is_stubborn && reply == CommandReply::NotSent {
            let _ = cx.send_command(GIMBAL, token);
        }
    }

    const READS_PARAMS: bool = true;

    fn param_for(&mut self, token: u16) -> Option<Text<16>> {
        (token != NOTHING).then_some(Text::new(if token == POINT { "GIMB_MODE" } else { "CAM_EXPOSURE_CMP" }))
    }

    fn param_answered(&mut self, _: &mut Context<'_>, token: u16, answer: ParamAnswer<'_>) {
        let value = match answer {
            ParamAnswer::Value(value) => Ok(value.param_value),
            ParamAnswer::ExtValue(value) => {
                assert_eq!(value.r#type, MavParamExtType::INT32);
                Ok(i32::from_le_bytes(value.bytes()) as f32)
            }
            ParamAnswer::Refused(MavParamError::DOES_NOT_EXIST) => Err("does not exist"),
            ParamAnswer::Refused(_) => Err("refused"),
            ParamAnswer::NotSent => Err("not sent"),
            ParamAnswer::TimedOut => Err("timed out"),
        };
        self.params.push((token, value));
    }
}

impl Telemetry for Carrier {}

#[derive(mavstack::Stack)]
#[stack(vehicle: Carrier, links: 3, messages, command_client: { slots: 2 })]
pub(super) struct Carrying;

pub(super) type Sky = World<3, Carrying>;

pub(super) fn sky() -> Sky {
    sky_at(millis(1))
}

/// Creates a world with this period of the loop.
fn sky_at(step: Duration) -> Sky {
    let uart = LinkConfig::uart(115_200).with_own_system(true);
    let links = [uart, uart, uart.with_class(LinkClass::HighLatency)];
    let mut world = Sky::of(Setup { links, step, ..Setup::new() });
    world.run_for(millis(20));
    beat(&mut world, COMPANION, GIMBAL, MavType::GIMBAL);
    world
}

/// A component sends a heartbeat.
pub(super) fn beat(world: &mut Sky, link: usize, from: Address, r#type: MavType) {
    world.gcs[link].send_from(from, &Heartbeat { r#type, ..Heartbeat::default() });
    world.run_for(millis(10));
}

/// A component answers a command.
pub(super) fn answer(world: &mut Sky, link: usize, from: Address, ack: CommandAck) {
    world.gcs[link].send_from(from, &ack);
    world.run_for(millis(10));
}

fn ack(command: MavCmd, result: MavResult) -> CommandAck {
    CommandAck { command, result, target_system: 1, target_component: 1, ..CommandAck::UNKNOWN }
}

fn done(result: MavResult) -> CommandReply {
    CommandReply::Done { result, result_param2: 0 }
}

/// Returns the commands that a link has sent: when, which, and their confirmation.
pub(super) fn sent(world: &Sky, link: usize) -> Vec<(u64, MavCmd, u8)> {
    let commands = world.gcs[link].all::<CommandLong>();
    commands.into_iter().map(|(at, command)| (at.as_millis(), command.command, command.confirmation)).collect()
}

const PITCHYAW: MavCmd = MavCmd::DO_GIMBAL_MANAGER_PITCHYAW;

/// K-1: a hook's command is sent to the gimbal of our system, once if it is answered, and the vehicle gets the result.
#[test]
fn command_to_a_gimbal_is_answered() {
    let mut world = sky();
    world.gcs[BACKUP].command_long(MavCmd::USER_1, [0.0; 7]);
    world.run_for(millis(50));
    let (_, command) = world.gcs[COMPANION].all::<CommandLong>()[0];
    let expected = CommandLong {
        param1: -30.0,
        param2: 45.0,
        param3: 0.5,
        param4: 0.25,
        param5: 2.0,
        command: PITCHYAW,
        target_system: 1,
        target_component: 154,
        ..CommandLong::default()
    };
    assert_eq!(command, expected);
    answer(&mut world, COMPANION, GIMBAL, CommandAck { result_param2: -7, ..ack(PITCHYAW, MavResult::DENIED) });
    world.run_for(secs(10));
    assert_eq!(world.vehicle.replies, [(POINT, CommandReply::Done { result: MavResult::DENIED, result_param2: -7 })]);
    assert_eq!((sent(&world, COMPANION).len(), sent(&world, BACKUP).len()), (1, 0), "on the gimbal's link only");
}

/// K-1: a command that is not answered is sent five times, 700 ms apart, with a rising confirmation.
#[test]
fn unanswered_command_is_repeated_and_times_out() {
    let mut world = sky();
    let start = world.now().as_millis();
    assert!(world.stack.send_command(GIMBAL, REQUEST));
    world.run_for(millis(3_450));
    assert_eq!(world.vehicle.replies, []);
    world.run_for(millis(100));
    assert_eq!(world.vehicle.replies, [(REQUEST, CommandReply::TimedOut)]);
    let sent = sent(&world, COMPANION);
    assert_eq!(sent.iter().map(|&(.., confirmation)| confirmation).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    for (number, &(at, ..)) in (0..).zip(&sent) {
        assert!((at - start).abs_diff(700 * number) <= 10 + number, "{number}: {} ms", at - start);
    }
    assert_eq!(world.vehicle.made[&REQUEST], 1, "retransmissions repeat the first");
    answer(&mut world, COMPANION, GIMBAL, ack(MavCmd::REQUEST_MESSAGE, MavResult::ACCEPTED));
    assert_eq!(world.vehicle.replies.len(), 1, "too late");
}

/// COMMAND_INT carries a position to 1e-7 degrees, and is repeated too.
#[test]
fn position_is_sent_as_command_int() {
    let mut world = sky();
    assert!(world.stack.send_command(GIMBAL, GO));
    world.run_for(millis(1_000));
    let commands = world.gcs[COMPANION].all::<CommandInt>();
    assert_eq!(commands.len(), 2);
    let (_, CommandInt { x, y, z, frame, command, param1, param4, .. }) = commands[0];
    assert_eq!((x, y, z, frame, command), (473_977_420, 85_455_940, 500.0, MavFrame::GLOBAL, MavCmd::DO_REPOSITION));
    assert!(param1 == -1.0 && param4.is_nan());
}

/// K-3, X-3: IN_PROGRESS ends the retransmissions. Silence for thirty seconds after it is a timeout.
#[test]
fn progress_is_followed() {
    let mut world = sky();
    assert!(world.stack.send_command(GIMBAL, POINT));
    world.run_for(millis(20));
    for progress in [10, 55, 255] {
        answer(&mut world, COMPANION, GIMBAL, CommandAck { progress, ..ack(PITCHYAW, MavResult::IN_PROGRESS) });
        world.run_for(millis(29_900));
    }
    answer(&mut world, COMPANION, GIMBAL, ack(PITCHYAW, MavResult::ACCEPTED));
    let running = [10, 55, 255].map(|progress| (POINT, CommandReply::InProgress(progress)));
    assert_eq!(world.vehicle.replies, [&running[..], &[(POINT, done(MavResult::ACCEPTED))]].concat());
    assert_eq!(sent(&world, COMPANION).len(), 1);

    world.vehicle.replies.clear();
    beat(&mut world, COMPANION, GIMBAL, MavType::GIMBAL);
    assert!(world.stack.send_command(GIMBAL, POINT));
    world.run_for(millis(20));
    answer(&mut world, COMPANION, GIMBAL, ack(PITCHYAW, MavResult::IN_PROGRESS));
    world.run_for(millis(30_100));
    assert_eq!(world.vehicle.replies.last(), Some(&(POINT, CommandReply::TimedOut)));
}

/// K-3: a command is cancelled by COMMAND_CANCEL, sent until it is answered; one that was not sent yet is dropped.
#[test]
fn commands_are_cancelled() {
    let mut world = sky();
    for token in [POINT, EQUAL, EQUAL + 1] {
        assert!(world.stack.send_command(GIMBAL, token));
    }
    world.run_for(millis(20));
    answer(&mut world, COMPANION, GIMBAL, ack(PITCHYAW, MavResult::IN_PROGRESS));
    for token in [POINT, EQUAL + 1, 77] {
        assert!(world.stack.cancel_sent_command(token));
    }
    world.run_for(millis(800));
    let cancels = world.gcs[COMPANION].all::<CommandCancel>();
    assert_eq!(cancels.len(), 2, "it is repeated");
    let (_, cancel) = cancels[0];
    assert_eq!(cancel, CommandCancel { command: PITCHYAW, target_system: 1, target_component: 154 });
    answer(&mut world, COMPANION, GIMBAL, ack(PITCHYAW, MavResult::CANCELLED));
    world.run_for(secs(5));
    let replies = [
        (POINT, CommandReply::InProgress(255)),
        (EQUAL + 1, done(MavResult::CANCELLED)),
        (POINT, done(MavResult::CANCELLED)),
        (EQUAL, CommandReply::TimedOut),
    ];
    assert_eq!(world.vehicle.replies, replies);
    assert_eq!(world.gcs[COMPANION].all::<CommandCancel>().len(), 2);
}

/// K-2: an answer does not say which of two equal commands it answers, so the second is sent after the first has ended.
#[test]
fn equal_commands_are_sent_one_after_the_other() {
    let mut world = sky();
    beat(&mut world, COMPANION, AUTHORISER, MavType::ONBOARD_CONTROLLER);
    for (to, token) in [(GIMBAL, EQUAL), (GIMBAL, EQUAL + 1)] {
        assert!(world.stack.send_command(to, token));
    }
    world.run_for(millis(100));
    let values = |world: &Sky| -> Vec<_> {
        world.gcs[COMPANION].all::<CommandLong>().into_iter().map(|(_, command)| command.param2).collect()
    };
    assert_eq!(values(&world), [100.0]);
    answer(&mut world, COMPANION, GIMBAL, ack(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED));
    assert_eq!(values(&world), [100.0, 101.0]);
    // The same command to another component does not wait.
    assert!(world.stack.send_command(AUTHORISER, EQUAL + 2));
    world.run_for(millis(50));
    assert_eq!(values(&world), [100.0, 101.0, 102.0]);
    answer(&mut world, COMPANION, AUTHORISER, ack(MavCmd::DO_SET_SERVO, MavResult::FAILED));
    answer(&mut world, COMPANION, GIMBAL, ack(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED));
    let tokens: Vec<_> = world.vehicle.replies.iter().map(|&(token, _)| token).collect();
    assert_eq!(tokens, [EQUAL, EQUAL + 2, EQUAL + 1]);
}

/// K-7, D-3: more commands than slots wait for a slot. More than eight are refused and counted.
#[test]
fn commands_wait_for_a_slot() {
    let mut world = sky();
    let tokens: Vec<u16> = (EQUAL..EQUAL + 12).collect();
    let is_accepted: Vec<bool> = tokens.iter().map(|&token| world.stack.send_command(GIMBAL, token)).collect();
    assert_eq!(is_accepted, [[true; 8].as_slice(), &[false; 4]].concat());
    assert_eq!(world.stack.refused_requests(), 4);
    for _ in 0..8 {
        world.run_for(millis(20));
        answer(&mut world, COMPANION, GIMBAL, ack(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED));
    }
    let ended: Vec<_> = world.vehicle.replies.iter().map(|&(token, _)| token).collect();
    assert_eq!(ended, tokens[..8]);
}

/// K-7, L-4: without a living recipient on a normal link, nothing is sent. A hook that tries again at once cannot hang the stack.
#[test]
fn command_without_a_recipient_is_not_sent() {
    let mut world = sky();
    beat(&mut world, SATELLITE, AUTHORISER, MavType::ONBOARD_CONTROLLER);
    beat(&mut world, COMPANION, Address::new(2, 100), MavType::CAMERA);
    let recipients =
        [Recipient::Address(AUTHORISER), Recipient::Type(MavType::CAMERA), Recipient::Address(Address::new(0, 0))];
    for to in recipients {
        assert!(world.stack.send_command(to, POINT));
    }
    assert!(world.stack.send_command(GIMBAL, NOTHING), "the vehicle makes no command of it");
    world.run_for(millis(100));
    let not_sent = |token| (token, CommandReply::NotSent);
    assert_eq!(world.vehicle.replies, [not_sent(POINT), not_sent(POINT), not_sent(POINT), not_sent(NOTHING)]);
    world.vehicle.is_stubborn = true;
    world.run_for(secs(6));
    world.vehicle.replies.clear();
    assert!(world.stack.send_command(GIMBAL, POINT), "it has timed out");
    let polls = 10;
    for _ in 0..polls {
        world.step();
    }
    assert!((polls..=polls * 8).contains(&world.vehicle.replies.len()), "{}", world.vehicle.replies.len());
    assert_eq!((0..3).map(|link| sent(&world, link).len()).sum::<usize>(), 0);
}

/// Messages of another component are requested and streamed by commands.
#[test]
fn messages_are_requested() {
    let mut world = sky();
    for token in [REQUEST, STREAM, STOP] {
        assert!(world.stack.send_command(GIMBAL, token));
        world.run_for(millis(50));
        let command = if token == REQUEST { MavCmd::REQUEST_MESSAGE } else { MavCmd::SET_MESSAGE_INTERVAL };
        answer(&mut world, COMPANION, GIMBAL, ack(command, MavResult::ACCEPTED));
    }
    let sent = world.gcs[COMPANION].all::<CommandLong>();
    let sent: Vec<_> = sent.into_iter().map(|(_, sent)| (sent.command, sent.param1, sent.param2)).collect();
    let (request, interval) = (MavCmd::REQUEST_MESSAGE, MavCmd::SET_MESSAGE_INTERVAL);
    assert_eq!(sent, [(request, 283.0, 0.0), (interval, 285.0, 100_000.0), (interval, 285.0, -1.0)]);
}

/// K-4: retransmissions take turns among the links on which the recipient is alive, from the wanted one on. An answer on any
/// link counts.
#[test]
fn redundant_link_takes_over() {
    for (first, second) in [(COMPANION, BACKUP), (BACKUP, COMPANION)] {
        let mut world = sky();
        beat(&mut world, BACKUP, GIMBAL, MavType::GIMBAL);
        let peer = Peer { address: GIMBAL, link: LinkId(first as u8) };
        assert!(world.stack.send_command(peer, POINT));
        world.run_for(millis(100));
        assert_eq!((sent(&world, first).len(), sent(&world, second).len()), (1, 0));
        // The first link dies.
        let until = world.now() + secs(60);
        world.uarts[first].stall_writes_until(until);
        world.run_for(millis(700));
        assert_eq!((sent(&world, first).len(), sent(&world, second).len()), (1, 1));
        assert_eq!(sent(&world, second)[0].2, 1, "confirmation");
        answer(&mut world, first, GIMBAL, ack(PITCHYAW, MavResult::ACCEPTED));
        assert_eq!(world.vehicle.replies, [(POINT, done(MavResult::ACCEPTED))]);
    }
}

/// K-1, D-3: a link that takes nothing does not keep a slot for ever: the request ends, and others go on meanwhile.
#[test]
fn stalled_link_ends_a_request() {
    for is_sent in [false, true] {
        let mut world = sky();
        beat(&mut world, BACKUP, AUTHORISER, MavType::ONBOARD_CONTROLLER);
        if is_sent {
            assert!(world.stack.send_command(GIMBAL, POINT));
            world.run_for(millis(100));
        }
        let until = world.now() + secs(60);
        world.uarts[COMPANION].stall_writes_until(until);
        if !is_sent {
            assert!(world.stack.send_command(GIMBAL, POINT));
        }
        assert!(world.stack.send_command(AUTHORISER, EQUAL));
        world.run_for(millis(100));
        assert_eq!(sent(&world, BACKUP).len(), 1);
        world.run_for(secs(4));
        let reply = if is_sent { CommandReply::TimedOut } else { CommandReply::NotSent };
        assert!(world.vehicle.replies.contains(&(POINT, reply)), "{:?}", world.vehicle.replies);
        world.run_for(secs(60));
        assert_eq!(sent(&world, COMPANION).len(), usize::from(is_sent), "nothing is sent afterwards");
    }
}

/// K-7, K-8: messages that wait on a stalled link refuse no commands, and the reverse.
#[test]
fn messages_and_commands_have_queues_of_their_own() {
    let mut world = sky();
    let until = world.now() + secs(60);
    world.uarts[BACKUP].stall_writes_until(until);
    for index in 0..9 {
        assert_eq!(world.stack.send::<Tunnel>(LinkId(0), index), index < 8);
    }
    for token in EQUAL..EQUAL + 9 {
        assert_eq!(world.stack.send_command(GIMBAL, token), token < EQUAL + 8);
    }
    assert_eq!((world.stack.refused_messages(LinkId(0)), world.stack.refused_requests()), (1, 1));
    world.run_for(millis(100));
    assert_eq!(sent(&world, COMPANION).len(), 1);
}

/// K-3: IN_PROGRESS does not end a cancellation. If it is never obeyed, the command is followed to its end.
#[test]
fn progress_does_not_end_a_cancellation() {
    let mut world = sky();
    assert!(world.stack.send_command(GIMBAL, POINT));
    world.run_for(millis(20));
    answer(&mut world, COMPANION, GIMBAL, ack(PITCHYAW, MavResult::IN_PROGRESS));
    assert!(world.stack.cancel_sent_command(POINT));
    for _ in 0..60 {
        world.run_for(millis(90));
        answer(&mut world, COMPANION, GIMBAL, ack(PITCHYAW, MavResult::IN_PROGRESS));
    }
    assert_eq!(world.gcs[COMPANION].all::<CommandCancel>().len(), 5);
    assert!(world.vehicle.replies.iter().all(|(_, reply)| *reply == CommandReply::InProgress(255)));
    answer(&mut world, COMPANION, GIMBAL, ack(PITCHYAW, MavResult::FAILED));
    assert_eq!(world.vehicle.replies.last(), Some(&(POINT, done(MavResult::FAILED))));
}

/// K-3: a cancellation applies to what was requested before it, so a command may be replaced under its token.
#[test]
fn cancellation_spares_what_is_requested_after_it() {
    let mut world = sky();
    assert!(world.stack.cancel_sent_command(EQUAL) && world.stack.send_command(GIMBAL, EQUAL));
    world.run_for(millis(20));
    assert_eq!((sent(&world, COMPANION).len(), world.vehicle.replies.len()), (1, 0));
    // Replaced before it is sent, and while it is.
    assert!(world.stack.send_command(GIMBAL, POINT) && world.stack.cancel_sent_command(POINT));
    assert!(world.stack.cancel_sent_command(EQUAL));
    world.run_for(millis(20));
    assert_eq!(world.vehicle.replies, [(POINT, done(MavResult::CANCELLED))]);
    answer(&mut world, COMPANION, GIMBAL, ack(MavCmd::DO_SET_SERVO, MavResult::CANCELLED));
    assert_eq!(world.vehicle.replies.last(), Some(&(EQUAL, done(MavResult::CANCELLED))));
    assert!(world.stack.send_command(GIMBAL, POINT));
    world.run_for(millis(20));
    assert_eq!(sent(&world, COMPANION).len(), 2);
}

/// K-2, C-3: each transmission may be answered. A second answer to a command is not taken for one to the next, equal command;
/// nor is one that comes after the command has timed out.
#[test]
fn late_answer_is_not_taken_for_another() {
    let mut world = sky();
    let accepted = ack(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED);
    assert!(world.stack.send_command(GIMBAL, EQUAL));
    world.run_for(millis(750));
    assert_eq!(sent(&world, COMPANION).len(), 2);
    answer(&mut world, COMPANION, GIMBAL, accepted);
    assert!(world.stack.send_command(GIMBAL, EQUAL + 1));
    world.run_for(millis(20));
    answer(&mut world, COMPANION, GIMBAL, accepted);
    assert_eq!(world.vehicle.replies, [(EQUAL, done(MavResult::ACCEPTED))]);
    assert_eq!(sent(&world, COMPANION).len(), 2, "it waits");
    world.run_for(secs(2));
    assert_eq!(sent(&world, COMPANION).len(), 3);
    beat(&mut world, COMPANION, GIMBAL, MavType::GIMBAL);
    world.run_for(secs(4));
    assert_eq!(world.vehicle.replies.last(), Some(&(EQUAL + 1, CommandReply::TimedOut)));
    assert!(world.stack.send_command(GIMBAL, EQUAL + 2));
    world.run_for(millis(50));
    answer(&mut world, COMPANION, GIMBAL, accepted);
    assert_eq!(world.vehicle.replies.len(), 2);
}

/// K-2, K-7: a command that was sent twice keeps its slot for a second answer, even if another one waits for a slot.
#[test]
fn late_answer_is_not_taken_for_one_that_waited_for_a_slot() {
    let mut world = sky();
    for token in [EQUAL, EQUAL + 1, EQUAL + 2] {
        assert!(world.stack.send_command(GIMBAL, token));
    }
    world.run_for(millis(750));
    let accepted = ack(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED);
    for _ in 0..2 {
        answer(&mut world, COMPANION, GIMBAL, accepted);
        world.run_for(millis(20));
    }
    assert_eq!(world.vehicle.replies, [(EQUAL, done(MavResult::ACCEPTED))]);
    world.run_for(secs(2));
    assert_eq!(sent(&world, COMPANION).len(), 3);
}

/// K-5: of a command to all components of a system, the first that knows it decides, and only that one is told to cancel it.
#[test]
fn command_to_all_components_is_followed() {
    let mut world = sky();
    let (other, all) = (Address::new(10, 7), Address::new(10, 0));
    beat(&mut world, COMPANION, AUTHORISER, MavType::ONBOARD_CONTROLLER);
    assert!(world.stack.send_command(all, EQUAL) && world.stack.send_command(AUTHORISER, EQUAL + 1));
    world.run_for(millis(50));
    assert_eq!(sent(&world, COMPANION).len(), 1, "the authoriser is one of all");
    answer(&mut world, COMPANION, other, ack(MavCmd::DO_SET_SERVO, MavResult::UNSUPPORTED));
    assert_eq!(world.vehicle.replies, []);
    answer(&mut world, COMPANION, AUTHORISER, ack(MavCmd::DO_SET_SERVO, MavResult::IN_PROGRESS));
    assert!(world.stack.cancel_sent_command(EQUAL));
    world.run_for(millis(50));
    let (_, cancel) = world.gcs[COMPANION].all::<CommandCancel>()[0];
    assert_eq!((cancel.target_system, cancel.target_component), (10, 1));
}

/// K-5: only the answer of the recipient to this command is one; component 0 is every component of a system.
#[test]
fn only_the_recipient_answers() {
    let mut world = sky();
    beat(&mut world, COMPANION, AUTHORISER, MavType::ONBOARD_CONTROLLER);
    answer(&mut world, COMPANION, AUTHORISER, ack(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED));
    assert!(world.stack.send_command(Address::new(10, 0), EQUAL));
    world.run_for(millis(50));
    let (_, command) = world.gcs[COMPANION].all::<CommandLong>()[0];
    assert_eq!((command.target_system, command.target_component), (10, 0));
    answer(&mut world, COMPANION, GIMBAL, ack(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED));
    answer(&mut world, COMPANION, AUTHORISER, ack(PITCHYAW, MavResult::ACCEPTED));
    let other =
        CommandAck { target_system: 255, target_component: 190, ..ack(MavCmd::DO_SET_SERVO, MavResult::DENIED) };
    answer(&mut world, COMPANION, AUTHORISER, other);
    assert_eq!(world.vehicle.replies, []);
    answer(&mut world, COMPANION, Address::new(10, 7), ack(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED));
    assert_eq!(world.vehicle.replies, [(EQUAL, done(MavResult::ACCEPTED))]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// K-1: each accepted command ends with exactly one final reply, whatever the recipient answers and whatever is lost.
    #[test]
    fn every_command_ends_once(
        events in prop::collection::vec((0u16..4, 0u8..8, 0u64..1_500), 1..60),
    ) {
        let mut world = sky_at(millis(10));
        let mut accepted = Vec::new();
        for (number, (which, what, pause)) in (0..).zip(events) {
            let command = KINDS[usize::from(which)];
            match what {
                0 => beat(&mut world, COMPANION, GIMBAL, MavType::GIMBAL),
                1 => answer(&mut world, COMPANION, GIMBAL, ack(command, MavResult::ACCEPTED)),
                2 => answer(&mut world, COMPANION, GIMBAL, ack(command, MavResult::IN_PROGRESS)),
                3 => {
                    let _ = world.stack.cancel_sent_command(VARIED + number / 2);
                }
                4 => world.stack.restart_link(LinkId(1)),
                _ => {
                    let token = VARIED + number;
                    if world.stack.send_command(GIMBAL, token) {
                        accepted.push(token);
                    }
                }
            }
            world.run_for(millis(pause));
        }
        world.run_for(secs(30 * 8));
        let is_final = |&&(_, reply): &&(u16, CommandReply)| !matches!(reply, CommandReply::InProgress(_));
        let mut ended: Vec<u16> = world.vehicle.replies.iter().filter(is_final).map(|&(token, _)| token).collect();
        ended.sort();
        prop_assert_eq!(ended, accepted);
        // All slots are free again.
        beat(&mut world, COMPANION, GIMBAL, MavType::GIMBAL);
        world.run_for(millis(50));
        world.gcs[COMPANION].forget();
        for token in [POINT, REQUEST] {
            prop_assert!(world.stack.send_command(GIMBAL, token));
        }
        world.run_for(millis(100));
        prop_assert_eq!(sent(&world, COMPANION).len(), 2);
    }
}
