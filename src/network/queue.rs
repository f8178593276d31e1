//! Frames that wait for their turn on a link: a ring of bytes, each frame whole, behind its length and the time it came.

use crate::time::{Duration, Instant};

/// Where the frames stand in the ring.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Ring {
    start: usize,
    used: usize,
}

/// Bytes before each frame: its length, and when it came, in [`ticks`].
const PREFIX: usize = 6;

impl Ring {
    pub(super) const EMPTY: Self = Self { start: 0, used: 0 };

    /// A ring of so many bytes holds any frame, if it is empty.
    pub(super) const fn holds(bytes: usize, frame: usize) -> bool {
        bytes >= frame.saturating_add(PREFIX)
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.used == 0
    }

    /// Puts `frame` behind the others, if that leaves so many bytes free, or there are no others. False, and nothing changed,
    /// when it has no room.
    pub(super) fn push(&mut self, bytes: &mut [u8], now: Instant, frame: &[u8], spare: usize) -> bool {
        let (Ok(len), size) = (u16::try_from(frame.len()), bytes.len()) else { return false };
        let needed = frame.len().saturating_add(PREFIX);
        let spare = if self.is_empty() { 0 } else { spare };
        if size.saturating_sub(self.used) < needed.saturating_add(spare) {
            return false;
        }
        let [len_low, len_high] = len.to_le_bytes();
        let [t0, t1, t2, t3] = ticks(now).to_le_bytes();
        let end = wrapped(self.start.saturating_add(self.used), size);
        put(bytes, end, &[len_low, len_high, t0, t1, t2, t3]);
        put(bytes, wrapped(end.saturating_add(PREFIX), size), frame);
        self.used = self.used.saturating_add(needed);
        true
    }

    /// Takes the oldest frame out, in its two parts, and tells how long it waited.
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
        Some((span(ticks(now).wrapping_sub(at)), [first, second]))
    }
}

/// A time in units of 1,024 µs, which needs no division. Wraps after 50 days.
#[allow(clippy::as_conversions, reason = "the low half is meant")]
const fn ticks(now: Instant) -> u32 {
    (now.as_micros() >> 10) as u32
}

/// A span of such units.
fn span(ticks: u32) -> Duration {
    Duration::from_micros(u64::from(ticks) << 10)
}

/// Writes `data` into a ring from `at` on.
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

/// A place in a ring of `size` bytes; `at` is less than twice that.
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
        /// Against a queue that allocates: frames come out whole, in order, with the time that they waited, and are refused
        /// only when there is no room.
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
                    prop_assert_eq!(ring.push(&mut bytes, Instant::from_micros(now << 10), &frame, spare), fits);
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
