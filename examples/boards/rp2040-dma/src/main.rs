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

#[path = "../../rp2040/src/board.rs"]
mod board;
mod dma;
#[path = "../../rp2040/src/flash.rs"]
mod flash;

use board::Board;
use mavstack::storage::Store;
use mavstack::{Duration, LinkConfig, LinkId, StackOf};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use rp2040_hal::dma::DMAExt;
use static_cell::ConstStaticCell;

const BAUD: u32 = 115_200;
const TELEM: LinkId = LinkId(0);
const PERIOD_MS: u32 = 4;
const PERIOD: Duration = Duration::from_millis(PERIOD_MS as u64);
/// The longest erase of a sector of the flash.
const ERASE: Duration = Duration::from_millis(400);
const _: () = assert!(Store::<flash::Sectors>::region_len::<Mavlink>() <= flash::REGION.end - flash::REGION.start);

/// Static because it is too large for the call stack. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

#[rp2040_hal::entry]
fn main() -> ! {
    let Board { uart, mut clock, flash, dma, mut resets, .. } = Board::start(BAUD);
    let (receiver, transmitter) = uart.split();
    let channels = dma.split(&mut resets);
    let mut receiver = dma::Receiver::new(receiver, channels.ch0, channels.ch1);
    let mut transmitter = dma::Transmitter::new(transmitter, channels.ch2);

    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut store = Store::new(flash, flash::REGION);
    // The rover checks `stack.restore_errors()` in each pass.
    let _ = stack.restore(clock.now(), &mut store, &mut rover);
    loop {
        clock.begin_pass(PERIOD_MS);
        let now = clock.now();
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
        clock.sleep();
    }
}
