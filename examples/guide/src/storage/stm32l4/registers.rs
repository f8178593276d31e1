//! The registers of an STM32L4 or G4 and its Cortex-M4.
#![allow(unsafe_code, reason = "registers")]

use core::arch::asm;
use core::ptr::with_exposed_provenance_mut as register;

const FLASH_ECCR: usize = 0x4002_2018;
/// A bit that is written as 1 is cleared.
const ECCD: u32 = 1 << 31;

/// Clears the error. Returns whether there was one.
pub fn clear_eccd() -> bool {
    let eccr = register::<u32>(FLASH_ECCR);
    // SAFETY: only the handler of the NMI, which nothing interrupts, accesses this register.
    unsafe {
        let value = eccr.read_volatile();
        eccr.write_volatile(value);
        value & ECCD != 0
    }
}

pub fn barrier() {
    // SAFETY: barriers have no other effect.
    unsafe { asm!("dsb", "isb") }
}
