//! Buffered UARTs of asynchronous HALs.

use core::pin::pin;
use core::task::{Context, Poll, Waker};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use super::HalError;

/// A buffered UART that is `embedded_io_async::{Read, Write}` and `ReadReady`, for [`poll_link`](crate::Stack::poll_link): each
/// future is polled once. Embassy's `BufferedUart` is meant, which cannot say whether it has room, and whose blocking
/// `write` waits for it.
///
/// For a UART whose interrupt does the work, and whose futures may be dropped before they are done and then have done nothing.
/// Its transmit buffer holds 32 bytes at least. Nobody is woken: poll in time, or when the HAL's own futures wake you.
#[derive(Debug)]
pub struct Polled<S> {
    serial: S,
    /// What found no room, `held[begin..end]`: it goes first.
    held: [u8; PIECE],
    begin: usize,
    end: usize,
}

/// Some HALs write all or nothing.
const PIECE: usize = 32;

/// What `future` gives at once.
fn now<T>(future: impl Future<Output = T>) -> Option<T> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(result) => Some(result),
        Poll::Pending => None,
    }
}

impl<S> Polled<S> {
    /// The polled end of `serial`.
    pub const fn new(serial: S) -> Self {
        Self { serial, held: [0; PIECE], begin: 0, end: 0 }
    }

    /// The UART, to be waited for: with `fill_buf` for what it receives, say.
    pub const fn get_mut(&mut self) -> &mut S {
        &mut self.serial
    }
}

impl<S: ErrorType> ErrorType for Polled<S> {
    type Error = HalError<S::Error>;
}

impl<S: ReadReady> ReadReady for Polled<S> {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        self.serial.read_ready().map_err(HalError::Hal)
    }
}

impl<S: embedded_io_async::Read> Read for Polled<S> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
        now(self.serial.read(buffer)).ok_or(HalError::WouldBlock)?.map_err(HalError::Hal)
    }
}

impl<S: embedded_io_async::Write> WriteReady for Polled<S> {
    fn write_ready(&mut self) -> Result<bool, Self::Error> {
        let held = self.held.get(self.begin..self.end).unwrap_or_default();
        if !held.is_empty() {
            match now(self.serial.write(held)) {
                Some(Ok(len)) => self.begin = self.begin.saturating_add(len),
                // Not tried again, or it would fail for good.
                Some(Err(error)) => {
                    self.begin = self.end;
                    return Err(HalError::Hal(error));
                }
                None => {}
            }
        }
        Ok(self.begin >= self.end)
    }
}

impl<S: embedded_io_async::Write> Write for Polled<S> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        if !self.write_ready()? {
            return Err(HalError::WouldBlock);
        }
        let piece = bytes.get(..PIECE).unwrap_or(bytes);
        if let Some(result) = now(self.serial.write(piece)) {
            return result.map_err(HalError::Hal);
        }
        for (cell, byte) in self.held.iter_mut().zip(piece) {
            *cell = *byte;
        }
        (self.begin, self.end) = (0, piece.len());
        Ok(piece.len())
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        if !self.write_ready()? {
            return Err(HalError::WouldBlock);
        }
        now(self.serial.flush()).ok_or(HalError::WouldBlock)?.map_err(HalError::Hal)
    }
}
