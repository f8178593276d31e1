//! The error of a HAL's UART behind an adapter.

/// What a HAL's UART reported through one of the adapters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum HalError<E> {
    /// The HAL's own error.
    Hal(E),
    /// There is nothing to read, or no room to write, and nobody waits here. Ask `read_ready` and `write_ready` first.
    WouldBlock,
}

impl<E: core::fmt::Debug> core::fmt::Display for HalError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Hal(error) => write!(f, "{error:?}"),
            Self::WouldBlock => f.write_str("not ready: ask read_ready and write_ready first"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for HalError<E> {}

impl<E: core::fmt::Debug> embedded_io::Error for HalError<E> {
    fn kind(&self) -> embedded_io::ErrorKind {
        embedded_io::ErrorKind::Other
    }
}
