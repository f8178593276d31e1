//! FRAM of the FM25V family (Ramtron, Cypress, Infineon) on SPI: what flight controllers keep their settings in.
//!
//! FRAM is written byte by byte, at the speed of the bus, without pages, without erasing and without wear that matters.
//! It is driven here as NOR flash with erase units of 256 bytes, so that all that works on flash works on it.

use embedded_hal::spi::{Operation, SpiDevice};
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// Operation codes.
mod op {
    pub(super) const WRITE: u8 = 0x02;
    pub(super) const READ: u8 = 0x03;
    /// Read the status register.
    pub(super) const RDSR: u8 = 0x05;
    /// Allow the next write.
    pub(super) const WREN: u8 = 0x06;
    /// Read the device id.
    pub(super) const RDID: u8 = 0x9F;
}

/// Ramtron's JEDEC id: number C2 of the seventh bank.
const MANUFACTURER: [u8; 7] = [0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0xC2];

/// Status bits that protect a part of the memory, or all, from writing.
const BLOCK_PROTECT: u8 = 0x0C;

/// What an erase unit has in it; FRAM has none of its own.
const ERASED: [u8; 256] = [0xFF; 256];

/// An FM25V01 to FM25V20, CY15B104Q, or one that answers alike.
///
/// The chip is recognized by its id, which also says how large it is: 16 KiB to 512 KiB. Each write enables itself, as the
/// chip wants it. No call waits for the chip, which is never busy; each blocks for as long as the bus needs.
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fram<S> {
    spi: S,
    capacity: u32,
}

/// What went wrong with an FRAM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FramError<E> {
    /// The bus failed.
    Bus(E),
    /// There is something else, or nothing: the nine bytes that came as its id.
    Id([u8; 9]),
    /// The chip's status register protects memory from writing. It is left as it is.
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
                write!(f, "no FRAM that is known answers, but {id:02X?}: is it wired, and is this its chip select?")
            }
            Self::Protected => f.write_str("the chip's status register protects memory: clear its bits BP0 and BP1"),
            Self::NotAligned => f.write_str("an address or a length is not a multiple of its unit"),
            Self::OutOfBounds => f.write_str("beyond the end of the memory: is the region larger than the chip?"),
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
    /// Asks the chip what it is. SPI mode 0 or 3, at most 40 MHz.
    ///
    /// # Errors
    ///
    /// The bus failed, another chip answered or none, or the chip is protected from writing.
    pub fn new(mut spi: S) -> Result<Self, FramError<S::Error>> {
        let mut id = [0; 9];
        spi.transaction(&mut [Operation::Write(&[op::RDID]), Operation::Read(&mut id)]).map_err(FramError::Bus)?;
        let [manufacturer @ .., product, _] = &id;
        // Three bits of family, which is 1; five of density, which is 1 for 16 KiB and one more for each doubling.
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

    /// Gives the bus back.
    pub fn into_inner(self) -> S {
        self.spi
    }

    /// The bytes that begin an access at `offset`, and how many they are: addresses have two bytes up to 64 KiB, and three
    /// beyond.
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

    /// Writes 0xFF.
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to).map_err(FramError::of_call)?;
        for offset in (from..to).step_by(Self::ERASE_SIZE) {
            self.write(offset, &ERASED)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len()).map_err(FramError::of_call)?;
        // The chip forgets after each write that it was allowed.
        self.spi.write(&[op::WREN]).map_err(FramError::Bus)?;
        let (command, len) = self.command(op::WRITE, offset);
        let command = command.get(..len).unwrap_or_default();
        self.spi.transaction(&mut [Operation::Write(command), Operation::Write(bytes)]).map_err(FramError::Bus)
    }
}
