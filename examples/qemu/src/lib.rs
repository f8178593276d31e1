//! The demo vehicle's firmware for the board mps2-an386 in QEMU. `cargo qemu` builds and runs it.
//!
//! The same vehicle exists in three firmwares: as a plain loop (`bin/loop.rs`), as RTIC tasks (`bin/rtic.rs`) and as Embassy
//! tasks (`bin/embassy`). `.ci/integration/test_frameworks.py` tests each with a ground station.
//!
//! | | `loop` | `rtic` | `embassy` |
//! |---|---|---|---|
//! | flight runs | in the loop | every 10 ms, at a higher priority than comms | every 10 ms, at a higher priority than comms |
//! | bytes are buffered | in the UART | in queues served by interrupts | in queues served by interrupts |
//! | comms runs | in the loop, every ms or on a byte | every ms | on a byte, on new output, or at `next_deadline` |
//! | comms calls | `poll_link` | `poll_link` | `receive` and `transmit` |
//! | storage runs | in the loop, which waits | in a task of the lowest priority | in a task of the lowest priority |
//! | when flight hangs | silence | heartbeats stop, the rest continues | heartbeats stop, the rest continues |
//!
//! `ethernet` and `ethernet-embassy` are the first and the third with a network: telemetry over UDP, on the board's Ethernet.
//!
//! Heartbeats depend on the pulse, and only flight ticks it. They stop when flight hangs, even if comms still runs.
#![no_std]

pub mod board;
pub mod device;
pub mod flash;
#[cfg(feature = "faults")]
pub mod jitter;
#[cfg(feature = "network")]
pub mod lan9118;
pub mod line;
#[cfg(all(feature = "defmt", not(feature = "panic-never")))]
mod log;
pub mod memory;
#[cfg(feature = "network")]
pub mod network;
pub mod polled;
#[cfg(all(feature = "faults", not(any(feature = "defmt", feature = "panic-never"))))]
mod report;
pub mod serial;
#[cfg(feature = "faults")]
pub mod tasks;
#[cfg(all(feature = "defmt", feature = "panic-never"))]
mod wire;

#[cfg(feature = "panic-never")]
use panic_never as _;

/// Without a log the panic cannot be reported. A real vehicle would stop its motors here and reset.
#[cfg(not(any(feature = "defmt", feature = "faults", feature = "panic-never")))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
