//! The part of a storage that the journal uses.

use core::ops::Range;

use super::page::{PAGE, TAIL};

#[allow(clippy::as_conversions, reason = "256")]
pub(super) const PAGE_LEN: u32 = PAGE as u32;

/// The part of a storage that the journal uses: some number of erase units of equal size, two at least.
///
/// With an odd number of units, each segment begins one unit further on, so that all of them wear evenly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Region {
    pub(super) start: u32,
    /// All in pages: the region, one erase unit, and a segment.
    pub(super) pages: u32,
    pub(super) unit: u32,
    pub(super) segment: u16,
    /// Length of the part of a record's last page that is written separately, after the rest, in bytes.
    pub(super) tail: u16,
}

impl Region {
    pub(super) const NONE: Self = Self { start: 0, pages: 0, unit: 0, segment: 0, tail: 0 };

    /// Returns the erase unit of the journal in bytes, for a storage with this erase unit: a multiple of 256.
    pub(super) const fn unit_of(erase_size: u32) -> u32 {
        if erase_size < PAGE_LEN { PAGE_LEN } else { erase_size }
    }

    /// Returns the region `bytes` of a storage with these units, all in bytes. Bytes at its ends that do not fill an
    /// erase unit are not used, and neither is what exceeds 16 MiB for each half.
    ///
    /// # Panics
    ///
    /// `write_size` does not divide 256, or neither of `erase_size` and 256 divides the other. In a `const`, this is a
    /// compile error.
    #[allow(
        clippy::arithmetic_side_effects,
        clippy::as_conversions,
        clippy::panic,
        reason = "for constants; all values are checked"
    )]
    pub const fn new(bytes: Range<u32>, write_size: u32, erase_size: u32) -> Self {
        assert!(write_size > 0 && PAGE_LEN.is_multiple_of(write_size), "the write unit must divide 256");
        assert!(
            erase_size > 0 && (PAGE_LEN.is_multiple_of(erase_size) || erase_size.is_multiple_of(PAGE_LEN)),
            "the erase unit must be a multiple of 256, or divide it"
        );
        assert!(erase_size.is_multiple_of(write_size), "the erase unit must be a multiple of the write unit");
        let unit = Self::unit_of(erase_size);
        let start = match bytes.start.checked_next_multiple_of(unit) {
            Some(start) => start,
            None => u32::MAX,
        };
        let unit_pages = unit / PAGE_LEN;
        let most = 65_535 / unit_pages;
        let all = bytes.end.saturating_sub(start) / unit;
        let half = if all / 2 < most { all / 2 } else { most };
        let units = if half == most { half * 2 } else { all };
        let tail = if write_size > TAIL as u32 { write_size } else { TAIL as u32 };
        Self {
            start,
            pages: units * unit_pages,
            unit: unit_pages,
            segment: (half * unit_pages) as u16,
            tail: tail as u16,
        }
    }

    /// Returns the address of a page, counted from the first page of a segment.
    pub(super) const fn at(&self, first: u32, position: u32) -> u32 {
        let mut page = first.wrapping_add(position);
        if page >= self.pages {
            page = page.wrapping_sub(self.pages);
        }
        self.start.wrapping_add(page.wrapping_mul(PAGE_LEN))
    }

    /// Returns the first page of the segment that follows the one at this page.
    pub(super) fn next(&self, first: u32) -> u32 {
        let next = first.wrapping_add(self.segment.into());
        if next >= self.pages { next.wrapping_sub(self.pages) } else { next }
    }

    /// Returns the number of its units.
    pub(super) fn units(&self) -> u32 {
        self.pages.checked_div(self.unit).unwrap_or(0)
    }

    /// Returns the position behind the unit that contains this position.
    #[inline(never)]
    pub(super) fn end_of_unit(&self, position: u16) -> u16 {
        let unit = self.unit.max(1);
        let end = u32::from(position).saturating_add(1).checked_next_multiple_of(unit).unwrap_or(u32::MAX);
        u16::try_from(end).unwrap_or(u16::MAX).min(self.segment)
    }
}
