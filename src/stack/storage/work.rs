//! What is loaded or written next, and what its service does for that (D-5, G-18, M-44, P-17, SEC-12).

use super::super::services::{Services, States};
use super::super::{Cx, Declares};
use crate::dialect::MavSeverity;
use crate::storage::{self, Event, Job, Kind, Next, Page, Part, Persistent, RestoreError, Storage, Texts};
use crate::types::Vehicle;

/// What storage asks of a service, or tells it: a method of [`Persistent`] each.
#[derive(Clone, Copy)]
pub(super) enum Op {
    Loaded(Result<bool, RestoreError>),
    IsReloadRequested,
    MayLoad,
    CancelIfRefused,
    PendingWrite,
    Fill(u16),
    OnWritten(bool),
    SaveAgain,
    OnBlocked,
    OnReadable,
}

/// The answer of a service. What only tells it something is answered with `No`.
enum Answer {
    No,
    Yes,
    Write(storage::Write),
    /// The number of bytes in the page, and whether it is the last one.
    Filled(u8, bool),
}

impl From<bool> for Answer {
    fn from(is_yes: bool) -> Self {
        if is_yes { Self::Yes } else { Self::No }
    }
}

impl Answer {
    const fn is_yes(&self) -> bool {
        matches!(self, Self::Yes)
    }
}

/// A call that concerns storage: all that it works on.
pub(super) struct Work<'a, D: Declares> {
    pub(super) cx: Cx<'a, D>,
    pub(super) services: &'a mut Services<D>,
    pub(super) states: &'a mut [States<D>],
    pub(super) storage: &'a mut Storage,
    pub(super) page: &'a mut Page,
}

impl<D: Declares> Work<'_, D> {
    /// Calls the method of a service.
    fn call<'l, S: Persistent<D, Link: 'l>>(
        service: &mut S,
        links: impl Iterator<Item = &'l mut S::Link>,
        cx: &mut Cx<'_, D>,
        storage: &mut Storage,
        page: &mut Page,
        op: Op,
    ) -> Answer {
        if S::RECORDS == 0 {
            return Answer::No;
        }
        let &mut Storage { record, is_late, .. } = storage;
        match op {
            Op::Loaded(result) => service.loaded(cx, result, is_late),
            Op::IsReloadRequested => return service.is_reload_requested(cx).into(),
            Op::MayLoad => return service.may_load(cx, is_late).into(),
            Op::CancelIfRefused => service.cancel_if_refused(cx, links),
            Op::PendingWrite => return service.pending_write(cx).map_or(Answer::No, Answer::Write),
            Op::Fill(index) => {
                let filled = service.fill(cx, record, index, page.payload_mut());
                return filled.map_or(Answer::No, |(len, is_last)| Answer::Filled(len, is_last));
            }
            Op::OnWritten(is_saved) => service.on_written(cx, links, is_saved),
            Op::SaveAgain => service.save_again(cx),
            Op::OnBlocked => service.on_blocked(cx, links),
            Op::OnReadable => return service.on_readable(cx, links).into(),
        }
        Answer::No
    }
}

/// Defines the services with stored content: the index, name, type, and field of [`RestoreErrors`] of each.
macro_rules! contents {
    ($($index:literal $service:ident $type:ident $field:ident;)*) => {
        /// The number of services with stored content.
        const CONTENTS: u8 = 0 $(+ { let _: u8 = $index; 1 })*;

        impl<D: Declares> Work<'_, D> {
            const KINDS: [Kind; [$($index),*].len()] = [$(Kind::of::<D, D::$type>()),*];
            const TEXTS: [Texts; [$($index),*].len()] = [$(<D::$type as Persistent<D>>::TEXTS),*];

            /// Attaches storage to every service.
            pub(super) fn attach(cx: &mut Cx<'_, D>, services: &mut Services<D>) {
                $(services.$service.attach(cx);)*
            }

            /// Asks or tells a service something.
            #[inline(never)]
            fn ask(&mut self, index: u8, op: Op) -> Answer {
                let Self { cx, services, states, storage, page } = self;
                match index {
                    $($index => {
                        let links = states.iter_mut().map(|state| &mut state.$service);
                        Self::call(&mut services.$service, links, cx, storage, page, op)
                    })*
                    _ => Answer::No,
                }
            }

            /// Loads a page with `len` bytes of the current record. Returns whether it is valid.
            // Apart from `ask`, because the checks of a plan need much of the call stack.
            #[inline(never)]
            fn load(&mut self, len: u8, is_first: bool, is_last: bool) -> bool {
                let Self { cx, services, storage, page, .. } = self;
                let &mut Storage { record, is_late, .. } = &mut **storage;
                let part = Part { record, bytes: page.payload(len), is_first, is_last, is_late };
                match storage.service {
                    $($index => services.$service.load(cx, &part, &mut storage.loading),)*
                    _ => false,
                }
            }

            /// Returns the place for the reason why the content of a service was not restored.
            fn error(&mut self, index: u8) -> &mut Option<RestoreError> {
                let errors = &mut self.storage.errors;
                match index {
                    $($index => &mut errors.$field,)*
                    _ => &mut errors.region,
                }
            }
        }
    };
}

// The order in which content is loaded, and in which it is written in turns.
contents! {
    0 signing Signing signing;
    1 param Param parameters;
    2 mission Mission plans;
    3 records Records records;
}

impl<D: Declares> Work<'_, D> {
    /// The number of pages of all records and of the reports that one is lost, and the pages of the longest record.
    #[allow(clippy::as_conversions, reason = "`from` is not const")]
    pub(super) const PAGES: (u32, u16) = {
        let (mut all, mut most, mut kinds): (u32, u16, &[Kind]) = (1, 0, &Self::KINDS);
        while let [kind, rest @ ..] = kinds {
            if kind.records > 0 {
                all = all.saturating_add((kind.pages as u32).saturating_add(1).saturating_mul(kind.records as u32));
                most = if kind.pages > most { kind.pages } else { most };
            }
            kinds = rest;
        }
        // Without a record, not even the page that begins a segment is needed.
        (if most == 0 { 0 } else { all }, most)
    };

    /// The mask of all records: eight bits for each service.
    #[allow(clippy::as_conversions, reason = "`from` is not const")]
    pub(super) const ALL_RECORDS: u32 = {
        let (mut mask, mut shift, mut kinds): (u32, u32, &[Kind]) = (0, 0, &Self::KINDS);
        while let [kind, rest @ ..] = kinds {
            let records = 1u32.wrapping_shl(kind.records as u32).wrapping_sub(1);
            mask |= records.wrapping_shl(shift);
            (shift, kinds) = (shift.wrapping_add(8), rest);
        }
        mask
    };

    /// Returns the mask of all records of a service.
    fn records(index: u8) -> u32 {
        Self::ALL_RECORDS & 0xFFu32.wrapping_shl(shift(index))
    }

    /// Adds the current record to those that are to be loaded.
    #[inline(never)]
    fn load_again(&mut self) {
        let &mut Storage { service, record, .. } = self.storage;
        self.storage.to_load |= 1u32.wrapping_shl(shift(service).wrapping_add(record.into()));
    }

    /// Tells every service something.
    pub(super) fn tell_all(&mut self, op: Op) {
        for index in 0..CONTENTS {
            self.ask(index, op);
        }
    }

    /// Ends loading, or learns that nothing can be loaded, and reports the result.
    #[inline(never)]
    fn loaded(&mut self, index: u8, result: Result<bool, RestoreError>) {
        self.ask(index, Op::Loaded(result));
        let is_late = self.storage.is_late;
        let place = self.error(index);
        if let Err(error) = result {
            *place = Some(error);
        } else if *place == Some(RestoreError::Unreadable) {
            *place = None;
        }
        if let Some(texts) = Self::TEXTS.get(usize::from(index)) {
            texts.report(&mut self.cx, result, is_late);
        }
    }

    /// Begins the next load or save, if there is one.
    fn begin_next(&mut self, may_write: bool) {
        for index in 0..CONTENTS {
            if self.ask(index, Op::IsReloadRequested).is_yes() {
                self.storage.to_load |= Self::records(index);
            }
        }
        let mut blocked = 0u8;
        let mut to_load = self.storage.to_load;
        while to_load != 0 {
            let [bit, ..] = to_load.trailing_zeros().to_le_bytes();
            to_load &= to_load.wrapping_sub(1);
            let (index, record) = (bit.wrapping_shr(3), bit & 7);
            if !self.ask(index, Op::MayLoad).is_yes() {
                blocked |= 1u8.wrapping_shl(index.into());
                self.ask(index, Op::OnBlocked);
                continue;
            }
            self.storage.to_load &= !1u32.wrapping_shl(bit.into());
            if self.begin_load(index, record) {
                return;
            }
        }
        // Whatever is requested from now on is not late.
        self.storage.is_late &= self.storage.to_load != 0;
        if !may_write {
            return;
        }
        for step in 0..CONTENTS {
            let index = self.storage.turn.wrapping_add(step) % CONTENTS;
            if blocked & 1u8.wrapping_shl(index.into()) != 0 {
                continue;
            }
            let Answer::Write(write) = self.ask(index, Op::PendingWrite) else { continue };
            let Some(kind) = Self::KINDS.get(usize::from(index)) else { continue };
            let storage = &mut *self.storage;
            storage.turn = index.wrapping_add(1) % CONTENTS;
            (storage.service, storage.record, storage.version) = (index, write.record, write.version);
            let number = kind.first.wrapping_add(write.record);
            if storage.log.begin(number, kind.schema, kind.pages, write.is_secret) {
                return;
            }
            self.ask(index, Op::OnWritten(false));
        }
    }

    /// Begins to load a record. Returns false if there is nothing to load.
    #[inline(never)]
    fn begin_load(&mut self, index: u8, record: u8) -> bool {
        if !self.ask(index, Op::OnReadable).is_yes() {
            return false;
        }
        let Some(kind) = Self::KINDS.get(usize::from(index)) else { return false };
        let storage = &mut *self.storage;
        let number = kind.first.wrapping_add(record);
        let found = kind.judge(storage.log.find(number));
        (storage.service, storage.record) = (index, record);
        if found == Ok(true) {
            storage.log.load(number);
        } else {
            self.loaded(index, found);
        }
        found == Ok(true)
    }

    /// Whether the record that is being written is still the one that is wanted.
    fn is_wanted(&mut self) -> bool {
        let Answer::Write(write) = self.ask(self.storage.service, Op::PendingWrite) else { return false };
        (write.record, write.version) == (self.storage.record, self.storage.version)
    }

    /// Returns the next job.
    pub(super) fn next_job(&mut self) -> Option<Job> {
        let may_write = self.cx.vehicle.may_persist();
        self.tell_all(Op::CancelIfRefused);
        if self.storage.log.writing() != 0 {
            if !self.is_wanted() {
                self.storage.log.abandon();
            }
        } else if self.storage.log.is_foreign() {
            self.refuse_all();
        }
        if self.storage.log.is_waiting() || self.storage.log.is_foreign() {
            for index in 0..CONTENTS {
                if self.storage.log.is_foreign() || self.storage.to_load & Self::records(index) != 0 {
                    self.ask(index, Op::OnBlocked);
                }
            }
        }
        if self.storage.log.is_idle() {
            self.begin_next(may_write);
        }
        // Twice, if content is needed first.
        for _ in 0..2 {
            match self.storage.log.next(self.cx.now, may_write, self.page) {
                Next::Job(job) => return Some(job),
                Next::Idle => return None,
                Next::Content(index) => {
                    let service = self.storage.service;
                    let Answer::Filled(len, is_last) = self.ask(service, Op::Fill(index)) else {
                        self.storage.log.abandon();
                        self.ask(service, Op::OnWritten(false));
                        return None;
                    };
                    self.storage.log.put(self.page, len, is_last);
                }
            }
        }
        None
    }

    /// The log is of another version: nothing can be loaded.
    fn refuse_all(&mut self) {
        if core::mem::replace(&mut self.storage.to_load, 0) != 0 {
            self.storage.errors.region = Some(RestoreError::Foreign);
            for (index, kind) in (0..).zip(&Self::KINDS) {
                if kind.records > 0 {
                    self.loaded(index, Err(RestoreError::Foreign));
                }
            }
        }
    }

    /// Takes a page of the record that is loaded.
    pub(super) fn on_loaded(&mut self, len: u8, is_first: bool, is_last: bool) {
        let &mut Storage { service: index, record, is_late, .. } = self.storage;
        if is_late && !self.ask(index, Op::MayLoad).is_yes() {
            // The vehicle has armed meanwhile.
            self.storage.log.end_load();
            self.load_again();
            return self.loaded(index, Err(RestoreError::Unreadable));
        }
        if is_late {
            // A whole plan may have been uploaded while this page was read.
            self.ask(index, Op::OnReadable);
        }
        let is_valid = self.load(len, is_first, is_last);
        if is_last || !is_valid {
            self.storage.log.end_load();
            let Some(kind) = Self::KINDS.get(usize::from(index)) else { return };
            let is_damaged = !is_valid || self.storage.log.find(kind.first.wrapping_add(record)).is_damaged;
            self.loaded(index, if is_damaged { Err(RestoreError::Damaged) } else { Ok(true) });
        }
    }

    /// Takes what a job has led to.
    #[inline(never)]
    pub(super) fn on_event(&mut self, event: Event) {
        let index = self.storage.service;
        match event {
            Event::Nothing => {}
            Event::Found => {
                if self.storage.log.has_other_data() {
                    self.storage.errors.region = Some(RestoreError::OtherData);
                    let text = "Storage has other data, which is erased";
                    storage::report(&mut self.cx, MavSeverity::WARNING, text);
                }
            }
            Event::Unreadable { was_loading } => {
                if was_loading {
                    self.load_again();
                }
                for index in 0..CONTENTS {
                    if self.storage.to_load & Self::records(index) != 0 {
                        self.loaded(index, Err(RestoreError::Unreadable));
                    }
                }
                self.storage.is_late = true;
            }
            // `on_loaded` takes it.
            Event::Loaded { .. } => {}
            Event::Written => {
                self.tell_all(Op::CancelIfRefused);
                let is_wanted = self.is_wanted();
                self.ask(index, if is_wanted { Op::OnWritten(true) } else { Op::SaveAgain });
            }
            Event::Failed { is_doubtful } => {
                // A service that no longer wants it knows that already.
                if self.is_wanted() {
                    self.ask(index, Op::OnWritten(false));
                }
                if is_doubtful {
                    self.ask(index, Op::SaveAgain);
                }
            }
            Event::Lost(kind) => {
                storage::report(&mut self.cx, MavSeverity::WARNING, "Stored data was lost, and is stored again");
                if let Some((index, _)) = (0..).zip(&Self::KINDS).find(|(_, known)| known.has(kind)) {
                    self.ask(index, Op::SaveAgain);
                }
            }
        }
    }

    /// Takes the result of the last job.
    pub(super) fn done(&mut self, is_done: bool) -> Event {
        self.storage.log.done(self.cx.now, is_done, self.page)
    }
}

fn shift(index: u8) -> u32 {
    u32::from(index).wrapping_mul(8)
}
