//! A rover on an STM32F405 with Embassy: telemetry on USART1, PA9 (out) and PA10 (in), at 57,600 bit/s.
//!
//! Embassy's `BufferedUart`, of embassy-stm32 0.6, cannot say whether it has room to send, and its blocking `write` waits until
//! it has; `Polled` polls the asynchronous one instead. What its receive buffer has no room for is dropped there without a word:
//! the checksums find it.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use embassy_executor::Spawner;
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config as UartConfig};
use embassy_stm32::{bind_interrupts, peripherals};
use embassy_time::{Duration, Ticker};
use mavstack::io::{Polled, queue_len};
use mavstack::{Instant, LinkConfig, LinkId};
use mavstack_rover::{CONFIG, Rover, RoverStack};
// Stops at a panic, which the stack has none of. A vehicle would rather cut its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::{ConstStaticCell, StaticCell};

bind_interrupts!(struct Interrupts {
    USART1 => BufferedInterruptHandler<peripherals::USART1>;
});

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// The loop comes round this often.
const PERIOD: Duration = Duration::from_millis(4);
const BUFFER: usize = queue_len(BAUD, mavstack::Duration::from_micros(PERIOD.as_micros()));

/// Not in the task, which it is too large for.
static STACK: StaticCell<RoverStack> = StaticCell::new();
static RECEIVED: ConstStaticCell<[u8; BUFFER]> = ConstStaticCell::new([0; BUFFER]);
static TO_SEND: ConstStaticCell<[u8; BUFFER]> = ConstStaticCell::new([0; BUFFER]);

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let chip = embassy_stm32::init(Default::default());
    let mut config = UartConfig::default();
    config.baudrate = BAUD;
    let (received, to_send) = (RECEIVED.take(), TO_SEND.take());
    let uart = BufferedUart::new(chip.USART1, chip.PA10, chip.PA9, to_send, received, Interrupts, config)
        .expect("the clock can be divided to this rate");
    let mut uart = Polled::new(uart);

    let mut rover = Rover::new();
    let stack = STACK.init_with(|| RoverStack::new(CONFIG, [LinkConfig::uart(BAUD)]));
    let mut pass = Ticker::every(PERIOD);
    loop {
        let now = Instant::from_micros(embassy_time::Instant::now().as_micros());
        rover.drive();
        stack.poll(now, &mut rover);
        // It is counted in `stack.link_counters(TELEM)`, and the link goes on.
        let _ = stack.poll_link(now, TELEM, &mut uart, &mut rover);
        // Others' tasks run now.
        pass.next().await;
    }
}
