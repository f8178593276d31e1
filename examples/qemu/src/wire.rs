//! A log that cannot panic, for the proof that nothing else of the log can: onto UART 3, as it is, and to nobody. The
//! emulator's own, which `log.rs` has, checks what it is given and panics.
//!
//! For a firmware whose interrupts are masked, as the bare loop's are: nothing here holds off another one's line.
#![allow(unsafe_code, reason = "a register of the board, and what the trait of a log demands")]

use crate::board;

/// Where UART 3 takes a byte.
const DATA: usize = 0x4000_7000;

defmt::timestamp!("{=u32:ms}", board::now().as_millis() as u32);

#[defmt::global_logger]
struct Wire;

// SAFETY: one at a time, as there are no interrupts; and what is written is only bytes.
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
