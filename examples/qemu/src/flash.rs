//! Simulates the flash for plans, parameters and the signing key. It uses a part of the board's PSRAM, which survives a reset of
//! the processor in the emulator, and behaves like NOR flash.
#![allow(unsafe_code, reason = "memory of the board")]

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// Start of the PSRAM. Nothing else uses it: `memory.x` does not contain it.
const BASE: usize = 0x2100_0000;

/// A partition of the flash: 64 KiB in erase units of 4 KiB, written in words, like serial NOR or internal flash.
pub struct PsramFlash {
    /// Index of the partition. Partitions are contiguous.
    part: usize,
}

impl PsramFlash {
    /// Size of a partition, in bytes.
    pub const LEN: u32 = 64 * 1024;

    /// Returns partition 0, 1 or 2. The value owns that memory; [`Board::take`](crate::board::Board::take) creates each once.
    pub(crate) const fn new(part: u8) -> Self {
        Self { part: part as usize }
    }

    /// Returns the address of the byte at `offset`, which must be less than [`LEN`](Self::LEN).
    fn byte(&self, offset: u32) -> *mut u8 {
        core::ptr::with_exposed_provenance_mut(BASE + self.part * Self::LEN as usize + offset as usize)
    }
}

impl ErrorType for PsramFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for PsramFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        for (offset, byte) in (offset..).zip(bytes) {
            // SAFETY: within the PSRAM, as checked above.
            *byte = unsafe { self.byte(offset).read_volatile() };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        Self::LEN as usize
    }
}

impl NorFlash for PsramFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        for offset in from..to {
            // SAFETY: within the PSRAM, as checked above; `&mut self` is exclusive.
            unsafe { self.byte(offset).write_volatile(0xFF) };
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        for (offset, byte) in (offset..).zip(bytes) {
            let cell = self.byte(offset);
            // SAFETY: as for `erase`. Writing only clears bits.
            unsafe { cell.write_volatile(cell.read_volatile() & byte) };
        }
        Ok(())
    }
}
