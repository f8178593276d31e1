//! The sending half of the stack: one frame at a time. [`turns!`](crate::service) has the order.

use super::Declares;
use super::services::{Services, States};
use crate::link::Port;
use crate::service::{Cx, ForwardingGate, SigningGate, increment};

impl<D: Declares> Services<D> {
    /// Puts the next frame into the link's empty outbox. On a link that opens that is the HEARTBEAT, or nothing until the wait for it
    /// ends (H-17); then the frame that was cut off when the link closed, if there is one.
    pub(super) fn refill(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
        loop {
            let is_held = cx.shared.holds(port);
            if !is_held {
                port.release();
                if port.outbox.resume() {
                    return;
                }
            }
            self.fill(cx, port, state);
            let waits = is_held && port.is_held();
            if !waits || cx.now < port.bound_hold(cx.now, cx.shared.config.max_loop_gap) {
                return;
            }
            port.release();
        }
    }

    /// Puts the next frame into the link's outbox, and signs it. While frames are held for a HEARTBEAT, only that is sent (H-17).
    fn fill(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
        port.bucket.drain(cx.now);
        self.signing.prepare(cx.now, port);
        ForwardingGate::<D>::prepare(&mut self.forwarding, port);
        if self.send(cx, port, state) {
            self.signing.sign(cx.now, port);
            port.release();
            increment(&mut port.counters.tx_frames);
            self.on_sent(port);
        }
    }
}
