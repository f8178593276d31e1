//! A simulated UART with faults that the script controls. It panics where a real UART would block.

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use std::collections::VecDeque;

/// The vehicle's end of a line, and its traffic.
#[derive(Debug)]
pub struct Uart {
    /// Bytes to read.
    rx: VecDeque<u8>,
    /// All bytes ever received.
    pub history: Vec<u8>,
    /// The last frames that the vehicle sent.
    pub frames: VecDeque<Vec<u8>>,
    /// Sent bytes of an incomplete frame.
    tx: Vec<u8>,
    /// Bytes accepted per poll.
    room: usize,
    /// Bytes per read or write.
    at_once: usize,
    left: usize,
    read_fails: bool,
    write_fails: bool,
    is_closed: bool,
    /// Bytes read in this poll.
    read: usize,
    /// Bytes written in this poll.
    written: usize,
}

impl Default for Uart {
    fn default() -> Self {
        Self {
            rx: VecDeque::new(),
            history: Vec::new(),
            frames: VecDeque::new(),
            tx: Vec::new(),
            room: usize::MAX,
            at_once: usize::MAX,
            left: 0,
            read_fails: false,
            write_fails: false,
            is_closed: false,
            read: 0,
            written: 0,
        }
    }
}

impl Uart {
    /// Starts a poll.
    pub fn begin(&mut self) {
        (self.left, self.read, self.written) = (self.room, 0, 0);
    }

    /// Adds bytes to read.
    pub fn receive(&mut self, bytes: &[u8]) {
        self.rx.extend(bytes);
        self.history.extend(bytes);
    }

    /// Enables a fault.
    pub fn fail(&mut self, kind: u8) {
        let number = usize::from(kind >> 3);
        match kind % 8 {
            0 => self.repair(),
            1 => self.room = 0,
            2 => self.room = number + 1,
            3 => self.at_once = number + 1,
            4 => self.read_fails = true,
            5 => self.write_fails = true,
            _ => self.is_closed = true,
        }
    }

    /// Disables all faults.
    pub fn repair(&mut self) {
        (self.room, self.at_once) = (usize::MAX, usize::MAX);
        (self.read_fails, self.write_fails, self.is_closed) = (false, false, false);
    }

    /// Discards an incomplete frame, after a reset of the link or a reboot.
    pub fn cut(&mut self) {
        self.tx.clear();
    }

    /// Whether it accepts all output.
    pub fn is_free(&self) -> bool {
        self.room == usize::MAX && !self.write_fails && !self.is_closed
    }

    /// Whether bytes are left to read.
    pub fn has_input(&self) -> bool {
        !self.rx.is_empty()
    }

    /// Takes the next complete frame that was sent.
    pub fn next_frame(&mut self) -> Option<Vec<u8>> {
        let len = match *self.tx {
            [0xFD, len, flags, ..] => 12 + usize::from(len) + if flags & 1 == 1 { 13 } else { 0 },
            [0xFE, len, ..] => 8 + usize::from(len),
            [] | [0xFD | 0xFE, ..] => return None,
            [byte, ..] => panic!("{byte:#04x} instead of a start byte"),
        };
        (self.tx.len() >= len).then(|| self.tx.drain(..len).collect())
    }

    /// Stores a frame after it was checked.
    pub fn sent(&mut self, frame: Vec<u8>) {
        if self.frames.len() == 16 {
            self.frames.pop_front();
        }
        self.frames.push_back(frame);
    }
}

impl ErrorType for Uart {
    type Error = ErrorKind;
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, ErrorKind> {
        Ok(self.read_fails || self.is_closed || !self.rx.is_empty())
    }
}

impl Read for Uart {
    fn read(&mut self, out: &mut [u8]) -> Result<usize, ErrorKind> {
        if std::mem::take(&mut self.read_fails) {
            return Err(ErrorKind::Other);
        }
        if self.is_closed {
            return Ok(0);
        }
        assert!(!self.rx.is_empty(), "this would block");
        let len = out.len().min(self.rx.len()).min(self.at_once);
        for (to, from) in out.iter_mut().zip(self.rx.drain(..len)) {
            *to = from;
        }
        self.read += len;
        assert!(self.read <= 128, "more than the budget was read");
        Ok(len)
    }
}

impl WriteReady for Uart {
    fn write_ready(&mut self) -> Result<bool, ErrorKind> {
        Ok(self.write_fails || self.is_closed || self.left > 0)
    }
}

impl Write for Uart {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        if std::mem::take(&mut self.write_fails) {
            return Err(ErrorKind::Other);
        }
        if self.is_closed {
            return Ok(0);
        }
        assert!(self.left > 0, "this would block");
        let len = bytes.len().min(self.left).min(self.at_once);
        self.tx.extend(&bytes[..len]);
        self.left -= len;
        self.written += len;
        assert!(self.written <= 280, "more than the budget was written");
        Ok(len)
    }

    fn flush(&mut self) -> Result<(), ErrorKind> {
        panic!("this would block");
    }
}
