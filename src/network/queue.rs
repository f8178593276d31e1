//! A queue of frames to forward to a link: a ring of bytes with a prefix of length and time for each
//! frame. A full queue drops whole frames.

use crate::time::{Duration, Instant};

/// The used part of a ring, whose bytes the caller owns.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Ring {
    start: usize,
    used: usize,
}

/// Length of the prefix of a frame: two bytes of length, and four bytes with the time of queueing in units of 1,024 µs.
const PREFIX: usize = 6;

impl Ring {
    pub(super) const EMPTY: Self = Self { start: 0, used: 0 };

    /// Returns whether an empty ring of `bytes` bytes has room for a frame of `frame` bytes.
    pub(super) const fn holds(bytes: usize, frame: usize) -> bool {
        bytes >= frame.saturating_add(PREFIX)
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.used == 0
    }

    /// Returns whether a ring of `size` bytes takes a frame of `len` bytes, such that `spare` bytes stay free. If it is empty,
    /// it needs no spare bytes.
    pub(super) const fn takes(&self, size: usize, len: usize, spare: usize) -> bool {
        let needed = len.saturating_add(PREFIX);
        let spare = if self.is_empty() { 0 } else { spare };
        size.saturating_sub(self.used) >= needed.saturating_add(spare)
    }

    /// Appends `frame`, which the ring [takes](Self::takes).
    pub(super) fn push(&mut self, bytes: &mut [u8], now: Instant, frame: &[u8]) {
        let (Ok(len), size) = (u16::try_from(frame.len()), bytes.len()) else { return };
        let [len_low, len_high] = len.to_le_bytes();
        let [t0, t1, t2, t3] = now.coarse().to_le_bytes();
        let end = wrapped(self.start.saturating_add(self.used), size);
        put(bytes, end, &[len_low, len_high, t0, t1, t2, t3]);
        put(bytes, wrapped(end.saturating_add(PREFIX), size), frame);
        self.used = self.used.saturating_add(frame.len().saturating_add(PREFIX));
    }

    /// Removes the oldest frame. Returns how long it waited, and its bytes in two parts.
    pub(super) fn pop<'a>(&mut self, bytes: &'a [u8], now: Instant) -> Option<(Duration, [&'a [u8]; 2])> {
        if self.is_empty() {
            return None;
        }
        let mut prefix = [0; PREFIX];
        let (front, back) = bytes.split_at_checked(self.start)?;
        for (to, from) in prefix.iter_mut().zip(back.iter().chain(front)) {
            *to = *from;
        }
        let [len_low, len_high, t0, t1, t2, t3] = prefix;
        let len = usize::from(u16::from_le_bytes([len_low, len_high]));
        let at = u32::from_le_bytes([t0, t1, t2, t3]);
        let begin = wrapped(self.start.saturating_add(PREFIX), bytes.len());
        let first = bytes.get(begin..)?;
        let first = first.get(..len).unwrap_or(first);
        let second = bytes.get(..len.saturating_sub(first.len()))?;
        self.start = wrapped(begin.saturating_add(len), bytes.len());
        self.used = self.used.saturating_sub(PREFIX.saturating_add(len));
        let waited = now.coarse().wrapping_sub(at);
        Some((Duration::from_micros(u64::from(waited) << 10), [first, second]))
    }
}

/// Writes `data` to a ring at `at`.
// Out of line: it has several callers.
#[inline(never)]
fn put(ring: &mut [u8], at: usize, data: &[u8]) {
    let Some((front, back)) = ring.split_at_mut_checked(at) else { return };
    for (cell, byte) in back.iter_mut().zip(data) {
        *cell = *byte;
    }
    let rest = data.get(back.len()..).unwrap_or_default();
    for (cell, byte) in front.iter_mut().zip(rest) {
        *cell = *byte;
    }
}

/// Wraps an offset in a ring of `size` bytes; `at` is less than twice `size`.
fn wrapped(at: usize, size: usize) -> usize {
    if at >= size { at.saturating_sub(size) } else { at }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;
    use std::vec::Vec;

    proptest! {
        /// Agrees with a queue that allocates: frames are returned whole and in order, with the time that they waited,
        /// and are refused only if there is no room.
        #[test]
        fn is_a_queue(size in 20_usize..120, steps: Vec<(bool, u8, u16, u8)>) {
            let (mut ring, mut bytes) = (Ring::EMPTY, std::vec![0; size]);
            let (mut model, mut held, mut now) = (VecDeque::<(u64, Vec<u8>)>::new(), 0, 0);
            for (is_push, len, wait, spare) in steps {
                now += u64::from(wait);
                if is_push {
                    let frame: Vec<u8> = (0..len % 50).map(|byte| byte ^ len).collect();
                    let spare = usize::from(spare % 40);
                    let free = size - if held > 0 { held + spare } else { 0 }.min(size);
                    let fits = frame.len() + PREFIX <= free;
                    prop_assert_eq!(ring.takes(bytes.len(), frame.len(), spare), fits);
                    if fits {
                        ring.push(&mut bytes, Instant::from_micros(now << 10), &frame);
                    }
                    if fits {
                        held += frame.len() + PREFIX;
                        model.push_back((now, frame));
                    }
                } else {
                    let popped = ring.pop(&bytes, Instant::from_micros(now << 10));
                    let popped = popped.map(|(waited, frame)| (waited.as_micros() >> 10, frame.concat()));
                    let expected = model.pop_front().map(|(at, frame)| (now - at, frame));
                    held -= expected.as_ref().map_or(0, |(_, frame)| frame.len() + PREFIX);
                    prop_assert_eq!(popped, expected);
                }
                prop_assert_eq!(ring.is_empty(), model.is_empty());
            }
        }
    }
}
