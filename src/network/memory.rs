//! What was forwarded a moment ago, so that a frame which comes back is not forwarded again.

use crate::time::{Duration, Instant};

/// One frame that was forwarded.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Seen {
    /// Of all its bytes; 0 where there is none.
    key: u32,
    /// In [`ticks`].
    at: u32,
}

impl Seen {
    /// No frame; zero bits.
    pub(super) const NONE: Self = Self { key: 0, at: 0 };
}

/// For how long a frame is known again: 800 ms, less than the second after which a sender without sequence numbers sends the
/// same heartbeat again.
const KNOWN: u32 = ticks(Instant::from_millis(800));

/// For how long a frame is known at least, however many come, where nothing comes around: 100 ms.
const KEPT: u32 = ticks(Instant::from_millis(100));

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
        let at = ticks(now);
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
        let at = ticks(now);
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

/// A time in units of 1,024 µs, which needs no division. Wraps after 50 days.
#[allow(clippy::as_conversions, reason = "const fn: `try_from` cannot be called; the low half is meant")]
pub(super) const fn ticks(now: Instant) -> u32 {
    (now.as_micros() >> 10) as u32
}

/// A span of such units.
pub(super) fn span(ticks: u32) -> Duration {
    Duration::from_micros(u64::from(ticks) << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// So many ticks after boot.
    fn at(ticks: u64) -> Instant {
        Instant::from_micros(ticks << 10)
    }

    /// a frame is known for 800 ms, also where the ticks wrap, and when many others come for 100 ms at least.
    #[test]
    fn frames_are_known_for_a_while() {
        let (known, kept) = (u64::from(KNOWN), u64::from(KEPT));
        assert!((799..=800).contains(&at(known).as_millis()) && (99..=100).contains(&at(kept).as_millis()));
        let wrap = u64::from(u32::MAX) + 1;
        for start in [0, 1, 5_000, wrap - 50, wrap] {
            let mut memory = Memory::<[Seen; 4]>::EMPTY;
            let memory: &mut Memory = &mut memory;
            assert!(!memory.is_copy(at(start), 7));
            for (key, later) in [(7, 0), (8, 10), (9, 20), (10, 30)] {
                assert!(memory.remember(at(start + later), key));
            }
            assert!(!memory.remember(at(start + kept - 1), 11), "the first is still needed");
            assert!(memory.remember(at(start + kept), 11));
            assert!(!memory.is_copy(at(start + kept), 7) && memory.is_copy(at(start + kept), 8));
            assert!(memory.is_copy(at(start + known + 9), 8) && !memory.is_copy(at(start + known + 10), 8));
        }
    }

    /// once a copy came, none is forgotten before its time, until no copy came for a minute.
    #[test]
    fn loops_make_it_strict() {
        let (known, kept) = (u64::from(KNOWN), u64::from(KEPT));
        let mut memory = Memory::<[Seen; 2]>::EMPTY;
        let memory: &mut Memory = &mut memory;
        for (key, now, room) in [(1, 0, true), (2, 1, true), (3, kept - 1, false), (3, kept, true)] {
            assert_eq!(memory.remember(at(now), key), room);
        }
        assert!(!memory.is_looped(at(kept)) && memory.is_copy(at(200), 3) && memory.is_looped(at(200)));
        for (key, now, room) in
            [(4, known, false), (4, known + 1, true), (5, known + kept - 1, false), (5, known + kept, true)]
        {
            assert_eq!(memory.remember(at(now), key), room, "{key}");
        }
        let over = at(200).after(LOOP_OVER);
        assert!(memory.is_looped(Instant::from_micros(over.as_micros() - 1)) && !memory.is_looped(over));
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
