//! The board's flash, as bad as is wanted; copies of it; and what the scenarios themselves remember over a reset.
#![allow(unsafe_code, reason = "memory that outlives a reset, and vehicles that are copied into it")]

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use mavstack_qemu::flash::PsramFlash;
use mavstack_qemu::memory::DemoApp;

/// No cut, no fault.
const NEVER: u32 = u32::MAX;

/// Steps until the power goes: a word that is written is one, an erase three.
static FUEL: AtomicU32 = AtomicU32::new(NEVER);
/// Calls of the flash until all fail.
static GOOD_CALLS: AtomicU32 = AtomicU32::new(NEVER);
/// A call that fails has done half of its work.
static HALF: AtomicU32 = AtomicU32::new(0);

/// The power goes after so many steps.
pub fn cut_after(steps: u32) {
    FUEL.store(steps, Relaxed);
}

/// Whether the power has gone.
pub fn is_off() -> bool {
    FUEL.load(Relaxed) == 0
}

/// Each write and erase behind so many fails, and does nothing or half of it.
pub fn fail_after(calls: u32, does_half: bool) {
    GOOD_CALLS.store(calls, Relaxed);
    HALF.store(does_half.into(), Relaxed);
}

/// Power, and nothing fails.
pub fn heal() {
    cut_after(NEVER);
    fail_after(NEVER, false);
}

/// Whether a call fails now.
fn fails() -> bool {
    match GOOD_CALLS.load(Relaxed) {
        NEVER => false,
        0 => true,
        left => {
            GOOD_CALLS.store(left - 1, Relaxed);
            false
        }
    }
}

/// One step; false when there is no power for it.
fn burn() -> bool {
    match FUEL.load(Relaxed) {
        NEVER => true,
        // The step that it goes in is not done.
        0 | 1 => {
            FUEL.store(0, Relaxed);
            false
        }
        left => {
            FUEL.store(left - 1, Relaxed);
            true
        }
    }
}

/// A part of the board's flash, which fails and loses power when it is told to.
pub struct Flash(pub PsramFlash);

impl Flash {
    pub const LEN: u32 = PsramFlash::LEN;
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = PsramFlash::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = PsramFlash::WRITE_SIZE;
    const ERASE_SIZE: usize = PsramFlash::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        if is_off() || fails() {
            return Err(NorFlashErrorKind::Other);
        }
        // Before it, in the middle, behind it.
        if !burn() {
            return Err(NorFlashErrorKind::Other);
        }
        if !burn() {
            for offset in (from..to).step_by(2 * Self::WRITE_SIZE) {
                scramble(&mut self.0, offset);
            }
            return Err(NorFlashErrorKind::Other);
        }
        self.0.erase(from, to)?;
        if burn() { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        if is_off() {
            return Err(NorFlashErrorKind::Other);
        }
        let whole = if fails() { if HALF.load(Relaxed) == 1 { bytes.len() / 8 * 4 } else { 0 } } else { bytes.len() };
        for (offset, word) in (offset..).step_by(Self::WRITE_SIZE).zip(bytes[..whole].chunks(Self::WRITE_SIZE)) {
            if !burn() {
                // Half of the word's bits are in it.
                let mut torn = [0xFF; Self::WRITE_SIZE];
                torn.iter_mut().zip(word).for_each(|(torn, byte)| *torn = byte | 0x5A);
                self.0.write(offset, &torn)?;
                return Err(NorFlashErrorKind::Other);
            }
            self.0.write(offset, word)?;
        }
        if whole == bytes.len() { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }
}

/// The word at `offset` was to be erased, and makes no sense any more.
fn scramble(flash: &mut PsramFlash, offset: u32) {
    let mut word = [0; 4];
    if flash.read(offset, &mut word).is_ok() {
        let _ = flash.write(offset, &word.map(|byte| byte & 0xA5));
    }
}

/// What is kept in the board's PSRAM behind its flash, which a reset leaves alone, in words.
const KEPT: usize = 0x2110_0000;
/// Room for a copy of all flash behind it.
const COPY: usize = KEPT + 4096;
const FLASH: usize = 0x2100_0000;
/// So many of them.
const WORDS: usize = 3 * Flash::LEN as usize / 4;

/// Room for a new vehicle behind that.
const NEW: usize = COPY + 4 * WORDS;

fn new() -> *mut DemoApp {
    core::ptr::with_exposed_provenance_mut(NEW)
}

/// Keeps a copy of `app`, which is new.
pub fn keep_new(app: &DemoApp) {
    // SAFETY: PSRAM of this board, which nothing else uses. The copy is never dropped.
    unsafe { new().copy_from_nonoverlapping(app, 1) }
}

/// Makes `app` new. To make it anew takes 30 kB of stack, where the compiler is not sure that it may be made in its place.
pub fn renew(app: &mut DemoApp) {
    // SAFETY: `keep_new` was called at the start; what was there is not dropped, which would only wipe a key.
    unsafe { core::ptr::from_mut(app).copy_from_nonoverlapping(new(), 1) }
}

fn word(base: usize, index: usize) -> *mut u32 {
    core::ptr::with_exposed_provenance_mut::<u32>(base).wrapping_add(index)
}

/// What was kept at `index`, which is below 16; 0 after power-on.
pub fn kept(index: usize) -> u32 {
    assert!(index < 16);
    // SAFETY: PSRAM of this board, which nothing else uses.
    unsafe { word(KEPT, index).read_volatile() }
}

/// Keeps `value` over a reset.
pub fn keep(index: usize, value: u32) {
    assert!(index < 16);
    // SAFETY: as for `kept`.
    unsafe { word(KEPT, index).write_volatile(value) }
}

/// Copies all flash, or brings the copy back. Nobody has a store open meanwhile, which would remember what it has read.
pub fn copy(_: &mut [Flash; 3], brings_back: bool) {
    let (from, to) = if brings_back { (COPY, FLASH) } else { (FLASH, COPY) };
    for index in 0..WORDS {
        // SAFETY: PSRAM of this board; the flash in it is borrowed, and nothing else uses the copy.
        unsafe { word(to, index).write_volatile(word(from, index).read_volatile()) }
    }
}
