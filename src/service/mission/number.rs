//! Sequence numbers: they tell which frame was sent first, and which COUNT is a duplicate (M-22, M-45).

use crate::types::LinkId;

/// The link on which a frame was received, and its sequence number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Number(pub(super) LinkId, pub(super) u8);

impl Number {
    /// Whether this frame was certainly sent after `other`. Each link has its own sequence numbers, and some senders do not
    /// increment them.
    pub(super) fn is_after(self, other: Self) -> bool {
        self.0 == other.0 && matches!(self.1.wrapping_sub(other.1), 1..=127)
    }
}

/// The range of sequence numbers of an upload's COUNTs: the first COUNT, up to the first item. Empty for a sender that does not
/// increment its sequence number.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counts {
    first: Number,
    len: u8,
}

impl Counts {
    /// All zero bits.
    pub(super) const VACANT: Self = Self { first: Number(LinkId(0), 0), len: 0 };

    /// Starts the range with the first COUNT.
    pub(super) const fn new(first: Number) -> Self {
        Self { first, len: 1 }
    }

    /// Extends the range to a repeated COUNT.
    pub(super) fn extend(&mut self, number: Number) {
        let len = number.1.wrapping_sub(self.first.1);
        if number.0 == self.first.0 && len < 127 {
            self.len = self.len.max(len.wrapping_add(1));
        }
    }

    /// Ends the range before the first item, which has this sequence number.
    pub(super) fn end(&mut self, number: Number) {
        let len = number.1.wrapping_sub(self.first.1);
        if number.0 == self.first.0 && len <= 127 {
            self.len = len;
        }
    }

    /// Whether this is the sequence number of one of these COUNTs, on whichever link it was received.
    pub(super) fn contains(self, number: u8) -> bool {
        number.wrapping_sub(self.first.1) < self.len
    }
}
