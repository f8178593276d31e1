//! Polled UARTs, for a main loop that sleeps until a byte arrives.

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};

use crate::board::{CLOCK_HZ, Uart};

/// A receiver overrun: bytes arrived faster than they were read, and at least one was lost.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Overrun;

impl core::fmt::Display for Overrun {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("receiver overrun")
    }
}

impl core::error::Error for Overrun {}

impl embedded_io::Error for Overrun {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// A UART that is polled.
pub struct Polled {
    uart: Uart,
    has_received: bool,
}

impl Polled {
    /// Wraps a UART whose interrupt ends [`Sleep::until_event`].
    pub fn new(mut uart: Uart) -> Self {
        uart.listen(false);
        Self { uart, has_received: false }
    }

    /// Whether bytes were read since the last call. More bytes may then follow soon.
    pub fn has_received(&mut self) -> bool {
        core::mem::take(&mut self.has_received)
    }
}

impl ErrorType for Polled {
    type Error = Overrun;
}

impl ReadReady for Polled {
    fn read_ready(&mut self) -> Result<bool, Overrun> {
        Ok(self.uart.has_byte())
    }
}

impl Read for Polled {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, Overrun> {
        if self.uart.take_overrun() {
            return Err(Overrun);
        }
        let mut read = 0;
        for byte in buf {
            // The trait requires waiting for the first byte. The stack calls `read` only after `read_ready`.
            while read == 0 && !self.uart.has_byte() {}
            let Some(received) = self.uart.take() else { break };
            self.has_received = true;
            *byte = received;
            read += 1;
        }
        Ok(read)
    }
}

impl WriteReady for Polled {
    fn write_ready(&mut self) -> Result<bool, Overrun> {
        Ok(self.uart.has_room())
    }
}

impl Write for Polled {
    fn write(&mut self, buf: &[u8]) -> Result<usize, Overrun> {
        let mut written = 0;
        for &byte in buf {
            while written == 0 && !self.uart.has_room() {}
            if !self.uart.has_room() {
                break;
            }
            self.uart.send(byte);
            written += 1;
        }
        Ok(written)
    }

    fn flush(&mut self) -> Result<(), Overrun> {
        while !self.uart.has_room() {}
        Ok(())
    }
}

/// Lets the main loop sleep. Interrupts stay masked: a pending one wakes the processor but runs no handler. So the loop shares
/// no data with interrupts.
pub struct Sleep(());

impl Sleep {
    /// Masks interrupts permanently, and starts SysTick with a period of one millisecond.
    pub fn new(mut syst: SYST) -> Self {
        cortex_m::interrupt::disable();
        syst.set_clock_source(SystClkSource::Core);
        syst.set_reload(CLOCK_HZ / 1_000 - 1);
        syst.clear_current();
        syst.enable_interrupt();
        syst.enable_counter();
        Self(())
    }

    /// Sleeps until a byte arrives or the next millisecond begins.
    pub fn until_event(&mut self, uarts: &mut [Polled]) {
        cortex_m::asm::wfi();
        SCB::clear_pendst();
        for polled in uarts {
            polled.uart.acknowledge();
        }
    }
}
