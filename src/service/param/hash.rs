//! `_HASH_CHECK`: a checksum of all parameters, for a ground station that has their values from last time (P-20).
//!
//! CRC-32 from zero and without a final complement, over the name of each parameter that is not volatile and the bytes of
//! its value, as many as its type has: that is what QGroundControl makes of its cache. A few parameters at a time, because a
//! whole table would be too much for one poll.

use super::table::TableMut;
use super::value;
use crate::crc32::Crc32;

/// Parameters that one step looks at.
const STEP: usize = 4;

/// The checksum, and how far it is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hash {
    crc: Crc32,
    /// Parameters that are in it.
    done: u16,
}

impl Hash {
    pub(super) const fn new() -> Self {
        Self { crc: Crc32::ZERO, done: 0 }
    }

    /// A step towards the hash of the table, and the hash when it was the last one; the next step begins anew. A value that changes between two steps is in it as it
    /// is when its turn comes: whoever asks is told of the change in any case (P-16).
    pub(super) fn step(&mut self, table: &TableMut<'_>) -> Option<u32> {
        if self.done >= table.count() {
            *self = Self::new();
        }
        for _ in 0..STEP {
            let Some((info, bits)) = table.get(self.done) else { break };
            self.done = self.done.saturating_add(1);
            if !info.is_volatile() {
                let size = value::size(info.param_type());
                self.crc.add(info.name_bytes());
                self.crc.add(bits.to_le_bytes().get(..size).unwrap_or_default());
            }
        }
        (self.done >= table.count()).then_some(!self.crc.sum())
    }
}
