//! A logger without panics, for the proof that logging itself cannot panic. It writes raw bytes to UART 3, which is not
//! connected. The semihosting logger in `log.rs` checks its calls and can panic.
//!
//! Use it only with masked interrupts, as in the plain loop: it has no critical section.
#![allow(unsafe_code, reason = "a register of the board, and the unsafe trait `Logger`")]

use crate::board;

/// Data register of UART 3.
const DATA: usize = 0x4000_7000;

defmt::timestamp!("{=u32:ms}", board::now().as_millis() as u32);

#[defmt::global_logger]
struct Wire;

// SAFETY: interrupts are masked, so calls do not overlap; the bytes are written unchanged.
unsafe impl defmt::Logger for Wire {
    fn acquire() {}

    unsafe fn flush() {}

    unsafe fn release() {}

    unsafe fn write(bytes: &[u8]) {
        for byte in bytes {
            // SAFETY: a register of this board, which nothing else uses.
            unsafe { core::ptr::with_exposed_provenance_mut::<u32>(DATA).write_volatile((*byte).into()) };
        }
    }
}
