//! The memory of the flight logs: a ring of bytes, in which a new log evicts the oldest ones.
//!
//! It is made of atomics, so that it may be shared, and may be in memory that a reset keeps, with any content. It is written by one
//! task at a time. A vehicle with an SD card has files instead.

use core::fmt;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering::Relaxed};

use mavstack::logs::LogInfo;

/// The maximum number of logs.
pub const LOGS: usize = 8;
/// The bytes of all logs together.
pub const LOG_BYTES: usize = if cfg!(target_os = "none") { 64 * 1024 } else { 256 * 1024 };

const LEN: u32 = LOG_BYTES as u32;
const MAGIC: u32 = 0x6C6F_6731;

/// Size (bytes) and time (s since 1970) of a log.
struct Entry {
    size: AtomicU32,
    time: AtomicU32,
}

/// The logs: each begins where the one before it ends.
#[repr(C)]
pub struct LogMemory {
    /// [`MAGIC`] if the rest is valid.
    magic: AtomicU32,
    count: AtomicU32,
    /// Where the oldest log begins in `bytes`.
    start: AtomicU32,
    /// The oldest first.
    entries: [Entry; LOGS],
    bytes: [AtomicU8; LOG_BYTES],
}

impl LogMemory {
    /// Returns memory without a log.
    pub const fn new() -> Self {
        Self {
            magic: AtomicU32::new(0),
            count: AtomicU32::new(0),
            start: AtomicU32::new(0),
            entries: [const { Entry { size: AtomicU32::new(0), time: AtomicU32::new(0) } }; LOGS],
            bytes: [const { AtomicU8::new(0) }; LOG_BYTES],
        }
    }

    /// Erases memory that holds no valid logs. Call it once after boot.
    pub(crate) fn check(&self) {
        let is_valid = self.magic.load(Relaxed) == MAGIC
            && self.count.load(Relaxed) <= LOGS as u32
            && self.start.load(Relaxed) < LEN
            && self.sizes().try_fold(0u32, u32::checked_add).is_some_and(|sum| sum <= LEN);
        if !is_valid {
            self.erase();
        }
    }

    /// Erases all logs.
    pub(crate) fn erase(&self) {
        self.count.store(0, Relaxed);
        self.start.store(0, Relaxed);
        self.magic.store(MAGIC, Relaxed);
    }

    /// Returns the number of logs.
    pub(crate) fn count(&self) -> u16 {
        self.count.load(Relaxed) as u16
    }

    fn sizes(&self) -> impl Iterator<Item = u32> {
        self.entries.iter().take(usize::from(self.count())).map(|entry| entry.size.load(Relaxed))
    }

    /// Returns size and time of a log.
    pub(crate) fn info(&self, id: u16) -> Option<LogInfo> {
        let entry = self.entries.get(usize::from(id)).filter(|_| id < self.count())?;
        Some(LogInfo { size: entry.size.load(Relaxed), time_utc: entry.time.load(Relaxed) })
    }

    /// Returns the bytes of the ring from a place on, which is counted from the beginning of the oldest log.
    fn ring(&self, at: u32) -> impl Iterator<Item = &AtomicU8> {
        let first = (self.start.load(Relaxed).wrapping_add(at) % LEN) as usize;
        self.bytes.iter().skip(first).chain(&self.bytes)
    }

    /// Fills `out` with bytes of a log. Returns false if the log has fewer.
    pub(crate) fn read(&self, id: u16, offset: u32, out: &mut [u8]) -> bool {
        let size = self.info(id).map_or(0, |info| info.size);
        if offset.checked_add(out.len() as u32).is_none_or(|end| end > size) {
            return false;
        }
        let before: u32 = self.sizes().take(usize::from(id)).sum();
        for (to, from) in out.iter_mut().zip(self.ring(before + offset)) {
            *to = from.load(Relaxed);
        }
        true
    }

    /// Begins a log.
    pub(crate) fn begin(&self, time: u32) {
        if usize::from(self.count()) == LOGS {
            self.evict();
        }
        let count = self.count();
        if let Some(entry) = self.entries.get(usize::from(count)) {
            entry.size.store(0, Relaxed);
            entry.time.store(time, Relaxed);
            self.count.store(u32::from(count) + 1, Relaxed);
        }
    }

    /// Adds bytes to the newest log. Returns false, and adds nothing, if it alone fills the memory.
    pub(crate) fn append(&self, bytes: &[u8]) -> bool {
        let len = bytes.len() as u32;
        let mut used: u32 = self.sizes().sum();
        while used + len > LEN {
            if self.count() < 2 {
                return false;
            }
            self.evict();
            used = self.sizes().sum();
        }
        for (from, to) in bytes.iter().zip(self.ring(used)) {
            to.store(*from, Relaxed);
        }
        // The bytes come first: a reset in between loses them, and nothing else.
        if let Some(newest) = usize::from(self.count()).checked_sub(1).and_then(|newest| self.entries.get(newest)) {
            newest.size.store(newest.size.load(Relaxed) + len, Relaxed);
        }
        true
    }

    /// Removes the oldest log.
    fn evict(&self) {
        let size = self.sizes().next().unwrap_or(0);
        self.start.store((self.start.load(Relaxed) + size) % LEN, Relaxed);
        for (to, from) in self.entries.iter().zip(self.entries.iter().skip(1)) {
            to.size.store(from.size.load(Relaxed), Relaxed);
            to.time.store(from.time.load(Relaxed), Relaxed);
        }
        self.count.store(u32::from(self.count()).saturating_sub(1), Relaxed);
    }
}

impl Default for LogMemory {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Debug for LogMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LogMemory").field("count", &self.count()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::boxed::Box;
    use std::vec::Vec;

    use super::*;

    /// LOG-1: however many logs are written, of whatever sizes, those that there are have the bytes that were written last.
    #[test]
    fn the_newest_logs_are_kept() {
        let memory = Box::leak(Box::new(LogMemory::new()));
        memory.check();
        let mut written: Vec<Vec<u8>> = Vec::new();
        for number in 0..40usize {
            memory.begin(number as u32);
            written.push(Vec::new());
            let log = written.last_mut().unwrap();
            for part in 0..(number * 37 % 11) * 90 {
                let bytes = [number as u8 ^ part as u8; 101];
                let len = part % 102;
                assert!(memory.append(&bytes[..len]));
                log.extend(&bytes[..len]);
            }
            memory.check();
            let count = usize::from(memory.count());
            assert!((1..=LOGS).contains(&count));
            let kept = &written[written.len() - count..];
            for (id, log) in (0..).zip(kept) {
                let first = (written.len() - count) as u32;
                let time_utc = first + u32::from(id);
                assert_eq!(memory.info(id), Some(LogInfo { size: log.len() as u32, time_utc }));
                let mut read = std::vec![0; log.len()];
                assert!(memory.read(id, 0, &mut read) && &read == log, "log {id} of {count}");
                assert!(!memory.read(id, 1, &mut read) || log.is_empty());
            }
        }
    }

    /// A log that fills the memory ends, and stays whole. The next one evicts it.
    #[test]
    fn a_full_memory_takes_no_more() {
        let memory = Box::leak(Box::new(LogMemory::new()));
        memory.check();
        memory.begin(1);
        let taken = (0..LOG_BYTES).take_while(|_| memory.append(&[7; 100])).count();
        assert_eq!(taken, LOG_BYTES / 100);
        memory.begin(2);
        assert!(memory.append(&[8; 100]));
        assert_eq!((memory.count(), memory.info(0).unwrap().time_utc), (1, 2));
    }
}
