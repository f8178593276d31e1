//! Forwarding, joined to the rest. All of it ends at once for a vehicle that forwards nothing, so that nothing of it is
//! linked for it.

use super::receive::target_of;
use super::{Context, Core, signing};
use crate::frame::Frame;
use crate::link::{LinkMask, Peer, Port};
use crate::network::{self, Booking, Passage};
use crate::service::mission::PlanStorage;
use crate::vehicle::Autopilot;

impl Core {
    /// Whether a frame, accepted on its link or not, is to be forwarded, before anything is learned from it.
    pub(super) fn examine<V: Autopilot, P: PlanStorage>(
        &self,
        context: &mut Context<'_, V, P>,
        port: &Port,
        frame: &Frame<'_>,
        is_accepted: bool,
    ) -> Passage {
        let target = target_of(frame);
        match context.vehicle.forwarding() {
            Some(mut forwarding) if port.config.forwards && target != self.config.address.get() => {
                let from = Peer { address: frame.source(), link: port.id };
                let is_way = || target.system.0 == 0 && network::is_heard(context.peers, from);
                forwarding.examine(context.now, port, frame, is_accepted, is_way)
            }
            _ => Passage::Stays,
        }
    }

    /// Puts a frame that was examined into the queues of the links that it is for. `booking`: what became of its sender in the
    /// peer table; `None` when nothing was to be learned from it. Tells what it has cost, in units of the decoder's work.
    pub(super) fn pass_on<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &Port,
        frame: &Frame<'_>,
        passage: Passage,
        booking: Option<Booking>,
    ) -> u32 {
        let has_key = signing::key_of(context.vehicle).is_some();
        let Some(mut forwarding) = context.vehicle.forwarding() else { return 0 };
        let from = Peer { address: frame.source(), link: port.id };
        if booking.is_some() {
            network::forget_rebooted(context.peers, from, frame);
        }
        let Passage::Goes(ticket) = passage else { return 0 };
        let len = u32::try_from(frame.raw().len()).unwrap_or(u32::MAX);
        let target = target_of(frame);
        // A broadcast needs no route back for an answer.
        if booking == Some(Booking::NoRoom) && target.system.0 != 0 {
            forwarding.count(port.id, |counters| &mut counters.no_peer_slot);
            return len;
        }
        let routes = network::routes(context.peers, context.now, from, booking.is_some(), target);
        let is_ours_too = target.system == self.config.address.get().system && target.component.0 == 0;
        if routes.to.is_empty() && !is_ours_too {
            forwarding.count(port.id, |counters| &mut counters.no_route);
        }
        let queued = forwarding.pass_on(context.now, port.id, frame, &ticket, routes, has_key);
        self.forwards = self.forwards.with(queued);
        len.saturating_mul(queued.len().saturating_add(1))
    }

    /// What is sent while nothing else waits for the line: streams and frames of others, in turn. False when there is
    /// neither.
    pub(super) fn share<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
    ) -> bool {
        let has_turn = context.vehicle.forwarding().is_some_and(|forwarding| forwarding.has_turn(port.id));
        if has_turn && self.forward(context, port) {
            return true;
        }
        if self.stream(context, port) {
            if let Some(mut forwarding) = context.vehicle.forwarding() {
                forwarding.streamed(port.id);
            }
            return true;
        }
        self.forward(context, port)
    }

    /// Sends the next frame of the link's queue. False when there is none, or the line is busy.
    pub(super) fn forward<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
    ) -> bool {
        let Some(mut forwarding) = context.vehicle.forwarding() else { return false };
        forwarding.open(port);
        let link = LinkMask::of(port.id);
        if !self.forwards.contains(link) || !port.bucket.is_idle() {
            return false;
        }
        let sent = forwarding.next(context.now, &mut port.outbox);
        if forwarding.is_empty(port.id) {
            self.forwards = self.forwards.without(link);
        }
        sent
    }
}
