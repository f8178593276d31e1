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

#[cfg(all(test, any(feature = "embedded-hal-nb", feature = "embedded-io-async")))]
pub(super) mod tests {
    use super::HalError;
    use embedded_io::{ErrorType, Write, WriteReady};
    use std::vec::Vec;

    /// Offers these numbers of bytes, and drains as many after each: written bytes are sent once and in order, whatever
    /// the pace of the link, and a ready UART takes at least one.
    pub(crate) fn check_order<U, E>(mut uart: U, drain: impl Fn(&mut U, usize) -> Vec<u8>, steps: Vec<(usize, usize)>)
    where
        U: Write + WriteReady + ErrorType<Error = HalError<E>>,
        E: core::fmt::Debug + PartialEq,
    {
        let (mut written, mut sent, mut next) = (Vec::<u8>::new(), Vec::<u8>::new(), 0u8);
        for (offered, drained) in steps {
            let bytes: Vec<u8> = (0..offered).map(|i| next.wrapping_add(i as u8)).collect();
            if uart.write_ready() == Ok(true) && offered > 0 {
                let len = uart.write(&bytes).unwrap();
                assert!(len > 0);
                written.extend(&bytes[..len]);
                next = next.wrapping_add(len as u8);
            } else if offered > 0 {
                assert_eq!(uart.write(&bytes), Err(HalError::WouldBlock));
            }
            sent.extend(drain(&mut uart, drained));
        }
        for _ in 0..2 {
            sent.extend(drain(&mut uart, usize::MAX));
            assert_eq!(uart.write_ready(), Ok(true));
        }
        assert_eq!(sent, written);
    }
}
