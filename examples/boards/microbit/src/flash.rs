//! The last 32 KiB of the flash, for the mission and the parameters. `memory.x` keeps the firmware out of them.
//!
//! The driver of `nrf51-hal` assumes the nRF52's pages of 4 KiB, so it erases only the first 1 KiB of each 4 KiB.

use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use nrf51_hal::pac::NVMC;

/// The region as addresses, which are also the offsets in the flash.
pub const REGION: Range<u32> = 0x3_8000..0x4_0000;

// `memory.x` compares it with the end of the firmware.
#[allow(unsafe_code, reason = "a symbol for the linker")]
mod symbol {
    core::arch::global_asm!(".global storage_start", ".set storage_start, {}", const super::REGION.start);
}

/// The flash. Erasing a page stops the processor for 22 ms, writing a word for 46 µs.
pub struct Pages(NVMC);

impl Pages {
    /// Takes the controller.
    pub fn new(controller: NVMC) -> Self {
        Self(controller)
    }

    fn wait(&self) {
        while self.0.ready.read().ready().is_busy() {}
    }
}

/// Returns whether the driver may access this range: only the region.
fn check(from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
    if REGION.start <= from && from <= to && to <= REGION.end { Ok(()) } else { Err(NorFlashErrorKind::OutOfBounds) }
}

impl ErrorType for Pages {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Pages {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check(offset, offset + bytes.len() as u32)?;
        for (address, byte) in (offset..).zip(bytes) {
            // SAFETY: the address is in the region, which is readable and not part of the firmware.
            #[allow(unsafe_code, reason = "memory that the linker does not know")]
            unsafe {
                *byte = (address as *const u8).read_volatile();
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        REGION.end as usize
    }
}

impl NorFlash for Pages {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 1024;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check(from, to)?;
        self.0.config.write(|w| w.wen().een());
        for page in (from..to).step_by(Self::ERASE_SIZE) {
            // SAFETY: the page is in the region.
            #[allow(unsafe_code, reason = "the register takes an address")]
            self.0.erasepage().write(|w| unsafe { w.bits(page) });
            self.wait();
        }
        self.0.config.write(|w| w.wen().ren());
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check(offset, offset + bytes.len() as u32)?;
        let (words, []) = bytes.as_chunks() else { return Err(NorFlashErrorKind::NotAligned) };
        if !offset.is_multiple_of(4) {
            return Err(NorFlashErrorKind::NotAligned);
        }
        self.0.config.write(|w| w.wen().wen());
        for (address, word) in (offset..).step_by(4).zip(words) {
            // SAFETY: the address is aligned and in the region, which writes to flash while WEN is set.
            #[allow(unsafe_code, reason = "memory that the linker does not know")]
            unsafe {
                (address as *mut u32).write_volatile(u32::from_le_bytes(*word));
            }
            self.wait();
        }
        self.0.config.write(|w| w.wen().ren());
        Ok(())
    }
}
