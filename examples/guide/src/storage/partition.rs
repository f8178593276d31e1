//! One flash with several users.

use core::cell::RefCell;

use embedded_storage::nor_flash::NorFlash;
use mavstack::storage::{Partition, Store};

fn divide(flash: impl NorFlash) {
    let flash = RefCell::new(flash);
    let mut blackbox = Partition::new::<0x10_0000, 0x1F_0000>(&flash);
    let store = Store::new(Partition::new::<0x1F_0000, 0x20_0000>(&flash), 0..0x1_0000);
    let _ = (blackbox.erase(0, 4_096), store);
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_flash_is_divided() {
        super::divide(super::super::Flash);
    }
}
