//! The right to steer: the authorised senders, and the one of them that steers at a time.

use crate::dialect::MavType;
use crate::message::{Address, SystemId};
use crate::network::{PeerInfo, Peers};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, Peer};

/// The senders that may steer the vehicle, by hand (J-2) or by setpoints (J-6).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ControlSource {
    /// No sender.
    Nobody,
    /// Every component of one system: the ground station in control.
    System(SystemId),
    /// Every system from `first` to `last`, both included.
    Systems {
        /// The lowest id.
        first: SystemId,
        /// The highest id.
        last: SystemId,
    },
    /// Every system that sends a ground station's heartbeats on the same link: type [`GCS`](MavType::GCS), and not
    /// [timed out](crate::PeerEvent::Lost). A sender without an entry in the peer table is not known.
    GroundStation,
}

impl ControlSource {
    /// Whether it allows this sender.
    pub(crate) fn allows(self, from: Peer, peers: &Peers) -> bool {
        let system = from.address.system;
        match self {
            Self::Nobody => false,
            Self::System(only) => system == only,
            Self::Systems { first, last } => first <= system && system <= last,
            Self::GroundStation => peers.iter().any(|info| {
                info.peer.address.system == system
                    && info.peer.link == from.link
                    && info.r#type == MavType::GCS
                    && info.is_alive
            }),
        }
    }

    /// Whether a ground station that may steer is alive, on any link.
    pub(crate) fn is_alive(self, mut peers: impl Iterator<Item = PeerInfo>) -> bool {
        let systems = match self {
            Self::Nobody => return false,
            Self::System(only) => only..=only,
            Self::Systems { first, last } => first..=last,
            Self::GroundStation => SystemId::ALL..=SystemId::new(u8::MAX),
        };
        peers.any(|info| info.is_living_station() && systems.contains(&info.peer.address.system))
    }
}

/// The sender that steers until it was silent for a timeout.
#[derive(Clone, Debug)]
pub(super) struct Holder {
    pub(super) source: ControlSource,
    pub(super) timeout: Duration,
    sender: Peer,
    /// When its turn ends; zero if no sender holds.
    until: Instant,
}

impl Holder {
    /// All zero bits.
    pub(super) const NEW: Self = Self {
        source: ControlSource::Nobody,
        timeout: Duration::ZERO,
        sender: Peer { address: Address::new(0, 0), link: LinkId(0) },
        until: Instant::ZERO,
    };

    /// Returns the sender that steers now.
    pub(super) fn sender(&self, now: Instant) -> Option<Peer> {
        (now < self.until).then_some(self.sender)
    }

    /// Returns the sender that has steered since the last [release](Self::release), also if it has timed out.
    pub(super) fn last_sender(&self) -> Option<Peer> {
        (self.until > Instant::ZERO).then_some(self.sender)
    }

    /// Returns when its turn ends.
    pub(super) const fn until(&self) -> Instant {
        self.until
    }

    /// Lets a sender steer until the timeout.
    pub(super) fn hold(&mut self, now: Instant, sender: Peer) {
        self.sender = sender;
        self.until = now + self.timeout;
    }

    pub(super) const fn release(&mut self) {
        self.until = Instant::ZERO;
    }
}
