//! CRC-16/MCRF4XX, the checksum of every frame (S-2).
//!
//! The checksum is the floor of all parsing, so its shape follows the target: eight table look-ups at a time (4 KiB of
//! tables) on 64-bit hosts; on microcontrollers, where flash and cache are small, four bytes at a time by shifts alone, which
//! takes fewer instructions than a table of 512 bytes. A property test proves both equal to `crc-any`.

/// Start value.
pub(crate) const INIT: u16 = 0xFFFF;

/// The checksum of one more byte.
#[inline]
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; low byte of u16, and u8 to u16")]
pub(crate) const fn step(sum: u16, byte: u8) -> u16 {
    let low = (sum as u8) ^ byte;
    let low = (low ^ (low << 4)) as u16;
    (sum >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)
}

/// The checksum of `bytes`, with the message's `CRC_EXTRA` behind them (S-3).
pub(crate) fn checksum(bytes: &[u8], crc_extra: u8) -> u16 {
    #[cfg(target_pointer_width = "64")]
    return wide::step(wide::update(INIT, bytes), crc_extra);
    #[cfg(not(target_pointer_width = "64"))]
    return step(narrow::update(INIT, bytes), crc_extra);
}

#[cfg(any(test, not(target_pointer_width = "64")))]
mod narrow {
    /// Four bytes at a time, by shifting.
    pub(super) fn update(sum: u16, bytes: &[u8]) -> u16 {
        let (words, rest) = bytes.as_chunks::<4>();
        let sum = words.iter().fold(sum, |sum, &word| remainder(u32::from_le_bytes(word) ^ u32::from(sum)));
        rest.iter().fold(sum, |sum, &byte| super::step(sum, byte))
    }

    /// `word` times x^16, modulo x^16 + x^12 + x^5 + 1: the checksum of four bytes with the one before them in their first two.
    /// Bit 0 is the highest power, so what a shift to the left pushes out is below what counts.
    #[inline(always)]
    fn remainder(word: u32) -> u16 {
        // The quotient is word / (1 + f) with f = x^-4 + x^-11 + x^-16. As addition is XOR, that is word (1 + f)(1 + f^2)(1 + f^4),
        // and of f^4 only x^-16 counts. The first and the last factor together:
        let shifted = (word << 4) ^ (word << 11);
        let quotient = word ^ shifted ^ (shifted << 16);
        let quotient = quotient ^ (quotient << 8) ^ (quotient << 22);
        // Of its product with x^12 + x^5 + 1 the 16 lowest powers.
        let [low, high, ..] = ((quotient >> 16) ^ (quotient >> 21) ^ (quotient >> 28)).to_le_bytes();
        u16::from_le_bytes([low, high])
    }
}

#[cfg(any(test, target_pointer_width = "64"))]
mod wide {
    /// `TABLES[k][b]`: the checksum of byte `b` with `k` zero bytes behind it.
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
    // Every index is a `u8` into 256 entries: no bounds check is left, and none can fail.
    #[allow(clippy::indexing_slicing, reason = "u8 into [u16; 256]")]
    pub(super) fn update(mut sum: u16, bytes: &[u8]) -> u16 {
        let (blocks, rest) = bytes.as_chunks::<8>();
        let [t0, t1, t2, t3, t4, t5, t6, t7] = &LOOKUP;
        for &[a, b, c, d, e, f, g, h] in blocks {
            // What does not wait for the sum comes first: from one sum to the next it is two look-ups only.
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
    fn check_value_of_the_catalogue() {
        assert_eq!(checksum(b"12345678", b'9'), 0x6F91);
    }

    proptest! {
        /// S-2: both forms are the catalogue's CRC-16/MCRF4XX, for any cut of the input.
        #[test]
        fn equal_to_crc_any(bytes in proptest::collection::vec(any::<u8>(), 0..300), cut in 0usize..300) {
            let mut reference = crc_any::CRCu16::crc16mcrf4cc();
            reference.digest(&bytes);
            let (front, back) = bytes.split_at(cut.min(bytes.len()));
            prop_assert_eq!(wide::update(wide::update(INIT, front), back), reference.get_crc());
            prop_assert_eq!(narrow::update(narrow::update(INIT, front), back), reference.get_crc());
        }
    }
}
