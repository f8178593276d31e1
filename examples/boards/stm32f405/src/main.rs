//! A rover on an STM32F405, as on many flight controllers: telemetry on USART1, PA9 (out) and PA10 (in), at 57,600 bit/s.
//!
//! A USART of this chip keeps one received byte, and the next is there 174 µs later. So its interrupt takes each into a queue,
//! and the loop, which comes round every 4 ms at most, hands the other end of the queue to the stack. The UART of
//! `stm32f4xx-hal` could not be handed over anyway: it is not `Read`, `ReadReady` and `WriteReady`.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use cortex_m_rt::entry;
use critical_section::Mutex;
use mavstack::io::{SerialQueues, queue_len};
use mavstack::{Duration, Instant, LinkConfig, LinkId};
use mavstack_rover::{CONFIG, Rover, RoverStack};
// Stops at a panic, which the stack has none of. A vehicle would rather cut its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::StaticCell;
use stm32f4xx_hal::pac::{self, Interrupt, TIM5, USART1};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::serial::{Config as SerialConfig, Event, Serial};
use stm32f4xx_hal::timer::CounterUs;
use stm32f4xx_hal::{interrupt, nb, rcc};

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// Between the interrupt and the loop, which comes round this often at least.
static QUEUES: SerialQueues<QUEUE, QUEUE> = SerialQueues::new();
const QUEUE: usize = queue_len(BAUD, Duration::from_millis(4));

/// The interrupt's, once it is set up.
static UART: Mutex<RefCell<Option<Serial<USART1>>>> = Mutex::new(RefCell::new(None));

/// Not on the stack, which it is too large for.
static STACK: StaticCell<RoverStack> = StaticCell::new();

#[entry]
fn main() -> ! {
    let chip = pac::Peripherals::take().expect("the entry point is entered once");
    // The crystal of your board.
    let mut rcc = chip.RCC.freeze(rcc::Config::hse(8.MHz()).sysclk(168.MHz()));
    let mut clock = Clock::new(chip.TIM5.counter_us(&mut rcc));

    let pins = chip.GPIOA.split(&mut rcc);
    let config = SerialConfig::default().baudrate(BAUD.bps());
    let mut uart =
        chip.USART1.serial((pins.pa9, pins.pa10), config, &mut rcc).expect("the clock can be divided to this rate");
    uart.listen(Event::RxNotEmpty);
    critical_section::with(|section| UART.replace(section, Some(uart)));
    // SAFETY: no critical section is open that the interrupt could break.
    #[allow(unsafe_code, reason = "an interrupt is unmasked")]
    unsafe {
        NVIC::unmask(Interrupt::USART1)
    };

    let mut rover = Rover::new();
    let stack = STACK.init_with(|| RoverStack::new(CONFIG, [LinkConfig::uart(BAUD)]));
    let mut telem = QUEUES.loop_end();
    loop {
        let now = clock.now();
        rover.drive();
        stack.poll(now, &mut rover);
        // An overrun, say. It is counted in `stack.link_counters(TELEM)`, and the link goes on.
        let _ = stack.poll_link(now, TELEM, &mut telem, &mut rover);
        if telem.has_to_send() {
            NVIC::pend(Interrupt::USART1);
        }
    }
}

/// A byte was received, one can be sent, or the loop has something to send.
#[interrupt]
fn USART1() {
    critical_section::with(|section| {
        let mut uart = UART.borrow_ref_mut(section);
        let Some(uart) = uart.as_mut() else { return };
        let mut queues = QUEUES.interrupt_end();
        match uart.read() {
            Ok(byte) => queues.received(byte),
            Err(nb::Error::WouldBlock) => {}
            // Overrun, framing, noise: the loop is told.
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

/// Microseconds since the reset, of which the timer counts 32 bits: look more often than every 71 minutes.
struct Clock {
    timer: CounterUs<TIM5>,
    last: u32,
    micros: u64,
}

impl Clock {
    /// As the timer can be set.
    const PERIOD: u32 = u32::MAX;

    fn new(mut timer: CounterUs<TIM5>) -> Self {
        timer.start(Self::PERIOD.micros()).expect("the timer has 32 bits");
        Self { timer, last: 0, micros: 0 }
    }

    fn now(&mut self) -> Instant {
        let count = self.timer.now().ticks();
        let elapsed = count.checked_sub(self.last).unwrap_or_else(|| Self::PERIOD - self.last + count);
        self.last = count;
        self.micros += u64::from(elapsed);
        Instant::from_micros(self.micros)
    }
}
