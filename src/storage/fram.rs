//! A driver for FRAM of the FM25V family (Ramtron, Cypress, Infineon) on SPI, which many flight controllers have for
//! settings.
//!
//! FRAM is written byte by byte, at the speed of the bus, without pages, erasing or relevant wear. The driver presents
//! it as NOR flash with erase units of 256 bytes, so that it works with all stores.

use embedded_hal::spi::{Operation, SpiDevice};
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// Operation codes.
mod op {
    pub(super) const WRITE: u8 = 0x02;
    pub(super) const READ: u8 = 0x03;
    /// Reads the status register.
    pub(super) const RDSR: u8 = 0x05;
    /// Enables the next write.
    pub(super) const WREN: u8 = 0x06;
    /// Reads the device id.
    pub(super) const RDID: u8 = 0x9F;
}

/// Ramtron's JEDEC manufacturer id: C2 in bank 7.
const MANUFACTURER: [u8; 7] = [0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0xC2];

/// The status bits that write-protect a part of the memory, or all of it.
const BLOCK_PROTECT: u8 = 0x0C;

/// An erase unit after erasing. FRAM itself has no erase units.
const ERASED: [u8; 256] = [0xFF; 256];

/// A driver for the FM25V01 to FM25V20, the CY15B104Q and compatible chips.
///
/// The driver recognises the chip by its id, which also encodes the capacity: 16 KiB to 512 KiB. It enables each write,
/// as the chip requires. Calls block only for the transfer on the bus, because the chip is never busy.
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fram<S> {
    spi: S,
    capacity: u32,
}

/// The error of an FRAM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FramError<E> {
    /// The bus failed.
    Bus(E),
    /// No known FRAM answered. These nine bytes were read as its id.
    Id([u8; 9]),
    /// The chip's status register write-protects memory. The driver does not change it.
    Protected,
    /// An address or a length is not a multiple of its unit.
    NotAligned,
    /// The call reaches beyond the end of the memory.
    OutOfBounds,
}

impl<E: core::fmt::Debug> core::fmt::Display for FramError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Bus(error) => write!(f, "the bus failed: {error:?}"),
            Self::Id(id) => {
                write!(f, "no known FRAM answers, its id reads as {id:02X?}: check the wiring and the chip select")
            }
            Self::Protected => f.write_str("the chip's status register protects memory: clear its bits BP0 and BP1"),
            Self::NotAligned => {
                f.write_str("an address or a length is not a multiple of its unit: erase 256 bytes at a time")
            }
            Self::OutOfBounds => f.write_str("the region reaches beyond the end of the memory: make it smaller"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for FramError<E> {}

impl<E: core::fmt::Debug> NorFlashError for FramError<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::Bus(_) | Self::Id(_) | Self::Protected => NorFlashErrorKind::Other,
        }
    }
}

impl<E> FramError<E> {
    fn of_call(kind: NorFlashErrorKind) -> Self {
        match kind {
            NorFlashErrorKind::NotAligned => Self::NotAligned,
            _ => Self::OutOfBounds,
        }
    }
}

impl<S: SpiDevice> Fram<S> {
    /// Identifies the chip and returns its driver. The bus must be in SPI mode 0 or 3, at no more than 40 MHz.
    ///
    /// # Errors
    ///
    /// The bus failed, no known FRAM answered, or the chip is write-protected.
    pub fn new(mut spi: S) -> Result<Self, FramError<S::Error>> {
        let mut id = [0; 9];
        spi.transaction(&mut [Operation::Write(&[op::RDID]), Operation::Read(&mut id)]).map_err(FramError::Bus)?;
        let [manufacturer @ .., product, _] = &id;
        // Three bits of family, which is 1, and five of density: 1 is 16 KiB, and each increment doubles it.
        let capacity = match product {
            0x21..=0x26 if *manufacturer == MANUFACTURER => 0x2000u32.wrapping_shl((product & 0x0F).into()),
            _ => return Err(FramError::Id(id)),
        };
        let mut status = [0];
        spi.transaction(&mut [Operation::Write(&[op::RDSR]), Operation::Read(&mut status)]).map_err(FramError::Bus)?;
        let [status] = status;
        if status & BLOCK_PROTECT != 0 {
            return Err(FramError::Protected);
        }
        Ok(Self { spi, capacity })
    }

    /// Returns the bus.
    pub fn into_inner(self) -> S {
        self.spi
    }

    /// Returns the command of an access at `offset`, and its length: addresses have two bytes in chips of up to 64 KiB,
    /// and three bytes in larger chips.
    fn command(&self, code: u8, offset: u32) -> ([u8; 4], usize) {
        let [_, high, middle, low] = offset.to_be_bytes();
        if self.capacity > 0x1_0000 { ([code, high, middle, low], 4) } else { ([code, middle, low, 0], 3) }
    }
}

impl<S: SpiDevice> ErrorType for Fram<S> {
    type Error = FramError<S::Error>;
}

impl<S: SpiDevice> ReadNorFlash for Fram<S> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len()).map_err(FramError::of_call)?;
        let (command, len) = self.command(op::READ, offset);
        let command = command.get(..len).unwrap_or_default();
        self.spi.transaction(&mut [Operation::Write(command), Operation::Read(bytes)]).map_err(FramError::Bus)
    }

    fn capacity(&self) -> usize {
        usize::try_from(self.capacity).unwrap_or(usize::MAX)
    }
}

impl<S: SpiDevice> NorFlash for Fram<S> {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = ERASED.len();

    /// Erases by writing 0xFF.
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to).map_err(FramError::of_call)?;
        for offset in (from..to).step_by(Self::ERASE_SIZE) {
            self.write(offset, &ERASED)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len()).map_err(FramError::of_call)?;
        // The chip disables writing after each write.
        self.spi.write(&[op::WREN]).map_err(FramError::Bus)?;
        let (command, len) = self.command(op::WRITE, offset);
        let command = command.get(..len).unwrap_or_default();
        self.spi.transaction(&mut [Operation::Write(command), Operation::Write(bytes)]).map_err(FramError::Bus)
    }
}
