//! A simulated transport for the firmwares that are measured.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::{Duration, Instant};

/// A transport with up to `LEN` bytes to read. The bytes are prepared before a poll, so that the measurement does not include
/// that. It checks sent bytes for heartbeats.
pub struct Line<const LEN: usize> {
    piece: [u8; LEN],
    at: usize,
    len: usize,
    /// Whether it accepts bytes.
    pub accepts: bool,
    /// Time of the poll.
    pub now: Instant,
    heartbeat: Option<Instant>,
    /// The longest time between two heartbeats.
    pub gap: Duration,
}

impl<const LEN: usize> Line<LEN> {
    /// A line without bytes to read.
    pub const SILENT: Self = Self {
        piece: [0; LEN],
        at: 0,
        len: 0,
        accepts: true,
        now: Instant::ZERO,
        heartbeat: None,
        gap: Duration::ZERO,
    };

    /// Replaces the bytes to read. `write` fills the buffer and returns the length.
    pub fn put(&mut self, write: impl FnOnce(&mut [u8; LEN]) -> usize) {
        self.len = write(&mut self.piece).min(LEN);
        self.at = 0;
    }

    /// Appends bytes from `next` to the unread ones, up to `bytes` in total.
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

impl<const LEN: usize> ErrorType for Line<LEN> {
    type Error = Infallible;
}

impl<const LEN: usize> ReadReady for Line<LEN> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.at < self.len)
    }
}

impl<const LEN: usize> Read for Line<LEN> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let rest = self.piece.get(self.at..self.len).unwrap_or_default();
        let len = rest.len().min(bytes.len());
        // Written without a panic, because the image is proven to be free of panics.
        if let (Some(to), Some(from)) = (bytes.get_mut(..len), rest.get(..len)) {
            to.copy_from_slice(from);
        }
        self.at += len;
        Ok(len)
    }
}

impl<const LEN: usize> WriteReady for Line<LEN> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.accepts)
    }
}

impl<const LEN: usize> Write for Line<LEN> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        // The vehicle's own heartbeat. The budget is large enough to send it in one piece.
        if let [0xFD, _, _, _, _, 1, 1, 0, 0, 0, ..] = bytes
            && let Some(last) = self.heartbeat.replace(self.now)
        {
            self.gap = self.gap.max(self.now - last);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
