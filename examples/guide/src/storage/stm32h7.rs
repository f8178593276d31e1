//! The flash of an STM32H7: reads that survive a half-written word.

#[cfg(target_arch = "arm")]
mod registers;
#[cfg(not(target_arch = "arm"))]
mod registers {
    //! A flash whose second word is half-written.
    use core::sync::atomic::{AtomicBool, Ordering};

    pub static DBECCERR: AtomicBool = AtomicBool::new(false);

    pub fn clear_ecc_error() {
        DBECCERR.store(false, Ordering::Relaxed);
    }

    pub fn has_ecc_error() -> bool {
        DBECCERR.load(Ordering::Relaxed)
    }

    pub fn ignoring_bus_faults<T>(call: impl FnOnce() -> T) -> T {
        call()
    }
}

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use registers::{clear_ecc_error, has_ecc_error, ignoring_bus_faults};

/// A flash whose reads survive a word that a power cut left half-written.
struct Guarded<F>(F);

impl<F: ErrorType> ErrorType for Guarded<F> {
    type Error = NorFlashErrorKind;
}

impl<F: ReadNorFlash> ReadNorFlash for Guarded<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        clear_ecc_error();
        let result = ignoring_bus_faults(|| self.0.read(offset, bytes));
        // A bus fault leaves garbage behind.
        if has_ecc_error() || result.is_err() { Err(NorFlashErrorKind::Other) } else { Ok(()) }
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: NorFlash> NorFlash for Guarded<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0.erase(from, to).map_err(|_| NorFlashErrorKind::Other)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.0.write(offset, bytes).map_err(|_| NorFlashErrorKind::Other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::sync::atomic::Ordering;

    struct Bank2;

    impl ErrorType for Bank2 {
        type Error = NorFlashErrorKind;
    }

    impl ReadNorFlash for Bank2 {
        const READ_SIZE: usize = 1;

        fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
            bytes.fill(0xFF);
            registers::DBECCERR.store(at == 32, Ordering::Relaxed);
            Ok(())
        }

        fn capacity(&self) -> usize {
            0x10_0000
        }
    }

    #[test]
    fn a_half_written_word_is_an_error_and_its_neighbours_are_read() {
        let mut flash = Guarded(Bank2);
        assert_eq!(flash.read(0, &mut [0; 32]), Ok(()));
        assert_eq!(flash.read(32, &mut [0; 32]), Err(NorFlashErrorKind::Other));
        assert_eq!(flash.read(64, &mut [0; 32]), Ok(()));
    }
}
