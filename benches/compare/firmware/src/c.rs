//! Functions for the C firmware, `benches/compare/c/firmware.c`.

use core::sync::atomic::{AtomicPtr, Ordering::Relaxed};

use crate::Uart;

static UART: AtomicPtr<Uart> = AtomicPtr::new(core::ptr::null_mut());

#[unsafe(no_mangle)]
extern "C" fn compare_read(out: *mut u8, len: usize) -> usize {
    // SAFETY: `run` keeps the UART alive while C runs, and C provides `len` bytes.
    let (uart, out) = unsafe { (&mut *UART.load(Relaxed), core::slice::from_raw_parts_mut(out, len)) };
    uart.take(out)
}

#[unsafe(no_mangle)]
extern "C" fn compare_send(bytes: *const u8, len: usize) {
    // SAFETY: C provides `len` bytes.
    Uart::send(unsafe { core::slice::from_raw_parts(bytes, len) });
}

/// Runs `c` until the stream ends. Returns the number of frames.
pub fn run(mut uart: Uart, c: extern "C" fn(framing: bool) -> u32) -> u32 {
    UART.store(&raw mut uart, Relaxed);
    c(cfg!(feature = "framing"))
}
