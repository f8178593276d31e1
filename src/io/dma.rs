//! Reading from a circular DMA buffer.

use core::sync::atomic::{AtomicU8, Ordering, fence};

use super::SerialError;
use crate::stack::{Declares, Stack};
use crate::time::Instant;
use crate::types::LinkId;

/// The number of bytes that are copied from the buffer at a time: on the call stack.
const PIECE: usize = 64;

/// The read position in a circular buffer that DMA fills continuously.
///
/// Receiving takes three lines in the loop. The hardware reports its write position, and the "transfer complete"
/// interrupt counts the laps (passes through the buffer):
///
/// ```
/// use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};
/// use mavstack::io::{CircularReader, SerialError};
/// # use mavstack::{Command, Commands, Context, Instant, LinkId, Outcome, Vehicle, VehicleState, StackOf};
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
/// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
/// #     }
/// # }
/// # #[derive(mavstack::Stack)]
/// # #[stack(vehicle: Rover, links: 1)]
/// # struct Mavlink;
///
/// static BUFFER: [AtomicU8; 256] = [const { AtomicU8::new(0) }; 256]; // written by the DMA only
/// static LAPS: AtomicU32 = AtomicU32::new(0); // written by the interrupt only
///
/// fn receive(
///     # now: Instant, stack: &mut StackOf<Mavlink>, vehicle: &mut Rover,
///     reader: &mut CircularReader, remaining: impl Fn() -> usize,
/// ) -> Result<(), SerialError> {
///     let laps = LAPS.load(Ordering::Acquire); // before the position
///     let position = BUFFER.len() - remaining(); // NDTR of an STM32
///     reader.poll(&BUFFER, laps, position, stack.receiver(now, LinkId(0), vehicle))
/// }
/// ```
///
/// Sending takes two lines, whenever the transmit DMA is idle:
///
/// ```
/// # use mavstack::{Command, Commands, Context, Instant, LinkId, Outcome, Vehicle, VehicleState, StackOf};
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
/// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
/// #     }
/// # }
/// # #[derive(mavstack::Stack)]
/// # #[stack(vehicle: Rover, links: 1)]
/// # struct Mavlink;
/// # fn send(now: Instant, stack: &mut StackOf<Mavlink>, vehicle: &mut Rover, mut start: impl FnMut(&[u8]) -> usize) {
/// let len = start(stack.transmit(now, LinkId(0), vehicle)); // copies as much as fits, and starts the DMA
/// stack.transmitted(LinkId(0), len);
/// # }
/// ```
///
/// The buffer must hold twice the bytes that are received between two polls: see [`queue_len`](super::queue_len).
///
/// # Memory that DMA writes
///
/// The compiler must know that the DMA writes the buffer. A `&[u8]` promises the opposite, so having one while the DMA
/// runs is undefined behaviour. The elements are atomic instead: each is read with one plain load, on every processor,
/// and copied before the stack sees it.
///
/// - Give the DMA the buffer's address, `BUFFER.as_ptr()`, and its length.
/// - The DMA must be able to access the memory. It cannot access the CCM of an STM32F4, or the DTCM of an STM32H7
///   (except by MDMA). Use `#[link_section]` to place the buffer in memory that it can access.
/// - On a processor with a data cache, such as the Cortex-M7 of an STM32F7 or H7, the cache hides the DMA's writes. The
///   simplest remedy is to make the buffer's memory non-cacheable by the MPU. Otherwise invalidate the buffer in the
///   cache before each poll (`SCB::invalidate_dcache_by_address`). The buffer then needs its own cache lines: aligned
///   to 32 bytes, with a length that is a multiple of 32. An invalidation loses all other data in these lines.
/// - For sending, the processor writes and the DMA reads. Clean the buffer's cache lines (`SCB::clean_dcache_by_slice`) before
///   the DMA starts, and leave the buffer alone until it has finished.
///
/// Some HALs hand over filled buffers with a length instead of filling a circular buffer. Copy these into
/// [`SerialQueues`](super::SerialQueues) in the DMA's interrupt, with
/// [`received_all`](super::InterruptEnd::received_all).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CircularReader {
    /// Lap of the next byte to be read.
    laps: u32,
    /// Its position in the buffer.
    position: usize,
    overruns: u32,
}

impl CircularReader {
    /// Returns a reader at the front of a buffer to which DMA has not yet written.
    pub const fn new() -> Self {
        Self { laps: 0, position: 0, overruns: 0 }
    }

    /// Returns how often bytes were overwritten before they were read. The count wraps.
    pub const fn overruns(&self) -> u32 {
        self.overruns
    }

    /// Passes the bytes written since the last poll to `receive`, at most 64 at a time. `receive` returns the number of
    /// bytes that it took.
    ///
    /// [`Stack::receiver`] takes fewer bytes when its budget is spent; the next poll passes the rest again. If there
    /// are no new bytes, `receive` is called once with an empty slice, so that the stack handles its backlog.
    ///
    /// `position` is the DMA's write position in `buffer`, and `laps` counts its passes through the buffer. Read `laps`
    /// before `position`. `laps` may be one too low, if the interrupt has not run yet. It wraps.
    ///
    /// # Errors
    ///
    /// [`SerialError::Overrun`] if bytes were overwritten before they were read. The overrun is counted and all bytes in the
    /// buffer are dropped, because the oldest would be overwritten next. The next poll continues with new bytes.
    pub fn poll(
        &mut self,
        buffer: &[AtomicU8],
        laps: u32,
        position: usize,
        mut receive: impl FnMut(&[u8]) -> usize,
    ) -> Result<(), SerialError> {
        // The bytes were written before the position was read.
        fence(Ordering::Acquire);
        let position = position.min(buffer.len());
        // The current lap is not counted yet if the writer seems to be behind the reader.
        let ahead = laps.wrapping_sub(self.laps);
        let is_uncounted = ahead > u32::MAX / 2 || (ahead == 0 && position < self.position);
        let (laps, ahead) = match is_uncounted {
            true if position < self.position => (self.laps.wrapping_add(1), 1),
            true => (self.laps, 0),
            false => (laps, ahead),
        };
        if ahead > 1 || (ahead == 1 && position >= self.position) {
            (self.laps, self.position) = (laps, position);
            self.overruns = self.overruns.wrapping_add(1);
            return Err(SerialError::Overrun);
        }
        let mut is_new = false;
        if ahead == 1 {
            let tail = buffer.get(self.position..).unwrap_or_default();
            is_new = !tail.is_empty();
            if !self.pass(tail, &mut receive) {
                return Ok(());
            }
            (self.laps, self.position) = (laps, 0);
        }
        let rest = buffer.get(self.position..position).unwrap_or_default();
        if !is_new && rest.is_empty() {
            receive(&[]);
        }
        self.pass(rest, &mut receive);
        Ok(())
    }

    /// Passes a part of the buffer that has no wrap in it. Returns false if `receive` did not take all of it.
    fn pass(&mut self, part: &[AtomicU8], receive: &mut impl FnMut(&[u8]) -> usize) -> bool {
        let mut piece = [0; PIECE];
        part.chunks(PIECE).all(|from| {
            let bytes = piece.get_mut(..from.len()).unwrap_or_default();
            for (byte, from) in bytes.iter_mut().zip(from) {
                *byte = from.load(Ordering::Relaxed);
            }
            let taken = receive(bytes).min(bytes.len());
            self.position = self.position.saturating_add(taken);
            taken == bytes.len()
        })
    }
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns a closure that takes received bytes in several pieces, for [`CircularReader::poll`], and handles the frames in them.
    /// The closure returns the number of bytes that it took.
    ///
    /// All pieces share the [budget](crate::Config::budget) of one poll: `rx_bytes`, `work` and `frames`. With
    /// [`receive`](Self::receive), each piece would have a budget of its own (D-2).
    pub fn receiver(&mut self, now: Instant, link: LinkId, vehicle: &mut D::Vehicle) -> impl FnMut(&[u8]) -> usize {
        let budget = self.config().budget;
        let mut allowance = budget.allowance();
        let mut left = usize::try_from(budget.rx_bytes).unwrap_or(usize::MAX);
        move |bytes| {
            let bytes = bytes.get(..left).unwrap_or(bytes);
            let taken = self.receive_within(now, link, bytes, vehicle, &mut allowance);
            left = left.saturating_sub(taken);
            taken
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const LEN: usize = 16;

    /// A DMA that writes consecutive numbers.
    struct Dma {
        buffer: [AtomicU8; LEN],
        written: usize,
        /// The laps that its interrupt has counted.
        laps: u32,
    }

    impl Dma {
        fn write(&mut self, len: usize) {
            for _ in 0..len {
                self.buffer[self.written % LEN].store(self.written as u8, Ordering::Relaxed);
                self.written += 1;
            }
        }
    }

    proptest! {
        /// Every byte is received once and in order, or an overrun is reported: exactly when more was written than
        /// fits.
        #[test]
        fn each_byte_is_received_once_or_an_overrun_is_reported(
            steps in proptest::collection::vec((0..24usize, 0..24usize, any::<bool>()), 1..100),
            first_lap in prop_oneof![Just(0u32), Just(u32::MAX - 2)],
        ) {
            let mut dma = Dma { buffer: [const { AtomicU8::new(0) }; LEN], written: 0, laps: first_lap };
            let mut reader = CircularReader { laps: first_lap, ..CircularReader::new() };
            let mut read = 0;
            let mut overruns = 0;
            for (len, mut budget, is_late) in steps {
                let before = dma.written / LEN;
                dma.write(len);
                let laps = first_lap.wrapping_add((dma.written / LEN) as u32);
                // The interrupt may be late by one lap, and only if it was in time before.
                let may_be_late = is_late && dma.written / LEN == before + 1 && dma.written - read < LEN;
                dma.laps = if may_be_late { laps.wrapping_sub(1) } else { laps };
                let mut received: Vec<u8> = Vec::new();
                let position = dma.written % LEN;
                let result = reader.poll(&dma.buffer, dma.laps, position, |bytes| {
                    let taken = bytes.len().min(budget);
                    received.extend(&bytes[..taken]);
                    budget -= taken;
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
                    prop_assert!(read == dma.written || budget == 0);
                }
                prop_assert_eq!(reader.overruns(), overruns);
            }
        }
    }

    #[test]
    fn without_new_bytes_the_stack_is_called_once() {
        let mut reader = CircularReader::new();
        let mut calls = Vec::new();
        for _ in 0..2 {
            let taken = reader.poll(&[const { AtomicU8::new(7) }; LEN], 0, 3, |bytes| {
                calls.push(bytes.len());
                bytes.len()
            });
            assert_eq!(taken, Ok(()));
        }
        assert_eq!(calls, [3, 0]);
    }

    /// The interrupt that counts laps may run after more than one poll, and the position may be the buffer's end.
    #[test]
    fn laps_may_be_counted_late_and_the_position_may_be_the_buffers_end() {
        let mut reader = CircularReader::new();
        let buffer: [AtomicU8; LEN] = core::array::from_fn(|at| AtomicU8::new(at as u8));
        let steps: [(u32, usize, &[u8]); 6] = [
            (0, 12, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
            (0, 2, &[12, 13, 14, 15, 0, 1]),
            (0, 4, &[2, 3]),
            (1, 5, &[4]),
            (1, LEN, &[5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]),
            (2, 1, &[0]),
        ];
        for (laps, position, expected) in steps {
            let mut received = Vec::new();
            let result = reader.poll(&buffer, laps, position, |bytes| {
                received.extend(bytes);
                bytes.len()
            });
            assert_eq!((result, &received[..]), (Ok(()), expected), "lap {laps}, position {position}");
        }
        assert_eq!(reader.overruns(), 0);
    }
}
