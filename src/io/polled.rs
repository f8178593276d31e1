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

#[cfg(test)]
mod tests {
    use super::*;
    use core::future::{pending, ready};
    use proptest::prelude::*;
    use std::vec::Vec;

    /// A buffered UART with room for 40 bytes to send, which takes all of a write or waits.
    #[derive(Default)]
    struct Buffered {
        rx: Vec<u8>,
        tx: Vec<u8>,
        /// Its next write fails.
        fails: bool,
    }

    impl ErrorType for Buffered {
        type Error = embedded_io::ErrorKind;
    }

    impl ReadReady for Buffered {
        fn read_ready(&mut self) -> Result<bool, Self::Error> {
            Ok(!self.rx.is_empty())
        }
    }

    impl embedded_io_async::Read for Buffered {
        async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
            if self.rx.is_empty() {
                return pending().await;
            }
            let len = buffer.len().min(self.rx.len());
            for (cell, byte) in buffer.iter_mut().zip(self.rx.drain(..len)) {
                *cell = byte;
            }
            ready(Ok(len)).await
        }
    }

    impl embedded_io_async::Write for Buffered {
        async fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
            assert!(bytes.len() <= 40, "a write that can never be done");
            if core::mem::take(&mut self.fails) {
                return Err(embedded_io::ErrorKind::Other);
            }
            if self.tx.len() + bytes.len() > 40 {
                return pending().await;
            }
            self.tx.extend(bytes);
            Ok(bytes.len())
        }

        async fn flush(&mut self) -> Result<(), Self::Error> {
            if self.tx.is_empty() { Ok(()) } else { pending().await }
        }
    }

    proptest! {
        /// What is written goes out in order, however the line takes it, and a ready UART takes something.
        #[test]
        fn what_is_written_is_sent_once_and_in_order(steps in proptest::collection::vec((0..80usize, 0..41usize), 1..100)) {
            let mut uart = Polled::new(Buffered::default());
            let (mut written, mut sent, mut next) = (Vec::<u8>::new(), Vec::<u8>::new(), 0u8);
            for (offered, gone) in steps {
                let bytes: Vec<u8> = (0..offered).map(|i| next.wrapping_add(i as u8)).collect();
                if uart.write_ready() == Ok(true) && offered > 0 {
                    let len = uart.write(&bytes).unwrap();
                    prop_assert!(len > 0);
                    written.extend(&bytes[..len]);
                    next = next.wrapping_add(len as u8);
                } else if offered > 0 {
                    prop_assert_eq!(uart.write(&bytes), Err(HalError::WouldBlock));
                }
                let gone = gone.min(uart.serial.tx.len());
                sent.extend(uart.serial.tx.drain(..gone));
            }
            for _ in 0..2 {
                sent.append(&mut uart.serial.tx);
                prop_assert_eq!(uart.write_ready(), Ok(true));
            }
            prop_assert_eq!(sent, written);
        }
    }

    #[test]
    fn nothing_waits() {
        let mut uart = Polled::new(Buffered::default());
        let mut buffer = [0; 8];
        assert_eq!((uart.read_ready(), uart.read(&mut buffer)), (Ok(false), Err(HalError::WouldBlock)));
        uart.get_mut().rx.extend([1, 2, 3]);
        assert_eq!((uart.read_ready(), uart.read(&mut buffer)), (Ok(true), Ok(3)));
        assert_eq!(uart.write(b"7"), Ok(1));
        assert_eq!(uart.flush(), Err(HalError::WouldBlock));
        uart.get_mut().tx.clear();
        assert_eq!(uart.flush(), Ok(()));
    }

    /// What could not be sent is not tried again, or the line would fail for good.
    #[test]
    fn an_error_is_told_once() {
        const FAILED: HalError<embedded_io::ErrorKind> = HalError::Hal(embedded_io::ErrorKind::Other);
        let mut uart = Polled::new(Buffered { fails: true, ..Buffered::default() });
        assert_eq!((uart.write(b"ab"), uart.write(&[7; 32]), uart.write(&[8; 32])), (Err(FAILED), Ok(32), Ok(32)));
        assert_eq!(uart.write_ready(), Ok(false), "the second piece waits");
        assert_eq!(uart.flush(), Err(HalError::WouldBlock));
        uart.get_mut().fails = true;
        assert_eq!((uart.write(b"c"), uart.write(b"d")), (Err(FAILED), Ok(1)));
        assert_eq!(uart.serial.tx, [&[7; 32][..], b"d"].concat());
    }
}
