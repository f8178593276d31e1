//! A driver for FRAM on SPI, which many flight controllers have for settings.
//!
//! FRAM is written byte by byte, at the speed of the bus, without pages, erasing or relevant wear. The driver presents
//! it as NOR flash with erase units of 256 bytes, so that it works with all stores.
//!
//! The ids are those of the datasheets, of Linux (`drivers/misc/eeprom/at25.c`) and of ArduPilot (`AP_RAMTRON`).

use embedded_hal::spi::{Operation, SpiDevice};
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

use super::spi::{self, ERASED, op, status};

/// A driver for FRAM on SPI. It enables each write, as the chips require. Calls block only for the transfer on the bus,
/// because the chips are never busy.
///
/// [`new`](Self::new) recognises these chips by their id:
///
/// | chips | made by | id, as read | capacity |
/// |---|---|---|---|
/// | FM25V01 to FM25V20, CY15B104Q | Ramtron, Cypress, Infineon | six times 7F, C2, 21 to 26 | 16 to 512 KiB |
/// | CY15B102QN to CY15B116QN and CY15V… (Excelon) | Cypress, Infineon | six times 7F, C2, 2A to 31; or reversed | 256 KiB to 2 MiB |
/// | MB85RS16 to MB85RS4MT | Fujitsu, RAMXEED | 04, 7F, density in five bits | 2 to 512 KiB |
/// | MR45V064 to MR45V200 | Lapis, ROHM | AE, 83, density | 8 to 256 KiB |
///
/// Others have the same commands, but no id: FM25L04B to FM25W256, and MB85RS256A. For those, or for a chip that is newer
/// than this list, there is [`with_capacity`](Self::with_capacity).
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
    /// No FRAM answered: writing was enabled, and the status register, which was read as this, does not say so.
    NoAnswer(u8),
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
                write!(
                    f,
                    "no known FRAM answers, its id reads as {id:02X?}: check the wiring and the chip select, or use \
                     `Fram::with_capacity`"
                )
            }
            Self::NoAnswer(status) => {
                write!(f, "no FRAM answers, its status reads as {status:#04X}: check the wiring and the chip select")
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
            Self::Bus(_) | Self::Id(_) | Self::NoAnswer(_) | Self::Protected => NorFlashErrorKind::Other,
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

/// Returns the capacity in bytes of a chip with this id; `None` if it is not known.
fn capacity_of(id: [u8; 9]) -> Option<u32> {
    // Some chips of the Excelon family send the id from its end.
    let id = if let [_, _, 0xC2, 0x7F, ..] = id {
        let [a, b, c, d, e, f, g, h, i] = id;
        [i, h, g, f, e, d, c, b, a]
    } else {
        id
    };
    match id {
        // Ramtron's JEDEC id: C2 in bank 7. Three bits of family, which is 1, and five of density.
        [0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0xC2, product @ 0x21..=0x26, _] => {
            Some(0x2000u32.wrapping_shl((product & 0x0F).into()))
        }
        // Excelon: three bits of family, four of density, and one for inrush control.
        [0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0xC2, product @ 0x2A..=0x31, _] => {
            Some(0x2000u32.wrapping_shl((product.wrapping_shr(1) & 0x0F).into()))
        }
        // Fujitsu's id and JEDEC's continuation code. Three bits that tell the generations apart, and five of density.
        [0x04, 0x7F, product, ..] if (0x01..=0x0B).contains(&(product & 0x1F)) => {
            Some(0x400u32.wrapping_shl((product & 0x1F).into()))
        }
        // Lapis: its id, FRAM on SPI, and the density.
        [0xAE, 0x83, density @ 0x05..=0x0C, ..] => Some(0x100u32.wrapping_shl(density.into())),
        _ => None,
    }
}

impl<S: SpiDevice> Fram<S> {
    /// Identifies the chip and returns its driver. The bus must be in SPI mode 0 or 3, and no faster than the chip's
    /// datasheet permits: 20 to 50 MHz.
    ///
    /// # Errors
    ///
    /// The bus failed, no known FRAM answered, or the chip is write-protected.
    pub fn new(mut spi: S) -> Result<Self, FramError<S::Error>> {
        let mut id = [0; 9];
        spi.transaction(&mut [Operation::Write(&[op::RDID]), Operation::Read(&mut id)]).map_err(FramError::Bus)?;
        let capacity = capacity_of(id).ok_or(FramError::Id(id))?;
        let mut fram = Self { spi, capacity };
        fram.check_protection()?;
        Ok(fram)
    }

    /// Returns the driver of a chip of this capacity in bytes, without reading its id. The capacity decides the length of
    /// addresses: it must be the chip's own.
    ///
    /// It enables writing, reads the status register and disables writing again, which finds out whether a chip is there.
    ///
    /// # Errors
    ///
    /// The bus failed, nothing answered, or the chip is write-protected.
    pub fn with_capacity(spi: S, capacity: u32) -> Result<Self, FramError<S::Error>> {
        let mut fram = Self { spi, capacity };
        fram.spi.write(&[op::WREN]).map_err(FramError::Bus)?;
        let status = fram.check_protection()?;
        // An open line reads as zeros or ones.
        if status & status::WEL == 0 {
            return Err(FramError::NoAnswer(status));
        }
        fram.spi.write(&[op::WRDI]).map_err(FramError::Bus)?;
        Ok(fram)
    }

    /// Returns the status register, if nothing is write-protected.
    fn check_protection(&mut self) -> Result<u8, FramError<S::Error>> {
        match spi::status_register(&mut self.spi).map_err(FramError::Bus)? {
            0xFF => Err(FramError::NoAnswer(0xFF)),
            status if status & status::BLOCK_PROTECT != 0 => Err(FramError::Protected),
            status => Ok(status),
        }
    }

    /// Returns the bus.
    pub fn into_inner(self) -> S {
        self.spi
    }
}

impl<S: SpiDevice> ErrorType for Fram<S> {
    type Error = FramError<S::Error>;
}

impl<S: SpiDevice> ReadNorFlash for Fram<S> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len()).map_err(FramError::of_call)?;
        spi::read(&mut self.spi, self.capacity, offset, bytes).map_err(FramError::Bus)
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
        spi::write(&mut self.spi, self.capacity, offset, bytes).map_err(FramError::Bus)
    }
}
