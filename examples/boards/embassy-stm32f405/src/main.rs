//! A rover on an STM32F405 with Embassy. Telemetry is on USART1, PA9 (TX) and PA10 (RX), at 57,600 bit/s.
//!
//! `BufferedUart` of embassy-stm32 0.6 cannot report whether it accepts bytes to send, and its blocking `write` waits until it does.
//! `Polled` polls the async methods instead. When the receive buffer is full, the UART drops bytes without an error; checksums
//! detect that.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use embassy_executor::Spawner;
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config as UartConfig};
use embassy_stm32::{bind_interrupts, peripherals};
use embassy_time::{Duration, Ticker};
use mavstack::io::{Polled, queue_len};
use mavstack::{Instant, LinkConfig, LinkId};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::ConstStaticCell;

bind_interrupts!(struct Interrupts {
    USART1 => BufferedInterruptHandler<peripherals::USART1>;
});

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// Period of the loop.
const PERIOD: Duration = Duration::from_millis(4);
const BUFFER: usize = queue_len(BAUD, mavstack::Duration::from_micros(PERIOD.as_micros()));

/// Static because it is too large for the task. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<Mavlink> = ConstStaticCell::new(Mavlink::VACANT);
static RECEIVED: ConstStaticCell<[u8; BUFFER]> = ConstStaticCell::new([0; BUFFER]);
static TO_SEND: ConstStaticCell<[u8; BUFFER]> = ConstStaticCell::new([0; BUFFER]);

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let chip = embassy_stm32::init(Default::default());
    let mut config = UartConfig::default();
    config.baudrate = BAUD;
    let (received, to_send) = (RECEIVED.take(), TO_SEND.take());
    let uart = BufferedUart::new(chip.USART1, chip.PA10, chip.PA9, to_send, received, Interrupts, config)
        .expect("the baud rate is supported");
    let mut uart = Polled::new(uart);

    let mut rover = Rover::new();
    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut pass = Ticker::every(PERIOD);
    loop {
        let now = Instant::from_micros(embassy_time::Instant::now().as_micros());
        rover.drive(stack);
        stack.poll(now, &mut rover);
        // Errors are counted in `stack.link_counters(TELEM)`. The link continues.
        let _ = stack.poll_link(now, TELEM, &mut uart, &mut rover);
        // Let other tasks run.
        pass.next().await;
    }
}
