//! A circular buffer that DMA fills.

use super::SerialError;

/// How far a circular buffer was read that DMA writes without end, in halves or otherwise.
///
/// Three lines in the loop. The hardware says where it writes, and its interrupt "transfer complete" counts the laps:
///
/// ```
/// use core::sync::atomic::{AtomicU32, Ordering};
/// use mavstack::io::{CircularReader, SerialError};
/// # use mavstack::{Autopilot, Instant, LinkId, Stack};
///
/// static LAPS: AtomicU32 = AtomicU32::new(0); // its one writer is the interrupt
///
/// fn receive<V: Autopilot>(
///     # now: Instant, stack: &mut Stack<1>, vehicle: &mut V,
///     reader: &mut CircularReader, buffer: &[u8], remaining: impl Fn() -> usize,
/// ) -> Result<(), SerialError> {
///     let laps = LAPS.load(Ordering::Acquire); // before the place
///     let place = buffer.len() - remaining(); // NDTR of an STM32
///     reader.poll(buffer, laps, place, |bytes| stack.receive(now, LinkId(0), bytes, vehicle))
/// }
/// ```
///
/// And three to send, whenever the DMA is idle:
///
/// ```
/// # use mavstack::{Autopilot, Instant, LinkId, Stack};
/// # fn send<V: Autopilot>(now: Instant, stack: &mut Stack<1>, vehicle: &mut V, mut start: impl FnMut(&[u8]) -> usize) {
/// let len = start(stack.transmit(now, LinkId(0), vehicle)); // copies what it has room for, and begins
/// stack.transmitted(LinkId(0), len);
/// # }
/// ```
///
/// The buffer has room for what comes between two polls, twice: [`queue_len`](super::queue_len). Where the buffers of a HAL
/// change hands instead, and come one by one with a length, put them into [`SerialQueues`](super::SerialQueues) in the DMA's
/// interrupt: [`received_all`](super::InterruptEnd::received_all).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CircularReader {
    /// Of the next byte to be read.
    laps: u32,
    place: usize,
    overruns: u32,
}

impl CircularReader {
    /// At the front of a buffer that is not written yet.
    pub const fn new() -> Self {
        Self { laps: 0, place: 0, overruns: 0 }
    }

    /// How often bytes were overwritten before they were read. Wraps.
    pub const fn overruns(&self) -> u32 {
        self.overruns
    }

    /// Hands what was written since to `receive`, which returns how much it took: all but what is beyond the budget of a
    /// poll, which it is given again the next time. With nothing new it is called once with no bytes, for what waits in the
    /// stack.
    ///
    /// The writer is at `place` of `buffer` in lap number `laps`, which was read before `place`; it may lag by one, when the
    /// interrupt that counts has not run yet. `laps` wraps.
    ///
    /// # Errors
    ///
    /// [`SerialError::Overrun`] when bytes were overwritten before they were read: what is in the buffer is given up, for the
    /// next is about to be overwritten too, and the overrun is counted. The next poll goes on.
    pub fn poll(
        &mut self,
        buffer: &[u8],
        laps: u32,
        place: usize,
        mut receive: impl FnMut(&[u8]) -> usize,
    ) -> Result<(), SerialError> {
        let place = place.min(buffer.len());
        // Behind us: the lap we are in is not counted yet.
        let ahead = laps.wrapping_sub(self.laps);
        let is_uncounted = ahead > u32::MAX / 2 || (ahead == 0 && place < self.place);
        let (laps, ahead) = match is_uncounted {
            true if place < self.place => (self.laps.wrapping_add(1), 1),
            true => (self.laps, 0),
            false => (laps, ahead),
        };
        if ahead > 1 || (ahead == 1 && place >= self.place) {
            (self.laps, self.place) = (laps, place);
            self.overruns = self.overruns.wrapping_add(1);
            return Err(SerialError::Overrun);
        }
        let mut is_new = false;
        if ahead == 1 {
            let tail = buffer.get(self.place..).unwrap_or_default();
            if !tail.is_empty() {
                is_new = true;
                let taken = receive(tail).min(tail.len());
                self.place = self.place.saturating_add(taken);
                if taken < tail.len() {
                    return Ok(());
                }
            }
            (self.laps, self.place) = (laps, 0);
        }
        let rest = buffer.get(self.place..place).unwrap_or_default();
        if !rest.is_empty() || !is_new {
            self.place = self.place.saturating_add(receive(rest).min(rest.len()));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const LEN: usize = 16;

    /// A DMA that writes the numbers of its bytes.
    struct Dma {
        buffer: [u8; LEN],
        written: usize,
        /// What its interrupt counted.
        laps: u32,
    }

    impl Dma {
        fn write(&mut self, len: usize) {
            for _ in 0..len {
                self.buffer[self.written % LEN] = self.written as u8;
                self.written += 1;
            }
        }
    }

    proptest! {
        /// Every byte comes once and in order, or an overrun is told; and it is told only when more was written than fits.
        #[test]
        fn every_byte_comes_once_or_its_loss_is_told(
            steps in proptest::collection::vec((0..24usize, 0..24usize, any::<bool>()), 1..100),
            first_lap in prop_oneof![Just(0u32), Just(u32::MAX - 2)],
        ) {
            let mut dma = Dma { buffer: [0; LEN], written: 0, laps: first_lap };
            let mut reader = CircularReader { laps: first_lap, ..CircularReader::new() };
            let mut read = 0;
            let mut overruns = 0;
            for (len, mut appetite, is_late) in steps {
                let before = dma.written / LEN;
                dma.write(len);
                let laps = first_lap.wrapping_add((dma.written / LEN) as u32);
                // The interrupt may be late by one lap, and only if it was in time before.
                let may_be_late = is_late && dma.written / LEN == before + 1 && dma.written - read < LEN;
                dma.laps = if may_be_late { laps.wrapping_sub(1) } else { laps };
                let mut received: Vec<u8> = Vec::new();
                let place = dma.written % LEN;
                let result = reader.poll(&dma.buffer, dma.laps, place, |bytes| {
                    let taken = bytes.len().min(appetite);
                    received.extend(&bytes[..taken]);
                    appetite -= taken;
                    taken
                });
                if dma.written - read >= LEN {
                    overruns += 1;
                    prop_assert_eq!(result, Err(SerialError::Overrun));
                    prop_assert!(received.is_empty());
                    read = dma.written;
                } else {
                    prop_assert_eq!(result, Ok(()));
                    let expected: Vec<u8> = (read..read + received.len()).map(|number| number as u8).collect();
                    prop_assert_eq!(&received, &expected);
                    read += received.len();
                    prop_assert!(read == dma.written || appetite == 0);
                }
                prop_assert_eq!(reader.overruns(), overruns);
            }
        }
    }

    #[test]
    fn with_nothing_new_the_stack_is_called_once() {
        let mut reader = CircularReader::new();
        let mut calls = Vec::new();
        for _ in 0..2 {
            let taken = reader.poll(&[7; LEN], 0, 3, |bytes| {
                calls.push(bytes.len());
                bytes.len()
            });
            assert_eq!(taken, Ok(()));
        }
        assert_eq!(calls, [3, 0]);
    }

    /// The interrupt that counts laps may come after more than one poll, and the place may be told as the buffer's end.
    #[test]
    fn a_lap_may_be_counted_late_and_end_at_the_buffers_end() {
        let mut reader = CircularReader::new();
        let buffer: [u8; LEN] = core::array::from_fn(|at| at as u8);
        let steps: [(u32, usize, &[u8]); 6] = [
            (0, 12, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
            (0, 2, &[12, 13, 14, 15, 0, 1]),
            (0, 4, &[2, 3]),
            (1, 5, &[4]),
            (1, LEN, &[5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]),
            (2, 1, &[0]),
        ];
        for (laps, place, expected) in steps {
            let mut received = Vec::new();
            let result = reader.poll(&buffer, laps, place, |bytes| {
                received.extend(bytes);
                bytes.len()
            });
            assert_eq!((result, &received[..]), (Ok(()), expected), "lap {laps}, place {place}");
        }
        assert_eq!(reader.overruns(), 0);
    }
}
