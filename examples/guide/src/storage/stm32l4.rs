//! The flash of an STM32L4 or G4: reads that survive a half-written double word.

#[cfg(target_arch = "arm")]
mod registers;
#[cfg(not(target_arch = "arm"))]
mod registers {
    //! A flash whose second double word is half-written.
    pub fn clear_eccd() -> bool {
        true
    }

    pub fn barrier() {}
}

use core::sync::atomic::{AtomicBool, Ordering, compiler_fence};

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use registers::{barrier, clear_eccd};

static ECC_ERROR: AtomicBool = AtomicBool::new(false);

/// The handler of the NMI: `#[exception] unsafe fn NonMaskableInt()` in cortex-m-rt.
fn nmi() {
    if clear_eccd() {
        ECC_ERROR.store(true, Ordering::Relaxed);
    } else {
        clock_has_failed(); // the other source of the NMI
    }
}

struct Reader<F>(F);

impl<F: ErrorType> ErrorType for Reader<F> {
    type Error = NorFlashErrorKind;
}

impl<F: ReadNorFlash> ReadNorFlash for Reader<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        ECC_ERROR.store(false, Ordering::Relaxed);
        // The compiler moves no read of the flash across the fences.
        compiler_fence(Ordering::SeqCst);
        let result = self.0.read(offset, bytes);
        compiler_fence(Ordering::SeqCst);
        // Wait until the reads are complete and the NMI, which cannot be masked, was taken.
        barrier();
        if ECC_ERROR.load(Ordering::Relaxed) || result.is_err() { Err(NorFlashErrorKind::Other) } else { Ok(()) }
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: NorFlash> NorFlash for Reader<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0.erase(from, to).map_err(|_| NorFlashErrorKind::Other)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.0.write(offset, bytes).map_err(|_| NorFlashErrorKind::Other)
    }
}

fn clock_has_failed() {}

#[cfg(test)]
mod tests {
    use super::*;

    struct Flash;

    impl ErrorType for Flash {
        type Error = NorFlashErrorKind;
    }

    impl ReadNorFlash for Flash {
        const READ_SIZE: usize = 1;

        fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
            bytes.fill(0x5A);
            if at == 8 {
                nmi();
            }
            Ok(())
        }

        fn capacity(&self) -> usize {
            0x8_0000
        }
    }

    #[test]
    fn a_half_written_double_word_is_an_error_and_its_neighbours_are_read() {
        let mut flash = Reader(Flash);
        assert_eq!(flash.read(0, &mut [0; 8]), Ok(()));
        assert_eq!(flash.read(8, &mut [0; 8]), Err(NorFlashErrorKind::Other));
        assert_eq!(flash.read(16, &mut [0; 8]), Ok(()));
    }
}
