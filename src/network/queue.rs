//! Frames that wait for their turn on a link: a ring of bytes, each frame whole, behind its length and the time it came.

use super::memory::low_half;
use crate::time::{Duration, Instant};

/// Where the frames stand in the ring.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Ring {
    start: usize,
    used: usize,
}

/// Bytes before each frame: its length, and the low half of the time (ms).
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

    /// Puts `frame` behind the others. False, and nothing changed, when it has no room.
    pub(super) fn push(&mut self, bytes: &mut [u8], now: Instant, frame: &[u8]) -> bool {
        let (Ok(len), size) = (u16::try_from(frame.len()), bytes.len()) else { return false };
        let needed = frame.len().saturating_add(PREFIX);
        if size.saturating_sub(self.used) < needed {
            return false;
        }
        let end = wrapped(self.start.saturating_add(self.used), size);
        let Some((front, back)) = bytes.split_at_mut_checked(end) else { return false };
        let prefix = len.to_le_bytes().into_iter().chain(low_half(now).to_le_bytes());
        for (cell, byte) in back.iter_mut().chain(front).zip(prefix.chain(frame.iter().copied())) {
            *cell = byte;
        }
        self.used = self.used.saturating_add(needed);
        true
    }

    /// Takes the oldest frame out, and tells how long it waited. It stays readable until the next [`push`](Self::push).
    pub(super) fn pop<'a>(
        &mut self,
        bytes: &'a [u8],
        now: Instant,
    ) -> Option<(Duration, impl Iterator<Item = u8> + use<'a>)> {
        if self.is_empty() {
            return None;
        }
        let (front, back) = bytes.split_at_checked(self.start)?;
        let mut from_start = back.iter().chain(front).copied();
        let mut next = || from_start.next();
        let len = usize::from(u16::from_le_bytes([next()?, next()?]));
        let at = u32::from_le_bytes([next()?, next()?, next()?, next()?]);
        let taken = len.saturating_add(PREFIX);
        self.start = wrapped(self.start.saturating_add(taken), bytes.len());
        self.used = self.used.saturating_sub(taken);
        let waited = Duration::from_millis(u64::from(low_half(now).wrapping_sub(at)));
        Some((waited, from_start.take(len)))
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
        fn is_a_queue(size in 20_usize..120, steps: Vec<(bool, u8, u16)>) {
            let (mut ring, mut bytes) = (Ring::EMPTY, std::vec![0; size]);
            let (mut model, mut held, mut now) = (VecDeque::<(u64, Vec<u8>)>::new(), 0, 0);
            for (is_push, len, wait) in steps {
                now += u64::from(wait);
                if is_push {
                    let frame: Vec<u8> = (0..len % 50).map(|byte| byte ^ len).collect();
                    let fits = held + frame.len() + PREFIX <= size;
                    prop_assert_eq!(ring.push(&mut bytes, Instant::from_millis(now), &frame), fits);
                    if fits {
                        held += frame.len() + PREFIX;
                        model.push_back((now, frame));
                    }
                } else {
                    let popped = ring.pop(&bytes, Instant::from_millis(now));
                    let popped = popped.map(|(waited, frame)| (waited.as_millis(), frame.collect::<Vec<_>>()));
                    let expected = model.pop_front().map(|(at, frame)| (now - at, frame));
                    held -= expected.as_ref().map_or(0, |(_, frame)| frame.len() + PREFIX);
                    prop_assert_eq!(popped, expected);
                }
                prop_assert_eq!(ring.is_empty(), model.is_empty());
            }
        }
    }
}
