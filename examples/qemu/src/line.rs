//! The other end of a link of the firmwares that are measured: a transport that has the next bytes ready.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::{Duration, Instant};

/// What is to be read in a poll lies ready, `LEN` bytes at most, so that making it is not counted; what is sent is looked at for
/// heartbeats.
pub struct Line<const LEN: usize> {
    piece: [u8; LEN],
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

impl<const LEN: usize> Line<LEN> {
    /// With nothing to be read.
    pub const SILENT: Self =
        Self { piece: [0; LEN], at: 0, len: 0, takes: true, now: Instant::ZERO, heartbeat: None, gap: Duration::ZERO };

    /// What is to be read is what `write` writes, which says how long that is; nothing else.
    pub fn put(&mut self, write: impl FnOnce(&mut [u8; LEN]) -> usize) {
        self.len = write(&mut self.piece).min(LEN);
        self.at = 0;
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
        // Without a panic, as all that is proved to have none.
        if let (Some(to), Some(from)) = (bytes.get_mut(..len), rest.get(..len)) {
            to.copy_from_slice(from);
        }
        self.at += len;
        Ok(len)
    }
}

impl<const LEN: usize> WriteReady for Line<LEN> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.takes)
    }
}

impl<const LEN: usize> Write for Line<LEN> {
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
