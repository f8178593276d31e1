//! The flash driver, over the registers of the controller (RM0090, section 3). It is independent of the HAL, so a test on the host runs
//! it against a model of the controller: `tests/storage/stm32f4.rs`.
//!
//! The driver of `stm32f4xx-hal` 0.23 lacks three things that this one does. It clears the errors of earlier operations, such as those
//! that a debugger leaves behind. It flushes the data cache after an erase. It refuses offsets outside the region.

use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

/// Sectors 10 and 11, as offsets in the flash.
pub const REGION: Range<u32> = 0xC_0000..0x10_0000;

/// The length of the sectors from number 5 on, in bytes. The sectors before have 16 or 64 KiB.
const SECTOR: u32 = 128 * 1024;
/// The number that the first sector would have, if all had this length.
const FIRST: u32 = 4;

/// The registers of the controller, by their offsets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Register {
    /// FLASH_ACR
    Access = 0x00,
    /// FLASH_KEYR
    Key = 0x04,
    /// FLASH_SR
    Status = 0x0C,
    /// FLASH_CR
    Control = 0x10,
}

/// The hardware: the controller, and the flash as memory.
pub trait Hardware {
    /// Reads a register.
    fn read(&mut self, register: Register) -> u32;
    /// Writes a register.
    fn write(&mut self, register: Register, value: u32);
    /// Reads the byte at an offset in the flash, which is in [`REGION`].
    fn load(&mut self, offset: u32) -> u8;
    /// Writes the byte at an offset in the flash, which is in [`REGION`]: the controller programs it.
    fn store(&mut self, offset: u32, byte: u8);
}

// FLASH_ACR
const DATA_CACHE_ENABLED: u32 = 1 << 10;
const DATA_CACHE_RESET: u32 = 1 << 12;
// FLASH_SR. A written 1 clears an error.
const BUSY: u32 = 1 << 16;
const WRITE_PROTECTED: u32 = 1 << 4;
/// OPERR, WRPERR, PGAERR, PGPERR and PGSERR.
const ERRORS: u32 = 1 << 1 | 0b1111 << 4;
// FLASH_CR. PSIZE is 0 while bytes are programmed.
const PROGRAM: u32 = 1 << 0;
const ERASE: u32 = 1 << 1;
const SECTOR_NUMBER: u32 = 3;
const START: u32 = 1 << 16;
/// PSIZE of an erase. 0 works at any supply voltage. At 2.7 to 3.6 V, `0b10 << 8` halves the duration.
const ERASE_PSIZE: u32 = 0;
const LOCK: u32 = 1 << 31;
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// An error of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// The range is not in [`REGION`].
    OutOfBounds,
    /// The range does not consist of whole sectors.
    NotAligned,
    /// The controller received a wrong key, and does not unlock before the next reset.
    Locked,
    /// The option bytes protect the sector.
    Protected,
    /// The controller reported another error. The bits are those of FLASH_SR.
    Controller(u32),
}

impl NorFlashError for Error {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            _ => NorFlashErrorKind::Other,
        }
    }
}

/// The sectors of [`REGION`]. Erasing a sector stops the processor for 2 s typically, and 4 s at most.
pub struct Driver<H>(H);

impl<H: Hardware> Driver<H> {
    /// Takes the hardware. The controller is locked again after each operation.
    pub fn new(hardware: H) -> Self {
        Self(hardware)
    }

    /// Runs an operation of the controller.
    fn run(&mut self, control: u32, start: impl FnOnce(&mut H)) -> Result<(), Error> {
        let Self(hardware) = self;
        while hardware.read(Register::Status) & BUSY != 0 {}
        // The errors of earlier operations.
        hardware.write(Register::Status, ERRORS);
        if hardware.read(Register::Control) & LOCK != 0 {
            KEYS.iter().for_each(|key| hardware.write(Register::Key, *key));
            if hardware.read(Register::Control) & LOCK != 0 {
                return Err(Error::Locked);
            }
        }
        hardware.write(Register::Control, control);
        start(hardware);
        while hardware.read(Register::Status) & BUSY != 0 {}
        let errors = hardware.read(Register::Status) & ERRORS;
        hardware.write(Register::Control, LOCK);
        match errors {
            0 => Ok(()),
            _ if errors & WRITE_PROTECTED != 0 => Err(Error::Protected),
            _ => Err(Error::Controller(errors)),
        }
    }

    /// Flushes the data cache, which still has the erased content. The cache must be disabled for its reset.
    fn reset_cache(&mut self) {
        let Self(hardware) = self;
        let access = hardware.read(Register::Access);
        let disabled = access & !DATA_CACHE_ENABLED;
        for value in [disabled, disabled | DATA_CACHE_RESET, disabled, access] {
            hardware.write(Register::Access, value);
        }
    }
}

/// Returns the range of `len` bytes at this offset, if the driver may access it: only the region.
fn range(offset: u32, len: usize) -> Result<Range<u32>, Error> {
    let end = u32::try_from(len).ok().and_then(|len| offset.checked_add(len)).ok_or(Error::OutOfBounds)?;
    if REGION.start <= offset && end <= REGION.end { Ok(offset..end) } else { Err(Error::OutOfBounds) }
}

impl<H> ErrorType for Driver<H> {
    type Error = Error;
}

impl<H: Hardware> ReadNorFlash for Driver<H> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        for (offset, byte) in range(offset, bytes.len())?.zip(bytes) {
            *byte = self.0.load(offset);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        REGION.end as usize
    }
}

impl<H: Hardware> NorFlash for Driver<H> {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = SECTOR as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        let range = range(from, to.checked_sub(from).ok_or(Error::OutOfBounds)? as usize)?;
        if !from.is_multiple_of(SECTOR) || !to.is_multiple_of(SECTOR) {
            return Err(Error::NotAligned);
        }
        for offset in range.step_by(SECTOR as usize) {
            let control = ERASE | ERASE_PSIZE | (FIRST + offset / SECTOR) << SECTOR_NUMBER;
            let result = self.run(control, |hardware| hardware.write(Register::Control, control | START));
            self.reset_cache();
            result?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        let range = range(offset, bytes.len())?;
        // A byte that is written while another one is programmed waits for it.
        self.run(PROGRAM, |hardware| range.zip(bytes).for_each(|(offset, byte)| hardware.store(offset, *byte)))
    }
}
