//! The log: records of kinds, in the two halves of a region of erase units (D-5, G-18, SEC-11, SEC-12, SEC-15).
//!
//! `format.md` in this folder documents the format, and says why no cut of the power loses a record. The log calls no
//! driver. It hands out one [`Job`] at a time, and is told its result:
//!
//! ```text
//!            attach                 found                    begin
//!   Detached ──────▶ Find, Replay ────────▶ Idle ◀────────────────────────▶ Append: erase, copy, write, check
//!                        ▲   │               ▲ └──────▶ Load: read a record
//!                        │   ▼ unreadable    └────────▶ erase ahead
//!                       Waiting: after 1 s
//! ```
//!
//! A *segment* is one half of the region. All live records are in the open segment, and new ones are appended to it. When
//! it is full, the live records are copied to the other half, followed by the new record. That one opens the new segment:
//! until it is complete, the old segment is valid, and nothing in it was changed.

use core::ops::Range;

use super::page::{Content, Footer, PAGE, Page, TAIL, flag};
use crate::time::{Duration, Instant};

/// The number of kinds of records that a log keeps.
pub(crate) const ENTRIES: usize = 16;
/// Stands for no entry.
const NO_ENTRY: u8 = u8::MAX;

#[allow(clippy::as_conversions, reason = "256")]
const PAGE_LEN: u32 = PAGE as u32;
/// Where the end of a page begins that has the footer.
#[allow(clippy::as_conversions, reason = "224")]
const TAIL_AT: u32 = (PAGE - TAIL) as u32;

/// Pages of one erase unit that cannot be read are given up after this many attempts.
const ATTEMPTS: u8 = 4;
/// More pages are given up after this many, a minute later, and everything counts as damaged; but never all pages of the region.
const LONG_ATTEMPTS: u8 = 10;
/// The number of pages that several power cuts may leave unreadable.
const FEW: u32 = 8;
/// The time between two attempts.
const PAUSE: Duration = Duration::from_secs(1);
/// The time between attempts while more pages cannot be read.
const LONG_PAUSE: Duration = Duration::from_secs(10);
/// After a record is complete, erasing ahead waits for this time, so that the answer to a client is sent first.
const GRACE: Duration = Duration::from_millis(200);

/// One operation on the storage. [`Stack::storage_job`](crate::Stack::storage_job) hands it out, and
/// [`Stack::storage_done`](crate::Stack::storage_done) takes its result.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Job {
    /// Read this range of the [`Page`] from `offset` on, in bytes from the start of the storage. Its length is 32 or 256
    /// bytes, and `offset` is a multiple of 32.
    Read {
        /// The address of the first byte.
        offset: u32,
        /// The part of the page to fill.
        range: Range<usize>,
    },
    /// Write this range of the [`Page`] at `offset`: a multiple of the write unit, at a multiple of it. The place is
    /// erased, and is written once.
    Write {
        /// The address of the first byte.
        offset: u32,
        /// The part of the page to write.
        range: Range<usize>,
    },
    /// Erase `len` bytes at `offset`: one erase unit, or as many as 256 bytes are.
    Erase {
        /// The address of the first byte.
        offset: u32,
        /// The number of bytes.
        len: u32,
    },
}

/// The part of a storage that the log uses: some number of erase units of equal size, two at least.
///
/// With an odd number of units, each segment begins one unit further on, so that all of them wear evenly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Region {
    start: u32,
    /// All in pages: the region, one erase unit, and a segment.
    pages: u32,
    unit: u32,
    segment: u16,
    /// Length of the part of a record's last page that is written separately, after the rest, in bytes.
    tail: u16,
}

impl Region {
    const NONE: Self = Self { start: 0, pages: 0, unit: 0, segment: 0, tail: 0 };

    /// Returns the erase unit of the log in bytes, for a storage with this erase unit: a multiple of 256.
    pub(crate) const fn unit_of(erase_size: u32) -> u32 {
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
    #[inline(never)]
    const fn at(&self, first: u32, position: u32) -> u32 {
        let mut page = first.wrapping_add(position);
        if page >= self.pages {
            page = page.wrapping_sub(self.pages);
        }
        self.start.wrapping_add(page.wrapping_mul(PAGE_LEN))
    }

    /// Returns the first page of the segment that follows the one at this page.
    fn next(&self, first: u32) -> u32 {
        let next = first.wrapping_add(self.segment.into());
        if next >= self.pages { next.wrapping_sub(self.pages) } else { next }
    }

    /// Returns the number of its units.
    fn units(&self) -> u32 {
        self.pages.checked_div(self.unit).unwrap_or(0)
    }

    /// Returns the position behind the unit that contains this position.
    #[inline(never)]
    fn end_of_unit(&self, position: u16) -> u16 {
        let unit = self.unit.max(1);
        let end = u32::from(position).saturating_add(1).checked_next_multiple_of(unit).unwrap_or(u32::MAX);
        u16::try_from(end).unwrap_or(u16::MAX).min(self.segment)
    }
}

/// Where a segment is, and how far it is written.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Segment {
    /// Counts up; 0 if there is none.
    number: u32,
    /// Its first page, counted from the start of the region.
    first: u32,
    /// The next page to be written.
    head: u16,
    /// The pages from `head` to here are erased.
    erased: u16,
    /// The number of records in it, modulo 2^16, and the kind of the newest one.
    count: u16,
    before: u8,
}

impl Segment {
    const NONE: Self = Self { number: 0, first: 0, head: 0, erased: 0, count: 0, before: 0 };
}

/// The newest record of a kind.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Entry {
    /// 0 if the entry is free.
    kind: u8,
    /// Whether a newer record of this kind was lost.
    pub(crate) is_damaged: bool,
    pub(crate) schema: u16,
    /// Its first page in the open segment.
    at: u16,
    /// Its length in pages; 0 if there is none.
    pub(crate) pages: u16,
    /// Its first page in the segment that is being written.
    moved: u16,
}

impl Entry {
    const FREE: Self = Self { kind: 0, is_damaged: false, schema: 0, at: 0, pages: 0, moved: 0 };
}

/// The record that is read or written.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Record {
    kind: u8,
    schema: u16,
    /// The index of its next page.
    index: u16,
    /// The checksum of its page before.
    crc: u32,
}

impl Record {
    const NONE: Self = Self { kind: 0, schema: 0, index: 0, crc: 0 };

    const fn of(kind: u8) -> Self {
        Self { kind, ..Self::NONE }
    }

    /// Whether a page continues the record.
    fn continues(&self, footer: &Footer) -> bool {
        (footer.kind, footer.index, footer.previous) == (self.kind, self.index, self.crc)
    }

    fn advance(&mut self, crc: u32) {
        (self.index, self.crc) = (self.index.saturating_add(1), crc);
    }
}

/// When a record begins a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Switch {
    /// If there is no room for it.
    IfFull,
    /// The next record, if that succeeds.
    Once,
    /// The next record, however often it fails: a newer segment may exist that could not be read.
    Always,
}

/// Stands for unknown kinds: a record of each kind may be lost.
const ANY_KIND: u8 = u8::MAX;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Task {
    /// No storage is attached.
    Detached,
    /// Reads the end of each page, to find the open segment.
    Find,
    /// Reads all of a page whose end is not whole.
    Examine,
    /// Reads the open segment from its start.
    Replay,
    /// Something could not be read: reading is repeated.
    Waiting,
    /// The region has a log of another version: it is neither read nor written.
    Foreign,
    Idle,
    Load,
    Append,
    /// Erases a page of a new segment that is not whole, or cannot be read back.
    Undo,
}

/// The next step of writing a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Stage {
    /// Its content is needed.
    Content,
    Body,
    Tail,
    Check,
}

/// What the job that was handed out is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Pending {
    None,
    /// The step of the task.
    Step,
    /// Erases the next unit of the segment that is written.
    Erase,
    /// The same, in the segment after it.
    EraseNext,
    /// Erases a unit that has an old key.
    Scrub,
}

/// What [`Log::next`] asks for.
#[derive(Debug)]
pub(crate) enum Next {
    Job(Job),
    /// The content of this page of the record: then [`Log::put`].
    Content(u16),
    Idle,
}

/// What a job has led to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    Nothing,
    /// The newest records are known.
    Found,
    /// Something could not be read; reading is repeated. `was_loading`: this ended the loading of a record.
    Unreadable {
        was_loading: bool,
    },
    /// A page of the record that is loaded was read; its payload has this length.
    Loaded {
        len: u8,
        is_first: bool,
        is_last: bool,
    },
    /// The record is complete.
    Written,
    /// The record could not be written. `is_doubtful`: after a restart, it may be found nevertheless.
    Failed {
        is_doubtful: bool,
    },
    /// The newest record of this kind, which was whole, cannot be read any more: it is lost.
    Lost(u8),
}

/// The log. All zero bits while no storage is attached.
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Log {
    region: Region,
    task: Task,
    stage: Stage,
    pending: Pending,
    /// The segment with the live records, and the one that is written: the same one, or the next.
    open: Segment,
    write: Segment,
    /// The greatest number of a segment. No number is used twice.
    newest: u32,
    /// Whether records of unknown kinds are lost that may be newer than all others.
    has_lost_all: bool,
    /// The newest segment with a whole copy: all there is if no segment is open.
    copied: Segment,
    /// Whether the page did not match its checksums, and is read again.
    is_read_twice: bool,
    /// Whether the next record begins a segment.
    switch: Switch,
    /// The page that is examined, counted from the start of the region or of the open segment.
    page: u32,
    entries: [Entry; ENTRIES],
    /// The record that is read, or copied, or written.
    record: Record,
    /// While a segment is begun: the new record, and the record's checksum at the source of a copy.
    new: Record,
    source: u32,
    /// The entry that is copied next, or loaded; [`NO_ENTRY`] if none is.
    entry: u8,
    /// The number of pages that could not be read, and of attempts to read them.
    unreadable: u32,
    attempts: u8,
    retry_at: Instant,
    /// Whether the region has other data, a log, and a log of another version.
    has_other_data: bool,
    has_log: bool,
    has_foreign: bool,
    /// Whether something was written since the start.
    has_written: bool,
    /// Whether the new record replaces a key: what is older is erased.
    is_secret: bool,
    /// The number of pages of the largest record.
    largest: u16,
    /// The first pages of the next segment that are erased.
    next_erased: u16,
    /// The number of units, from the start of the open segment on, that may have an old key. Those that the segment does
    /// not use are erased.
    scrub: u32,
    /// The number of pages that are not blank, outside of the open segment once that is read; and whether those may have an
    /// old key.
    used: u32,
    has_old_secret: bool,
    /// Until then, nothing is erased ahead.
    rest_until: Instant,
    /// After a failure, nothing is erased because of an old key until then.
    scrub_from: Instant,
}

impl Log {
    pub(crate) const NEW: Self = Self {
        region: Region::NONE,
        task: Task::Detached,
        stage: Stage::Content,
        pending: Pending::None,
        open: Segment::NONE,
        write: Segment::NONE,
        newest: 0,
        has_lost_all: false,
        copied: Segment::NONE,
        is_read_twice: false,
        switch: Switch::IfFull,
        page: 0,
        entries: [Entry::FREE; ENTRIES],
        record: Record::NONE,
        new: Record::NONE,
        source: 0,
        entry: 0,
        unreadable: 0,
        attempts: 0,
        retry_at: Instant::ZERO,
        has_other_data: false,
        has_log: false,
        has_foreign: false,
        has_written: false,
        is_secret: false,
        largest: 0,
        next_erased: 0,
        scrub: 0,
        used: 0,
        has_old_secret: false,
        rest_until: Instant::ZERO,
        scrub_from: Instant::ZERO,
    };

    /// Begins to read the log in this region. `largest` is the length of the longest record in pages.
    pub(crate) fn attach(&mut self, region: Region, largest: u16) {
        (self.region, self.largest) = (region, largest);
        (self.pending, self.attempts, self.retry_at) = (Pending::None, 0, Instant::ZERO);
        (self.has_written, self.is_secret, self.scrub_from) = (false, false, Instant::ZERO);
        if region.segment > 0 {
            self.scan();
        } else {
            // Nothing is stored, and there is no room for anything.
            self.task = Task::Idle;
        }
    }

    /// Starts reading from the beginning.
    fn scan(&mut self) {
        self.task = Task::Find;
        (self.open, self.write) = (Segment::NONE, Segment::NONE);
        (self.newest, self.has_lost_all, self.page, self.unreadable) = (0, false, 0, 0);
        self.entries = [Entry::FREE; ENTRIES];
        (self.scrub, self.used, self.has_old_secret) = (0, 0, false);
        (self.copied, self.switch, self.next_erased) = (Segment::NONE, Switch::IfFull, 0);
        (self.has_other_data, self.has_log, self.has_foreign) = (false, false, false);
    }

    /// Whether nothing is in progress, and the log can be read and written.
    pub(crate) fn is_idle(&self) -> bool {
        self.task == Task::Idle
    }

    /// Whether the newest records are not known yet, and will be without waiting.
    pub(crate) const fn is_starting(&self) -> bool {
        matches!(self.task, Task::Find | Task::Examine | Task::Replay)
    }

    /// Whether a record is being loaded.
    pub(crate) fn is_loading(&self) -> bool {
        self.task == Task::Load
    }

    /// Whether something could not be read, and reading will be repeated.
    pub(crate) fn is_waiting(&self) -> bool {
        self.task == Task::Waiting
    }

    /// Whether a page was written in part, or is not checked yet.
    pub(crate) fn is_within_page(&self) -> bool {
        self.task == Task::Append && self.stage != Stage::Content
    }

    /// Whether the region has a log of another version.
    pub(crate) fn is_foreign(&self) -> bool {
        self.task == Task::Foreign
    }

    /// Whether the region has data, but no log.
    pub(crate) const fn has_other_data(&self) -> bool {
        self.has_other_data
    }

    /// Whether a job has no result yet.
    pub(crate) fn is_busy(&self) -> bool {
        self.pending != Pending::None
    }

    /// Returns the kind of the record that is being written; 0 if none is. It cannot be [abandoned](Self::abandon) once
    /// its last bytes are written.
    pub(crate) fn writing(&self) -> u8 {
        if self.task == Task::Append { self.new.kind } else { 0 }
    }

    /// Returns the newest record of a kind, and whether a newer one was lost.
    pub(crate) fn find(&self, kind: u8) -> Entry {
        let of = |kind| self.entries.iter().find(|entry| entry.kind == kind).copied();
        of(kind).unwrap_or(Entry { is_damaged: of(ANY_KIND).is_some(), ..Entry::FREE })
    }

    /// Returns the index of a kind's entry, or of a free one.
    #[inline(never)]
    fn slot(&self, kind: u8) -> Option<usize> {
        let of = |kind| self.entries.iter().position(|entry| entry.kind == kind);
        of(kind).or_else(|| of(0))
    }

    /// Begins to load the newest record of a kind. Returns false if there is none.
    pub(crate) fn load(&mut self, kind: u8) -> bool {
        let Some(index) = self.entries.iter().position(|entry| entry.kind == kind && entry.pages > 0) else {
            return false;
        };
        (self.task, self.record) = (Task::Load, Record::of(kind));
        self.entry = u8::try_from(index).unwrap_or(0);
        true
    }

    /// Ends loading, after the last page or before.
    pub(crate) fn end_load(&mut self) {
        if self.is_loading() {
            self.task = Task::Idle;
        }
    }

    /// Begins to write a record of a kind, of at most this many pages. With `is_secret`, everything older is erased once
    /// it is complete. Returns false if there is no room for it.
    pub(crate) fn begin(&mut self, kind: u8, schema: u16, pages: u16, is_secret: bool) -> bool {
        let others = self.entries.iter().filter(|entry| entry.kind != 0 && entry.kind != kind);
        let needed = others.fold(u32::from(pages), |sum, entry| {
            sum.saturating_add(entry.pages.into()).saturating_add(entry.is_damaged.into())
        });
        let unknown = self.entries.iter().position(|entry| entry.kind == ANY_KIND);
        if let Some(place) = unknown.and_then(|index| self.entries.get_mut(index))
            && needed == u32::from(self.region.segment).saturating_add(1)
        {
            // Storing again is worth more than the report of an unknown loss.
            *place = Entry::FREE;
        } else if needed > self.region.segment.into() {
            return false;
        }
        if self.slot(kind).is_none() {
            return false;
        }
        self.new = Record { kind, schema, ..Record::NONE };
        self.is_secret = is_secret;
        let room = self.region.segment.saturating_sub(self.write.head);
        if is_secret || self.switch != Switch::IfFull || self.open.number == 0 || pages > room {
            self.newest = self.newest.wrapping_add(1);
            let first = if self.open.number == 0 { 0 } else { self.region.next(self.open.first) };
            self.write = Segment { number: self.newest, first, erased: self.next_erased, ..Segment::NONE };
            self.next_erased = 0;
            (self.entry, self.record) = (0, Record::NONE);
        } else {
            (self.entry, self.record) = (NO_ENTRY, self.new);
        }
        self.attempts = 0;
        (self.task, self.stage) = (Task::Append, Stage::Content);
        true
    }

    /// Gives up the record that is being written: it does not count. Does nothing while a page that was written is still
    /// to be checked, because it may be the last one.
    pub(crate) fn abandon(&mut self) {
        if self.task == Task::Append && self.stage != Stage::Check {
            self.stop(self.stage == Stage::Tail);
        }
    }

    /// Whether everything older than the segment that is begun is to be erased.
    const fn must_scrub(&self) -> bool {
        self.is_secret || self.scrub > 0
    }

    /// Ends writing without a record. `is_dirty`: the next page may be written in part.
    #[inline(never)]
    fn stop(&mut self, is_dirty: bool) {
        self.task = Task::Idle;
        self.write.head = self.write.head.saturating_add(is_dirty.into());
        if self.write.number == self.open.number {
            self.open = self.write;
        } else {
            self.write = self.open;
        }
    }

    /// Completes the page that [`Next::Content`] asked for, with `len` bytes of payload in place.
    pub(crate) fn put(&mut self, page: &mut Page, len: u8, is_last: bool) {
        let is_secret = self.write.number != self.open.number && self.must_scrub();
        self.seal(page, len, if is_last { flag::LAST } else { 0 } | if is_secret { flag::SECRET } else { 0 });
    }

    fn seal(&mut self, page: &mut Page, len: u8, flags: u8) {
        let Segment { number: segment, head: position, count, before, .. } = self.write;
        let Record { kind, schema, index, crc: previous } = self.record;
        page.seal(&Footer { segment, position, index, schema, kind, flags, len, before, count, previous });
        self.stage = Stage::Body;
    }

    /// Returns the next job, or what is needed first. Writes and erases only if `may_write` is set.
    #[inline(never)]
    pub(crate) fn next(&mut self, now: Instant, may_write: bool, page: &mut Page) -> Next {
        if self.is_busy() || now < self.retry_at {
            return Next::Idle;
        }
        match self.task {
            Task::Waiting => {
                self.scan();
                self.read_tail()
            }
            Task::Find => self.read_tail(),
            Task::Examine => self.read(0, self.page),
            Task::Replay => self.read(self.open.first, self.page),
            Task::Load => {
                let at = self.entries.get(usize::from(self.entry)).map_or(0, |entry| entry.at);
                self.read(self.open.first, at.wrapping_add(self.record.index).into())
            }
            // The check of a page only reads, and decides whether a record is complete.
            Task::Append if may_write || self.stage == Stage::Check => self.next_of_append(page),
            Task::Idle if may_write => self.erase_ahead(now),
            Task::Undo if may_write => {
                let Segment { first, head, .. } = self.write;
                let unit = u32::from(self.region.end_of_unit(head)).saturating_sub(self.region.unit);
                self.erase(first, unit, Pending::Step)
            }
            Task::Append | Task::Idle | Task::Undo | Task::Detached | Task::Foreign => Next::Idle,
        }
    }

    /// Reads the page at a position, counted from page `first` of the region.
    #[inline(never)]
    fn read(&mut self, first: u32, position: u32) -> Next {
        self.pending = Pending::Step;
        Next::Job(Job::Read { offset: self.region.at(first, position), range: 0..PAGE })
    }

    fn read_tail(&mut self) -> Next {
        self.pending = Pending::Step;
        let offset = self.region.at(0, self.page).wrapping_add(TAIL_AT);
        Next::Job(Job::Read { offset, range: PAGE - TAIL..PAGE })
    }

    /// Erases the unit that begins at a position, counted from page `first` of the region.
    #[inline(never)]
    fn erase(&mut self, first: u32, position: u32, pending: Pending) -> Next {
        self.pending = pending;
        Next::Job(Job::Erase { offset: self.region.at(first, position), len: self.region.unit.wrapping_mul(PAGE_LEN) })
    }

    /// Erases a unit that has an old key; or else the next unit, if the longest record would need it.
    fn erase_ahead(&mut self, now: Instant) -> Next {
        let Segment { first, head, erased, .. } = self.write;
        let end = self.region.segment;
        let next = self.region.next(first);
        // At most one unit ahead, and late: it is erased again after a restart, which wears it more than others.
        let ahead = self.largest.min(u16::try_from(self.region.unit.div_ceil(4)).unwrap_or(u16::MAX));
        let needed = if self.has_written && now >= self.rest_until { ahead } else { 0 };
        // From the last unit on, down to those that the open segment uses.
        let scrubbed = self.scrub.saturating_sub(1).saturating_mul(self.region.unit);
        if scrubbed < erased.into() {
            self.scrub = 0;
        }
        if self.scrub > 0 && now >= self.scrub_from {
            self.erase(first, scrubbed, Pending::Scrub)
        } else if erased < end && erased.saturating_sub(head) < needed {
            self.erase(first, erased.into(), Pending::Erase)
        } else if end.saturating_sub(head) < needed && self.next_erased == 0 {
            self.erase(next, 0, Pending::EraseNext)
        } else {
            Next::Idle
        }
    }

    #[inline(never)]
    fn next_of_append(&mut self, page: &mut Page) -> Next {
        if self.stage == Stage::Content {
            match self.source() {
                Source::Vehicle => return Next::Content(self.record.index),
                Source::Copy(position) => return self.read(self.open.first, position.into()),
                Source::Lost => {
                    self.record = Record { index: 0, crc: 0, ..self.record };
                    self.seal(page, 0, flag::LAST | flag::COPY | flag::LOST);
                }
            }
        }
        let Segment { first, head, erased, .. } = self.write;
        if self.stage == Stage::Body && head >= erased {
            return self.erase(first, erased.into(), Pending::Erase);
        }
        let split = if is_last(page) { PAGE.saturating_sub(self.region.tail.into()) } else { 0 };
        let range = match self.stage {
            Stage::Body if split > 0 => 0..split,
            Stage::Tail => split..PAGE,
            _ => 0..PAGE,
        };
        self.pending = Pending::Step;
        let offset = self.region.at(first, head.into());
        let offset = offset.wrapping_add(u32::try_from(range.start).unwrap_or(0));
        Next::Job(if self.stage == Stage::Check { Job::Read { offset, range } } else { Job::Write { offset, range } })
    }

    /// Returns where the content of the next page comes from: while a segment is begun, first from the other records.
    fn source(&mut self) -> Source {
        while let Some(&Entry { kind, is_damaged, schema, at, pages, .. }) = self.entries.get(usize::from(self.entry)) {
            if kind != 0 && kind != self.new.kind {
                if self.record.kind != kind {
                    (self.record, self.source) = (Record { kind, schema, ..Record::NONE }, 0);
                }
                if self.record.index < pages {
                    return Source::Copy(at.wrapping_add(self.record.index));
                }
                if is_damaged {
                    return Source::Lost;
                }
            }
            self.end_copy();
        }
        if self.record.kind != self.new.kind {
            self.record = self.new;
        }
        Source::Vehicle
    }

    /// Proceeds to the next entry to be copied.
    fn end_copy(&mut self) {
        (self.entry, self.record) = (self.entry.wrapping_add(1), Record::NONE);
    }

    /// Takes the result of the job.
    #[inline(never)]
    pub(crate) fn done(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        match core::mem::replace(&mut self.pending, Pending::None) {
            Pending::None => Event::Nothing,
            Pending::Step => self.step_done(now, is_done, page),
            Pending::Erase if is_done => {
                self.write.erased = self.region.end_of_unit(self.write.erased);
                if self.write.number == self.open.number {
                    self.open.erased = self.write.erased;
                }
                Event::Nothing
            }
            Pending::Erase if self.task == Task::Append => {
                if self.write.number == self.open.number {
                    // Another attempt leaves this unit out.
                    let end = self.region.end_of_unit(self.write.erased);
                    (self.write.head, self.write.erased) = (end, end);
                }
                self.failed(false)
            }
            Pending::EraseNext if is_done => {
                self.next_erased = self.region.end_of_unit(0);
                Event::Nothing
            }
            Pending::Scrub if is_done => {
                self.scrub = self.scrub.saturating_sub(1);
                Event::Nothing
            }
            Pending::Scrub => {
                self.scrub_from = now.after(LONG_PAUSE);
                Event::Nothing
            }
            Pending::Erase | Pending::EraseNext => {
                // It is not repeated before the unit is needed.
                self.has_written = false;
                Event::Nothing
            }
        }
    }

    fn step_done(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        match self.task {
            Task::Find | Task::Examine => {
                self.found(is_done, page);
                if self.task == Task::Examine {
                    return Event::Nothing;
                }
                self.page = self.page.saturating_add(1);
                if self.page < self.region.pages { Event::Nothing } else { self.end_of_find(now) }
            }
            Task::Replay => {
                let is_bad = is_done && matches!(page.open(), Content::Bad(_));
                if is_bad && !core::mem::replace(&mut self.is_read_twice, true) {
                    return Event::Nothing;
                }
                self.is_read_twice = false;
                self.replay(is_done, page);
                self.page = self.page.saturating_add(1);
                if self.page < self.region.segment.into() { Event::Nothing } else { self.end_of_scan(now) }
            }
            Task::Load => match if is_done { page.open() } else { Content::Blank } {
                Content::Whole(footer, crc) if self.record.continues(&footer) && footer.segment == self.open.number => {
                    self.record.advance(crc);
                    Event::Loaded { len: footer.len, is_first: footer.index == 0, is_last: footer.is_last() }
                }
                _ => self.wait(now, PAUSE),
            },
            Task::Append => self.append_done(now, is_done, page),
            Task::Undo if is_done => self.failed(true),
            Task::Undo if self.attempts < 2 * ATTEMPTS => {
                self.attempts = self.attempts.saturating_add(1);
                self.retry_at = now.after(LONG_PAUSE);
                Event::Nothing
            }
            // The next segment has a greater number, so that it counts whatever becomes of this one.
            Task::Undo => {
                self.switch = Switch::Always;
                self.failed(true)
            }
            Task::Detached | Task::Waiting | Task::Foreign | Task::Idle => Event::Nothing,
        }
    }

    /// Looks for the open segment: the newest one with the last page of a record that is no copy.
    fn found(&mut self, is_done: bool, page: &Page) {
        let is_examined = core::mem::replace(&mut self.task, Task::Find) == Task::Examine;
        if !is_done {
            self.unreadable = self.unreadable.saturating_add(1);
            return;
        }
        let tail = page.bytes().last_chunk::<TAIL>().copied().unwrap_or_default();
        if !is_examined {
            self.used = self.used.saturating_add(is_used(&tail).into());
        }
        let (footer, is_ours) = match Footer::read(&tail) {
            Some(read) => read,
            None if !is_used(&tail) || tail == [0; TAIL] => return,
            None if !is_examined => {
                self.task = Task::Examine;
                return;
            }
            None => match page.open() {
                Content::Bad(Some(footer)) => (footer, true),
                _ => {
                    self.has_other_data |= !page.is_begun();
                    return;
                }
            },
        };
        self.has_log = true;
        if !is_ours {
            self.has_foreign = true;
            return;
        }
        let Footer { segment, position, .. } = footer;
        if is_newer(segment, self.newest) {
            self.newest = segment;
        }
        if !footer.is_last() || position >= self.region.segment {
            return;
        }
        let position = u32::from(position);
        let first = self.page.checked_sub(position);
        let first = first.unwrap_or_else(|| self.page.wrapping_add(self.region.pages).wrapping_sub(position));
        let place = if footer.is_copy() { &mut self.copied } else { &mut self.open };
        if is_newer(segment, place.number) {
            *place = Segment { number: segment, first, ..Segment::NONE };
        }
    }

    fn end_of_find(&mut self, now: Instant) -> Event {
        (self.page, self.record) = (0, Record::NONE);
        if self.open.number == 0 && self.copied.number != 0 {
            // The record that opened the segment is lost, and so is the segment before.
            (self.open, self.has_lost_all) = (self.copied, true);
        }
        self.write = self.open;
        self.has_other_data &= !self.has_log;
        if self.has_foreign {
            self.task = Task::Foreign;
            return Event::Found;
        }
        // A power cut leaves no more than one unit that cannot be read, several cuts a few pages more. What is in others may be
        // read later.
        let is_outage = self.unreadable > self.region.unit.max(FEW);
        let attempts = self.attempts.saturating_add(1);
        if self.unreadable >= self.region.pages || is_outage && attempts < LONG_ATTEMPTS {
            return self.wait(now, if attempts < ATTEMPTS { PAUSE } else { LONG_PAUSE });
        }
        self.has_lost_all |= is_outage;
        if self.open.number == 0 {
            if self.unreadable > 0 && self.attempts.saturating_add(1) >= ATTEMPTS {
                self.all_damaged();
            }
            return self.end_of_scan(now);
        }
        self.task = Task::Replay;
        Event::Nothing
    }

    /// Repeats reading from the start after this time.
    fn wait(&mut self, now: Instant, time: Duration) -> Event {
        let was_loading = self.is_loading();
        self.task = Task::Waiting;
        self.attempts = self.attempts.saturating_add(1);
        self.retry_at = now.after(time);
        Event::Unreadable { was_loading }
    }

    fn end_of_scan(&mut self, now: Instant) -> Event {
        if self.unreadable > 0 && self.attempts.saturating_add(1) < ATTEMPTS {
            return self.wait(now, PAUSE);
        }
        self.switch = if self.has_lost_all {
            self.all_damaged();
            // A newer segment may be read another time, and must then be older than what is written now.
            self.newest = self.newest.wrapping_add(1);
            Switch::Always
        } else if self.unreadable > 0 {
            // Pages that a cut has made unreadable must not add up.
            Switch::Once
        } else {
            Switch::IfFull
        };
        // A page is left out: a write that was cut off may have disturbed it, even if it reads as erased.
        let Segment { head, erased, .. } = self.write;
        self.write.head = head.saturating_add(1).min(erased);
        self.open = self.write;
        (self.task, self.attempts) = (Task::Idle, 0);
        if self.has_old_secret && self.used > 0 {
            self.scrub = self.region.units();
        }
        Event::Found
    }

    /// Takes the next page of the open segment.
    #[inline(never)]
    fn replay(&mut self, is_done: bool, page: &Page) {
        let position = u16::try_from(self.page).unwrap_or(u16::MAX);
        let content = if is_done { page.open() } else { Content::Bad(None) };
        self.unreadable = self.unreadable.saturating_add((!is_done).into());
        let is_here = |footer: &Footer| footer.segment == self.open.number && footer.position == position;
        let record = core::mem::replace(&mut self.record, Record::NONE);
        let is_own = match content {
            Content::Whole(footer, _) | Content::Bad(Some(footer)) => is_here(&footer),
            Content::Bad(None) => position < self.write.erased,
            Content::Blank => false,
        };
        if is_own && is_done && page.bytes().last_chunk().is_some_and(is_used) {
            self.used = self.used.saturating_sub(1);
        }
        match content {
            Content::Whole(footer, crc) if is_here(&footer) => {
                (self.write.head, self.write.erased) = (position.saturating_add(1), self.region.end_of_unit(position));
                if footer.index == 0 {
                    self.check_count(&footer);
                    self.record = Record { kind: footer.kind, schema: footer.schema, index: 1, crc };
                } else if record.continues(&footer) {
                    self.record = record;
                    self.record.advance(crc);
                } else if footer.is_last() {
                    self.damaged(&footer);
                }
                if footer.is_last() && self.record.index > 0 {
                    self.complete(&footer);
                }
            }
            Content::Bad(Some(footer)) if is_here(&footer) => {
                // Its unit was erased for it. It must stay until a new record replaces it: nothing else shows the damage.
                (self.write.head, self.write.erased) = (position.saturating_add(1), self.region.end_of_unit(position));
                if footer.is_last() {
                    self.damaged(&footer);
                }
            }
            // A newer segment begins where this one did, and the record that opened it is lost.
            Content::Whole(footer, _) if self.write.head == 0 && is_newer(footer.segment, self.open.number) => {
                self.has_lost_all = true;
            }
            Content::Bad(_) if position < self.write.erased => self.write.head = position.saturating_add(1),
            // A page of another segment, in a unit that was not erased as a whole: units were smaller then.
            Content::Whole(..) if position < self.write.erased => self.write.head = position.saturating_add(1),
            // A page of another segment, from before its unit was erased.
            Content::Whole(..) | Content::Bad(_) | Content::Blank => {}
        }
    }

    /// Compares the number of records so far with the one that a page of the next record states.
    fn check_count(&mut self, footer: &Footer) {
        let lost = footer.count.wrapping_sub(self.write.count).cast_signed();
        if lost > 0 {
            self.mark_damaged(footer.before);
        }
        if lost > 1 {
            self.all_damaged();
        }
        self.write.count = footer.count;
    }

    /// Records were lost, and nobody knows of which kinds.
    fn all_damaged(&mut self) {
        self.mark_damaged(ANY_KIND);
        for entry in &mut self.entries {
            entry.is_damaged |= entry.kind != 0;
        }
    }

    /// Takes the last page of a record that was complete, and is not whole.
    fn damaged(&mut self, footer: &Footer) {
        self.check_count(footer);
        self.mark_damaged(footer.kind);
        (self.write.count, self.write.before) = (footer.count.wrapping_add(1), footer.kind);
    }

    #[inline(never)]
    fn mark_damaged(&mut self, kind: u8) {
        if let Some(entry) = self.slot(kind).and_then(|index| self.entries.get_mut(index)) {
            (entry.kind, entry.is_damaged) = (kind, true);
        }
    }

    /// Takes the last page of a whole record.
    fn complete(&mut self, footer: &Footer) {
        let Record { kind, schema, index: pages, .. } = core::mem::replace(&mut self.record, Record::NONE);
        (self.write.count, self.write.before) = (self.write.count.wrapping_add(1), kind);
        if footer.flags & flag::LOST != 0 {
            return self.mark_damaged(kind);
        }
        self.has_old_secret |= footer.flags & flag::SECRET != 0;
        let at = footer.position.saturating_add(1).saturating_sub(pages);
        self.set_entry(Entry { kind, is_damaged: false, schema, at, pages, moved: at });
    }

    fn set_entry(&mut self, entry: Entry) {
        if let Some(place) = self.slot(entry.kind).and_then(|index| self.entries.get_mut(index)) {
            *place = entry;
        }
    }

    fn append_done(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        match self.stage {
            Stage::Content => return self.copy_read(now, is_done, page),
            Stage::Body if is_last(page) && usize::from(self.region.tail) < PAGE => {
                if !is_done {
                    return self.failed(true);
                }
                self.stage = Stage::Tail;
            }
            // What a driver says of the last write does not count: after a restart, what can be read does.
            Stage::Body if !is_done && !is_last(page) => return self.failed(true),
            Stage::Body | Stage::Tail => self.stage = Stage::Check,
            Stage::Check if !is_done && self.attempts < ATTEMPTS => {
                self.attempts = self.attempts.saturating_add(1);
                self.retry_at = now.after(PAUSE);
            }
            Stage::Check => {
                let Segment { number: segment, head: position, .. } = self.write;
                match if is_done { page.open() } else { Content::Blank } {
                    Content::Whole(footer, crc) if (footer.segment, footer.position) == (segment, position) => {
                        return self.written(now, &footer, crc);
                    }
                    _ if self.write.number == self.open.number => {
                        self.failed(true);
                        return Event::Failed { is_doubtful: true };
                    }
                    // It might be whole after a restart, or look like damage, and count for the segment that it opens.
                    _ => self.task = Task::Undo,
                }
            }
        }
        Event::Nothing
    }

    /// Takes a page that is to be copied.
    fn copy_read(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        let Record { kind, index, .. } = self.record;
        let is_next = |footer: &Footer| {
            (footer.segment, footer.kind, footer.index, footer.previous) == (self.open.number, kind, index, self.source)
        };
        match if is_done { page.open() } else { Content::Blank } {
            Content::Whole(footer, crc) if is_next(&footer) => {
                (self.source, self.attempts) = (crc, 0);
                self.seal(page, footer.len, (footer.flags & flag::LAST) | flag::COPY);
                Event::Nothing
            }
            _ if self.attempts < ATTEMPTS => {
                self.attempts = self.attempts.saturating_add(1);
                self.retry_at = now.after(PAUSE);
                Event::Nothing
            }
            _ => {
                // It was whole, and is lost. The new segment will say so.
                self.attempts = 0;
                if let Some(entry) = self.entries.get_mut(usize::from(self.entry)) {
                    (entry.pages, entry.is_damaged) = (0, true);
                }
                Event::Lost(kind)
            }
        }
    }

    /// Takes a page that was written and is whole.
    fn written(&mut self, now: Instant, footer: &Footer, crc: u32) -> Event {
        self.write.head = self.write.head.saturating_add(1);
        self.record.advance(crc);
        (self.stage, self.attempts) = (Stage::Content, 0);
        if !footer.is_last() {
            return Event::Nothing;
        }
        let Record { kind, schema, index: pages, .. } = self.record;
        let at = self.write.head.saturating_sub(pages);
        (self.write.count, self.write.before) = (self.write.count.wrapping_add(1), kind);
        if footer.flags & flag::LOST != 0 {
            self.end_copy();
            return Event::Nothing;
        }
        if let Some(entry) = self.entries.get_mut(usize::from(self.entry)) {
            entry.moved = at;
            return Event::Nothing;
        }
        if self.write.number != self.open.number {
            self.switch = Switch::IfFull;
            for entry in &mut self.entries {
                entry.at = entry.moved;
            }
            if self.must_scrub() {
                self.scrub = self.region.units();
            }
        }
        self.set_entry(Entry { kind, is_damaged: false, schema, at, pages, moved: at });
        (self.open, self.task) = (self.write, Task::Idle);
        (self.has_written, self.rest_until) = (true, now.after(GRACE));
        Event::Written
    }

    /// Ends writing: it failed.
    fn failed(&mut self, is_dirty: bool) -> Event {
        if self.switch == Switch::Once && self.write.number != self.open.number {
            self.switch = Switch::IfFull;
        }
        self.stop(is_dirty);
        Event::Failed { is_doubtful: false }
    }
}

/// Where the content of a page comes from.
enum Source {
    /// It is new.
    Vehicle,
    /// The page at this position of the open segment.
    Copy(u16),
    /// There is none: it says that a record is lost.
    Lost,
}

/// Returns whether the end of a page is not blank.
#[inline(never)]
fn is_used(tail: &[u8; TAIL]) -> bool {
    *tail != [0xFF; TAIL]
}

/// Returns whether segment `a` is newer than segment `b`.
fn is_newer(a: u32, b: u32) -> bool {
    a.wrapping_sub(b).cast_signed() > 0
}

/// Returns whether a page that is to be written is the last one of its record.
#[inline(never)]
fn is_last(page: &Page) -> bool {
    page.bytes().last_chunk().and_then(Footer::read).is_some_and(|(footer, _)| footer.is_last())
}
