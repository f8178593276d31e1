//! The parts of the board mps2-an386 that the firmware uses: three UARTs, a clock, an alarm. The flash is in
//! [`flash`](crate::flash), the Ethernet controller in `lan9118`.
#![allow(unsafe_code, reason = "registers of the board, and its interrupts")]

use core::cell::Cell;

use cortex_m::interrupt::{Mutex, free};
use cortex_m::peripheral::{NVIC, SCB};
use mavstack::Instant;

use crate::device::Interrupt;
use crate::flash::PsramFlash;
#[cfg(feature = "network")]
use crate::lan9118::Lan9118;

/// Clock of the processor and the peripherals (Hz).
pub const CLOCK_HZ: u32 = 25_000_000;
/// Baud rate of UART0 (bit/s).
pub const TELEMETRY_BAUD: u32 = 115_200;
/// Baud rate of UART1 (bit/s).
pub const COMPANION_BAUD: u32 = 921_600;
/// Baud rate of UART2 (bit/s).
pub const SATELLITE_BAUD: u32 = 2_400;

/// Registers of timer 0.
const CLOCK_BASE: usize = 0x4000_0000;
const TICKS_PER_US: u32 = CLOCK_HZ / 1_000_000;

/// The registers of a peripheral.
struct Registers(usize);

impl Registers {
    /// Returns the registers at `base`.
    ///
    /// # Safety
    ///
    /// `base` must be the address of a peripheral with at least 5 word registers, and nothing else may use it.
    const unsafe fn at(base: usize) -> Self {
        Self(base)
    }

    fn word(&self, index: usize) -> *mut u32 {
        core::ptr::with_exposed_provenance_mut::<u32>(self.0).wrapping_add(index)
    }

    fn read(&self, index: usize) -> u32 {
        // SAFETY: `at` guarantees a register there; all uses in this file have `index` < 5.
        unsafe { self.word(index).read_volatile() }
    }

    fn write(&mut self, index: usize, value: u32) {
        // SAFETY: as in `read`; `&mut self` is the only user.
        unsafe { self.word(index).write_volatile(value) }
    }
}

/// A CMSDK APB UART, with a buffer of one byte in each direction.
pub struct Uart {
    registers: Registers,
    /// Byte received, byte sent.
    interrupts: [Interrupt; 2],
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
    const SENT_INTERRUPT: u32 = 1 << 2;
    const INTERRUPTS: u32 = 0b11;

    /// # Safety
    ///
    /// As for [`Registers::at`]; the peripheral must be a UART with these interrupts.
    unsafe fn at(base: usize, baud: u32, interrupts: [Interrupt; 2]) -> Self {
        // SAFETY: guaranteed by the caller.
        let mut registers = unsafe { Registers::at(base) };
        registers.write(Self::BAUDDIV, CLOCK_HZ / baud);
        registers.write(Self::CTRL, Self::ENABLE);
        Self { registers, interrupts }
    }

    /// Enables the interrupts: for each byte received and, if `sent`, for each byte sent.
    pub fn listen(&mut self, sent: bool) {
        self.registers.write(Self::CTRL, Self::ENABLE | if sent { Self::SENT_INTERRUPT } else { 0 });
        for interrupt in self.interrupts {
            // SAFETY: no critical section here relies on masking a single interrupt.
            unsafe { NVIC::unmask(interrupt) };
        }
    }

    /// Returns the interrupt of the UART's handler.
    pub fn interrupt(&self) -> Interrupt {
        self.interrupts[0]
    }

    /// Clears the pending interrupts. Later events raise them again, so check the UART after this call.
    pub fn acknowledge(&mut self) {
        self.registers.write(Self::INTCLEAR, Self::INTERRUPTS);
        for interrupt in self.interrupts {
            NVIC::unpend(interrupt);
        }
    }

    /// Whether a byte was received.
    pub fn has_byte(&self) -> bool {
        self.is(Self::RX_FULL)
    }

    /// Takes the received byte, if any.
    pub fn take(&mut self) -> Option<u8> {
        self.has_byte().then(|| self.registers.read(Self::DATA).to_le_bytes()[0])
    }

    /// Whether a byte was lost since the last call.
    pub fn take_overrun(&mut self) -> bool {
        let is_overrun = self.is(Self::RX_OVERRUN);
        if is_overrun {
            self.registers.write(Self::STATE, Self::RX_OVERRUN);
        }
        is_overrun
    }

    /// Whether the UART accepts a byte to send.
    pub fn has_room(&self) -> bool {
        !self.is(Self::TX_FULL)
    }

    /// Sends a byte. Call it only if [`has_room`](Self::has_room).
    pub fn send(&mut self, byte: u8) {
        self.registers.write(Self::DATA, byte.into());
    }

    fn is(&self, flag: u32) -> bool {
        self.registers.read(Self::STATE) & flag != 0
    }
}

/// A CMSDK APB timer.
struct Timer(Registers);

impl Timer {
    const CTRL: usize = 0;
    const VALUE: usize = 1;
    const RELOAD: usize = 2;
    const INTCLEAR: usize = 3;

    const ENABLE: u32 = 1 << 0;
    const INTERRUPT: u32 = 1 << 3;
}

/// A clock on timer 0, which counts down and wraps every 171 s.
struct Clock {
    timer: Timer,
    last: u32,
    /// Remainder of ticks that do not make a whole microsecond.
    rest: u32,
    micros: u64,
}

impl Clock {
    fn start(mut timer: Timer) -> Self {
        timer.0.write(Timer::RELOAD, u32::MAX);
        timer.0.write(Timer::VALUE, u32::MAX);
        timer.0.write(Timer::CTRL, Timer::ENABLE);
        Self { timer, last: u32::MAX, rest: 0, micros: 0 }
    }

    fn now(&mut self) -> Instant {
        let value = self.timer.0.read(Timer::VALUE);
        let elapsed = u64::from(self.last.wrapping_sub(value)) + u64::from(self.rest);
        self.last = value;
        self.micros += elapsed / u64::from(TICKS_PER_US);
        self.rest = (elapsed % u64::from(TICKS_PER_US)) as u32;
        Instant::from_micros(self.micros)
    }
}

static CLOCK: Mutex<Cell<Option<Clock>>> = Mutex::new(Cell::new(None));

/// Returns the time since boot. Tasks and interrupts may call it. Call it at least every 171 s.
pub fn now() -> Instant {
    free(|cs| {
        let clock = CLOCK.borrow(cs);
        let mut running = clock.take();
        let now = running.as_mut().map_or(Instant::ZERO, Clock::now);
        clock.set(running);
        now
    })
}

/// Returns the ticks of the clock since boot ([`CLOCK_HZ`]), which wrap after 171 s. Unlike [`now`], it needs no critical section, which
/// would delay interrupts.
pub fn ticks() -> u32 {
    // SAFETY: the address of timer 0. Nothing is written, and reading the counter has no effect.
    let clock = unsafe { Registers::at(CLOCK_BASE) };
    !clock.read(Timer::VALUE)
}

/// The UDP port of ground stations: a word of the PSRAM, in which the emulator may put another one; by default 14550.
#[cfg(feature = "network")]
pub fn station_port() -> u16 {
    // SAFETY: PSRAM that nothing else uses. It is zero unless the emulator wrote it before the start.
    let port = unsafe { Registers::at(crate::flash::OPTIONS) }.read(0);
    u16::try_from(port).ok().filter(|&port| port > 0).unwrap_or(14_550)
}

/// Whether the vehicle runs without its camera and its gimbal: a word of the PSRAM, in which the emulator may put 1.
pub fn is_without_components() -> bool {
    // SAFETY: as in `station_port`.
    unsafe { Registers::at(crate::flash::OPTIONS) }.read(1) != 0
}

/// An alarm, which raises [`Interrupt::TIMER1`].
pub struct Alarm(Timer);

impl Alarm {
    /// The longest delay (µs).
    const LONGEST: u64 = 60_000_000;

    /// Enables the interrupt.
    pub fn listen(&mut self) {
        // SAFETY: as for the UARTs.
        unsafe { NVIC::unmask(Interrupt::TIMER1) };
    }

    /// Sets the alarm to `micros` from now, at most one minute. Replaces an earlier alarm and clears its interrupt.
    pub fn set(&mut self, micros: u64) {
        let ticks = micros.clamp(1, Self::LONGEST) as u32 * TICKS_PER_US;
        let timer = &mut self.0.0;
        timer.write(Timer::CTRL, 0);
        timer.write(Timer::INTCLEAR, 1);
        timer.write(Timer::RELOAD, ticks);
        timer.write(Timer::VALUE, ticks);
        timer.write(Timer::CTRL, Timer::ENABLE | Timer::INTERRUPT);
    }
}

/// The peripherals of the board.
pub struct Board {
    /// UART0 to UART2: telemetry, companion, satellite modem.
    pub uarts: [Uart; 3],
    /// Timer 1.
    pub alarm: Alarm,
    /// The three partitions of the flash.
    pub flash: PsramFlash,
    /// The Ethernet controller.
    #[cfg(feature = "network")]
    pub ethernet: Lan9118,
}

impl Board {
    /// Initialises the board. Returns `None` on every call but the first.
    pub fn take() -> Option<Self> {
        cortex_m::singleton!(: () = ())?;
        // SAFETY: the addresses and interrupts of this board. The singleton above guarantees that each is created once.
        let (uarts, clock, alarm) = unsafe {
            let uarts = [
                Uart::at(0x4000_4000, TELEMETRY_BAUD, [Interrupt::UART0, Interrupt::UART0_TX]),
                Uart::at(0x4000_5000, COMPANION_BAUD, [Interrupt::UART1, Interrupt::UART1_TX]),
                Uart::at(0x4000_6000, SATELLITE_BAUD, [Interrupt::UART2, Interrupt::UART2_TX]),
            ];
            (uarts, Timer(Registers::at(CLOCK_BASE)), Timer(Registers::at(0x4000_1000)))
        };
        free(|cs| CLOCK.borrow(cs).set(Some(Clock::start(clock))));
        #[cfg(feature = "defmt")]
        defmt::info!("the vehicle boots");
        Some(Self {
            uarts,
            alarm: Alarm(alarm),
            flash: PsramFlash::new(),
            // SAFETY: as above.
            #[cfg(feature = "network")]
            ethernet: unsafe { Lan9118::at(0x4020_0000) },
        })
    }

    /// Resets the processor and the board. The flash keeps its contents.
    pub fn reset() -> ! {
        SCB::sys_reset()
    }
}
