//! What the C library's firmware calls: it is in `benches/compare/c/firmware.c`.

use core::sync::atomic::{AtomicPtr, Ordering::Relaxed};

use crate::Uart;

static UART: AtomicPtr<Uart> = AtomicPtr::new(core::ptr::null_mut());

#[unsafe(no_mangle)]
extern "C" fn compare_read(out: *mut u8, len: usize) -> usize {
    // SAFETY: `run` keeps the line while C runs, and C has so many bytes there.
    let (uart, out) = unsafe { (&mut *UART.load(Relaxed), core::slice::from_raw_parts_mut(out, len)) };
    uart.take(out)
}

#[unsafe(no_mangle)]
extern "C" fn compare_send(bytes: *const u8, len: usize) {
    // SAFETY: C has so many bytes there.
    Uart::send(unsafe { core::slice::from_raw_parts(bytes, len) });
}

/// Lets `c` read the line until nothing comes; returns how many frames that was.
pub fn run(mut uart: Uart, c: extern "C" fn(framing: bool) -> u32) -> u32 {
    UART.store(&raw mut uart, Relaxed);
    c(cfg!(feature = "framing"))
}
