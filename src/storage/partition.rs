//! A part of a flash that several users share.

use core::cell::RefCell;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

/// A part of a flash that has other users too: the firmware's own log, a bootloader, another store. It is a flash of
/// its own, whose addresses begin at 0.
///
/// HALs lend the flash of a microcontroller once. Put the driver into a [`RefCell`], and give each user its partition:
///
/// ```
/// # use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
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
/// use core::cell::RefCell;
/// use mavstack::storage::{Partition, Store};
///
/// let flash = RefCell::new(Flash);
/// let mut log = Partition::new::<0x8000, 0xC000>(&flash);
/// let mut store = Store::new(Partition::new::<0xC000, 0x1_0000>(&flash), 0..0x4000);
///
/// log.write(0, &[1; 8]).unwrap(); // at 0x8000 of the flash
/// # let _ = &mut store;
/// ```
///
/// A [`RefCell`] is for users in one context: one loop, or the tasks of one executor. Each call borrows the flash and
/// gives it back. If an interrupt uses the flash too, share it by the means of the HAL or of `embassy-sync`.
///
/// A firmware that runs the [jobs](super::Job) itself needs no partition: their addresses are those of the whole flash,
/// so the owner of the driver runs them between its other calls.
#[derive(Debug)]
pub struct Partition<'a, F> {
    flash: &'a RefCell<F>,
    start: u32,
    len: u32,
}

/// Another user of the same partition: two users must not write the same bytes.
impl<F> Clone for Partition<'_, F> {
    fn clone(&self) -> Self {
        Self { ..*self }
    }
}

/// The error of a partition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PartitionError<E> {
    /// The flash failed.
    Flash(E),
    /// The call reaches beyond the end of the partition.
    OutOfBounds,
    /// The flash is borrowed: another user holds it across a call.
    InUse,
}

impl<E: core::fmt::Debug> core::fmt::Display for PartitionError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Flash(error) => write!(f, "the flash failed: {error:?}"),
            Self::OutOfBounds => {
                f.write_str("the call reaches beyond the end of the partition: make the region smaller")
            }
            Self::InUse => f.write_str("another user holds the flash: borrow it for one call at a time"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for PartitionError<E> {}

impl<E: NorFlashError> NorFlashError for PartitionError<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Flash(error) => error.kind(),
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::InUse => NorFlashErrorKind::Other,
        }
    }
}

impl<'a, F: NorFlash> Partition<'a, F> {
    /// Returns the part of a flash from `START` to `END`, in bytes. Both must be multiples of the erase unit:
    ///
    /// ```compile_fail
    /// # use embedded_storage::nor_flash::NorFlash;
    /// # use mavstack::storage::Partition;
    /// # struct Flash;
    /// # impl embedded_storage::nor_flash::ErrorType for Flash { type Error = core::convert::Infallible; }
    /// # impl embedded_storage::nor_flash::ReadNorFlash for Flash {
    /// #     const READ_SIZE: usize = 1;
    /// #     fn read(&mut self, _: u32, _: &mut [u8]) -> Result<(), Self::Error> { Ok(()) }
    /// #     fn capacity(&self) -> usize { 65_536 }
    /// # }
    /// impl NorFlash for Flash {
    ///     const WRITE_SIZE: usize = 8;
    ///     const ERASE_SIZE: usize = 2_048;
    ///     // …
    /// #     fn erase(&mut self, _: u32, _: u32) -> Result<(), Self::Error> { Ok(()) }
    /// #     fn write(&mut self, _: u32, _: &[u8]) -> Result<(), Self::Error> { Ok(()) }
    /// }
    /// let flash = core::cell::RefCell::new(Flash);
    /// Partition::new::<0x8000, 0x8400>(&flash); // does not compile: END is half an erase unit
    /// ```
    #[allow(
        clippy::as_conversions,
        clippy::arithmetic_side_effects,
        clippy::panic,
        reason = "const-evaluated; checked"
    )]
    pub const fn new<const START: u32, const END: u32>(flash: &'a RefCell<F>) -> Self {
        const {
            assert!(START < END, "the partition must end behind its start");
            assert!(F::ERASE_SIZE > 0 && F::ERASE_SIZE <= 1 << 31, "ERASE_SIZE must be from 1 to 2^31");
            assert!(
                START.is_multiple_of(F::ERASE_SIZE as u32) && END.is_multiple_of(F::ERASE_SIZE as u32),
                "a partition must start and end at an erase unit of the flash: at a multiple of ERASE_SIZE"
            );
        }
        Self { flash, start: START, len: const { END - START } }
    }
}

impl<F: ErrorType> Partition<'_, F> {
    /// Calls the flash, with the address of `offset`, if `len` bytes from there on are in the partition.
    fn call(
        &self,
        offset: u32,
        len: usize,
        call: impl FnOnce(&mut F, u32) -> Result<(), F::Error>,
    ) -> Result<(), PartitionError<F::Error>> {
        let end = u32::try_from(len).ok().and_then(|len| offset.checked_add(len));
        if end.is_none_or(|end| end > self.len) {
            return Err(PartitionError::OutOfBounds);
        }
        let mut flash = self.flash.try_borrow_mut().map_err(|_| PartitionError::InUse)?;
        call(&mut flash, self.start.wrapping_add(offset)).map_err(PartitionError::Flash)
    }
}

impl<F: ErrorType> ErrorType for Partition<'_, F> {
    type Error = PartitionError<F::Error>;
}

impl<F: ReadNorFlash> ReadNorFlash for Partition<'_, F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.call(offset, bytes.len(), |flash, at| flash.read(at, bytes))
    }

    /// Returns the length of the partition, in bytes.
    fn capacity(&self) -> usize {
        usize::try_from(self.len).unwrap_or(usize::MAX)
    }
}

impl<F: NorFlash> NorFlash for Partition<'_, F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        let len = to.checked_sub(from).and_then(|len| usize::try_from(len).ok()).unwrap_or(usize::MAX);
        self.call(from, len, |flash, at| flash.erase(at, self.start.wrapping_add(to)))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.call(offset, bytes.len(), |flash, at| flash.write(at, bytes))
    }
}
