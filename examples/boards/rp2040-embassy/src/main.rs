//! A rover on a Raspberry Pi Pico with Embassy, with two links: UART0, GP0 (TX) and GP1 (RX), at 57,600 bit/s, and the USB, as a serial
//! port (CDC).
//!
//! The futures of `rover-embassy` and the USB future share one task. The mission and the parameters are stored in the last 64 KiB of
//! the flash, while the rover is disarmed. An erase stops the processor for 45 ms typically, and 400 ms at most. Received bytes beyond
//! the UART's FIFO are lost meanwhile.
//!
//! `cargo xtask boards --run` runs this firmware in rp2040js, unchanged.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use embassy_executor::Spawner;
use embassy_futures::join::join4;
use embassy_rp::flash::{Blocking, Flash};
use embassy_rp::peripherals::{FLASH, UART0, USB};
use embassy_rp::uart::{BufferedInterruptHandler, BufferedUart, Config as UartConfig};
use embassy_rp::{bind_interrupts, usb};
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::{Builder, Config as UsbConfig};
use mavstack::config::PollBudget;
use mavstack::io::queue_len;
use mavstack::storage::Store;
use mavstack::{Config, Duration, LinkConfig, LinkId, StackOf};
use mavstack_rover::{CONFIG, Mavlink, Rover};
use mavstack_rover_embassy::{PERIOD, Shared, now};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::{ConstStaticCell, StaticCell};

bind_interrupts!(struct Interrupts {
    UART0_IRQ => BufferedInterruptHandler<UART0>;
    USBCTRL_IRQ => usb::InterruptHandler<USB>;
});

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);
const USB_PORT: LinkId = LinkId(1);
/// USB has no baud rate: backpressure limits the stack.
const LINKS: [LinkConfig; 2] = [LinkConfig::uart(BAUD), LinkConfig::unlimited()];
/// All bytes that USB full speed carries in a millisecond.
const BUDGET: PollBudget = PollBudget::for_link(12_000_000, Duration::from_millis(1));

const FLASH_LEN: usize = 2 * 1024 * 1024;
type Sectors = Flash<'static, FLASH, Blocking, FLASH_LEN>;
/// The last 64 KiB, as offsets in the flash. `memory.x` keeps the firmware out of them.
const REGION: core::ops::Range<u32> = 0x1F_0000..0x20_0000;
const _: () = assert!(Store::<Sectors>::region_len::<Mavlink>() <= REGION.end - REGION.start);

const BUFFER: usize = queue_len(BAUD, PERIOD);
/// The most bytes in a packet.
const PACKET: u16 = 64;
/// The number of bytes sent at a time: less than a packet, because after a full packet a host waits for a shorter one.
const PIECE: usize = PACKET as usize - 1;

/// Static because it is too large for the task. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);
static RECEIVED: ConstStaticCell<[u8; BUFFER]> = ConstStaticCell::new([0; BUFFER]);
static TO_SEND: ConstStaticCell<[u8; BUFFER]> = ConstStaticCell::new([0; BUFFER]);
/// The buffers of the USB: its descriptors, and control requests.
static CONFIGURATION: ConstStaticCell<[u8; 128]> = ConstStaticCell::new([0; 128]);
static OBJECT_STORE: ConstStaticCell<[u8; 32]> = ConstStaticCell::new([0; 32]);
static CONTROL: ConstStaticCell<[u8; 64]> = ConstStaticCell::new([0; 64]);
static PACKET_RECEIVED: ConstStaticCell<[u8; PACKET as usize]> = ConstStaticCell::new([0; PACKET as usize]);
static PORT: StaticCell<State<'_>> = StaticCell::new();

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let chip = embassy_rp::init(Default::default());
    let mut config = UartConfig::default();
    config.baudrate = BAUD;
    let (received, to_send) = (RECEIVED.take(), TO_SEND.take());
    let uart = BufferedUart::new(chip.UART0, chip.PIN_0, chip.PIN_1, Interrupts, to_send, received, config);
    let (tx, rx) = uart.split();

    // The ids are those of usb-device for tests; your product needs its own.
    let mut config = UsbConfig::new(0x16C0, 0x27DD);
    config.manufacturer = Some("mavstack");
    config.product = Some("Rover");
    config.serial_number = Some("1");
    let driver = usb::Driver::new(chip.USB, Interrupts);
    let mut builder = Builder::new(driver, config, CONFIGURATION.take(), OBJECT_STORE.take(), &mut [], CONTROL.take());
    let port = CdcAcmClass::new(&mut builder, PORT.init(State::new()), PACKET);
    let mut usb = builder.build();
    let (mut sender, receiver) = port.split();
    let mut receiver = receiver.into_buffered(PACKET_RECEIVED.take());

    let stack = STACK.take();
    stack.begin(Config { budget: BUDGET, ..CONFIG }, LINKS);
    let mut store = Store::new(Sectors::new_blocking(chip.FLASH), REGION);
    let mut rover = Rover::default();
    // The rover checks `stack.restore_errors()` in each pass.
    let _ = stack.restore(now(), &mut store, &mut rover);
    let shared = Shared::new(stack, rover);
    let port = async {
        loop {
            sender.wait_connection().await;
            shared.until_closed::<PIECE, _, _>(USB_PORT, (&mut receiver, &mut sender)).await;
        }
    };
    join4(shared.drive(store), shared.uart::<BUFFER, _, _>(TELEM, (rx, tx)), usb.run(), port).await;
}
