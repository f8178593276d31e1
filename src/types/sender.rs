//! Who has sent a frame, and what proves it.

use super::link::Peer;
use crate::message::SystemId;

/// What proves the sender of a frame. Ordered: a signature is the strongest proof.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Trust {
    /// Nothing: an unsigned frame that a link accepts as an exception, such as RADIO_STATUS.
    None,
    /// The link is open: whoever can send there is believed.
    Open,
    /// A valid signature.
    Signed,
}

/// Who has sent a frame: an address on a link, with what proves it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sender {
    /// The address, and the link on which the frame was received.
    pub peer: Peer,
    /// What proves that the frame is the peer's.
    pub trust: Trust,
}

impl Sender {
    /// Whether `other` is the same component on the same link, with at least the same proof.
    pub(crate) fn is_repeated_by(self, other: Self) -> bool {
        other.peer == self.peer && other.trust >= self.trust
    }
}

/// The systems that may change the vehicle while one of them is in control (O-5). All bits zero: nobody is.
#[derive(Clone, Copy, Debug)]
pub struct Controllers {
    /// The system in control; [`SystemId::ALL`] if none is.
    owner: SystemId,
    /// What has proved the frame that took control. Frames that prove less are not the owner's.
    trust: Trust,
    /// Other systems that may send commands; 0 is none.
    secondaries: [u8; 10],
}

impl Controllers {
    /// Nobody is in control, so everyone may change the vehicle.
    pub(crate) const NOBODY: Self = Self { owner: SystemId::ALL, trust: Trust::None, secondaries: [0; 10] };

    pub(crate) fn new(owner: Option<SystemId>, trust: Trust, secondaries: [u8; 10]) -> Self {
        Self { owner: owner.unwrap_or(SystemId::ALL), trust, secondaries }
    }

    /// Returns the system in control.
    pub(crate) fn owner(&self) -> Option<SystemId> {
        Some(self.owner).filter(|owner| !owner.is_all())
    }

    /// Whether a frame of this system, proved so well, is that of the system in control.
    pub(crate) fn is_owner(&self, system: SystemId, trust: Trust) -> bool {
        self.owner() == Some(system) && trust >= self.trust
    }

    /// Whether a frame of this system, proved so well, may change the vehicle: the system is in control, or nobody is, or it is a
    /// secondary one.
    pub(crate) fn may_change(&self, system: SystemId, trust: Trust) -> bool {
        self.owner.is_all()
            || self.is_owner(system, trust)
            || self.secondaries.iter().any(|secondary| *secondary == system.wire())
    }
}
