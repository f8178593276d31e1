use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;

use crate::Error;
use crate::memory::{SpiMemory, WriteCycle, op, read_status};

/// The time between two reads of the status register, in microseconds.
const PERIOD: u32 = 100;
/// The number of reads before the chip counts as stuck: 20 ms, twice the longest write time of the datasheets.
const POLLS: u32 = 200;

/// A driver for EEPROM on SPI: the 25xx and M95 series, which have the same commands and status registers.
///
/// These chips have no id that tells their size, so the firmware states it:
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
/// A call writes page by page and waits for each, at most 20 ms: then it fails with [`Busy`](Error::Busy). An erase of 256
/// bytes takes `256 / PAGE` times the write time, which is 20 ms with pages of 64 bytes. The processor is free while
/// `delay` waits, if `delay` lets others run.
pub type Eeprom<S, D> = SpiMemory<S, PageByPage<D>>;

/// A write must not cross a page, and the chip is busy after it: of an [`Eeprom`].
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PageByPage<D> {
    delay: D,
    /// The length of a page: a power of two.
    len: u32,
}

impl<D: DelayNs> WriteCycle for PageByPage<D> {
    fn wait<S: SpiDevice>(&mut self, spi: &mut S) -> Result<(), Error<S::Error>> {
        for _ in 0..POLLS {
            if read_status(spi)? & op::WIP == 0 {
                return Ok(());
            }
            self.delay.delay_us(PERIOD);
        }
        Err(Error::Busy)
    }

    /// Splits at the end of a page. Behind it, the chip would continue at the beginning of the page.
    fn split<'b>(&self, offset: u32, bytes: &'b [u8]) -> (&'b [u8], &'b [u8]) {
        let last = self.len.wrapping_sub(1);
        let room = self.len.wrapping_sub(offset & last);
        usize::try_from(room).ok().and_then(|room| bytes.split_at_checked(room)).unwrap_or((bytes, &[]))
    }
}

impl<S: SpiDevice, D: DelayNs> Eeprom<S, D> {
    /// Returns the driver of a chip with this capacity and these pages, in bytes: the datasheet has both. A value that is
    /// no power of two, and a page of more than 256 bytes, is a compile error. The bus must be in SPI mode 0 or 3, at
    /// no more than the chip's clock: 5 to 20 MHz.
    ///
    /// It waits for a write that was in progress before a restart. Then it enables writing, reads the status register and
    /// disables writing again, which shows whether a chip is there.
    ///
    /// # Errors
    ///
    /// The bus failed, nothing answered, or the chip is write-protected.
    #[allow(clippy::panic, reason = "const-evaluated")]
    pub fn new<const CAPACITY: u32, const PAGE: u32>(spi: S, delay: D) -> Result<Self, Error<S::Error>> {
        const {
            assert!(PAGE.is_power_of_two() && PAGE <= 256, "PAGE must be a power of two, and at most 256");
            assert!(
                CAPACITY.is_power_of_two() && CAPACITY >= 512 && CAPACITY <= 0x100_0000,
                "CAPACITY must be a power of two, in bytes, from 512 to 16 MiB"
            );
        }
        let mut eeprom = Self { spi, capacity: CAPACITY, cycle: PageByPage { delay, len: PAGE } };
        eeprom.cycle.wait(&mut eeprom.spi)?;
        eeprom.check_presence()?;
        Ok(eeprom)
    }

    /// Returns the bus and the delay.
    pub fn into_inner(self) -> (S, D) {
        (self.spi, self.cycle.delay)
    }
}
