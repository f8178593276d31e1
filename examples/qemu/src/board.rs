//! The board mps2-an386 as far as the firmware needs it: three UARTs, a clock, a tick to sleep until.
//!
//! Everything is polled. Interrupts stay masked; a pending one only ends [`Board::sleep`], which is why there are no
//! handlers and nothing is shared. Registers are memory: `unsafe`, here and in the flash beside.
#![allow(unsafe_code)]

use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SCB};
use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::Instant;

use crate::flash::PsramFlash;

/// Ticks of the system clock in a microsecond: 25 MHz.
const TICKS_PER_US: u32 = 25;

/// A peripheral's registers.
struct Registers(*mut u32);

impl Registers {
    /// The registers at `base`.
    ///
    /// # Safety
    ///
    /// `base` is the address of a peripheral with at least 5 word registers, and nobody else uses it.
    unsafe fn at(base: usize) -> Self {
        Self(core::ptr::with_exposed_provenance_mut(base))
    }

    fn read(&self, index: usize) -> u32 {
        // SAFETY: `at` promises a register there; all uses in this file have `index` < 5.
        unsafe { self.0.add(index).read_volatile() }
    }

    fn write(&mut self, index: usize, value: u32) {
        // SAFETY: as in `read`; `&mut self` is the only user.
        unsafe { self.0.add(index).write_volatile(value) }
    }
}

#[derive(Clone, Copy)]
struct Irq(u16);

// SAFETY: the numbers are those of the board's UART receivers: 0, 2, 4.
unsafe impl InterruptNumber for Irq {
    fn number(self) -> u16 {
        self.0
    }
}

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

/// A CMSDK APB UART: one byte of buffer each way.
pub struct Uart {
    registers: Registers,
    irq: Irq,
    has_received: bool,
}

impl Uart {
    const DATA: usize = 0;
    const STATE: usize = 1;
    const CTRL: usize = 2;
    const INTCLEAR: usize = 3;
    const BAUDDIV: usize = 4;

    const TX_FULL: u32 = 1 << 0;
    const RX_FULL: u32 = 1 << 1;
    const RX_OVERRUN: u32 = 1 << 3;
    const ENABLE: u32 = 0b1011; // transmitter, receiver, receive interrupt
    const RX_INTERRUPT: u32 = 1 << 1;

    /// # Safety
    ///
    /// As [`Registers::at`], for a UART whose receive interrupt is `irq`.
    unsafe fn at(base: usize, irq: Irq) -> Self {
        // SAFETY: passed on.
        let mut registers = unsafe { Registers::at(base) };
        registers.write(Self::BAUDDIV, 25_000_000 / 115_200);
        registers.write(Self::CTRL, Self::ENABLE);
        // SAFETY: interrupts are masked for good, so no critical section can be broken.
        unsafe { NVIC::unmask(irq) };
        Self { registers, irq, has_received: false }
    }

    /// Whether bytes were read since this was asked last: then more may be on their way.
    pub fn has_received(&mut self) -> bool {
        core::mem::take(&mut self.has_received)
    }

    fn is(&self, flag: u32) -> bool {
        self.registers.read(Self::STATE) & flag != 0
    }

    /// Takes back the wake-up call of a received byte.
    fn acknowledge(&mut self) {
        self.registers.write(Self::INTCLEAR, Self::RX_INTERRUPT);
        NVIC::unpend(self.irq);
    }
}

impl ErrorType for Uart {
    type Error = Overrun;
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Overrun> {
        Ok(self.is(Self::RX_FULL))
    }
}

impl Read for Uart {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, Overrun> {
        if self.is(Self::RX_OVERRUN) {
            self.registers.write(Self::STATE, Self::RX_OVERRUN);
            return Err(Overrun);
        }
        let mut read = 0;
        for byte in buf {
            // The first byte is waited for, as the trait asks; nobody calls without `read_ready`.
            while read == 0 && !self.is(Self::RX_FULL) {}
            if !self.is(Self::RX_FULL) {
                break;
            }
            self.has_received = true;
            *byte = self.registers.read(Self::DATA).to_le_bytes()[0];
            read += 1;
        }
        Ok(read)
    }
}

impl WriteReady for Uart {
    fn write_ready(&mut self) -> Result<bool, Overrun> {
        Ok(!self.is(Self::TX_FULL))
    }
}

impl Write for Uart {
    fn write(&mut self, buf: &[u8]) -> Result<usize, Overrun> {
        let mut written = 0;
        for &byte in buf {
            while written == 0 && self.is(Self::TX_FULL) {}
            if self.is(Self::TX_FULL) {
                break;
            }
            self.registers.write(Self::DATA, byte.into());
            written += 1;
        }
        Ok(written)
    }

    fn flush(&mut self) -> Result<(), Overrun> {
        while self.is(Self::TX_FULL) {}
        Ok(())
    }
}

/// Time since boot, from a timer that counts down and wraps every 171 s: read it more often than that.
pub struct Clock {
    registers: Registers,
    last: u32,
    /// Ticks not yet counted as a microsecond.
    rest: u32,
    micros: u64,
}

impl Clock {
    const CTRL: usize = 0;
    const VALUE: usize = 1;
    const RELOAD: usize = 2;

    /// # Safety
    ///
    /// As [`Registers::at`], for a CMSDK APB timer.
    unsafe fn at(base: usize) -> Self {
        // SAFETY: passed on.
        let mut registers = unsafe { Registers::at(base) };
        registers.write(Self::RELOAD, u32::MAX);
        registers.write(Self::VALUE, u32::MAX);
        registers.write(Self::CTRL, 1);
        Self { registers, last: u32::MAX, rest: 0, micros: 0 }
    }

    /// Time since boot.
    pub fn now(&mut self) -> Instant {
        let value = self.registers.read(Self::VALUE);
        let elapsed = u64::from(self.last.wrapping_sub(value)) + u64::from(self.rest);
        self.last = value;
        self.micros += elapsed / u64::from(TICKS_PER_US);
        self.rest = (elapsed % u64::from(TICKS_PER_US)) as u32;
        Instant::from_micros(self.micros)
    }
}

/// What the main loop works with.
pub struct Board {
    /// UART0 to UART2.
    pub uarts: [Uart; 3],
    /// Timer 0.
    pub clock: Clock,
}

impl Board {
    /// Sets the board up, and the three parts of the flash beside it; `None` the second time.
    pub fn take() -> Option<(Self, [PsramFlash; 3])> {
        let mut core = cortex_m::Peripherals::take()?;
        // For good: see the top of the file.
        cortex_m::interrupt::disable();
        core.SYST.set_clock_source(SystClkSource::Core);
        core.SYST.set_reload(TICKS_PER_US * 1_000 - 1);
        core.SYST.clear_current();
        core.SYST.enable_interrupt();
        core.SYST.enable_counter();
        // SAFETY: addresses and interrupts of this board; `Peripherals::take` succeeds once, so each is made once.
        unsafe {
            let board = Self {
                uarts: [Uart::at(0x4000_4000, Irq(0)), Uart::at(0x4000_5000, Irq(2)), Uart::at(0x4000_6000, Irq(4))],
                clock: Clock::at(0x4000_0000),
            };
            Some((board, [PsramFlash::new(0), PsramFlash::new(1), PsramFlash::new(2)]))
        }
    }

    /// Restarts the processor and the board, as after power-on; the flash keeps what is in it.
    pub fn reset() -> ! {
        SCB::sys_reset()
    }

    /// Sleeps until a byte arrives or the millisecond is over.
    pub fn sleep(&mut self) {
        cortex_m::asm::wfi();
        SCB::clear_pendst();
        for uart in &mut self.uarts {
            uart.acknowledge();
        }
    }
}
