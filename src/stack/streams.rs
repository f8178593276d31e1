//! Streams and messages on request, joined to the rest. All of it ends at once for a vehicle that has none, so that nothing
//! of the service is linked for it.

use super::{Context, Core};
use crate::dialect::{MavProtocolCapability, MavResult};
use crate::frame::Frame;
use crate::link::Port;
use crate::service::mission::PlanStorage;
use crate::service::stream::{self, Fill, Fixed, Stream};
use crate::vehicle::{Autopilot, Command};

impl Core {
    fn fixed(&self) -> Fixed {
        Fixed {
            heartbeat: self.config.heartbeat_period,
            has_missions: self.capabilities.contains(MavProtocolCapability::MISSION_INT),
        }
    }

    /// A command about messages, of those that the vehicle fills; `None` for all others.
    pub(super) fn on_message_command<V: Autopilot, P: PlanStorage>(
        &self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        command: &Command,
    ) -> Option<MavResult> {
        if V::STREAMS.is_empty() {
            return None;
        }
        stream::on_command(context.now, self.fixed(), port, context.slots, context.vehicle, command)
    }

    /// A message that somebody asked for. False when none is owed.
    pub(super) fn answer<V: Autopilot, P: PlanStorage>(
        &self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
    ) -> bool {
        !V::STREAMS.is_empty()
            && (stream::next_interval(self.fixed(), port, V::STREAMS, context.slots)
                || stream::next_asked(context.now, &mut port.streams, &mut port.outbox, context.vehicle))
    }

    /// A stream that is due, while nothing else waits for the line (D-4, Q-8). False when none is.
    pub(super) fn stream<V: Autopilot, P: PlanStorage>(
        &self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
    ) -> bool {
        if V::STREAMS.is_empty() {
            return false;
        }
        let is_heard = || context.peers.iter().any(|info| info.is_alive && info.peer.link == port.id);
        if self.config.streams_wait_for_peer && !is_heard() {
            port.streams.pause();
            return false;
        }
        let Port { streams, outbox, bucket, config, .. } = port;
        if !bucket.is_idle() {
            return false;
        }
        while let Some(number) = streams.next_due(context.now, V::STREAMS, context.slots, config.streams) {
            let Some(id) = V::STREAMS.get(number).map(Stream::id) else { continue };
            if stream::fill(context.vehicle, id, Fill::new(context.now, id, 0, outbox, false)) {
                return true;
            }
        }
        false
    }
}

/// A frame about streams came in; true when that was all that was to be done about it.
pub(super) fn on_frame<V: Autopilot, P: PlanStorage>(
    context: &mut Context<'_, V, P>,
    port: &mut Port,
    frame: &Frame<'_>,
) -> bool {
    !V::STREAMS.is_empty() && stream::on_frame(context.now, port, V::STREAMS, context.slots, frame)
}

/// Whether a stack with room for `slots` streams can serve this vehicle: a compile error where not.
pub(super) const fn check<V: Autopilot>(slots: usize) {
    Stream::check(V::STREAMS);
    assert!(V::STREAMS.len() <= slots, "the vehicle has more streams than the stack has room for: see `STREAMS`");
}
