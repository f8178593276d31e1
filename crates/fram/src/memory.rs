use embedded_hal::spi::{Operation, SpiDevice};
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash, check_erase, check_read, check_write};

use crate::Error;

/// Operation codes, and the bits of the status register.
pub(crate) mod op {
    pub(crate) const WRITE: u8 = 0x02;
    pub(crate) const READ: u8 = 0x03;
    /// Disables writing.
    pub(crate) const WRDI: u8 = 0x04;
    /// Reads the status register.
    pub(crate) const RDSR: u8 = 0x05;
    /// Enables the next write.
    pub(crate) const WREN: u8 = 0x06;
    /// Reads the device id.
    pub(crate) const RDID: u8 = 0x9F;
    /// Status: a write is in progress. FRAM never sets it.
    pub(crate) const WIP: u8 = 0x01;
    /// Status: writing is enabled.
    pub(crate) const WEL: u8 = 0x02;
    /// Status: a part of the memory is write-protected, or all of it.
    pub(crate) const BLOCK_PROTECT: u8 = 0x0C;
}

/// An erase unit after erasing. These memories have no erase units of their own.
const ERASED: [u8; 256] = [0xFF; 256];

/// The difference between FRAM and EEPROM.
pub trait WriteCycle {
    /// Waits until the chip takes a command.
    fn wait<S: SpiDevice>(&mut self, spi: &mut S) -> Result<(), Error<S::Error>>;

    /// Returns the bytes that the chip takes in one write at `offset`, and those that remain.
    fn split<'b>(&self, offset: u32, bytes: &'b [u8]) -> (&'b [u8], &'b [u8]);
}

/// A driver for a memory on SPI: an [`Fram`](crate::Fram) or an [`Eeprom`](crate::Eeprom).
///
/// It implements [`NorFlash`], with a write unit of one byte and erase units of 256 bytes. It enables each write, as the
/// chips require.
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SpiMemory<S, W> {
    pub(crate) spi: S,
    pub(crate) capacity: u32,
    pub(crate) cycle: W,
}

impl<S: SpiDevice, W> SpiMemory<S, W> {
    /// Reads the status register and returns it. Fails if no chip answers or memory is write-protected.
    pub(crate) fn check_protection(&mut self) -> Result<u8, Error<S::Error>> {
        match read_status(&mut self.spi)? {
            0xFF => Err(Error::NoAnswer(0xFF)),
            status if status & op::BLOCK_PROTECT != 0 => Err(Error::Protected),
            status => Ok(status),
        }
    }

    /// Enables writing, reads the status register and disables writing again. Fails if the status does not show that
    /// writing was enabled: an open line reads as zeros or ones.
    pub(crate) fn check_presence(&mut self) -> Result<(), Error<S::Error>> {
        self.spi.write(&[op::WREN]).map_err(Error::Bus)?;
        let status = self.check_protection()?;
        if status & op::WEL == 0 {
            return Err(Error::NoAnswer(status));
        }
        self.spi.write(&[op::WRDI]).map_err(Error::Bus)
    }

    /// Returns the bytes of a command: the operation code and the address.
    ///
    /// An address has one byte in chips of up to 256 bytes, two up to 64 KiB, and three up to 16 MiB. Chips of 512 bytes
    /// have one byte too, and take the ninth bit of the address from bit 3 of the operation code.
    fn command<'b>(&self, code: u8, offset: u32, buffer: &'b mut [u8; 4]) -> &'b [u8] {
        let [_, high, middle, low] = offset.to_be_bytes();
        match self.capacity {
            0..=0x200 => {
                let ninth_bit = if middle & 1 == 0 { 0 } else { 0x08 };
                *buffer = [code | ninth_bit, low, 0, 0];
                let [command @ .., _, _] = buffer;
                command
            }
            0x201..=0x1_0000 => {
                *buffer = [code, middle, low, 0];
                let [command @ .., _] = buffer;
                command
            }
            _ => {
                *buffer = [code, high, middle, low];
                buffer
            }
        }
    }
}

/// Returns the status register.
pub(crate) fn read_status<S: SpiDevice>(spi: &mut S) -> Result<u8, Error<S::Error>> {
    let mut status = [0];
    spi.transaction(&mut [Operation::Write(&[op::RDSR]), Operation::Read(&mut status)]).map_err(Error::Bus)?;
    let [status] = status;
    Ok(status)
}

impl<S: SpiDevice, W> ErrorType for SpiMemory<S, W> {
    type Error = Error<S::Error>;
}

impl<S: SpiDevice, W: WriteCycle> ReadNorFlash for SpiMemory<S, W> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len())?;
        // The write before may have failed with `Busy`: a busy chip would answer with garbage.
        self.cycle.wait(&mut self.spi)?;
        let mut buffer = [0; 4];
        let command = self.command(op::READ, offset, &mut buffer);
        self.spi.transaction(&mut [Operation::Write(command), Operation::Read(bytes)]).map_err(Error::Bus)
    }

    fn capacity(&self) -> usize {
        usize::try_from(self.capacity).unwrap_or(usize::MAX)
    }
}

impl<S: SpiDevice, W: WriteCycle> NorFlash for SpiMemory<S, W> {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = ERASED.len();

    /// Erases by writing 0xFF.
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to)?;
        for offset in (from..to).step_by(Self::ERASE_SIZE) {
            self.write(offset, &ERASED)?;
        }
        Ok(())
    }

    /// Writes, and returns when the chip has stored the last byte.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len())?;
        let (mut offset, mut rest) = (offset, bytes);
        while !rest.is_empty() {
            let (part, after) = self.cycle.split(offset, rest);
            self.cycle.wait(&mut self.spi)?;
            self.spi.write(&[op::WREN]).map_err(Error::Bus)?;
            let mut buffer = [0; 4];
            let command = self.command(op::WRITE, offset, &mut buffer);
            self.spi.transaction(&mut [Operation::Write(command), Operation::Write(part)]).map_err(Error::Bus)?;
            offset = offset.saturating_add(u32::try_from(part.len()).unwrap_or(u32::MAX));
            rest = after;
        }
        self.cycle.wait(&mut self.spi)
    }
}
