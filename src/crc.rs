//! CRC-16/MCRF4XX, the checksum of every frame (S-2).
//!
//! Every received byte passes through it, so there is an implementation for each kind of target:
//!
//! - 64-bit hosts take eight bytes at a time from 4 KiB of tables (slicing-by-8).
//! - Microcontrollers have little flash and cache. They take four bytes at a time by shifts and XORs, which needs fewer
//!   instructions than a table of 512 bytes.
//!
//! A property test compares both with `crc-any`.

/// Initial value.
pub(crate) const INIT: u16 = 0xFFFF;

/// Returns the checksum after one more byte.
#[inline]
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; low byte of u16, and u8 to u16")]
pub(crate) const fn step(sum: u16, byte: u8) -> u16 {
    let low = (sum as u8) ^ byte;
    let low = (low ^ (low << 4)) as u16;
    (sum >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)
}

/// Returns the checksum of `bytes` followed by the message's `CRC_EXTRA` (S-3).
pub(crate) fn checksum(bytes: &[u8], crc_extra: u8) -> u16 {
    #[cfg(target_pointer_width = "64")]
    return wide::step(wide::update(INIT, bytes), crc_extra);
    #[cfg(not(target_pointer_width = "64"))]
    return step(narrow::update(INIT, bytes), crc_extra);
}

#[cfg(any(test, not(target_pointer_width = "64")))]
mod narrow {
    /// Four bytes at a time, by shifts and XORs.
    pub(super) fn update(sum: u16, bytes: &[u8]) -> u16 {
        let (words, rest) = bytes.as_chunks::<4>();
        let sum = words.iter().fold(sum, |sum, &word| remainder(u32::from_le_bytes(word) ^ u32::from(sum)));
        rest.iter().fold(sum, |sum, &byte| super::step(sum, byte))
    }

    /// Returns `word` · x^16 modulo x^16 + x^12 + x^5 + 1: the checksum of four bytes, whose first two are XORed with
    /// the checksum before them. Bits are reflected (bit 0 is the highest power), so a left shift divides and drops
    /// fractions.
    #[inline(always)]
    fn remainder(word: u32) -> u16 {
        // The quotient is word / (1 + f) with f = x^-4 + x^-11 + x^-16. Addition is XOR, so this equals
        // word (1 + f)(1 + f^2)(1 + f^4). Of f^4 only x^-16 is within 32 bits. The first and the last factor together:
        let shifted = (word << 4) ^ (word << 11);
        let quotient = word ^ shifted ^ (shifted << 16);
        let quotient = quotient ^ (quotient << 8) ^ (quotient << 22);
        // The remainder: the 16 lowest powers of quotient · (x^12 + x^5 + 1).
        let [low, high, ..] = ((quotient >> 16) ^ (quotient >> 21) ^ (quotient >> 28)).to_le_bytes();
        u16::from_le_bytes([low, high])
    }
}

#[cfg(any(test, target_pointer_width = "64"))]
mod wide {
    /// `TABLES[k][b]` is the checksum of byte `b` followed by `k` zero bytes.
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        clippy::as_conversions,
        reason = "const-evaluated: a panic here is a compile error"
    )]
    const TABLES: [[u16; 256]; 8] = {
        let mut tables = [[0; 256]; 8];
        let mut k = 0;
        while k < 8 {
            let mut byte = 0;
            while byte < 256 {
                tables[k][byte] = if k == 0 {
                    super::step(0, byte as u8)
                } else {
                    let before = tables[k - 1][byte];
                    (before >> 8) ^ tables[0][(before & 0xFF) as usize]
                };
                byte += 1;
            }
            k += 1;
        }
        tables
    };
    static LOOKUP: [[u16; 256]; 8] = TABLES;

    /// Eight bytes at a time, then four, two, one.
    // Every index is a `u8` into 256 entries, so the compiler removes the bounds checks.
    #[allow(clippy::indexing_slicing, reason = "u8 into [u16; 256]")]
    pub(super) fn update(mut sum: u16, bytes: &[u8]) -> u16 {
        let (blocks, rest) = bytes.as_chunks::<8>();
        let [t0, t1, t2, t3, t4, t5, t6, t7] = &LOOKUP;
        for &[a, b, c, d, e, f, g, h] in blocks {
            // Six look-ups do not depend on `sum`. Only the other two are on the critical path between sums.
            let ahead = t5[usize::from(c)]
                ^ t4[usize::from(d)]
                ^ t3[usize::from(e)]
                ^ t2[usize::from(f)]
                ^ t1[usize::from(g)]
                ^ t0[usize::from(h)];
            let [low, high] = (sum ^ u16::from_le_bytes([a, b])).to_le_bytes();
            sum = ahead ^ (t7[usize::from(low)] ^ t6[usize::from(high)]);
        }
        let mut rest = rest;
        if let Some((&[a, b, c, d], behind)) = rest.split_first_chunk() {
            let [low, high] = (sum ^ u16::from_le_bytes([a, b])).to_le_bytes();
            sum = t3[usize::from(low)] ^ t2[usize::from(high)] ^ t1[usize::from(c)] ^ t0[usize::from(d)];
            rest = behind;
        }
        if let Some((&[a, b], behind)) = rest.split_first_chunk() {
            let [low, high] = (sum ^ u16::from_le_bytes([a, b])).to_le_bytes();
            sum = t1[usize::from(low)] ^ t0[usize::from(high)];
            rest = behind;
        }
        if let [last] = rest { step(sum, *last) } else { sum }
    }

    #[inline]
    #[allow(clippy::indexing_slicing, reason = "u8 into [u16; 256]")]
    pub(super) fn step(sum: u16, byte: u8) -> u16 {
        let [low, high] = sum.to_le_bytes();
        LOOKUP[0][usize::from(low ^ byte)] ^ u16::from(high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn catalogue_check_value() {
        assert_eq!(checksum(b"12345678", b'9'), 0x6F91);
    }

    proptest! {
        /// S-2: both implementations compute the catalogue's CRC-16/MCRF4XX, wherever the input is split.
        #[test]
        fn both_agree_with_crc_any(bytes in proptest::collection::vec(any::<u8>(), 0..300), cut in 0usize..300) {
            let mut reference = crc_any::CRCu16::crc16mcrf4cc();
            reference.digest(&bytes);
            let (front, back) = bytes.split_at(cut.min(bytes.len()));
            prop_assert_eq!(wide::update(wide::update(INIT, front), back), reference.get_crc());
            prop_assert_eq!(narrow::update(narrow::update(INIT, front), back), reference.get_crc());
        }
    }
}
