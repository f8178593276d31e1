//! Runs the jobs of the journal on an async driver.

use embedded_storage_async::nor_flash::NorFlash;

use super::job::{Job, JobSlot};
use super::region::Region;
use super::store::store;

/// A region of a storage with an async driver, for everything that a firmware stores. Needs the feature
/// `embedded-storage-async`.
///
/// The driver is an `embedded_storage_async::nor_flash::NorFlash`. Its units are limited as those of a
/// [`Store`](super::Store) are.
///
/// While a job runs, the store borrows nothing but the driver and its own page. A stack that several tasks share is
/// locked only to exchange a job, so links are served and heartbeats are sent during an erase of seconds:
///
/// ```
/// # use core::cell::RefCell;
/// # use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
/// # use mavstack::prelude::*;
/// # use mavstack::parameters;
/// # struct Flash;
/// # impl ErrorType for Flash { type Error = NorFlashErrorKind; }
/// # impl ReadNorFlash for Flash {
/// #     const READ_SIZE: usize = 1;
/// #     async fn read(&mut self, _: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> { bytes.fill(0xFF); Ok(()) }
/// #     fn capacity(&self) -> usize { 65_536 }
/// # }
/// # impl NorFlash for Flash {
/// #     const WRITE_SIZE: usize = 8;
/// #     const ERASE_SIZE: usize = 2_048;
/// #     async fn erase(&mut self, _: u32, _: u32) -> Result<(), NorFlashErrorKind> { Ok(()) }
/// #     async fn write(&mut self, _: u32, _: &[u8]) -> Result<(), NorFlashErrorKind> { Ok(()) }
/// # }
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
/// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
/// #     }
/// # }
/// # impl Parameters for Rover { type Table = Tuning; }
/// # parameters! { pub struct Tuning { CRUISE: f32 = 5.0, 0.5..=15.0, "m/s"; } }
/// # static PULSE: Pulse = Pulse::new();
/// # fn now() -> Instant { Instant::ZERO }
/// # async fn sleep(_: Duration) {}
/// # struct Shared(RefCell<(StackOf<Mavlink>, Rover)>);
/// # impl Shared {
/// #     fn lock<T>(&self, call: impl FnOnce(&mut StackOf<Mavlink>, &mut Rover) -> T) -> T {
/// #         let (stack, vehicle) = &mut *self.0.borrow_mut();
/// #         call(stack, vehicle)
/// #     }
/// # }
/// use mavstack::storage::AsyncStore;
///
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 1, parameters: Tuning, storage)]
/// struct Mavlink;
///
/// const _: () = assert!(AsyncStore::<Flash>::region_len::<Mavlink>() <= 0x4000);
///
/// /// Before the tasks start, nothing shares the stack.
/// async fn start(stack: &mut StackOf<Mavlink>, rover: &mut Rover) -> AsyncStore<Flash> {
///     let mut store = AsyncStore::new(Flash, 0x8000..0xC000);
///     if let Err(errors) = stack.restore_async(now(), &mut store, rover).await {
///         let _ = errors; // a text has reported each content that could not be read
///     }
///     store
/// }
///
/// /// The task for the storage. Other tasks lock the stack to poll it.
/// async fn storage_task(mut store: AsyncStore<Flash>, shared: &Shared) {
///     loop {
///         let has_job = shared.lock(|stack, rover| stack.exchange_job(now(), store.slot(), rover));
///         if has_job {
///             store.run().await; // the stack is not locked
///         } else {
///             sleep(Duration::from_millis(10)).await;
///         }
///     }
/// }
/// # let mut stack = StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600)]);
/// # let mut waker = core::task::Context::from_waker(core::task::Waker::noop());
/// # let started = core::pin::pin!(start(&mut stack, &mut Rover)).as_mut().poll(&mut waker);
/// # assert!(started.is_ready());
/// # let _ = storage_task;
/// # use core::future::Future;
/// ```
///
/// # Cancellation
///
/// The future of [`run`](Self::run) may be dropped at any time. The next [`exchange_job`](crate::Stack::exchange_job)
/// counts its job as failed, like an error of the driver: a durable upload ends with ERROR, other content is written
/// again at another place, and a read is repeated. Nothing that was stored is lost. The driver must cope with its own
/// dropped futures: its next call must wait until the flash has finished.
///
/// A task that was aborted may go on with the same store. If the store was dropped too, restore a new one.
pub struct AsyncStore<F> {
    flash: F,
    region: Region,
    slot: JobSlot,
}

store!(AsyncStore, NorFlash);

impl<F: NorFlash> AsyncStore<F> {
    /// Runs the job in the [slot](Self::slot), and keeps its result there. Returns at once if there is none.
    ///
    /// A job runs once: another call before the next [`exchange_job`](crate::Stack::exchange_job) does nothing.
    pub async fn run(&mut self) {
        let Self { flash, slot, .. } = self;
        let Some((job, page)) = slot.take() else { return };
        let result = match job {
            Job::Read { offset, range } => {
                flash.read(offset, page.bytes_mut().get_mut(range).unwrap_or_default()).await
            }
            Job::Write { offset, range } => flash.write(offset, page.bytes().get(range).unwrap_or_default()).await,
            Job::Erase { offset, len } => flash.erase(offset, offset.saturating_add(len)).await,
        };
        slot.finish(result.is_ok());
    }
}
