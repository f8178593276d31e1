//! An adapter for UARTs with the traits of `embedded-hal-nb`.

use embedded_hal_nb::nb;
use embedded_hal_nb::serial;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use super::HalError;

/// A polled adapter for a UART that implements `embedded_hal_nb::serial::{Read, Write}`.
///
/// It holds one byte in each direction, because these traits have no calls for readiness. Use it for a UART whose FIFO
/// holds the bytes between two polls, or for a slow link: a UART with a single data register receives two bytes per
/// poll. For other UARTs use [`SerialQueues`](super::SerialQueues).
#[derive(Debug)]
pub struct NbSerial<S: serial::ErrorType> {
    serial: S,
    /// A byte or error that was read from the UART, but not yet returned by `read`.
    received: Option<Result<u8, S::Error>>,
    /// A byte that counts as written, but for which the UART had no room. The next `write_ready` sends it.
    unsent: Option<u8>,
}

/// Whether the UART took a byte.
enum Sent {
    Taken,
    NoRoom,
}

impl<S: serial::Read + serial::Write> NbSerial<S> {
    /// Returns an adapter for `serial`.
    pub const fn new(serial: S) -> Self {
        Self { serial, received: None, unsent: None }
    }

    /// Returns the UART, for other functions of the HAL, such as enabling an interrupt. Bytes that are read from it do
    /// not reach the stack.
    pub const fn get_mut(&mut self) -> &mut S {
        &mut self.serial
    }

    /// Returns the next received byte or error; `None` if there is none.
    fn next(&mut self) -> Option<Result<u8, S::Error>> {
        if self.received.is_some() {
            return self.received.take();
        }
        match self.serial.read() {
            Ok(byte) => Some(Ok(byte)),
            Err(nb::Error::WouldBlock) => None,
            Err(nb::Error::Other(error)) => Some(Err(error)),
        }
    }

    /// Offers a byte to the UART.
    fn send(&mut self, byte: u8) -> Result<Sent, HalError<S::Error>> {
        match self.serial.write(byte) {
            Ok(()) => Ok(Sent::Taken),
            Err(nb::Error::WouldBlock) => Ok(Sent::NoRoom),
            Err(nb::Error::Other(error)) => Err(HalError::Hal(error)),
        }
    }
}

impl<S: serial::ErrorType> ErrorType for NbSerial<S> {
    type Error = HalError<S::Error>;
}

impl<S: serial::Read + serial::Write> ReadReady for NbSerial<S> {
    /// Returns whether there is a byte or an error to read. The adapter keeps it for the next `read`.
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        self.received = self.next();
        Ok(self.received.is_some())
    }
}

impl<S: serial::Read + serial::Write> Read for NbSerial<S> {
    /// Reads the bytes that the UART has, and returns their number.
    ///
    /// # Errors
    ///
    /// [`HalError::WouldBlock`] if there is no byte, or the UART's error if it comes before the first byte. An error
    /// after the first byte is returned by the next call.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
        let mut len = 0usize;
        for byte in buffer.iter_mut() {
            match self.next() {
                Some(Ok(received)) => *byte = received,
                Some(Err(error)) if len == 0 => return Err(HalError::Hal(error)),
                Some(Err(error)) => {
                    self.received = Some(Err(error));
                    break;
                }
                None => break,
            }
            len = len.saturating_add(1);
        }
        if len == 0 && !buffer.is_empty() { Err(HalError::WouldBlock) } else { Ok(len) }
    }
}

impl<S: serial::Read + serial::Write> WriteReady for NbSerial<S> {
    /// Sends the byte that is still unsent, if any. Returns whether the adapter can take another byte.
    ///
    /// # Errors
    ///
    /// The UART's error. The unsent byte is then dropped, because sending it again could fail forever.
    fn write_ready(&mut self) -> Result<bool, Self::Error> {
        if let Some(byte) = self.unsent.take()
            && let Sent::NoRoom = self.send(byte)?
        {
            self.unsent = Some(byte);
        }
        Ok(self.unsent.is_none())
    }
}

impl<S: serial::Read + serial::Write> Write for NbSerial<S> {
    /// Writes bytes until the UART has no room, and returns their number. The last of them may still be unsent: the
    /// adapter keeps it until the UART has room.
    ///
    /// # Errors
    ///
    /// [`HalError::WouldBlock`] if an earlier byte is still unsent, or the UART's error if it refuses the first byte.
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        if !self.write_ready()? {
            return Err(HalError::WouldBlock);
        }
        for (len, &byte) in bytes.iter().enumerate() {
            match self.send(byte) {
                Ok(Sent::Taken) => {}
                Ok(Sent::NoRoom) => {
                    self.unsent = Some(byte);
                    return Ok(len.saturating_add(1));
                }
                Err(error) if len == 0 => return Err(error),
                // The bytes before this one are written. The caller writes this one again, and then gets a lasting
                // error.
                Err(_) => return Ok(len),
            }
        }
        Ok(bytes.len())
    }

    /// Sends the unsent byte, and succeeds when the UART has sent all bytes.
    ///
    /// # Errors
    ///
    /// [`HalError::WouldBlock`] until all bytes are sent, or the UART's error.
    fn flush(&mut self) -> Result<(), Self::Error> {
        if !self.write_ready()? {
            return Err(HalError::WouldBlock);
        }
        match self.serial.flush() {
            Ok(()) => Ok(()),
            Err(nb::Error::WouldBlock) => Err(HalError::WouldBlock),
            Err(nb::Error::Other(error)) => Err(HalError::Hal(error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::hal::tests::check_order;
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;

    /// A UART with a FIFO of four bytes each way.
    #[derive(Default)]
    struct Fifo {
        rx: VecDeque<Result<u8, serial::ErrorKind>>,
        tx: VecDeque<u8>,
        /// Accepts this many bytes, then fails once.
        fails_after: Option<usize>,
    }

    impl Fifo {
        fn fails(&mut self) -> nb::Result<(), serial::ErrorKind> {
            match self.fails_after {
                Some(0) => {
                    self.fails_after = None;
                    Err(nb::Error::Other(serial::ErrorKind::Other))
                }
                left => {
                    self.fails_after = left.map(|left| left - 1);
                    Ok(())
                }
            }
        }
    }

    impl serial::ErrorType for Fifo {
        type Error = serial::ErrorKind;
    }

    impl serial::Read for Fifo {
        fn read(&mut self) -> nb::Result<u8, serial::ErrorKind> {
            self.rx.pop_front().ok_or(nb::Error::WouldBlock)?.map_err(nb::Error::Other)
        }
    }

    impl serial::Write for Fifo {
        fn write(&mut self, byte: u8) -> nb::Result<(), serial::ErrorKind> {
            self.fails()?;
            if self.tx.len() == 4 {
                return Err(nb::Error::WouldBlock);
            }
            self.tx.push_back(byte);
            Ok(())
        }

        fn flush(&mut self) -> nb::Result<(), serial::ErrorKind> {
            self.fails()?;
            if self.tx.is_empty() { Ok(()) } else { Err(nb::Error::WouldBlock) }
        }
    }

    proptest! {
        /// Written bytes are sent once and in order, whatever the pace of the link, and a ready UART takes at least
        /// one.
        #[test]
        fn bytes_are_sent_once_and_in_order(steps in proptest::collection::vec((0..8usize, 0..5usize), 1..100)) {
            let drain = |uart: &mut NbSerial<Fifo>, len: usize| {
                let tx = &mut uart.get_mut().tx;
                tx.drain(..len.min(tx.len())).collect()
            };
            check_order(NbSerial::new(Fifo::default()), drain, steps);
        }
    }

    #[test]
    fn errors_are_returned_once_and_after_the_bytes_before_them() {
        let mut uart = NbSerial::new(Fifo::default());
        let mut buffer = [0; 8];
        assert_eq!((uart.read_ready(), uart.read(&mut buffer)), (Ok(false), Err(HalError::WouldBlock)));
        uart.serial.rx.extend([Ok(1), Ok(2), Err(serial::ErrorKind::Overrun), Ok(3)]);
        assert_eq!((uart.read_ready(), uart.read_ready()), (Ok(true), Ok(true)), "read_ready consumes nothing");
        assert_eq!((uart.read(&mut buffer), &buffer[..2]), (Ok(2), &[1, 2][..]));
        assert_eq!(uart.read(&mut buffer), Err(HalError::Hal(serial::ErrorKind::Overrun)));
        assert_eq!((uart.read(&mut buffer), buffer[0]), (Ok(1), 3));
        assert_eq!(uart.read_ready(), Ok(false));
        assert_eq!(uart.read(&mut []), Ok(0));
    }

    const FAILED: HalError<serial::ErrorKind> = HalError::Hal(serial::ErrorKind::Other);

    /// The bytes before an error are returned as written, and the bytes after it are written by the next call.
    #[test]
    fn write_errors_are_returned_once_and_lose_no_later_bytes() {
        let mut uart = NbSerial::new(Fifo { fails_after: Some(0), ..Fifo::default() });
        assert_eq!(uart.write(b"ab"), Err(FAILED));
        uart.get_mut().fails_after = Some(2);
        assert_eq!((uart.write(b"abc"), uart.write(b"c")), (Ok(2), Ok(1)));
        assert_eq!(
            (uart.write(b"def"), uart.write_ready()),
            (Ok(2), Ok(false)),
            "the FIFO is full, and one byte is held"
        );
        uart.get_mut().fails_after = Some(0);
        assert_eq!(
            (uart.write(b"f"), uart.write_ready()),
            (Err(FAILED), Ok(true)),
            "the byte that failed is not retried"
        );
        assert!(uart.serial.tx.iter().eq(b"abcd"));
    }

    /// Flushing succeeds when the UART has sent all bytes, and returns the UART's errors.
    #[test]
    fn flush_does_not_block() {
        let mut uart = NbSerial::new(Fifo::default());
        assert_eq!((uart.flush(), uart.write(b"abcde")), (Ok(()), Ok(5)));
        assert_eq!(uart.flush(), Err(HalError::WouldBlock), "a byte is still held");
        uart.get_mut().tx.pop_front();
        assert_eq!(uart.flush(), Err(HalError::WouldBlock), "the bytes are in the FIFO");
        uart.get_mut().tx.clear();
        uart.get_mut().fails_after = Some(0);
        assert_eq!((uart.flush(), uart.flush()), (Err(FAILED), Ok(())));
    }
}
