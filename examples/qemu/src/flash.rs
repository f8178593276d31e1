//! Simulates the flash for plans, parameters and the signing key. It uses a part of the board's PSRAM, which survives a reset of
//! the processor in the emulator, and behaves like NOR flash. The flight logs are in another part of it.
#![allow(unsafe_code, reason = "memory of the board")]

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use mavstack_demo::LogMemory;

/// Start of the PSRAM. Nothing else uses it: `memory.x` does not contain it.
const BASE: usize = 0x2100_0000;

/// The address of the flight logs, behind the flash.
const LOGS: usize = BASE + PsramFlash::LEN as usize;

/// The address of the words in which the emulator puts options, at a distance from the start that does not depend on the length of the
/// logs: `xtask/src/qemu.rs` has it too. The first word is the UDP port of ground stations. The second one is not 0 if the vehicle runs
/// without components.
pub(crate) const OPTIONS: usize = BASE + 0x10_0000;
const _: () = assert!(
    LOGS + size_of::<LogMemory>() <= OPTIONS,
    "the flight logs overlap the options: move OPTIONS here and in xtask/src/qemu.rs"
);

/// The flash: 192 KiB in erase units of 4 KiB, written in words, like serial NOR or internal flash.
pub struct PsramFlash(());

impl PsramFlash {
    /// Its size, in bytes.
    pub const LEN: u32 = 192 * 1024;

    /// Returns the flash. The value owns that memory; [`Board::take`](crate::board::Board::take) creates it once.
    pub(crate) const fn new() -> Self {
        Self(())
    }

    /// Returns the address of the byte at `offset`, which must be less than [`LEN`](Self::LEN).
    fn byte(offset: u32) -> *mut u8 {
        core::ptr::with_exposed_provenance_mut(BASE + offset as usize)
    }
}

/// Returns the memory of the flight logs, behind the flash. A reset keeps it too.
pub fn logs() -> &'static LogMemory {
    // SAFETY: a part of the PSRAM, aligned to 4 KiB, which nothing else uses. It consists of atomics, so any content is valid, and it
    // may be shared.
    unsafe { &*core::ptr::with_exposed_provenance(LOGS) }
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
            *byte = unsafe { Self::byte(offset).read_volatile() };
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
            unsafe { Self::byte(offset).write_volatile(0xFF) };
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        for (offset, byte) in (offset..).zip(bytes) {
            let cell = Self::byte(offset);
            // SAFETY: as for `erase`. Writing only clears bits.
            unsafe { cell.write_volatile(cell.read_volatile() & byte) };
        }
        Ok(())
    }
}
