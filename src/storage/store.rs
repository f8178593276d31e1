//! Runs the jobs of the journal on a blocking driver.

use embedded_storage::nor_flash::NorFlash;

use super::job::{Job, JobSlot};
use super::page::{PAGE, Page};
use super::region::Region;

/// A region of a storage with a blocking driver, for everything that a firmware stores.
///
/// The driver is a [`NorFlash`]: of the microcontroller's flash, of a chip, of an FRAM or EEPROM (the package
/// `mavstack-fram`), or a part of one that others use too. `WRITE_SIZE` must divide 256, `READ_SIZE` 32, and
/// `ERASE_SIZE` must divide 256 or be a multiple of it. [`Stack::restore`](crate::Stack::restore) reads all of the
/// region, and [`Stack::persist`](crate::Stack::persist) writes to it in steps.
///
/// ```
/// # use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
/// # use mavstack::prelude::*;
/// # use mavstack::parameters;
/// use mavstack::storage::Store;
///
/// # struct Flash;
/// # impl ErrorType for Flash { type Error = NorFlashErrorKind; }
/// # impl ReadNorFlash for Flash {
/// #     const READ_SIZE: usize = 1;
/// #     fn read(&mut self, _: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> { bytes.fill(0xFF); Ok(()) }
/// #     fn capacity(&self) -> usize { 65_536 }
/// # }
/// # impl NorFlash for Flash {
/// #     const WRITE_SIZE: usize = 8;
/// #     const ERASE_SIZE: usize = 2_048;
/// #     fn erase(&mut self, _: u32, _: u32) -> Result<(), NorFlashErrorKind> { Ok(()) }
/// #     fn write(&mut self, _: u32, _: &[u8]) -> Result<(), NorFlashErrorKind> { Ok(()) }
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
/// # let now = Instant::ZERO;
/// # let (mut rover, is_running) = (Rover, false);
/// # let mut stack = StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600)]);
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 1, parameters: Tuning, storage)]
/// struct Mavlink;
///
/// const REGION: core::ops::Range<u32> = 0x8000..0xC000;
/// const _: () = assert!(Store::<Flash>::region_len::<Mavlink>() <= REGION.end - REGION.start);
///
/// let mut store = Store::new(Flash, REGION);
/// if let Err(errors) = stack.restore(now, &mut store, &mut rover) {
///     // A text has reported each content that could not be read.
///     assert!(errors.parameters.is_some());
/// }
/// while is_running {
///     // … fly, and poll the stack
///     stack.persist(now, &mut store, &mut rover);
/// }
/// ```
pub struct Store<F> {
    flash: F,
    region: Region,
    slot: JobSlot,
}

/// Returns the write unit and the erase unit of a storage.
#[allow(clippy::as_conversions, clippy::panic, reason = "const-evaluated; checked")]
pub(super) const fn units(read_size: usize, write_size: usize, erase_size: usize) -> (u32, u32) {
    assert!(read_size > 0 && 32usize.is_multiple_of(read_size), "READ_SIZE must divide 32");
    assert!(erase_size <= 1 << 30 && write_size <= PAGE, "ERASE_SIZE must be at most 2^30, and WRITE_SIZE 256");
    (write_size as u32, erase_size as u32)
}

/// Returns the length of two segments for this many pages, in bytes, with this erase unit.
pub(super) const fn region_len(erase_size: u32, pages: u32) -> u32 {
    match pages.saturating_mul(256).checked_next_multiple_of(Region::unit_of(erase_size)) {
        Some(len) => len.saturating_mul(2),
        None => u32::MAX,
    }
}

/// Implements a store on drivers of one kind.
macro_rules! store {
    ($Store:ident, $NorFlash:path) => {
        impl<F: $NorFlash> $Store<F> {
            const UNITS: (u32, u32) = $crate::storage::store::units(F::READ_SIZE, F::WRITE_SIZE, F::ERASE_SIZE);

            /// Returns a store in this region of the storage, in bytes. Bytes at its ends that do not fill an erase
            /// unit are not used. Content that does not fit a region is not stored, which a text reports. Reads nothing
            /// yet.
            pub const fn new(flash: F, region: core::ops::Range<u32>) -> Self {
                let (write_size, erase_size) = Self::UNITS;
                Self { flash, region: Region::new(region, write_size, erase_size), slot: JobSlot::new() }
            }

            /// Returns the length of two segments for this many pages, in bytes.
            pub(crate) const fn region_len_for(pages: u32) -> u32 {
                $crate::storage::store::region_len(Self::UNITS.1, pages)
            }
        }

        impl<F> $Store<F> {
            /// Returns the region, for [`attach_storage`](crate::Stack::attach_storage).
            pub const fn region(&self) -> Region {
                self.region
            }

            /// Returns the slot for [`exchange_job`](crate::Stack::exchange_job).
            pub const fn slot(&mut self) -> &mut JobSlot {
                &mut self.slot
            }

            /// Returns the storage.
            pub const fn flash(&self) -> &F {
                &self.flash
            }

            /// Returns the storage. Do not write to the store's region: that may damage the stored content.
            pub const fn flash_mut(&mut self) -> &mut F {
                &mut self.flash
            }

            /// Returns the storage and drops the store.
            pub fn into_inner(self) -> F {
                self.flash
            }
        }

        /// Omits the storage, whose `Debug` may show the key (SEC-15).
        impl<F> core::fmt::Debug for $Store<F> {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(stringify!($Store))
            }
        }

        #[cfg(feature = "defmt")]
        impl<F> defmt::Format for $Store<F> {
            fn format(&self, f: defmt::Formatter<'_>) {
                defmt::write!(f, "{=str}", stringify!($Store));
            }
        }
    };
}
#[cfg(feature = "embedded-storage-async")]
pub(super) use store;

store!(Store, NorFlash);

impl<F: NorFlash> Store<F> {
    /// Runs the job in the [slot](Self::slot), and keeps its result there. Does nothing if there is none, or if it has
    /// run before. Blocks for one operation of the driver.
    ///
    /// This is for a task of its own, which locks a shared stack only to [exchange the
    /// job](crate::Stack::exchange_job). [`Stack::persist`](crate::Stack::persist) does both for a firmware with one
    /// loop.
    pub fn run(&mut self) {
        let Self { flash, slot, .. } = self;
        if let Some((job, page)) = slot.take() {
            let is_done = carry_out(flash, &job, page);
            slot.finish(is_done);
        }
    }

    /// Carries out a job. Returns whether it succeeded.
    pub(crate) fn carry_out(&mut self, job: &Job) -> bool {
        carry_out(&mut self.flash, job, self.slot.page_mut())
    }
}

fn carry_out<F: NorFlash>(flash: &mut F, job: &Job, page: &mut Page) -> bool {
    let result = match job {
        Job::Read { offset, range } => flash.read(*offset, page.bytes_mut().get_mut(range.clone()).unwrap_or_default()),
        Job::Write { offset, range } => flash.write(*offset, page.bytes().get(range.clone()).unwrap_or_default()),
        Job::Erase { offset, len } => flash.erase(*offset, offset.saturating_add(*len)),
    };
    result.is_ok()
}

impl<F> Store<F> {
    pub(crate) const fn page_mut(&mut self) -> &mut Page {
        self.slot.page_mut()
    }
}
