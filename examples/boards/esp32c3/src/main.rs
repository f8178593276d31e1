//! A rover on an ESP32-C3: telemetry on UART1, GPIO10 (out) and GPIO3 (in), at 57,600 bit/s.
//!
//! GPIO21 and GPIO20 are not used: they belong to UART0, the console of the boot ROM, which prints at 115,200 bit/s at every
//! start. On most boards they also lead to the USB bridge. UART1 can use any other pins; avoid the strapping pins 2, 8 and 9,
//! JTAG's 4 to 7, the flash's 11 to 17, and USB's 18 and 19.
//!
//! `esp-hal` implements all that the stack asks of a UART, with its feature `unstable`, so the UART is handed over as it is.
//! Its FIFO takes 128 bytes: with 5,760 bytes a second the loop has to come round every 22 ms. This one does not sleep.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use esp_hal::uart::{Config as UartConfig, Uart};
use mavstack::{Instant, LinkConfig, LinkId};
use mavstack_rover::{CONFIG, Rover, RoverStack};
// Stops at a panic, which the stack has none of. A vehicle would rather cut its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::StaticCell;

// What Espressif's boot loader wants to know of an application.
esp_bootloader_esp_idf::esp_app_desc!();

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// Not on the stack, which it is too large for.
static STACK: StaticCell<RoverStack> = StaticCell::new();

#[esp_hal::main]
fn main() -> ! {
    let chip = esp_hal::init(esp_hal::Config::default());
    let mut uart = Uart::new(chip.UART1, UartConfig::default().with_baudrate(BAUD))
        .expect("the clock can be divided to this rate")
        .with_tx(chip.GPIO10)
        .with_rx(chip.GPIO3);

    let mut rover = Rover::new();
    let stack = STACK.init_with(|| RoverStack::new(CONFIG, [LinkConfig::uart(BAUD)]));
    loop {
        let now = Instant::from_micros(esp_hal::time::Instant::now().duration_since_epoch().as_micros());
        rover.drive();
        stack.poll(now, &mut rover);
        // An overrun, say. It is counted in `stack.link_counters(TELEM)`, and the link goes on.
        let _ = stack.poll_link(now, TELEM, &mut uart, &mut rover);
    }
}
