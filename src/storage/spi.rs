//! What FRAM and EEPROM on SPI have in common: commands, addresses, and the status register.

use embedded_hal::spi::{Operation, SpiDevice};

/// Operation codes.
pub(super) mod op {
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
}

/// Bits of the status register.
pub(super) mod status {
    /// A write is in progress. FRAM never sets it.
    pub(crate) const WIP: u8 = 0x01;
    /// Writing is enabled.
    pub(crate) const WEL: u8 = 0x02;
    /// A part of the memory is write-protected, or all of it.
    pub(crate) const BLOCK_PROTECT: u8 = 0x0C;
}

/// An erase unit after erasing. These memories have no erase units of their own.
pub(super) const ERASED: [u8; 256] = [0xFF; 256];

/// Returns the command of an access at `offset`, and its length.
///
/// An address has one byte in chips of up to 256 bytes, two up to 64 KiB, and three up to 16 MiB. Chips of 512 bytes have
/// one byte too, and take the ninth bit of the address from bit 3 of the operation code.
fn command(code: u8, capacity: u32, offset: u32) -> ([u8; 4], usize) {
    let [_, high, middle, low] = offset.to_be_bytes();
    match capacity {
        0..=0x200 => ([code | (middle & 1).wrapping_shl(3), low, 0, 0], 2),
        0x201..=0x1_0000 => ([code, middle, low, 0], 3),
        _ => ([code, high, middle, low], 4),
    }
}

/// Returns the status register.
pub(super) fn status_register<S: SpiDevice>(spi: &mut S) -> Result<u8, S::Error> {
    let mut status = [0];
    spi.transaction(&mut [Operation::Write(&[op::RDSR]), Operation::Read(&mut status)])?;
    let [status] = status;
    Ok(status)
}

/// Reads from `offset` on.
pub(super) fn read<S: SpiDevice>(spi: &mut S, capacity: u32, offset: u32, bytes: &mut [u8]) -> Result<(), S::Error> {
    let (command, len) = command(op::READ, capacity, offset);
    spi.transaction(&mut [Operation::Write(command.get(..len).unwrap_or_default()), Operation::Read(bytes)])
}

/// Writes from `offset` on. Enables writing first: the chip disables it after each write.
pub(super) fn write<S: SpiDevice>(spi: &mut S, capacity: u32, offset: u32, bytes: &[u8]) -> Result<(), S::Error> {
    spi.write(&[op::WREN])?;
    let (command, len) = command(op::WRITE, capacity, offset);
    spi.transaction(&mut [Operation::Write(command.get(..len).unwrap_or_default()), Operation::Write(bytes)])
}
