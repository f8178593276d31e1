//! Interrupt-driven UARTs. The queues of [`mavstack::io`] connect the interrupt and the task.

use mavstack::io::InterruptEnd;

use crate::board::Uart;

/// The state of the interrupt handler.
pub struct SerialInterrupt {
    uart: Uart,
    queues: InterruptEnd<'static>,
}

impl SerialInterrupt {
    /// Connects a UART with its queues and enables its interrupt. Give the interrupt the highest priority, because the UART
    /// buffers a single byte.
    pub fn new(mut uart: Uart, queues: InterruptEnd<'static>) -> Self {
        uart.listen(true);
        Self { uart, queues }
    }

    /// Handles the interrupt: a byte was received or sent, or the task has pended the interrupt after a read or write.
    pub fn on_interrupt(&mut self) {
        let Self { uart, queues } = self;
        uart.acknowledge();
        if uart.take_overrun() {
            queues.line_error();
        }
        // When the queue is full, the byte stays in the UART. The emulator then stops sending. A real line would overrun the
        // UART, which is counted.
        while !queues.is_full()
            && let Some(byte) = uart.take()
        {
            queues.received(byte);
        }
        while uart.has_room()
            && let Some(byte) = queues.next_to_send()
        {
            uart.send(byte);
        }
    }
}
