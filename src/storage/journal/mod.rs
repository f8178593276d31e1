//! The journal: records of kinds, in the two halves of a region of erase units (D-5, G-18, SEC-11, SEC-12, SEC-15).
//!
//! `format.md` in this folder documents the format, and says why no cut of the power loses a record. The journal calls no
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

mod append;
mod record;
mod scan;

use super::job::Job;
use super::page::{Content, Footer, PAGE, Page, TAIL, VERSION, flag};
use super::region::{PAGE_LEN, Region};
use crate::time::{Duration, Instant};
pub(crate) use record::Entry;
use record::{Record, Segment};

/// The number of kinds of records that a journal keeps.
pub(crate) const ENTRIES: usize = 16;
/// Stands for no entry.
const NO_ENTRY: u8 = u8::MAX;

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
    /// The region has a journal of another version: it is neither read nor written.
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

/// What [`Journal::next`] asks for.
#[derive(Debug)]
pub(crate) enum Next {
    Job(Job),
    /// The content of this page of the record: then [`Journal::put`].
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

/// The journal. All zero bits while no storage is attached.
// Small fields are first: shorter instructions reach them there.
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(C)]
pub(crate) struct Journal {
    task: Task,
    stage: Stage,
    pending: Pending,
    /// Whether the next record begins a segment.
    switch: Switch,
    /// The entry that is copied next, or loaded; [`NO_ENTRY`] if none is.
    entry: u8,
    /// The number of attempts to read, or to check what was written.
    attempts: u8,
    /// Whether records of unknown kinds are lost that may be newer than all others.
    has_lost_all: bool,
    /// Whether the page did not match its checksums, and is read again.
    is_read_twice: bool,
    /// Whether the region has other data, a journal, and a journal of another version.
    has_other_data: bool,
    has_log: bool,
    has_foreign: bool,
    /// Whether something was written since the start.
    has_written: bool,
    /// Whether the new record replaces a key: what is older is erased.
    is_secret: bool,
    /// Whether pages outside of the open segment may have an old key.
    has_old_secret: bool,
    /// Whether the last page of the new record was written, and has read back as something else: in the open segment, where it may
    /// be found after a restart nevertheless, and in a new one.
    is_doubtful: bool,
    is_worn: bool,
    /// Whether a unit that did not take a page was left out, and no page was written since: storage that takes nothing must not be
    /// erased over and over.
    has_left_out: bool,
    /// The number of attempts to erase the unit that has an old key.
    scrubs: u8,
    /// The number of pages of the new record, at most.
    new_pages: u16,
    /// The next segment begins with this page: those before it were not written in an attempt that failed.
    skipped: u16,
    /// The number of pages of the largest record.
    largest: u16,
    /// The first pages of the next segment that are erased.
    next_erased: u16,
    region: Region,
    /// The segment with the live records, and the one that is written: the same one, or the next.
    open: Segment,
    write: Segment,
    /// The record that is read, or copied, or written.
    record: Record,
    /// The page that is examined, counted from the start of the region or of the open segment.
    page: u32,
    /// The greatest number of a segment. No number is used twice.
    newest: u32,
    /// The number of pages that could not be read.
    unreadable: u32,
    /// The number of units, from the start of the open segment on, that may have an old key. Those that the segment does
    /// not use are erased.
    scrub: u32,
    /// The number of pages that are not blank, outside of the open segment once that is read.
    used: u32,
    /// While a segment is begun: the new record, and the record's checksum at the source of a copy.
    new: Record,
    source: u32,
    /// The newest segment with a whole copy: all there is if no segment is open.
    copied: Segment,
    retry_at: Instant,
    /// Until then, nothing is erased ahead.
    rest_until: Instant,
    /// After a failure, nothing is erased because of an old key until then.
    scrub_from: Instant,
    entries: [Entry; ENTRIES],
}

impl Journal {
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
        is_doubtful: false,
        is_worn: false,
        has_left_out: false,
        scrubs: 0,
        new_pages: 0,
        skipped: 0,
        rest_until: Instant::ZERO,
        scrub_from: Instant::ZERO,
    };

    /// Begins to read the journal in this region. `largest` is the length of the longest record in pages.
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

    /// Whether nothing is in progress, and the journal can be read and written.
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

    /// Whether the region has a journal of another version.
    pub(crate) fn is_foreign(&self) -> bool {
        self.task == Task::Foreign
    }

    /// Whether the region has data, but no journal.
    pub(crate) const fn has_other_data(&self) -> bool {
        self.has_other_data
    }

    /// Whether a job has no result yet.
    pub(crate) fn is_busy(&self) -> bool {
        self.pending != Pending::None
    }

    /// Whether a record is being written. It cannot be [abandoned](Self::abandon) once its last bytes are written.
    pub(crate) fn is_writing(&self) -> bool {
        self.task == Task::Append
    }

    /// Returns the newest record of a kind, and whether a newer one was lost.
    pub(crate) fn find(&self, kind: u8) -> &Entry {
        let index = self.index_of(kind).or_else(|| self.index_of(ANY_KIND));
        index.and_then(|index| self.entries.get(index)).unwrap_or(&Entry::FREE)
    }

    /// Returns the index of a kind's entry.
    #[inline(never)]
    fn index_of(&self, kind: u8) -> Option<usize> {
        self.entries.iter().position(|entry| entry.kind == kind)
    }

    /// Returns the index of a kind's entry, or of a free one.
    #[inline(never)]
    fn slot(&self, kind: u8) -> Option<usize> {
        self.index_of(kind).or_else(|| self.index_of(0))
    }

    /// Begins to load the newest record of a kind, which was [found](Self::find).
    pub(crate) fn load(&mut self, kind: u8) {
        if let Some(index) = self.index_of(kind) {
            (self.task, self.record) = (Task::Load, Record::of(kind));
            self.entry = u8::try_from(index).unwrap_or(0);
        }
    }

    /// Ends loading, after the last page or before.
    pub(crate) fn end_load(&mut self) {
        if self.is_loading() {
            self.task = Task::Idle;
        }
    }

    /// Whether to erase everything that is older than the new segment.
    const fn must_scrub(&self) -> bool {
        self.is_secret || self.scrub > 0
    }

    /// Ends writing without a record. `is_dirty`: the next page may be written in part.
    #[inline(never)]
    fn stop(&mut self, is_dirty: bool) {
        self.task = Task::Idle;
        self.write.head = self.write.head.wrapping_add(is_dirty.into());
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
        let flags = flags | const { VERSION << 4 };
        page.seal(&Footer { segment, position, index, schema, kind, flags, len, before, count, previous, crc: 0 });
        self.stage = Stage::Body;
    }

    /// Returns the next job, or what is needed first. Writes and erases only if `may_write` is set.
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
                let unit = u32::from(self.region.end_of_unit(head)).wrapping_sub(self.region.unit);
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

    #[inline(never)]
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
        let scrubbed = self.scrub.wrapping_sub(1).wrapping_mul(self.region.unit);
        if scrubbed < erased.into() {
            self.scrub = 0;
        }
        if self.scrub > 0 && now >= self.scrub_from {
            self.erase(first, scrubbed, Pending::Scrub)
        } else if erased < end && erased.wrapping_sub(head) < needed {
            self.erase(first, erased.into(), Pending::Erase)
        } else if end.wrapping_sub(head) < needed && self.next_erased == 0 {
            self.erase(next, 0, Pending::EraseNext)
        } else {
            Next::Idle
        }
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
            Pending::Erase if self.task == Task::Append => self.leave_out(),
            Pending::EraseNext if is_done => {
                self.next_erased = self.region.end_of_unit(0);
                Event::Nothing
            }
            // A unit that cannot be erased is given up, so that the others with an old key are erased (X-7).
            Pending::Scrub if is_done || self.scrubs >= ATTEMPTS => {
                (self.scrub, self.scrubs) = (self.scrub.wrapping_sub(1), 0);
                Event::Nothing
            }
            Pending::Scrub => {
                (self.scrub_from, self.scrubs) = (now + LONG_PAUSE, self.scrubs.wrapping_add(1));
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
                self.page = self.page.wrapping_add(1);
                if self.page < self.region.pages { Event::Nothing } else { self.end_of_find(now) }
            }
            Task::Replay => {
                let is_bad = is_done && matches!(page.open(), Content::Bad | Content::Damaged(_));
                if is_bad && !core::mem::replace(&mut self.is_read_twice, true) {
                    return Event::Nothing;
                }
                self.is_read_twice = false;
                self.replay(is_done, page);
                self.page = self.page.wrapping_add(1);
                if self.page < self.region.segment.into() { Event::Nothing } else { self.end_of_scan(now) }
            }
            Task::Load => match if is_done { page.open() } else { Content::Blank } {
                Content::Whole(footer) if self.record.continues(&footer) && footer.segment == self.open.number => {
                    self.record.advance(footer.crc);
                    Event::Loaded { len: footer.len, is_first: footer.index == 0, is_last: footer.is_last() }
                }
                _ => self.wait(now, PAUSE),
            },
            Task::Append => self.append_done(now, is_done, page),
            Task::Undo if is_done && self.is_worn => {
                let Segment { head, .. } = self.write;
                let begin = self.region.end_of_unit(head).wrapping_sub(u16::try_from(self.region.unit).unwrap_or(0));
                if head.wrapping_sub(self.record.index) <= begin {
                    // Only pages of the new record were in it.
                    self.task = Task::Append;
                    return self.not_written();
                }
                // The copies in this unit are erased too, so all are made again behind it.
                self.skipped = self.region.end_of_unit(self.write.head);
                self.begin_segment();
                if self.skipped == 0 || self.has_left_out {
                    return self.failed(false);
                }
                self.has_left_out = true;
                (self.task, self.stage, self.attempts) = (Task::Append, Stage::Content, 0);
                Event::Nothing
            }
            Task::Undo if is_done => self.failed(true),
            Task::Undo if self.attempts < 2 * ATTEMPTS => {
                self.attempts = self.attempts.wrapping_add(1);
                self.retry_at = now + LONG_PAUSE;
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

    /// Repeats reading from the start after this time.
    #[inline(never)]
    fn wait(&mut self, now: Instant, time: Duration) -> Event {
        let was_loading = self.is_loading();
        self.task = Task::Waiting;
        self.attempts = self.attempts.saturating_add(1);
        self.retry_at = now + time;
        Event::Unreadable { was_loading }
    }

    #[inline(never)]
    fn mark_damaged(&mut self, kind: u8) {
        if let Some(entry) = self.slot(kind).and_then(|index| self.entries.get_mut(index)) {
            (entry.kind, entry.is_damaged) = (kind, true);
        }
    }

    fn set_entry(&mut self, entry: Entry) {
        if let Some(place) = self.slot(entry.kind).and_then(|index| self.entries.get_mut(index)) {
            *place = entry;
        }
    }
}

/// Returns whether segment `a` is newer than segment `b`.
fn is_newer(a: u32, b: u32) -> bool {
    a.wrapping_sub(b).cast_signed() > 0
}
