//! The same with a table of the twelve messages, and nothing to sign with.
#![no_std]
#![no_main]

use mavstack_compare_firmware::{Uart, c, measure};

unsafe extern "C" {
    safe fn compare_run_lean(framing: bool) -> u32;
}

fn app(uart: Uart) -> u32 {
    c::run(uart, compare_run_lean)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
