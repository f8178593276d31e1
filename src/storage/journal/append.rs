//! Writing the journal: a new record, and in a new segment the copies before it (SEC-11).

use super::super::job::Job;
use super::super::page::{Content, Footer, PAGE, Page, flag};
use super::{
    ANY_KIND, ATTEMPTS, ENTRIES, Entry, Event, GRACE, Journal, NO_ENTRY, Next, PAUSE, Pending, Record, Segment, Stage,
    Switch, Task,
};
use crate::time::Instant;

impl Journal {
    /// Begins to write a record of a kind, of at most this many pages. With `is_secret`, everything older is erased once
    /// it is complete. Returns false if there is no room for it.
    pub(crate) fn begin(&mut self, kind: u8, schema: u16, pages: u16, is_secret: bool) -> bool {
        let needed = self.needed(kind, pages, 0);
        if let Some(place) = self.index_of(ANY_KIND).and_then(|index| self.entries.get_mut(index))
            && needed == u32::from(self.region.segment).wrapping_add(1)
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
        (self.is_secret, self.new_pages) = (is_secret, pages);
        (self.is_doubtful, self.is_worn) = (false, false);
        let room = self.region.segment.wrapping_sub(self.write.head);
        if is_secret || self.switch != Switch::IfFull || self.open.number == 0 || pages > room {
            self.begin_segment();
        } else {
            (self.entry, self.record) = (NO_ENTRY, self.new);
        }
        self.attempts = 0;
        (self.task, self.stage) = (Task::Append, Stage::Content);
        true
    }

    /// Returns the number of pages of a new record of this kind, and of the others from entry `first` on.
    fn needed(&self, kind: u8, pages: u16, first: u8) -> u32 {
        let others = self.entries.iter().skip(first.into()).filter(|entry| entry.kind != 0 && entry.kind != kind);
        others.fold(u32::from(pages), |sum, entry| {
            sum.wrapping_add(entry.pages.into()).wrapping_add(entry.is_damaged.into())
        })
    }

    /// Begins the next segment, with the copies.
    #[inline(never)]
    pub(super) fn begin_segment(&mut self) {
        self.newest = self.newest.wrapping_add(1);
        let first = if self.open.number == 0 { 0 } else { self.region.next(self.open.first) };
        let room = self.region.segment.wrapping_sub(self.skipped);
        if self.needed(self.new.kind, self.new_pages, 0) > room.into() {
            self.skipped = 0;
        }
        let (head, erased) = (self.skipped, self.next_erased.max(self.skipped));
        self.write = Segment { number: self.newest, first, head, erased, ..Segment::NONE };
        self.next_erased = 0;
        (self.entry, self.record) = (0, Record::NONE);
    }

    /// Leaves out the rest of the unit at the head, which cannot be erased or written, and begins the record behind it again: in
    /// the next segment if there is no room for it. Fails if there is none in the next segment either.
    #[inline(never)]
    pub(super) fn leave_out(&mut self) -> Event {
        let end = self.region.end_of_unit(self.write.head);
        (self.write.head, self.write.erased) = (end, self.write.erased.max(end));
        (self.record, self.stage, self.attempts) = (Record::NONE, Stage::Content, 0);
        if self.needed(self.new.kind, self.new_pages, self.entry) <= self.region.segment.wrapping_sub(end).into() {
            return Event::Nothing;
        }
        if self.write.number != self.open.number {
            self.skipped = 0;
            return self.failed(false);
        }
        self.open = self.write;
        self.begin_segment();
        Event::Nothing
    }

    /// Leaves out the unit that did not take a page; or ends writing, and the next attempt leaves it out.
    pub(super) fn not_written(&mut self) -> Event {
        if !core::mem::replace(&mut self.has_left_out, true) {
            return self.leave_out();
        }
        let end = self.region.end_of_unit(self.write.head);
        (self.write.head, self.write.erased) = (end, self.write.erased.max(end));
        if self.write.number != self.open.number {
            self.skipped = end;
        }
        self.failed(false)
    }

    /// Gives up the record that is being written: it does not count. Does nothing while a page that was written is still
    /// to be checked, because it may be the last one.
    #[inline(never)]
    pub(crate) fn abandon(&mut self) {
        if self.task == Task::Append && self.stage != Stage::Check {
            self.stop(self.stage == Stage::Tail);
        }
    }

    #[inline(never)]
    pub(super) fn next_of_append(&mut self, page: &mut Page) -> Next {
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
        let split = if is_last(page) { PAGE.wrapping_sub(self.region.tail.into()) } else { 0 };
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
    #[inline(never)]
    fn end_copy(&mut self) {
        (self.entry, self.record) = (self.entry.wrapping_add(1), Record::NONE);
    }

    pub(super) fn append_done(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        match self.stage {
            Stage::Content => return self.copy_read(now, is_done, page),
            Stage::Body if is_last(page) && usize::from(self.region.tail) < PAGE => {
                if !is_done {
                    return self.not_written();
                }
                self.stage = Stage::Tail;
            }
            // What a driver says of the last write does not count: after a restart, what can be read does.
            Stage::Body if !is_done && !is_last(page) => return self.not_written(),
            Stage::Body | Stage::Tail => self.stage = Stage::Check,
            Stage::Check if !is_done && self.attempts < ATTEMPTS => {
                self.attempts = self.attempts.wrapping_add(1);
                self.retry_at = now + PAUSE;
            }
            Stage::Check => {
                let Segment { number: segment, head: position, .. } = self.write;
                match if is_done { page.open() } else { Content::Blank } {
                    Content::Whole(footer) if (footer.segment, footer.position) == (segment, position) => {
                        return self.written(now, &footer);
                    }
                    _ if self.write.number == self.open.number => {
                        self.is_doubtful = true;
                        return if is_done { self.not_written() } else { self.failed(true) };
                    }
                    // A copy opens no segment.
                    _ if is_done && usize::from(self.entry) < ENTRIES => return self.not_written(),
                    // It might be whole after a restart, or look like damage, and count for the segment that it opens.
                    _ => (self.task, self.is_worn) = (Task::Undo, is_done),
                }
            }
        }
        Event::Nothing
    }

    /// Takes a page that was read to copy it.
    fn copy_read(&mut self, now: Instant, is_done: bool, page: &mut Page) -> Event {
        let Record { kind, index, .. } = self.record;
        let is_next = |footer: &Footer| {
            (footer.segment, footer.kind, footer.index, footer.previous) == (self.open.number, kind, index, self.source)
        };
        match if is_done { page.open() } else { Content::Blank } {
            Content::Whole(footer) if is_next(&footer) => {
                (self.source, self.attempts) = (footer.crc, 0);
                self.seal(page, footer.len, (footer.flags & flag::LAST) | flag::COPY);
                Event::Nothing
            }
            _ if self.attempts < ATTEMPTS => {
                self.attempts = self.attempts.wrapping_add(1);
                self.retry_at = now + PAUSE;
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
    #[inline(never)]
    fn written(&mut self, now: Instant, footer: &Footer) -> Event {
        self.write.head = self.write.head.wrapping_add(1);
        self.record.advance(footer.crc);
        (self.stage, self.attempts, self.has_left_out) = (Stage::Content, 0, false);
        if !footer.is_last() {
            return Event::Nothing;
        }
        let Record { kind, schema, index: pages, .. } = self.record;
        let at = self.write.head.wrapping_sub(pages);
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
            (self.switch, self.skipped) = (Switch::IfFull, 0);
            for entry in &mut self.entries {
                entry.at = entry.moved;
            }
            if self.must_scrub() {
                self.scrub = self.region.units();
            }
        }
        self.set_entry(Entry { kind, is_damaged: false, schema, at, pages, moved: at });
        (self.open, self.task) = (self.write, Task::Idle);
        (self.has_written, self.rest_until) = (true, now + GRACE);
        Event::Written
    }

    /// Ends writing: it failed.
    #[inline(never)]
    pub(super) fn failed(&mut self, is_dirty: bool) -> Event {
        if self.switch == Switch::Once && self.write.number != self.open.number {
            self.switch = Switch::IfFull;
        }
        self.stop(is_dirty);
        Event::Failed { is_doubtful: self.is_doubtful }
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

/// Whether the page in the buffer is the last one of its record.
#[inline(never)]
fn is_last(page: &Page) -> bool {
    Footer::read(page.tail()).is_some_and(|footer| footer.is_last())
}
