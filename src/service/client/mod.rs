//! The vehicle's own requests to other components, such as a gimbal, a camera or an arm authoriser: commands, messages on
//! request, and parameters.
//!
//! Implements the client's side of <https://mavlink.io/en/services/command.html>; arm authorisation (O-3) is built on
//! it. A hook or the flight loop names the recipient and a token, [`CommandClient::command_for`] makes the command of
//! the token, and [`CommandClient::command_answered`] gets its outcome (K-1 to K-7):
//!
//! ```text
//!                      ┌── five attempts of 700 ms ─────────▶ TimedOut; NotSent if no link took it
//!   send_command ─▶ sent ─── IN_PROGRESS ──▶ running ── silent for 30 s ──▶ TimedOut
//!                      │                        │                  │  unchanged for 30 s while another request waits
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

mod slot;
mod vehicle;

pub use slot::Slot;
pub(crate) use vehicle::check;
pub use vehicle::{CommandClient, CommandReply, ExtParamValue, OutgoingCommand, ParamAnswer};

use super::{About, Cx, Handled, OwnCommands, OwnRequest, Received, Service, Turn, View};
use crate::dialect::{CommandAck, MavCmd, MavResult, ParamError, ParamValue};
use crate::link::Port;
use crate::message::Address;
use crate::time::Instant;
use crate::types::{Cancellation, CommandAnswer, Firmware, LinkId, MAX_PENDING, Outcome, Peer, Pending};
use slot::{ClientRequest, SlotState, find, find_own, note_answer};

/// The maximum number of transmissions of a request.
const TRANSMISSIONS: u8 = 5;

/// Sends the vehicle's requests and follows them, `N` at a time.
#[derive(Debug)]
pub struct Client<const N: usize> {
    slots: [Slot; N],
}

impl<F: Firmware<Vehicle: CommandClient>, const N: usize> Service<F> for Client<N> {
    type Link = ();
    const VACANT: () = ();
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::Client]);
    /// The index of the slot whose request is sent.
    type Reply = usize;
    const NEW: Self = {
        assert!(N > 0, "a command needs a slot: `command_client: {{ slots: 2 }}`, or leave `command_client` out");
        Self { slots: [Slot::FREE; N] }
    };

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ()>) {
        if cx.requests.has_request() {
            self.make_room();
        }
        self.run_timers(cx);
        self.start_waiting(cx.now);
        // Bounded: a hook may queue a new request for each one that is taken.
        for _ in 0..MAX_PENDING {
            self.take_cancellation(cx);
            self.take_request(cx);
        }
        self.start_waiting(cx.now);
        let has_free_slot = self.slots.iter().any(|slot| slot.state == SlotState::Free);
        let is_due = has_free_slot && cx.requests.has_request();
        cx.requests.set_client_due(is_due);
    }

    fn deadline(&self) -> Instant {
        let started = self.slots.iter().filter(|slot| slot.is_started());
        started.map(|slot| slot.deadline).min().unwrap_or(Instant::NEVER)
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut (), received: &Received<'_>) -> Handled {
        if let Some(ack) = received.frame.decode::<CommandAck>() {
            let CommandAck { command, result, progress, result_param2, .. } = ack;
            let outcome = Outcome { result, result_param2 };
            let answer = CommandAnswer { command, outcome, progress };
            return if received.counts { self.on_command_answer(cx, received.from, answer) } else { Handled::No };
        }
        if F::Vehicle::READS_PARAMS && received.counts { self.on_param_answer(cx, received) } else { Handled::No }
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, (): &(), _: Turn) -> Option<(Instant, usize)> {
        let index = self.slots.iter().position(|slot| slot.is_due_on(port))?;
        Some((view.now, index))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, (): &mut (), index: usize) -> bool {
        self.slots.get_mut(index).is_some_and(|slot| slot.send::<F::Vehicle>(cx.now, &mut port.outbox))
    }
}

/// The firmware's own components are on no link: [`LinkId::NONE`].
impl<F: Firmware<Vehicle: CommandClient>, const N: usize> OwnCommands<F> for Client<N> {
    fn take_own(&mut self, now: Instant, own: Address) -> Option<OwnRequest> {
        let is_due = |slot: &&mut Slot| slot.state == SlotState::Due && slot.to.link == LinkId::NONE;
        let slot = self.slots.iter_mut().find(is_due)?;
        let command = slot.take_own(now, own)?;
        Some(if slot.is_cancelled { OwnRequest::Cancel(command) } else { OwnRequest::Execute(command) })
    }

    fn own_slots(&self) -> usize {
        N
    }

    fn running_own(&self, index: usize) -> Option<MavCmd> {
        let slot = self.slots.get(index)?;
        let is_it = slot.to.link == LinkId::NONE && slot.is_running && slot.state != SlotState::Free;
        slot.command().filter(|_| is_it)
    }

    fn answered_own(&mut self, cx: &mut Cx<'_, F>, from: Address, answer: CommandAnswer) {
        self.on_command_answer(cx, Peer { address: from, link: LinkId::NONE }, answer);
    }
}

impl<const N: usize> Client<N> {
    /// A request waits. Without a slot for it, the running command of a peer whose progress has not changed for the longest time gives
    /// way, after a while. One at a time: a slot that has ended is soon free (X-3).
    fn make_room(&mut self) {
        if !self.slots.iter().any(|slot| matches!(slot.state, SlotState::Free | SlotState::Ended)) {
            let is_peers = |slot: &&mut Slot| slot.state == SlotState::Running && slot.to.link != LinkId::NONE;
            let running = self.slots.iter_mut().filter(is_peers);
            if let Some(oldest) = running.min_by_key(|slot| slot.changed_at) {
                oldest.give_way();
            }
        }
    }

    /// Sends unanswered requests again, or ends them.
    fn run_timers<F: Firmware<Vehicle: CommandClient>>(&mut self, cx: &mut Cx<'_, F>) {
        for slot in &mut self.slots {
            // The rest is for services that are polled later (X-6).
            if !cx.shared.has_hooks(12) {
                break;
            }
            match slot.state {
                SlotState::Free | SlotState::Waiting => {}
                _ if cx.now < slot.deadline => {}
                SlotState::Ended => slot.state = SlotState::Free,
                SlotState::Due | SlotState::Sent if slot.attempts.0 < TRANSMISSIONS => {
                    slot.try_again(cx.now, cx.peers, cx.shared);
                }
                // It cannot be cancelled.
                SlotState::Due | SlotState::Sent if slot.is_running && slot.is_cancelled => {
                    slot.expect_progress(cx.now)
                }
                SlotState::Due | SlotState::Sent | SlotState::Running => {
                    slot.end(cx.now, false);
                    let is_command = slot.command().is_some();
                    match slot.transmissions.0 {
                        0 => fail(cx, is_command, slot.token, CommandReply::NotSent, ParamAnswer::NotSent),
                        _ => fail(cx, is_command, slot.token, CommandReply::TimedOut, ParamAnswer::TimedOut),
                    }
                }
            }
        }
    }

    /// Starts the requests that wait, except behind an equal command: an answer does not say which of two it answers.
    fn start_waiting(&mut self, now: Instant) {
        for index in 0..N {
            let Some(&slot) = self.slots.get(index).filter(|slot| slot.state == SlotState::Waiting) else { continue };
            let is_blocked = self.slots.iter().any(|other| other.is_started() && other.is_like(&slot));
            if let Some(slot) = self.slots.get_mut(index).filter(|_| !is_blocked) {
                slot.start(now);
            }
        }
    }

    /// Handles a cancellation, if one is queued.
    fn take_cancellation<F: Firmware<Vehicle: CommandClient>>(&mut self, cx: &mut Cx<'_, F>) {
        /// The reply for a command that was cancelled before it was sent.
        const CANCELLED: CommandReply = CommandReply::Done { result: MavResult::CANCELLED, result_param2: 0 };

        let token = match cx.requests.take_cancellation() {
            None => return,
            Some(Cancellation::OfQueued { token }) => return report(cx, token, CANCELLED),
            Some(Cancellation::OfStarted { token }) => token,
        };
        for slot in &mut self.slots {
            let is_it = slot.token == token && slot.command().is_some();
            if !is_it || slot.is_cancelled || matches!(slot.state, SlotState::Free | SlotState::Ended) {
                continue;
            }
            if slot.transmissions.0 > 0 {
                slot.cancel(cx.now, cx.peers, cx.shared);
            } else {
                slot.state = SlotState::Free;
                report(cx, token, CANCELLED);
            }
        }
    }

    /// Takes up a command or a parameter to read, if one is queued and there is a slot for it.
    fn take_request<F: Firmware<Vehicle: CommandClient>>(&mut self, cx: &mut Cx<'_, F>) {
        // A slot that has ended is not free yet: an equal command may wait behind it, and must not get its answers.
        let Some(slot) = self.slots.iter_mut().find(|slot| slot.state == SlotState::Free) else { return };
        let (to, token, request, is_command) = match cx.requests.take_request() {
            Some(Pending::Command { to, token }) => {
                (to, token, cx.vehicle.command_for(token).map(ClientRequest::Command), true)
            }
            Some(Pending::Param { to, token, is_ext }) if F::Vehicle::READS_PARAMS => {
                let name = cx.vehicle.param_for(token);
                (to, token, name.map(|name| ClientRequest::Param { name, is_ext }), false)
            }
            _ => return,
        };
        let may_be_own = is_command && !cx.shared.leaves_out_components::<F>();
        let own = if may_be_own { find_own(F::COMPONENTS, cx.shared, to) } else { None };
        match (own.or_else(|| find(cx.peers, cx.shared, to)), request) {
            (Some(to), Some(request)) => {
                *slot = Slot::waiting(to, token, request);
            }
            _ => fail(cx, is_command, token, CommandReply::NotSent, ParamAnswer::NotSent),
        }
    }

    /// Handles a COMMAND_ACK, which may answer a command.
    fn on_command_answer<F: Firmware<Vehicle: CommandClient>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        answer: CommandAnswer,
    ) -> Handled {
        let CommandAnswer { command, outcome: Outcome { result, result_param2 }, progress } = answer;
        let is_it = |slot: &&mut Slot| slot.is_answered_by(from) && slot.command() == Some(command);
        let Some(slot) = self.slots.iter_mut().find(is_it) else { return Handled::No };
        // A duplicate; or a component that does not know a command to all of a system.
        let is_unknown = slot.to.address.component.is_all() && result == MavResult::UNSUPPORTED;
        if slot.state == SlotState::Ended || is_unknown {
            return Handled::Yes;
        }
        // The next poll starts the request that waits for the slot, and takes up the hook's requests.
        cx.requests.set_client_due(true);
        note_answer(cx.peers, from);
        let reply = if result == MavResult::IN_PROGRESS {
            slot.on_progress(cx.now, from.address, progress);
            CommandReply::InProgress(progress)
        } else {
            slot.end(cx.now, true);
            CommandReply::Done { result, result_param2 }
        };
        report(cx, slot.token, reply);
        Handled::Yes
    }

    /// Handles a frame that may be an answer to a request for a parameter.
    fn on_param_answer<F: Firmware<Vehicle: CommandClient>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        received: &Received<'_>,
    ) -> Handled {
        let frame = received.frame;
        let value = frame.decode::<ParamValue>();
        let (name, is_ext, answer) = if let Some(value) = &value {
            (value.param_id, Some(false), ParamAnswer::Value(value))
        } else if let Some(error) = frame.decode::<ParamError>() {
            (error.param_id, None, ParamAnswer::Refused(error.error))
        } else if let Some((name, value)) = ExtParamValue::read(frame) {
            (name, Some(true), ParamAnswer::ExtValue(value))
        } else {
            return Handled::No;
        };
        let is_it = |slot: &&mut Slot| match &slot.request {
            ClientRequest::Param { name: requested, is_ext: wants_ext } => {
                // Bytes after the NUL are no part of the name (S-18).
                let is_same = requested.as_bytes() == name.as_bytes();
                is_same && is_ext.is_none_or(|is_ext| is_ext == *wants_ext) && slot.is_answered_by(received.from)
            }
            ClientRequest::Command(_) => false,
        };
        let Some(slot) = self.slots.iter_mut().find(is_it) else { return Handled::No };
        slot.state = SlotState::Free;
        cx.requests.set_client_due(true);
        note_answer(cx.peers, received.from);
        let (vehicle, mut context) = cx.hook();
        vehicle.param_answered(&mut context, slot.token, answer);
        Handled::Yes
    }
}

/// Passes it on to the vehicle that a request has no answer: `reply` if it is a command, or else `answer`.
fn fail<F: Firmware<Vehicle: CommandClient>>(
    cx: &mut Cx<'_, F>,
    is_command: bool,
    token: u16,
    reply: CommandReply,
    answer: ParamAnswer<'_>,
) {
    if is_command || !F::Vehicle::READS_PARAMS {
        return report(cx, token, reply);
    }
    let (vehicle, mut context) = cx.hook();
    vehicle.param_answered(&mut context, token, answer);
}

/// Passes a reply to the vehicle, which may refuse the command of a ground station because of it: its texts are answers, also those
/// about silence (C-16).
fn report<F: Firmware<Vehicle: CommandClient>>(cx: &mut Cx<'_, F>, token: u16, reply: CommandReply) {
    let was_answering = core::mem::replace(&mut cx.texts.is_answering, true);
    let (vehicle, mut context) = cx.hook();
    vehicle.command_answered(&mut context, token, reply);
    cx.texts.is_answering = was_answering;
}
