//! The queues between a UART's interrupt and the loop.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use super::SerialError;
use super::ring::Ring;

/// The queues of one UART: `RX` bytes from the interrupt to the loop, and `TX` bytes from the loop to the interrupt.
///
/// Both lengths are powers of two; see the [module](super) for how to choose them. Declare the queues as a `static`:
///
/// ```
/// use mavstack::io::{SerialError, SerialQueues};
/// # use mavstack::network::LinkError;
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
/// static TELEM: SerialQueues<64, 64> = SerialQueues::new();
///
/// /// The UART's interrupt handler: a byte was received, or the UART is ready to send.
/// fn on_uart(uart: &mut impl Registers) {
///     let mut telem = TELEM.interrupt_end();
///     if uart.has_error() {
///         telem.line_error();
///     }
///     if let Some(byte) = uart.received() {
///         telem.received(byte);
///     }
///     if uart.can_send() {
///         match telem.next_to_send() {
///             Some(byte) => uart.send(byte),
///             None => uart.enable_tx_interrupt(false),
///         }
///     }
/// }
///
/// /// In the loop, with `telem = TELEM.loop_end()`.
/// fn serve(
///     # now: Instant, stack: &mut StackOf<Mavlink>, vehicle: &mut Rover, uart: &mut impl Registers,
///     telem: &mut mavstack::io::LoopEnd<'_>,
/// ) -> Result<(), LinkError<SerialError>> {
///     let result = stack.poll_link(now, LinkId(0), telem, vehicle);
///     if telem.has_to_send() {
///         // The interrupt runs immediately, and again after each byte until the queue is empty.
///         uart.enable_tx_interrupt(true);
///     }
///     result
/// }
/// # trait Registers {
/// #     fn has_error(&self) -> bool;
/// #     fn received(&mut self) -> Option<u8>;
/// #     fn can_send(&self) -> bool;
/// #     fn send(&mut self, byte: u8);
/// #     fn enable_tx_interrupt(&mut self, enable: bool);
/// # }
/// ```
///
/// The queues are lock-free and work on processors without compare-and-swap. Use each end in one place only: two
/// interrupts or two loops at the same time may lose or repeat bytes, but cause no undefined behaviour.
#[derive(Debug)]
pub struct SerialQueues<const RX: usize, const TX: usize> {
    rx: Ring<[AtomicU8; RX]>,
    tx: Ring<[AtomicU8; TX]>,
    faults: Faults,
}

/// The errors so far, and those that were reported to the loop.
#[derive(Debug)]
struct Faults {
    /// Stored by the interrupt only.
    overrun_bytes: AtomicU32,
    line_errors: AtomicU32,
    /// Stored by the loop only.
    reported_overrun_bytes: AtomicU32,
    reported_line_errors: AtomicU32,
    /// Whether the last read returned an error. Then queued bytes are returned before the next error, because a link
    /// with permanent errors would never be read.
    must_return_data: AtomicBool,
}

impl Faults {
    /// Returns an error that was not yet reported, if any.
    fn unreported(&self) -> Option<SerialError> {
        if self.overrun_bytes.load(Ordering::Relaxed) != self.reported_overrun_bytes.load(Ordering::Relaxed) {
            return Some(SerialError::Overrun);
        }
        let is_unreported =
            self.line_errors.load(Ordering::Relaxed) != self.reported_line_errors.load(Ordering::Relaxed);
        is_unreported.then_some(SerialError::Line)
    }

    /// Marks all errors so far as reported.
    fn mark_reported(&self) {
        self.reported_overrun_bytes.store(self.overrun_bytes.load(Ordering::Relaxed), Ordering::Relaxed);
        self.reported_line_errors.store(self.line_errors.load(Ordering::Relaxed), Ordering::Relaxed);
    }
}

/// Counts of lost bytes and errors between the UART and the loop. They wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct SerialCounters {
    /// Bytes for which the receive queue had no room.
    pub overrun_bytes: u32,
    /// Errors that the UART reported to the interrupt: overruns in the UART, framing errors, noise.
    pub line_errors: u32,
}

impl<const RX: usize, const TX: usize> SerialQueues<RX, TX> {
    /// Returns empty queues.
    pub const fn new() -> Self {
        Self {
            rx: Ring::<[AtomicU8; RX]>::new(),
            tx: Ring::<[AtomicU8; TX]>::new(),
            faults: Faults {
                overrun_bytes: AtomicU32::new(0),
                line_errors: AtomicU32::new(0),
                reported_overrun_bytes: AtomicU32::new(0),
                reported_line_errors: AtomicU32::new(0),
                must_return_data: AtomicBool::new(false),
            },
        }
    }

    /// Returns the interrupt's end. It is a set of references: create it once, or in each interrupt.
    pub const fn interrupt_end(&self) -> InterruptEnd<'_> {
        InterruptEnd { rx: &self.rx, tx: &self.tx, faults: &self.faults }
    }

    /// Returns the loop's end, for [`poll_link`](crate::Stack::poll_link). It is a set of references: create it once,
    /// or for each poll.
    pub const fn loop_end(&self) -> LoopEnd<'_> {
        LoopEnd { rx: &self.rx, tx: &self.tx, faults: &self.faults }
    }
}

impl<const RX: usize, const TX: usize> Default for SerialQueues<RX, TX> {
    fn default() -> Self {
        Self::new()
    }
}

/// The end of [`SerialQueues`] for the interrupt of a UART or of its DMA.
#[derive(Debug)]
pub struct InterruptEnd<'a> {
    rx: &'a Ring,
    tx: &'a Ring,
    faults: &'a Faults,
}

impl InterruptEnd<'_> {
    /// Queues a byte that the UART received. If there is no room, the byte is dropped, counted and reported.
    pub fn received(&mut self, byte: u8) {
        self.received_all(&[byte]);
    }

    /// Queues bytes from a FIFO or a DMA buffer, as [`received`](Self::received).
    ///
    /// Pass the part of a DMA buffer that was filled since the last call. Call it when half of the buffer is full, when
    /// all of it is full, and when the UART detects an idle line.
    pub fn received_all(&mut self, bytes: &[u8]) {
        let lost = bytes.len().saturating_sub(self.rx.push(bytes));
        if lost > 0 {
            add(&self.faults.overrun_bytes, u32::try_from(lost).unwrap_or(u32::MAX));
        }
    }

    /// Returns whether the receive queue is full. A UART with flow control can then release RTS.
    pub fn is_full(&self) -> bool {
        self.rx.is_full()
    }

    /// Reports an error flag of the UART: an overrun in the UART, a framing error, or noise.
    pub fn line_error(&mut self) {
        add(&self.faults.line_errors, 1);
    }

    /// Removes and returns the next byte to send; `None` if there is none. Then disable the transmit interrupt.
    #[must_use = "the byte was removed from the queue: send it"]
    pub fn next_to_send(&mut self) -> Option<u8> {
        let mut byte = [0];
        (self.tx.pop(&mut byte) > 0).then_some(byte[0])
    }

    /// Moves bytes to send into `buffer`, for DMA and FIFOs, and returns how many.
    #[must_use = "the bytes were removed from the queue: send them"]
    pub fn take_to_send(&mut self, buffer: &mut [u8]) -> usize {
        self.tx.pop(buffer)
    }
}

/// Adds to a counter with a single writer: load and store suffice, also on processors without compare-and-swap.
fn add(counter: &AtomicU32, by: u32) {
    counter.store(counter.load(Ordering::Relaxed).wrapping_add(by), Ordering::Relaxed);
}

/// The end of [`SerialQueues`] for the loop, which [`poll_link`](crate::Stack::poll_link) reads and writes. It never
/// blocks.
#[derive(Debug)]
pub struct LoopEnd<'a> {
    rx: &'a Ring,
    tx: &'a Ring,
    faults: &'a Faults,
}

impl LoopEnd<'_> {
    /// Returns whether bytes are queued for sending.
    ///
    /// If so after a poll, start the interrupt: enable the UART's transmit interrupt, or set the interrupt pending. It
    /// then repeats until [`next_to_send`](InterruptEnd::next_to_send) returns `None`.
    pub fn has_to_send(&self) -> bool {
        !self.tx.is_empty()
    }

    /// Returns the counts of lost bytes and errors.
    pub fn counters(&self) -> SerialCounters {
        SerialCounters {
            overrun_bytes: self.faults.overrun_bytes.load(Ordering::Relaxed),
            line_errors: self.faults.line_errors.load(Ordering::Relaxed),
        }
    }

    /// Returns the error that the next read reports; `None` if it returns bytes.
    fn error_to_report(&self) -> Option<SerialError> {
        let must_return_bytes = self.faults.must_return_data.load(Ordering::Relaxed) && !self.rx.is_empty();
        if must_return_bytes { None } else { self.faults.unreported() }
    }
}

impl ErrorType for LoopEnd<'_> {
    type Error = SerialError;
}

impl ReadReady for LoopEnd<'_> {
    /// Returns whether there is a byte to read, or an error to report.
    fn read_ready(&mut self) -> Result<bool, SerialError> {
        Ok(!self.rx.is_empty() || self.faults.unreported().is_some())
    }
}

impl Read for LoopEnd<'_> {
    /// Removes received bytes from the queue.
    ///
    /// # Errors
    ///
    /// [`SerialError::Overrun`] or [`SerialError::Line`], once, if errors occurred since the last report. While bytes
    /// are queued, an error is never followed immediately by another. [`SerialError::WouldBlock`] if there is nothing
    /// to read.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, SerialError> {
        if buffer.is_empty() {
            return Ok(0);
        }
        if let Some(error) = self.error_to_report() {
            self.faults.mark_reported();
            self.faults.must_return_data.store(true, Ordering::Relaxed);
            return Err(error);
        }
        match self.rx.pop(buffer) {
            0 => Err(SerialError::WouldBlock),
            len => {
                self.faults.must_return_data.store(false, Ordering::Relaxed);
                Ok(len)
            }
        }
    }
}

impl WriteReady for LoopEnd<'_> {
    fn write_ready(&mut self) -> Result<bool, SerialError> {
        Ok(!self.tx.is_full())
    }
}

impl Write for LoopEnd<'_> {
    /// Queues as many of `bytes` as there is room for. See [`has_to_send`](LoopEnd::has_to_send).
    ///
    /// # Errors
    ///
    /// [`SerialError::WouldBlock`] if there is no room.
    fn write(&mut self, bytes: &[u8]) -> Result<usize, SerialError> {
        match self.tx.push(bytes) {
            0 if !bytes.is_empty() => Err(SerialError::WouldBlock),
            len => Ok(len),
        }
    }

    /// Succeeds if the interrupt has taken all bytes.
    ///
    /// # Errors
    ///
    /// [`SerialError::WouldBlock`] while bytes are queued for sending.
    fn flush(&mut self) -> Result<(), SerialError> {
        if self.has_to_send() { Err(SerialError::WouldBlock) } else { Ok(()) }
    }
}
