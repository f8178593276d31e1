//! Reading the journal: where the open segment is, and its newest records (G-18).

use super::super::page::{Content, Footer, Page, flag, is_all};
use super::{
    ANY_KIND, ATTEMPTS, ENTRIES, Entry, Event, FEW, Journal, LONG_ATTEMPTS, LONG_PAUSE, PAUSE, Record, Segment, Switch,
    Task, is_newer,
};
use crate::time::Instant;

impl Journal {
    /// Starts reading from the beginning.
    pub(super) fn scan(&mut self) {
        self.task = Task::Find;
        (self.open, self.write) = (Segment::NONE, Segment::NONE);
        (self.newest, self.has_lost_all, self.page, self.unreadable) = (0, false, 0, 0);
        self.entries = [Entry::FREE; ENTRIES];
        (self.scrub, self.used, self.has_old_secret) = (0, 0, false);
        (self.copied, self.switch, self.next_erased) = (Segment::NONE, Switch::IfFull, 0);
        self.skipped = 0;
        (self.has_other_data, self.has_log, self.has_foreign) = (false, false, false);
    }

    /// Looks for the open segment: the newest one with the last page of a record that is no copy.
    #[inline(never)]
    pub(super) fn found(&mut self, is_done: bool, page: &Page) {
        let is_examined = core::mem::replace(&mut self.task, Task::Find) == Task::Examine;
        if !is_done {
            self.unreadable = self.unreadable.wrapping_add(1);
            return;
        }
        let is_blank = is_all(page.tail(), 0xFF);
        if !is_examined && !is_blank {
            self.used = self.used.wrapping_add(1);
        }
        let read = Footer::read(page.tail());
        let footer = match read {
            Some(footer) => footer,
            None if is_blank || is_all(page.tail(), 0) => return,
            None if !is_examined => {
                self.task = Task::Examine;
                return;
            }
            None => match page.open() {
                Content::Damaged(footer) => footer,
                _ => {
                    self.has_other_data |= !page.is_begun();
                    return;
                }
            },
        };
        self.has_log = true;
        // The version may be the bit that was wrong.
        if read.is_some() && !footer.is_ours() {
            self.has_foreign = true;
            return;
        }
        let Footer { segment, position, .. } = footer;
        if segment.cast_signed() <= 0 {
            // No segment has this number. Without an open segment, it is what is left of a journal.
            self.has_lost_all = true;
            return;
        }
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

    pub(super) fn end_of_find(&mut self, now: Instant) -> Event {
        (self.page, self.record) = (0, Record::NONE);
        self.has_lost_all &= self.open.number == 0;
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

    pub(super) fn end_of_scan(&mut self, now: Instant) -> Event {
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
    pub(super) fn replay(&mut self, is_done: bool, page: &Page) {
        let position = u16::try_from(self.page).unwrap_or(u16::MAX);
        let content = if is_done { page.open() } else { Content::Bad };
        self.unreadable = self.unreadable.wrapping_add((!is_done).into());
        let is_here = |footer: &Footer| footer.segment == self.open.number && footer.position == position;
        let record = core::mem::replace(&mut self.record, Record::NONE);
        let is_own = match content {
            Content::Whole(footer) | Content::Damaged(footer) => is_here(&footer),
            Content::Bad => position < self.write.erased,
            Content::Blank => false,
        };
        if is_own && is_done && !is_all(page.tail(), 0xFF) {
            self.used = self.used.saturating_sub(1);
        }
        match content {
            Content::Whole(footer) if is_here(&footer) => {
                (self.write.head, self.write.erased) = (position.wrapping_add(1), self.region.end_of_unit(position));
                if footer.index == 0 {
                    self.check_count(&footer);
                    self.record = Record { kind: footer.kind, schema: footer.schema, index: 1, crc: footer.crc };
                } else if record.continues(&footer) {
                    self.record = record;
                    self.record.advance(footer.crc);
                } else if footer.is_last() {
                    self.damaged(&footer);
                }
                if footer.is_last() && self.record.index > 0 {
                    self.complete(&footer);
                }
            }
            Content::Damaged(footer) if is_here(&footer) => {
                // Its unit was erased for it. It must stay until a new record replaces it: nothing else shows the damage.
                (self.write.head, self.write.erased) = (position.wrapping_add(1), self.region.end_of_unit(position));
                if footer.is_last() {
                    self.damaged(&footer);
                }
            }
            // A newer segment begins where this one did, and the record that opened it is lost.
            Content::Whole(footer) if self.write.head == 0 && is_newer(footer.segment, self.open.number) => {
                self.has_lost_all = true;
            }
            Content::Blank => {}
            // Also a page of another segment, in a unit that was not erased as a whole: units were smaller then.
            _ if position < self.write.erased => self.write.head = position.wrapping_add(1),
            // A page of another segment, from before its unit was erased.
            _ => {}
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

    /// Records of unknown kinds were lost: marks all kinds.
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

    /// Takes the last page of a whole record.
    fn complete(&mut self, footer: &Footer) {
        let Record { kind, schema, index: pages, .. } = core::mem::replace(&mut self.record, Record::NONE);
        (self.write.count, self.write.before) = (self.write.count.wrapping_add(1), kind);
        if footer.flags & flag::LOST != 0 {
            return self.mark_damaged(kind);
        }
        self.has_old_secret |= footer.flags & flag::SECRET != 0;
        let at = footer.position.wrapping_add(1).wrapping_sub(pages);
        self.set_entry(Entry { kind, is_damaged: false, schema, at, pages, moved: at });
    }
}
