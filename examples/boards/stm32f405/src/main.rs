//! A rover on an STM32F405, as on many flight controllers. Telemetry is on USART1, PA9 (TX) and PA10 (RX), at 57,600 bit/s.
//!
//! A USART of this chip buffers one received byte, and the next one arrives 174 µs later. Its interrupt therefore moves each byte
//! to a queue. The loop passes the other end of the queue to the stack. It runs at least every 4 ms, unless it erases or writes flash. The
//! UART of `stm32f4xx-hal` cannot be passed directly, because it does not implement `Read`, `ReadReady` and `WriteReady`.
//!
//! The mission and the parameters are stored in the last two sectors of the flash, while the rover is disarmed. An erase stops the
//! processor for 2 s typically, and 4 s at most. All received bytes are lost meanwhile, because the interrupt's code is in the flash, too.
//!
//! `cargo xtask boards --run` runs this firmware in QEMU. The feature `qemu` is only for that.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

#[cfg_attr(feature = "qemu", path = "emulated.rs")]
mod flash;

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use cortex_m_rt::entry;
use critical_section::Mutex;
use mavstack::io::{SerialQueues, queue_len};
use mavstack::storage::Store;
use mavstack::{Duration, Instant, LinkConfig, LinkId, StackOf};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::ConstStaticCell;
use stm32f4xx_hal::pac::{self, Interrupt, TIM5, USART1};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::serial::{Config as SerialConfig, Event, Serial};
use stm32f4xx_hal::timer::CounterUs;
use stm32f4xx_hal::{interrupt, nb, rcc};

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);
const _: () = assert!(Store::<flash::Sectors>::region_len::<Mavlink>() <= flash::REGION.end - flash::REGION.start);

/// Queues between the interrupt and the loop, which runs at least this often, except while it erases or writes flash.
static QUEUES: SerialQueues<QUEUE, QUEUE> = SerialQueues::new();
/// QEMU delivers several frames at once, faster than the baud rate.
const QUEUE: usize = queue_len(BAUD, Duration::from_millis(if cfg!(feature = "qemu") { 80 } else { 4 }));

/// The UART, owned by the interrupt after initialisation.
static UART: Mutex<RefCell<Option<Serial<USART1>>>> = Mutex::new(RefCell::new(None));

/// Static because it is too large for the call stack. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

#[entry]
fn main() -> ! {
    let chip = pac::Peripherals::take().expect("main runs once");
    // Set this to the crystal of your board. QEMU has neither a crystal nor a PLL.
    let clocks = if cfg!(feature = "qemu") { rcc::Config::hsi() } else { rcc::Config::hse(8.MHz()).sysclk(168.MHz()) };
    let mut rcc = chip.RCC.freeze(clocks);
    let mut clock = Clock::new(chip.TIM5.counter_us(&mut rcc));

    let pins = chip.GPIOA.split(&mut rcc);
    let config = SerialConfig::default().baudrate(BAUD.bps());
    let mut uart = chip.USART1.serial((pins.pa9, pins.pa10), config, &mut rcc).expect("the baud rate is supported");
    uart.listen(Event::RxNotEmpty);
    critical_section::with(|section| UART.replace(section, Some(uart)));
    // SAFETY: no critical section is active that the interrupt could break.
    #[allow(unsafe_code, reason = "an interrupt is unmasked")]
    unsafe {
        NVIC::unmask(Interrupt::USART1)
    };

    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut store = Store::new(flash::Sectors::new(chip.FLASH), flash::REGION);
    // The rover checks `stack.restore_errors()` in each pass.
    let _ = stack.restore(clock.now(), &mut store, &mut rover);
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
        stack.persist(now, &mut store, &mut rover);
    }
}

/// Raised when a byte was received, when a byte can be sent, or by the loop when bytes are pending.
#[interrupt]
fn USART1() {
    critical_section::with(|section| {
        let mut uart = UART.borrow_ref_mut(section);
        let Some(uart) = uart.as_mut() else { return };
        let mut queues = QUEUES.interrupt_end();
        match uart.read() {
            Ok(byte) => queues.received(byte),
            Err(nb::Error::WouldBlock) => {}
            // Overrun, framing or noise: report it to the loop.
            Err(nb::Error::Other(_)) => queues.line_error(),
        }
        if uart.is_tx_empty() {
            match queues.next_to_send() {
                Some(byte) => {
                    let _ = uart.write(byte);
                    uart.listen(Event::TxEmpty);
                }
                None => uart.unlisten(Event::TxEmpty),
            }
        }
    });
}

/// A clock of microseconds since reset, on a 32-bit timer. Call `now` at least every 71 minutes.
struct Clock {
    timer: CounterUs<TIM5>,
    last: u32,
    ticks: u64,
}

impl Clock {
    /// The longest period that the timer supports.
    const PERIOD: u32 = u32::MAX;

    /// Microseconds per tick, as a fraction. In QEMU the timer's clock is 1 GHz, and the HAL divides it by 16.
    const TICK: (u64, u64) = if cfg!(feature = "qemu") { (16, 1_000) } else { (1, 1) };

    fn new(mut timer: CounterUs<TIM5>) -> Self {
        timer.start(Self::PERIOD.micros()).expect("the timer has 32 bits");
        Self { timer, last: 0, ticks: 0 }
    }

    fn now(&mut self) -> Instant {
        let count = self.timer.now().ticks();
        let elapsed = count.checked_sub(self.last).unwrap_or_else(|| Self::PERIOD - self.last + count);
        self.last = count;
        self.ticks += u64::from(elapsed);
        Instant::from_micros(self.ticks * Self::TICK.0 / Self::TICK.1)
    }
}
