//! A rover on a BBC micro:bit: an nRF51822, a Cortex-M0 at 16 MHz with 16 KiB of RAM. Telemetry is on UART0, P0.24 (TX) and P0.25
//! (RX), at 57,600 bit/s, which the micro:bit's USB interface carries.
//!
//! The UART buffers six received bytes, which arrive in 1 ms. Its interrupt therefore moves each byte to a queue. The loop passes the
//! other end of the queue to the stack. It runs at least every 4 ms, unless it erases or writes flash.
//!
//! The mission and the parameters are stored in the last 32 KiB of the flash, while the rover is disarmed. An erase stops the processor
//! for 22 ms, so received bytes are lost meanwhile.
//!
//! `cargo xtask boards --run` runs this firmware in QEMU, unchanged.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

mod flash;

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use cortex_m_rt::entry;
use critical_section::Mutex;
use mavstack::io::{SerialQueues, queue_len};
use mavstack::storage::Store;
use mavstack::{Duration, Instant, LinkConfig, LinkId, StackOf};
use mavstack_rover::{CONFIG, Mavlink, Rover};
use nrf51_hal::gpio::{Level, p0};
use nrf51_hal::pac::{self, Interrupt, TIMER0, UART0, interrupt};
use nrf51_hal::timer::Periodic;
use nrf51_hal::{Clocks, Timer};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::ConstStaticCell;

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);
const _: () = assert!(Store::<flash::Pages>::region_len::<Mavlink>() <= flash::REGION.end - flash::REGION.start);

/// Queues between the interrupt and the loop, which runs at least this often, except while it erases or writes flash.
static QUEUES: SerialQueues<QUEUE, QUEUE> = SerialQueues::new();
const QUEUE: usize = queue_len(BAUD, Duration::from_millis(4));

/// The UART, owned by the interrupt after initialisation.
static UART: Mutex<RefCell<Option<UART0>>> = Mutex::new(RefCell::new(None));

/// Static because it is too large for the call stack. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

#[entry]
fn main() -> ! {
    let chip = pac::Peripherals::take().expect("main runs once");
    // The crystal: the internal oscillator is too inaccurate for a UART.
    let _clocks = Clocks::new(chip.CLOCK).enable_ext_hfosc();
    let mut clock = Clock::new(chip.TIMER0);

    let pins = p0::Parts::new(chip.GPIO);
    let tx = pins.p0_24.into_push_pull_output(Level::High).degrade();
    let rx = pins.p0_25.into_floating_input().degrade();
    start(&chip.UART0, tx.pin().into(), rx.pin().into());
    critical_section::with(|section| UART.replace(section, Some(chip.UART0)));
    // SAFETY: no critical section is active that the interrupt could break.
    #[allow(unsafe_code, reason = "an interrupt is unmasked")]
    unsafe {
        NVIC::unmask(Interrupt::UART0)
    };

    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut store = Store::new(flash::Pages::new(chip.NVMC), flash::REGION);
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
            NVIC::pend(Interrupt::UART0);
        }
        stack.persist(now, &mut store, &mut rover);
    }
}

/// Starts the UART. The driver of `nrf51-hal` has no interrupts.
fn start(uart: &UART0, tx: u32, rx: u32) {
    uart.enable.write(|w| w.enable().enabled());
    // SAFETY: these are the numbers of the pins.
    #[allow(unsafe_code, reason = "the registers take any value")]
    unsafe {
        uart.pseltxd.write(|w| w.bits(tx));
        uart.pselrxd.write(|w| w.bits(rx));
        uart.tasks_starttx.write(|w| w.bits(1));
        uart.tasks_startrx.write(|w| w.bits(1));
        // A first byte, which receivers ignore: TXDRDY reports that a byte was sent, not that one can be sent.
        uart.txd.write(|w| w.bits(0));
    }
    uart.baudrate.write(|w| w.baudrate().baud57600());
    uart.intenset.write(|w| w.rxdrdy().set().error().set());
}

/// Raised when a byte was received, when a byte was sent, or by the loop when bytes are pending.
#[interrupt]
fn UART0() {
    critical_section::with(|section| {
        let uart = UART.borrow_ref(section);
        let Some(uart) = uart.as_ref() else { return };
        let mut queues = QUEUES.interrupt_end();
        while uart.events_rxdrdy.read().bits() != 0 {
            uart.events_rxdrdy.reset();
            queues.received(uart.rxd.read().rxd().bits());
        }
        if uart.events_error.read().bits() != 0 {
            // Overrun, framing or noise: report it to the loop.
            uart.events_error.reset();
            queues.line_error();
        }
        if uart.events_txdrdy.read().bits() != 0 {
            match queues.next_to_send() {
                Some(byte) => {
                    uart.events_txdrdy.reset();
                    uart.intenset.write(|w| w.txdrdy().set());
                    // SAFETY: any byte can be sent.
                    #[allow(unsafe_code, reason = "the register takes any value")]
                    uart.txd.write(|w| unsafe { w.txd().bits(byte) });
                }
                // The event stays set, for the next byte.
                None => uart.intenclr.write(|w| w.txdrdy().clear()),
            }
        }
    });
}

/// A clock of microseconds since reset, on a 32-bit timer. Call `now` at least every 71 minutes.
struct Clock {
    timer: Timer<TIMER0, Periodic>,
    last: u32,
    micros: u64,
}

impl Clock {
    fn new(timer: TIMER0) -> Self {
        let mut timer = Timer::periodic(timer);
        // The longest period: the timer wraps from there to 0.
        timer.start(u32::MAX);
        Self { timer, last: 0, micros: 0 }
    }

    fn now(&mut self) -> Instant {
        let count = self.timer.read();
        self.micros += u64::from(count.wrapping_sub(self.last));
        self.last = count;
        Instant::from_micros(self.micros)
    }
}
