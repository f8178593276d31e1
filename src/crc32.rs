//! The CRC-32 of zip and Ethernet, for the ids of plans (M-5), parameter hashes (P-20) and stored records.

/// The effect of four bits on the checksum.
#[allow(
    clippy::indexing_slicing,
    clippy::arithmetic_side_effects,
    clippy::as_conversions,
    reason = "const-evaluated: a panic here is a compile error"
)]
static TABLE: [u32; 16] = {
    let mut table = [0; 16];
    let mut bits = 0;
    while bits < 16 {
        let (mut sum, mut bit) = (bits as u32, 0);
        while bit < 4 {
            sum = (sum >> 1) ^ (0xEDB8_8320 & (sum & 1).wrapping_neg());
            bit += 1;
        }
        table[bits] = sum;
        bits += 1;
    }
    table
};

/// Moves the checksum on by the byte that was added to it.
#[inline(always)]
#[allow(clippy::indexing_slicing, clippy::as_conversions, reason = "four bits into [u32; 16]")]
fn byte(crc: u32) -> u32 {
    let crc = (crc >> 4) ^ TABLE[(crc & 15) as usize];
    (crc >> 4) ^ TABLE[(crc & 15) as usize]
}

/// A CRC-32 under computation.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Crc32(u32);

impl Crc32 {
    pub(crate) const fn new() -> Self {
        Self(u32::MAX)
    }

    /// A CRC-32 with initial value zero, for the hash of the parameters (P-20). The hash is the complement of
    /// [`sum`](Self::sum).
    pub(crate) const ZERO: Self = Self(0);

    /// Returns the CRC-32 of `bytes`.
    #[cfg(feature = "storage")]
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) fn of(bytes: &[u8]) -> u32 {
        let mut crc = Self::new();
        crc.add(bytes);
        crc.sum()
    }

    /// Adds `bytes`: four bits at a time, with a table of 64 bytes. Words of four bytes take 7 instructions a byte on a
    /// Cortex-M4, single bytes 13. Only storage checks so many that the code for words is worth its 140 bytes.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) fn add(&mut self, bytes: &[u8]) {
        let (words, rest) = if cfg!(feature = "storage") { bytes.as_chunks::<4>() } else { (&[][..], bytes) };
        let mut crc = self.0;
        for word in words {
            crc = byte(byte(byte(byte(crc ^ u32::from_le_bytes(*word)))));
        }
        for single in rest {
            crc = byte(crc ^ u32::from(*single));
        }
        self.0 = crc;
    }

    /// Returns the CRC-32 of the bytes so far.
    pub(crate) const fn sum(self) -> u32 {
        !self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_crc_any(bytes: std::vec::Vec<u8>, cut: usize) {
            let mut ours = Crc32::new();
            let (first, second) = bytes.split_at(cut % (bytes.len() + 1));
            ours.add(first);
            ours.add(second);
            let mut reference = crc_any::CRCu32::crc32();
            reference.digest(&bytes);
            prop_assert_eq!(ours.sum(), reference.get_crc());
        }
    }
}
