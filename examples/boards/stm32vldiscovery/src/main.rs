//! A rover on an STM32VLDISCOVERY: an STM32F100, a Cortex-M3 at 24 MHz with 8 KiB of RAM. Telemetry is on USART1, PA9 (TX) and PA10
//! (RX), at 57,600 bit/s.
//!
//! This is the smallest board: it has a mission of 32 items, and no storage. Otherwise it is the firmware of `stm32f405`, with the system
//! timer as the clock.
//!
//! `cargo xtask boards --run` runs this firmware in QEMU. The feature `qemu` is only for that.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SYST};
use cortex_m_rt::{entry, exception};
use critical_section::Mutex;
use mavstack::io::{SerialQueues, queue_len};
use mavstack::{Duration, Instant, LinkConfig, LinkId, StackOf};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::ConstStaticCell;
use stm32f1xx_hal::pac::{self, Interrupt, USART1, interrupt};
use stm32f1xx_hal::prelude::*;
use stm32f1xx_hal::rcc;
use stm32f1xx_hal::serial::{Config as SerialConfig, Serial};

/// The processor's clock. QEMU has no other.
const CLOCK: u32 = 24;
const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// Queues between the interrupt and the loop, which runs at least this often.
static QUEUES: SerialQueues<QUEUE, QUEUE> = SerialQueues::new();
const QUEUE: usize = queue_len(BAUD, Duration::from_millis(4));

/// The UART, owned by the interrupt after initialisation.
static UART: Mutex<RefCell<Option<Serial<USART1>>>> = Mutex::new(RefCell::new(None));

/// Static because it is too large for the call stack. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

#[entry]
fn main() -> ! {
    let chip = pac::Peripherals::take().expect("main runs once");
    let core = cortex_m::Peripherals::take().expect("main runs once");
    // QEMU has neither a crystal nor a PLL.
    let clocks =
        if cfg!(feature = "qemu") { rcc::Config::hsi() } else { rcc::Config::hse(8.MHz()).sysclk(CLOCK.MHz()) };
    let mut rcc = chip.RCC.freeze(clocks, &mut chip.FLASH.constrain().acr);
    let mut clock = Clock::new(core.SYST);

    let gpio = chip.GPIOA.split(&mut rcc);
    let config = SerialConfig::default().baudrate(BAUD.bps());
    let mut uart = chip.USART1.serial((gpio.pa9, gpio.pa10), config, &mut rcc);
    uart.rx.listen();
    critical_section::with(|section| UART.replace(section, Some(uart)));
    // SAFETY: no critical section is active that the interrupt could break.
    #[allow(unsafe_code, reason = "an interrupt is unmasked")]
    unsafe {
        NVIC::unmask(Interrupt::USART1)
    };

    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut telem = QUEUES.loop_end();
    loop {
        let now = clock.now();
        rover.drive(now, stack);
        stack.poll(now, &mut rover);
        // Errors, such as overruns, are counted in `stack.link_counters(TELEM)`. The link continues.
        let _ = stack.poll_link(now, TELEM, &mut telem, &mut rover);
        if telem.has_to_send() {
            NVIC::pend(Interrupt::USART1);
        }
    }
}

/// Raised when a byte was received, when a byte can be sent, or by the loop when bytes are pending.
#[interrupt]
fn USART1() {
    critical_section::with(|section| {
        let mut uart = UART.borrow_ref_mut(section);
        let Some(uart) = uart.as_mut() else { return };
        let mut queues = QUEUES.interrupt_end();
        match uart.rx.read() {
            Ok(byte) => queues.received(byte),
            Err(nb::Error::WouldBlock) => {}
            // Overrun, framing or noise: report it to the loop.
            Err(nb::Error::Other(_)) => queues.line_error(),
        }
        if uart.tx.is_tx_empty() {
            match queues.next_to_send() {
                Some(byte) => {
                    let _ = uart.tx.write_u8(byte);
                    uart.tx.listen();
                }
                None => uart.tx.unlisten(),
            }
        }
    });
}

/// Milliseconds since reset.
static MILLIS: AtomicU32 = AtomicU32::new(0);

#[exception]
fn SysTick() {
    // The only writer.
    MILLIS.store(MILLIS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// A clock of microseconds since reset, on the system timer. Call `now` at least every 49 days.
struct Clock {
    last: u32,
    millis: u64,
}

impl Clock {
    const TICKS_PER_MILLI: u32 = CLOCK * 1_000;

    fn new(mut timer: SYST) -> Self {
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(Self::TICKS_PER_MILLI - 1);
        timer.clear_current();
        timer.enable_counter();
        timer.enable_interrupt();
        Self { last: 0, millis: 0 }
    }

    fn now(&mut self) -> Instant {
        // Again if the timer has wrapped between the two readings. It counts down.
        let (millis, left) = loop {
            let before = MILLIS.load(Ordering::Relaxed);
            let left = SYST::get_current();
            if MILLIS.load(Ordering::Relaxed) == before {
                break (before, left);
            }
        };
        self.millis += u64::from(millis.wrapping_sub(self.last));
        self.last = millis;
        let micros = (Self::TICKS_PER_MILLI - 1).saturating_sub(left) / CLOCK;
        Instant::from_micros(self.millis * 1_000 + u64::from(micros))
    }
}
