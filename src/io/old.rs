//! UARTs with the traits of `embedded-io` 0.6.

use embedded_io_06 as old;

use super::HalError;

/// A UART that is all of `embedded_io::{Read, Write, ReadReady, WriteReady}`, but of version 0.6: the same calls by their new
/// names. It waits where the HAL's UART waits; the stack asks first.
#[derive(Debug)]
pub struct Io06<S>(S);

impl<S> Io06<S> {
    /// `serial` by its new names.
    pub const fn new(serial: S) -> Self {
        Self(serial)
    }

    /// The UART itself, for what only the HAL has.
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
