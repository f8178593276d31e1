//! Who has sent a frame, and what proves it.

use super::link::Peer;

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
