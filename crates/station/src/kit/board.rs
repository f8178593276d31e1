//! What a reset leaves: the flash.

use std::cell::{Cell, RefCell};

use mavstack::Duration;

use super::flash::{FlashChip, RamFlash};

/// The board on which the firmware boots. It keeps what a reset keeps.
#[derive(Debug, Default)]
pub struct Board {
    chips: RefCell<Vec<FlashChip>>,
    /// The chips that the firmware has taken since it booted.
    taken: Cell<usize>,
    boots: Cell<u32>,
}

impl Board {
    /// Returns a driver of the board's flash of `len` bytes, with write units of `WRITE` bytes and erase units of `ERASE`. It is erased at
    /// the first boot. A second call in the same boot returns a second chip, and so on.
    ///
    /// # Panics
    ///
    /// An earlier boot has asked for another length.
    pub fn flash<const WRITE: usize, const ERASE: usize>(&self, len: u32) -> RamFlash<WRITE, ERASE> {
        let index = self.taken.replace(self.taken.get() + 1);
        let mut chips = self.chips.borrow_mut();
        if index == chips.len() {
            chips.push(FlashChip::new(len));
        }
        let chip = &chips[index];
        assert_eq!(chip.bytes().len(), len as usize, "the flash had another length at an earlier boot");
        chip.driver()
    }

    /// Returns the number of boots before this one.
    pub fn boots(&self) -> u32 {
        self.boots.get()
    }

    /// Returns a chip, by the order in which the firmware takes them at boot.
    pub(super) fn chip(&self, index: usize) -> Option<FlashChip> {
        self.chips.borrow().get(index).cloned()
    }

    /// Prepares the next boot, with power.
    pub(super) fn reset(&self) {
        self.taken.set(0);
        self.boots.set(self.boots.get() + 1);
        self.chips.borrow().iter().for_each(FlashChip::power_on);
    }

    /// Whether a power cut ordered by [`FlashChip::cut_power_after`] has happened.
    pub(super) fn is_off(&self) -> bool {
        self.chips.borrow().iter().any(FlashChip::is_off)
    }

    /// Takes the time that the chips have kept the processor.
    pub(super) fn take_busy(&self) -> Duration {
        self.chips.borrow().iter().fold(Duration::ZERO, |busy, chip| busy + chip.take_busy())
    }
}
