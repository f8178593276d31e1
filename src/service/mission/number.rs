//! Sequence numbers: which frame was sent first, and which is a duplicate of a COUNT (M-22, M-45).

use crate::link::LinkId;

/// The link that a frame came by, and its sequence number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Number(pub(super) LinkId, pub(super) u8);

impl Number {
    /// Whether this frame was sent after `other`, as far as that can be told: on another link they count apart, and there are
    /// senders that do not count.
    pub(super) fn is_after(self, other: Self) -> bool {
        self.0 == other.0 && matches!(self.1.wrapping_sub(other.1), 1..=127)
    }
}

/// The sequence numbers of the COUNTs that began an upload: the first one, and how many from there to the first item. None
/// of a sender that does not count.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counts {
    first: Number,
    len: u8,
}

impl Counts {
    /// The first of them.
    pub(super) const fn new(first: Number) -> Self {
        Self { first, len: 1 }
    }

    /// Another COUNT has come.
    pub(super) fn extend(&mut self, number: Number) {
        let len = number.1.wrapping_sub(self.first.1);
        if number.0 == self.first.0 && len < 127 {
            self.len = self.len.max(len.wrapping_add(1));
        }
    }

    /// The first item has come, and bears this number.
    pub(super) fn end(&mut self, number: Number) {
        let len = number.1.wrapping_sub(self.first.1);
        if number.0 == self.first.0 && len <= 127 {
            self.len = len;
        }
    }

    /// Whether it is the number of one of them, also where it came by another link.
    pub(super) fn contains(self, number: u8) -> bool {
        number.wrapping_sub(self.first.1) < self.len
    }
}
