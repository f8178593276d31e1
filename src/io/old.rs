//! An adapter for UARTs with the traits of `embedded-io` 0.6.

use embedded_io_06 as old;

use super::HalError;

/// An adapter for a UART that implements `Read`, `Write`, `ReadReady` and `WriteReady` of `embedded-io` 0.6.
///
/// It forwards each call to the same call of version 0.6. So it blocks if the HAL's call blocks; the stack avoids that
/// by checking for readiness first.
#[derive(Debug)]
pub struct Io06<S>(S);

impl<S> Io06<S> {
    /// Returns an adapter for `serial`.
    pub const fn new(serial: S) -> Self {
        Self(serial)
    }

    /// Returns the UART, for other functions of the HAL.
    pub const fn get_mut(&mut self) -> &mut S {
        &mut self.0
    }
}

impl<S: old::ErrorType> embedded_io::ErrorType for Io06<S> {
    type Error = HalError<S::Error>;
}

impl<S: old::ReadReady> embedded_io::ReadReady for Io06<S> {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        self.0.read_ready().map_err(HalError::Hal)
    }
}

impl<S: old::Read> embedded_io::Read for Io06<S> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
        self.0.read(buffer).map_err(HalError::Hal)
    }
}

impl<S: old::WriteReady> embedded_io::WriteReady for Io06<S> {
    fn write_ready(&mut self) -> Result<bool, Self::Error> {
        self.0.write_ready().map_err(HalError::Hal)
    }
}

impl<S: old::Write> embedded_io::Write for Io06<S> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        self.0.write(bytes).map_err(HalError::Hal)
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        self.0.flush().map_err(HalError::Hal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_io::{Read, ReadReady, Write, WriteReady};
    use std::vec::Vec;

    /// A UART that receives the bytes that it has sent, and fails when there is nothing to read.
    #[derive(Default)]
    struct Loopback(Vec<u8>);

    impl old::ErrorType for Loopback {
        type Error = old::ErrorKind;
    }

    impl old::ReadReady for Loopback {
        fn read_ready(&mut self) -> Result<bool, old::ErrorKind> {
            Ok(!self.0.is_empty())
        }
    }

    impl old::Read for Loopback {
        fn read(&mut self, buffer: &mut [u8]) -> Result<usize, old::ErrorKind> {
            if self.0.is_empty() {
                return Err(old::ErrorKind::TimedOut);
            }
            let len = buffer.len().min(self.0.len());
            buffer[..len].copy_from_slice(&self.0[..len]);
            self.0.drain(..len);
            Ok(len)
        }
    }

    impl old::WriteReady for Loopback {
        fn write_ready(&mut self) -> Result<bool, old::ErrorKind> {
            Ok(self.0.len() < 4)
        }
    }

    impl old::Write for Loopback {
        fn write(&mut self, bytes: &[u8]) -> Result<usize, old::ErrorKind> {
            let len = bytes.len().min(4 - self.0.len());
            self.0.extend(&bytes[..len]);
            Ok(len)
        }

        fn flush(&mut self) -> Result<(), old::ErrorKind> {
            if self.0.is_empty() { Ok(()) } else { Err(old::ErrorKind::Other) }
        }
    }

    #[test]
    fn each_call_is_forwarded_to_the_uart() {
        let mut uart = Io06::new(Loopback::default());
        let mut buffer = [0; 8];
        assert_eq!((uart.read_ready(), uart.write_ready(), uart.flush()), (Ok(false), Ok(true), Ok(())));
        assert_eq!(uart.read(&mut buffer), Err(HalError::Hal(old::ErrorKind::TimedOut)));
        assert_eq!((uart.write(b"abcdef"), uart.write_ready(), uart.read_ready()), (Ok(4), Ok(false), Ok(true)));
        assert_eq!(uart.flush(), Err(HalError::Hal(old::ErrorKind::Other)));
        uart.get_mut().0.remove(0);
        assert_eq!((uart.read(&mut buffer), &buffer[..3]), (Ok(3), &b"bcd"[..]));
    }
}
