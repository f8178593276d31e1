use embedded_hal::spi::{Operation, SpiDevice};

use crate::Error;
use crate::memory::{SpiMemory, WriteCycle, op};

/// A driver for FRAM on SPI. It is written byte by byte, at the speed of the bus, without relevant wear. The chips are never
/// busy, so calls block only for the transfer on the bus.
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
pub type Fram<S> = SpiMemory<S, Immediate>;

/// A write is complete when its transfer is: of an [`Fram`].
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Immediate(());

impl WriteCycle for Immediate {
    fn wait<S: SpiDevice>(&mut self, _: &mut S) -> Result<(), Error<S::Error>> {
        Ok(())
    }

    fn split<'b>(&self, _: u32, bytes: &'b [u8]) -> (&'b [u8], &'b [u8]) {
        (bytes, &[])
    }
}

impl<S: SpiDevice> Fram<S> {
    /// Identifies the chip and returns its driver. The bus must be in SPI mode 0 or 3, and no faster than the chip's
    /// datasheet permits: 20 to 50 MHz.
    ///
    /// # Errors
    ///
    /// The bus failed, no known FRAM answered, or the chip is write-protected.
    pub fn new(mut spi: S) -> Result<Self, Error<S::Error>> {
        let mut id = [0; 9];
        spi.transaction(&mut [Operation::Write(&[op::RDID]), Operation::Read(&mut id)]).map_err(Error::Bus)?;
        let capacity = capacity_of(id).ok_or(Error::Id(id))?;
        let mut fram = Self { spi, capacity, cycle: Immediate(()) };
        fram.check_protection()?;
        Ok(fram)
    }

    /// Returns the driver of a chip of this capacity in bytes, without reading its id. The capacity decides the length of
    /// addresses: it must be the chip's own.
    ///
    /// It enables writing, reads the status register and disables writing again, which shows whether a chip is there.
    ///
    /// # Errors
    ///
    /// The bus failed, nothing answered, or the chip is write-protected.
    pub fn with_capacity(spi: S, capacity: u32) -> Result<Self, Error<S::Error>> {
        let mut fram = Self { spi, capacity, cycle: Immediate(()) };
        fram.check_presence()?;
        Ok(fram)
    }

    /// Returns the bus.
    pub fn into_inner(self) -> S {
        self.spi
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
        // Fujitsu's id and JEDEC's continuation code. Three bits are the generation, and five the density.
        [0x04, 0x7F, product, ..] if (0x01..=0x0B).contains(&(product & 0x1F)) => {
            Some(0x400u32.wrapping_shl((product & 0x1F).into()))
        }
        // Lapis: its id, FRAM on SPI, and the density.
        [0xAE, 0x83, density @ 0x05..=0x0C, ..] => Some(0x100u32.wrapping_shl(density.into())),
        _ => None,
    }
}
