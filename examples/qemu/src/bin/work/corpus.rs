//! The fuzz corpus as byte streams. The emulator loads it at the start of the board's flash: each stream follows its length, and
//! 0xFFFF_FFFF marks the end.

use embedded_storage::nor_flash::ReadNorFlash;
use mavstack_qemu::flash::PsramFlash;

/// An iterator over the bytes of all streams.
pub struct Corpus {
    flash: PsramFlash,
    pub at: u32,
    left: u32,
}

impl Corpus {
    pub const fn new(flash: PsramFlash) -> Self {
        Self { flash, at: 0, left: 0 }
    }

    /// Restarts at the first stream.
    pub fn rewind(&mut self) {
        (self.at, self.left) = (0, 0);
    }

    /// Returns the next byte; `None` at the end of each stream and of the corpus.
    pub fn next(&mut self) -> Option<u8> {
        if self.left == 0 {
            let len = u32::from_le_bytes([0; 4].map(|_: u8| self.byte()));
            if len == u32::MAX {
                self.at -= 4;
                return None;
            }
            self.left = len + 1;
        }
        self.left -= 1;
        if self.left == 0 { None } else { Some(self.byte()) }
    }

    /// Whether the corpus has ended.
    pub fn is_at_end(&mut self) -> bool {
        let at = self.at;
        let is_at_end = self.left == 0 && [0; 4].map(|_: u8| self.byte()) == [0xFF; 4];
        self.at = at;
        is_at_end
    }

    fn byte(&mut self) -> u8 {
        let mut byte = [0xFF];
        // An error leaves 0xFF, which marks the end.
        let _ = self.flash.read(self.at, &mut byte);
        self.at += 1;
        byte[0]
    }
}
