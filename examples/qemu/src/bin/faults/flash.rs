//! Fault injection for the board's flash, snapshots of it, and words that are retained over a reset.
#![allow(unsafe_code, reason = "memory that survives a reset")]

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use mavstack_qemu::flash::PsramFlash;

/// Disables a fault.
const NEVER: u32 = u32::MAX;

/// Steps until the power cut. Writing a word is one step, an erase is three.
static FUEL: AtomicU32 = AtomicU32::new(NEVER);
/// Operations until all fail.
static GOOD_CALLS: AtomicU32 = AtomicU32::new(NEVER);
/// Whether a failed operation has half of its effect.
static HALF: AtomicU32 = AtomicU32::new(0);

/// Cuts the power after `steps` steps.
pub fn cut_after(steps: u32) {
    FUEL.store(steps, Relaxed);
}

/// Returns the steps until the power cut.
pub fn steps_left() -> u32 {
    FUEL.load(Relaxed)
}

/// Whether the power was cut.
pub fn is_power_off() -> bool {
    FUEL.load(Relaxed) == 0
}

/// Lets every write and erase fail after `calls` operations, without effect or with half of it.
pub fn fail_after(calls: u32, does_half: bool) {
    GOOD_CALLS.store(calls, Relaxed);
    HALF.store(does_half.into(), Relaxed);
}

/// Restores the power and disables all faults.
pub fn clear_faults() {
    cut_after(NEVER);
    fail_after(NEVER, false);
}

/// Whether the current operation fails.
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

/// Takes one step. Returns false when the power is off.
fn burn() -> bool {
    match FUEL.load(Relaxed) {
        NEVER => true,
        // The step during which the power is cut is not completed.
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

/// A partition of the board's flash with fault injection.
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
        if is_power_off() || fails() {
            return Err(NorFlashErrorKind::Other);
        }
        // A cut before, during or after the erase.
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
        if is_power_off() {
            return Err(NorFlashErrorKind::Other);
        }
        let whole = if fails() { if HALF.load(Relaxed) == 1 { bytes.len() / 8 * 4 } else { 0 } } else { bytes.len() };
        for (offset, word) in (offset..).step_by(Self::WRITE_SIZE).zip(bytes[..whole].chunks(Self::WRITE_SIZE)) {
            if !burn() {
                // A torn write: half of the word's bits.
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

/// Corrupts the word at `offset`, as an interrupted erase does.
fn scramble(flash: &mut PsramFlash, offset: u32) {
    let mut word = [0; 4];
    if flash.read(offset, &mut word).is_ok() {
        let _ = flash.write(offset, &word.map(|byte| byte & 0xA5));
    }
}

/// Address of the retained words, in the board's PSRAM behind the flash. A reset does not change them.
const RETAINED: usize = 0x2110_0000;
/// Address of the snapshot of the flash.
const SNAPSHOT: usize = RETAINED + 4096;
const FLASH: usize = 0x2100_0000;
/// Size of the flash, in words.
const WORDS: usize = Flash::LEN as usize / 4;

fn word(base: usize, index: usize) -> *mut u32 {
    core::ptr::with_exposed_provenance_mut::<u32>(base).wrapping_add(index)
}

/// Returns a retained word (`index` below 16); 0 after power-on.
pub fn retained(index: usize) -> u32 {
    assert!(index < 16);
    // SAFETY: PSRAM of this board, which nothing else uses.
    unsafe { word(RETAINED, index).read_volatile() }
}

/// Stores a word (`index` below 16) that is retained over a reset.
pub fn retain(index: usize, value: u32) {
    assert!(index < 16);
    // SAFETY: as for `retained`.
    unsafe { word(RETAINED, index).write_volatile(value) }
}

/// Takes a snapshot of the flash, or restores it. No store may be open meanwhile, because stores cache what they have read.
pub fn snapshot(_: &mut Flash, restores: bool) {
    let (from, to) = if restores { (SNAPSHOT, FLASH) } else { (FLASH, SNAPSHOT) };
    for index in 0..WORDS {
        // SAFETY: PSRAM of this board; the flash in it is borrowed, and nothing else uses the snapshot.
        unsafe { word(to, index).write_volatile(word(from, index).read_volatile()) }
    }
}
