//! CRC-32 as in zip and Ethernet: ids of plans (M-5), and records on storage.

/// A CRC-32 while its bytes come in.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Crc32(u32);

impl Crc32 {
    pub(crate) const fn new() -> Self {
        Self(u32::MAX)
    }

    /// Beginning with zero, as the hash of the parameters does (P-20), which is the complement of its [`sum`](Self::sum).
    pub(crate) const ZERO: Self = Self(0);

    /// The next bytes. By shifts: a table would cost more flash than all that is checked is worth in time.
    pub(crate) fn add(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 ^= u32::from(*byte);
            for _ in 0..8 {
                self.0 = (self.0 >> 1) ^ (0xEDB8_8320 & (self.0 & 1).wrapping_neg());
            }
        }
    }

    /// The sum of all bytes so far.
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
        fn equals_another_implementation(bytes: std::vec::Vec<u8>, cut: usize) {
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
