//! A rover on a Raspberry Pi Pico. Telemetry is on UART0, GP0 (TX) and GP1 (RX), at 57,600 bit/s.
//!
//! `rp2040-hal` implements the traits that the stack needs, so the UART is passed to the stack directly. Its FIFO holds 32 bytes.
//! At 5,760 bytes per second the loop must run at least every 5 ms. This loop never sleeps.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

use mavstack::{Instant, LinkConfig, LinkId};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use rp2040_hal::clocks::init_clocks_and_plls;
use rp2040_hal::fugit::RateExtU32;
use rp2040_hal::gpio::Pins;
use rp2040_hal::uart::{DataBits, StopBits, UartConfig, UartPeripheral};
use rp2040_hal::{Clock, Sio, Timer, Watchdog, pac};
use static_cell::ConstStaticCell;

/// The second-stage boot loader for the Pico's flash chip. The boot ROM expects it at a fixed address: see `memory.x`.
#[allow(unsafe_code, reason = "a section that contains nothing else")]
#[unsafe(link_section = ".boot2")]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

const CRYSTAL_HZ: u32 = 12_000_000;
const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// Static because it is too large for the call stack. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<Mavlink> = ConstStaticCell::new(Mavlink::VACANT);

#[rp2040_hal::entry]
fn main() -> ! {
    let mut chip = pac::Peripherals::take().expect("main runs once");
    let mut watchdog = Watchdog::new(chip.WATCHDOG);
    let clocks = init_clocks_and_plls(
        CRYSTAL_HZ,
        chip.XOSC,
        chip.CLOCKS,
        chip.PLL_SYS,
        chip.PLL_USB,
        &mut chip.RESETS,
        &mut watchdog,
    )
    .expect("12 MHz is a valid crystal frequency");

    let sio = Sio::new(chip.SIO);
    let pins = Pins::new(chip.IO_BANK0, chip.PADS_BANK0, sio.gpio_bank0, &mut chip.RESETS);
    let pins = (pins.gpio0.into_function(), pins.gpio1.into_function());
    let format = UartConfig::new(BAUD.Hz(), DataBits::Eight, None, StopBits::One);
    let mut uart = UartPeripheral::new(chip.UART0, pins, &mut chip.RESETS)
        .enable(format, clocks.peripheral_clock.freq())
        .expect("the baud rate is supported");

    // A 64-bit counter of microseconds since reset, as the stack needs it.
    let timer = Timer::new(chip.TIMER, &mut chip.RESETS, &clocks);

    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    loop {
        let now = Instant::from_micros(timer.get_counter().ticks());
        rover.drive(now, stack);
        stack.poll(now, &mut rover);
        // Errors, such as overruns, are counted in `stack.link_counters(TELEM)`. The link continues.
        let _ = stack.poll_link(now, TELEM, &mut uart, &mut rover);
    }
}
