//! `char[N]`: text of at most `N` bytes.

use super::Field;

/// A `char[N]` field: bytes up to the first NUL, or all `N` when there is none (S-18). Need not be UTF-8.
///
/// Also the place where the stack builds its own short texts, without `core::fmt`:
///
/// ```
/// let mut text = mavstack::Text::<20>::new("item ");
/// text.push_number(12);
/// text.push_str(": no such command");
/// assert_eq!(text.as_bytes(), b"item 12: no such com");
/// ```
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Text<const N: usize>([u8; N]);

impl<const N: usize> Text<N> {
    /// No text.
    pub const EMPTY: Self = Self([0; N]);

    /// The front of `text`, as much of it as fits, cut between code points; a NUL in it ends it.
    #[must_use]
    pub fn new(text: &str) -> Self {
        let mut new = Self::EMPTY;
        new.push_str(text);
        new
    }

    /// The field's bytes as they stand on the wire.
    #[inline]
    pub const fn from_wire(bytes: [u8; N]) -> Self {
        Self(bytes)
    }

    /// All `N` bytes, with the NULs behind the text.
    #[inline]
    pub const fn wire(&self) -> &[u8; N] {
        &self.0
    }

    /// The text: up to the first NUL.
    pub fn as_bytes(&self) -> &[u8] {
        self.0.split(|&byte| byte == 0).next().unwrap_or(&[])
    }

    /// The text, when it is UTF-8.
    pub fn as_str(&self) -> Option<&str> {
        core::str::from_utf8(self.as_bytes()).ok()
    }

    /// Length of the text in bytes.
    pub fn len(&self) -> usize {
        self.as_bytes().len()
    }

    /// Whether there is no text.
    pub fn is_empty(&self) -> bool {
        self.0.first().is_none_or(|&byte| byte == 0)
    }

    /// Appends as much of `text` as fits, cut between code points.
    pub fn push_str(&mut self, text: &str) {
        let at = self.len();
        let Some(room) = self.0.get_mut(at..) else { return };
        let mut len = room.len().min(text.len());
        while !text.is_char_boundary(len) {
            len = len.saturating_sub(1);
        }
        for (to, &from) in room.iter_mut().zip(text.as_bytes().iter().take(len)) {
            *to = from;
        }
    }

    /// The front of the text as a shorter field, cut between code points when it is UTF-8.
    #[must_use]
    pub fn front<const M: usize>(&self) -> Text<M> {
        let bytes = self.as_bytes();
        let mut len = bytes.len().min(M);
        // A byte 0b10xx_xxxx goes on with the code point before it.
        while len > 0 && bytes.get(len).is_some_and(|&byte| byte & 0xC0 == 0x80) {
            len = len.saturating_sub(1);
        }
        let mut front = [0; M];
        for (to, &from) in front.iter_mut().zip(bytes.iter().take(len)) {
            *to = from;
        }
        Text(front)
    }

    /// Appends a number in decimal; what does not fit is cut off.
    pub fn push_number(&mut self, number: u32) {
        let mut digits = [0; 10];
        let mut rest = number;
        let mut used = 0usize;
        for digit in digits.iter_mut().rev() {
            // The remainder is below ten, so nothing is lost.
            *digit = b'0'.wrapping_add(u8::try_from(rest % 10).unwrap_or(0));
            rest /= 10;
            used = used.saturating_add(1);
            if rest == 0 {
                break;
            }
        }
        let at = self.len();
        let free = self.0.get_mut(at..).unwrap_or_default();
        for (to, &from) in free.iter_mut().zip(digits.iter().skip(digits.len().saturating_sub(used))) {
            *to = from;
        }
    }
}

impl<const N: usize> Default for Text<N> {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl<const N: usize> core::fmt::Debug for Text<N> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "\"{}\"", self.as_bytes().escape_ascii())
    }
}

#[cfg(feature = "defmt")]
impl<const N: usize> defmt::Format for Text<N> {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self.as_str() {
            Some(text) => defmt::write!(f, "{=str}", text),
            None => defmt::write!(f, "{=[u8]:a}", self.as_bytes()),
        }
    }
}

impl<const N: usize> Field for Text<N> {
    const SIZE: usize = N;
    const ELEMENT: usize = 1;
    const WIRE_TYPE: &'static str = "char";
    const IS_ARRAY: bool = true;
    const ZERO: Self = Self::EMPTY;

    #[inline(always)]
    fn read(payload: &[u8], at: usize) -> Self {
        Self(<[u8; N]>::read(payload, at))
    }

    #[inline(always)]
    fn write(&self, payload: &mut [u8], at: usize) {
        self.0.write(payload, at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_ends_at_nul_or_fills_the_field() {
        // S-18
        assert_eq!(Text::from_wire(*b"ab\0cd").as_bytes(), b"ab");
        assert_eq!(Text::from_wire(*b"abcde").as_bytes(), b"abcde");
        assert_eq!(Text::from_wire([0xFF, 0xC3, 0]).as_str(), None);
        assert!(Text::from_wire(*b"\0bc").is_empty());
    }

    #[test]
    fn cut_falls_between_code_points() {
        assert_eq!(Text::<4>::new("abcé").as_str(), Some("abc"));
        assert_eq!(Text::<5>::new("abcé").as_str(), Some("abcé"));
        assert_eq!(Text::<2>::new("€").as_str(), Some(""));
    }

    #[test]
    fn numbers_append_in_decimal() {
        for (number, text) in [(0, "0"), (10, "10"), (4_294_967_295, "4294967295")] {
            let mut built = Text::<10>::EMPTY;
            built.push_number(number);
            assert_eq!(built.as_str(), Some(text));
        }
        assert_eq!(Text::<9>::new("abcdé").front::<5>().as_str(), Some("abcd"));
        let mut full = Text::<3>::new("a");
        full.push_number(123);
        assert_eq!(full.as_str(), Some("a12"));
    }
}
