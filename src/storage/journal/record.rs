//! The positions of segments and records.

use core::num::{Saturating, Wrapping};

use super::super::page::Footer;
use super::super::region::{Pages, Region, RegionPages, in_region};

/// The number of kinds of records that a journal keeps.
const KINDS: usize = 16;

/// Stands for unknown kinds: a record of each kind may be lost.
const ANY_KIND: u8 = u8::MAX;

/// The number of a segment: one more than the greatest before; 0 if there is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SegmentNumber(pub(super) u32);

impl SegmentNumber {
    pub(super) const NONE: Self = Self(0);

    /// Whether a segment can have this number.
    pub(super) const fn is_possible(self) -> bool {
        self.0.cast_signed() > 0
    }

    pub(super) const fn is_newer_than(self, other: Self) -> bool {
        self.0.wrapping_sub(other.0).cast_signed() > 0
    }

    pub(super) const fn next(self) -> Self {
        Self(self.0.wrapping_add(1))
    }
}

/// Where a segment is, and how far it is written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    pub(super) number: SegmentNumber,
    /// Its first page, counted from the start of the region.
    pub(super) first: RegionPages,
    /// The next page to be written.
    pub(super) head: Pages,
    /// The pages from `head` to here are erased.
    pub(super) erased: Pages,
    /// The number of records in it, modulo 2^16, and the kind of the newest one.
    pub(super) count: Wrapping<u16>,
    pub(super) before: u8,
}

impl Segment {
    pub(super) const NONE: Self = Self::new(SegmentNumber::NONE, Wrapping(0));

    pub(super) const fn new(number: SegmentNumber, first: RegionPages) -> Self {
        Self { number, first, head: Wrapping(0), erased: Wrapping(0), count: Wrapping(0), before: 0 }
    }

    pub(super) fn is_none(&self) -> bool {
        self.number == SegmentNumber::NONE
    }

    /// Counts a page that was found in it. Its unit was erased for it.
    pub(super) fn add_page(&mut self, position: Pages, region: &Region) {
        self.head = position + Wrapping(1);
        self.erased = region.end_of_unit(position);
    }

    /// Counts a record.
    pub(super) fn add_record(&mut self, kind: u8) {
        self.count += 1;
        self.before = kind;
    }

    /// Leaves out the rest of the unit at its head.
    pub(super) fn leave_out_unit(&mut self, region: &Region) {
        self.head = region.end_of_unit(self.head);
        self.erased = self.erased.max(self.head);
    }
}

/// The newest record of a kind.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    /// 0 if the entry is free.
    pub(super) kind: u8,
    /// Whether a newer record of this kind was lost.
    pub(crate) is_damaged: bool,
    pub(crate) schema: u16,
    /// Its first page in the open segment.
    pub(super) at: Pages,
    /// Its length; 0 if there is none.
    pub(crate) pages: Pages,
    /// Its first page in the segment that is being written.
    pub(super) moved: Pages,
}

impl Entry {
    const FREE: Self =
        Self { kind: 0, is_damaged: false, schema: 0, at: Wrapping(0), pages: Wrapping(0), moved: Wrapping(0) };

    /// Whether the slot holds no record.
    pub(super) const fn is_free(&self) -> bool {
        self.kind == 0
    }
}

/// The newest record of each kind.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entries([Entry; KINDS]);

impl Entries {
    pub(super) const FREE: Self = Self([Entry::FREE; KINDS]);

    /// Returns the newest record of a kind; `None` if it has no entry.
    pub(super) fn get(&self, kind: u8) -> Option<&Entry> {
        self.0.iter().find(|entry| entry.kind == kind)
    }

    /// Returns the newest record of a kind, and whether a newer one was lost.
    pub(super) fn find(&self, kind: u8) -> &Entry {
        self.get(kind).or_else(|| self.get(ANY_KIND)).unwrap_or(&Entry::FREE)
    }

    /// Returns the entry of a kind, or a free one; `None` if there are too many kinds.
    // Out of line: it has several callers.
    #[inline(never)]
    fn slot(&mut self, kind: u8) -> Option<&mut Entry> {
        let wanted = if self.get(kind).is_some() { kind } else { 0 };
        self.0.iter_mut().find(|entry| entry.kind == wanted)
    }

    /// Whether a record of this kind can be added.
    pub(super) fn has_slot(&mut self, kind: u8) -> bool {
        self.slot(kind).is_some()
    }

    pub(super) fn set(&mut self, entry: Entry) {
        if let Some(slot) = self.slot(entry.kind) {
            *slot = entry;
        }
    }

    pub(super) fn mark_damaged(&mut self, kind: u8) {
        if let Some(entry) = self.slot(kind) {
            (entry.kind, entry.is_damaged) = (kind, true);
        }
    }

    /// Marks all kinds: records of unknown kinds were lost.
    pub(super) fn mark_all_damaged(&mut self) {
        self.mark_damaged(ANY_KIND);
        for entry in &mut self.0 {
            entry.is_damaged |= !entry.is_free();
        }
    }

    /// Forgets that records of unknown kinds were lost. Returns false if none were.
    pub(super) fn clear_any_kind(&mut self) -> bool {
        let entry = self.0.iter_mut().find(|entry| entry.kind == ANY_KIND);
        entry.map(|entry| *entry = Entry::FREE).is_some()
    }

    /// All copies are complete: the records are where they were copied to.
    pub(super) fn move_all(&mut self) {
        for entry in &mut self.0 {
            entry.at = entry.moved;
        }
    }

    /// Returns the number of pages of a new record of this kind, and of the others that `copies` has still to copy.
    pub(super) fn pages_with(&self, kind: u8, pages: Pages, copies: Copies) -> RegionPages {
        let others = self.0.iter().skip(copies.next.0.into()).filter(|entry| !entry.is_free() && entry.kind != kind);
        others.fold(in_region(pages), |sum, entry| sum + in_region(entry.pages) + Wrapping(entry.is_damaged.into()))
    }

    /// Returns the next entry to copy; `None` if all are copied.
    pub(super) fn next_to_copy(&mut self, copies: Copies) -> Option<&mut Entry> {
        self.0.get_mut(usize::from(copies.next.0))
    }
}

/// The copies of the other records at the start of a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Copies {
    /// The index of the entry that is copied next.
    next: Saturating<u8>,
}

impl Copies {
    /// No entry is copied yet.
    pub(super) const ALL: Self = Self { next: Saturating(0) };
    /// All are copied, or none must be.
    #[allow(clippy::as_conversions, reason = "16")]
    pub(super) const NONE: Self = Self { next: Saturating(KINDS as u8) };

    /// Whether no entry remains to be copied.
    pub(super) fn is_complete(self) -> bool {
        self.next >= Self::NONE.next
    }

    /// Proceeds to the next entry.
    pub(super) fn advance(&mut self) {
        self.next += 1;
    }
}

/// The record that is read, copied or written, and which of its pages is next.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordCursor {
    pub(super) kind: u8,
    pub(super) schema: u16,
    /// Its first page in the open segment, if it is read from there.
    at: Pages,
    /// The index of its next page.
    pub(super) index: Pages,
    /// The checksum of its page before.
    pub(super) previous_crc: u32,
}

impl RecordCursor {
    pub(super) const NONE: Self = Self::new(0, 0);

    /// A new record.
    pub(super) const fn new(kind: u8, schema: u16) -> Self {
        Self { kind, schema, at: Wrapping(0), index: Wrapping(0), previous_crc: 0 }
    }

    /// The start of a record in the open segment.
    pub(super) const fn at(entry: &Entry) -> Self {
        Self { at: entry.at, ..Self::new(entry.kind, entry.schema) }
    }

    /// Returns its next page in the open segment.
    pub(super) fn next_position(&self) -> RegionPages {
        in_region(self.at + self.index)
    }

    /// Whether a page continues the record.
    pub(super) fn continues_with(&self, footer: &Footer) -> bool {
        (footer.kind, footer.index, footer.previous_crc) == (self.kind, self.index.0, self.previous_crc)
    }

    /// Proceeds to the page after the one with this checksum.
    pub(super) fn advance(&mut self, crc: u32) {
        self.index += 1;
        self.previous_crc = crc;
    }
}
