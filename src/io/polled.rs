//! An adapter for buffered UARTs of asynchronous HALs.

use core::pin::pin;
use core::task::{Context, Poll, Waker};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use super::HalError;

/// An adapter for [`poll_link`](crate::Stack::poll_link): wraps a buffered UART that implements
/// `embedded_io_async::{Read, Write}` and `ReadReady`, and polls each of its futures once.
///
/// It is made for Embassy's `BufferedUart`, which has no `WriteReady`, and whose blocking `write` waits for room. The
/// UART must fulfil these conditions:
///
/// - An interrupt moves the bytes.
/// - The futures may be dropped before they complete, and then have no effect.
/// - The transmit buffer holds at least 32 bytes.
///
/// The adapter wakes no task: poll the link periodically, or when a future of the HAL wakes the task.
#[derive(Debug)]
pub struct Polled<S> {
    serial: S,
    /// Bytes that count as written, but for which the UART had no room: `unsent[begin..end]`. The next `write_ready`
    /// sends them.
    unsent: [u8; PIECE],
    begin: usize,
    end: usize,
}

/// Length of a write in bytes. It is short, because some HALs write all bytes or none.
const PIECE: usize = 32;

/// Polls `future` once; `None` if it is not ready.
fn poll_once<T>(future: impl Future<Output = T>) -> Option<T> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(result) => Some(result),
        Poll::Pending => None,
    }
}

impl<S> Polled<S> {
    /// Returns an adapter for `serial`.
    pub const fn new(serial: S) -> Self {
        Self { serial, unsent: [0; PIECE], begin: 0, end: 0 }
    }

    /// Returns the UART, for example to wait for received bytes with `fill_buf`.
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
        poll_once(self.serial.read(buffer)).ok_or(HalError::WouldBlock)?.map_err(HalError::Hal)
    }
}

impl<S: embedded_io_async::Write> WriteReady for Polled<S> {
    /// Sends the bytes that are still unsent, if any. Returns whether the adapter can take other bytes.
    ///
    /// # Errors
    ///
    /// The UART's error. The unsent bytes are then dropped, because sending them again could fail forever.
    fn write_ready(&mut self) -> Result<bool, Self::Error> {
        let unsent = self.unsent.get(self.begin..self.end).unwrap_or_default();
        if !unsent.is_empty() {
            match poll_once(self.serial.write(unsent)) {
                Some(Ok(len)) => self.begin = self.begin.saturating_add(len),
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
    /// Writes up to 32 bytes, and returns their number. If the UART has no room for them, the adapter keeps them until
    /// it has, and counts them as written.
    ///
    /// # Errors
    ///
    /// [`HalError::WouldBlock`] if earlier bytes are still unsent, or the UART's error.
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        if !self.write_ready()? {
            return Err(HalError::WouldBlock);
        }
        let piece = bytes.get(..PIECE).unwrap_or(bytes);
        if let Some(result) = poll_once(self.serial.write(piece)) {
            return result.map_err(HalError::Hal);
        }
        for (cell, byte) in self.unsent.iter_mut().zip(piece) {
            *cell = *byte;
        }
        (self.begin, self.end) = (0, piece.len());
        Ok(piece.len())
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        if !self.write_ready()? {
            return Err(HalError::WouldBlock);
        }
        poll_once(self.serial.flush()).ok_or(HalError::WouldBlock)?.map_err(HalError::Hal)
    }
}

#[cfg(test)]
mod tests {
    use super::super::hal::tests::check_order;
    use super::*;
    use core::future::{pending, ready};
    use proptest::prelude::*;
    use std::vec::Vec;

    /// A buffered UART with a transmit buffer of 40 bytes, which takes all bytes of a write or is pending.
    #[derive(Default)]
    struct Buffered {
        rx: Vec<u8>,
        tx: Vec<u8>,
        /// Whether the next write fails.
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
            assert!(bytes.len() <= 40, "a write that can never complete");
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
        /// Written bytes are sent once and in order, whatever the pace of the link, and a ready UART takes at least
        /// one.
        #[test]
        fn bytes_are_sent_once_and_in_order(steps in proptest::collection::vec((0..80usize, 0..41usize), 1..100)) {
            let drain = |uart: &mut Polled<Buffered>, len: usize| {
                let tx = &mut uart.get_mut().tx;
                tx.drain(..len.min(tx.len())).collect()
            };
            check_order(Polled::new(Buffered::default()), drain, steps);
        }
    }

    #[test]
    fn no_call_blocks() {
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

    /// Bytes that failed are not retried, or the link could fail forever.
    #[test]
    fn an_error_is_returned_once() {
        const FAILED: HalError<embedded_io::ErrorKind> = HalError::Hal(embedded_io::ErrorKind::Other);
        let mut uart = Polled::new(Buffered { fails: true, ..Buffered::default() });
        assert_eq!((uart.write(b"ab"), uart.write(&[7; 32]), uart.write(&[8; 32])), (Err(FAILED), Ok(32), Ok(32)));
        assert_eq!(uart.write_ready(), Ok(false), "the second piece is held");
        assert_eq!(uart.flush(), Err(HalError::WouldBlock));
        uart.get_mut().fails = true;
        assert_eq!((uart.write(b"c"), uart.write(b"d")), (Err(FAILED), Ok(1)));
        assert_eq!(uart.serial.tx, [&[7; 32][..], b"d"].concat());
    }
}
