//! The registers of an STM32H743 and its Cortex-M7.
#![allow(unsafe_code, reason = "registers")]

use core::arch::asm;
use core::ptr::with_exposed_provenance_mut as register;
use core::sync::atomic::{Ordering, compiler_fence};

const FLASH_SR2: usize = 0x5200_2110;
const FLASH_CCR2: usize = 0x5200_2114;
/// FLASH_SR2 shows a double error in this bit, and FLASH_CCR2 clears it.
const DBECCERR: u32 = 1 << 26;
const SCB_CCR: usize = 0xE000_ED14;
const BFHFNMIGN: u32 = 1 << 8;
/// One byte of SCB_CFSR. A bit that is written as 1 is cleared.
const SCB_BFSR: usize = 0xE000_ED29;

pub fn clear_ecc_error() {
    // SAFETY: writing this register affects flags of the second bank only.
    unsafe { register::<u32>(FLASH_CCR2).write_volatile(DBECCERR) }
}

pub fn has_ecc_error() -> bool {
    // SAFETY: reading this register has no effect.
    unsafe { register::<u32>(FLASH_SR2).read_volatile() & DBECCERR != 0 }
}

/// Runs `call` at priority -1, at which data bus faults are ignored. No interrupt runs meanwhile.
pub fn ignoring_bus_faults<T>(call: impl FnOnce() -> T) -> T {
    let ccr = register::<u32>(SCB_CCR);
    // SAFETY: no handler runs while FAULTMASK is set, and everything is as before at the end. `call` only reads the flash.
    unsafe {
        asm!("cpsid f", "dsb", "isb");
        ccr.write_volatile(ccr.read_volatile() | BFHFNMIGN);
        asm!("dsb", "isb");
        compiler_fence(Ordering::SeqCst);
        let result = call();
        compiler_fence(Ordering::SeqCst);
        asm!("dsb", "isb");
        register::<u8>(SCB_BFSR).write_volatile(0xFF);
        ccr.write_volatile(ccr.read_volatile() & !BFHFNMIGN);
        asm!("dsb", "isb", "cpsie f");
        result
    }
}
