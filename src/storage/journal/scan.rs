//! Reading the journal: where the open segment is, and its newest records (G-18).

use core::num::{Saturating, Wrapping};

use super::super::page::{Footer, Page, PageState, is_all};
use super::super::region::{Pages, RegionPages, in_region};
use super::record::{Entries, Entry, RecordCursor, Segment, SegmentNumber};
use super::state::{ATTEMPTS, Event, Journal, LONG_PAUSE, NewSegment, PAUSE, Scan, Task};
use crate::time::Instant;

/// If more pages cannot be read than a power cut leaves, they are given up after this many attempts, a minute later, and everything
/// counts as damaged. All pages of the region are never given up.
const LONG_ATTEMPTS: Saturating<u8> = Saturating(10);
/// The number of pages that several power cuts may leave unreadable.
const FEW: RegionPages = Wrapping(8);

impl Journal {
    /// Starts reading from the beginning.
    pub(super) fn scan(&mut self) {
        self.task = Task::Find;
        self.scan = Scan::NEW;
        self.has_other_data = false;
        (self.open_segment, self.target, self.newest) = (Segment::NONE, Segment::NONE, SegmentNumber::NONE);
        self.entries = Entries::FREE;
        self.writer.new_segment = NewSegment::IfFull;
        self.old_key.units = Wrapping(0);
        self.ahead.next_erased = Wrapping(0);
        self.writer.skipped = Wrapping(0);
    }

    /// Takes the end of a page, or all of it: looks for the open segment, which is the newest one with the last page of a record
    /// that is no copy.
    // Out of line: its locals stay off the call stack of the other steps.
    #[inline(never)]
    pub(super) fn find_segment(&mut self, now: Instant, is_done: bool, page: &Page) -> Event {
        let is_examined = self.task == Task::Examine;
        let scan = &mut self.scan;
        let is_blank = is_all(page.tail(), 0xFF);
        let mut found = None;
        if !is_done {
            scan.unreadable += 1;
        } else if !is_blank {
            if !is_examined {
                scan.used += 1;
            }
            match Footer::read(page.tail()) {
                Some(footer) if !footer.is_ours() => {
                    scan.has_journal = true;
                    scan.has_foreign = true;
                }
                Some(footer) => found = Some(footer),
                None if is_all(page.tail(), 0) => {}
                None if !is_examined => {
                    self.task = Task::Examine;
                    return Event::Nothing;
                }
                // The version may be the bit that was wrong.
                None => match page.open() {
                    PageState::Damaged(footer) => found = Some(footer),
                    _ => self.has_other_data |= !page.is_begun(),
                },
            }
        }
        if let Some(footer) = found {
            self.add_to_segment(&footer);
        }
        self.task = Task::Find;
        self.scan.page += 1;
        if self.scan.page < self.region.pages { Event::Nothing } else { self.end_of_find(now) }
    }

    /// Takes the footer of a page of any segment.
    fn add_to_segment(&mut self, footer: &Footer) {
        let (number, position) = (SegmentNumber(footer.segment), Wrapping(footer.position));
        self.scan.has_journal = true;
        if !number.is_possible() {
            // Without an open segment, it is the rest of a journal.
            self.scan.has_lost_all = true;
            return;
        }
        if number.is_newer_than(self.newest) {
            self.newest = number;
        }
        if !footer.is_last() || position >= self.region.segment {
            return;
        }
        let segment = if footer.is_copy() { &mut self.scan.copied } else { &mut self.open_segment };
        if number.is_newer_than(segment.number) {
            *segment = Segment::new(number, self.region.before(self.scan.page, in_region(position)));
        }
    }

    fn end_of_find(&mut self, now: Instant) -> Event {
        self.cursor = RecordCursor::NONE;
        let scan = &mut self.scan;
        scan.page = Wrapping(0);
        scan.has_lost_all &= self.open_segment.is_none();
        if self.open_segment.is_none() && !scan.copied.is_none() {
            // The record that opened the segment is lost, and so is the segment before.
            self.open_segment = scan.copied;
            scan.has_lost_all = true;
        }
        self.target = self.open_segment;
        self.has_other_data &= !scan.has_journal;
        if scan.has_foreign {
            self.task = Task::Foreign;
            return Event::Found;
        }
        // A power cut leaves no more than one unit that cannot be read, several cuts a few pages more. Others may be read later.
        let is_outage = scan.unreadable > self.region.unit.max(FEW);
        let attempts = self.attempts + Saturating(1);
        if scan.unreadable >= self.region.pages || is_outage && attempts < LONG_ATTEMPTS {
            return self.wait(now, if attempts < ATTEMPTS { PAUSE } else { LONG_PAUSE });
        }
        scan.has_lost_all |= is_outage;
        if !self.open_segment.is_none() {
            self.task = Task::Replay;
            return Event::Nothing;
        }
        if scan.unreadable > Wrapping(0) && attempts >= ATTEMPTS {
            self.entries.mark_all_damaged();
        }
        self.end_of_scan(now)
    }

    fn end_of_scan(&mut self, now: Instant) -> Event {
        let has_unreadable = self.scan.unreadable > Wrapping(0);
        if has_unreadable && self.attempts + Saturating(1) < ATTEMPTS {
            return self.wait(now, PAUSE);
        }
        self.writer.new_segment = if self.scan.has_lost_all {
            self.entries.mark_all_damaged();
            // A newer segment may be read another time, and must then be older than all that is written now.
            self.newest = self.newest.next();
            NewSegment::Always
        } else if has_unreadable {
            // Pages that a cut has made unreadable must not add up.
            NewSegment::Once
        } else {
            NewSegment::IfFull
        };
        // A page is left out: a write that was cut off may have disturbed it, even if it reads as erased.
        if self.target.head < self.target.erased {
            self.target.head += 1;
        }
        self.open_segment = self.target;
        self.task = Task::Idle;
        self.attempts = Saturating(0);
        if self.scan.has_old_secret && self.scan.used > Saturating(0) {
            self.old_key.units = Wrapping(self.region.units());
        }
        Event::Found
    }

    /// Takes the next page of the open segment. A page that does not match its checksums is read a second time.
    // Out of line: its locals stay off the call stack of the other steps.
    #[inline(never)]
    pub(super) fn replay(&mut self, now: Instant, is_done: bool, page: &Page) -> Event {
        let state = if is_done { page.open() } else { PageState::Bad };
        if is_done && matches!(state, PageState::Bad | PageState::Damaged(_)) && !self.scan.is_read_twice {
            self.scan.is_read_twice = true;
            return Event::Nothing;
        }
        self.scan.is_read_twice = false;
        let position = Wrapping(u16::try_from(self.scan.page.0).unwrap_or(u16::MAX));
        let is_here = |footer: &Footer| (footer.segment, footer.position) == (self.open_segment.number.0, position.0);
        if !is_done {
            self.scan.unreadable += 1;
        } else if !is_all(page.tail(), 0xFF) {
            let is_own = match &state {
                PageState::Whole(footer) | PageState::Damaged(footer) => is_here(footer),
                PageState::Bad => position < self.target.erased,
                PageState::Blank => false,
            };
            if is_own {
                self.scan.used -= 1;
            }
        }
        let record = core::mem::replace(&mut self.cursor, RecordCursor::NONE);
        match state {
            PageState::Whole(footer) if is_here(&footer) => self.replay_page(&footer, position, record),
            PageState::Damaged(footer) if is_here(&footer) => {
                // It must stay until a new record replaces it: nothing else shows the damage.
                self.target.add_page(position, &self.region);
                if footer.is_last() {
                    self.count_damaged(&footer);
                }
            }
            // A newer segment begins where this one did, and the record that opened it is lost.
            PageState::Whole(footer)
                if self.target.head == Wrapping(0)
                    && SegmentNumber(footer.segment).is_newer_than(self.open_segment.number) =>
            {
                self.scan.has_lost_all = true;
            }
            PageState::Blank => {}
            // Also a page of another segment, in a unit that was not erased as a whole: units were smaller then.
            _ if position < self.target.erased => self.target.head = position + Wrapping(1),
            // A page of another segment, from before its unit was erased.
            _ => {}
        }
        self.scan.page += 1;
        if self.scan.page < in_region(self.region.segment) { Event::Nothing } else { self.end_of_scan(now) }
    }

    /// Takes a whole page of the open segment, behind a page of `record`.
    fn replay_page(&mut self, footer: &Footer, position: Pages, record: RecordCursor) {
        self.target.add_page(position, &self.region);
        if footer.index == 0 {
            self.check_count(footer);
            self.cursor = RecordCursor::new(footer.kind, footer.schema);
        } else if record.continues_with(footer) {
            self.cursor = record;
        } else {
            if footer.is_last() {
                self.count_damaged(footer);
            }
            return;
        }
        self.cursor.advance(footer.crc);
        if !footer.is_last() {
            return;
        }
        let RecordCursor { kind, schema, index: pages, .. } = core::mem::replace(&mut self.cursor, RecordCursor::NONE);
        self.target.add_record(kind);
        if footer.is_loss_report() {
            return self.entries.mark_damaged(kind);
        }
        self.scan.has_old_secret |= footer.is_secret();
        let at = self.target.head - pages;
        self.entries.set(Entry { kind, is_damaged: false, schema, at, pages, moved: at });
    }

    /// Counts a record whose last page is there, and which is not whole.
    fn count_damaged(&mut self, footer: &Footer) {
        self.check_count(footer);
        self.entries.mark_damaged(footer.kind);
        self.target.add_record(footer.kind);
    }

    /// Compares the number of records so far with the number that a page of the next record states.
    fn check_count(&mut self, footer: &Footer) {
        let count = Wrapping(footer.count);
        match (count - self.target.count).0.cast_signed() {
            ..=0 => {}
            1 => self.entries.mark_damaged(footer.before),
            2.. => {
                self.entries.mark_damaged(footer.before);
                self.entries.mark_all_damaged();
            }
        }
        self.target.count = count;
    }
}
