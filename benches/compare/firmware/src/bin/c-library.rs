//! The C library of mavgen: what it does is in `benches/compare/c/firmware.c`.
#![no_std]
#![no_main]

use core::sync::atomic::{AtomicPtr, Ordering::Relaxed};

use mavstack_compare_firmware::{Uart, measure};

unsafe extern "C" {
    /// Reads until nothing comes; returns how many frames that was.
    safe fn compare_run(framing: bool) -> u32;
}

static UART: AtomicPtr<Uart> = AtomicPtr::new(core::ptr::null_mut());

#[unsafe(no_mangle)]
extern "C" fn compare_read(out: *mut u8, len: usize) -> usize {
    // SAFETY: `app` keeps the line while C runs, and C has so many bytes there.
    let (uart, out) = unsafe { (&mut *UART.load(Relaxed), core::slice::from_raw_parts_mut(out, len)) };
    uart.take(out)
}

#[unsafe(no_mangle)]
extern "C" fn compare_send(bytes: *const u8, len: usize) {
    // SAFETY: C has so many bytes there.
    Uart::send(unsafe { core::slice::from_raw_parts(bytes, len) });
}

fn app(mut uart: Uart) -> u32 {
    UART.store(&raw mut uart, Relaxed);
    compare_run(cfg!(feature = "framing"))
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
