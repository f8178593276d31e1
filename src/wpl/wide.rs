//! Fixed-point numbers for conversions between decimal and binary. They hold any `f32`, and the midpoint between two,
//! exactly (W-4), and can be multiplied and divided by ten.
//!
//! The parser of `core` takes 20 kB of flash with its tables, and `core::fmt` can panic. Plan files are not read in the
//! control loop, so the code is small rather than fast.

/// The magnitude of an `f32`: 128 bits before the point and 160 bits after it, in words of 16 bits, the highest first.
/// The lowest bit of a subnormal is 2^-149, and half of it decides how to round.
pub(super) struct Wide {
    words: [u16; 18],
    /// Sticky bit: whether a division has dropped a remainder below the last word.
    inexact: bool,
}

/// The position of a subnormal's lowest bit in a [`Wide`], counted from the lowest bit.
const LOWEST: u32 = 160 - 149;
/// Number of words before the point.
const WHOLE: usize = 8;
const FRACTION_BITS: u32 = 23;
pub(super) const INFINITY: u32 = 0xFF << FRACTION_BITS;

fn low(value: u32) -> u16 {
    let [a, b, ..] = value.to_le_bytes();
    u16::from_le_bytes([a, b])
}

/// Multiplies `words` by ten and adds `carry`. Returns the carry out of the highest word.
fn multiply(words: &mut [u16], mut carry: u32) -> u32 {
    for word in words.iter_mut().rev() {
        let value = u32::from(*word).wrapping_mul(10).wrapping_add(carry);
        *word = low(value);
        carry = value >> 16;
    }
    carry
}

/// Divides `words` by ten, with `rest` as the digit before them. Returns the remainder.
fn divide(words: &mut [u16], mut rest: u32) -> u32 {
    for word in words {
        let value = (rest << 16) | u32::from(*word);
        *word = low(value / 10);
        rest = value % 10;
    }
    rest
}

impl Wide {
    pub(super) const ZERO: Self = Self { words: [0; 18], inexact: false };

    fn from_integer(value: u32) -> Self {
        let mut wide = Self::ZERO;
        if let [.., high, lowest] = wide.whole() {
            (*high, *lowest) = (low(value >> 16), low(value));
        }
        wide
    }

    fn whole(&mut self) -> &mut [u16] {
        self.words.get_mut(..WHOLE).unwrap_or_default()
    }

    fn fraction(&mut self) -> &mut [u16] {
        self.words.get_mut(WHOLE..).unwrap_or_default()
    }

    /// Converts the bits of a positive, finite `f32`.
    fn from_bits(bits: u32) -> Self {
        let exponent = bits >> FRACTION_BITS;
        let hidden = if exponent == 0 { 0 } else { 1 << FRACTION_BITS };
        let at = LOWEST.wrapping_add(exponent.saturating_sub(1));
        let mut rest = u64::from((bits & ((1 << FRACTION_BITS) - 1)) | hidden).wrapping_shl(at % 16);
        let mut wide = Self::ZERO;
        // The conversion cannot fail; 18 skips all words.
        let skipped = usize::try_from(at / 16).unwrap_or(18);
        for word in wide.words.iter_mut().rev().skip(skipped).take(3) {
            let [a, b, ..] = rest.to_le_bytes();
            *word = u16::from_le_bytes([a, b]);
            rest >>= 16;
        }
        wide
    }

    pub(super) fn is_zero(&self) -> bool {
        self.words == [0; 18]
    }

    /// Multiplies by ten and adds `digit`. Returns false if the result is 2^128 or more. The fraction must be zero.
    pub(super) fn push(&mut self, digit: u8) -> bool {
        multiply(self.whole(), digit.into()) == 0
    }

    /// Adds `digit` and divides by ten. Each step truncates after the last word. Together the steps give the same
    /// result as one division by a power of ten.
    pub(super) fn push_behind_point(&mut self, digit: u8) {
        if let Some(lowest) = self.whole().last_mut() {
            *lowest |= u16::from(digit);
        }
        self.divide();
    }

    fn divide(&mut self) {
        self.inexact |= divide(&mut self.words, 0) != 0;
    }

    /// Returns the bits of the nearest `f32`, ties to even; `None` if that is infinity.
    pub(super) fn round(&self) -> Option<u32> {
        // Three words. The first is not zero unless they are the last ones: at least 33 significant bits.
        let skipped = self.words.iter().take(15).take_while(|word| **word == 0).count();
        let base = 16u32.wrapping_mul(u32::try_from(15usize.wrapping_sub(skipped)).unwrap_or(0));
        let [high, middle, lowest, rest @ ..] = self.words.get(skipped..)? else { return None };
        let window = u64::from(*high) << 32 | u64::from(*middle) << 16 | u64::from(*lowest);
        let inexact = self.inexact || rest.iter().any(|word| *word != 0);
        // The lowest of the bits that are kept: 24, or fewer for a subnormal.
        let length = 64u32.wrapping_sub(window.leading_zeros());
        let lowest = base.wrapping_add(length).saturating_sub(24).max(LOWEST);
        let shift = lowest.wrapping_sub(base);
        let [a, b, c, d, ..] = window.wrapping_shr(shift).to_le_bytes();
        let kept = u32::from_le_bytes([a, b, c, d]);
        let dropped = window.wrapping_shl(64u32.wrapping_sub(shift)) | u64::from(inexact);
        let half = 1u64 << 63;
        let up = dropped > half || (dropped == half && kept % 2 == 1);
        // The hidden bit is added to the exponent, and so is a carry.
        let bits = (lowest.wrapping_sub(LOWEST) << FRACTION_BITS).wrapping_add(kept).wrapping_add(up.into());
        (bits < INFINITY).then_some(bits)
    }
}

/// Returns the bits of the `f32` nearest to `digits`·10^`exponent`.
fn nearest(digits: u32, exponent: i32) -> Option<u32> {
    let mut wide = Wide::from_integer(digits);
    for _ in 0..exponent {
        wide.push(0).then_some(())?;
    }
    for _ in exponent..0 {
        wide.divide();
    }
    wide.round()
}

/// Returns the shortest decimal, as digits and a power of ten, that reads back as the positive, finite `f32` with these
/// bits. Among the shortest, returns the nearest; on a tie, the larger.
pub(super) fn shortest(bits: u32) -> (u32, i32) {
    if bits == 0 {
        return (0, 0);
    }
    // The number, truncated to nine digits, is `digits`·10^`exponent`; `next` is the tenth digit.
    let mut wide = Wide::from_bits(bits);
    let mut exponent = 0i32;
    let mut next = 0;
    let mut digits = loop {
        if let [0, 0, 0, 0, 0, 0, high, lowest] = wide.whole() {
            let whole = u32::from(*high) << 16 | u32::from(*lowest);
            if whole < 1_000_000_000 {
                break whole;
            }
        }
        next = divide(wide.whole(), 0);
        exponent = exponent.wrapping_add(1);
    };
    if exponent == 0 {
        while digits < 100_000_000 {
            digits = digits.wrapping_mul(10).wrapping_add(multiply(wide.fraction(), 0));
            exponent = exponent.wrapping_sub(1);
        }
        next = multiply(wide.fraction(), 0);
    }
    // For each length, only the truncated digits and the next larger ones can read back as the number. Nine digits
    // suffice.
    let mut unit = 100_000_000u32;
    exponent = exponent.wrapping_add(8);
    loop {
        let cut = digits.checked_div(unit).unwrap_or(digits);
        let rest = digits.wrapping_sub(cut.wrapping_mul(unit));
        let up = rest.wrapping_mul(10).wrapping_add(next) >= unit.wrapping_mul(5);
        for up in [up, !up] {
            let candidate = cut.wrapping_add(up.into());
            if unit <= 1 || nearest(candidate, exponent) == Some(bits) {
                // Rounded up from 9.
                return if candidate == 10 { (1, exponent.wrapping_add(1)) } else { (candidate, exponent) };
            }
        }
        unit /= 10;
        exponent = exponent.wrapping_sub(1);
    }
}
