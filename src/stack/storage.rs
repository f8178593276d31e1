//! Persistence: the code between the services and the [log](crate::storage) (D-5, G-13, G-15, M-44, P-17, SEC-11, SEC-12).
//!
//! Storage is used by jobs, apart from polling: an erase of a microcontroller's own flash stops the processor for 100 ms
//! and more. The firmware chooses when a job runs, and the vehicle is asked before each one that writes.

use embedded_storage::nor_flash::NorFlash;

use super::services::{Services, States};
use super::{Cx, Declares, PeerMemory, Stack, TextMemory, split};
use crate::dialect::MavSeverity;
use crate::service::param::{ParamService, ParamTable, Parameters};
use crate::storage::{
    self, Event, Job, JobSlot, Kind, Next, Page, Part, Persistent, RecordService, Region, RestoreError, RestoreErrors,
    Storage, Store,
};
use crate::time::Instant;
use crate::types::Vehicle;

/// What storage asks of a service, or tells it: a method of [`Persistent`] each.
#[derive(Clone, Copy)]
enum Op {
    Attach,
    Load { len: u8, is_first: bool, is_last: bool },
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

impl Answer {
    const fn is_yes(&self) -> bool {
        matches!(self, Self::Yes)
    }
}

/// A call that concerns storage: all that it works on.
struct Work<'a, D: Declares> {
    cx: Cx<'a, D>,
    services: &'a mut Services<D>,
    states: &'a mut [States<D>],
    storage: &'a mut Storage,
    /// Not needed to attach storage.
    page: Option<&'a mut Page>,
}

impl<D: Declares> Work<'_, D> {
    /// Calls the method of a service.
    fn call<'l, S: Persistent<D, Link: 'l>>(
        service: &mut S,
        links: impl Iterator<Item = &'l mut S::Link>,
        cx: &mut Cx<'_, D>,
        storage: &mut Storage,
        page: Option<&mut Page>,
        op: Op,
    ) -> Answer {
        if S::RECORDS == 0 {
            return Answer::No;
        }
        let &mut Storage { record, is_late, .. } = storage;
        let is_yes = match op {
            Op::Attach => {
                service.attach(cx);
                false
            }
            Op::Load { len, is_first, is_last } => {
                let bytes = page.map_or(&[][..], |page| page.payload(len));
                service.load(cx, &Part { record, bytes, is_first, is_last, is_late }, &mut storage.loading)
            }
            Op::Loaded(result) => {
                service.loaded(cx, result, is_late);
                false
            }
            Op::IsReloadRequested => service.is_reload_requested(cx),
            Op::MayLoad => service.may_load(cx, is_late),
            Op::CancelIfRefused => {
                service.cancel_if_refused(cx, links);
                false
            }
            Op::PendingWrite => return service.pending_write(cx).map_or(Answer::No, Answer::Write),
            Op::Fill(index) => {
                let bytes = page.map(Page::payload_mut).unwrap_or_default();
                let filled = service.fill(cx, record, index, bytes);
                return filled.map_or(Answer::No, |(len, is_last)| Answer::Filled(len, is_last));
            }
            Op::OnWritten(is_saved) => {
                service.on_written(cx, links, is_saved);
                false
            }
            Op::SaveAgain => {
                service.save_again(cx);
                false
            }
            Op::OnBlocked => {
                service.on_blocked(cx, links);
                false
            }
            Op::OnReadable => service.on_readable(cx, links),
        };
        if is_yes { Answer::Yes } else { Answer::No }
    }
}

/// Defines the services with stored content: the index, name, type, and field of [`RestoreErrors`] of each.
macro_rules! contents {
    ($($index:literal $service:ident $type:ident $field:ident;)*) => {
        /// The number of services with stored content.
        const CONTENTS: u8 = 0 $(+ { let _: u8 = $index; 1 })*;

        impl<D: Declares> Work<'_, D> {
            const KINDS: [Kind; [$($index),*].len()] = [$(Kind::of::<D, D::$type>()),*];

            /// Asks or tells a service something.
            #[inline(never)]
            fn ask(&mut self, index: u8, op: Op) -> Answer {
                let Self { cx, services, states, storage, page } = self;
                match index {
                    $($index => {
                        let links = states.iter_mut().map(|state| &mut state.$service);
                        Self::call(&mut services.$service, links, cx, storage, page.as_deref_mut(), op)
                    })*
                    _ => Answer::No,
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
    const PAGES: (u32, u16) = {
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
    const ALL_RECORDS: u32 = {
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
    fn load_again(&mut self) {
        let &mut Storage { service, record, .. } = self.storage;
        self.storage.to_load |= 1u32.wrapping_shl(shift(service).wrapping_add(record.into()));
    }

    /// Tells every service something.
    fn tell_all(&mut self, op: Op) {
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
        if let Some(kind) = Self::KINDS.get(usize::from(index)) {
            kind.report(&mut self.cx, result, is_late);
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
    fn next_job(&mut self) -> Option<Job> {
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
            let page = self.page.as_deref_mut()?;
            match self.storage.log.next(self.cx.now, may_write, page) {
                Next::Job(job) => return Some(job),
                Next::Idle => return None,
                Next::Content(index) => {
                    let service = self.storage.service;
                    let Answer::Filled(len, is_last) = self.ask(service, Op::Fill(index)) else {
                        self.storage.log.abandon();
                        self.ask(service, Op::OnWritten(false));
                        return None;
                    };
                    self.storage.log.put(self.page.as_deref_mut()?, len, is_last);
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
    // Apart from `on_event`, because the checks of a plan need much of the call stack.
    fn on_loaded(&mut self, len: u8, is_first: bool, is_last: bool) {
        let &mut Storage { service: index, record, is_late, .. } = self.storage;
        if is_late && !self.ask(index, Op::MayLoad).is_yes() {
            // The vehicle has armed meanwhile.
            self.storage.log.end_load();
            self.load_again();
            return self.loaded(index, Err(RestoreError::Unreadable));
        }
        let is_valid = self.ask(index, Op::Load { len, is_first, is_last }).is_yes();
        if is_last || !is_valid {
            self.storage.log.end_load();
            let Some(kind) = Self::KINDS.get(usize::from(index)) else { return };
            let is_damaged = !is_valid || self.storage.log.find(kind.first.wrapping_add(record)).is_damaged;
            self.loaded(index, if is_damaged { Err(RestoreError::Damaged) } else { Ok(true) });
        }
    }

    /// Takes what a job has led to.
    fn on_event(&mut self, event: Event) {
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
            Event::Loaded { len, is_first, is_last } => self.on_loaded(len, is_first, is_last),
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
    fn done(&mut self, is_done: bool) {
        if let Some(page) = self.page.as_deref_mut() {
            let event = self.storage.log.done(self.cx.now, is_done, page);
            self.on_event(event);
        }
    }
}

fn shift(index: u8) -> u32 {
    u32::from(index).wrapping_mul(8)
}

impl<F: NorFlash> Store<F> {
    /// Returns the least length of the region for everything that the firmware declares, in bytes: two segments of as
    /// many erase units as its longest records fill, one of each. A longer region wears less: see
    /// [the format](crate::storage#wear).
    pub const fn region_len<D: Declares>() -> u32 {
        Self::region_len_for(Work::<D>::PAGES.0)
    }
}

#[cfg(feature = "embedded-storage-async")]
impl<F: embedded_storage_async::nor_flash::NorFlash> storage::AsyncStore<F> {
    /// Returns the least length of the region for everything that the firmware declares, in bytes, like
    /// [`Store::region_len`].
    pub const fn region_len<D: Declares>() -> u32 {
        Self::region_len_for(Work::<D>::PAGES.0)
    }
}

/// With `storage`.
impl<D: Declares<Storage = Storage>, const LINKS: usize> Stack<D, LINKS> {
    /// Attaches a region of storage: from now on, [`storage_job`](Self::storage_job) reads what is stored, and then writes
    /// what changes. Call it once, before the loop. [`restore`](Self::restore) does it for a blocking driver.
    #[inline(never)]
    pub fn attach_storage(&mut self, now: Instant, region: Region, vehicle: &mut D::Vehicle) {
        let mut work = self.storage_work(now, None, vehicle);
        let storage = &mut *work.storage;
        (storage.to_load, storage.is_late, storage.errors) = (Work::<D>::ALL_RECORDS, false, RestoreErrors::NONE);
        storage.log.attach(region, Work::<D>::PAGES.1);
        work.tell_all(Op::Attach);
    }

    /// Collects what a call that concerns storage works on.
    #[inline(never)]
    fn storage_work<'a>(
        &'a mut self,
        now: Instant,
        page: Option<&'a mut Page>,
        vehicle: &'a mut D::Vehicle,
    ) -> Work<'a, D> {
        let (cx, services, states, storage) = split!(self, now, vehicle, storage);
        Work { cx, services, states, storage, page }
    }

    /// Returns the next operation on the storage, if one is to be done now. Carry it out with `page`, and report the
    /// result to [`storage_done`](Self::storage_done) with the same page. Meanwhile poll the stack as always: the
    /// operation may run in another task, by DMA, or in the background of a chip, for as long as it takes.
    ///
    /// There is one job at a time. A call before the result of the last job counts that job as failed. Jobs that write
    /// or erase are handed out only while the vehicle [permits](crate::Vehicle::may_persist) it.
    ///
    /// Call it in every pass of the loop, or whenever the storage is free: a client that has uploaded a plan waits for
    /// it.
    pub fn storage_job(&mut self, now: Instant, page: &mut Page, vehicle: &mut D::Vehicle) -> Option<Job> {
        let mut work = self.storage_work(now, Some(page), vehicle);
        if work.storage.log.is_busy() {
            work.done(false);
        }
        let job = work.next_job();
        work.cx.shared.is_storage_busy = job.is_some();
        job
    }

    /// Takes the result of the [job](Self::storage_job): whether the driver reported success.
    pub fn storage_done(&mut self, now: Instant, is_done: bool, page: &mut Page, vehicle: &mut D::Vehicle) {
        let mut work = self.storage_work(now, Some(&mut *page), vehicle);
        work.cx.shared.is_storage_busy = false;
        work.done(is_done);
        if work.storage.log.is_idle() {
            page.wipe();
        }
    }

    /// Reads the result of the last job in `slot`; or, if there was none, puts the next job there. Returns true if storage
    /// is not finished: run the slot's job, if it has one, and call this again. It is [`storage_job`](Self::storage_job) and
    /// [`storage_done`](Self::storage_done) in turns, for a stack that several tasks share: lock it, exchange, unlock, run.
    /// Each call does one of the two, so the lock is held for a short time.
    ///
    /// A job that was not run, or whose run was cut off, counts as failed.
    ///
    /// ```
    /// # use core::cell::RefCell;
    /// # use embedded_storage::nor_flash::NorFlash;
    /// # use mavstack::storage::Store;
    /// # use mavstack::*;
    /// # struct Rover;
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
    /// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
    /// #     }
    /// # }
    /// # stack! { struct Mavlink for Rover { links: 1, storage } }
    /// # struct Shared(RefCell<(Mavlink, Rover)>);
    /// # impl Shared {
    /// #     fn lock<T>(&self, call: impl FnOnce(&mut Mavlink, &mut Rover) -> T) -> T {
    /// #         let (stack, vehicle) = &mut *self.0.borrow_mut();
    /// #         call(stack, vehicle)
    /// #     }
    /// # }
    /// # fn now() -> Instant { Instant::ZERO }
    /// # fn sleep(_: Duration) {}
    /// /// A task of low priority, which the flight loop and the links interrupt.
    /// fn storage_task<F: NorFlash>(mut store: Store<F>, shared: &Shared) {
    ///     shared.lock(|stack, rover| stack.attach_storage(now(), store.region(), rover));
    ///     loop {
    ///         if shared.lock(|stack, rover| stack.exchange_job(now(), store.slot(), rover)) {
    ///             store.run();
    ///         } else {
    ///             sleep(Duration::from_millis(10));
    ///         }
    ///     }
    /// }
    /// ```
    pub fn exchange_job(&mut self, now: Instant, slot: &mut JobSlot, vehicle: &mut D::Vehicle) -> bool {
        if self.storage.log.is_busy() {
            let is_done = slot.is_done();
            self.storage_done(now, is_done, slot.page_mut(), vehicle);
            slot.put(None);
            return true;
        }
        let job = self.storage_job(now, slot.page_mut(), vehicle);
        slot.put(job)
    }

    /// Attaches `store` and reads what is stored, as [`restore`](Self::restore) does, on an async driver. Call it before
    /// other tasks use the stack. For a stack that is shared from the start, call [`attach_storage`](Self::attach_storage)
    /// instead: the first jobs read what is stored, and [`is_restoring`](Self::is_restoring) says when that is done.
    ///
    /// If the future is dropped, some of the content is restored, and later jobs read the rest.
    ///
    /// # Errors
    ///
    /// Returns an error if something is damaged or cannot be read (G-18): see [`restore`](Self::restore).
    #[cfg(feature = "embedded-storage-async")]
    pub async fn restore_async<F: embedded_storage_async::nor_flash::NorFlash>(
        &mut self,
        now: Instant,
        store: &mut storage::AsyncStore<F>,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), RestoreErrors> {
        self.attach_storage(now, store.region(), vehicle);
        while self.is_restoring() && self.exchange_job(now, store.slot(), vehicle) {
            store.run().await;
        }
        self.restore_errors().result()
    }

    /// Whether the stored content is being read for the first time, after [`attach_storage`](Self::attach_storage).
    /// `false` once it is restored, or could not be read; [`restore_errors`](Self::restore_errors) has what went wrong.
    pub fn is_restoring(&self) -> bool {
        self.storage.is_restoring()
    }

    /// Returns what was not restored so far. Content that was restored late is no longer in it.
    pub fn restore_errors(&self) -> RestoreErrors {
        self.storage.errors
    }

    /// Attaches `store` and reads the signing key, the parameters, the plans and the firmware's own records at startup, as
    /// far as they are declared. Call it once, before the loop. It reads the whole region, and blocks for as long as the
    /// flash takes. If nothing was ever stored, nothing changes.
    ///
    /// The vehicle is told of each parameter that does not have its default. The stack and the vehicle check the plans
    /// as in an upload. A plan that this firmware cannot fly, or has no room for, does not become live, and a text
    /// reports it.
    ///
    /// # Errors
    ///
    /// Returns an error if something is damaged or cannot be read (G-18), and a text reports each. The store is in use
    /// nevertheless, and everything else was restored.
    ///
    /// - [`plans`](RestoreErrors::plans): the plans are empty, or older than the damaged ones. A vehicle that must not fly
    ///   without its geofence learns here that there may have been another one.
    /// - [`parameters`](RestoreErrors::parameters): they have their defaults, or older values.
    /// - [`signing`](RestoreErrors::signing): there is no key, unless the firmware has set one, but the links are not
    ///   open. Links that would sign, or refuse unsigned frames, accept nothing until there is a key. Only links for
    ///   provisioning (`LinkSigning::provisioning`) accept SETUP_SIGNING, which ends this state by setting a key or by
    ///   removing it. `Signing::set_key` and `clear_key` end it too. The unsigned text that reports it is repeated, at
    ///   most every 10 s, when a frame is refused on a link for provisioning.
    ///
    /// Content that cannot be read is read again by [`persist`](Self::persist): the key at any time, parameters and plans
    /// while the vehicle is disarmed. Parameters that still have their defaults are then restored, and plans that were
    /// not uploaded meanwhile go live. [`plan_changed`](crate::Plans::plan_changed) informs the vehicle, and a text the
    /// operators.
    #[inline(never)]
    pub fn restore<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut Store<F>,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), RestoreErrors> {
        self.attach_storage(now, store.region(), vehicle);
        while self.is_restoring() && self.run_job(now, store, vehicle).is_some() {}
        self.restore_errors().result()
    }

    /// Does the next step of storage on a blocking driver: erases at most one unit, or writes at most 256 bytes,
    /// and reads at most 1 KiB. It may block for as long as that takes. Returns true if there is more to do at once.
    ///
    /// It writes only while the vehicle [permits](crate::Vehicle::may_persist) it. Plans are written when they were
    /// uploaded. With [`Durability::Durable`](crate::plan::Durability::Durable) the final answer to an upload waits for
    /// this: call it in every pass of the loop, or from an idle task. Units are erased in advance, so that a plan is
    /// stored within a second of its last item even if an erase takes 100 ms.
    ///
    /// Parameters are written about a second after a change, at most every ten seconds; the signing key after a change;
    /// and the signing time every 55 s. If the vehicle does not permit writing in flight, a restart in flight begins
    /// with the time of take-off, until the first signed frame provides a later time. See also `Signing::set_time`.
    #[inline(never)]
    pub fn persist<F: NorFlash>(&mut self, now: Instant, store: &mut Store<F>, vehicle: &mut D::Vehicle) -> bool {
        // A page is copied in four jobs: read, write, write its end, check. It is not left half written.
        const JOBS: u8 = 4;
        for done in 0..2 * JOBS {
            let was_within = self.storage.log.is_within_page();
            let Some(is_erase) = self.run_job(now, store, vehicle) else { return done > 0 };
            let is_within = self.storage.log.is_within_page();
            let is_end = was_within || done.wrapping_add(1) >= JOBS;
            if is_erase || is_end && !is_within {
                break;
            }
        }
        true
    }

    /// Runs the next job, if there is one. Returns whether it has erased.
    #[inline(never)]
    fn run_job<F: NorFlash>(&mut self, now: Instant, store: &mut Store<F>, vehicle: &mut D::Vehicle) -> Option<bool> {
        let job = self.storage_job(now, store.page_mut(), vehicle)?;
        let is_done = store.carry_out(&job);
        self.storage_done(now, is_done, store.page_mut(), vehicle);
        Some(matches!(job, Job::Erase { .. }))
    }
}

/// With `storage: { records: N }`.
impl<D: Declares<Records = RecordService<N>>, const LINKS: usize, const N: usize> Stack<D, LINKS> {
    /// Has one of the firmware's own [records](crate::storage::Records) written, as soon as storage is free and the
    /// vehicle permits it. Does nothing if there is no record of this number.
    pub fn save_record(&mut self, number: u8) {
        self.services.records.save(number);
    }
}

/// With `parameters` (P-17).
impl<D, const LINKS: usize> Stack<D, LINKS>
where
    D: Declares<Parameters: ParamTable, Param = ParamService>,
    D::Vehicle: Parameters<Table = D::Parameters>,
{
    /// Schedules the parameters for writing at once, like MAV_CMD_PREFLIGHT_STORAGE, if some are not stored yet or what is
    /// stored is damaged (G-18): for use before a reboot. Afterwards, [`persist`](Self::persist) returns false once they are stored, or cannot be.
    pub fn save_parameters(&mut self, now: Instant) {
        self.services.param.write_now(now, &mut self.parameters);
    }
}
