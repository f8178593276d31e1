//! The line that the writer composes, with numbers that read back unchanged (W-4, W-8).

use super::wide::shortest;

/// The text of a row. Bytes that do not fit are dropped.
#[derive(Clone, Debug)]
pub(super) struct Line {
    bytes: [u8; Self::LEN],
    len: usize,
}

impl Line {
    /// Length of the longest row: 5 + 1 + 3 + 5 digits, five floats of 16 characters, x and y of 12, 3 digits, and a
    /// separator after each column.
    const LEN: usize = 6 + 2 + 4 + 6 + 5 * 17 + 2 * 13 + 4;

    pub(super) const fn new() -> Self {
        Self { bytes: [0; Self::LEN], len: 0 }
    }

    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    pub(super) fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }

    pub(super) fn push(&mut self, byte: u8) {
        if let Some(end) = self.bytes.get_mut(self.len) {
            *end = byte;
            self.len = self.len.wrapping_add(1);
        }
    }

    fn push_all(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.push(byte);
        }
    }

    pub(super) fn push_integer(&mut self, value: u32) {
        self.push_all(Digits::new(value).as_bytes());
    }

    /// Appends `value`/10^`decimals` with all decimals; `nan` for `i32::MAX`, "not given".
    pub(super) fn push_scaled(&mut self, value: i32, decimals: u8) {
        if value == i32::MAX {
            return self.push_all(b"nan");
        }
        if value < 0 {
            self.push(b'-');
        }
        self.push_plain(value.unsigned_abs(), i32::from(decimals).wrapping_neg());
    }

    /// Appends the shortest number that reads back as `value`, the nearest one if there are several: at most 16
    /// characters.
    pub(super) fn push_f32(&mut self, value: f32) {
        if value.is_nan() {
            return self.push_all(b"nan");
        }
        if value.is_sign_negative() {
            self.push(b'-');
        }
        if value.is_infinite() {
            return self.push_all(b"inf");
        }
        let (digits, exponent) = shortest(value.abs().to_bits());
        let count = i32::try_from(Digits::new(digits).as_bytes().len()).unwrap_or(0);
        let point = count.wrapping_add(exponent);
        // As `0.00001` and as `12345678901`, which are no longer than with an exponent.
        if (-4..=10).contains(&point) {
            return self.push_plain(digits, exponent);
        }
        // As `1.5e-7`: with one digit before the point.
        self.push_plain(digits, 1i32.wrapping_sub(count));
        self.push(b'e');
        let power = point.wrapping_sub(1);
        if power < 0 {
            self.push(b'-');
        }
        self.push_integer(power.unsigned_abs());
    }

    /// Appends `value`·10^`exponent` in positional notation.
    fn push_plain(&mut self, value: u32, exponent: i32) {
        let digits = Digits::new(value);
        let digits = digits.as_bytes();
        let count = i32::try_from(digits.len()).unwrap_or(0);
        let point = count.wrapping_add(exponent);
        for at in point.wrapping_sub(1).min(0)..point.max(count) {
            if at == point {
                self.push(b'.');
            }
            let digit = usize::try_from(at).ok().and_then(|at| digits.get(at));
            self.push(digit.copied().unwrap_or(b'0'));
        }
    }
}

/// The decimal digits of a number, at the end of the array.
struct Digits {
    bytes: [u8; 10],
    count: usize,
}

impl Digits {
    fn new(mut value: u32) -> Self {
        let mut digits = Self { bytes: [0; 10], count: 0 };
        for digit in digits.bytes.iter_mut().rev() {
            let [rest, ..] = (value % 10).to_le_bytes();
            *digit = b'0'.wrapping_add(rest);
            digits.count = digits.count.wrapping_add(1);
            value /= 10;
            if value == 0 {
                break;
            }
        }
        digits
    }

    fn as_bytes(&self) -> &[u8] {
        self.bytes.get(self.bytes.len().saturating_sub(self.count)..).unwrap_or_default()
    }
}
