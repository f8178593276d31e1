//! The numbers in which decimal and binary meet: wide enough to hold any `f32` and its halves exactly, multiplied and
//! divided by ten.
//!
//! The parser of `core` takes 20 kB of flash with its tables, and `core::fmt` can panic. Plans are read now and then,
//! not in the control loop, so this is small rather than quick.

/// The magnitude of any `f32`, exactly: 128 bits before the point and 160 behind it, in words of 16 bits, the highest
/// first. The lowest bit of a subnormal is 2^-149, and half of it decides how to round.
pub(super) struct Wide {
    words: [u16; 18],
    /// Whether a division dropped something below the last word.
    inexact: bool,
}

/// How far the lowest bit of a subnormal is above the lowest bit of a [`Wide`].
const LOWEST: u32 = 160 - 149;
/// How many words stand before the point.
const WHOLE: usize = 8;
const FRACTION_BITS: u32 = 23;
pub(super) const INFINITY: u32 = 0xFF << FRACTION_BITS;

fn low(value: u32) -> u16 {
    let [a, b, ..] = value.to_le_bytes();
    u16::from_le_bytes([a, b])
}

/// Multiplies by ten and adds; returns what did not fit.
fn multiply(words: &mut [u16], mut carry: u32) -> u32 {
    for word in words.iter_mut().rev() {
        let value = u32::from(*word).wrapping_mul(10).wrapping_add(carry);
        *word = low(value);
        carry = value >> 16;
    }
    carry
}

/// Divides by ten what stands here with `rest` before it; returns the rest.
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

    /// From the bits of a positive, finite `f32`.
    fn from_bits(bits: u32) -> Self {
        let exponent = bits >> FRACTION_BITS;
        let hidden = if exponent == 0 { 0 } else { 1 << FRACTION_BITS };
        let at = LOWEST.wrapping_add(exponent.saturating_sub(1));
        let mut rest = u64::from((bits & ((1 << FRACTION_BITS) - 1)) | hidden).wrapping_shl(at % 16);
        let mut wide = Self::ZERO;
        // At most 18 words lie there.
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

    /// Ten times this, plus a digit; false when it is 2^128 or more. There must be nothing behind the point.
    pub(super) fn push(&mut self, digit: u8) -> bool {
        multiply(self.whole(), digit.into()) == 0
    }

    /// A tenth of this with `digit` added first. Divided down to the last word and cut there, any number of such steps
    /// gives what one division by a power of ten would.
    pub(super) fn push_behind_point(&mut self, digit: u8) {
        if let Some(lowest) = self.whole().last_mut() {
            *lowest |= u16::from(digit);
        }
        self.divide();
    }

    fn divide(&mut self) {
        self.inexact |= divide(&mut self.words, 0) != 0;
    }

    /// The bits of the nearest `f32`, of two that are as near the even one; nothing when that is infinity.
    pub(super) fn round(&self) -> Option<u32> {
        // Three words, of which the first is not zero unless they are the last: at least 33 bits of significance.
        let skipped = self.words.iter().take(15).take_while(|word| **word == 0).count();
        let base = 16u32.wrapping_mul(u32::try_from(15usize.wrapping_sub(skipped)).unwrap_or(0));
        let [high, middle, lowest, rest @ ..] = self.words.get(skipped..)? else { return None };
        let window = u64::from(*high) << 32 | u64::from(*middle) << 16 | u64::from(*lowest);
        let inexact = self.inexact || rest.iter().any(|word| *word != 0);
        // Where the bits that are kept begin: 24 of them, or fewer of a subnormal.
        let length = 64u32.wrapping_sub(window.leading_zeros());
        let lowest = base.wrapping_add(length).saturating_sub(24).max(LOWEST);
        let shift = lowest.wrapping_sub(base);
        let [a, b, c, d, ..] = window.wrapping_shr(shift).to_le_bytes();
        let kept = u32::from_le_bytes([a, b, c, d]);
        let dropped = window.wrapping_shl(64u32.wrapping_sub(shift)) | u64::from(inexact);
        let half = 1u64 << 63;
        let up = dropped > half || (dropped == half && kept % 2 == 1);
        // The highest kept bit counts as one exponent more, and so does a carry.
        let bits = (lowest.wrapping_sub(LOWEST) << FRACTION_BITS).wrapping_add(kept).wrapping_add(up.into());
        (bits < INFINITY).then_some(bits)
    }
}
/// The bits of the `f32` nearest to `digits`·10^`exponent`.
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

/// The fewest digits, and their power of ten, that are read as the positive, finite `f32` with these bits; of several
/// as short the nearest, of two as near the larger.
pub(super) fn shortest(bits: u32) -> (u32, i32) {
    if bits == 0 {
        return (0, 0);
    }
    // The first nine digits, cut off: the number is `digits`·10^exponent and a bit, `next` being the tenth digit.
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
    // What is shorter and is read as this number, if anything is, is the number cut off or one more. Nine digits do.
    let mut unit = 100_000_000u32;
    exponent = exponent.wrapping_add(8);
    loop {
        let cut = digits.checked_div(unit).unwrap_or(digits);
        let rest = digits.wrapping_sub(cut.wrapping_mul(unit));
        let up = rest.wrapping_mul(10).wrapping_add(next) >= unit.wrapping_mul(5);
        for up in [up, !up] {
            let candidate = cut.wrapping_add(up.into());
            if unit <= 1 || nearest(candidate, exponent) == Some(bits) {
                // Of nine and one more.
                return if candidate == 10 { (1, exponent.wrapping_add(1)) } else { (candidate, exponent) };
            }
        }
        unit /= 10;
        exponent = exponent.wrapping_sub(1);
    }
}
