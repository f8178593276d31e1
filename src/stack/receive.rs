//! The receiving half of the stack: the address filter, then the services one by one. Frames beyond the poll's budget
//! wait in the decoder (D-2).

use super::services::{Services, States};
use super::{Declares, Stack};
use crate::dialect::{MavCmd, MavResult, MavSeverity};
use crate::frame::{Checks, Decoder, Frame};
use crate::link::{Accepted, Link, Port};
use crate::message::{Address, Text};
use crate::network::{self, ForwardDecision, Reception, Recorded, Residents, SenderEntry};
use crate::service::command::{self, CommandMemory, CommandService};
use crate::service::mission;
use crate::service::mode;
use crate::service::{
    ControlGate, Cx, Examined, ForwardingGate, Handled, OwnCommands, OwnRequest, Received, Request, SigningGate,
    SticksGate, Turn, Verdict, increment,
};
use crate::time::Instant;
use crate::types::{
    Allowance, CommandAnswer, CreditMemory, LinkId, MAX_TEXT_LEN, Payer, Peer, PeerEvent, Trust, Vehicle,
};

/// What a sender for which the peer table has no free place takes of the allowance of a poll, besides its frame: a look at all peers, and
/// calls of hooks if it evicts one.
const COST_OF_NEWCOMER: u32 = 300;

/// A received frame with our own address: an echo, if a link has sent such a frame.
#[derive(Clone, Copy)]
pub(super) struct OwnFrame {
    pub(super) seq: u8,
    /// The low byte.
    pub(super) checksum: u8,
}

/// What a frame is worth as evidence of its sender.
#[derive(Clone, Copy)]
pub(super) struct Standing {
    trust: Trust,
    /// See [`Received::counts`].
    counts: bool,
    /// See [`Received::may_change`].
    may_change: bool,
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Makes the next deadline the present: received bytes are pending outside the decoders.
    pub(crate) const fn poll_again(&mut self) {
        self.shared.has_acted = true;
    }
}

impl<D: Declares> Services<D> {
    /// Handles the frames that the decoder finds. Returns the last frame with our own address, which may be an echo.
    pub(super) fn drain(
        &mut self,
        cx: &mut Cx<'_, D>,
        link: &mut Link,
        state: &mut States<D>,
        allowance: &mut Allowance,
    ) -> Option<OwnFrame> {
        if D::HAS_CONTROL {
            cx.shared.controllers = self.operator_control.controllers();
        }
        let mut own_frame = None;
        let Link { decoder, port } = link;
        // All calls of a poll of the link share the allowance.
        cx.shared.hooks = allowance.hooks;
        while allowance.may_handle() && cx.shared.may_handle_frame() {
            let next = self.next_frame(cx, decoder, allowance);
            // By reference: it is large.
            let Some(frame) = &next else { break };
            allowance.handle();
            allowance.spend(self.signing.cost(frame));
            let id = frame.id();
            let is_from_us = is_our_address(cx, frame.source());
            if is_from_us {
                own_frame = self.count_own_frame(cx, port, frame).or(own_frame);
            }
            let standing = if is_from_us {
                None
            } else {
                let is_accepted = self.signing.admits(cx.now, port, &mut state.signing, frame);
                self.learn_and_forward(cx, port, frame, is_accepted, allowance)
            };
            if let Some(standing) = standing
                && let Some(target) = target_if_for_us(cx, port, frame)
            {
                Self::take_news(cx);
                // The text of a refusal is sent again if the operator repeats the request (C-16).
                if D::HAS_TEXTS {
                    cx.texts.is_answering = true;
                }
                let received = self.received(cx.now, port, frame, standing, target);
                let is_command = self.execute_if_command(cx, port, state, &received);
                if !is_command && self.is_sender_in_control(cx, &received) {
                    self.serve(cx, port, state, &received);
                }
                if D::HAS_TEXTS {
                    cx.texts.is_answering = false;
                }
                port.shares.ask(Self::take_news(cx));
            }
            self.signing.wipe(id, decoder);
        }
        allowance.hooks = cx.shared.hooks;
        own_frame
    }

    /// Returns the shared turns for which services and hooks have queued something since the last call.
    fn take_news(cx: &mut Cx<'_, D>) -> u32 {
        if !Self::HAS_SHARES {
            return 0;
        }
        let mut turns = core::mem::take(&mut cx.shared.asked);
        if core::mem::take(&mut cx.requests.is_new) {
            turns |= const { Turn::shared(Turn::BY_HOOKS) };
        }
        if core::mem::take(&mut cx.texts.is_new) {
            turns |= const { Turn::shared(Turn::Text.bit()) };
        }
        if core::mem::take(&mut cx.events.is_new) {
            turns |= const { Turn::shared(Turn::Event.bit()) };
        }
        turns
    }

    /// Returns whether the sender may cause the effect of a frame that is no command. A frame from a sender that is not
    /// in control of the vehicle is counted, and the caller drops it (O-5).
    fn is_sender_in_control(&mut self, cx: &Cx<'_, D>, received: &Received<'_>) -> bool {
        let is_receiver = self.manual_control.is_receiver(received.from);
        !self.operator_control.drops(is_ours(cx, received), is_receiver, received)
    }

    /// Returns the next frame that the decoder finds; `None` if it needs more bytes.
    fn next_frame<'a>(&self, cx: &Cx<'_, D>, decoder: &'a mut Decoder, allowance: &mut Allowance) -> Option<Frame<'a>> {
        let checks = Checks {
            messages: <D::Vehicle as Vehicle>::MESSAGES,
            is_known: |address| network::is_known(cx.peers, address),
            verifies: |raw: &[u8], work: &mut u32| self.signing.vouches_for(raw, work),
        };
        decoder.next_checked(cx.now, &mut allowance.work, checks)
    }

    /// Learns the sender and its route from a received frame, and forwards the frame. Returns the sender's standing if the
    /// services get the frame: it was accepted, its checksum was verified, and it is no duplicate.
    // Its locals stay off the call stack of services.
    #[inline(never)]
    fn learn_and_forward(
        &mut self,
        cx: &mut Cx<'_, D>,
        port: &mut Port,
        frame: &Frame<'_>,
        is_accepted: bool,
        allowance: &mut Allowance,
    ) -> Option<Standing> {
        let from = Peer { address: frame.source(), link: port.id };
        // A refused frame may be forwarded to links that verify signatures themselves; it has no other effect.
        let decision = self.forwarding.examine(cx, port, frame, is_accepted);
        let is_duplicate = decision == ForwardDecision::Duplicate;
        // An unknown message is never acted on (S-12), but may be forwarded.
        let is_trusted = is_accepted && frame.is_checked();
        let (mut sender, mut served) = (None, None);
        if is_trusted {
            if is_duplicate && !network::is_heard(cx.peers, from) {
                // A duplicate must not teach a route to its sender.
                return None;
            }
            let (entry, standing) = self.record_sender(cx, port, frame);
            if entry != SenderEntry::Present {
                allowance.spend(COST_OF_NEWCOMER);
            }
            // Only what proves its sender teaches a route, and keeps something alive.
            if standing.trust > Trust::None {
                sender = Some(entry);
                if !is_duplicate {
                    self.on_heard(cx.now, from);
                }
            }
            served = Some(standing).filter(|_| !is_duplicate);
        } else if is_accepted {
            increment(&mut port.counters.unknown);
            network::record_unchecked(cx.peers, from, frame.header().seq);
        }
        // A refused frame proves nothing, whatever signature it has.
        let trust = if is_accepted { self.signing.trust(port, frame) } else { Trust::None };
        let (payer, has_key) = (self.payer(cx, port, from, trust), self.signing.has_key());
        let examined = Examined { frame, decision, sender, payer, has_key };
        allowance.spend(self.forwarding.forward(cx, port, &examined));
        served
    }

    /// Records the sender of an accepted frame in the peer table. Returns its entry and its standing.
    fn record_sender(&self, cx: &mut Cx<'_, D>, port: &mut Port, frame: &Frame<'_>) -> (SenderEntry, Standing) {
        port.note_version(frame.header().version);
        let trust = self.signing.trust(port, frame);
        // The heartbeat of a vehicle makes no station, but it keeps one.
        if trust > Trust::None && (port.accepted != Accepted::Nothing || !network::is_of_vehicle(frame)) {
            port.accepted = Accepted::Again;
        }
        let is_ours = frame.source().system == cx.address().system;
        let settles = trust == Trust::Signed || (is_ours && port.config.trusts_own_system);
        let by = Reception { now: cx.now, link: port.id, class: port.config.class, trust, settles };
        let residents =
            Residents { owner: self.operator_control.controllers().owner(), timeout: cx.shared.config.peer_timeout };
        let (peers, mut hook) = cx.peers_and_hook();
        let Recorded { entry, is_proven } = network::record(peers, by, residents, frame, |event| hook.report(event));
        match entry {
            SenderEntry::Evicted => increment(&mut port.counters.evicted_peers),
            SenderEntry::NoRoom => increment(&mut port.counters.no_peer_slot),
            SenderEntry::Present => {}
        }
        let counts = is_proven && (settles || !is_ours);
        let may_change =
            (is_ours && counts) || self.operator_control.controllers().may_change(frame.source().system, trust);
        (entry, Standing { trust, counts, may_change })
    }

    /// Counts a frame from one of our own addresses, which is neither used nor forwarded (S-15, R-8). Returns its
    /// number and checksum, which may identify it as an echo.
    fn count_own_frame(&self, cx: &Cx<'_, D>, port: &mut Port, frame: &Frame<'_>) -> Option<OwnFrame> {
        increment(&mut port.counters.own_address);
        let is_from_autopilot = frame.source() == cx.address();
        let may_be_echo = is_from_autopilot && frame.is_checked() && self.signing.accepts_unsigned(port, frame.id());
        if !may_be_echo {
            return None;
        }
        let [checksum, _] = frame.checksum()?;
        Some(OwnFrame { seq: frame.header().seq, checksum })
    }

    /// Hands a frame that is not a command to its service, or to the vehicle.
    // Inlined, it costs 270 bytes of flash.
    #[inline(never)]
    fn serve(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>, received: &Received<'_>) {
        match self.on_frame(cx, port, state, received) {
            Handled::Yes => {}
            Handled::NoRoom => increment(&mut port.counters.no_answer_slot),
            Handled::OutOfPlace => increment(&mut port.counters.out_of_place),
            Handled::No if port.config.class.is_high_latency() => increment(&mut port.counters.out_of_place),
            Handled::No => {
                let (vehicle, mut context) = cx.hook();
                let is_handled = vehicle.message(&mut context, received.frame, port.id);
                // Broadcasts are not counted: no component has to handle them.
                let is_broadcast = received.target.system != cx.shared.config.address.get().system;
                if !is_handled && !is_broadcast {
                    increment(&mut port.counters.unhandled);
                }
            }
        }
    }

    /// Returns the frame as the services get it.
    fn received<'a>(
        &self,
        now: Instant,
        port: &Port,
        frame: &'a Frame<'a>,
        standing: Standing,
        target: Address,
    ) -> Received<'a> {
        let from = Peer { address: frame.source(), link: port.id };
        let Standing { trust, counts, may_change } = standing;
        Received { frame, from, trust, counts, may_change, target, age: self.signing.age(now, frame) }
    }

    /// Returns whose credits pay for what a frame causes on the high-latency links (L-17). A component of our own system, such as one that
    /// answers a command, has the reserved ones too if it is believed.
    fn payer(&self, cx: &Cx<'_, D>, port: &Port, from: Peer, trust: Trust) -> Payer {
        let system = from.address.system;
        let is_ours = port.config.trusts_own_system && system == cx.address().system;
        let is_in_control = self.operator_control.controllers().is_owner(system, trust);
        if is_ours || is_in_control || trust == Trust::Signed { Payer::Privileged } else { Payer::Anyone }
    }

    /// Returns the command in a frame; `None` if the frame contains none.
    fn request(&self, cx: &Cx<'_, D>, port: &Port, received: &Received<'_>) -> Option<Request> {
        let in_mode = || if D::HAS_MODES { mode::command_in(port, received) } else { None };
        let mut request = command::command_in(port, received).or_else(in_mode)?;
        request.signed_at = self.signing.signed_at(received.frame);
        if D::Credits::IS_SOME {
            request.payer = self.payer(cx, port, received.from, received.trust);
        }
        Some(request)
    }

    /// Executes the command in a frame, and queues one answer, on the link on which the command was received (C-3).
    /// Without room for the answer, the command is dropped and counted.
    ///
    /// Returns false if the frame contains no command. A COMMAND_ACK contains none, so it is not answered (C-13).
    // Its locals stay off the call stack of other frames.
    #[inline(never)]
    fn execute_if_command(
        &mut self,
        cx: &mut Cx<'_, D>,
        port: &mut Port,
        state: &mut States<D>,
        received: &Received<'_>,
    ) -> bool {
        let mut request = self.request(cx, port, received);
        // By reference: it is large.
        let Some(request) = &mut request else { return false };
        if !CommandService::<D::Commands>::has_room(&state.command) {
            increment(&mut port.counters.no_answer_slot);
            return true;
        }
        // The sender's control is checked before any hook of the vehicle is called (O-5).
        let own = cx.shared.config.address.get().system;
        let refusal = if self.operator_control.refuses(is_ours(cx, received), &request.command) {
            Some(Verdict::Refused(MavResult::NOT_IN_CONTROL.into()))
        } else {
            self.command.admit(cx, request)
        };
        let is_admitted = refusal.is_none();
        let verdict = if is_admitted { self.on_command(cx, port, state, request) } else { refusal };
        if let Some(owner) = self.operator_control.take_new_owner() {
            cx.shared.controllers = self.operator_control.controllers();
            self.on_owner(own, owner);
        }
        self.command.answer(cx, port, &mut state.command, request, verdict, is_admitted);
        true
    }
}

impl<D: Declares> Services<D> {
    /// Carries out the commands of the firmware itself to its other components (K-11). They are handled as if they were
    /// received, but their answers are not sent. `port` and `state` are those of any link.
    pub(super) fn carry_out_own(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
        let own = cx.shared.config.address.get();
        let mut number = 0usize;
        while number < self.client.own_slots() && cx.shared.has_hooks(3) {
            let running = self.client.running_own(number);
            if let Some(command) = running
                && let Some(slots) = self.command.slots.view()
                && let Some((component, answer)) = slots.own_answer(cx.now, own, command)
            {
                self.client.answered_own(cx, Address { component, ..own }, answer);
            }
            number = number.wrapping_add(1);
        }
        for _ in 0..self.client.own_slots() {
            if !cx.shared.has_hooks(3) {
                // The next poll continues.
                return;
            }
            let command = match self.client.take_own(cx.now, own) {
                None => return,
                Some(OwnRequest::Cancel(command)) => {
                    self.command.cancel_own(cx, &command);
                    continue;
                }
                Some(OwnRequest::Execute(command)) => command,
            };
            let from = Address { component: command.component, ..own };
            let request = Request::from(command);
            let refusal = self.command.admit(cx, &request);
            let is_admitted = refusal.is_none();
            let verdict = if asks_for_message(request.command.id) {
                // The message would be sent on a link.
                Some(Verdict::done(MavResult::DENIED))
            } else if is_admitted {
                self.on_own_command(cx, port, state, &request)
            } else {
                refusal
            };
            let outcome = self.command.conclude(cx, &request, verdict, is_admitted);
            let answer = CommandAnswer { command: request.command.id, outcome, progress: u8::MAX };
            self.client.answered_own(cx, from, answer);
        }
    }
}

/// Whether a frame is that of a component of our own system, and is believed.
fn is_ours<D: Declares>(cx: &Cx<'_, D>, received: &Received<'_>) -> bool {
    received.from.address.system == cx.shared.config.address.get().system && received.counts
}

/// Whether a command asks for a message, which a component of the firmware does not send to the firmware itself.
const fn asks_for_message(command: MavCmd) -> bool {
    matches!(
        command,
        MavCmd::REQUEST_MESSAGE
            | MavCmd::SET_MESSAGE_INTERVAL
            | MavCmd::GET_MESSAGE_INTERVAL
            | MavCmd::REQUEST_CAMERA_INFORMATION
            | MavCmd::REQUEST_CAMERA_SETTINGS
            | MavCmd::REQUEST_STORAGE_INFORMATION
            | MavCmd::REQUEST_CAMERA_CAPTURE_STATUS
            | MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE
            | MavCmd::REQUEST_VIDEO_STREAM_INFORMATION
            | MavCmd::REQUEST_VIDEO_STREAM_STATUS
    )
}

/// Returns the address to which a frame is sent. Returns `None`, and counts the frame, if the services must not get it:
/// it is for another system or component, or its message is not handled on a link of this class.
fn target_if_for_us<D: Declares>(cx: &Cx<'_, D>, port: &mut Port, frame: &Frame<'_>) -> Option<Address> {
    let own = cx.shared.config.address.get();
    let target = network::target_of(frame);
    // Id 0 stands for every system, and for every component (S-11).
    let is_for_our_system = target.system.is_all() || target.system == own.system;
    // A command for another component gets no answer from us (C-2).
    let is_for_our_component = target.component.is_all()
        || target.component == own.component
        || cx.shared.has_component::<D>(target.component)
        || mission::is_for_planner(target.component, frame.id());
    if !(is_for_our_system && is_for_our_component) {
        // Others' frames are forwarded, but no service sees them.
        increment(&mut port.counters.not_ours);
        return None;
    }
    if !port.config.class.handles_message(frame.id()) {
        // On a high-latency link, only heartbeats and commands are handled (L-4).
        increment(&mut port.counters.out_of_place);
        return None;
    }
    Some(target)
}

/// Whether an address is that of one of the firmware's components (SEC-9, S-15).
fn is_our_address<D: Declares>(cx: &Cx<'_, D>, source: Address) -> bool {
    let own = cx.shared.config.address.get();
    source.system == own.system && (source.component == own.component || cx.shared.has_component::<D>(source.component))
}

/// Reports that another vehicle on this link has our address (H-14).
// Rare: its text stays off the call stack of services.
#[inline(never)]
pub(super) fn report_conflict<D: Declares>(cx: &mut Cx<'_, D>, link: LinkId) {
    let (vehicle, mut context) = cx.hook();
    vehicle.peer(&mut context, PeerEvent::AddressConflict(link));
    if !D::HAS_TEXTS {
        return;
    }
    let mut text = Text::<MAX_TEXT_LEN>::EMPTY;
    text.push_str("Another vehicle has system id ");
    text.push_number(u32::from(cx.shared.config.address.get().system.wire()));
    cx.text(MavSeverity::WARNING, text.as_bytes());
}
