//! The last two sectors of the flash, for the mission and the parameters. `memory.x` keeps the firmware out of them.

mod driver;

use driver::{Driver, Hardware, Register};
use stm32f4xx_hal::pac::FLASH;

pub use driver::REGION;

/// The sectors of [`REGION`].
pub type Sectors = Driver<FLASH>;

/// Where the flash is in memory.
const BASE: u32 = 0x0800_0000;

// `memory.x` compares the start of `REGION` with the end of the firmware.
#[allow(unsafe_code, reason = "a symbol for the linker")]
mod symbol {
    core::arch::global_asm!(".global storage_start", ".set storage_start, {}", const super::BASE + super::REGION.start);
}

#[allow(unsafe_code, reason = "registers by their number, and memory that the linker does not know")]
impl Hardware for FLASH {
    fn read(&mut self, register: Register) -> u32 {
        // SAFETY: the registers can be read, and the reference to the peripheral is exclusive.
        unsafe { FLASH::ptr().cast::<u32>().byte_add(register as usize).read_volatile() }
    }

    fn write(&mut self, register: Register, value: u32) {
        // SAFETY: as above. The driver writes only what erases or programs the region, in which there is no code.
        unsafe { FLASH::ptr().cast::<u32>().cast_mut().byte_add(register as usize).write_volatile(value) }
    }

    fn load(&mut self, offset: u32) -> u8 {
        // SAFETY: the address is in the region, which is readable and not part of the firmware.
        unsafe { ((BASE + offset) as *const u8).read_volatile() }
    }

    fn store(&mut self, offset: u32, byte: u8) {
        // SAFETY: as above.
        unsafe { ((BASE + offset) as *mut u8).write_volatile(byte) }
        // The byte reaches the flash before the status is read, which is on another bus.
        cortex_m::asm::dsb();
    }
}
