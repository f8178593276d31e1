//! The C library of mavgen: what it does is in `benches/compare/c/firmware.c`.
#![no_std]
#![no_main]

use mavstack_compare_firmware::{Uart, c, measure};

unsafe extern "C" {
    safe fn compare_run(framing: bool) -> u32;
}

fn app(uart: Uart) -> u32 {
    c::run(uart, compare_run)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
