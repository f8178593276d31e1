//! Two queues between the interrupt of a UART and the loop.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use super::SerialError;
use super::ring::Ring;

/// The queues of one UART: `RX` bytes from the interrupt to the loop, `TX` bytes back, both powers of two; the
/// [module](super) says how many. For a `static`:
///
/// ```
/// use mavstack::io::{SerialError, SerialQueues};
/// # use mavstack::{Autopilot, Instant, LinkError, LinkId, Stack};
///
/// static TELEM: SerialQueues<64, 64> = SerialQueues::new();
///
/// /// The UART's interrupt: received, or ready to send.
/// fn on_uart(uart: &mut impl Registers) {
///     let mut telem = TELEM.interrupt_end();
///     if uart.has_failed() {
///         telem.line_error();
///     }
///     if let Some(byte) = uart.received() {
///         telem.received(byte);
///     }
///     if uart.can_send() {
///         match telem.next_to_send() {
///             Some(byte) => uart.send(byte),
///             None => uart.listen_to_sent(false),
///         }
///     }
/// }
///
/// /// In the loop, with `telem = TELEM.loop_end()`.
/// fn serve<V: Autopilot>(
///     # now: Instant, stack: &mut Stack<1>, vehicle: &mut V, uart: &mut impl Registers,
///     telem: &mut mavstack::io::LoopEnd<'_>,
/// ) -> Result<(), LinkError<SerialError>> {
///     let result = stack.poll_link(now, LinkId(0), telem, vehicle);
///     if telem.has_to_send() {
///         // The interrupt comes at once, and again after each byte until there is nothing to send.
///         uart.listen_to_sent(true);
///     }
///     result
/// }
/// # trait Registers {
/// #     fn has_failed(&self) -> bool;
/// #     fn received(&mut self) -> Option<u8>;
/// #     fn can_send(&self) -> bool;
/// #     fn send(&mut self, byte: u8);
/// #     fn listen_to_sent(&mut self, listen: bool);
/// # }
/// ```
///
/// Works on processors without compare-and-swap, and without a lock. There is one interrupt and one loop: with two of one kind at
/// the same time bytes are lost or repeated, and nothing worse.
#[derive(Debug)]
pub struct SerialQueues<const RX: usize, const TX: usize> {
    rx: Ring<[AtomicU8; RX]>,
    tx: Ring<[AtomicU8; TX]>,
    faults: Faults,
}

/// What went wrong, and what of it the loop was told.
#[derive(Debug)]
struct Faults {
    /// Written by the interrupt only.
    overrun_bytes: AtomicU32,
    line_errors: AtomicU32,
    /// Written by the loop only.
    told_overrun_bytes: AtomicU32,
    told_line_errors: AtomicU32,
    /// The last read was an error: first what waits, then the next error, or a line that fails all the time would never be read.
    owes_data: AtomicBool,
}

impl Faults {
    /// Whether the loop is to be told something, and what.
    fn untold(&self) -> Option<SerialError> {
        if self.overrun_bytes.load(Ordering::Relaxed) != self.told_overrun_bytes.load(Ordering::Relaxed) {
            return Some(SerialError::Overrun);
        }
        let is_untold = self.line_errors.load(Ordering::Relaxed) != self.told_line_errors.load(Ordering::Relaxed);
        is_untold.then_some(SerialError::Line)
    }

    /// The loop was told of all that happened so far.
    fn told(&self) {
        self.told_overrun_bytes.store(self.overrun_bytes.load(Ordering::Relaxed), Ordering::Relaxed);
        self.told_line_errors.store(self.line_errors.load(Ordering::Relaxed), Ordering::Relaxed);
    }
}

/// What was lost between the line and the loop. Numbers wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct SerialCounters {
    /// Bytes for which the receive queue had no room.
    pub overrun_bytes: u32,
    /// Errors that the interrupt was told of by the UART: overruns of its own, framing, noise.
    pub line_errors: u32,
}

impl<const RX: usize, const TX: usize> SerialQueues<RX, TX> {
    /// Empty queues.
    pub const fn new() -> Self {
        Self {
            rx: Ring::<[AtomicU8; RX]>::new(),
            tx: Ring::<[AtomicU8; TX]>::new(),
            faults: Faults {
                overrun_bytes: AtomicU32::new(0),
                line_errors: AtomicU32::new(0),
                told_overrun_bytes: AtomicU32::new(0),
                told_line_errors: AtomicU32::new(0),
                owes_data: AtomicBool::new(false),
            },
        }
    }

    /// What the interrupt works with. Costs nothing: make it where it is used, or once.
    pub const fn interrupt_end(&self) -> InterruptEnd<'_> {
        InterruptEnd { rx: &self.rx, tx: &self.tx, faults: &self.faults }
    }

    /// What the loop hands to [`poll_link`](crate::Stack::poll_link). Costs nothing, as the other end.
    pub const fn loop_end(&self) -> LoopEnd<'_> {
        LoopEnd { rx: &self.rx, tx: &self.tx, faults: &self.faults }
    }
}

impl<const RX: usize, const TX: usize> Default for SerialQueues<RX, TX> {
    fn default() -> Self {
        Self::new()
    }
}

/// The interrupt's end of [`SerialQueues`]: of a UART, or of the DMA behind it.
#[derive(Debug)]
pub struct InterruptEnd<'a> {
    rx: &'a Ring,
    tx: &'a Ring,
    faults: &'a Faults,
}

impl InterruptEnd<'_> {
    /// The UART received a byte. One for which there is no room is lost, counted, and told of.
    pub fn received(&mut self, byte: u8) {
        self.received_all(&[byte]);
    }

    /// The same for all that stands in a FIFO, or in the part of a DMA buffer that was filled since the last time: call it
    /// when half of the buffer is full, when all of it is, and when the line falls silent.
    pub fn received_all(&mut self, bytes: &[u8]) {
        let lost = bytes.len().saturating_sub(self.rx.push(bytes));
        if lost > 0 {
            add(&self.faults.overrun_bytes, u32::try_from(lost).unwrap_or(u32::MAX));
        }
    }

    /// Whether a byte that is received now would be lost: for who can hold the line (RTS) until it is not.
    pub fn is_full(&self) -> bool {
        self.rx.is_full()
    }

    /// The UART has an error flag set: it was overrun itself, or a byte was damaged.
    pub fn line_error(&mut self) {
        add(&self.faults.line_errors, 1);
    }

    /// The byte to be sent now; `None` when there is none, which is when to stop listening to "ready to send".
    #[must_use = "the byte is out of the queue: send it"]
    pub fn next_to_send(&mut self) -> Option<u8> {
        let mut byte = [0];
        (self.tx.pop(&mut byte) > 0).then_some(byte[0])
    }

    /// The same for DMA and FIFOs: moves what is to be sent into `buffer`, and returns how many bytes that are.
    #[must_use = "the bytes are out of the queue: send them"]
    pub fn take_to_send(&mut self, buffer: &mut [u8]) -> usize {
        self.tx.pop(buffer)
    }
}

/// One writer: load, add, store, for processors without compare-and-swap.
fn add(count: &AtomicU32, by: u32) {
    count.store(count.load(Ordering::Relaxed).wrapping_add(by), Ordering::Relaxed);
}

/// The loop's end of [`SerialQueues`]: what [`poll_link`](crate::Stack::poll_link) reads and writes. Nothing here waits.
#[derive(Debug)]
pub struct LoopEnd<'a> {
    rx: &'a Ring,
    tx: &'a Ring,
    faults: &'a Faults,
}

impl LoopEnd<'_> {
    /// Whether bytes wait to be sent. After a poll: then make the interrupt come, by having it listen to "ready to send", or by
    /// pending it; it goes on by itself until [`next_to_send`](InterruptEnd::next_to_send) has nothing.
    pub fn has_to_send(&self) -> bool {
        !self.tx.is_empty()
    }

    /// What was lost so far.
    pub fn counters(&self) -> SerialCounters {
        SerialCounters {
            overrun_bytes: self.faults.overrun_bytes.load(Ordering::Relaxed),
            line_errors: self.faults.line_errors.load(Ordering::Relaxed),
        }
    }

    /// The error that is due: after what was received before it, as far as that goes.
    fn due(&self) -> Option<SerialError> {
        let has_to_wait = self.faults.owes_data.load(Ordering::Relaxed) && !self.rx.is_empty();
        if has_to_wait { None } else { self.faults.untold() }
    }
}

impl ErrorType for LoopEnd<'_> {
    type Error = SerialError;
}

impl ReadReady for LoopEnd<'_> {
    /// Whether a byte waits, or an error that was not told yet.
    fn read_ready(&mut self) -> Result<bool, SerialError> {
        Ok(!self.rx.is_empty() || self.faults.untold().is_some())
    }
}

impl Read for LoopEnd<'_> {
    /// Takes what waits.
    ///
    /// # Errors
    ///
    /// What happened since the last error, once, and no two without bytes between them while bytes wait;
    /// [`SerialError::WouldBlock`] when there is nothing.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, SerialError> {
        if buffer.is_empty() {
            return Ok(0);
        }
        if let Some(error) = self.due() {
            self.faults.told();
            self.faults.owes_data.store(true, Ordering::Relaxed);
            return Err(error);
        }
        match self.rx.pop(buffer) {
            0 => Err(SerialError::WouldBlock),
            len => {
                self.faults.owes_data.store(false, Ordering::Relaxed);
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
    /// Queues what there is room for. See [`has_to_send`](LoopEnd::has_to_send).
    ///
    /// # Errors
    ///
    /// [`SerialError::WouldBlock`] when there is no room.
    fn write(&mut self, bytes: &[u8]) -> Result<usize, SerialError> {
        match self.tx.push(bytes) {
            0 if !bytes.is_empty() => Err(SerialError::WouldBlock),
            len => Ok(len),
        }
    }

    /// # Errors
    ///
    /// [`SerialError::WouldBlock`] while bytes wait to be sent.
    fn flush(&mut self) -> Result<(), SerialError> {
        if self.has_to_send() { Err(SerialError::WouldBlock) } else { Ok(()) }
    }
}
