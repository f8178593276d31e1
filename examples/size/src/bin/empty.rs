//! Only the UART loop: the baseline that is subtracted from the other firmwares.
#![no_std]
#![no_main]

use core::hint::black_box;

use embedded_io::{Read, ReadReady, Write};
use mavstack_size::{Uart, entry, now_micros};

#[entry]
fn main() -> ! {
    let mut uart = Uart;
    let mut bytes = [0; 64];
    loop {
        if uart.read_ready() == Ok(true) {
            let len = uart.read(&mut bytes).unwrap_or(0);
            let _ = uart.write(bytes.get(..len).unwrap_or_default());
        }
        black_box(now_micros());
    }
}
