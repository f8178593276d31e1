//! The board mps2-an386 in QEMU, and what the demo vehicle's firmware is made of. `cargo qemu` builds and runs it.
//!
//! The same vehicle is there three times: `bin/loop.rs` is a loop without any framework, `bin/rtic.rs` has it as tasks of
//! RTIC, `bin/embassy` as tasks of Embassy. What they have in common is here:
//!
//! | | `loop` | `rtic` | `embassy` |
//! |---|---|---|---|
//! | flight | in the loop | task above comms, every 10 ms | the same |
//! | bytes | polled in the UART | queues between UART interrupt and task | the same, and the task awaits them |
//! | the stack is called | in every pass, every ms | every ms | when a byte came, or at `next_deadline` |
//! | its calls | `poll_link` | `poll_link` | `receive`, `transmit` |
//! | the flight loop hangs | everything is silent | heartbeats stop, the rest is answered | the same |
//!
//! In all three it is the pulse that decides on heartbeats, and it is ticked by the flight loop alone: comms that lives on
//! says nothing about flight. Nothing does that hangs above it in priority without awaiting either: comms is silent then.
#![no_std]

pub mod board;
pub mod device;
pub mod flash;
#[cfg(feature = "defmt")]
mod log;
pub mod memory;
pub mod polled;
pub mod serial;

/// Without a log there is nobody to tell. A real vehicle would cut its motors here and reset.
#[cfg(not(feature = "defmt"))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
