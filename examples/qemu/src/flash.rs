//! A stand-in for the flash that a real flight controller keeps its plans, parameters and key in: a piece of the board's PSRAM,
//! which the emulator leaves alone when the processor is reset, and which behaves as NOR flash does.
#![allow(unsafe_code, reason = "memory of the board")]

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// The PSRAM, which nothing else uses: `memory.x` does not name it.
const BASE: usize = 0x2100_0000;

/// A part of it: 64 KiB in erase units of 4 KiB, written in words: like a serial NOR flash, or a microcontroller's own.
pub struct PsramFlash {
    /// Which of the parts that lie behind one another.
    part: usize,
}

impl PsramFlash {
    /// How large a part is, in bytes.
    pub const LEN: u32 = 64 * 1024;

    /// Part 0, 1 or 2. Whoever has it is the only user of that memory; [`Board::take`](crate::board::Board::take) sees to that.
    pub(crate) const fn new(part: u8) -> Self {
        Self { part: part as usize }
    }

    /// The byte at `offset`, which is less than [`LEN`](Self::LEN).
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
            // SAFETY: within the PSRAM, as was checked.
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
            // SAFETY: within the PSRAM, as was checked; `&mut self` is its only user.
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
