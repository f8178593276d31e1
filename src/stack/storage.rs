//! Persistence: the code between the services and the [journal](crate::storage) (D-5, G-18, P-17).
//!
//! Storage is used by jobs, apart from polling: an erase of a microcontroller's own flash stops the processor for 100 ms
//! and more. The firmware chooses when a job runs, and the vehicle is asked before each one that writes.

use embedded_storage::nor_flash::NorFlash;

use super::parts::HasStorage;
use super::persistence::Persistence;
use super::{Cx, Declares, Stack, split};
use crate::message::Address;
use crate::service::param::{ParamMemory, ParamService, ParamTable, Parameters};
use crate::storage::{Job, JobSlot, Page, RecordService, Region, RestoreErrors, Storage, Store};
use crate::time::Instant;

impl<F: NorFlash> Store<F> {
    /// Returns the least length of the region for everything that the firmware declares, in bytes: two segments of as
    /// many erase units as its longest records fill, one of each. A longer region wears less: see
    /// [the format](crate::storage#wear).
    pub const fn region_len<D: Declares>() -> u32 {
        Self::region_len_for(Persistence::<D>::PAGES.least)
    }
}

#[cfg(feature = "embedded-storage-async")]
impl<F: embedded_storage_async::nor_flash::NorFlash> crate::storage::AsyncStore<F> {
    /// Returns the least length of the region for everything that the firmware declares, in bytes, like
    /// [`Store::region_len`].
    pub const fn region_len<D: Declares>() -> u32 {
        Self::region_len_for(Persistence::<D>::PAGES.least)
    }
}

/// Available if `#[stack]` has the entry `storage`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Attaches a region of storage: from now on, [`storage_job`](Self::storage_job) reads the stored content, and then
    /// writes changes. Call it once, before the loop. [`restore`](Self::restore) does it for a blocking driver.
    // Out of line: it has several callers.
    #[inline(never)]
    pub fn attach_storage(&mut self, now: Instant, region: Region, vehicle: &mut D::Vehicle)
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        let mut persistence = self.persistence(now, vehicle);
        persistence.storage.is_retry = false;
        persistence.storage.errors = RestoreErrors::NONE;
        persistence.storage.journal.attach(region, Persistence::<D>::PAGES.longest_record);
        persistence.attach();
    }

    fn persistence<'a>(&'a mut self, now: Instant, vehicle: &'a mut D::Vehicle) -> Persistence<'a, D>
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        let (cx, services, states, storage) = split!(self, now, vehicle, storage);
        cx.shared.hooks.0 = 0;
        Persistence { cx, services, states, storage }
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
    pub fn storage_job(&mut self, now: Instant, page: &mut Page, vehicle: &mut D::Vehicle) -> Option<Job>
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        if !self.shared.is_begun() {
            return None;
        }
        let address = self.address();
        let mut persistence = self.persistence(now, vehicle);
        if persistence.storage.journal.is_busy() {
            persistence.take_result(false, page);
        }
        let job = persistence.next_job(page);
        persistence.cx.shared.is_storage_busy = job.is_some();
        drop(persistence);
        self.note_address(address);
        job
    }

    /// Tells the links if storage had another system id than that of the address before.
    fn note_address(&mut self, before: Address) {
        let address = self.shared.config.address;
        if D::Parameters::SYSTEM_ID.is_some() && address.get() != before {
            self.set_address(address);
        }
    }

    /// Takes the result of the [job](Self::storage_job): whether the driver reported success.
    pub fn storage_done(&mut self, now: Instant, is_done: bool, page: &mut Page, vehicle: &mut D::Vehicle)
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        let address = self.address();
        let mut persistence = self.persistence(now, vehicle);
        persistence.cx.shared.is_storage_busy = false;
        persistence.take_result(is_done, page);
        if persistence.storage.journal.is_idle() {
            page.wipe();
        }
        drop(persistence);
        self.note_address(address);
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
    /// # use mavstack::prelude::*;
    /// # struct Rover;
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
    /// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
    /// #     }
    /// # }
    /// # #[derive(Stack)]
    /// # #[stack(vehicle: Rover, links: 1, storage)]
    /// # struct Mavlink;
    /// # struct Shared(RefCell<(StackOf<Mavlink>, Rover)>);
    /// # impl Shared {
    /// #     fn lock<T>(&self, call: impl FnOnce(&mut StackOf<Mavlink>, &mut Rover) -> T) -> T {
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
    pub fn exchange_job(&mut self, now: Instant, slot: &mut JobSlot, vehicle: &mut D::Vehicle) -> bool
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        if self.storage.part().journal.is_busy() {
            let is_done = slot.is_done();
            self.storage_done(now, is_done, slot.page_mut(), vehicle);
            slot.put(None);
            return true;
        }
        let job = self.storage_job(now, slot.page_mut(), vehicle);
        slot.put(job)
    }

    /// Attaches `store` and reads its content, as [`restore`](Self::restore) does, on an async driver. Call it before
    /// other tasks use the stack. For a stack that is shared from the start, call
    /// [`attach_storage`](Self::attach_storage) instead: the first jobs read the stored content, and
    /// [`is_restoring`](Self::is_restoring) says when that is done.
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
        store: &mut crate::storage::AsyncStore<F>,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), RestoreErrors>
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        self.attach_storage(now, store.region(), vehicle);
        while self.is_restoring() && self.exchange_job(now, store.slot(), vehicle) {
            store.run().await;
        }
        self.restore_errors().result()
    }

    /// Whether the stored content is being read for the first time, after [`attach_storage`](Self::attach_storage).
    /// `false` once it is restored, or could not be read; [`restore_errors`](Self::restore_errors) has the errors.
    pub fn is_restoring(&self) -> bool
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        self.storage.part().is_restoring()
    }

    /// Returns the content that was not restored so far. Content that was restored late is no longer in it. Without
    /// attached storage it is [empty](RestoreErrors::is_empty).
    pub fn restore_errors(&self) -> RestoreErrors
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        self.storage.part().errors
    }

    /// Attaches `store` and reads the signing key, the parameters, the plans and the firmware's own records at startup, as
    /// far as they are declared. Call it once, before the loop. It reads the whole region, and blocks for as long as the
    /// flash takes. If nothing was ever stored, nothing changes.
    ///
    /// A hook of the vehicle gets each parameter that does not have its default. The stack and the vehicle check the
    /// plans as in an upload. A plan that this firmware cannot fly, or has no room for, does not become live, and a
    /// text reports it.
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
    pub fn restore<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut Store<F>,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), RestoreErrors>
    where
        D::Storage: HasStorage<Part = Storage>,
    {
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
    pub fn persist<F: NorFlash>(&mut self, now: Instant, store: &mut Store<F>, vehicle: &mut D::Vehicle) -> bool
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        // A page is copied in four jobs: read, write, write its end, check. It is not left half written.
        const JOBS: u8 = 4;
        for done in 0..2 * JOBS {
            let was_within = self.storage.part().journal.is_within_page();
            let Some(is_erase) = self.run_job(now, store, vehicle) else { return done > 0 };
            let is_within = self.storage.part().journal.is_within_page();
            let is_end = was_within || done.wrapping_add(1) >= JOBS;
            if is_erase || is_end && !is_within {
                break;
            }
        }
        true
    }

    /// Runs the next job, if there is one. Returns whether it has erased.
    // Out of line: it has several callers.
    #[inline(never)]
    fn run_job<F: NorFlash>(&mut self, now: Instant, store: &mut Store<F>, vehicle: &mut D::Vehicle) -> Option<bool>
    where
        D::Storage: HasStorage<Part = Storage>,
    {
        let job = self.storage_job(now, store.page_mut(), vehicle)?;
        let is_done = store.carry_out(&job);
        self.storage_done(now, is_done, store.page_mut(), vehicle);
        Some(matches!(job, Job::Erase { .. }))
    }
}

/// Available if `#[stack]` has the entry `storage: { records: N }`.
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
    /// Schedules the parameters for writing at once, like MAV_CMD_PREFLIGHT_STORAGE, if some are not stored yet or the
    /// stored ones are damaged (G-18): for use before a reboot. Afterwards, [`persist`](Self::persist) returns false
    /// once they are stored, or cannot be.
    pub fn save_parameters(&mut self, now: Instant) {
        let now = self.enter(now);
        self.services.param.write_now(now, &mut self.parameters);
    }
}
