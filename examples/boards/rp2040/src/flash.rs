//! The last 64 KiB of the Pico's flash, for the mission and the parameters. `memory.x` keeps the firmware out of them.
//!
//! `rp2040-hal` has no flash driver, but the boot ROM has the functions. No code can run from flash meanwhile, so the code that calls
//! them is in RAM, with interrupts masked. Nothing else may read the flash meanwhile: neither the second core, nor a DMA channel whose
//! source is a constant, nor the XIP stream. The firmwares that use this driver have none of them. The driver does not wait for them.

use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use rp2040_hal::pac::XIP_SSI;
use rp2040_hal::rom_data;

/// The region, as offsets in the flash.
pub const REGION: Range<u32> = 0x1F_0000..0x20_0000;

// `memory.x` compares it with the end of the firmware.
#[allow(unsafe_code, reason = "a symbol for the linker")]
mod symbol {
    core::arch::global_asm!(".global storage_start", ".set storage_start, {}", const super::BASE + super::REGION.start);
}

/// The address at which the flash is mapped for reading.
const BASE: u32 = 0x1000_0000;
const PAGE: usize = 256;
const SECTOR: usize = 4096;
/// The second stage of the boot loader, at the start of the flash. It sets up execution from flash.
const BOOT2_WORDS: usize = 64;

/// The flash. Erasing a sector stops the processor for 45 ms typically, writing a page for 0.4 ms.
pub struct Sectors {
    _controller: XIP_SSI,
}

impl Sectors {
    /// Takes the controller. The ROM's functions use it.
    pub fn new(controller: XIP_SSI) -> Self {
        Self { _controller: controller }
    }
}

/// Returns whether the driver may access this range: only the region.
fn check(from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
    if REGION.start <= from && from <= to && to <= REGION.end { Ok(()) } else { Err(NorFlashErrorKind::OutOfBounds) }
}

/// An operation that runs while the flash is not mapped.
enum Operation<'a> {
    Erase,
    Program(&'a [u8; PAGE]),
}

/// The functions of the boot ROM, which are looked up while the flash is mapped.
struct Functions {
    connect: unsafe extern "C" fn(),
    leave_mapping: unsafe extern "C" fn(),
    erase: unsafe extern "C" fn(u32, usize, u32, u8),
    program: unsafe extern "C" fn(u32, *const u8, usize),
    flush_cache: unsafe extern "C" fn(),
}

/// Erases the sector or programs the page at this offset.
fn run(offset: u32, operation: &Operation<'_>) {
    let functions = Functions {
        connect: rom_data::connect_internal_flash::ptr(),
        leave_mapping: rom_data::flash_exit_xip::ptr(),
        erase: rom_data::flash_range_erase::ptr(),
        program: rom_data::flash_range_program::ptr(),
        flush_cache: rom_data::flash_flush_cache::ptr(),
    };
    // SAFETY: the flash begins with the second stage, which is position-independent and returns to its caller.
    #[allow(unsafe_code, reason = "memory that the linker does not know")]
    let boot2 = unsafe { (BASE as *const [u32; BOOT2_WORDS]).read_volatile() };
    critical_section::with(|_| {
        // SAFETY: the offset is in the region, interrupts are masked, and the second core does not run.
        #[allow(unsafe_code, reason = "the flash cannot be read meanwhile")]
        unsafe {
            run_in_ram(&functions, &boot2, offset, operation);
        }
    });
}

/// Calls only the ROM and the copy of the second stage. The functions in `functions` are pointers, so nothing is inlined from flash.
#[allow(unsafe_code, reason = "a section that the start-up code copies to RAM")]
#[unsafe(link_section = ".data.run_in_ram")]
#[inline(never)]
unsafe fn run_in_ram(functions: &Functions, boot2: &[u32; BOOT2_WORDS], offset: u32, operation: &Operation<'_>) {
    // SAFETY: the caller promises what these functions need. Bit 0 of the address says that the code is Thumb code.
    unsafe {
        let map_again: unsafe extern "C" fn() = core::mem::transmute(boot2.as_ptr().byte_add(1));
        (functions.connect)();
        (functions.leave_mapping)();
        match *operation {
            // No block is as large as this, so each sector is erased by the command for sectors.
            Operation::Erase => (functions.erase)(offset, SECTOR, 1 << 31, 0),
            Operation::Program(page) => (functions.program)(offset, page.as_ptr(), PAGE),
        }
        (functions.flush_cache)();
        map_again();
    }
}

impl ErrorType for Sectors {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Sectors {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check(offset, offset + bytes.len() as u32)?;
        for (address, byte) in (BASE + offset..).zip(bytes) {
            // SAFETY: the address is in the region, which is readable and not part of the firmware.
            #[allow(unsafe_code, reason = "memory that the linker does not know")]
            unsafe {
                *byte = (address as *const u8).read_volatile();
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        REGION.end as usize
    }
}

impl NorFlash for Sectors {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check(from, to)?;
        if !from.is_multiple_of(SECTOR as u32) || !to.is_multiple_of(SECTOR as u32) {
            return Err(NorFlashErrorKind::NotAligned);
        }
        for sector in (from..to).step_by(SECTOR) {
            run(sector, &Operation::Erase);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check(offset, offset + bytes.len() as u32)?;
        let (mut offset, mut left) = (offset as usize, bytes);
        while !left.is_empty() {
            let begin = offset % PAGE;
            let (now, later) = left.split_at(left.len().min(PAGE - begin));
            // The ROM writes whole pages. Bytes of 0xFF change nothing.
            let mut page = [0xFF; PAGE];
            page[begin..begin + now.len()].copy_from_slice(now);
            run((offset - begin) as u32, &Operation::Program(&page));
            (offset, left) = (offset + now.len(), later);
        }
        Ok(())
    }
}
