//! A rover on a Raspberry Pi Pico. Telemetry is on UART0, GP0 (TX) and GP1 (RX), at 115,200 bit/s, by DMA in both directions.
//!
//! The DMA writes received bytes to a ring, and the loop passes them to the stack every 4 ms. The DMA's counter gives the laps, so no
//! interrupt counts them. To send, the loop refills a buffer when the DMA has sent it. See `dma.rs`.
//!
//! The mission and the parameters are stored in the last 64 KiB of the flash, while the rover is disarmed. An erase stops the
//! processor for 45 ms typically, and 400 ms at most. The DMA continues meanwhile, so no received byte is lost. Without it, the UART's FIFO
//! of 32 bytes would be full after 2.8 ms.
//!
//! The processor sleeps between passes of the loop. Interrupts stay masked: the timer interrupt only wakes the processor.
//!
//! `cargo xtask boards --run` runs this firmware in rp2040js, unchanged.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

mod dma;
#[path = "../../rp2040/src/flash.rs"]
mod flash;

use cortex_m::peripheral::NVIC;
use mavstack::storage::Store;
use mavstack::{Duration, Instant, LinkConfig, LinkId};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use rp2040_hal::clocks::init_clocks_and_plls;
use rp2040_hal::dma::DMAExt;
use rp2040_hal::fugit::{ExtU32, RateExtU32};
use rp2040_hal::gpio::Pins;
use rp2040_hal::pac::{self, Interrupt};
use rp2040_hal::timer::Alarm;
use rp2040_hal::uart::{DataBits, StopBits, UartConfig, UartPeripheral};
use rp2040_hal::{Clock, Sio, Timer, Watchdog};
use static_cell::ConstStaticCell;

/// The second-stage boot loader for the Pico's flash chip. The boot ROM expects it at a fixed address: see `memory.x`.
#[allow(unsafe_code, reason = "a section that contains nothing else")]
#[unsafe(link_section = ".boot2")]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

const CRYSTAL_HZ: u32 = 12_000_000;
const BAUD: u32 = 115_200;
const TELEM: LinkId = LinkId(0);
const PERIOD_MS: u32 = 4;
const PERIOD: Duration = Duration::from_millis(PERIOD_MS as u64);
/// The longest erase of a sector of the flash.
const ERASE: Duration = Duration::from_millis(400);
const _: () = assert!(Store::<flash::Sectors>::region_len::<Mavlink>() <= flash::REGION.end - flash::REGION.start);

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
    // It enables the UART's requests to the DMA, too.
    let uart = UartPeripheral::new(chip.UART0, pins, &mut chip.RESETS)
        .enable(format, clocks.peripheral_clock.freq())
        .expect("the baud rate is supported");
    let (receiver, transmitter) = uart.split();
    let channels = chip.DMA.split(&mut chip.RESETS);
    let mut receiver = dma::Receiver::new(receiver, channels.ch0, channels.ch1);
    let mut transmitter = dma::Transmitter::new(transmitter, channels.ch2);

    // A 64-bit counter of microseconds since reset, as the stack needs it.
    let mut timer = Timer::new(chip.TIMER, &mut chip.RESETS, &clocks);
    let mut alarm = timer.alarm_0().expect("an alarm is taken once");
    alarm.enable_interrupt();
    cortex_m::interrupt::disable();
    // SAFETY: interrupts are masked, so no handler runs.
    #[allow(unsafe_code, reason = "an interrupt is unmasked, to wake the processor")]
    unsafe {
        NVIC::unmask(Interrupt::TIMER_IRQ_0);
    };

    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut store = Store::new(flash::Sectors::new(chip.XIP_SSI), flash::REGION);
    let now = |timer: &Timer| Instant::from_micros(timer.get_counter().ticks());
    // The rover checks `stack.restore_errors()` in each pass.
    let _ = stack.restore(now(&timer), &mut store, &mut rover);
    loop {
        let _ = alarm.schedule(PERIOD_MS.millis());
        let now = now(&timer);
        rover.drive(now, stack);
        stack.poll(now, &mut rover);
        // The receiver counts the bytes that were overwritten before they were read. The link continues.
        let _ = receiver.poll(stack.receiver(now, TELEM, &mut rover));
        if transmitter.is_idle() {
            loop {
                let len = transmitter.append(stack.transmit(now, TELEM, &mut rover));
                if len == 0 {
                    break;
                }
                stack.transmitted(TELEM, len);
            }
            transmitter.start();
        }
        stack.persist(now, &mut store, &mut rover);
        cortex_m::asm::wfi();
        alarm.clear_interrupt();
        NVIC::unpend(Interrupt::TIMER_IRQ_0);
    }
}
