//! UARTs with interrupts: between the interrupt and the task stand the queues of [`mavstack::io`].

use mavstack::io::InterruptEnd;

use crate::board::Uart;

/// What the interrupt's handler works with.
pub struct SerialInterrupt {
    uart: Uart,
    queues: InterruptEnd<'static>,
}

impl SerialInterrupt {
    /// A UART and its queues. The interrupt comes from now on; it has the highest priority, for the UART holds a single byte.
    pub fn new(mut uart: Uart, queues: InterruptEnd<'static>) -> Self {
        uart.listen(true);
        Self { uart, queues }
    }

    /// The handler: a byte came, or one has left, or the task has written something, or made room, and pended the interrupt.
    pub fn on_interrupt(&mut self) {
        let Self { uart, queues } = self;
        uart.acknowledge();
        if uart.take_overrun() {
            queues.line_error();
        }
        // Without room it waits in the UART: the emulator then sends no other. A real line would, and overrun the UART, which
        // is counted.
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
