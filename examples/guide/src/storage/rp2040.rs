//! The flash of an RP2040, by embassy-rp.

use embedded_storage::nor_flash::NorFlash;
use mavstack::storage::Store;

/// The last 64 KiB of a Pico's flash. Its `memory.x` ends `FLASH` before.
fn store<F: NorFlash>(flash: F) -> Store<F> {
    Store::new(flash, 0x1F_0000..0x20_0000)
}
