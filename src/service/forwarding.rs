//! Forwarding: frames for peers on other links.
//!
//! The queues, and the memory for duplicate detection, are in `network`: see [`ForwardQueues`].

use super::gate::{Examined, ForwardingGate};
use super::{About, Cx, Service, ShowCounters, Turn, View};
use crate::frame::Frame;
use crate::link::Port;
use crate::network::{self, ForwardCounters, ForwardDecision, ForwardQueues, Passed, SenderEntry};
use crate::time::Instant;
use crate::types::{Config, Firmware, LinkId, LinkMask, Peer};

/// Forwards frames between the links. Declared by `forwarding` in [`#[stack]`](macro@crate::Stack).
#[derive(Debug)]
pub struct Forwarding<const LINKS: usize, const BYTES: usize, const SEEN: usize> {
    pub(crate) queues: ForwardQueues<LINKS, BYTES, SEEN>,
    /// Links with frames in their queues.
    queued: LinkMask,
}

impl<F: Firmware, const LINKS: usize, const BYTES: usize, const SEEN: usize> Service<F>
    for Forwarding<LINKS, BYTES, SEEN>
{
    const NEW: Self = Self { queues: ForwardQueues::new(), queued: LinkMask::NONE };
    type Link = ();
    const VACANT: () = ();
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::ForwardedFirst, Turn::Forwarded]);
    type Reply = ();

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, (): &(), turn: Turn) -> Option<(Instant, ())> {
        let is_turn = match turn {
            Turn::ForwardedFirst => port.shares.forwarded_first(),
            _ => true,
        };
        (is_turn && self.queued.contains(port.id)).then_some((view.now, ()))
    }

    /// Sends the next frame of the link's queue, and drops those that have waited for too long.
    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, (): &mut (), (): ()) -> bool {
        let mut queues = self.queues.view();
        let sent = queues.next(cx.now, &mut port.outbox);
        if queues.is_empty(port.id) {
            self.queued = self.queued.without(LinkMask::of(port.id));
        }
        sent
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        for link in (0..).map(LinkId).take(LINKS) {
            if let Some(counters) = self.queues.counters(link) {
                show.counters_of(link, &counters);
            }
        }
    }
}

impl<F: Firmware, const LINKS: usize, const BYTES: usize, const SEEN: usize> ForwardingGate<F>
    for Forwarding<LINKS, BYTES, SEEN>
{
    fn examine(&mut self, cx: &Cx<'_, F>, port: &Port, frame: &Frame<'_>, is_accepted: bool) -> ForwardDecision {
        let target = network::target_of(frame);
        let own = cx.shared.config.address.get();
        let is_ours = target.component == own.component || cx.shared.has_component::<F>(target.component);
        if !port.config.forwards || (target.system == own.system && is_ours) {
            return ForwardDecision::LocalOnly;
        }
        let from = Peer { address: frame.source(), link: port.id };
        let is_way = || target.system.is_all() && network::is_heard(cx.peers, from);
        let Config { seed, identity, .. } = cx.shared.config;
        self.queues.view().examine(cx.now, seed ^ identity.uid, port, frame, is_accepted, is_way)
    }

    fn forward(&mut self, cx: &mut Cx<'_, F>, port: &Port, examined: &Examined<'_>) -> u32 {
        let Examined { frame, decision, sender, payer, has_key } = *examined;
        let mut queues = self.queues.view();
        let from = Peer { address: frame.source(), link: port.id };
        if sender.is_some() {
            network::forget_rebooted(cx.peers, cx.now, from, frame);
        }
        let ForwardDecision::Forward(new) = decision else { return 0 };
        let len = u32::try_from(frame.raw().len()).unwrap_or(u32::MAX);
        let target = network::target_of(frame);
        // A broadcast needs no route back for an answer.
        if sender == Some(SenderEntry::NoRoom) && !target.system.is_all() {
            queues.increment(port.id, |counters| &mut counters.no_peer_slot);
            return len;
        }
        let free = queues.free_links(frame.id(), target);
        if sender.is_some() {
            network::learn_route(cx.peers, from);
        }
        let routes = network::routes(cx.peers, cx.now, from, target, free);
        let own = cx.shared.config.address.get();
        let is_ours_too = target.system == own.system && target.component.is_all();
        if routes.to.is_empty() && !is_ours_too {
            queues.increment(port.id, |counters| &mut counters.no_route);
        }
        let passed = Passed { frame, from: port.id, new: &new, has_key };
        let queued = queues.push(cx.now, &passed, routes, |len| cx.pay(payer, len, 1));
        self.queued = self.queued.with(queued);
        // Examining the frame costs as much as a copy.
        len.saturating_mul(queued.len().saturating_add(1))
    }

    fn prepare(&mut self, port: &Port) {
        self.queues.view().open(port);
    }

    fn link_counters(&self, link: LinkId) -> Option<ForwardCounters> {
        self.queues.counters(link)
    }
}
