//! `erase-stall`: a driver that erases before each write, as one that rewrites a large sector does. The processor stands still for 2 s.

use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};

use crate::flash::{self, Sectors};

/// The last sector is not used for storage, so that it can be erased.
pub const REGION: Range<u32> = flash::REGION.start..SPARE;
const SPARE: u32 = flash::REGION.end - Sectors::ERASE_SIZE as u32;
/// The emulator erases a sector in 45 ms.
const ERASES: usize = 2_000 / 45;

/// The flash with this driver.
pub struct Memory(Sectors);

/// Returns the storage.
pub fn new(sectors: Sectors) -> Memory {
    Memory(sectors)
}

impl ErrorType for Memory {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = Sectors::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for Memory {
    // A page of the flash: what is stored is written at once.
    const WRITE_SIZE: usize = 256;
    const ERASE_SIZE: usize = Sectors::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        for _ in 0..ERASES {
            self.0.erase(SPARE, flash::REGION.end)?;
        }
        self.0.write(offset, bytes)
    }
}
