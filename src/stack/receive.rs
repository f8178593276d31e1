//! From a decoded frame to the service that it is for: the address filter, then the services one by one.

use super::commands::{command_of, refused_item};
use super::{Context, Core, count, signing, streams};
use crate::config::Allowance;
#[cfg(feature = "signing")]
use crate::dialect::SetupSigning;
use crate::dialect::{Heartbeat, ManualControl, MavComponent, MavResult, MavSeverity};
use crate::frame::{Address, Frame};
use crate::link::{Link, LinkClass, Peer, Port};
use crate::message::{Message, MessageTable, Text};
use crate::network::{self, Booking, Passage, Reception};
use crate::service::command::{self, Origin, Refusal};
use crate::service::high_latency;
use crate::service::manual_control;
use crate::service::mission::{Caller, Missions, PlanStorage};
use crate::service::mode;
use crate::service::param::{self, Params, Taken};
use crate::service::statustext::{MAX_TEXT_LEN, StatusTexts};
use crate::service::time;
use crate::time::Instant;
use crate::vehicle::{Autopilot, Command, Outcome};

impl Core {
    /// Handles the frames that the decoder finds.
    pub(super) fn drain<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        link: &mut Link,
        messages: MessageTable,
        allowance: &mut Allowance,
    ) {
        let Link { decoder, port } = link;
        while allowance.may_handle() {
            let is_known = |address| network::is_known(context.peers, address);
            let key = signing::key_of(context.vehicle);
            let vouches = |raw: &[u8], work: &mut u32| signing::vouches_for(raw, key, work);
            let next = decoder.next_vouched(context.now, messages, &mut allowance.work, is_known, vouches);
            let Some(frame) = next else { return };
            allowance.handle();
            allowance.spend(signing::cost(&frame, context.vehicle));
            #[cfg(feature = "signing")]
            let has_key = frame.id() == SetupSigning::ID;
            let (copied, is_served) = self.on_frame(context, port, &frame);
            allowance.work = allowance.work.saturating_sub(copied);
            if is_served
                && let Some(target) = self.addressee(port, &frame)
                && !self.on_command(context, port, &frame)
            {
                self.serve(context, port, &frame, target);
            }
            #[cfg(feature = "signing")]
            if has_key {
                decoder.wipe();
            }
        }
    }

    /// A frame came in on a link: what is learned from it, and where it goes on to. Tells what forwarding it has cost, in
    /// units of the decoder's work, and whether the services are to see it. Not inlined, and apart from what they do with it:
    /// what this takes of the stack they need for themselves.
    #[inline(never)]
    fn on_frame<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        frame: &Frame<'_>,
    ) -> (u32, bool) {
        let own = self.config.address.get();
        if frame.source() == own {
            count(&mut port.counters.own_address);
            if frame.is_checked() && signing::believes_unsigned(port, frame.id(), context.vehicle) {
                let header = frame.header();
                let sum_at = header.version.header_len().saturating_add(frame.payload().len());
                self.own_frame = frame.raw().get(sum_at).map(|&checksum| [header.seq, checksum]);
            }
            return (0, false);
        }
        let from = Peer { address: frame.source(), link: port.id };
        // A refused frame may be forwarded to links that verify signatures themselves; it has no other effect.
        let is_accepted = signing::admits(context.now, port, frame, context.vehicle);
        let passage = self.examine(context, port, frame, is_accepted);
        if !is_accepted {
            return (self.pass_on(context, port, frame, passage, None), false);
        }
        if !frame.is_checked() {
            count(&mut port.counters.unknown);
            network::on_unchecked(context.peers, from, frame.header().seq);
            return (self.pass_on(context, port, frame, passage, None), false);
        }
        let was_heard = network::is_heard(context.peers, from);
        if passage == Passage::Again && !was_heard {
            // No way back to its sender is learned from what came around.
            return (0, false);
        }
        port.heard(frame.header().version);
        let is_verified = signing::knows_sender(port, frame, context.vehicle);
        let by = Reception { now: context.now, link: port.id, class: port.config.class, is_verified };
        let booking = network::on_frame(context.peers, by, own.system, frame, context.vehicle);
        match booking {
            Booking::Evicted => count(&mut port.counters.evicted_peers),
            Booking::NoRoom => count(&mut port.counters.no_peer_slot),
            Booking::Kept => {}
        }
        if passage != Passage::Again
            && let Some((missions, _)) = context.plans.parts(context.missions)
        {
            missions.heard(context.now, from);
        }
        let copied = self.pass_on(context, port, frame, passage, is_verified.then_some(booking));
        (copied, passage != Passage::Again)
    }

    /// Reports that another vehicle has our address. Not inlined, because it is rare.
    #[inline(never)]
    pub(super) fn tell_conflict(&self, now: Instant, texts: &mut StatusTexts) {
        let mut text = Text::<MAX_TEXT_LEN>::EMPTY;
        text.push_str("Another vehicle has system id ");
        text.push_number(u32::from(self.config.address.get().system.0));
        texts.push(now, self.normal, MavSeverity::WARNING, &text);
    }

    /// Whom a frame is for, if it is for us.
    fn addressee(&self, port: &mut Port, frame: &Frame<'_>) -> Option<Address> {
        let own = self.config.address.get();
        let target = target_of(frame);
        // Old ground stations address plans to component 190 (M-10).
        let is_our_component = target.component.0 == 0
            || target.component == own.component
            || (Missions::handles(frame.id()) && target.component.0 == MavComponent::MISSIONPLANNER.0);
        if (target.system.0 != 0 && target.system != own.system) || !is_our_component {
            count(&mut port.counters.not_ours);
            return None;
        }
        Some(target)
    }

    /// Hands a frame that is for us, and is no command, to its service.
    #[inline(never)]
    fn serve<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        frame: &Frame<'_>,
        target: Address,
    ) {
        let own = self.config.address.get();
        let from = Peer { address: frame.source(), link: port.id };
        if self.on_cancel(context, port, frame, target) {
            // That was all.
        } else if port.config.class == LinkClass::HighLatency && frame.id() != Heartbeat::ID {
            count(&mut port.counters.out_of_place);
        } else if Missions::handles(frame.id()) {
            if target.system.0 == 0 {
                // A broadcast COUNT would start uploads on every vehicle in reach (M-10).
                count(&mut port.counters.out_of_place);
                return;
            }
            let refused = refused_item(frame, origin(context, port, frame), context.vehicle);
            let mut caller = Caller { from, version: port.outbox.version(), replies: &mut port.plans };
            let Some((missions, mut plans)) = context.plans.parts(context.missions) else {
                if !caller.refuse(frame) {
                    count(&mut port.counters.no_answer_slot);
                }
                return;
            };
            let Context { now, texts, vehicle, .. } = context;
            let mut context = self.plan_context(*now, &mut plans, texts);
            match refused {
                Some(seq) => missions.refuse_current(&mut context, *vehicle, seq),
                None => missions.on_frame(&mut context, *vehicle, &mut caller, frame),
            }
        } else if Params::handles(frame.id()) && context.vehicle.parameters_mut().is_some() {
            let Context { now, texts, vehicle, .. } = context;
            let mut context = param::Context { now: *now, texts, normal: self.normal };
            let mut caller = param::Caller { from, version: port.outbox.version(), list: &mut port.params };
            match self.params.on_frame(&mut context, *vehicle, &mut caller, frame) {
                Taken::Yes => {}
                Taken::NoRoom => count(&mut port.counters.no_answer_slot),
                Taken::OutOfPlace => count(&mut port.counters.out_of_place),
            }
        } else if frame.id() == Heartbeat::ID || streams::on_frame(context, port, frame) {
            // That was all.
        } else if time::on_frame(context.now, port, frame, context.vehicle) {
            self.has_acted = true;
        } else if !signing::on_frame(context.now, port, frame, target.system == own.system, context.vehicle)
            && !manual_control::on_frame(context.now, from, frame, target.system.0 == 0, context.peers, context.vehicle)
            && !context.vehicle.message(frame, port.id)
            && target.system == own.system
        {
            // Broadcasts are not counted: no component has to handle them.
            count(&mut port.counters.unhandled);
        }
    }

    /// Carries out the command in a frame, and owes its answer. False when there is none in it.
    #[inline(never)]
    fn on_command<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        frame: &Frame<'_>,
    ) -> bool {
        let has_set_mode = const { !V::MODES.is_empty() } && port.config.class != LinkClass::HighLatency;
        let command = command_of(frame, origin(context, port, frame), has_set_mode);
        let Some((command, set_mode)) = &command else { return false };
        let id = if set_mode.is_some() { mode::SET_MODE } else { command.id };
        if port.acks.is_full() {
            count(&mut port.counters.no_answer_slot);
            return true;
        }
        if command.is_broadcast && command::is_for_one(id) {
            let answer = self.refuse(context.now, port, context.texts, command, Refusal::BROADCAST);
            port.acks.push(command.from.address, id, answer);
            return true;
        }
        let signed_at = signing::signed_at(frame, context.vehicle);
        if let Some(answer) = command::answered(context.now, command, signed_at, context.vehicle) {
            let answer =
                answer.unwrap_or_else(|refusal| self.refuse(context.now, port, context.texts, command, refusal));
            port.acks.push(command.from.address, id, answer);
            return true;
        }
        let satellite = high_latency::on_command(context.now, port, context.peers, context.vehicle, command, signed_at);
        let satellite = satellite.map(accepted);
        let Context { now, texts, vehicle, .. } = context;
        let progress = satellite.or_else(|| {
            let (missions, mut plans) = context.plans.parts(context.missions)?;
            let mut context = self.plan_context(*now, &mut plans, texts);
            missions.on_command(&mut context, *vehicle, command)
        });
        let stored = progress.or_else(|| {
            let mut context = param::Context { now: *now, texts, normal: self.normal };
            self.params.on_command(&mut context, *vehicle, command).map(accepted)
        });
        let asked = stored.or_else(|| self.on_message_command(context, port, command).map(Ok));
        let outcome = match asked {
            Some(Ok(result)) => result.into(),
            Some(Err(result)) => self.refuse(context.now, port, context.texts, command, result.into()),
            None => execute(context, port, command, *set_mode),
        };
        command::carried_out(context.now, command, signed_at, outcome, context.vehicle);
        self.has_acted = true;
        port.acks.push(command.from.address, id, outcome);
        true
    }

    /// Explains a refusal to the sender's link, and returns the answer.
    fn refuse(
        &self,
        now: Instant,
        port: &mut Port,
        texts: &mut StatusTexts,
        command: &Command,
        refusal: Refusal,
    ) -> Outcome {
        command::explain(now, self.config.address.get().system, port, texts, command, refusal);
        refusal.result.into()
    }
}

/// Converts a service's answer to a command: a refusal becomes an error.
fn accepted(result: MavResult) -> Result<MavResult, MavResult> {
    if result == MavResult::ACCEPTED { Ok(result) } else { Err(result) }
}

/// Where the command in a frame comes from, and how old it is if that is known (L-16).
fn origin<V: Autopilot, P: PlanStorage>(context: &mut Context<'_, V, P>, port: &Port, frame: &Frame<'_>) -> Origin {
    let from = Peer { address: frame.source(), link: port.id };
    Origin { from, class: port.config.class, age: signing::age(context.now, frame, context.vehicle) }
}

/// Carries out a command that is none of plans, parameters and streams.
fn execute<V: Autopilot, P: PlanStorage>(
    context: &mut Context<'_, V, P>,
    port: &mut Port,
    command: &Command,
    set_mode: Option<u32>,
) -> Outcome {
    let has_modes = const { !V::MODES.is_empty() };
    match has_modes.then(|| mode::on_command(port, context.vehicle, command, set_mode)).flatten() {
        Some(Ok(outcome)) => outcome,
        Some(Err(mode::Refused(mode, why))) => {
            command::explain_mode(context.now, port, context.texts, mode, why);
            MavResult::DENIED.into()
        }
        None => command::execute(command, port.config.class, &mut port.owed, context.vehicle),
    }
}

/// Whom a frame is for; for everyone, where that is not known.
pub(super) fn target_of(frame: &Frame<'_>) -> Address {
    let Some(info) = frame.info() else { return Address::default() };
    // MANUAL_CONTROL alone calls the system that it means otherwise.
    let system = if info.id() == ManualControl::ID { Some(MANUAL_CONTROL_TARGET) } else { info.target_system() };
    // A field that was cut off, or is not there, reads as 0: for everyone.
    let byte = |offset: Option<u8>| offset.map_or(0, |offset| frame.byte(offset));
    Address::new(byte(system), byte(info.target_component()))
}

/// Where MANUAL_CONTROL.target stands.
const MANUAL_CONTROL_TARGET: u8 = 10;
