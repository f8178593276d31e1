//! `_HASH_CHECK`: a checksum of all parameters, for a ground station that has cached their values (P-20).
//!
//! A CRC-32 with initial value 0 and without the final complement, over the name and the value of each parameter that is not
//! volatile; a value has as many bytes as its type. QGroundControl computes the same from its cache. A step handles a few
//! parameters, because a whole table would take too long for one poll.

use core::borrow::Borrow;
use core::num::Saturating;

use super::info::{ParamInfo, Rows};
use super::value;
use crate::crc32::Crc32;

/// Number of parameters in a step.
const STEP: u16 = 4;

/// The checksum and its progress.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hash {
    crc: Crc32,
    /// Number of parameters included.
    done: Saturating<u16>,
}

impl Hash {
    pub(super) const NEW: Self = Self { crc: Crc32::ZERO, done: Saturating(0) };

    /// Whether only the last step is left.
    pub(super) fn is_ready<R: Rows>(&self, rows: &R) -> bool {
        self.done + Saturating(STEP) >= Saturating(rows.count())
    }

    /// Adds the next parameters. A value that changes between two steps is included as it is in its step; the change itself is sent to
    /// the client anyway (P-16).
    pub(super) fn step<R: Rows>(&mut self, rows: &R) {
        for _ in 0..STEP {
            let Some((info, bits)) = rows.get(self.done.0) else { break };
            let info: &ParamInfo = info.borrow();
            self.done += 1;
            if !info.is_volatile() {
                let size = value::size(info.param_type());
                self.crc.add(info.name_bytes());
                self.crc.add(bits.to_le_bytes().get(..size).unwrap_or_default());
            }
        }
    }

    /// Returns the hash, which [is ready](Self::is_ready): it takes the last step, so that other links can have it too.
    pub(super) fn sum<R: Rows>(&self, rows: &R) -> u32 {
        let mut hash = *self;
        hash.step(rows);
        !hash.crc.sum()
    }
}
