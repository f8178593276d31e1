//! The vehicle's own messages: to a peer, on a link, or on every normal link, whenever the vehicle has something to
//! say.
//!
//! [`Context::send`] and [`Stack::send`](crate::Stack::send) queue the id of a message, and no payload. When the link
//! has room, the vehicle [fills](Telemetry::fill) it. So a message reports the state at the time it is sent, and the
//! memory is bounded: each link has room for eight, and a pending message is not queued twice (K-8).
//!
//! ```text
//!   Context::send ─▶ queue of the link ─▶ Telemetry::fill ─▶ one frame
//! ```
//!
//! The messages take at most half of a link's rate, and come after all answers (D-4, K-9). On a link without a rate
//! they are every other frame, while others have something to send. They are not sent on high-latency links (L-2).

use super::table::is_own;
use super::vehicle::{Fill, Telemetry, fill};
use crate::link::Port;
use crate::message::Message;
use crate::service::rate_limit::{RateLimit, cost};
use crate::service::{About, Cx, Service, Turn, View};
use crate::time::{Duration, Instant};
use crate::types::{Context, Destination, Firmware, Pending};

/// The percentage of a link that the messages may use (K-9).
const PERCENT: u32 = 50;

/// How long a message waits for the frames of others on a link without a rate.
const PATIENCE: Duration = Duration::from_millis(20);

/// The state of the service on a link.
#[derive(Debug)]
pub struct MessageLink {
    limit: RateLimit,
    /// When the last message was sent, and the number of frames that the link had sent before.
    at: Instant,
    frames: u32,
}

impl MessageLink {
    /// Returns when the next message may be sent. Half of an unknown rate is every other frame.
    fn due(&self, port: &Port) -> Instant {
        let is_last = port.counters.tx_frames == self.frames.wrapping_add(1);
        match port.config.bytes_per_second {
            0 if is_last && self.at != Instant::ZERO => self.at + PATIENCE,
            _ => self.limit.due(),
        }
    }
}

/// Sends the vehicle's own messages.
#[derive(Debug)]
pub struct Messages;

impl<F: Firmware<Vehicle: Telemetry>> Service<F> for Messages {
    const NEW: Self = Self;
    type Link = MessageLink;
    const VACANT: MessageLink = MessageLink { limit: RateLimit::NEW, frames: 0, at: Instant::ZERO };
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::Message]);
    type Reply = ();

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &MessageLink, _: Turn) -> Option<(Instant, ())> {
        if view.requests.has_message(port.id) { Some((link.due(port), ())) } else { None }
    }

    /// Sends the next message that the vehicle can fill, and leaves out the others.
    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut MessageLink, (): ()) -> bool {
        while let Some(Pending::Message { id, index, target }) = cx.requests.take_message(port.id) {
            let outbox = &mut port.outbox;
            if fill(cx.vehicle, &mut Fill::new(cx.now, id.get(), index, outbox, false).to(target)) {
                let cost = cost(outbox.len(), PERCENT);
                link.limit.spend(cx.now, cost, port.config.bytes_per_second);
                (link.frames, link.at) = (port.counters.tx_frames, cx.now);
                return true;
            }
        }
        false
    }
}

/// The id of a message that the vehicle sends. Fails to compile if the stack sends it by itself.
pub(crate) const fn id_of<M: Message>() -> u32 {
    assert!(!is_own(M::ID), "the stack sends this message by itself: it cannot be sent by the vehicle");
    M::ID
}

impl Context<'_> {
    /// Sends message `M` when a link of `to` has room: the stack then calls [`Telemetry::fill`] with this `index`, as
    /// for a stream, but `M` need not be one of [`STREAMS`](Telemetry::STREAMS). Needs `messages` in
    /// [`#[stack]`](macro@crate::Stack).
    ///
    /// Each link has room for eight messages, sends them in order, after all answers, and uses at most half of its rate
    /// for them. The same message to the same destination is sent once until then. Returns false if no link has room:
    /// then nothing is sent, and it is [counted](crate::Stack::refused_messages). A message that cannot be filled when
    /// its turn comes is left out. High-latency links send none.
    ///
    /// ```
    /// use mavstack::dialect::GimbalDeviceSetAttitude;
    /// use mavstack::prelude::*;
    ///
    /// # struct Camera { gimbal: Option<Peer>, angle: [f32; 4] }
    /// # impl Camera {
    /// fn point_at(&mut self, cx: &mut Context<'_>, angle: [f32; 4]) {
    ///     self.angle = angle;
    ///     if let Some(gimbal) = self.gimbal {
    ///         let _ = cx.send::<GimbalDeviceSetAttitude>(gimbal, 0);
    ///     }
    /// }
    /// # }
    ///
    /// impl Telemetry for Camera {
    ///     fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
    ///         match id {
    ///             GimbalDeviceSetAttitude::ID => out.put(&GimbalDeviceSetAttitude {
    ///                 q: self.angle,
    ///                 target_system: out.target().system.wire(),
    ///                 target_component: out.target().component.wire(),
    ///                 ..GimbalDeviceSetAttitude::UNKNOWN
    ///             }),
    ///             _ => false,
    ///         }
    ///     }
    /// }
    /// ```
    #[must_use = "it is not sent if the link has no room"]
    pub fn send<M: Message>(&mut self, to: impl Into<Destination>, index: u16) -> bool {
        self.requests.send(self.normal, const { id_of::<M>() }, to.into(), index)
    }
}
