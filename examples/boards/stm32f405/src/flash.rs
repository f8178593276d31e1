//! The last two sectors of the flash, for the mission and the parameters. `memory.x` keeps the firmware out of them.

use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use stm32f4xx_hal::flash::{Error, FlashExt, LockedFlash};
use stm32f4xx_hal::pac::FLASH;

/// Sectors 10 and 11, as offsets in the flash.
pub const REGION: Range<u32> = 0xC_0000..0x10_0000;

/// Owns the flash, and unlocks it for each call: the HAL implements `NorFlash` for a borrow.
pub struct Sectors(LockedFlash);

impl Sectors {
    /// Takes the flash.
    pub fn new(flash: FLASH) -> Self {
        Self(LockedFlash::new(flash))
    }
}

impl ErrorType for Sectors {
    type Error = Error;
}

impl ReadNorFlash for Sectors {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        ReadNorFlash::read(&mut self.0, offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for Sectors {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = 128 * 1024;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        NorFlash::erase(&mut self.0.unlocked(), from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        self.0.unlocked().write(offset, bytes)
    }
}
