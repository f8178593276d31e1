//! An asynchronous UART: the queues of [`mavstack::io`] with wakers.

use core::cell::RefCell;
use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;

use cortex_m::peripheral::NVIC;
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_sync::waitqueue::AtomicWaker;
use embedded_io::{Read as _, ReadReady, Write as _};
use embedded_io_async::{ErrorType, Read, Write};
use mavstack::io::{LoopEnd, SerialError, SerialQueues};
use mavstack_qemu::board;
use mavstack_qemu::device::Interrupt;
use mavstack_qemu::serial::SerialInterrupt;

/// A UART with queues of `N` bytes, for a `static`.
pub struct Uart<const N: usize> {
    queues: SerialQueues<N, N>,
    interrupt: CriticalSectionMutex<RefCell<Option<SerialInterrupt>>>,
    received: AtomicWaker,
    sent: AtomicWaker,
}

impl<const N: usize> Uart<N> {
    /// Creates a UART that has not been started.
    pub const fn new() -> Self {
        Self {
            queues: SerialQueues::new(),
            interrupt: CriticalSectionMutex::new(RefCell::new(None)),
            received: AtomicWaker::new(),
            sent: AtomicWaker::new(),
        }
    }

    /// Starts the UART and splits it into halves for two tasks. Call it once.
    pub fn start(&'static self, uart: board::Uart) -> (Receiver, Sender) {
        let number = uart.interrupt();
        // Within the lock, because the interrupt may be raised at once and needs the state.
        self.interrupt.lock(|cell| cell.replace(Some(SerialInterrupt::new(uart, self.queues.interrupt_end()))));
        let receiver = Receiver { end: self.queues.loop_end(), interrupt: number, waker: &self.received };
        (receiver, Sender { end: self.queues.loop_end(), interrupt: number, waker: &self.sent })
    }

    /// Handles the UART's interrupt.
    pub fn on_interrupt(&self) {
        self.interrupt.lock(|cell| {
            if let Some(interrupt) = cell.borrow_mut().as_mut() {
                interrupt.on_interrupt();
            }
        });
        self.received.wake();
        self.sent.wake();
    }
}

/// The receiving half.
pub struct Receiver {
    end: LoopEnd<'static>,
    interrupt: Interrupt,
    waker: &'static AtomicWaker,
}

impl ErrorType for Receiver {
    type Error = SerialError;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, SerialError> {
        poll_fn(|context| {
            // Register first, so that a byte that arrives in between wakes the task.
            self.waker.register(context.waker());
            if !self.end.read_ready()? {
                return Poll::Pending;
            }
            let result = self.end.read(buffer);
            // If the queue was full, a byte may be left in the UART.
            NVIC::pend(self.interrupt);
            Poll::Ready(result)
        })
        .await
    }
}

/// The sending half.
pub struct Sender {
    end: LoopEnd<'static>,
    interrupt: Interrupt,
    waker: &'static AtomicWaker,
}

impl ErrorType for Sender {
    type Error = Infallible;
}

impl Write for Sender {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            self.waker.register(context.waker());
            let Ok(len) = self.end.write(bytes) else { return Poll::Pending };
            // The interrupt sends the bytes, so it must be raised for the first one.
            NVIC::pend(self.interrupt);
            Poll::Ready(Ok(len))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        poll_fn(|context| {
            self.waker.register(context.waker());
            if self.end.has_to_send() { Poll::Pending } else { Poll::Ready(Ok(())) }
        })
        .await
    }
}
