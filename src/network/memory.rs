//! What was forwarded a moment ago, so that a frame which comes back is not forwarded again.

use crate::time::Instant;

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

/// For how long a frame is known again (ms), if there is room for so long: less than the second after which a sender
/// without sequence numbers sends the same heartbeat again.
const KNOWN: u32 = 800;

/// For how long a frame is known again at least (ms): what would have to take the place of a younger one is not forwarded.
const KEPT: u32 = 100;

/// A number for all bytes of a frame: FNV-1a.
pub(super) fn key_of(frame: &[u8]) -> u32 {
    let hash = frame.iter().fold(0x811C_9DC5_u32, |hash, &byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    hash.max(1)
}

/// Whether the frame with this key was forwarded a moment ago.
pub(super) fn is_known(seen: &[Seen], now: Instant, key: u32) -> bool {
    let now = low_half(now);
    seen.iter().any(|seen| seen.key == key && now.wrapping_sub(seen.at) < KNOWN)
}

/// Notes that the frame with this key is forwarded, in the place of the oldest, which is number `next`. False when that one
/// is still needed.
pub(super) fn remember(seen: &mut [Seen], next: &mut usize, now: Instant, key: u32) -> bool {
    let now = low_half(now);
    let count = seen.len();
    let Some(place) = seen.get_mut(*next) else { return false };
    if place.key != 0 && now.wrapping_sub(place.at) < KEPT {
        return false;
    }
    *place = Seen { key, at: now };
    *next = next.saturating_add(1);
    if *next >= count {
        *next = 0;
    }
    true
}

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
            let (mut seen, mut next) = ([Seen::NONE; 4], 0);
            assert!(!is_known(&seen, at(start), 7));
            assert!(remember(&mut seen, &mut next, at(start), 7));
            assert!(is_known(&seen, at(start + 799), 7) && !is_known(&seen, at(start + 800), 7));
            assert!(!is_known(&seen, at(start + 10), 8));
            for (key, ms) in [(8, 10), (9, 20), (10, 30)] {
                assert!(remember(&mut seen, &mut next, at(start + ms), key));
            }
            assert!(!remember(&mut seen, &mut next, at(start + 99), 11), "the first is still needed");
            assert!(is_known(&seen, at(start + 99), 7));
            assert!(remember(&mut seen, &mut next, at(start + 100), 11));
            assert!(!is_known(&seen, at(start + 100), 7) && is_known(&seen, at(start + 100), 8));
        }
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
