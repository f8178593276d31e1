//! A lock-free single-producer, single-consumer queue of bytes, between an interrupt and the loop.
//!
//! It only loads and stores atomics, so it needs no `unsafe` and works on processors without compare-and-swap.
//! (`heapless::spsc` is not available on RISC-V without the A extension.)

use core::sync::atomic::{AtomicU8, AtomicUsize, Ordering};

/// A queue whose length is a power of two. All of its bytes are usable.
///
/// Two concurrent writers, or two readers, may lose or repeat bytes, but cause no undefined behaviour.
#[derive(Debug)]
pub(super) struct Ring<B: ?Sized = [AtomicU8]> {
    /// Number of bytes ever read, which wraps. Stored by the reader only.
    read: AtomicUsize,
    /// Number of bytes ever written, which wraps. Stored by the writer only.
    written: AtomicUsize,
    bytes: B,
}

impl<const N: usize> Ring<[AtomicU8; N]> {
    pub(super) const fn new() -> Self {
        const { assert!(N.is_power_of_two(), "the length of a queue must be a power of two: 32, 64, 128, ...") };
        Self { read: AtomicUsize::new(0), written: AtomicUsize::new(0), bytes: [const { AtomicU8::new(0) }; N] }
    }
}

impl Ring {
    fn cell(&self, count: usize) -> Option<&AtomicU8> {
        self.bytes.get(count & self.bytes.len().wrapping_sub(1))
    }

    /// Returns the number of queued bytes.
    pub(super) fn len(&self) -> usize {
        self.written.load(Ordering::Acquire).wrapping_sub(self.read.load(Ordering::Acquire))
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(super) fn is_full(&self) -> bool {
        self.len() >= self.bytes.len()
    }

    /// Appends as many of `bytes` as there is room for, and returns how many. For the writer.
    pub(super) fn push(&self, bytes: &[u8]) -> usize {
        let begin = self.written.load(Ordering::Relaxed);
        let room = self.bytes.len().saturating_sub(begin.wrapping_sub(self.read.load(Ordering::Acquire)));
        let mut end = begin;
        for byte in bytes.iter().take(room) {
            if let Some(cell) = self.cell(end) {
                cell.store(*byte, Ordering::Relaxed);
            }
            end = end.wrapping_add(1);
        }
        // Publish the bytes to the reader.
        self.written.store(end, Ordering::Release);
        end.wrapping_sub(begin)
    }

    /// Moves the oldest bytes into `buffer`, and returns how many. For the reader.
    pub(super) fn pop(&self, buffer: &mut [u8]) -> usize {
        let begin = self.read.load(Ordering::Relaxed);
        let queued = self.written.load(Ordering::Acquire).wrapping_sub(begin);
        let mut end = begin;
        for byte in buffer.iter_mut().take(queued) {
            if let Some(cell) = self.cell(end) {
                *byte = cell.load(Ordering::Relaxed);
            }
            end = end.wrapping_add(1);
        }
        // Give the room back to the writer.
        self.read.store(end, Ordering::Release);
        end.wrapping_sub(begin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;
    use std::vec::Vec;

    #[derive(Clone, Debug)]
    enum Step {
        Push(Vec<u8>),
        Pop(usize),
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let step = prop_oneof![
            proptest::collection::vec(any::<u8>(), 0..12).prop_map(Step::Push),
            (0usize..12).prop_map(Step::Pop),
        ];
        proptest::collection::vec(step, 0..200)
    }

    proptest! {
        /// It behaves as a queue of eight bytes, whatever its counters are, also when they wrap.
        #[test]
        fn is_a_queue(steps in steps(), start in prop_oneof![Just(0usize), Just(usize::MAX - 20), any::<usize>()]) {
            let ring: &Ring = &Ring::<[AtomicU8; 8]> {
                read: AtomicUsize::new(start),
                written: AtomicUsize::new(start),
                ..Ring::new()
            };
            let mut model = VecDeque::new();
            for step in steps {
                match step {
                    Step::Push(bytes) => {
                        let taken = ring.push(&bytes);
                        prop_assert_eq!(taken, bytes.len().min(8 - model.len()));
                        model.extend(&bytes[..taken]);
                    }
                    Step::Pop(len) => {
                        let mut buffer = [0; 12];
                        let popped = ring.pop(&mut buffer[..len]);
                        let expected: Vec<u8> = model.drain(..len.min(model.len())).collect();
                        prop_assert_eq!(&buffer[..popped], &expected[..]);
                    }
                }
                prop_assert_eq!(ring.len(), model.len());
                prop_assert_eq!((ring.is_empty(), ring.is_full()), (model.is_empty(), model.len() == 8));
            }
        }
    }

    #[test]
    fn bytes_between_two_threads_arrive_once_and_in_order() {
        let ring: &Ring = &Ring::<[AtomicU8; 16]>::new();
        // Miri detects data races, but is slow.
        let len: u32 = if cfg!(miri) { 300 } else { 50_000 };
        let sent: Vec<u8> = (0..len).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let mut received: Vec<u8> = Vec::new();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let mut rest = &sent[..];
                while !rest.is_empty() {
                    rest = &rest[ring.push(&rest[..rest.len().min(5)])..];
                    std::thread::yield_now();
                }
            });
            while received.len() < sent.len() {
                let mut buffer = [0; 7];
                let len = ring.pop(&mut buffer);
                received.extend(&buffer[..len]);
                std::thread::yield_now();
            }
        });
        assert!(received == sent);
    }
}
