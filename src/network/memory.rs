//! What was forwarded a moment ago, so that a frame which comes back is not forwarded again.

use crate::time::{Duration, Instant};

/// One frame that was forwarded.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Seen {
    /// Of all its bytes; 0 where there is none.
    key: u32,
    /// The low half of the time (ms).
    at: u32,
}

impl Seen {
    /// No frame; zero bits.
    pub(super) const NONE: Self = Self { key: 0, at: 0 };
}

/// For how long a frame is known again (ms): less than the second after which a sender without sequence numbers sends the
/// same heartbeat again.
const KNOWN: u32 = 800;

/// For how long a frame is known at least (ms), however many come, where nothing comes around.
const KEPT: u32 = 100;

/// After the last copy that came around the lines are no loop any more.
const LOOP_OVER: Duration = Duration::from_secs(60);

/// The last frames that were forwarded. The logic works on the unsized form, so their number is compiled once.
#[derive(Clone, Debug)]
pub(super) struct Memory<S: ?Sized = [Seen]> {
    /// The place of the oldest.
    next: usize,
    /// When the last copy came around.
    copied: Option<Instant>,
    seen: S,
}

impl<const SEEN: usize> Memory<[Seen; SEEN]> {
    /// Zero bits.
    pub(super) const EMPTY: Self = Self { next: 0, copied: None, seen: [Seen::NONE; SEEN] };
}

impl Memory {
    /// Whether the frame with this key was forwarded a moment ago.
    pub(super) fn is_copy(&mut self, now: Instant, key: u32) -> bool {
        let at = low_half(now);
        let is_copy = self.seen.iter().any(|seen| seen.key == key && at.wrapping_sub(seen.at) < KNOWN);
        if is_copy {
            self.copied = Some(now);
        }
        is_copy
    }

    /// Whether frames come around: then none is forgotten before its time.
    pub(super) fn is_looped(&self, now: Instant) -> bool {
        self.copied.is_some_and(|at| now.since(at) < LOOP_OVER)
    }

    /// Notes that the frame with this key is forwarded, in the place of the oldest. False when that one is still needed.
    pub(super) fn remember(&mut self, now: Instant, key: u32) -> bool {
        let kept = if self.is_looped(now) { KNOWN } else { KEPT };
        let at = low_half(now);
        let count = self.seen.len();
        let Some(place) = self.seen.get_mut(self.next) else { return false };
        if place.key != 0 && at.wrapping_sub(place.at) < kept {
            return false;
        }
        *place = Seen { key, at };
        self.next = self.next.saturating_add(1);
        if self.next >= count {
            self.next = 0;
        }
        true
    }
}

/// A number for all bytes of a frame.
pub(super) fn key_of(frame: &[u8]) -> u32 {
    let add = |key: u32, word: u32| (key.rotate_left(5) ^ word).wrapping_mul(0x9E37_79B9);
    let (words, rest) = frame.as_chunks();
    let key = words.iter().fold(0, |key, &word| add(key, u32::from_le_bytes(word)));
    let key = rest.iter().fold(key, |key, &byte| add(key, u32::from(byte)));
    key.max(1)
}

/// The low half of a time (ms).
pub(super) fn low_half(now: Instant) -> u32 {
    u32::try_from(now.as_millis() & u64::from(u32::MAX)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Instant {
        Instant::from_millis(ms)
    }

    /// a frame is known for 800 ms, also where the milliseconds wrap, and when many others come for 100 ms at least.
    #[test]
    fn frames_are_known_for_a_while() {
        let wrap = u64::from(u32::MAX) + 1;
        for start in [0, 1, 5_000, wrap - 50, wrap] {
            let mut memory = Memory::<[Seen; 4]>::EMPTY;
            let memory: &mut Memory = &mut memory;
            assert!(!memory.is_copy(at(start), 7));
            for (key, ms) in [(7, 0), (8, 10), (9, 20), (10, 30)] {
                assert!(memory.remember(at(start + ms), key));
            }
            assert!(!memory.remember(at(start + 99), 11), "the first is still needed");
            assert!(memory.remember(at(start + 100), 11));
            assert!(!memory.is_copy(at(start + 100), 7) && memory.is_copy(at(start + 100), 8));
            assert!(memory.is_copy(at(start + 809), 8) && !memory.is_copy(at(start + 810), 8));
        }
    }

    /// once a copy came, none is forgotten before its time, until no copy came for a minute.
    #[test]
    fn loops_make_it_strict() {
        let mut memory = Memory::<[Seen; 2]>::EMPTY;
        let memory: &mut Memory = &mut memory;
        for (key, ms, room) in [(1, 0, true), (2, 1, true), (3, 99, false), (3, 100, true)] {
            assert_eq!(memory.remember(at(ms), key), room);
        }
        assert!(!memory.is_looped(at(100)) && memory.is_copy(at(200), 3) && memory.is_looped(at(200)));
        for (key, ms, room) in [(4, 800, false), (4, 801, true), (5, 899, false), (5, 900, true)] {
            assert_eq!(memory.remember(at(ms), key), room, "{key}");
        }
        assert!(memory.is_looped(at(60_199)) && !memory.is_looped(at(60_200)));
    }

    #[test]
    fn every_byte_counts() {
        let frame = [0xFD, 3, 0, 0, 7, 255, 190, 1, 2, 3, 4, 5, 6, 7, 8];
        for index in 0..frame.len() {
            let mut other = frame;
            other[index] ^= 0x10;
            assert_ne!(key_of(&frame), key_of(&other), "byte {index}");
        }
        assert_ne!(key_of(&frame), key_of(&frame[..14]));
    }
}
