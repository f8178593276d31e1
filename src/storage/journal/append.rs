//! Writing the journal: a new record, and in a new segment the copies before it (SEC-11).

use core::num::{Saturating, Wrapping};

use super::super::job::Job;
use super::super::page::{Footer, PAGE, Page, PageState, flag};
use super::super::region::{RegionPages, in_region};
use super::record::{Copies, Entry, RecordCursor, Segment};
use super::state::{ATTEMPTS, Event, Journal, LONG_PAUSE, NewSegment, Next, PAUSE, Purpose, Stage, Task};
use crate::time::{Duration, Instant};

/// After a record is complete, erasing ahead waits for this time, so that the answer to a client is sent first.
const GRACE: Duration = Duration::from_millis(200);

/// The origin of the content of a page.
enum Origin {
    /// The service whose record is written.
    Service,
    /// The page at this position of the open segment.
    Copy(RegionPages),
    /// There is no content: the page says that a record is lost.
    LossReport,
}

impl Journal {
    /// Begins to write a record of a kind, of at most this many pages. With `is_secret`, everything older is erased once
    /// it is complete. Returns false if there is no room for it.
    pub(crate) fn begin(&mut self, kind: u8, schema: u16, pages: u16, is_secret: bool) -> bool {
        let pages = Wrapping(pages);
        let needed = self.entries.pages_with(kind, pages, Copies::ALL);
        let room = in_region(self.region.segment);
        // Storing again is worth more than the report of an unknown loss, which takes a page.
        let has_room = needed <= room || needed == room + Wrapping(1) && self.entries.clear_any_kind();
        if !has_room || !self.entries.has_slot(kind) {
            return false;
        }
        let writer = &mut self.writer;
        writer.new = RecordCursor::new(kind, schema);
        writer.pages = pages;
        writer.is_secret = is_secret;
        writer.is_doubtful = false;
        writer.is_worn = false;
        let is_full = pages > self.region.segment - self.target.head;
        if is_secret || is_full || writer.new_segment != NewSegment::IfFull || self.open_segment.is_none() {
            self.begin_segment();
        } else {
            self.writer.copies = Copies::NONE;
            self.cursor = self.writer.new;
        }
        self.task = Task::Append;
        self.begin_page();
        true
    }

    /// Begins with the content of a page.
    pub(super) fn begin_page(&mut self) {
        self.writer.stage = Stage::Content;
        self.attempts = Saturating(0);
    }

    /// Begins the next segment, with the copies.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(super) fn begin_segment(&mut self) {
        self.newest = self.newest.next();
        let first = if self.open_segment.is_none() { Wrapping(0) } else { self.region.next(self.open_segment.first) };
        self.writer.copies = Copies::ALL;
        if !self.fits_behind_skipped() {
            self.writer.skipped = Wrapping(0);
        }
        self.target = Segment::new(self.newest, first);
        self.target.head = self.writer.skipped;
        self.target.erased = self.ahead.next_erased.max(self.writer.skipped);
        self.ahead.next_erased = Wrapping(0);
        self.cursor = RecordCursor::NONE;
    }

    /// Whether a new segment has room behind the pages that are skipped.
    fn fits_behind_skipped(&self) -> bool {
        self.needed() <= in_region(self.region.segment - self.writer.skipped)
    }

    /// Returns the number of pages of the new record and of the copies that are still to be made.
    fn needed(&self) -> RegionPages {
        self.entries.pages_with(self.writer.new.kind, self.writer.pages, self.writer.copies)
    }

    /// Leaves out the rest of the unit at the head, which cannot be erased or written, and begins the record behind it again: in
    /// the next segment if there is no room for it. Fails if there is none in the next segment either.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(super) fn leave_out_unit(&mut self) -> Event {
        self.target.leave_out_unit(&self.region);
        self.cursor = RecordCursor::NONE;
        self.begin_page();
        if self.needed() <= in_region(self.region.segment - self.target.head) {
            return Event::Nothing;
        }
        if self.is_in_new_segment() {
            self.writer.skipped = Wrapping(0);
            return self.fail(false);
        }
        self.open_segment = self.target;
        self.begin_segment();
        Event::Nothing
    }

    /// Leaves out the unit that did not take a page; or ends writing, and the next attempt leaves it out.
    pub(super) fn on_page_not_written(&mut self) -> Event {
        if !self.writer.has_left_out {
            self.writer.has_left_out = true;
            return self.leave_out_unit();
        }
        self.target.leave_out_unit(&self.region);
        if self.is_in_new_segment() {
            self.writer.skipped = self.target.head;
        }
        self.fail(false)
    }

    /// Gives up the record that is being written: it does not count. Does nothing while a page that was written is still
    /// to be checked, because it may be the last one.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) fn abandon(&mut self) {
        if self.task == Task::Append && self.writer.stage != Stage::Check {
            self.end_write(self.writer.stage == Stage::Tail);
        }
    }

    /// Completes the page that [`Next::Content`] asked for, with `len` bytes of payload in place.
    pub(crate) fn put(&mut self, page: &mut Page, len: u8, is_last: bool) {
        let last = if is_last { flag::LAST } else { 0 };
        let secret = if self.is_in_new_segment() && self.must_erase_older() { flag::SECRET } else { 0 };
        self.seal(page, len, last | secret);
    }

    /// Whether to erase everything that is older than the new segment.
    fn must_erase_older(&self) -> bool {
        self.writer.is_secret || self.old_key.units > Wrapping(0)
    }

    /// Returns the next step of writing a page.
    // Out of line: its locals stay off the call stack of the other steps.
    #[inline(never)]
    pub(super) fn next_of_append(&mut self, page: &mut Page) -> Next {
        if self.writer.stage == Stage::Content {
            match self.begin_next_page() {
                Origin::Service => return Next::Content(self.cursor.index.0),
                Origin::Copy(position) => return self.read(self.open_segment.first, position),
                Origin::LossReport => {
                    self.cursor = RecordCursor::new(self.cursor.kind, self.cursor.schema);
                    self.seal(page, 0, flag::LAST | flag::COPY | flag::LOST);
                }
            }
        }
        let Segment { first, head, erased, .. } = self.target;
        if self.writer.stage == Stage::Body && head >= erased {
            return self.erase(first, in_region(erased), Purpose::Erase);
        }
        // The last page of a record is written in two parts.
        let tail_at = if is_last(page) { self.region.tail_at } else { 0 };
        let address = self.region.address(first, in_region(head));
        let (offset, range) = match self.writer.stage {
            Stage::Body if tail_at > 0 => (address, 0..usize::from(tail_at)),
            Stage::Tail => (address + Wrapping(tail_at.into()), usize::from(tail_at)..PAGE),
            _ => (address, 0..PAGE),
        };
        let offset = offset.0;
        self.job = Purpose::Step;
        Next::Job(if self.writer.stage == Stage::Check {
            Job::Read { offset, range }
        } else {
            Job::Write { offset, range }
        })
    }

    /// Moves to the record of the next page, and returns where the content of that page comes from. A new segment
    /// begins with copies of
    /// the records that are not being written; the new record follows them.
    fn begin_next_page(&mut self) -> Origin {
        while let Some(entry) = self.entries.next_to_copy(self.writer.copies) {
            if !entry.is_free() && entry.kind != self.writer.new.kind {
                if self.cursor.kind != entry.kind {
                    self.cursor = RecordCursor::at(entry);
                    self.writer.copied_crc = 0;
                }
                if self.cursor.index < entry.pages {
                    return Origin::Copy(self.cursor.next_position());
                }
                // One page, after which `on_page_written` ends the copy.
                if entry.is_damaged {
                    return Origin::LossReport;
                }
            }
            self.end_copy();
        }
        if self.cursor.kind != self.writer.new.kind {
            self.cursor = self.writer.new;
        }
        Origin::Service
    }

    /// Proceeds to the next entry to be copied.
    fn end_copy(&mut self) {
        self.writer.copies.advance();
        self.cursor = RecordCursor::NONE;
    }

    /// Takes the result of a step of writing a page.
    pub(super) fn on_append_step(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        match self.writer.stage {
            Stage::Content => return self.on_copy_read(now, is_done, page),
            Stage::Body if is_last(page) && self.region.tail_at > 0 => {
                if !is_done {
                    return self.on_page_not_written();
                }
                self.writer.stage = Stage::Tail;
            }
            Stage::Body if !is_done && !is_last(page) => return self.on_page_not_written(),
            // The driver's result for the last write does not count: after a restart, only the content that can be read does.
            Stage::Body | Stage::Tail => self.writer.stage = Stage::Check,
            Stage::Check if !is_done && self.attempts < ATTEMPTS => self.try_again(now),
            Stage::Check => {
                match if is_done { page.open() } else { PageState::Blank } {
                    PageState::Whole(footer)
                        if (footer.segment, footer.position) == (self.target.number.0, self.target.head.0) =>
                    {
                        return self.on_page_written(now, &footer);
                    }
                    _ if !self.is_in_new_segment() => {
                        self.writer.is_doubtful = true;
                        return if is_done { self.on_page_not_written() } else { self.fail(true) };
                    }
                    // A copy opens no segment.
                    _ if is_done && !self.writer.copies.is_complete() => return self.on_page_not_written(),
                    // It might be whole after a restart, or look like damage, and count for the segment that it opens.
                    _ => {
                        self.task = Task::Undo;
                        self.writer.is_worn = is_done;
                    }
                }
            }
        }
        Event::Nothing
    }

    /// Repeats a read after a pause.
    fn try_again(&mut self, now: Instant) {
        self.attempts += 1;
        self.retry_at = now + PAUSE;
    }

    /// Takes a page that was read to copy it.
    fn on_copy_read(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        let RecordCursor { kind, index, .. } = self.cursor;
        let expected = (self.open_segment.number.0, kind, index.0, self.writer.copied_crc);
        let is_next = |footer: &Footer| (footer.segment, footer.kind, footer.index, footer.previous_crc) == expected;
        match if is_done { page.open() } else { PageState::Blank } {
            PageState::Whole(footer) if is_next(&footer) => {
                self.writer.copied_crc = footer.crc;
                self.attempts = Saturating(0);
                self.seal(page, footer.len, (footer.flags & flag::LAST) | flag::COPY);
                Event::Nothing
            }
            _ if self.attempts < ATTEMPTS => {
                self.try_again(now);
                Event::Nothing
            }
            _ => {
                // It was whole, and is lost. The new segment will say so.
                self.attempts = Saturating(0);
                if let Some(entry) = self.entries.next_to_copy(self.writer.copies) {
                    entry.pages = Wrapping(0);
                    entry.is_damaged = true;
                }
                Event::Lost(kind)
            }
        }
    }

    /// Takes a page that was written and is whole.
    // Out of line: its locals stay off the call stack of the other steps.
    #[inline(never)]
    fn on_page_written(&mut self, now: Instant, footer: &Footer) -> Event {
        self.target.head += 1;
        self.cursor.advance(footer.crc);
        self.begin_page();
        self.writer.has_left_out = false;
        if !footer.is_last() {
            return Event::Nothing;
        }
        let RecordCursor { kind, schema, index: pages, .. } = self.cursor;
        let at = self.target.head - pages;
        self.target.add_record(kind);
        if footer.is_loss_report() {
            self.end_copy();
            return Event::Nothing;
        }
        if let Some(entry) = self.entries.next_to_copy(self.writer.copies) {
            entry.moved = at;
            return Event::Nothing;
        }
        if self.is_in_new_segment() {
            self.writer.new_segment = NewSegment::IfFull;
            self.writer.skipped = Wrapping(0);
            self.entries.move_all();
            if self.must_erase_older() {
                self.old_key.units = Wrapping(self.region.units());
            }
        }
        self.entries.set(Entry { kind, is_damaged: false, schema, at, pages, moved: at });
        self.open_segment = self.target;
        self.task = Task::Idle;
        self.ahead.has_written = true;
        self.ahead.rest_until = now + GRACE;
        Event::Written
    }

    /// Takes the result of erasing the unit of a new segment whose last page is not whole.
    pub(super) fn on_undo_step(&mut self, now: Instant, is_done: bool) -> Event {
        if !is_done {
            if self.attempts < ATTEMPTS + ATTEMPTS {
                self.attempts += 1;
                self.retry_at = now + LONG_PAUSE;
                return Event::Nothing;
            }
            // The next segment has a greater number, so that it counts whatever becomes of this one.
            self.writer.new_segment = NewSegment::Always;
            return self.fail(true);
        }
        if !self.writer.is_worn {
            return self.fail(true);
        }
        let record_at = in_region(self.target.head - self.cursor.index);
        if record_at <= self.region.begin_of_unit(self.target.head) {
            // Only pages of the new record were in the unit.
            self.task = Task::Append;
            return self.on_page_not_written();
        }
        // The copies in this unit are erased too, so all are made again behind it.
        self.writer.skipped = self.region.end_of_unit(self.target.head);
        self.begin_segment();
        if self.writer.skipped == Wrapping(0) || self.writer.has_left_out {
            return self.fail(false);
        }
        self.writer.has_left_out = true;
        self.task = Task::Append;
        self.begin_page();
        Event::Nothing
    }

    /// Ends writing without the record.
    // Out of line: it has several callers.
    #[inline(never)]
    fn fail(&mut self, is_dirty: bool) -> Event {
        if self.writer.new_segment == NewSegment::Once && self.is_in_new_segment() {
            self.writer.new_segment = NewSegment::IfFull;
        }
        self.end_write(is_dirty);
        Event::Failed { is_doubtful: self.writer.is_doubtful }
    }
}

/// Whether the page in the buffer is the last one of its record.
// Out of line: it has several callers.
#[inline(never)]
fn is_last(page: &Page) -> bool {
    Footer::read(page.tail()).is_some_and(|footer| footer.is_last())
}
