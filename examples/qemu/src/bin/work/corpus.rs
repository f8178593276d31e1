//! What the fuzzer found worth keeping, as streams of bytes. The emulator puts them where the board's flash begins: each behind its
//! length, the last one behind 0xFFFF_FFFF.

use embedded_storage::nor_flash::ReadNorFlash;
use mavstack_qemu::flash::PsramFlash;

/// Bytes of all streams, one behind the other.
pub struct Corpus {
    parts: [PsramFlash; 3],
    pub at: u32,
    left: u32,
}

impl Corpus {
    pub const fn new(parts: [PsramFlash; 3]) -> Self {
        Self { parts, at: 0, left: 0 }
    }

    /// From the front again.
    pub fn rewind(&mut self) {
        (self.at, self.left) = (0, 0);
    }

    /// The next byte; `None` at the end of each stream, and from the end on.
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

    /// Whether there is no more.
    pub fn is_over(&mut self) -> bool {
        let at = self.at;
        let is_over = self.left == 0 && [0; 4].map(|_: u8| self.byte()) == [0xFF; 4];
        self.at = at;
        is_over
    }

    fn byte(&mut self) -> u8 {
        let mut byte = [0xFF];
        if let Some(part) = self.parts.get_mut((self.at / PsramFlash::LEN) as usize) {
            // Beyond the last part it is over.
            let _ = part.read(self.at % PsramFlash::LEN, &mut byte);
        }
        self.at += 1;
        byte[0]
    }
}
