//! The other end of the measured link: a transport that always has the next bytes ready.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::{Duration, Instant};

/// The most bytes that one poll is given.
pub const PIECE: usize = 128;

/// What is to be read in this poll lies ready, so that making it is not counted; what is sent is looked at for heartbeats.
pub struct Line {
    piece: [u8; PIECE],
    at: usize,
    len: usize,
    /// Whether it takes what is sent.
    pub takes: bool,
    /// Of the poll.
    pub now: Instant,
    heartbeat: Option<Instant>,
    /// The longest time between two heartbeats.
    pub gap: Duration,
}

impl Line {
    pub const fn new() -> Self {
        Self { piece: [0; PIECE], at: 0, len: 0, takes: true, now: Instant::ZERO, heartbeat: None, gap: Duration::ZERO }
    }

    /// Adds what `next` gives behind what was not read, as far as there is room.
    pub fn fill(&mut self, bytes: usize, mut next: impl FnMut() -> Option<u8>) {
        self.piece.copy_within(self.at..self.len, 0);
        (self.at, self.len) = (0, self.len - self.at);
        while self.len < bytes {
            let Some(byte) = next() else { return };
            self.piece[self.len] = byte;
            self.len += 1;
        }
    }
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.at < self.len)
    }
}

impl Read for Line {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let len = bytes.len().min(self.len - self.at);
        bytes[..len].copy_from_slice(&self.piece[self.at..self.at + len]);
        self.at += len;
        Ok(len)
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.takes)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        // Ours, whole; what budget it is sent by is enough for that.
        if let [0xFD, _, _, _, _, 1, 1, 0, 0, 0, ..] = bytes
            && let Some(last) = self.heartbeat.replace(self.now)
        {
            self.gap = self.gap.max(self.now.since(last));
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
