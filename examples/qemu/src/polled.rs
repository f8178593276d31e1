//! UARTs without interrupts: the loop looks at them, and is woken when there is something to see.

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};

use crate::board::{CLOCK_HZ, Uart};

/// Bytes arrived faster than they were read: at least one is lost.
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
    /// A UART whose interrupt ends [`Bed::sleep`].
    pub fn new(mut uart: Uart) -> Self {
        uart.listen(false);
        Self { uart, has_received: false }
    }

    /// Whether bytes were read since this was asked last: then more may be on their way.
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
            // The first byte is waited for, as the trait asks; nobody calls without `read_ready`.
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

/// Where the loop sleeps. Interrupts stay masked; a pending one only ends the sleep, which is why there are no handlers and
/// nothing is shared.
pub struct Bed(());

impl Bed {
    /// Masks interrupts, for good, and has SysTick raise one every millisecond.
    pub fn make(mut syst: SYST) -> Self {
        cortex_m::interrupt::disable();
        syst.set_clock_source(SystClkSource::Core);
        syst.set_reload(CLOCK_HZ / 1_000 - 1);
        syst.clear_current();
        syst.enable_interrupt();
        syst.enable_counter();
        Self(())
    }

    /// Sleeps until a byte comes or the millisecond is over.
    pub fn sleep(&mut self, uarts: &mut [Polled]) {
        cortex_m::asm::wfi();
        SCB::clear_pendst();
        for polled in uarts {
            polled.uart.acknowledge();
        }
    }
}
