//! The sending half of the stack: one frame at a time. [`turns!`](crate::service) has the order.

use super::Declares;
use super::services::{Services, States};
use crate::link::Port;
use crate::service::{Cx, ForwardingGate, SigningGate, increment};

impl<D: Declares> Services<D> {
    /// Brings up to date what decides on the next frame of a link, before the services are asked for it.
    pub(super) fn prepare(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
        port.bucket.drain(cx.now);
        self.signing.prepare(cx.now, port);
        ForwardingGate::<D>::prepare(&mut self.forwarding, port);
        self.heartbeat.prepare(cx, port, &mut state.heartbeat);
    }

    /// Puts the next frame into the link's outbox, and signs it. While frames are held for a HEARTBEAT, only that is sent (H-17).
    pub(super) fn fill(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
        self.prepare(cx, port, state);
        if self.send(cx, port, state) {
            self.signing.sign(cx.now, port);
            port.release();
            increment(&mut port.counters.tx_frames);
            self.on_sent(port, state);
        }
    }
}
