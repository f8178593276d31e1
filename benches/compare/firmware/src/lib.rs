//! Code shared by the firmwares: a transport that delivers the stream and accepts all output, and the measurement of instructions
//! and stack usage.
//!
//! The emulator takes one nanosecond of emulated time per instruction, and SysTick ticks every 40 ns. The counts are the same on
//! every machine.
#![no_std]

use core::convert::Infallible;
use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use embedded_io::{ErrorType, Read, Write};

pub mod c;

/// Frames of the twelve messages.
static STREAM: &[u8] = include_bytes!(env!("COMPARE_STREAM"));
/// The number of frames that `streams` has written.
pub const FRAMES: u32 = 240;
/// Instructions per tick of the timer.
const INSTRUCTIONS: u32 = 40;
const LONGEST: u32 = 0x00FF_FFFF;
/// The pattern for stack painting.
const PAINT: u32 = 0xA5C3_5A3C;

/// The transport. A read returns the rest of a piece, or nothing at the end of the stream.
#[derive(Debug)]
pub struct Uart {
    rest: &'static [u8],
    piece: usize,
    left: usize,
}

/// The last byte written, so that output is not optimized away.
static SENT: AtomicU32 = AtomicU32::new(0);

impl Uart {
    const fn new(piece: usize) -> Self {
        Self { rest: STREAM, piece, left: piece }
    }

    /// Copies the rest of the current piece to `out`. Returns the number of bytes; 0 at the end.
    #[inline(never)]
    pub fn take(&mut self, out: &mut [u8]) -> usize {
        let len = out.len().min(self.left).min(self.rest.len());
        let (Some(out), Some((now, rest))) = (out.get_mut(..len), self.rest.split_at_checked(len)) else { return 0 };
        for (to, from) in out.iter_mut().zip(now) {
            // SAFETY: derived from a reference. Volatile like a UART's register, so that the location of a library's buffer does
            // not matter.
            *to = unsafe { core::ptr::from_ref(from).read_volatile() };
        }
        self.rest = rest;
        self.left = self.left.wrapping_sub(len);
        if self.left == 0 {
            self.left = self.piece;
        }
        len
    }

    /// Fills all of `out`. Returns false if the stream ends before.
    pub fn take_exact(&mut self, mut out: &mut [u8]) -> bool {
        while !out.is_empty() {
            let len = self.take(out);
            if len == 0 {
                return false;
            }
            out = out.get_mut(len..).unwrap_or_default();
        }
        true
    }

    /// Sends a frame.
    #[inline(never)]
    pub fn send(bytes: &[u8]) {
        for byte in bytes {
            SENT.store((*byte).into(), Relaxed);
        }
    }
}

impl ErrorType for Uart {
    type Error = Infallible;
}

impl Read for Uart {
    fn read(&mut self, out: &mut [u8]) -> Result<usize, Infallible> {
        Ok(self.take(out))
    }
}

/// The sending direction.
#[derive(Debug)]
pub struct Tx;

impl ErrorType for Tx {
    type Error = Infallible;
}

impl Write for Tx {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Uart::send(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Runs `app` on the stream in pieces of 64 bytes, then byte by byte. For each it prints the piece size, the instructions, the
/// result of `app`, the length of the stream, and the stack usage (bytes).
pub fn measure(app: fn(Uart) -> u32) -> ! {
    // Prevents inlining, which would add this function's stack frame to the measurement.
    let app = core::hint::black_box(app);
    // Links these functions into every firmware, so that they do not count as flash of a library.
    core::hint::black_box(memcpy as unsafe extern "C" fn(_, _, _) -> _);
    core::hint::black_box(memset as unsafe extern "C" fn(_, _, _) -> _);
    core::hint::black_box(__aeabi_memclr as unsafe extern "C" fn(_, _));
    core::hint::black_box(__aeabi_memclr4 as unsafe extern "C" fn(_, _));
    if let Some(mut peripherals) = cortex_m::Peripherals::take() {
        let timer = &mut peripherals.SYST;
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(LONGEST);
        timer.clear_current();
        timer.enable_counter();
    }
    console::begin();
    for piece in [64, 1] {
        let top = stack::paint();
        let before = SYST::get_current();
        let result = app(Uart::new(piece));
        let ticks = before.wrapping_sub(SYST::get_current()) & LONGEST;
        let stack = stack::used(top);
        for number in [piece as u32, ticks * INSTRUCTIONS, result, STREAM.len() as u32, stack] {
            console::number(number);
        }
        console::put(b'\n');
    }
    console::put(b'.');
    console::put(b'\n');
    loop {
        cortex_m::asm::wfi();
    }
}

unsafe extern "C" {
    fn memcpy(to: *mut u8, from: *const u8, len: usize) -> *mut u8;
    fn memset(to: *mut u8, byte: i32, len: usize) -> *mut u8;
    // The compiler calls these instead of memset when the byte is 0.
    fn __aeabi_memclr(to: *mut u8, len: usize);
    fn __aeabi_memclr4(to: *mut u8, len: usize);
}

mod stack {
    use super::PAINT;

    unsafe extern "C" {
        /// End of static memory.
        static mut __sheap: u32;
    }

    fn bottom() -> *mut u32 {
        &raw mut __sheap
    }

    /// Paints the memory below the stack pointer. Returns the stack pointer.
    #[inline(never)]
    pub fn paint() -> *mut u32 {
        let top = cortex_m::register::msp::read() as *mut u32;
        let mut at = bottom();
        // Leaves room for the frame of this function.
        while at < top.wrapping_sub(16) {
            // SAFETY: unused memory between the statics and the stack pointer.
            unsafe { at.write_volatile(PAINT) };
            at = at.wrapping_add(1);
        }
        top
    }

    /// Returns the high-water mark of the stack since `paint`, in bytes.
    pub fn used(top: *mut u32) -> u32 {
        let mut at = bottom();
        // SAFETY: as for `paint`.
        while at < top && unsafe { at.read_volatile() } == PAINT {
            at = at.wrapping_add(1);
        }
        (top as u32).wrapping_sub(at as u32)
    }
}

/// The board's first UART, which is the emulator's standard output.
mod console {
    const BASE: usize = 0x4000_4000;

    fn register(offset: usize) -> *mut u32 {
        core::ptr::with_exposed_provenance_mut(BASE + offset)
    }

    pub fn begin() {
        // SAFETY: registers of the UART: divisor and control.
        unsafe {
            register(16).write_volatile(16);
            register(8).write_volatile(1);
        }
    }

    pub fn put(byte: u8) {
        // SAFETY: registers of the UART: state and data.
        unsafe {
            while register(4).read_volatile() & 1 != 0 {}
            register(0).write_volatile(byte.into());
        }
    }

    pub fn number(mut number: u32) {
        let mut digits = [b'0'; 10];
        let mut first = digits.len();
        while first > 0 && (number > 0 || first == digits.len()) {
            first -= 1;
            digits[first] += (number % 10) as u8;
            number /= 10;
        }
        digits[first..].iter().for_each(|digit| put(*digit));
        put(b' ');
    }
}

/// Prints "!" and halts.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    console::put(b'!');
    console::put(b'\n');
    loop {
        cortex_m::asm::wfi();
    }
}
