//! A rover on an ESP32-C3. Telemetry is on UART1, GPIO10 (TX) and GPIO3 (RX), at 57,600 bit/s.
//!
//! GPIO21 and GPIO20 are not used. They belong to UART0, the console of the boot ROM, which prints at 115,200 bit/s at every boot.
//! On most boards they are also connected to the USB bridge. UART1 can use any other pins. Avoid the strapping pins 2, 8 and 9,
//! JTAG's 4 to 7, the flash's 11 to 17, and USB's 18 and 19.
//!
//! With its feature `unstable`, `esp-hal` implements the traits that the stack needs, so the UART is passed to the stack directly.
//! Its FIFO holds 128 bytes. At 5,760 bytes per second the loop must run at least every 22 ms. This loop never sleeps.
//!
//! The mission and the parameters are stored in the partition `nvs` of the default partition table, while the rover is disarmed. Only
//! Espressif's radio uses it: with the radio, or with another partition table, give the storage a partition of its own. An erase stops
//! the processor for up to 400 ms, with interrupts masked. Received bytes beyond the FIFO are lost meanwhile.
//!
//! `esp_hal::init` disables all watchdogs. A real vehicle enables one again, for longer than an erase.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use esp_hal::uart::{Config as UartConfig, Uart};
use esp_storage::FlashStorage;
use mavstack::storage::Store;
use mavstack::{Instant, LinkConfig, LinkId, StackOf};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::ConstStaticCell;

// The application descriptor that Espressif's boot loader needs.
esp_bootloader_esp_idf::esp_app_desc!();

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// The partition `nvs`, as offsets in the flash: six sectors. The firmware does not read the partition table.
const REGION: core::ops::Range<u32> = 0x9000..0xF000;
const _: () = assert!(Store::<FlashStorage<'_>>::region_len::<Mavlink>() <= REGION.end - REGION.start);

/// Static because it is too large for the call stack. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

#[esp_hal::main]
fn main() -> ! {
    let chip = esp_hal::init(esp_hal::Config::default());
    let mut uart = Uart::new(chip.UART1, UartConfig::default().with_baudrate(BAUD))
        .expect("the baud rate is supported")
        .with_tx(chip.GPIO10)
        .with_rx(chip.GPIO3);

    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut store = Store::new(FlashStorage::new(chip.FLASH), REGION);
    // The rover checks `stack.restore_errors()` in each pass.
    let _ = stack.restore(now(), &mut store, &mut rover);
    loop {
        let now = now();
        rover.drive(now, stack);
        stack.poll(now, &mut rover);
        // Errors, such as overruns, are counted in `stack.link_counters(TELEM)`. The link continues.
        let _ = stack.poll_link(now, TELEM, &mut uart, &mut rover);
        stack.persist(now, &mut store, &mut rover);
    }
}

fn now() -> Instant {
    Instant::from_micros(esp_hal::time::Instant::now().duration_since_epoch().as_micros())
}
