//! Streams and messages on request, joined to the rest. All of it ends at once for a vehicle that has none, so that nothing
//! of the service is linked for it.

use super::{Context, Core, Stack};
use crate::dialect::{MavProtocolCapability, MavResult};
use crate::frame::Frame;
use crate::link::{LinkClass, Port};
use crate::message::Message;
use crate::service::mission::PlanStorage;
use crate::service::stream::{self, Fill, Fixed, Slot, Stream};
use crate::time::Instant;
use crate::vehicle::{Autopilot, Command, Telemetry};

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// Sends message `M` once on every normal link, whatever its interval there is: for what has changed and is not to wait
    /// for its turn, as HOME_POSITION when home is set (O-6). It is filled when the link has room, and left out if the vehicle
    /// cannot [fill](Telemetry::fill) it then; announced again before that it still goes out once.
    ///
    /// `M` has to be one of the [`STREAMS`](Telemetry::STREAMS) of the vehicle `V`, or this does not compile:
    ///
    /// ```
    /// # use mavstack::dialect::HomePosition;
    /// # use mavstack::{Fill, NoPlans, Stack, Stream, Telemetry};
    /// # struct Rover;
    /// impl Telemetry for Rover {
    ///     const STREAMS: &'static [Stream] = &[Stream::of::<HomePosition>()];
    /// #   fn fill(&mut self, _: u32, out: Fill<'_>) -> bool { out.put(&HomePosition::default()) }
    /// }
    ///
    /// fn on_home_set(stack: &mut Stack<2, NoPlans>) {
    ///     stack.announce::<HomePosition, Rover>();
    /// }
    /// ```
    pub fn announce<M: Message, V: Telemetry>(&mut self) {
        let number = const { Stream::number_of::<M>(V::STREAMS) };
        for link in self.links.iter_mut().filter(|link| link.port.config.class != LinkClass::HighLatency) {
            link.port.streams.ask(number, 0);
        }
    }
}

impl Core {
    fn fixed<V: Autopilot>(&self) -> Fixed {
        Fixed {
            heartbeat: self.config.heartbeat_period,
            has_missions: self.capabilities.contains(MavProtocolCapability::MISSION_INT),
            has_modes: !V::MODES.is_empty(),
        }
    }

    /// Handles a command about HEARTBEAT or about a message that the vehicle fills; `None` for all others.
    pub(super) fn on_message_command<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        command: &Command,
    ) -> Option<MavResult> {
        let of_heartbeat = self.on_heartbeat_request(context.now, port, context.vehicle, command);
        if of_heartbeat.is_some() || V::STREAMS.is_empty() {
            return of_heartbeat;
        }
        stream::on_command(context.now, self.fixed::<V>(), port, context.slots, context.vehicle, command)
    }

    /// Sends a requested message. Returns false when none is pending.
    pub(super) fn answer<V: Autopilot>(&self, now: Instant, slots: &[Slot], port: &mut Port, vehicle: &mut V) -> bool {
        !V::STREAMS.is_empty()
            && (stream::next_interval(now, self.fixed::<V>(), port, V::STREAMS, slots)
                || stream::next_asked(now, &mut port.streams, &mut port.outbox, vehicle))
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
    Stream::check(V::STREAMS, !V::MODES.is_empty());
    assert!(
        V::STREAMS.len() <= slots,
        "more `STREAMS` than the stack has room for: name a number, `Stack<1, P, 8, 4, 32>`"
    );
}
