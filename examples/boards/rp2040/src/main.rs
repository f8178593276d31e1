//! A rover on a Raspberry Pi Pico, with two links: UART0, GP0 (TX) and GP1 (RX), at 57,600 bit/s, and the USB, as a serial port (CDC).
//!
//! `rp2040-hal` implements the traits that the stack needs, so the UART is passed to the stack directly. Its FIFO holds 32 bytes.
//! At 5,760 bytes per second the loop must run at least every 5 ms. `io::Io06` adapts the port of `usbd-serial`.
//!
//! The loop runs every millisecond, and after each USB interrupt. In between the processor sleeps. Interrupts stay masked: they only
//! wake the processor.
//!
//! The mission and the parameters are stored in the last 64 KiB of the flash, while the rover is disarmed. An erase stops the
//! processor for 45 ms typically, and 400 ms at most. Received bytes beyond the UART's FIFO are lost meanwhile.
//!
//! `cargo xtask boards --run` runs this firmware in rp2040js, unchanged.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

mod board;
mod flash;

use board::Board;
use cortex_m::peripheral::NVIC;
use mavstack::io::Io06;
use mavstack::storage::Store;
use mavstack::{LinkConfig, LinkId, StackOf};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use rp2040_hal::pac::Interrupt;
use rp2040_hal::usb::UsbBus;
use static_cell::ConstStaticCell;
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{StringDescriptors, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};
use usbd_serial::{SerialPort, USB_CLASS_CDC};

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);
const USB: LinkId = LinkId(1);
/// USB has no baud rate: backpressure limits the stack. The default budget is less than USB carries, and the rest waits in the host: a
/// pass stays short enough for the UART, also when a host floods the USB.
const LINKS: [LinkConfig; 2] = [LinkConfig::uart(BAUD), LinkConfig::unlimited()];
const PERIOD_MS: u32 = 1;
const _: () = assert!(Store::<flash::Sectors>::region_len::<Mavlink>() <= flash::REGION.end - flash::REGION.start);

/// Static because it is too large for the call stack. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

#[rp2040_hal::entry]
fn main() -> ! {
    let Board { mut uart, mut clock, flash, usb: (registers, memory, usb_clock), mut resets, .. } = Board::start(BAUD);

    // The USB. The ids are those of usb-device for tests; your product needs its own.
    let bus = UsbBus::new(registers, memory, usb_clock, true, &mut resets);
    let bus = UsbBusAllocator::new(bus);
    let mut port = Io06::new(SerialPort::new(&bus));
    let names = StringDescriptors::default().manufacturer("mavstack").product("Rover").serial_number("1");
    let mut usb = UsbDeviceBuilder::new(&bus, UsbVidPid(0x16C0, 0x27DD))
        .strings(&[names])
        .expect("strings in one language")
        .device_class(USB_CLASS_CDC)
        .max_packet_size_0(64)
        .expect("64 is a valid size")
        .build();
    let mut was_configured = false;

    // SAFETY: interrupts are masked, so no handler runs.
    #[allow(unsafe_code, reason = "an interrupt is unmasked, to wake the processor")]
    unsafe {
        NVIC::unmask(Interrupt::USBCTRL_IRQ);
    };

    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, LINKS);
    let mut store = Store::new(flash, flash::REGION);
    // The rover checks `stack.restore_errors()` in each pass.
    let _ = stack.restore(clock.now(), &mut store, &mut rover);
    loop {
        clock.begin_pass(PERIOD_MS);
        let now = clock.now();
        rover.drive(now, stack);
        stack.poll(now, &mut rover);
        // Errors, such as overruns, are counted in `stack.link_counters(TELEM)`. The link continues.
        let _ = stack.poll_link(now, TELEM, &mut uart, &mut rover);

        usb.poll(&mut [port.get_mut()]);
        let is_configured = usb.state() == UsbDeviceState::Configured;
        if is_configured {
            if !was_configured {
                // A reset of the bus has emptied the port's buffers.
                stack.restart_link(USB);
            }
            let _ = stack.poll_link(now, USB, &mut port, &mut rover);
        }
        was_configured = is_configured;

        stack.persist(now, &mut store, &mut rover);
        clock.sleep();
        // While the USB has something to do, it raises its interrupt again.
        NVIC::unpend(Interrupt::USBCTRL_IRQ);
    }
}
