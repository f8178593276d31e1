//! The journal: records of kinds, in the two halves of a region of erase units (D-5, G-18, SEC-11, SEC-12, SEC-15).
//!
//! `format.md` in this folder documents the format, and says why no cut of the power loses a record. The journal calls no
//! driver. It hands out one [`Job`] at a time, and takes its result:
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
mod state;

use core::num::{Saturating, Wrapping};

use super::job::Job;
use super::page::{PAGE, Page, PageState, TAIL};
use super::region::{Region, in_region};
use crate::time::Instant;
pub(crate) use record::Entry;
use record::{RecordCursor, Segment};
use state::{ATTEMPTS, LONG_PAUSE, PAUSE, Purpose, Stage, Task};
pub(crate) use state::{Event, Journal, Next};

/// The offset of a page's end, which has the footer.
#[allow(clippy::as_conversions, reason = "224")]
const TAIL_AT: Wrapping<u32> = Wrapping((PAGE - TAIL) as u32);

impl Journal {
    /// Begins to read the journal in this region. `longest` is the length of the longest record in pages.
    pub(crate) fn attach(&mut self, region: Region, longest: u16) {
        self.region = region;
        self.ahead.longest = Wrapping(longest);
        self.ahead.has_written = false;
        self.writer.is_secret = false;
        (self.job, self.attempts, self.retry_at) = (Purpose::None, Saturating(0), Instant::ZERO);
        self.old_key.retry_at = Instant::ZERO;
        if region.segment > Wrapping(0) {
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

    /// Whether a record is being written. It cannot be [abandoned](Self::abandon) once its last bytes are written.
    pub(crate) fn is_writing(&self) -> bool {
        self.task == Task::Append
    }

    /// Whether a page was written in part, or is not checked yet.
    pub(crate) fn is_within_page(&self) -> bool {
        self.task == Task::Append && self.writer.stage != Stage::Content
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
        self.job != Purpose::None
    }

    /// Returns the newest record of a kind, and whether a newer one was lost.
    pub(crate) fn find(&self, kind: u8) -> &Entry {
        self.entries.find(kind)
    }

    /// Begins to load the newest record of a kind, which was [found](Self::find).
    pub(crate) fn load(&mut self, kind: u8) {
        if let Some(entry) = self.entries.get(kind) {
            self.cursor = RecordCursor::at(entry);
            self.task = Task::Load;
        }
    }

    /// Ends loading, after the last page or before.
    pub(crate) fn end_load(&mut self) {
        if self.is_loading() {
            self.task = Task::Idle;
        }
    }

    /// Returns the next job, or asks for the content that it needs. Writes and erases only if `may_write` is set.
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
            Task::Examine => self.read(Wrapping(0), self.scan.page),
            Task::Replay => self.read(self.open_segment.first, self.scan.page),
            Task::Load => self.read(self.open_segment.first, self.cursor.next_position()),
            // The check of a page only reads, and decides whether a record is complete.
            Task::Append if may_write || self.writer.stage == Stage::Check => self.next_of_append(page),
            Task::Idle if may_write => self.erase_ahead(now),
            Task::Undo if may_write => {
                let unit = self.region.begin_of_unit(self.target.head);
                self.erase(self.target.first, unit, Purpose::Step)
            }
            Task::Append | Task::Idle | Task::Undo | Task::Detached | Task::Foreign => Next::Idle,
        }
    }

    /// Reads the end of the page that is examined.
    // Out of line: it has several callers.
    #[inline(never)]
    fn read_tail(&mut self) -> Next {
        self.job = Purpose::Step;
        let offset = self.region.address(Wrapping(0), self.scan.page) + TAIL_AT;
        Next::Job(Job::Read { offset: offset.0, range: PAGE - TAIL..PAGE })
    }

    /// Erases a unit that has an old key; or else the next unit, if the longest record would need it.
    fn erase_ahead(&mut self, now: Instant) -> Next {
        let Segment { first, head, erased, .. } = self.target;
        // From the last unit on, down to those that the open segment uses.
        let key_unit = (self.old_key.units - Wrapping(1)) * self.region.unit;
        if key_unit < in_region(erased) {
            self.old_key.units = Wrapping(0);
        }
        if self.old_key.units > Wrapping(0) && now >= self.old_key.retry_at {
            return self.erase(first, key_unit, Purpose::EraseKey);
        }
        if !self.ahead.has_written || now < self.ahead.rest_until {
            return Next::Idle;
        }
        // At most one unit ahead, and late: it is erased again after a restart, which wears it more than others.
        let needed = in_region(self.ahead.longest).min(Wrapping(self.region.unit.0.div_ceil(4)));
        let end = self.region.segment;
        if erased < end && in_region(erased - head) < needed {
            self.erase(first, in_region(erased), Purpose::Erase)
        } else if in_region(end - head) < needed && self.ahead.next_erased == Wrapping(0) {
            self.erase(self.region.next(first), Wrapping(0), Purpose::EraseNext)
        } else {
            Next::Idle
        }
    }

    /// Takes the result of the job.
    // Out of line: its locals stay off the call stack of the code that runs the job.
    #[inline(never)]
    pub(crate) fn done(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        match core::mem::replace(&mut self.job, Purpose::None) {
            Purpose::None => {}
            Purpose::Step => return self.on_step(now, is_done, page),
            Purpose::Erase if is_done => {
                let is_open = !self.is_in_new_segment();
                self.target.erased = self.region.end_of_unit(self.target.erased);
                if is_open {
                    self.open_segment.erased = self.target.erased;
                }
            }
            Purpose::Erase if self.task == Task::Append => return self.leave_out_unit(),
            Purpose::EraseNext if is_done => self.ahead.next_erased = self.region.end_of_unit(Wrapping(0)),
            // It is not repeated before the unit is needed.
            Purpose::Erase | Purpose::EraseNext => self.ahead.has_written = false,
            // A unit that cannot be erased is given up, so that the others with an old key are erased (X-7).
            Purpose::EraseKey if is_done || self.old_key.attempts >= ATTEMPTS => {
                self.old_key.units -= 1;
                self.old_key.attempts = Saturating(0);
            }
            Purpose::EraseKey => {
                self.old_key.attempts += 1;
                self.old_key.retry_at = now + LONG_PAUSE;
            }
        }
        Event::Nothing
    }

    /// Takes the result of a step of the task.
    fn on_step(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        match self.task {
            Task::Find | Task::Examine => self.find_segment(now, is_done, page),
            Task::Replay => self.replay(now, is_done, page),
            Task::Load => match if is_done { page.open() } else { PageState::Blank } {
                PageState::Whole(footer)
                    if self.cursor.continues_with(&footer) && footer.segment == self.open_segment.number.0 =>
                {
                    self.cursor.advance(footer.crc);
                    Event::Loaded { len: footer.len, is_first: footer.index == 0, is_last: footer.is_last() }
                }
                _ => self.wait(now, PAUSE),
            },
            Task::Append => self.on_append_step(now, is_done, page),
            Task::Undo => self.on_undo_step(now, is_done),
            Task::Detached | Task::Waiting | Task::Foreign | Task::Idle => Event::Nothing,
        }
    }
}
