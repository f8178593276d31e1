//! The board mps2-an386 in QEMU, and what the demo vehicle's firmware is made of. `cargo qemu` builds and runs it.
//!
//! The same vehicle is there three times: in a loop of its own (`bin/loop.rs`), as tasks of RTIC (`bin/rtic.rs`) and as tasks of
//! Embassy (`bin/embassy`). `.ci/integration/test_frameworks.py` holds all of them against a ground station.
//!
//! | | `loop` | `rtic` | `embassy` |
//! |---|---|---|---|
//! | flight runs | in the loop | above comms, every 10 ms | above comms, every 10 ms |
//! | bytes wait | in the UART | in queues that interrupts serve | in queues that interrupts serve |
//! | comms runs | in the loop, every ms or at a byte | every ms | at a byte, news or `next_deadline` |
//! | it calls | `poll_link` | `poll_link` | `receive` and `transmit` |
//! | flight hangs | silence | no heartbeats, all else goes on | no heartbeats, all else goes on |
//!
//! It is the pulse that heartbeats depend on, and flight alone ticks it: that comms goes on says nothing about flight.
#![no_std]

pub mod board;
pub mod device;
pub mod flash;
pub mod line;
#[cfg(all(feature = "defmt", not(feature = "panic-never")))]
mod log;
pub mod memory;
pub mod polled;
#[cfg(all(feature = "faults", not(any(feature = "defmt", feature = "panic-never"))))]
mod report;
pub mod serial;
#[cfg(all(feature = "defmt", feature = "panic-never"))]
mod wire;

#[cfg(feature = "panic-never")]
use panic_never as _;

/// Without a log there is nobody to tell. A real vehicle would cut its motors here and reset.
#[cfg(not(any(feature = "defmt", feature = "faults", feature = "panic-never")))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
