//! A driver for EEPROM on SPI: the 25xx and M95 series, which have the same commands.
//!
//! EEPROM needs no erasing, but a write takes some milliseconds, and must not cross a page. The driver presents it as NOR
//! flash with erase units of 256 bytes, so that it works with all stores.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

use super::spi::{self, ERASED, op, status};

/// The time between two reads of the status register, in microseconds.
const PERIOD: u32 = 100;
/// The number of reads before the chip counts as stuck: 20 ms, twice the longest write time of the datasheets.
const POLLS: u32 = 200;

/// A driver for EEPROM on SPI.
///
/// These chips have no id that tells their size, so the firmware states it. Their commands, and the bits of their status
/// registers, are the same:
///
/// | chips | made by | capacity | page | write time | writes of a page |
/// |---|---|---|---|---|---|
/// | 25LC640, M95640 | Microchip, ST | 8 KiB | 32 | 5 ms | 1 to 4 million |
/// | 25LC256, M95256 | Microchip, ST | 32 KiB | 64 | 5 ms | 1 to 4 million |
/// | 25LC512, M95512 | Microchip, ST | 64 KiB | 128 | 5 ms | 1 to 4 million |
/// | 25LC1024, M95M01 | Microchip, ST | 128 KiB | 256 | 5 or 6 ms | 1 to 4 million |
/// | M95M02 | ST | 256 KiB | 256 | 5 or 10 ms | 4 million |
///
/// A chip with longer pages works with a page of 256. A page that is too long for the chip damages data.
///
/// A call writes page by page and waits for each, at most 20 ms: then it fails with [`Busy`](EepromError::Busy). An erase
/// of 256 bytes takes `256 / PAGE` times the write time, which is 20 ms with pages of 64 bytes. The processor is free
/// while `delay` waits, if `delay` lets others run.
///
/// ```
/// # use mavstack::storage::Eeprom;
/// # use embedded_hal::delay::DelayNs;
/// # use embedded_hal::spi::SpiDevice;
/// # fn start<S: SpiDevice, D: DelayNs>(spi: S, delay: D) -> Result<(), mavstack::storage::EepromError<S::Error>> {
/// use mavstack::storage::Store;
///
/// let eeprom = Eeprom::new::<0x1_0000, 128>(spi, delay)?; // a 25LC512
/// let store = Store::new(eeprom, 0..0x1_0000);
/// # let _ = store;
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Eeprom<S, D> {
    spi: S,
    delay: D,
    capacity: u32,
    page: u32,
}

/// The error of an EEPROM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum EepromError<E> {
    /// The bus failed.
    Bus(E),
    /// A write was in progress for more than 20 ms, or no chip answers.
    Busy,
    /// No EEPROM answered: writing was enabled, and the status register, which was read as this, does not say so.
    NoAnswer(u8),
    /// The chip's status register write-protects memory. The driver does not change it.
    Protected,
    /// An address or a length is not a multiple of its unit.
    NotAligned,
    /// The call reaches beyond the end of the memory.
    OutOfBounds,
}

impl<E: core::fmt::Debug> core::fmt::Display for EepromError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Bus(error) => write!(f, "the bus failed: {error:?}"),
            Self::Busy => f.write_str("the chip stays busy, or none answers: check the wiring and the chip select"),
            Self::NoAnswer(status) => {
                write!(f, "no EEPROM answers, its status reads as {status:#04X}: check the wiring and the chip select")
            }
            Self::Protected => f.write_str("the chip's status register protects memory: clear its bits BP0 and BP1"),
            Self::NotAligned => {
                f.write_str("an address or a length is not a multiple of its unit: erase 256 bytes at a time")
            }
            Self::OutOfBounds => f.write_str("the region reaches beyond the end of the memory: make it smaller"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for EepromError<E> {}

impl<E: core::fmt::Debug> NorFlashError for EepromError<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::Bus(_) | Self::Busy | Self::NoAnswer(_) | Self::Protected => NorFlashErrorKind::Other,
        }
    }
}

impl<E> EepromError<E> {
    fn of_call(kind: NorFlashErrorKind) -> Self {
        match kind {
            NorFlashErrorKind::NotAligned => Self::NotAligned,
            _ => Self::OutOfBounds,
        }
    }
}

impl<S: SpiDevice, D: DelayNs> Eeprom<S, D> {
    /// Returns the driver of a chip with this capacity and these pages, in bytes: the datasheet has both. A value that is
    /// no power of two, and a page of more than 256 bytes, is a compile error. The bus must be in SPI mode 0 or 3, at
    /// no more than the chip's clock: 5 to 20 MHz.
    ///
    /// It waits for a write that was in progress before a restart, and finds out whether a chip is there: it enables
    /// writing, reads the status register, and disables writing again.
    ///
    /// # Errors
    ///
    /// The bus failed, nothing answered, or the chip is write-protected.
    #[allow(clippy::panic, reason = "const-evaluated")]
    pub fn new<const CAPACITY: u32, const PAGE: u32>(spi: S, delay: D) -> Result<Self, EepromError<S::Error>> {
        const {
            assert!(PAGE.is_power_of_two() && PAGE <= 256, "PAGE must be a power of two, and at most 256");
            assert!(
                CAPACITY.is_power_of_two() && CAPACITY >= 512 && CAPACITY <= 0x100_0000,
                "CAPACITY must be a power of two, in bytes, from 512 to 16 MiB"
            );
        }
        let mut eeprom = Self { spi, delay, capacity: CAPACITY, page: PAGE };
        if eeprom.wait()? & status::BLOCK_PROTECT != 0 {
            return Err(EepromError::Protected);
        }
        eeprom.spi.write(&[op::WREN]).map_err(EepromError::Bus)?;
        let status = spi::status_register(&mut eeprom.spi).map_err(EepromError::Bus)?;
        if status & status::WEL == 0 {
            return Err(EepromError::NoAnswer(status));
        }
        eeprom.spi.write(&[op::WRDI]).map_err(EepromError::Bus)?;
        Ok(eeprom)
    }

    /// Returns the bus and the delay.
    pub fn into_inner(self) -> (S, D) {
        (self.spi, self.delay)
    }

    /// Waits until no write is in progress. Returns the status register.
    fn wait(&mut self) -> Result<u8, EepromError<S::Error>> {
        for _ in 0..POLLS {
            let status = spi::status_register(&mut self.spi).map_err(EepromError::Bus)?;
            if status & status::WIP == 0 {
                return Ok(status);
            }
            self.delay.delay_us(PERIOD);
        }
        Err(EepromError::Busy)
    }
}

impl<S: SpiDevice, D: DelayNs> ErrorType for Eeprom<S, D> {
    type Error = EepromError<S::Error>;
}

impl<S: SpiDevice, D: DelayNs> ReadNorFlash for Eeprom<S, D> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len()).map_err(EepromError::of_call)?;
        // The write before may have ended with `Busy`: a busy chip would answer with garbage.
        self.wait()?;
        spi::read(&mut self.spi, self.capacity, offset, bytes).map_err(EepromError::Bus)
    }

    fn capacity(&self) -> usize {
        usize::try_from(self.capacity).unwrap_or(usize::MAX)
    }
}

impl<S: SpiDevice, D: DelayNs> NorFlash for Eeprom<S, D> {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = ERASED.len();

    /// Erases by writing 0xFF.
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to).map_err(EepromError::of_call)?;
        for offset in (from..to).step_by(Self::ERASE_SIZE) {
            self.write(offset, &ERASED)?;
        }
        Ok(())
    }

    /// Writes page by page. When it returns, the last page is written too.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len()).map_err(EepromError::of_call)?;
        let (mut at, mut rest) = (offset, bytes);
        while !rest.is_empty() {
            // Behind the end of a page, the chip would continue at its beginning.
            let len = self.page.wrapping_sub(at & self.page.wrapping_sub(1));
            let room = usize::try_from(len).unwrap_or(usize::MAX);
            let (part, after) = rest.split_at_checked(room).unwrap_or((rest, &[]));
            self.wait()?;
            spi::write(&mut self.spi, self.capacity, at, part).map_err(EepromError::Bus)?;
            (at, rest) = (at.wrapping_add(len), after);
        }
        self.wait().map(|_| ())
    }
}
