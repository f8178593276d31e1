//! The part of a storage that the journal uses.

use core::num::Wrapping;
use core::ops::Range;

use super::page::{PAGE, TAIL};

#[allow(clippy::as_conversions, reason = "256")]
const PAGE_LEN: u32 = PAGE as u32;

/// An address in the storage, in bytes. No operation wraps, because the region lies in the storage.
pub(super) type Address = Wrapping<u32>;

/// A number of pages in a segment, or a position there. No operation wraps, because a segment has at most 65,535 pages.
pub(super) type Pages = Wrapping<u16>;

/// A number of pages in the region, or a position there. No operation wraps, because the region has at most 131,070
/// pages.
pub(super) type RegionPages = Wrapping<u32>;

/// The part of a storage that the journal uses: some number of erase units of equal size, two at least.
///
/// With an odd number of units, each segment begins one unit further on, so that all of them wear evenly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Region {
    start: Address,
    /// The length of the region, of one erase unit, and of a segment.
    pub(super) pages: RegionPages,
    pub(super) unit: RegionPages,
    pub(super) segment: Pages,
    /// The last page of a record is written in two parts: the second begins with this byte. 0 if it is written in one.
    pub(super) tail_at: u16,
}

impl Region {
    pub(super) const NONE: Self =
        Self { start: Wrapping(0), pages: Wrapping(0), unit: Wrapping(0), segment: Wrapping(0), tail_at: 0 };

    /// Returns the erase unit of the journal in bytes, for a storage with this erase unit: a multiple of 256.
    pub(super) const fn unit_of(erase_size: u32) -> u32 {
        if erase_size < PAGE_LEN { PAGE_LEN } else { erase_size }
    }

    /// Returns the region `bytes` of a storage with these units, all in bytes. Bytes at its ends that do not fill an
    /// erase unit are not used, and neither is the part beyond 16 MiB in each half.
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
            start: Wrapping(start),
            pages: Wrapping(units * unit_pages),
            unit: Wrapping(unit_pages),
            segment: Wrapping((half * unit_pages) as u16),
            tail_at: (PAGE_LEN - tail) as u16,
        }
    }

    /// Returns the address of a page. It is counted from page `first` of the region, at whose end it begins again.
    pub(super) fn address(&self, first: RegionPages, position: RegionPages) -> Address {
        self.start + self.wrapped(first + position) * Wrapping(PAGE_LEN)
    }

    /// Returns the length of an erase unit in bytes.
    pub(super) fn unit_len(&self) -> u32 {
        (self.unit * Wrapping(PAGE_LEN)).0
    }

    /// Returns the first page of the segment that follows the one at this page.
    pub(super) fn next(&self, first: RegionPages) -> RegionPages {
        self.wrapped(first + in_region(self.segment))
    }

    /// Returns the page `position` pages before this one.
    pub(super) fn before(&self, page: RegionPages, position: RegionPages) -> RegionPages {
        if page >= position { page - position } else { page + self.pages - position }
    }

    /// Begins again after the end of the region.
    fn wrapped(&self, page: RegionPages) -> RegionPages {
        if page >= self.pages { page - self.pages } else { page }
    }

    /// Returns the number of its units.
    pub(super) fn units(&self) -> u32 {
        self.pages.0.checked_div(self.unit.0).unwrap_or(0)
    }

    /// Returns the position behind the unit that contains this position.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(super) fn end_of_unit(&self, position: Pages) -> Pages {
        let next = in_region(position) + Wrapping(1);
        let end = next.0.checked_next_multiple_of(self.unit.0.max(1)).unwrap_or(u32::MAX);
        Wrapping(u16::try_from(end).unwrap_or(u16::MAX)).min(self.segment)
    }

    /// Returns the first position of the unit that contains this position.
    pub(super) fn begin_of_unit(&self, position: Pages) -> RegionPages {
        in_region(self.end_of_unit(position)) - self.unit
    }
}

/// Converts a position in a segment.
pub(super) fn in_region(position: Pages) -> RegionPages {
    Wrapping(position.0.into())
}
