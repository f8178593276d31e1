//! The ends of a link in async tasks: a receiver and a transmitter for the halves of a UART with the traits of
//! `embedded-io-async`.
//!
//! The stack stays sans-IO. The futures of the ends do not know it, so they hold no lock and no borrow of the stack
//! across an `await`. [`Stack::receive_from`] and [`Stack::transmit_to`] exchange bytes with the ends and never wait.
//! The library needs no timer and no executor: the firmware awaits its own.

use core::future::poll_fn;
use core::task::Poll;

use embedded_io_async::{ErrorType, Read, Write};

use crate::network::LinkError;
use crate::stack::{Declares, Stack};
use crate::time::Instant;
use crate::types::LinkId;

/// An error in a future, until the stack counts and reports it.
enum Fault<E> {
    Closed,
    Failed(E),
}

/// The receiving end of a link in an async task: the receiving half of a UART, and the received bytes that the stack has
/// not taken yet. Needs the feature `embedded-io-async`.
///
/// [`wait`](Self::wait) waits for bytes. [`Stack::receive_from`] hands them to the stack; lock a shared stack only for
/// that call:
///
/// ```
/// # use core::cell::RefCell;
/// # use embedded_io_async::Read;
/// # use mavstack::prelude::*;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
/// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
/// #     }
/// # }
/// # #[derive(Stack)]
/// # #[stack(vehicle: Rover, links: 1)]
/// # struct Mavlink;
/// # fn now() -> Instant { Instant::ZERO }
/// # fn wake_transmitters() {}
/// use mavstack::io::AsyncReceiver;
/// use mavstack::network::LinkError;
///
/// async fn receive(shared: &RefCell<(StackOf<Mavlink>, Rover)>, link: LinkId, uart: impl Read) {
///     let mut buffer = [0; 64];
///     let mut receiver = AsyncReceiver::new(uart, &mut buffer);
///     loop {
///         receiver.wait().await;
///         let result = {
///             let (stack, rover) = &mut *shared.borrow_mut();
///             stack.receive_from(now(), link, &mut receiver, rover)
///         };
///         if matches!(result, Err(LinkError::Closed)) {
///             return; // open the transport again, then call `stack.restart_link`
///         }
///         wake_transmitters(); // answers are pending
///     }
/// }
/// # let _ = |shared| receive(shared, LinkId(0), &[0u8][..]);
/// ```
///
/// A call of `receive_from` handles several frames, up to the budget of a poll. [`with_piece`](Self::with_piece)
/// shortens the call, so that other tasks wait less for the lock.
///
/// # Cancellation
///
/// The future of [`wait`](Self::wait) may be dropped at any time, in a `select` for example. No byte is lost, provided
/// that the UART's `read` has no effect when it is dropped. Buffered UARTs and DMA ring buffers satisfy this. With
/// other UARTs, do not drop the future. Bytes that the stack has not taken stay in the receiver, so keep it for as long
/// as the transport is open.
pub struct AsyncReceiver<'a, R: ErrorType> {
    uart: R,
    buffer: &'a mut [u8],
    /// The most bytes for one call of the stack.
    piece: usize,
    /// The bytes that the stack has not taken are `buffer[begin..end]`.
    begin: usize,
    end: usize,
    fault: Option<Fault<R::Error>>,
    /// Whether frames are pending in the stack that exceeded the budget of a call.
    has_backlog: bool,
    /// Whether the next [`wait`](Self::wait) lets other tasks run first.
    must_yield: bool,
}

impl<'a, R: ErrorType> AsyncReceiver<'a, R> {
    /// Returns a receiver that reads from `uart` into `buffer`. The buffer holds the bytes of one read. Where a DMA
    /// restricts the memory, use a `static`.
    pub const fn new<const N: usize>(uart: R, buffer: &'a mut [u8; N]) -> Self {
        const { assert!(N > 0, "the buffer of a receiver must hold bytes: `[0; 64]`") };
        Self { uart, buffer, piece: usize::MAX, begin: 0, end: 0, fault: None, has_backlog: false, must_yield: false }
    }

    /// Limits the bytes that one call of [`Stack::receive_from`] takes from this receiver to `len`, at least 1. Without a
    /// limit it takes all. With 16, a call rarely handles more than one frame.
    #[must_use]
    pub const fn with_piece(mut self, len: usize) -> Self {
        self.piece = if len > 0 { len } else { 1 };
        self
    }

    fn pending(&self) -> &[u8] {
        self.buffer.get(self.begin..self.end).unwrap_or_default()
    }
}

impl<R: Read> AsyncReceiver<'_, R> {
    /// Waits until bytes or an error were received: then call [`Stack::receive_from`].
    ///
    /// After an error, and while bytes are pending that exceeded the budget of a call, it only yields to other tasks
    /// once. A transport that fails repeatedly would starve tasks of lower priority: pause after its errors.
    pub async fn wait(&mut self) {
        if self.must_yield {
            yield_now().await;
            self.must_yield = false;
        }
        if self.has_backlog || self.begin < self.end || self.fault.is_some() {
            return;
        }
        // No `await` between the read and the fields: a future that is dropped has read nothing.
        let fault = match self.uart.read(self.buffer).await {
            Ok(len) if len > 0 => {
                (self.begin, self.end) = (0, len.min(self.buffer.len()));
                return;
            }
            Ok(_) => Fault::Closed,
            Err(error) => Fault::Failed(error),
        };
        self.fault = Some(fault);
        self.must_yield = true;
    }
}

/// Is pending once.
async fn yield_now() {
    let mut has_yielded = false;
    poll_fn(|context| {
        if has_yielded {
            return Poll::Ready(());
        }
        has_yielded = true;
        context.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

/// Omits the received bytes: a key may be among them (SEC-15).
impl<R: ErrorType> core::fmt::Debug for AsyncReceiver<'_, R> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("AsyncReceiver").field("pending", &self.pending().len()).finish_non_exhaustive()
    }
}

/// The transmitting end of a link in an async task: the transmitting half of a UART, and a copy of the bytes that it sends.
/// Needs the feature `embedded-io-async`.
///
/// [`Stack::transmit_to`] takes the next bytes from the stack, and [`send`](Self::send) sends them. When there is nothing to
/// send, the task awaits a wake-up or the link's deadline, whichever comes first:
///
/// ```
/// # use core::cell::RefCell;
/// # use embedded_io_async::Write;
/// # use mavstack::prelude::*;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
/// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
/// #     }
/// # }
/// # #[derive(Stack)]
/// # #[stack(vehicle: Rover, links: 1)]
/// # struct Mavlink;
/// # fn now() -> Instant { Instant::ZERO }
/// # async fn wake_up_or(_: Instant) {}
/// use mavstack::io::AsyncTransmitter;
///
/// async fn transmit(shared: &RefCell<(StackOf<Mavlink>, Rover)>, link: LinkId, uart: impl Write) {
///     let mut buffer = [0; 64];
///     let mut transmitter = AsyncTransmitter::new(uart, &mut buffer);
///     loop {
///         let (has_bytes, deadline) = {
///             let (stack, rover) = &mut *shared.borrow_mut();
///             let now = now();
///             stack.poll(now, rover);
///             let has_bytes = stack.transmit_to(now, link, &mut transmitter, rover);
///             (has_bytes, stack.link_deadline(now, link))
///         };
///         match has_bytes {
///             Ok(true) => transmitter.send().await,
///             // With Embassy: `select(WAKE.wait(), Timer::at(deadline))`. An error is counted, and the link continues.
///             _ => wake_up_or(deadline).await,
///         }
///     }
/// }
/// # let _ = |shared, uart: &'static mut [u8]| transmit(shared, LinkId(0), uart);
/// ```
///
/// A buffer of [`MAX_FRAME_LEN`](crate::frame::MAX_FRAME_LEN) bytes sends each frame at once. A shorter one leaves a
/// gap on the link after each piece, until the task runs again. Some UARTs refuse a write that exceeds their own
/// buffer, such as `BufferedUart` of embassy-stm32 0.6: then `buffer` must be no longer than that.
///
/// # Cancellation
///
/// The future of [`send`](Self::send) may be dropped at any time. The stack counts bytes as sent only when all bytes of
/// the buffer are sent. Unsent bytes stay in the transmitter: the next `send` continues there. The UART's `write`
/// determines whether bytes are sent twice:
///
/// | a `write` that is dropped | for example | then |
/// |---|---|---|
/// | has no effect | buffered UARTs | no byte is lost or sent twice |
/// | has sent an unknown part of its bytes | DMA without a ring buffer | these may be sent twice: the peer drops one frame, by its checksum |
///
/// The example drops no `send`: only the sleep is in a `select`. It therefore suits both kinds.
///
/// Keep the transmitter for as long as the transport is open. For a transport that was opened again, create a new
/// transmitter and call [`restart_link`](Stack::restart_link): the first frame is then a HEARTBEAT (H-17).
pub struct AsyncTransmitter<'a, W: ErrorType> {
    uart: W,
    buffer: &'a mut [u8],
    /// The bytes to send are `buffer[written..end]`.
    written: usize,
    end: usize,
    /// Whether some bytes, written or not, have not left the UART yet.
    must_flush: bool,
    fault: Option<Fault<W::Error>>,
}

impl<'a, W: ErrorType> AsyncTransmitter<'a, W> {
    /// Returns a transmitter that sends the bytes in `buffer` through `uart`. Where a DMA restricts the memory, use a
    /// `static`.
    pub const fn new<const N: usize>(uart: W, buffer: &'a mut [u8; N]) -> Self {
        const { assert!(N > 0, "the buffer of a transmitter must hold bytes: `[0; 64]`") };
        Self { uart, buffer, written: 0, end: 0, must_flush: false, fault: None }
    }

    /// Copies the front of `bytes`.
    fn put(&mut self, bytes: &[u8]) {
        let len = bytes.len().min(self.buffer.len());
        for (cell, byte) in self.buffer.iter_mut().zip(bytes) {
            *cell = *byte;
        }
        (self.written, self.end, self.must_flush) = (0, len, len > 0);
    }
}

impl<W: Write> AsyncTransmitter<'_, W> {
    /// Sends the bytes that [`Stack::transmit_to`] took from the stack, and waits until they have left the UART. Returns at
    /// once if there are none.
    ///
    /// Flushes the UART, so that no frame waits in its buffer behind others: a heartbeat must not be sent after flight
    /// has stopped (H-5). If the UART fails, the next `transmit_to` returns the error.
    pub async fn send(&mut self) {
        if self.fault.is_none()
            && let Err(fault) = self.try_send().await
        {
            self.fault = Some(fault);
        }
    }

    /// Sends the pending bytes, and flushes the UART. Returns the UART's error, or [`Fault::Closed`] if it takes no
    /// more.
    async fn try_send(&mut self) -> Result<(), Fault<W::Error>> {
        while self.written < self.end {
            let rest = self.buffer.get(self.written..self.end).unwrap_or_default();
            // No `await` between the write and the field: a future that is dropped has written nothing.
            match self.uart.write(rest).await.map_err(Fault::Failed)? {
                0 => return Err(Fault::Closed),
                len => self.written = self.written.saturating_add(len),
            }
        }
        if self.must_flush {
            self.uart.flush().await.map_err(Fault::Failed)?;
            self.must_flush = false;
        }
        Ok(())
    }
}

impl<W: ErrorType> core::fmt::Debug for AsyncTransmitter<'_, W> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let pending = self.end.saturating_sub(self.written);
        f.debug_struct("AsyncTransmitter").field("pending", &pending).finish_non_exhaustive()
    }
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Takes bytes from an [`AsyncReceiver`], and handles the frames in them up to the budget of one poll. Returns whether
    /// some stay pending, because they exceed the budget or the [piece](AsyncReceiver::with_piece): then call it again. The
    /// receiver's [`wait`](AsyncReceiver::wait) does not wait for more bytes meanwhile. Needs the feature `embedded-io-async`.
    ///
    /// # Errors
    ///
    /// Returns [`LinkError::Read`] if reading failed, which is also counted (S-20), and [`LinkError::Closed`] at the end of the
    /// stream: each once. The link stays usable.
    pub fn receive_from<R: ErrorType>(
        &mut self,
        now: Instant,
        link: LinkId,
        receiver: &mut AsyncReceiver<'_, R>,
        vehicle: &mut D::Vehicle,
    ) -> Result<bool, LinkError<R::Error>> {
        let pending = receiver.pending();
        let taken = self.receive(now, link, pending.get(..receiver.piece).unwrap_or(pending), vehicle);
        receiver.begin = receiver.begin.saturating_add(taken);
        receiver.has_backlog = self.has_backlog(link);
        let is_pending = receiver.has_backlog || receiver.begin < receiver.end;
        receiver.must_yield |= is_pending;
        let no_link = self.no_link();
        let counters = self.counters_mut(link).ok_or(no_link)?;
        match receiver.fault.take() {
            None => Ok(is_pending),
            Some(Fault::Closed) => Err(LinkError::Closed),
            Some(Fault::Failed(error)) => {
                counters.read_errors = counters.read_errors.wrapping_add(1);
                Err(LinkError::Read(error))
            }
        }
    }

    /// Hands the next bytes to an [`AsyncTransmitter`], at most the rest of one frame, and returns whether it has bytes to
    /// [`send`](AsyncTransmitter::send). If it has not sent all of the last ones, it keeps them. Needs the feature
    /// `embedded-io-async`.
    ///
    /// If `false`, there is nothing to send before [`link_deadline`](Self::link_deadline), unless something happens: bytes
    /// are received on any link, or the vehicle's state changes.
    ///
    /// Received bytes that wait for silence, or for more budget, are handled first, up to the budget of one poll.
    ///
    /// # Errors
    ///
    /// Returns [`LinkError::Write`] or [`LinkError::Closed`] if sending failed, once, and counts it. The rest of the frame
    /// is dropped: otherwise a task that sends it again could fail forever. The link stays usable, and sends nothing for
    /// 100 ms: until then this returns `false`, and [`link_deadline`](Self::link_deadline) is no earlier (X-7).
    pub fn transmit_to<W: ErrorType>(
        &mut self,
        now: Instant,
        link: LinkId,
        transmitter: &mut AsyncTransmitter<'_, W>,
        vehicle: &mut D::Vehicle,
    ) -> Result<bool, LinkError<W::Error>> {
        self.receive(now, link, &[], vehicle);
        let (is_new, retry_at) = self.transmit_state(link)?;
        if is_new {
            // The rest of a frame from before the link was opened again must not precede the HEARTBEAT (H-17).
            transmitter.put(&[]);
        }
        let fault = transmitter.fault.take();
        if fault.is_some() {
            self.note_failure(link);
        } else if self.enter(now) < retry_at {
            return Ok(false);
        } else if transmitter.must_flush {
            return Ok(true);
        }
        self.transmitted(link, if fault.is_some() { usize::MAX } else { transmitter.end });
        transmitter.put(if fault.is_some() { &[] } else { self.transmit(now, link, vehicle) });
        match fault {
            None => Ok(transmitter.must_flush),
            Some(Fault::Closed) => Err(LinkError::Closed),
            Some(Fault::Failed(error)) => Err(LinkError::Write(error)),
        }
    }
}
