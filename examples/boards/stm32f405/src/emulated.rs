//! Stands in for `flash.rs` in QEMU, which has no controller for this chip's flash: RAM that survives a reset of the processor.

use core::mem::MaybeUninit;
use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use stm32f4xx_hal::pac::FLASH;

const LEN: usize = 32 * 1024;

/// The whole emulated flash.
pub const REGION: Range<u32> = 0..32 * 1024;

/// Not in `.bss`, which each start clears.
#[allow(unsafe_code, reason = "a section that contains nothing else")]
#[unsafe(link_section = ".uninit.flash")]
static mut BYTES: MaybeUninit<[u8; LEN]> = MaybeUninit::uninit();

/// Each byte is stored inverted, so that the emulator's zeroed RAM reads as erased flash.
pub struct Sectors(&'static mut [u8; LEN]);

impl Sectors {
    /// Takes the flash, which exists once.
    pub fn new(_: FLASH) -> Self {
        let bytes = &raw mut BYTES;
        // SAFETY: this is called once, because there is one FLASH, and the emulator initialises its RAM.
        #[allow(unsafe_code, reason = "RAM that the start-up code does not touch")]
        Self(unsafe { (*bytes).assume_init_mut() })
    }

    fn range(&mut self, from: u32, to: u32) -> Result<&mut [u8], NorFlashErrorKind> {
        self.0.get_mut(from as usize..to as usize).ok_or(NorFlashErrorKind::OutOfBounds)
    }
}

impl ErrorType for Sectors {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Sectors {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let stored = self.range(offset, offset + bytes.len() as u32)?;
        bytes.iter_mut().zip(stored).for_each(|(byte, stored)| *byte = !*stored);
        Ok(())
    }

    fn capacity(&self) -> usize {
        LEN
    }
}

impl NorFlash for Sectors {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = 4 * 1024;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.range(from, to)?.fill(0);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let stored = self.range(offset, offset + bytes.len() as u32)?;
        // Flash only clears bits.
        stored.iter_mut().zip(bytes).for_each(|(stored, byte)| *stored |= !*byte);
        Ok(())
    }
}
