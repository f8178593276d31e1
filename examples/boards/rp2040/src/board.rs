//! The Raspberry Pi Pico, for the firmwares with `rp2040-hal`: the boot loader, the clocks, UART0, and a timer that wakes the processor.

use cortex_m::peripheral::NVIC;
use mavstack::Instant;
use rp2040_hal::clocks::{UsbClock, init_clocks_and_plls};
use rp2040_hal::fugit::{ExtU32, RateExtU32};
use rp2040_hal::gpio::bank0::{Gpio0, Gpio1};
use rp2040_hal::gpio::{FunctionUart, Pin, Pins, PullDown};
use rp2040_hal::pac::{self, Interrupt};
use rp2040_hal::timer::{Alarm, Alarm0};
use rp2040_hal::uart::{DataBits, Enabled, StopBits, UartConfig, UartPeripheral};
use rp2040_hal::{Clock as _, Sio, Timer, Watchdog};

use crate::flash::Sectors;

/// The second-stage boot loader for the Pico's flash chip. The boot ROM expects it at a fixed address: see `memory.x`.
#[allow(unsafe_code, reason = "a section that contains nothing else")]
#[unsafe(link_section = ".boot2")]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

const CRYSTAL_HZ: u32 = 12_000_000;

/// UART0, on GP0 (TX) and GP1 (RX).
pub type Uart =
    UartPeripheral<Enabled, pac::UART0, (Pin<Gpio0, FunctionUart, PullDown>, Pin<Gpio1, FunctionUart, PullDown>)>;

/// What the firmwares use of the chip.
#[allow(dead_code, reason = "each firmware uses its own part")]
pub struct Board {
    pub uart: Uart,
    pub clock: Clock,
    pub flash: Sectors,
    pub dma: pac::DMA,
    /// The USB's controller, its memory and its clock.
    pub usb: (pac::USBCTRL_REGS, pac::USBCTRL_DPRAM, UsbClock),
    pub resets: pac::RESETS,
}

impl Board {
    /// Starts the clocks, the timer, and the UART at `baud` bit/s. From then on, interrupts are masked: they only wake the processor.
    pub fn start(baud: u32) -> Self {
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
        let format = UartConfig::new(baud.Hz(), DataBits::Eight, None, StopBits::One);
        // It enables the UART's requests to the DMA, too.
        let uart = UartPeripheral::new(chip.UART0, pins, &mut chip.RESETS)
            .enable(format, clocks.peripheral_clock.freq())
            .expect("the baud rate is supported");

        let timer = Timer::new(chip.TIMER, &mut chip.RESETS, &clocks);
        Self {
            uart,
            clock: Clock::new(timer),
            flash: Sectors::new(chip.XIP_SSI),
            dma: chip.DMA,
            usb: (chip.USBCTRL_REGS, chip.USBCTRL_DPRAM, clocks.usb_clock),
            resets: chip.RESETS,
        }
    }
}

/// The stack's clock: a 64-bit counter of microseconds since reset. Its alarm wakes the processor.
pub struct Clock {
    timer: Timer,
    alarm: Alarm0,
}

impl Clock {
    fn new(mut timer: Timer) -> Self {
        let mut alarm = timer.alarm_0().expect("an alarm is taken once");
        alarm.enable_interrupt();
        cortex_m::interrupt::disable();
        // SAFETY: interrupts are masked, so no handler runs.
        #[allow(unsafe_code, reason = "an interrupt is unmasked, to wake the processor")]
        unsafe {
            NVIC::unmask(Interrupt::TIMER_IRQ_0);
        };
        Self { timer, alarm }
    }

    /// Returns the time since reset.
    pub fn now(&self) -> Instant {
        self.timer.get_counter().into()
    }

    /// Begins a pass of the loop, whose [`sleep`](Self::sleep) ends `period_ms` milliseconds from now.
    pub fn begin_pass(&mut self, period_ms: u32) {
        let _ = self.alarm.schedule(period_ms.millis());
    }

    /// Sleeps until the end of the pass, or until another interrupt.
    pub fn sleep(&mut self) {
        cortex_m::asm::wfi();
        self.alarm.clear_interrupt();
        NVIC::unpend(Interrupt::TIMER_IRQ_0);
    }
}
