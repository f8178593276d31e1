//! Ready ends for UARTs: between an interrupt and the loop, behind a circular DMA buffer, and for HALs that do not offer the
//! four traits that [`Stack::poll_link`](crate::Stack::poll_link) asks for.
//!
//! | what the HAL offers | what to hand to the stack |
//! |---|---|
//! | `Read + Write + ReadReady + WriteReady` of `embedded-io` 0.7, and a FIFO for what comes between two polls | its UART itself |
//! | interrupts, in whatever form | a [`LoopEnd`] of [`SerialQueues`] |
//! | circular DMA | [`CircularReader`] and the byte-level calls; or the DMA's interrupt in front of [`SerialQueues`] |
//! | the traits of `embedded-hal-nb` | `NbSerial`, feature `embedded-hal-nb` |
//! | all four traits of `embedded-io` 0.6 | `Io06`, feature `embedded-io-06` |
//! | `embedded-io-async`'s `Read` and `Write`, and `ReadReady` | `Polled`, feature `embedded-io-async` |
//!
//! None of them waits. Where a contract would have them wait they say [`SerialError::WouldBlock`]; the stack never gets
//! there, because it asks first.
//!
//! # How large a queue
//!
//! Between two polls a line brings baud × poll period / 10 bytes. A receive queue has room for twice that, for the poll that
//! comes late; [`queue_len`] computes it:
//!
//! | baud | polled every | bytes between two polls | queue | [`PollBudget`](crate::PollBudget) |
//! |---:|---:|---:|---:|---|
//! | 57,600 | 4 ms | 24 | 64 | the default |
//! | 115,200 | 4 ms | 47 | 128 | the default |
//! | 115,200 | 20 ms | 231 | 512 | [`for_line`](crate::PollBudget::for_line) |
//! | 921,600 | 1 ms | 93 | 256 | the default for a ground station, else `for_line` |
//! | 921,600 | 4 ms | 369 | 1,024 | `for_line` |
//!
//! The default handles three frames a poll: more than any line brings of long ones, and fewer than a fast one can bring of short
//! ones. What is beyond it waits, and in the end finds the queue full.
//!
//! A transmit queue of the same length keeps the line busy. A longer one is worse: what stands in it is not taken back, and
//! an answer waits behind it.
//!
//! # What is lost is told
//!
//! Bytes that found the queue full, and errors that the interrupt was told of by its UART, are counted
//! ([`LoopEnd::counters`]) and reported once, as a [`SerialError`] of the next read: so in
//! [`LinkCounters::read_errors`](crate::LinkCounters::read_errors), and by `poll_link` as
//! [`LinkError::Read`](crate::LinkError::Read) (S-20).

mod dma;
#[cfg(any(feature = "embedded-hal-nb", feature = "embedded-io-06", feature = "embedded-io-async"))]
mod hal;
#[cfg(feature = "embedded-hal-nb")]
mod nb;
#[cfg(feature = "embedded-io-06")]
mod old;
#[cfg(feature = "embedded-io-async")]
mod polled;
mod ring;
mod serial;

pub use dma::CircularReader;
#[cfg(any(feature = "embedded-hal-nb", feature = "embedded-io-06", feature = "embedded-io-async"))]
pub use hal::HalError;
#[cfg(feature = "embedded-hal-nb")]
pub use nb::NbSerial;
#[cfg(feature = "embedded-io-06")]
pub use old::Io06;
#[cfg(feature = "embedded-io-async")]
pub use polled::Polled;
pub use serial::{InterruptEnd, LoopEnd, SerialCounters, SerialQueues};

use crate::time::Duration;

/// What an end reports when it fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SerialError {
    /// Bytes came faster than they were read, and some are lost: poll more often, or make the queue longer.
    Overrun,
    /// The interrupt was told of an error on the line, or of an overrun in the UART itself.
    Line,
    /// There is nothing to read, or no room to write, and nobody waits here. Ask `read_ready` and `write_ready` first.
    WouldBlock,
}

impl core::fmt::Display for SerialError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Overrun => "bytes came faster than they were read: poll more often, or make the queue longer",
            Self::Line => "the UART reported an error, or an overrun of its own",
            Self::WouldBlock => "not ready: ask read_ready and write_ready first",
        })
    }
}

impl core::error::Error for SerialError {}

impl embedded_io::Error for SerialError {
    fn kind(&self) -> embedded_io::ErrorKind {
        embedded_io::ErrorKind::Other
    }
}

/// How long a queue is for a line of `baud` bit/s that is polled every `period`, at most a second: twice the bytes that come
/// meanwhile, rounded up to a power of two, and 32 at least.
///
/// ```
/// use mavstack::Duration;
/// use mavstack::io::{SerialQueues, queue_len};
///
/// const LEN: usize = queue_len(57_600, Duration::from_millis(4));
/// static TELEM: SerialQueues<LEN, LEN> = SerialQueues::new();
/// assert_eq!(LEN, 64);
/// ```
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; u32 to u64, and less than 2^31 to usize")]
pub const fn queue_len(baud: u32, period: Duration) -> usize {
    let micros = period.as_micros();
    let micros = if micros > 1_000_000 { 1_000_000 } else { micros };
    let bytes = (baud as u64).saturating_mul(micros).div_ceil(10_000_000);
    let twice = bytes.saturating_mul(2);
    if twice < 32 { 32 } else { twice.next_power_of_two() as usize }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table above.
    #[test]
    fn a_queue_is_as_long_as_the_table_says() {
        let rows = [(57_600, 4, 64), (115_200, 4, 128), (115_200, 20, 512), (921_600, 1, 256), (921_600, 4, 1_024)];
        for (baud, millis, len) in rows {
            assert_eq!(queue_len(baud, Duration::from_millis(millis)), len, "{baud} baud, {millis} ms");
        }
        assert_eq!(queue_len(0, Duration::ZERO), 32);
        assert_eq!(queue_len(u32::MAX, Duration::from_secs(1_000_000)), 1 << 30);
    }
}
