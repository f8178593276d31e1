//! The positions of segments and records.

use super::super::page::Footer;

/// Where a segment is, and how far it is written.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Segment {
    /// Counts up; 0 if there is none.
    pub(super) number: u32,
    /// Its first page, counted from the start of the region.
    pub(super) first: u32,
    /// The next page to be written.
    pub(super) head: u16,
    /// The pages from `head` to here are erased.
    pub(super) erased: u16,
    /// The number of records in it, modulo 2^16, and the kind of the newest one.
    pub(super) count: u16,
    pub(super) before: u8,
}

impl Segment {
    pub(super) const NONE: Self = Self { number: 0, first: 0, head: 0, erased: 0, count: 0, before: 0 };
}

/// The newest record of a kind.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Entry {
    /// 0 if the entry is free.
    pub(super) kind: u8,
    /// Whether a newer record of this kind was lost.
    pub(crate) is_damaged: bool,
    pub(crate) schema: u16,
    /// Its first page in the open segment.
    pub(super) at: u16,
    /// Its length in pages; 0 if there is none.
    pub(crate) pages: u16,
    /// Its first page in the segment that is being written.
    pub(super) moved: u16,
}

impl Entry {
    pub(super) const FREE: Self = Self { kind: 0, is_damaged: false, schema: 0, at: 0, pages: 0, moved: 0 };
}

/// The record that is read or written.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Record {
    pub(super) kind: u8,
    pub(super) schema: u16,
    /// The index of its next page.
    pub(super) index: u16,
    /// The checksum of its page before.
    pub(super) crc: u32,
}

impl Record {
    pub(super) const NONE: Self = Self { kind: 0, schema: 0, index: 0, crc: 0 };

    pub(super) const fn of(kind: u8) -> Self {
        Self { kind, ..Self::NONE }
    }

    /// Whether a page continues the record.
    pub(super) fn continues(&self, footer: &Footer) -> bool {
        (footer.kind, footer.index, footer.previous) == (self.kind, self.index, self.crc)
    }

    pub(super) fn advance(&mut self, crc: u32) {
        (self.index, self.crc) = (self.index.wrapping_add(1), crc);
    }
}
