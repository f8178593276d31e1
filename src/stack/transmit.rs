//! The sending half of the stack: one frame at a time, and when the next is due. [`turns!`](crate::service) has the
//! order.

use super::Declares;
use super::services::{Services, States};
use crate::link::{Port, Transport};
use crate::service::{Cx, ForwardingGate, Service, SigningGate, Turn, View, count};
use crate::time::Instant;

impl<D: Declares> Services<D> {
    /// Puts the next frame into the link's empty outbox, and signs it.
    pub(super) fn fill(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
        port.bucket.drain(cx.now);
        self.signing.prepare(cx.now, port);
        ForwardingGate::<D>::prepare(&mut self.forwarding, port);
        if self.send(cx, port, state) {
            self.signing.sign(cx.now, port);
            count(&mut port.counters.tx_frames);
            self.on_sent(port);
        }
    }

    /// Returns when something is to be sent on a link, as far as its transport accepts bytes.
    pub(super) fn tx_deadline(&self, view: &View<'_>, port: &Port, state: &States<D>) -> Instant {
        match port.transport {
            // The rest of a frame waits for the next poll's budget.
            Transport::Ready if !port.outbox.is_empty() => view.now,
            // The transport must become ready first, which the stack cannot observe.
            Transport::Full | Transport::Unknown if !port.outbox.is_empty() => Instant::NEVER,
            // The same. The transport may be ready by the time of the next heartbeat, even if no other wake-up reports
            // it.
            Transport::Full => {
                let heartbeat = if Turn::Heartbeat.is_on(port.config.class) {
                    Service::<D>::due(&self.heartbeat, view, port, &state.heartbeat, Turn::Heartbeat)
                } else {
                    Service::<D>::due(&self.high_latency, view, port, &state.high_latency, Turn::HighLatency)
                };
                if heartbeat > view.now { heartbeat } else { Instant::NEVER }
            }
            _ => self.due(view, port, state),
        }
    }
}
