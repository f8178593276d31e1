//! The memory of the flight logs: a ring of bytes, in which a new log evicts the oldest ones.
//!
//! It is made of atomics, so that it may be shared, and may be in memory that a reset keeps, with any content. It is written by one
//! task at a time. A vehicle with an SD card has files instead.

use core::fmt;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering::Relaxed, Ordering::SeqCst, compiler_fence};

use mavstack::logs::LogInfo;

/// The maximum number of logs.
pub const LOGS: usize = 8;
/// The bytes of all logs together.
pub const LOG_BYTES: usize = if cfg!(target_os = "none") { 64 * 1024 } else { 256 * 1024 };

const LEN: u32 = LOG_BYTES as u32;
const MAGIC: u32 = 0x6C6F_6732;

/// Where a log begins in the ring, its size (bytes) and time (s since 1970).
struct Entry {
    start: AtomicU32,
    size: AtomicU32,
    time: AtomicU32,
}

impl Entry {
    const fn new() -> Self {
        Self { start: AtomicU32::new(0), size: AtomicU32::new(0), time: AtomicU32::new(0) }
    }
}

/// The logs: each begins where the one before it ends.
///
/// A reset may come between any two writes, so each change becomes valid by a single one: that of `state`, or of a size. What is written
/// before it belongs to no log yet, and what is evicted belongs to none any more when it is overwritten.
#[repr(C)]
pub struct LogMemory {
    /// [`MAGIC`] if the rest is valid.
    magic: AtomicU32,
    /// The place of the oldest log in `entries`, times 256, plus the number of logs.
    state: AtomicU32,
    /// A ring too.
    entries: [Entry; LOGS],
    bytes: [AtomicU8; LOG_BYTES],
}

/// Writes a word. Neither this nor the writes before and after it change their order.
fn set(word: &AtomicU32, value: u32) {
    #[cfg(test)]
    tests::step();
    compiler_fence(SeqCst);
    word.store(value, Relaxed);
    compiler_fence(SeqCst);
}

impl LogMemory {
    /// Returns memory without a log.
    pub const fn new() -> Self {
        Self {
            magic: AtomicU32::new(0),
            state: AtomicU32::new(0),
            entries: [const { Entry::new() }; LOGS],
            bytes: [const { AtomicU8::new(0) }; LOG_BYTES],
        }
    }

    /// Erases memory that holds no valid logs. Call it once after boot.
    pub(crate) fn check(&self) {
        let (first, count) = self.state();
        let mut used = 0u32;
        let follows = |entry: &Entry| {
            let (start, size) = (entry.start.load(Relaxed), entry.size.load(Relaxed));
            let is_next = start < LEN && start == (self.start().wrapping_add(used)) % LEN;
            used = used.saturating_add(size);
            is_next && used <= LEN
        };
        let is_valid =
            self.magic.load(Relaxed) == MAGIC && first < LOGS && count <= LOGS && self.entries().all(follows);
        if !is_valid {
            self.erase();
            set(&self.magic, MAGIC);
        }
    }

    /// Erases all logs.
    pub(crate) fn erase(&self) {
        set(&self.state, 0);
    }

    /// Returns the place of the oldest log, and the number of logs.
    fn state(&self) -> (usize, usize) {
        let state = self.state.load(Relaxed);
        ((state >> 8) as usize, (state & 0xFF) as usize)
    }

    fn set_state(&self, first: usize, count: usize) {
        set(&self.state, ((first % LOGS) << 8 | count) as u32);
    }

    /// Returns the number of logs.
    pub(crate) fn count(&self) -> u16 {
        self.state().1 as u16
    }

    /// Returns the entries of the logs, the oldest first.
    fn entries(&self) -> impl Iterator<Item = &Entry> {
        let (first, count) = self.state();
        self.entries.iter().skip(first).chain(&self.entries).take(count.min(LOGS))
    }

    fn sizes(&self) -> impl Iterator<Item = u32> {
        self.entries().map(|entry| entry.size.load(Relaxed))
    }

    /// Returns where the oldest log begins.
    fn start(&self) -> u32 {
        self.entries().next().map_or(0, |entry| entry.start.load(Relaxed))
    }

    /// Returns size and time of a log.
    pub(crate) fn info(&self, id: u16) -> Option<LogInfo> {
        let entry = self.entries().nth(usize::from(id))?;
        Some(LogInfo { size: entry.size.load(Relaxed), time_utc: entry.time.load(Relaxed) })
    }

    /// Returns the bytes of the ring from a place on, which is counted from the beginning of the oldest log.
    fn ring(&self, at: u32) -> impl Iterator<Item = &AtomicU8> {
        let first = (self.start().wrapping_add(at) % LEN) as usize;
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
        let (first, count) = self.state();
        let used: u32 = self.sizes().sum();
        if let Some(entry) = self.entries.get((first + count) % LOGS) {
            set(&entry.start, self.start().wrapping_add(used) % LEN);
            set(&entry.size, 0);
            set(&entry.time, time);
            self.set_state(first, count + 1);
        }
    }

    /// Adds bytes to the newest log. Returns false, and adds nothing, if there is none, or if it alone fills the memory.
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
        let Some(newest) = self.entries().last() else { return false };
        for (from, to) in bytes.iter().zip(self.ring(used)) {
            #[cfg(test)]
            tests::step();
            to.store(*from, Relaxed);
        }
        set(&newest.size, newest.size.load(Relaxed) + len);
        true
    }

    /// Removes the oldest log.
    fn evict(&self) {
        let (first, count) = self.state();
        self.set_state(first + 1, count.saturating_sub(1));
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
    use core::cell::Cell;
    use core::panic::AssertUnwindSafe;
    use std::boxed::Box;
    use std::vec::Vec;

    use super::*;

    std::thread_local! {
        /// So many writes come before a reset.
        static STEPS: Cell<usize> = const { Cell::new(usize::MAX) };
    }

    /// Called before each write.
    pub(super) fn step() {
        match STEPS.get().checked_sub(1) {
            Some(left) => STEPS.set(left),
            None => std::panic::resume_unwind(Box::new("reset")),
        }
    }

    /// Returns the bytes of a log from `offset` on.
    fn content(time: u32, offset: usize, len: usize) -> Vec<u8> {
        (offset..offset + len).map(|at| (at / 7) as u8 ^ (at as u8).wrapping_mul(3) ^ time as u8).collect()
    }

    /// LOG-1: a reset at any write, of a log that is begun and then evicts the oldest ones, loses no other log, and no log has bytes of
    /// another one.
    #[test]
    fn a_reset_at_any_write_keeps_whole_logs() {
        let size = LOG_BYTES / LOGS;
        for steps in 0.. {
            let memory = Box::new(LogMemory::new());
            memory.check();
            // The ring is full, and the oldest log is not in the first place.
            for time in 0..LOGS as u32 + 3 {
                memory.begin(time);
                assert!(memory.append(&content(time, 0, size)));
            }
            STEPS.set(steps);
            let ended = std::panic::catch_unwind(AssertUnwindSafe(|| {
                memory.begin(77);
                for offset in [0, 60] {
                    assert!(memory.append(&content(77, offset, 60)));
                }
                memory.begin(78);
            }));
            STEPS.set(usize::MAX);
            memory.check();
            let infos: Vec<LogInfo> = (0..memory.count()).map_while(|id| memory.info(id)).collect();
            let old: Vec<u32> = infos.iter().map(|info| info.time_utc).filter(|time| *time < 77).collect();
            assert!((LOGS - 2..=LOGS).contains(&old.len()), "{steps}: {infos:?}");
            assert!(old.iter().copied().eq(LOGS as u32 + 3 - old.len() as u32..LOGS as u32 + 3), "{steps}: {infos:?}");
            for (id, info) in (0..).zip(&infos) {
                let len = info.size as usize;
                assert!(if info.time_utc < 77 { len == size } else { len.is_multiple_of(60) }, "{steps}: {infos:?}");
                let mut read = std::vec![0; len];
                assert!(memory.read(id, 0, &mut read) && read == content(info.time_utc, 0, len), "{steps}: log {id}");
            }
            // It goes on.
            memory.begin(79);
            assert!(memory.append(&content(79, 0, 500)));
            if ended.is_ok() {
                assert!(steps > 120, "{steps} writes");
                break;
            }
        }
    }

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
