//! The error of the adapters for HALs.

/// The error of an adapter for a HAL's UART.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum HalError<E> {
    /// An error of the HAL.
    Hal(E),
    /// There is nothing to read, or no room to write, and the adapter does not block. Call `read_ready` or
    /// `write_ready` first.
    WouldBlock,
}

impl<E: core::fmt::Debug> core::fmt::Display for HalError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Hal(error) => write!(f, "{error:?}"),
            Self::WouldBlock => f.write_str("the UART is not ready: call read_ready or write_ready first"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for HalError<E> {}

impl<E: core::fmt::Debug> embedded_io::Error for HalError<E> {
    fn kind(&self) -> embedded_io::ErrorKind {
        embedded_io::ErrorKind::Other
    }
}
