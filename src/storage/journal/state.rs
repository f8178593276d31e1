//! The state of the journal, and the jobs that its parts hand out.

use core::num::{Saturating, Wrapping};

use super::super::job::Job;
use super::super::page::{Footer, PAGE, Page, VERSION};
use super::super::region::{Pages, Region, RegionPages};
use super::record::{Copies, Entries, RecordCursor, Segment, SegmentNumber};
use crate::time::{Duration, Instant};

/// Pages of one erase unit that cannot be read are given up after this many attempts.
pub(super) const ATTEMPTS: Saturating<u8> = Saturating(4);
/// The time between two attempts.
pub(super) const PAUSE: Duration = Duration::from_secs(1);
/// The time between attempts while more pages cannot be read.
pub(super) const LONG_PAUSE: Duration = Duration::from_secs(10);

/// The running task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Task {
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
pub(super) enum Stage {
    /// Its content is needed.
    Content,
    Body,
    Tail,
    Check,
}

/// The purpose of the job that was handed out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// There is no job.
    None,
    /// The next step of the task.
    Step,
    /// Erases the next unit of the segment that is written.
    Erase,
    /// Erases the first unit of the segment after it.
    EraseNext,
    /// Erases a unit that has an old key.
    EraseKey,
}

/// The condition for a record to begin a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NewSegment {
    /// There is no room for it.
    IfFull,
    /// It is the next record. If it fails, this ends.
    Once,
    /// It is the next record, however often it fails: a newer segment may exist that could not be read.
    Always,
}

/// The answer of [`Journal::next`].
#[derive(Debug)]
pub(crate) enum Next {
    Job(Job),
    /// The content of this page of the record is needed: then [`Journal::put`].
    Content(u16),
    Idle,
}

/// The effect of a job.
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
#[repr(C)]
pub(crate) struct Journal {
    pub(super) task: Task,
    pub(super) job: Purpose,
    /// The number of failed attempts to read, or to check a written page.
    pub(super) attempts: Saturating<u8>,
    /// Whether the region has data, but no journal.
    pub(super) has_other_data: bool,
    pub(super) writer: Writer,
    pub(super) ahead: EraseAhead,
    pub(super) region: Region,
    /// The segment with the live records.
    pub(super) open_segment: Segment,
    /// The segment that is written: the open one, or the next.
    pub(super) target: Segment,
    /// The record that is read, copied or written.
    pub(super) cursor: RecordCursor,
    /// The greatest number of a segment. No number is used twice.
    pub(super) newest: SegmentNumber,
    pub(super) scan: Scan,
    pub(super) old_key: OldKey,
    pub(super) retry_at: Instant,
    pub(super) entries: Entries,
}

/// The state of reading the journal from its start.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scan {
    /// The page that is examined, counted from the start of the region or of the open segment.
    pub(super) page: RegionPages,
    /// Whether the page did not match its checksums, and is read again.
    pub(super) is_read_twice: bool,
    /// Whether the region has a journal, and a journal of another version.
    pub(super) has_journal: bool,
    pub(super) has_foreign: bool,
    /// Whether records of unknown kinds are lost that may be newer than all others.
    pub(super) has_lost_all: bool,
    /// Whether pages outside of the open segment may have an old key.
    pub(super) has_old_secret: bool,
    /// The number of pages that could not be read.
    pub(super) unreadable: RegionPages,
    /// The number of pages that are not blank, outside of the open segment once that is read.
    pub(super) used: Saturating<u32>,
    /// The newest segment with a whole copy: all there is if no segment is open.
    pub(super) copied: Segment,
}

/// The state of writing a record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Writer {
    pub(super) stage: Stage,
    pub(super) new_segment: NewSegment,
    /// The copies that precede the record in a new segment.
    pub(super) copies: Copies,
    /// Whether the record replaces a key: everything older is erased.
    pub(super) is_secret: bool,
    /// Whether the last page of the record was written, and has read back as something else in the open segment. It may be found
    /// after a restart nevertheless.
    pub(super) is_doubtful: bool,
    /// The same in a new segment.
    pub(super) is_worn: bool,
    /// Whether a unit that did not take a page was left out, and no page was written since: storage that takes nothing must not be
    /// erased over and over.
    pub(super) has_left_out: bool,
    /// The maximum length of the record.
    pub(super) pages: Pages,
    /// The next segment begins with this page: those before it were not written in an attempt that failed.
    pub(super) skipped: Pages,
    pub(super) new: RecordCursor,
    /// While a record is copied: the checksum of its page before, in the open segment.
    pub(super) copied_crc: u32,
}

/// The state of erasing before a unit is needed.
#[derive(Clone, Copy, Debug)]
pub(super) struct EraseAhead {
    /// Whether something was written since the start.
    pub(super) has_written: bool,
    /// The length of the longest record.
    pub(super) longest: Pages,
    /// The first pages of the next segment that are erased.
    pub(super) next_erased: Pages,
    /// Nothing is erased ahead until then.
    pub(super) rest_until: Instant,
}

/// The state of erasing an old key. The units that the open segment does not use are erased.
#[derive(Clone, Copy, Debug)]
pub(super) struct OldKey {
    /// The number of attempts to erase a unit.
    pub(super) attempts: Saturating<u8>,
    /// The number of units, from the start of the open segment on, that may have the key.
    pub(super) units: RegionPages,
    /// After a failure, nothing is erased until then.
    pub(super) retry_at: Instant,
}

impl Scan {
    pub(super) const NEW: Self = Self {
        page: Wrapping(0),
        is_read_twice: false,
        has_journal: false,
        has_foreign: false,
        has_lost_all: false,
        has_old_secret: false,
        unreadable: Wrapping(0),
        used: Saturating(0),
        copied: Segment::NONE,
    };
}

impl Journal {
    pub(crate) const NEW: Self = Self {
        task: Task::Detached,
        job: Purpose::None,
        attempts: Saturating(0),
        has_other_data: false,
        region: Region::NONE,
        open_segment: Segment::NONE,
        target: Segment::NONE,
        newest: SegmentNumber::NONE,
        retry_at: Instant::ZERO,
        cursor: RecordCursor::NONE,
        scan: Scan::NEW,
        writer: Writer {
            stage: Stage::Content,
            new_segment: NewSegment::IfFull,
            copies: Copies::ALL,
            is_secret: false,
            is_doubtful: false,
            is_worn: false,
            has_left_out: false,
            pages: Wrapping(0),
            skipped: Wrapping(0),
            new: RecordCursor::NONE,
            copied_crc: 0,
        },
        ahead: EraseAhead {
            has_written: false,
            longest: Wrapping(0),
            next_erased: Wrapping(0),
            rest_until: Instant::ZERO,
        },
        old_key: OldKey { attempts: Saturating(0), units: Wrapping(0), retry_at: Instant::ZERO },
        entries: Entries::FREE,
    };

    /// Whether a new segment is being written.
    pub(super) fn is_in_new_segment(&self) -> bool {
        self.target.number != self.open_segment.number
    }

    /// Hands out a read of the page at a position, counted from page `first` of the region.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(super) fn read(&mut self, first: RegionPages, position: RegionPages) -> Next {
        self.job = Purpose::Step;
        Next::Job(Job::Read { offset: self.region.address(first, position).0, range: 0..PAGE })
    }

    /// Hands out an erase of the unit that begins at a position, counted from page `first` of the region.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(super) fn erase(&mut self, first: RegionPages, position: RegionPages, purpose: Purpose) -> Next {
        self.job = purpose;
        Next::Job(Job::Erase { offset: self.region.address(first, position).0, len: self.region.unit_len() })
    }

    /// Completes the page in the buffer, whose payload is in place.
    pub(super) fn seal(&mut self, page: &mut Page, len: u8, flags: u8) {
        let RecordCursor { kind, schema, index, previous_crc, .. } = self.cursor;
        page.seal(&Footer {
            segment: self.target.number.0,
            position: self.target.head.0,
            index: index.0,
            schema,
            kind,
            flags: flags | const { VERSION << 4 },
            len,
            before: self.target.before,
            count: self.target.count.0,
            previous_crc,
            // `Page::seal` computes it.
            crc: 0,
        });
        self.writer.stage = Stage::Body;
    }

    /// Repeats reading from the start after this time.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(super) fn wait(&mut self, now: Instant, time: Duration) -> Event {
        let was_loading = self.task == Task::Load;
        self.task = Task::Waiting;
        self.attempts += 1;
        self.retry_at = now + time;
        Event::Unreadable { was_loading }
    }

    /// Ends writing. If the next page may be written in part, it is left out.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(super) fn end_write(&mut self, is_dirty: bool) {
        self.task = Task::Idle;
        if is_dirty {
            self.target.head += 1;
        }
        if self.is_in_new_segment() {
            self.target = self.open_segment;
        } else {
            self.open_segment = self.target;
        }
    }
}
