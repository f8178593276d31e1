//! Persistence: the code between the services and the [log](crate::storage) (D-5, G-13, G-15, M-44, P-17, SEC-11, SEC-12).
//!
//! Storage is used by jobs, apart from polling: an erase of a microcontroller's own flash stops the processor for 100 ms
//! and more. The firmware chooses when a job runs, and the vehicle is asked before each one that writes.

use embedded_storage::nor_flash::NorFlash;

use super::services::{Services, States};
use super::{Cx, Declares, Stack, split};
use crate::dialect::MavSeverity;
use crate::service::param::{ParamService, ParamTable, Parameters};
use crate::storage::{
    self, Event, Job, JobSlot, Kind, Next, Page, Part, Persistent, RecordService, Region, RestoreError, RestoreErrors,
    Storage, Store,
};
use crate::time::Instant;
use crate::types::Vehicle;

/// Defines what is done for each service with stored content: its index, name, type, and field of [`RestoreErrors`].
macro_rules! contents {
    ($($index:literal $service:ident $type:ident $field:ident;)*) => {
        /// The number of services with stored content.
        const CONTENTS: u8 = 0 $(+ { let _: u8 = $index; 1 })*;
        const LEN: usize = [$($index),*].len();

        impl<D: Declares> Services<D> {
            const KINDS: [Kind; LEN] = [$(Kind::of::<D, D::$type>()),*];

            fn attach(&mut self, cx: &mut Cx<'_, D>) {
                $(self.$service.attach(cx);)*
            }

            fn load(
                &mut self,
                cx: &mut Cx<'_, D>,
                index: u8,
                part: &Part<'_>,
                storage: &mut Storage,
            ) -> Result<(), RestoreError> {
                match index {
                    $($index => self.$service.load(cx, part, &mut storage.loading),)*
                    _ => Ok(()),
                }
            }

            /// Ends loading, or learns that nothing can be loaded.
            #[inline(never)]
            fn set_loaded(
                &mut self,
                cx: &mut Cx<'_, D>,
                index: u8,
                result: Result<bool, RestoreError>,
                storage: &mut Storage,
            ) {
                match index {
                    $($index => {
                        Persistent::loaded(&mut self.$service, cx, result, storage.is_late);
                        if let Err(error) = result {
                            storage.errors.$field = Some(error);
                        } else if storage.errors.$field == Some(RestoreError::Unreadable) {
                            storage.errors.$field = None;
                        }
                    })*
                    _ => {}
                }
            }

            /// Has a service wait for its stored content.
            fn on_blocked(&mut self, cx: &mut Cx<'_, D>, states: &mut [States<D>], index: u8) {
                match index {
                    $($index => {
                        let links = states.iter_mut().map(|state| &mut state.$service);
                        Persistent::on_blocked(&mut self.$service, cx, links);
                    })*
                    _ => {}
                }
            }

            /// Whether content may be loaded now. Late, the service is asked whether it still wants it.
            fn may_load(&mut self, cx: &mut Cx<'_, D>, index: u8, is_late: bool) -> bool {
                match index {
                    $($index => self.$service.may_load(cx, is_late),)*
                    _ => false,
                }
            }

            fn on_readable(&mut self, cx: &mut Cx<'_, D>, states: &mut [States<D>], index: u8) -> bool {
                match index {
                    $($index => self.$service.on_readable(cx, states.iter_mut().map(|state| &mut state.$service)),)*
                    _ => false,
                }
            }

            /// Returns the services that must load their stored content again: a bit each.
            fn reloads(&mut self, cx: &mut Cx<'_, D>) -> u8 {
                0 $(| if Persistent::is_reload_requested(&self.$service, cx) { 1 << $index } else { 0 })*
            }

            /// Cancels the writes that the vehicle no longer permits.
            fn cancel_refused(&mut self, cx: &mut Cx<'_, D>, states: &mut [States<D>]) {
                $(
                    let links = states.iter_mut().map(|state| &mut state.$service);
                    self.$service.cancel_if_refused(cx, links);
                )*
            }

            /// Returns what a service has to write.
            #[inline(never)]
            fn pending_write(&mut self, cx: &mut Cx<'_, D>, index: u8) -> Option<storage::Write> {
                match index {
                    $($index if !self.$service.is_paused(cx.now) => {
                        Persistent::pending_write(&mut self.$service, cx)
                    })*
                    _ => None,
                }
            }

            fn fill_page(
                &mut self,
                cx: &mut Cx<'_, D>,
                index: u8,
                record: u8,
                page: u16,
                bytes: &mut [u8],
            ) -> Option<(u8, bool)> {
                match index {
                    $($index => self.$service.fill(cx, record, page, bytes),)*
                    _ => None,
                }
            }

            #[inline(never)]
            fn on_written(&mut self, cx: &mut Cx<'_, D>, states: &mut [States<D>], index: u8, result: Option<bool>) {
                match index {
                    $($index => {
                        let links = states.iter_mut().map(|state| &mut state.$service);
                        match result {
                            Some(is_saved) => self.$service.on_written(cx, links, is_saved),
                            None => Persistent::save_again(&mut self.$service, cx),
                        }
                    })*
                    _ => {}
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

impl<D: Declares> Services<D> {
    /// Returns the number of pages of all records and of the reports that one is lost, and the pages of the longest record.
    #[allow(clippy::as_conversions, reason = "`from` is not const")]
    const fn pages() -> (u32, u16) {
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
    }

    /// Returns a mask of all records: eight bits for each service.
    #[allow(clippy::as_conversions, reason = "`from` is not const")]
    const fn all_records() -> u32 {
        let (mut mask, mut shift, mut kinds): (u32, u32, &[Kind]) = (0, 0, &Self::KINDS);
        while let [kind, rest @ ..] = kinds {
            let records = 1u32.wrapping_shl(kind.records as u32).wrapping_sub(1);
            mask |= records.wrapping_shl(shift);
            (shift, kinds) = (shift.wrapping_add(8), rest);
        }
        mask
    }

    /// Returns the mask of a record.
    fn bit(index: u8, record: u8) -> u32 {
        1u32.wrapping_shl(shift(index).wrapping_add(record.into()))
    }

    /// Returns the mask of all records of a service.
    fn records(index: u8) -> u32 {
        Self::all_records() & 0xFFu32.wrapping_shl(shift(index))
    }

    /// Ends loading, and reports the result.
    fn loaded(&mut self, cx: &mut Cx<'_, D>, index: u8, result: Result<bool, RestoreError>, storage: &mut Storage) {
        self.set_loaded(cx, index, result, storage);
        if let Some(kind) = Self::KINDS.get(usize::from(index)) {
            kind.report(cx, result, storage.is_late);
        }
    }

    /// Begins the next load or save, if there is one.
    fn begin_next(&mut self, cx: &mut Cx<'_, D>, states: &mut [States<D>], storage: &mut Storage, may_write: bool) {
        let reloads = self.reloads(cx);
        for index in 0..CONTENTS {
            if reloads & 1u8.wrapping_shl(index.into()) != 0 {
                storage.to_load |= Self::records(index);
            }
        }
        let mut blocked = 0u8;
        let mut to_load = storage.to_load;
        while let Some(bit) = to_load.checked_ilog2().map(|_| to_load.trailing_zeros()) {
            to_load &= to_load.wrapping_sub(1);
            let [bit, ..] = bit.to_le_bytes();
            let (index, record) = (bit.wrapping_shr(3), bit & 7);
            if !self.may_load(cx, index, storage.is_late) {
                blocked |= 1u8.wrapping_shl(index.into());
                self.on_blocked(cx, states, index);
                continue;
            }
            storage.to_load &= !Self::bit(index, record);
            if self.begin_load(cx, states, storage, index, record) {
                return;
            }
        }
        // Whatever is requested from now on is not late.
        storage.is_late &= storage.to_load != 0;
        if !may_write {
            return;
        }
        for step in 0..CONTENTS {
            let index = storage.turn.wrapping_add(step) % CONTENTS;
            if blocked & 1u8.wrapping_shl(index.into()) != 0 {
                continue;
            }
            let Some(write) = self.pending_write(cx, index) else { continue };
            let Some(kind) = Self::KINDS.get(usize::from(index)) else { continue };
            storage.turn = index.wrapping_add(1) % CONTENTS;
            (storage.service, storage.record, storage.version) = (index, write.record, write.version);
            let number = kind.first.wrapping_add(write.record);
            if storage.log.begin(number, kind.schema, kind.pages, write.is_secret) {
                return;
            }
            self.on_written(cx, states, index, Some(false));
        }
    }

    /// Begins to load a record. Returns false if there is nothing to load.
    fn begin_load(
        &mut self,
        cx: &mut Cx<'_, D>,
        states: &mut [States<D>],
        storage: &mut Storage,
        index: u8,
        record: u8,
    ) -> bool {
        if !self.on_readable(cx, states, index) {
            return false;
        }
        let Some(kind) = Self::KINDS.get(usize::from(index)) else { return false };
        let entry = storage.log.find(kind.first.wrapping_add(record));
        let found = kind.judge(entry);
        (storage.service, storage.record) = (index, record);
        if found == Ok(true) && storage.log.load(kind.first.wrapping_add(record)) {
            return true;
        }
        self.loaded(cx, index, found, storage);
        false
    }

    /// Whether the record that is being written is still the one that is wanted.
    fn is_wanted(&mut self, cx: &mut Cx<'_, D>, storage: &Storage) -> bool {
        let write = self.pending_write(cx, storage.service);
        write.is_some_and(|write| (write.record, write.version) == (storage.record, storage.version))
    }

    fn next_job(
        &mut self,
        cx: &mut Cx<'_, D>,
        states: &mut [States<D>],
        storage: &mut Storage,
        page: &mut Page,
    ) -> Option<Job> {
        let may_write = cx.vehicle.may_persist();
        self.cancel_refused(cx, states);
        if storage.log.writing() != 0 {
            if !self.is_wanted(cx, storage) {
                storage.log.abandon();
            }
        } else if storage.log.is_foreign() {
            self.refuse_all(cx, storage);
        }
        if storage.log.is_waiting() || storage.log.is_foreign() {
            for index in 0..CONTENTS {
                if storage.log.is_foreign() || storage.to_load & Self::records(index) != 0 {
                    self.on_blocked(cx, states, index);
                }
            }
        }
        if storage.log.is_idle() {
            self.begin_next(cx, states, storage, may_write);
        }
        match storage.log.next(cx.now, may_write, page) {
            Next::Job(job) => Some(job),
            Next::Idle => None,
            Next::Content(index) => {
                let (service, record) = (storage.service, storage.record);
                let filled = self.fill_page(cx, service, record, index, page.payload_mut());
                let Some((len, is_last)) = filled else {
                    storage.log.abandon();
                    self.on_written(cx, states, service, Some(false));
                    return None;
                };
                storage.log.put(page, len, is_last);
                match storage.log.next(cx.now, may_write, page) {
                    Next::Job(job) => Some(job),
                    Next::Idle | Next::Content(_) => None,
                }
            }
        }
    }

    /// The log is of another version: nothing can be loaded.
    fn refuse_all(&mut self, cx: &mut Cx<'_, D>, storage: &mut Storage) {
        if core::mem::replace(&mut storage.to_load, 0) != 0 {
            storage.errors.region = Some(RestoreError::Foreign);
            for (index, kind) in (0..).zip(&Self::KINDS) {
                if kind.records > 0 {
                    self.loaded(cx, index, Err(RestoreError::Foreign), storage);
                }
            }
        }
    }

    /// Takes a page of the record that is loaded.
    // Apart from `on_event`, because the checks of a plan need much of the call stack.
    fn on_loaded(&mut self, cx: &mut Cx<'_, D>, storage: &mut Storage, bytes: &[u8], is_first: bool, is_last: bool) {
        let index = storage.service;
        if storage.is_late && !self.may_load(cx, index, true) {
            // The vehicle has armed meanwhile.
            storage.log.end_load();
            storage.to_load |= Self::bit(index, storage.record);
            return self.set_loaded(cx, index, Err(RestoreError::Unreadable), storage);
        }
        let part = Part { record: storage.record, bytes, is_first, is_last, is_late: storage.is_late };
        let result = self.load(cx, index, &part, storage);
        if result.is_err() || is_last {
            storage.log.end_load();
            let is_damaged = Self::KINDS
                .get(usize::from(index))
                .is_some_and(|kind| storage.log.find(kind.first.wrapping_add(storage.record)).is_damaged);
            let result = if is_damaged { Err(RestoreError::Damaged) } else { result.map(|()| true) };
            self.loaded(cx, index, result, storage);
        }
    }

    /// Takes what a job has led to.
    #[inline(never)]
    fn on_event(&mut self, cx: &mut Cx<'_, D>, states: &mut [States<D>], storage: &mut Storage, event: Event) {
        let index = storage.service;
        match event {
            Event::Nothing => {}
            Event::Found => {
                if storage.log.has_other_data() {
                    storage.errors.region = Some(RestoreError::OtherData);
                    storage::report(cx, MavSeverity::WARNING, "Storage has other data, which is erased");
                }
            }
            Event::Unreadable { was_loading } => {
                if was_loading {
                    storage.to_load |= Self::bit(index, storage.record);
                }
                let is_new = !storage.is_late;
                for (index, kind) in (0..).zip(&Self::KINDS) {
                    if storage.to_load & Self::records(index) != 0 {
                        let error = Err(RestoreError::Unreadable);
                        self.set_loaded(cx, index, error, storage);
                        if is_new {
                            kind.report(cx, error, false);
                        }
                    }
                }
                storage.is_late = true;
            }
            // `on_loaded` takes it.
            Event::Loaded { .. } => {}
            Event::Written => {
                self.cancel_refused(cx, states);
                let is_wanted = self.is_wanted(cx, storage);
                self.on_written(cx, states, index, is_wanted.then_some(true));
            }
            Event::Failed { is_doubtful } => {
                // A service that no longer wants it knows that already.
                if self.is_wanted(cx, storage) {
                    self.on_written(cx, states, index, Some(false));
                }
                if is_doubtful {
                    self.on_written(cx, states, index, None);
                }
            }
            Event::Lost(kind) => {
                storage::report(cx, MavSeverity::WARNING, "Stored data was lost, and is stored again");
                if let Some((index, _)) = (0..).zip(&Self::KINDS).find(|(_, known)| known.has(kind)) {
                    self.on_written(cx, states, index, None);
                }
            }
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
        Self::region_len_for(Services::<D>::pages().0)
    }
}

#[cfg(feature = "embedded-storage-async")]
impl<F: embedded_storage_async::nor_flash::NorFlash> storage::AsyncStore<F> {
    /// Returns the least length of the region for everything that the firmware declares, in bytes, like
    /// [`Store::region_len`].
    pub const fn region_len<D: Declares>() -> u32 {
        Self::region_len_for(Services::<D>::pages().0)
    }
}

/// With `storage`.
impl<D: Declares<Storage = Storage>, const LINKS: usize> Stack<D, LINKS> {
    /// Attaches a region of storage: from now on, [`storage_job`](Self::storage_job) reads what is stored, and then writes
    /// what changes. Call it once, before the loop. [`restore`](Self::restore) does it for a blocking driver.
    #[inline(never)]
    pub fn attach_storage(&mut self, now: Instant, region: Region, vehicle: &mut D::Vehicle) {
        let (mut cx, services, _, storage) = split!(&mut *self, now, vehicle, storage);
        (storage.to_load, storage.is_late, storage.errors) = (Services::<D>::all_records(), false, RestoreErrors::NONE);
        storage.log.attach(region, Services::<D>::pages().1);
        services.attach(&mut cx);
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
        let (mut cx, services, states, storage) = split!(&mut *self, now, vehicle, storage);
        if storage.log.is_busy() {
            let event = storage.log.done(now, false, page);
            services.on_event(&mut cx, states, storage, event);
        }
        let job = services.next_job(&mut cx, states, storage, page);
        cx.shared.is_storage_busy = job.is_some();
        job
    }

    /// Takes the result of the [job](Self::storage_job): whether the driver reported success.
    pub fn storage_done(&mut self, now: Instant, is_done: bool, page: &mut Page, vehicle: &mut D::Vehicle) {
        let (mut cx, services, states, storage) = split!(&mut *self, now, vehicle, storage);
        cx.shared.is_storage_busy = false;
        match storage.log.done(now, is_done, page) {
            Event::Loaded { len, is_first, is_last } => {
                services.on_loaded(&mut cx, storage, page.payload(len), is_first, is_last);
            }
            event => services.on_event(&mut cx, states, storage, event),
        }
        if storage.log.is_idle() {
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
        while self.is_restoring() {
            let Some(job) = self.storage_job(now, store.page_mut(), vehicle) else { break };
            let is_done = store.carry_out(&job);
            self.storage_done(now, is_done, store.page_mut(), vehicle);
        }
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
            let Some(job) = self.storage_job(now, store.page_mut(), vehicle) else { return done > 0 };
            let is_done = store.carry_out(&job);
            self.storage_done(now, is_done, store.page_mut(), vehicle);
            let is_within = self.storage.log.is_within_page();
            let is_end = was_within || done.wrapping_add(1) >= JOBS;
            if matches!(job, Job::Erase { .. }) || is_end && !is_within {
                break;
            }
        }
        true
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
