use embedded_storage::nor_flash::{NorFlashError, NorFlashErrorKind};

/// The error of an FRAM or an EEPROM. `E` is the error of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Error<E> {
    /// The bus failed.
    Bus(E),
    /// No known FRAM answered. These nine bytes were read as its id.
    Id([u8; 9]),
    /// No chip answered: writing was enabled, and the status register, which was read as this, does not say so.
    NoAnswer(u8),
    /// A write was in progress for more than 20 ms, or no chip answers.
    Busy,
    /// The chip's status register write-protects memory. The driver does not change it.
    Protected,
    /// An address or a length is not a multiple of its unit.
    NotAligned,
    /// The call reaches beyond the end of the memory.
    OutOfBounds,
}

impl<E: core::fmt::Debug> core::fmt::Display for Error<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Bus(error) => write!(f, "the bus failed: {error:?}"),
            Self::Id(id) => write!(
                f,
                "no known FRAM answers, its id reads as {id:02X?}: check the wiring and the chip select, or use \
                 `Fram::with_capacity`"
            ),
            Self::NoAnswer(status) => {
                write!(f, "no chip answers, its status reads as {status:#04X}: check the wiring and the chip select")
            }
            Self::Busy => f.write_str("the chip stays busy, or none answers: check the wiring and the chip select"),
            Self::Protected => f.write_str("the chip's status register protects memory: clear its bits BP0 and BP1"),
            Self::NotAligned => {
                f.write_str("an address or a length is not a multiple of its unit: erase 256 bytes at a time")
            }
            Self::OutOfBounds => f.write_str("the region reaches beyond the end of the memory: make it smaller"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for Error<E> {}

impl<E: core::fmt::Debug> NorFlashError for Error<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::Bus(_) | Self::Id(_) | Self::NoAnswer(_) | Self::Busy | Self::Protected => NorFlashErrorKind::Other,
        }
    }
}

/// From the checks of `embedded-storage`, which know two errors.
impl<E> From<NorFlashErrorKind> for Error<E> {
    fn from(kind: NorFlashErrorKind) -> Self {
        match kind {
            NorFlashErrorKind::NotAligned => Self::NotAligned,
            _ => Self::OutOfBounds,
        }
    }
}
