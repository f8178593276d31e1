//! The sending half of the stack: one frame at a time. [`turns!`](crate::service) has the order.

use super::Declares;
use super::services::{Services, States};
use crate::link::Port;
use crate::service::{Cx, ForwardingGate, SigningGate, increment};

impl<D: Declares> Services<D> {
    /// Ends the wait for a HEARTBEAT that has not come (H-17). Unless frames still wait, makes the frame that was cut off when the
    /// link closed the next one. Returns whether there is one.
    pub(super) fn resume(&self, cx: &Cx<'_, D>, port: &mut Port) -> bool {
        if port.is_held() {
            if cx.shared.holds(port) && cx.now < port.bound_hold(cx.now, cx.shared.config.max_loop_gap) {
                return false;
            }
            port.release();
        }
        port.outbox.resume()
    }

    /// Puts the next frame into the link's outbox, and signs it. While frames are held for a HEARTBEAT, only that is sent (H-17).
    pub(super) fn fill(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
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
