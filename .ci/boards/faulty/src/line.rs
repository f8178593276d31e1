//! The UART, as it is.

use mavstack::{Instant, StackOf};
use mavstack_rover::{Mavlink, Rover};
use rp2040_hal::pac::{DMA, RESETS};

use crate::TELEM;
use crate::board::Uart;

/// The link's UART.
pub struct Line(Uart);

impl Line {
    pub fn new(uart: Uart, _: DMA, _: &mut RESETS) -> Self {
        Self(uart)
    }

    pub fn poll(&mut self, now: Instant, stack: &mut StackOf<Mavlink>, rover: &mut Rover) {
        let _ = stack.poll_link(now, TELEM, &mut self.0, rover);
    }
}
