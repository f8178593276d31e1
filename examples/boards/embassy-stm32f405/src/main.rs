//! A rover on an STM32F405 with Embassy. Telemetry is on USART1, PA9 (TX) and PA10 (RX), at 57,600 bit/s.
//!
//! The futures are those of `rover-embassy`.
//!
//! The mission and the parameters are stored in the last two sectors of the flash, while the rover is disarmed. An erase stops the
//! processor for 2 s typically, and 4 s at most: the driver of embassy-stm32 0.6 programs words, but erases with PSIZE 0. All received
//! bytes are lost meanwhile, because the interrupt's code is in the flash, too.
//!
//! When the receive buffer is full, `BufferedUart` of embassy-stm32 0.6 drops bytes without an error; checksums detect that.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use embassy_executor::Spawner;
use embassy_futures::join::join;
use embassy_stm32::flash::{Blocking, Flash};
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config as UartConfig};
use embassy_stm32::{bind_interrupts, peripherals};
use mavstack::io::queue_len;
use mavstack::storage::Store;
use mavstack::{LinkConfig, LinkId, StackOf};
use mavstack_rover::{CONFIG, Mavlink, Rover};
use mavstack_rover_embassy::{PERIOD, Shared, now};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::ConstStaticCell;

bind_interrupts!(struct Interrupts {
    USART1 => BufferedInterruptHandler<peripherals::USART1>;
});

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// Sectors 10 and 11, as offsets in the flash. `memory.x` keeps the firmware out of them.
const REGION: core::ops::Range<u32> = 0xC_0000..0x10_0000;
const _: () = assert!(Store::<Flash<'_, Blocking>>::region_len::<Mavlink>() <= REGION.end - REGION.start);

/// Also the most bytes that are sent at a time: the UART refuses a longer write.
const BUFFER: usize = queue_len(BAUD, PERIOD);

/// Static because it is too large for the task. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);
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
    let (tx, rx) = uart.split();

    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut store = Store::new(Flash::new_blocking(chip.FLASH), REGION);
    let mut rover = Rover::default();
    // The rover checks `stack.restore_errors()` in each pass.
    let _ = stack.restore(now(), &mut store, &mut rover);
    let shared = Shared::new(stack, rover);
    join(shared.drive(store), shared.uart::<BUFFER, _, _>(TELEM, (rx, tx))).await;
}
