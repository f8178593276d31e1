//! A rover on a Raspberry Pi Pico: telemetry on UART0, GP0 (out) and GP1 (in), at 57,600 bit/s.
//!
//! `rp2040-hal` implements all that the stack asks of a UART, so the UART is handed over as it is. Its FIFO takes 32 bytes: with
//! 5,760 bytes a second the loop has to come round every 5 ms. This one does not sleep.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

use mavstack::{Instant, LinkConfig, LinkId};
use mavstack_rover::{CONFIG, Rover, RoverStack};
// Stops at a panic, which the stack has none of. A vehicle would rather cut its motors and let the watchdog reset it.
use panic_halt as _;
use rp2040_hal::clocks::init_clocks_and_plls;
use rp2040_hal::fugit::RateExtU32;
use rp2040_hal::gpio::Pins;
use rp2040_hal::uart::{DataBits, StopBits, UartConfig, UartPeripheral};
use rp2040_hal::{Clock, Sio, Timer, Watchdog, pac};
use static_cell::StaticCell;

/// The second stage of the boot loader, for the flash chip of the Pico. Where it stands is part of the chip: see `memory.x`.
#[allow(unsafe_code, reason = "a section of its own, which nothing else is in")]
#[unsafe(link_section = ".boot2")]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

const CRYSTAL_HZ: u32 = 12_000_000;
const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// Not on the stack, which it is too large for.
static STACK: StaticCell<RoverStack> = StaticCell::new();

#[rp2040_hal::entry]
fn main() -> ! {
    let mut chip = pac::Peripherals::take().expect("the entry point is entered once");
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
    .expect("the crystal of a Pico swings at 12 MHz");

    let sio = Sio::new(chip.SIO);
    let pins = Pins::new(chip.IO_BANK0, chip.PADS_BANK0, sio.gpio_bank0, &mut chip.RESETS);
    let pins = (pins.gpio0.into_function(), pins.gpio1.into_function());
    let format = UartConfig::new(BAUD.Hz(), DataBits::Eight, None, StopBits::One);
    let mut uart = UartPeripheral::new(chip.UART0, pins, &mut chip.RESETS)
        .enable(format, clocks.peripheral_clock.freq())
        .expect("the clock can be divided to this rate");

    // 64 bits of microseconds since the reset: what the stack wants.
    let timer = Timer::new(chip.TIMER, &mut chip.RESETS, &clocks);

    let mut rover = Rover::new();
    let stack = STACK.init_with(|| RoverStack::new(CONFIG, [LinkConfig::uart(BAUD)]));
    loop {
        let now = Instant::from_micros(timer.get_counter().ticks());
        rover.drive();
        stack.poll(now, &mut rover);
        // An overrun, say. It is counted in `stack.link_counters(TELEM)`, and the link goes on.
        let _ = stack.poll_link(now, TELEM, &mut uart, &mut rover);
    }
}
