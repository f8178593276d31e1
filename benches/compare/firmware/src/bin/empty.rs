//! Only the transport: the baseline that is subtracted from the other firmwares. Returns the number of frames.
#![no_std]
#![no_main]

use mavstack_compare_firmware::{FRAMES, Uart, measure};

fn app(mut uart: Uart) -> u32 {
    let mut bytes = [0; 64];
    while uart.take(&mut bytes) > 0 {}
    Uart::send(&[]);
    FRAMES
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
