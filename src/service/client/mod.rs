//! The vehicle's own requests to other components, such as a gimbal, a camera or an arm authoriser: commands, messages on
//! request, and parameters.
//!
//! Implements the client's side of <https://mavlink.io/en/services/command.html>; arm authorisation (O-3) is built on it. A hook
//! or the flight loop names the recipient and a token, [`CommandClient::command_for`] makes the command of the token, and
//! [`CommandClient::command_answered`] learns what became of it (K-1 to K-7):
//!
//! ```text
//!                      ┌── five attempts of 700 ms ─────────▶ TimedOut; NotSent if no link took it
//!   send_command ─▶ sent ─── IN_PROGRESS ──▶ running ── silent for 10 s ──▶ TimedOut
//!                      │                        │
//!                      └── any other result ────┴──▶ Done       cancel_sent_command: COMMAND_CANCEL, sent in the same way
//! ```
//!
//! The first transmission takes the link on which the recipient has answered last, or else the one on which it was heard first:
//! anybody may send its heartbeats on another open link. Retransmissions have a rising `confirmation` and take the next link on
//! which the recipient is alive, so a redundant link takes over; only the first of them stays where it has answered.
//!
//! An answer does not say which of two commands it answers. So of two commands with the same number to the same component the second
//! waits until the first has ended; if that was sent more than once, two seconds longer, in which the first keeps its slot.
//!
//! A command to another [component](crate::Components) of the firmware itself is carried out by the next
//! [`poll`](crate::Stack::poll), and sent on no link (K-11). High-latency links carry no answers to the vehicle (L-4), and so no
//! requests.

mod param;
mod recipients;
mod slot;

pub use param::{ExtParamValue, ParamAnswer};
pub use slot::Slot;

pub(crate) use param::check;

use self::param::Query;
use self::recipients::{find, find_inside, note_answer};
use self::slot::{State, What};
use super::{About, Cx, Handled, OwnCommands, Received, Service, Turn, View};
use crate::dialect::{CommandAck, MavCmd, MavFrame, MavResult};
use crate::link::Port;
use crate::message::{Address, Message, Text};
use crate::num;
use crate::time::{Duration, Instant};
use crate::types::{
    Answer, Command, CommandPosition, Context, Firmware, LinkClass, LinkId, Outcome, PENDING, Peer, Pending, Recipient,
};

/// How long to wait for an answer before the command is sent again.
const TIMEOUT: Duration = Duration::from_millis(700);

/// The maximum number of transmissions of a command.
const TRANSMISSIONS: u8 = 5;

/// How long to wait after IN_PROGRESS. Its sender repeats it about every second (C-20).
const PROGRESS_TIMEOUT: Duration = Duration::from_secs(10);

/// A command that the vehicle sends, as COMMAND_LONG or COMMAND_INT.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OutgoingCommand {
    id: MavCmd,
    params: [f32; 4],
    position: CommandPosition,
    z: f32,
}

impl OutgoingCommand {
    /// All zero bits.
    const NONE: Self = Self::long(MavCmd(0), [0.0; 7]);

    /// Returns a command for COMMAND_LONG. A command with a location has it in degrees.
    pub const fn long(id: MavCmd, params: [f32; 7]) -> Self {
        let [p1, p2, p3, p4, param5, param6, z] = params;
        Self { id, params: [p1, p2, p3, p4], position: CommandPosition::Long { param5, param6 }, z }
    }

    /// Returns MAV_CMD_REQUEST_MESSAGE: message `M`, once. Each message defines what `index` means; 0 is the default (Q-3).
    /// [`Vehicle::message`](crate::Vehicle::message) gets the message.
    pub fn request_message<M: Message>(index: u16) -> Self {
        Self::long(
            MavCmd::REQUEST_MESSAGE,
            [num::from_i32(M::ID.cast_signed()), f32::from(index), 0.0, 0.0, 0.0, 0.0, 0.0],
        )
    }

    /// Returns MAV_CMD_SET_MESSAGE_INTERVAL: message `M` at this interval. `None` stops it, and zero is the component's
    /// default (Q-4).
    pub fn set_message_interval<M: Message>(interval: Option<Duration>) -> Self {
        let micros = interval
            .map_or(-1.0, |interval| num::from_i32(i32::try_from(interval.as_micros()).unwrap_or(i32::MAX - 1)));
        Self::long(MavCmd::SET_MESSAGE_INTERVAL, [num::from_i32(M::ID.cast_signed()), micros, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    /// Returns a command for COMMAND_INT: parameters 1 to 4, the position (deg·1e7 in a global frame), and parameter 7.
    pub const fn int(id: MavCmd, frame: MavFrame, params: [f32; 4], [x, y]: [i32; 2], z: f32) -> Self {
        Self { id, params, position: CommandPosition::Int { frame, x, y }, z }
    }
}

/// What became of a command of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CommandReply {
    /// It runs, and another reply follows. Progress in percent; 255 is unknown.
    InProgress(u8),
    /// It was answered: ACCEPTED, CANCELLED, or why it was refused.
    Done {
        /// The result.
        result: MavResult,
        /// COMMAND_ACK.result_param2. Each command defines its meaning.
        result_param2: i32,
    },
    /// It was not sent: no such component is alive on a normal link, its link took nothing, or the vehicle made no command of
    /// the token.
    NotSent,
    /// It was not answered: it was lost each time, its recipient does not know commands, or it stopped reporting progress.
    TimedOut,
}

/// The vehicle sends commands to other components. For a vehicle that declares `command_client` in
/// [`#[stack]`](macro@crate::Stack).
///
/// ```
/// use mavstack::dialect::{MavCmd, MavResult, MavSeverity, MavType};
/// use mavstack::prelude::*;
///
/// struct Carrier { pitch: f32 }
///
/// const POINT_GIMBAL: u16 = 1;
///
/// impl Carrier {
///     fn point(&mut self, cx: &mut Context<'_>, pitch: f32) {
///         self.pitch = pitch;
///         if !cx.send_command(Recipient::Type(MavType::GIMBAL), POINT_GIMBAL) {
///             cx.text(MavSeverity::WARNING, "Gimbal: too many commands");
///         }
///     }
/// }
///
/// impl CommandClient for Carrier {
///     fn command_for(&mut self, token: u16) -> Option<OutgoingCommand> {
///         let params = [self.pitch, 0.0, f32::NAN, f32::NAN, 0.0, 0.0, 0.0];
///         (token == POINT_GIMBAL).then_some(OutgoingCommand::long(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, params))
///     }
///
///     fn command_answered(&mut self, cx: &mut Context<'_>, _: u16, reply: CommandReply) {
///         match reply {
///             CommandReply::InProgress(_) | CommandReply::Done { result: MavResult::ACCEPTED, .. } => {}
///             _ => cx.text(MavSeverity::WARNING, "Gimbal: not pointed"),
///         }
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `CommandClient`",
    note = "`command_client` in `#[stack]` needs `impl CommandClient for {Self}`: write it, or leave `command_client` out"
)]
pub trait CommandClient {
    /// Returns the command that a token stands for: once, when a slot takes it up. Transmissions repeat it. `None` if there is
    /// nothing to send any more.
    fn command_for(&mut self, token: u16) -> Option<OutgoingCommand>;

    /// Called with what became of a command: any number of times with [`CommandReply::InProgress`], then once with another
    /// reply.
    fn command_answered(&mut self, cx: &mut Context<'_>, token: u16, reply: CommandReply);

    /// Whether the vehicle also [reads parameters](Context::read_param) of other components. The code for it is left out
    /// if not.
    const READS_PARAMS: bool = false;

    /// Returns the name of the parameter that a token stands for: at most 16 bytes. `None` if there is nothing to read any
    /// more.
    fn param_for(&mut self, token: u16) -> Option<Text<16>> {
        let _ = token;
        None
    }

    /// Called once with the answer to each [`Context::read_param`].
    fn param_answered(&mut self, cx: &mut Context<'_>, token: u16, answer: ParamAnswer<'_>) {
        let _ = (cx, token, answer);
    }
}

/// Sends the vehicle's requests and follows them, `N` at a time.
#[derive(Debug)]
pub struct Client<const N: usize> {
    slots: [Slot; N],
}

impl<F: Firmware<Vehicle: CommandClient>, const N: usize> Service<F> for Client<N> {
    type Link = ();
    const VACANT: () = ();
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::Client]);
    /// The number of the slot whose request is sent.
    type Reply = usize;
    const NEW: Self = {
        assert!(N > 0, "a command needs a slot: `command_client: {{ slots: 2 }}`, or leave `command_client` out");
        Self { slots: [Slot::FREE; N] }
    };

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ()>) {
        run_timers(&mut self.slots, cx);
        start_waiting(&mut self.slots, cx.now);
        // A hook may request as much again, so this is bounded.
        for _ in 0..PENDING {
            take_cancellation(&mut self.slots, cx);
            take_request(&mut self.slots, cx);
        }
        start_waiting(&mut self.slots, cx.now);
        let has_room = self.slots.iter().any(|slot| slot.state == State::Free);
        let is_due = has_room && cx.requests.has_request();
        cx.requests.set_client_due(is_due);
    }

    fn deadline(&self) -> Instant {
        let timed = self.slots.iter().filter(|slot| !matches!(slot.state, State::Free | State::Waiting));
        timed.fold(Instant::NEVER, |deadline, slot| deadline.min(slot.at))
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut (), received: &Received<'_>) -> Handled {
        match received.frame.id() {
            CommandAck::ID => match received.frame.decode().map(answer_of) {
                Some(answer) => take_answer(&mut self.slots, cx, received.from, answer),
                None => Handled::No,
            },
            _ if F::Vehicle::READS_PARAMS => param::take_answer(&mut self.slots, cx, received),
            _ => Handled::No,
        }
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, (): &(), _: Turn) -> Option<(Instant, usize)> {
        due_on(&self.slots, port).map(|number| (view.now, number))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, (): &mut (), number: usize) -> bool {
        let Some(slot) = self.slots.get_mut(number) else { return false };
        (slot.state, slot.at) = (State::Sent, cx.now + TIMEOUT);
        let confirmation = slot.sent;
        slot.sent = slot.sent.saturating_add(1);
        match &slot.what {
            What::Command(command) => slot.send_command(command, confirmation, port),
            What::Param(query) => F::Vehicle::READS_PARAMS && query.send(slot.to.address, port),
        }
    }
}

/// The firmware's own components are on no link: [`LinkId::NONE`].
impl<F: Firmware<Vehicle: CommandClient>, const N: usize> OwnCommands<F> for Client<N> {
    fn take_own(&mut self, now: Instant, own: Address) -> Option<(Command, bool)> {
        take_own(&mut self.slots, now, own)
    }

    fn own_slots(&self) -> usize {
        N
    }

    fn running_own(&self, number: usize) -> Option<MavCmd> {
        let is_it = |slot: &&Slot| slot.to.link == LinkId::NONE && slot.is_running && slot.state != State::Free;
        self.slots.get(number).filter(is_it).and_then(Slot::command)
    }

    fn answered_own(&mut self, cx: &mut Cx<'_, F>, from: Address, answer: Answer) {
        take_answer(&mut self.slots, cx, Peer { address: from, link: LinkId::NONE }, answer);
    }
}

/// Takes a transmission that is pending for one of our components.
fn take_own(slots: &mut [Slot], now: Instant, own: Address) -> Option<(Command, bool)> {
    let slot = slots.iter_mut().find(|slot| slot.state == State::Due && slot.to.link == LinkId::NONE)?;
    let What::Command(OutgoingCommand { id, params, position, z }) = slot.what else { return None };
    (slot.state, slot.at) = (State::Sent, now + TIMEOUT);
    slot.sent = slot.sent.saturating_add(1);
    let command = Command {
        id,
        params,
        position,
        z,
        from: Peer { address: own, link: LinkId::NONE },
        class: LinkClass::Normal,
        age: None,
        component: slot.to.address.component,
        is_broadcast: false,
        confirmation: 0,
    };
    Some((command, slot.is_cancelled))
}

/// Returns the index of a slot whose transmission is pending on a link that can carry it: MAVLink 1 has no extended
/// parameters (S-10).
fn due_on(slots: &[Slot], port: &Port) -> Option<usize> {
    let is_due = |slot: &Slot| {
        let has_target = !slot.is_cancelled || slot.executor.wire() != 0;
        slot.state == State::Due && slot.to.link == port.id && has_target
    };
    slots.iter().position(|slot| is_due(slot) && (slot.command().is_some() || port.outbox.takes(slot.id())))
}

fn answer_of(ack: CommandAck) -> Answer {
    let CommandAck { command, result, progress, result_param2, .. } = ack;
    Answer { command, outcome: Outcome { result, result_param2 }, progress }
}

/// Handles what may be an answer.
fn take_answer<F: Firmware<Vehicle: CommandClient>>(
    slots: &mut [Slot],
    cx: &mut Cx<'_, F>,
    peer: Peer,
    Answer { command, outcome: Outcome { result, result_param2 }, progress }: Answer,
) -> Handled {
    let from = peer.address;
    let is_it = |slot: &&mut Slot| slot.is_answered_by(from) && slot.command() == Some(command);
    let Some(slot) = slots.iter_mut().find(is_it) else { return Handled::No };
    let is_for_all = slot.to.address.component.is_all();
    // A duplicate; or a component that knows nothing of a command to all of a system.
    if slot.state == State::Ended || is_for_all && result == MavResult::UNSUPPORTED {
        return Handled::Yes;
    }
    // The next poll takes up what waits for the slot, and what the hook requests.
    cx.requests.set_client_due(true);
    note_answer(cx.peers, peer);
    let reply = if result == MavResult::IN_PROGRESS {
        (slot.is_running, slot.to.address) = (true, from);
        // The cancellation of a running command is sent all the same, and again now that it is known which component to tell.
        if !slot.is_cancelled {
            (slot.state, slot.at) = (State::Running, cx.now + PROGRESS_TIMEOUT);
        } else if is_for_all {
            slot.start(cx.now);
            slot.executor = from.component;
        }
        CommandReply::InProgress(progress)
    } else {
        slot.end(cx.now, true);
        CommandReply::Done { result, result_param2 }
    };
    answered(cx, slot.token, reply);
    Handled::Yes
}

/// Has unanswered requests sent again, or ends them.
fn run_timers<F: Firmware<Vehicle: CommandClient>>(slots: &mut [Slot], cx: &mut Cx<'_, F>) {
    for slot in slots {
        match slot.state {
            State::Free | State::Waiting => {}
            _ if cx.now < slot.at => {}
            State::Ended => slot.state = State::Free,
            State::Due | State::Sent if slot.tries < TRANSMISSIONS => slot.try_again(cx.now, cx.peers, cx.shared),
            // It cannot be cancelled.
            State::Due | State::Sent if slot.is_running && slot.is_cancelled => {
                (slot.state, slot.at) = (State::Running, cx.now + PROGRESS_TIMEOUT);
            }
            State::Due | State::Sent | State::Running => {
                let failure = if slot.sent == 0 { Failure::NotSent } else { Failure::TimedOut };
                slot.end(cx.now, false);
                fail(cx, slot.command().is_some(), slot.token, failure);
            }
        }
    }
}

/// Takes up a cancellation, if one is pending.
fn take_cancellation<F: Firmware<Vehicle: CommandClient>>(slots: &mut [Slot], cx: &mut Cx<'_, F>) {
    let Some((token, is_queued)) = cx.requests.take_cancellation() else { return };
    if is_queued {
        return answered(cx, token, CANCELLED);
    }
    for slot in slots {
        let is_it = !matches!(slot.state, State::Free | State::Ended) && slot.token == token;
        if !is_it || slot.is_cancelled || slot.command().is_none() {
            continue;
        }
        if slot.sent > 0 {
            slot.is_cancelled = true;
            slot.start(cx.now);
            slot.aim(cx.peers, cx.shared);
        } else {
            slot.state = State::Free;
            answered(cx, token, CANCELLED);
        }
    }
}

/// Takes up a command or a parameter to read, if one is pending and there is a slot for it.
fn take_request<F: Firmware<Vehicle: CommandClient>>(slots: &mut [Slot], cx: &mut Cx<'_, F>) {
    // A slot that has ended is not free yet: an equal command may wait behind it, and must not get its answers.
    let Some(slot) = slots.iter_mut().find(|slot| slot.state == State::Free) else { return };
    let Some(request) = cx.requests.take_request() else { return };
    let (to, token, what) = match request {
        Pending::Command { to, token } => (to, token, cx.vehicle.command_for(token).map(What::Command)),
        Pending::Param { to, token, is_ext } if F::Vehicle::READS_PARAMS => {
            let name = cx.vehicle.param_for(token);
            (to, token, name.map(|name| What::Param(Query { name, is_ext })))
        }
        _ => return,
    };
    let is_command = matches!(request, Pending::Command { .. });
    let has_inside = is_command && !cx.shared.leaves_out_components::<F>();
    let inside = if has_inside { find_inside(F::COMPONENTS, cx.shared, to) } else { None };
    match (inside.or_else(|| find(cx.peers, cx.shared, to)), what) {
        (Some(to), Some(what)) => *slot = Slot { state: State::Waiting, to, token, what, ..Slot::FREE },
        _ => {
            fail(cx, is_command, token, Failure::NotSent);
        }
    }
}

/// Starts the requests that wait, except behind an equal command: an answer does not say which of two it answers.
fn start_waiting(slots: &mut [Slot], now: Instant) {
    for number in 0..slots.len() {
        let Some(&slot) = slots.get(number).filter(|slot| slot.state == State::Waiting) else { continue };
        let is_before = |other: &Slot| !matches!(other.state, State::Free | State::Waiting) && other.is_like(&slot);
        let is_blocked = slots.iter().any(is_before);
        if let Some(slot) = slots.get_mut(number).filter(|_| !is_blocked) {
            slot.start(now);
        }
    }
}

/// Why there is no answer.
#[derive(Clone, Copy)]
enum Failure {
    NotSent,
    TimedOut,
}

/// The reply for a command that was cancelled before it was sent.
const CANCELLED: CommandReply = CommandReply::Done { result: MavResult::CANCELLED, result_param2: 0 };

/// Tells the vehicle that there is no answer.
fn fail<F: Firmware<Vehicle: CommandClient>>(cx: &mut Cx<'_, F>, is_command: bool, token: u16, failure: Failure) {
    if is_command || !F::Vehicle::READS_PARAMS {
        let reply = match failure {
            Failure::NotSent => CommandReply::NotSent,
            Failure::TimedOut => CommandReply::TimedOut,
        };
        return answered(cx, token, reply);
    }
    let answer = match failure {
        Failure::NotSent => ParamAnswer::NotSent,
        Failure::TimedOut => ParamAnswer::TimedOut,
    };
    let (vehicle, mut context) = cx.hook();
    vehicle.param_answered(&mut context, token, answer);
}

/// Passes a reply to the vehicle, which may refuse the command of a ground station because of it: its texts are answers, also those
/// about silence (C-16).
fn answered<F: Firmware<Vehicle: CommandClient>>(cx: &mut Cx<'_, F>, token: u16, reply: CommandReply) {
    let was_answering = core::mem::replace(&mut cx.texts.is_answering, true);
    let (vehicle, mut context) = cx.hook();
    vehicle.command_answered(&mut context, token, reply);
    cx.texts.is_answering = was_answering;
}

impl Context<'_> {
    /// Sends a command to another component, and repeats it until it is answered: see [`CommandClient`]. The next
    /// [`poll`](crate::Stack::poll) takes it up, or a later one if all slots are taken. One that waits for that already, with the
    /// same recipient and token, is not queued twice, so both get one reply. Returns false, and sends nothing, if eight requests
    /// wait, or if [`#[stack]`](macro@crate::Stack) does not declare `command_client`.
    #[must_use = "it is not sent if too many commands wait"]
    pub fn send_command(&mut self, to: impl Into<Recipient>, token: u16) -> bool {
        self.requests.request(Pending::Command { to: to.into(), token })
    }

    /// Cancels the commands with this token that were requested before: they are not sent, or else COMMAND_CANCEL is sent for
    /// them. The reply to each goes to [`CommandClient::command_answered`], under its token: many components know no
    /// COMMAND_CANCEL, and answer the command itself in the end. So use another token for another command meanwhile. Returns
    /// false if eight requests wait.
    #[must_use = "it is not cancelled if too many commands wait"]
    pub fn cancel_sent_command(&mut self, token: u16) -> bool {
        self.requests.request(Pending::Cancel { token })
    }
}
