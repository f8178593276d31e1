//! Transports. For UARTs: queues between an interrupt and the loop, a reader for circular DMA buffers, the ends of a link in async
//! tasks, and adapters for HALs that do not implement the four traits that [`Stack::poll_link`](crate::Stack::poll_link) needs.
//! For UDP: [`UdpLinks`], a link for each ground station that sends to a socket.
//!
//! [The guide](crate::guides::transports) lists what to pass for the traits that a HAL has, HAL by HAL.
//!
//! They do not block, except for `Io06`, which blocks if the HAL does. Where a trait's contract says that a call
//! blocks, they return [`SerialError::WouldBlock`] or `HalError::WouldBlock`. The stack never sees these errors,
//! because it checks `read_ready` and `write_ready` first.
//!
//! # Length of the queues
//!
//! A link receives baud × poll period / 10 bytes between two polls. The receive queue should hold twice as many, so
//! that a poll may be late. [`queue_len`] computes its length:
//!
//! | baud | polled every | bytes between two polls | queue | [`PollBudget`](crate::config::PollBudget) |
//! |---:|---:|---:|---:|---|
//! | 57,600 | 4 ms | 24 | 64 | the default |
//! | 115,200 | 4 ms | 47 | 128 | the default |
//! | 115,200 | 20 ms | 231 | 512 | [`for_link`](crate::config::PollBudget::for_link) |
//! | 921,600 | 1 ms | 93 | 256 | the default for a ground station, else `for_link` |
//! | 921,600 | 4 ms | 369 | 1,024 | `for_link` |
//! | 921,600 | 20 ms | 1,844 | 4,096 | `for_link` |
//!
//! The default budget handles three frames per poll. That suffices for long frames on any link, but not for short
//! frames on a fast link. Excess frames stay in the queue until it overflows.
//!
//! A transmit queue of the same length keeps the link busy. A longer one only adds latency: queued bytes cannot be
//! reordered, so answers wait behind them.
//!
//! # Lost bytes are reported
//!
//! [`LoopEnd::counters`] counts the bytes for which the queue had no room and the errors that the UART reported to the
//! interrupt. The next read reports them once, as a [`SerialError`]. The stack counts it in
//! [`LinkCounters::read_errors`](crate::network::LinkCounters::read_errors), and `poll_link` returns it as
//! [`LinkError::Read`](crate::network::LinkError::Read) (S-20).

#[cfg(feature = "embedded-io-async")]
mod asynch;
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
mod udp;

#[cfg(feature = "embedded-io-async")]
pub use asynch::{AsyncReceiver, AsyncTransmitter};
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
pub use udp::{DatagramSocket, MAX_DATAGRAM_LEN, UdpLinks};

use crate::time::Duration;

/// The error of [`LoopEnd`] and [`CircularReader`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SerialError {
    /// Bytes were lost, because they were received faster than they were read. Poll more often, or make the queue
    /// longer.
    Overrun,
    /// The UART reported an error on the line, or an overrun in the UART itself.
    Line,
    /// There is nothing to read, or no room to write, and the call does not block. Call `read_ready` or `write_ready`
    /// first.
    WouldBlock,
}

impl core::fmt::Display for SerialError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Overrun => {
                "bytes were received faster than they were read: poll more often, or make the queue longer"
            }
            Self::Line => "the UART reported an error on the line or an overrun: check the baud rate and the wiring",
            Self::WouldBlock => "the queue is not ready: call read_ready or write_ready first",
        })
    }
}

impl core::error::Error for SerialError {}

impl embedded_io::Error for SerialError {
    fn kind(&self) -> embedded_io::ErrorKind {
        embedded_io::ErrorKind::Other
    }
}

/// Returns the length in bytes of a queue for a link of `baud` bit/s that is polled every `period`.
///
/// It is twice the number of bytes in a period, rounded up to a power of two, and at least 32. A period above 1 s
/// counts as 1 s.
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

    /// The table in the module's documentation.
    #[test]
    fn queue_lengths_are_those_of_the_table() {
        let rows = [
            (57_600, 4, 64),
            (115_200, 4, 128),
            (115_200, 20, 512),
            (921_600, 1, 256),
            (921_600, 4, 1_024),
            (921_600, 20, 4_096),
        ];
        for (baud, millis, len) in rows {
            assert_eq!(queue_len(baud, Duration::from_millis(millis)), len, "{baud} baud, {millis} ms");
        }
        assert_eq!(queue_len(0, Duration::ZERO), 32);
        assert_eq!(queue_len(u32::MAX, Duration::from_secs(1_000_000)), 1 << 30);
    }
}
