//! Gates: they examine each received frame before the services see it, and sign each frame before it is sent.

use super::{Cx, Handled, Received, Service, increment};
use crate::dialect::{MavCmd, SetupSigning};
use crate::frame::{Decoder, Frame};
use crate::link::Port;
use crate::message::{Address, Message, SystemId};
use crate::network::{ForwardCounters, ForwardDecision, SenderEntry};
use crate::time::{Duration, Instant};
use crate::types::{Command, CommandAnswer, Controllers, Firmware, LinkId, Payer, Peer, SignedAt, Trust};

/// Verifies the signatures of received frames, and signs sent frames. `L` is its state on a link.
pub trait SigningGate<L> {
    /// Whether a frame is accepted on its link. Called once for each frame, before the frame has any effect.
    fn admits(&mut self, now: Instant, port: &mut Port, link: &mut L, frame: &Frame<'_>) -> bool;

    /// Returns what proves the sender of an accepted frame. A frame that was accepted as an exception, or to set the
    /// first key, may come from anyone.
    fn trust(&self, port: &Port, frame: &Frame<'_>) -> Trust;

    /// Whether an unsigned frame with this id is accepted on this link.
    fn accepts_unsigned(&self, port: &Port, id: u32) -> bool;

    /// Returns how long ago an accepted frame was signed; `None` if its signature was not verified.
    fn age(&self, now: Instant, frame: &Frame<'_>) -> Option<Duration>;

    /// Returns when an accepted frame was signed, by its sender's clock; `None` if its signature was not verified.
    fn signed_at(&self, frame: &Frame<'_>) -> SignedAt;

    /// Returns the cost of [`admits`](Self::admits) for a frame, in cost units.
    fn cost(&self, frame: &Frame<'_>) -> u32;

    /// Whether there is a key.
    fn has_key(&self) -> bool;

    /// Whether the signature of a frame with an unknown id is correct, so that it is an intact frame (SEC-5). The frame
    /// may still be refused. The cost is subtracted from `work`.
    fn vouches_for(&self, raw: &[u8], work: &mut u32) -> bool;

    /// Selects signing for the next frame, if the link signs and there are a key and a timestamp. The frame is then
    /// MAVLink 2 (V-3).
    fn prepare(&mut self, now: Instant, port: &mut Port);

    /// Signs the frame that is about to be sent, if it needs a signature: a new frame, or one that is sent again from
    /// its start (G-4). Without a key or a timestamp, the frame is dropped.
    fn sign(&mut self, now: Instant, port: &mut Port);

    /// Called after a frame with this id was handled. Overwrites a key that the frame contained in the decoder's
    /// buffer.
    fn wipe(&self, id: u32, decoder: &mut Decoder);
}

/// An examined frame, and what the other gates know of its sender.
pub struct Examined<'a> {
    pub(crate) frame: &'a Frame<'a>,
    pub(crate) decision: ForwardDecision,
    /// The sender's entry in the peer table; `None` if nothing may be learned from the frame.
    pub(crate) sender: Option<SenderEntry>,
    /// Whose credits pay for the frame on a high-latency link.
    pub(crate) payer: Payer,
    /// The vehicle has a key for verifying signatures.
    pub(crate) has_key: bool,
}

/// Examines received frames, and queues those that are forwarded.
pub trait ForwardingGate<F: Firmware>: Service<F> {
    /// Decides whether to forward a frame, accepted or not, before anything is learned from it.
    fn examine(&mut self, cx: &Cx<'_, F>, port: &Port, frame: &Frame<'_>, is_accepted: bool) -> ForwardDecision;

    /// Queues an examined frame for the links of its routes. Returns the number of bytes that were copied, which is the
    /// cost.
    fn forward(&mut self, cx: &mut Cx<'_, F>, port: &Port, examined: &Examined<'_>) -> u32;

    /// Updates the link's queue to the link's configuration and version.
    fn prepare(&mut self, port: &Port);

    /// Returns the counters of a link's queue; `None` if there is no such link.
    fn link_counters(&self, link: LinkId) -> Option<ForwardCounters>;
}

/// Decides which systems control the vehicle (O-5), before the services see their frames.
pub trait ControlGate {
    /// Whether a system can be in control.
    const IS_SOME: bool = false;

    /// Whether a frame that is no command is dropped, because its sender is not in control. Counted. `is_ours`: the sender is
    /// a component of our own system, and is believed.
    /// `is_receiver`: the sender is the pilot's receiver, whose sticks are never dropped (J-11).
    fn drops(&mut self, is_ours: bool, is_receiver: bool, received: &Received<'_>) -> bool {
        let _ = (is_ours, is_receiver, received);
        false
    }

    /// Whether a command is answered NOT_IN_CONTROL. Counted.
    fn refuses(&mut self, is_ours: bool, command: &Command) -> bool {
        let _ = (is_ours, command);
        false
    }

    /// Returns the systems that may change the vehicle.
    fn controllers(&self) -> Controllers {
        Controllers::NOBODY
    }

    /// Returns the system in control, once after each time that it is another one.
    fn take_new_owner(&mut self) -> Option<SystemId> {
        None
    }
}

impl ControlGate for Absent {}

/// Knows the pilot's receivers (J-10).
pub trait SticksGate {
    /// Whether the sender is one of them.
    fn is_receiver(&self, from: Peer) -> bool {
        let _ = from;
        false
    }
}

impl SticksGate for Absent {}

/// A request of the firmware itself to one of its other components.
#[derive(Debug)]
pub enum OwnRequest {
    /// Execute the command.
    Execute(Command),
    /// Cancel the command.
    Cancel(Command),
}

/// Hands over the firmware's own commands to its other components, which are carried out without a link (K-11).
pub trait OwnCommands<F: Firmware> {
    /// Takes a request that is pending for one of our components.
    fn take_own(&mut self, now: Instant, own: Address) -> Option<OwnRequest> {
        let _ = (now, own);
        None
    }

    /// Returns the number of slots.
    fn own_slots(&self) -> usize {
        0
    }

    /// Returns the command in the slot with this index if one of our components is executing it.
    fn running_own(&self, index: usize) -> Option<MavCmd> {
        let _ = index;
        None
    }

    /// Passes an answer of one of our components to the vehicle.
    fn answered_own(&mut self, cx: &mut Cx<'_, F>, from: Address, answer: CommandAnswer) {
        let _ = (cx, from, answer);
    }
}

impl<F: Firmware> OwnCommands<F> for Absent {}

/// A service that the firmware did not declare.
#[derive(Clone, Copy, Debug)]
pub struct Absent;

impl<F: Firmware> Service<F> for Absent {
    const NEW: Self = Self;
    type Link = ();
    const VACANT: () = ();
    type Reply = ();
}

/// Without signing, every frame counts as unsigned, and only open links accept frames.
impl SigningGate<()> for WithoutSigning {
    fn admits(&mut self, _: Instant, port: &mut Port, (): &mut (), _: &Frame<'_>) -> bool {
        let is_open = is_open(port);
        if !is_open {
            increment(&mut port.counters.out_of_place);
        }
        is_open
    }

    fn trust(&self, port: &Port, _: &Frame<'_>) -> Trust {
        if is_open(port) { Trust::Open } else { Trust::None }
    }

    fn accepts_unsigned(&self, port: &Port, _: u32) -> bool {
        is_open(port)
    }

    fn age(&self, _: Instant, _: &Frame<'_>) -> Option<Duration> {
        None
    }

    fn signed_at(&self, _: &Frame<'_>) -> SignedAt {
        None
    }

    fn cost(&self, _: &Frame<'_>) -> u32 {
        0
    }

    fn has_key(&self) -> bool {
        false
    }

    fn vouches_for(&self, _: &[u8], _: &mut u32) -> bool {
        false
    }

    fn prepare(&mut self, _: Instant, _: &mut Port) {}

    fn sign(&mut self, _: Instant, _: &mut Port) {}

    fn wipe(&self, _: u32, _: &mut Decoder) {}
}

/// The signing gate of a stack that does not declare `signing`.
#[derive(Clone, Copy, Debug)]
pub struct WithoutSigning;

impl<F: Firmware> Service<F> for WithoutSigning {
    const NEW: Self = Self;
    type Link = ();
    const VACANT: () = ();
    type Reply = ();

    /// Drops SETUP_SIGNING: it contains a key, which the vehicle's hook for messages must not see (G-11).
    fn on_frame(&mut self, _: &mut Cx<'_, F>, _: &mut Port, (): &mut (), received: &Received<'_>) -> Handled {
        if received.frame.id() == SetupSigning::ID { Handled::OutOfPlace } else { Handled::No }
    }
}

#[cfg_attr(
    not(feature = "signing"),
    allow(clippy::missing_const_for_fn, reason = "without signing, all links are open")
)]
fn is_open(port: &Port) -> bool {
    #[cfg(feature = "signing")]
    return matches!(port.config.signing.accept, crate::types::Accept::Open);
    #[cfg(not(feature = "signing"))]
    {
        let _ = port;
        true
    }
}

/// Without forwarding, every frame is handled locally only.
impl<F: Firmware> ForwardingGate<F> for Absent {
    fn examine(&mut self, _: &Cx<'_, F>, _: &Port, _: &Frame<'_>, _: bool) -> ForwardDecision {
        ForwardDecision::LocalOnly
    }

    fn forward(&mut self, _: &mut Cx<'_, F>, _: &Port, _: &Examined<'_>) -> u32 {
        0
    }

    fn prepare(&mut self, _: &Port) {}

    fn link_counters(&self, _: LinkId) -> Option<ForwardCounters> {
        None
    }
}
