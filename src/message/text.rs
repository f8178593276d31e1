//! Texts of at most `N` bytes: the type of `char[N]`.

use super::Field;

/// A `char[N]` field: its bytes up to the first NUL, or all `N` if there is none (S-18). It need not be UTF-8.
///
/// It also serves as a builder for short texts, without `core::fmt`:
///
/// ```
/// let mut text = mavstack::Text::<43>::new("Battery 2: ");
/// text.push_decimal(1_184, 2);
/// text.push_str(" V at ");
/// text.push_signed(-7);
/// text.push_str("°C, error 0x");
/// text.push_hex(0x2F, 4);
/// assert_eq!(text.as_str(), Some("Battery 2: 11.84 V at -7°C, error 0x002F"));
/// // Text that does not fit is cut between code points.
/// text.push_str(" – replace it");
/// assert_eq!(text.len(), 42);
/// ```
///
/// With the feature `fmt` it implements `core::fmt::Write`, so that `write!` works.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Text<const N: usize>([u8; N]);

impl<const N: usize> Text<N> {
    /// The empty text.
    pub const EMPTY: Self = Self([0; N]);

    /// Returns as much of `text` as fits in `N` bytes, cut between code points. A NUL ends the text.
    #[must_use]
    pub fn new(text: &str) -> Self {
        Self::from_bytes(text.as_bytes())
    }

    /// Like [`new`](Self::new), for bytes that need not be UTF-8.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Self {
        let mut new = Self::EMPTY;
        append(&mut new.0, bytes);
        new
    }

    /// Replaces the text, as [`from_bytes`](Self::from_bytes) does, in place.
    pub(crate) fn set(&mut self, bytes: &[u8]) {
        if let Some(first) = self.0.first_mut() {
            *first = 0;
        }
        append(&mut self.0, bytes);
    }

    /// Returns the text with these bytes on the wire.
    #[inline]
    pub const fn from_wire(bytes: [u8; N]) -> Self {
        Self(bytes)
    }

    /// Returns all `N` bytes on the wire, including the NULs after the text.
    #[inline]
    pub const fn wire(&self) -> &[u8; N] {
        &self.0
    }

    /// Returns the text's bytes, up to the first NUL.
    pub fn as_bytes(&self) -> &[u8] {
        self.0.split(|&byte| byte == 0).next().unwrap_or(&[])
    }

    /// Returns the text; `None` if it is not UTF-8.
    pub fn as_str(&self) -> Option<&str> {
        core::str::from_utf8(self.as_bytes()).ok()
    }

    /// Returns the length of the text in bytes.
    pub fn len(&self) -> usize {
        self.as_bytes().len()
    }

    /// Returns whether the text is empty.
    pub fn is_empty(&self) -> bool {
        self.0.first().is_none_or(|&byte| byte == 0)
    }

    /// Appends as much of `text` as fits, cut between code points. A NUL ends the text.
    pub fn push_str(&mut self, text: &str) {
        append(&mut self.0, text.as_bytes());
    }

    /// Appends a number in decimal.
    pub fn push_number(&mut self, number: u32) {
        append_number(&mut self.0, false, number, 10, 0, 0);
    }

    /// Appends a number in decimal, with a minus sign if it is negative.
    pub fn push_signed(&mut self, number: i32) {
        self.push_decimal(number, 0);
    }

    /// Appends `number`·10^-`places` as a decimal fraction with `places` digits after the point, 0 to 9; more count as
    /// 9.
    ///
    /// `push_decimal(millivolts, 3)` shows a voltage in volts, `push_decimal(latitude, 7)` a latitude in degrees.
    pub fn push_decimal(&mut self, number: i32, places: u8) {
        append_number(&mut self.0, number < 0, number.unsigned_abs(), 10, places.min(9), 0);
    }

    /// Appends a number in hexadecimal, padded with zeros to `digits` digits, 0 to 8; more count as 8.
    pub fn push_hex(&mut self, number: u32, digits: u8) {
        append_number(&mut self.0, false, number, 16, 0, digits.min(8));
    }

    /// Returns as much of the text as fits in a field of `M` bytes, cut between code points if it is UTF-8.
    #[must_use]
    pub fn front<const M: usize>(&self) -> Text<M> {
        Text::from_bytes(self.as_bytes())
    }
}

/// Appends as much of `text` as fits, up to a NUL, to the text in `field`. Returns whether all of it was appended. Not
/// generic, so it is compiled once.
fn append(field: &mut [u8], text: &[u8]) -> bool {
    let room = match field.iter().position(|&byte| byte == 0) {
        Some(end) => field.get_mut(end..).unwrap_or_default(),
        None => &mut [],
    };
    let front = front(text, room.len());
    for (to, from) in room.iter_mut().zip(front) {
        *to = *from;
    }
    // A received field may have other bytes after the NUL. With the condition, this is not `fill`, which links a function of its own.
    for to in room.iter_mut().skip(front.len()) {
        if *to != 0 {
            *to = 0;
        }
    }
    front.len() == up_to_nul(text).len()
}

fn up_to_nul(text: &[u8]) -> &[u8] {
    text.split(|&byte| byte == 0).next().unwrap_or_default()
}

/// Returns what a [`Text`] of `max` bytes has of `text`.
pub(crate) fn front(text: &[u8], max: usize) -> &[u8] {
    let text = up_to_nul(text);
    text.get(..cut(text, max)).unwrap_or_default()
}

/// Returns how many of the first `max` bytes of a text are whole code points; `max` if it is not UTF-8.
fn cut(text: &[u8], max: usize) -> usize {
    if text.len() <= max {
        return text.len();
    }
    // A byte 0b10xx_xxxx continues a code point, which has at most four bytes.
    let is_start = |&len: &usize| text.get(len).is_none_or(|&byte| byte & 0xC0 != 0x80);
    let min = max.saturating_sub(3);
    (min..=max).rev().find(is_start).unwrap_or(max)
}

/// Appends a number to the text in `field`: with `places` digits after a point, and at least `min_digits` digits. Not
/// generic, so
/// it is compiled once.
fn append_number(field: &mut [u8], is_negative: bool, number: u32, radix: u32, places: u8, min_digits: u8) {
    // A sign, ten digits and a point, written from the end.
    let mut text = [0; 12];
    let mut free = text.iter_mut().rev();
    let mut put = |byte: u8| free.next().map_or((), |place| *place = byte);
    let (mut rest, mut count) = (number, 0u8);
    while count == 0 || rest != 0 || count <= places || count < min_digits {
        if count == places && count > 0 {
            put(b'.');
        }
        let digit = rest.checked_rem(radix).unwrap_or(0);
        rest = rest.checked_div(radix).unwrap_or(0);
        let digit = u8::try_from(digit).unwrap_or(0);
        put(digit.wrapping_add(if digit < 10 { b'0' } else { b'A'.wrapping_sub(10) }));
        count = count.saturating_add(1);
    }
    if is_negative {
        put(b'-');
    }
    let start = text.iter().position(|&byte| byte != 0).unwrap_or(0);
    append(field, text.get(start..).unwrap_or_default());
}

/// For functions that accept any text, such as [`Stack::text`](crate::Stack::text).
impl<const N: usize> AsRef<[u8]> for Text<N> {
    fn as_ref(&self) -> &[u8] {
        self.as_bytes()
    }
}

#[cfg(feature = "fmt")]
impl<const N: usize> Text<N> {
    /// Returns a text that `core::fmt` formats, cut off after `N` bytes. `core::fmt` takes some kilobytes of flash.
    ///
    /// ```
    /// use mavstack::Text;
    ///
    /// let wind = 2.25;
    /// let text = Text::<50>::formatted(format_args!("Wind {wind:.1} m/s"));
    /// assert_eq!(text.as_str(), Some("Wind 2.2 m/s"));
    /// ```
    pub fn formatted(text: core::fmt::Arguments<'_>) -> Self {
        let mut formatted = Self::EMPTY;
        // An error means that the text was cut off.
        let _ = core::fmt::Write::write_fmt(&mut formatted, text);
        formatted
    }
}

/// Appends as much as fits, and returns an error if the text was cut.
#[cfg(feature = "fmt")]
impl<const N: usize> core::fmt::Write for Text<N> {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        if append(&mut self.0, text.as_bytes()) { Ok(()) } else { Err(core::fmt::Error) }
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

    /// UTF-8 stays valid wherever it is cut, and at most three bytes more than necessary are removed.
    #[test]
    fn cut_keeps_utf8_valid() {
        for text in ["aé€𝄞", "é", "€uro", "𝄞𝄞𝄞", "abcdefg", ""] {
            for max in 0..12 {
                let len = cut(text.as_bytes(), max);
                assert!(len <= max && text.is_char_boundary(len), "{text} at {max}: {len}");
                assert!(len + 3 >= max.min(text.len()));
            }
        }
        assert_eq!(cut(&[0x80; 9], 5), 5);
    }

    #[test]
    fn bytes_after_the_nul_are_cleared() {
        let mut text = Text::from_wire(*b"ab\0cdefg");
        text.push_str("xy\0z");
        assert_eq!(text.as_bytes(), b"abxy");
        assert_eq!(Text::<8>::new("ab\0cd").wire(), b"ab\0\0\0\0\0\0");
        assert_eq!(Text::<2>::from_wire(*b"ab").as_ref(), b"ab");
    }

    fn built(push: impl FnOnce(&mut Text<20>)) -> std::string::String {
        let mut text = Text::EMPTY;
        push(&mut text);
        text.as_str().expect("UTF-8").into()
    }

    #[test]
    fn numbers_append_in_decimal() {
        for (number, text) in [(0, "0"), (10, "10"), (4_294_967_295, "4294967295")] {
            assert_eq!(built(|built| built.push_number(number)), text);
        }
        assert_eq!(Text::<9>::new("abcdé").front::<5>().as_str(), Some("abcd"));
        let mut full = Text::<3>::new("a");
        full.push_number(123);
        assert_eq!(full.as_str(), Some("a12"));
        for (number, places, text) in [
            (0, 0, "0"),
            (-1, 0, "-1"),
            (i32::MIN, 0, "-2147483648"),
            (0, 1, "0.0"),
            (5, 1, "0.5"),
            (-5, 2, "-0.05"),
            (1_184, 2, "11.84"),
            (-473_977_418, 7, "-47.3977418"),
            (i32::MAX, 9, "2.147483647"),
            (i32::MIN, 9, "-2.147483648"),
            (1, 200, "0.000000001"),
        ] {
            assert_eq!(built(|built| built.push_decimal(number, places)), text);
        }
        for (number, digits, text) in [
            (0, 0, "0"),
            (0, 2, "00"),
            (0xBEEF, 0, "BEEF"),
            (0xA, 4, "000A"),
            (u32::MAX, 2, "FFFFFFFF"),
            (1, 99, "00000001"),
        ] {
            assert_eq!(built(|built| built.push_hex(number, digits)), text);
        }
    }

    proptest::proptest! {
        /// Numbers are written as `core::fmt` writes them.
        #[test]
        fn numbers_are_written_as_by_fmt(number: i32, places in 0usize..10, digits in 0usize..9) {
            let power = 10i64.pow(places as u32);
            let (whole, part) = (i64::from(number).abs() / power, i64::from(number).abs() % power);
            let sign = if number < 0 { "-" } else { "" };
            let expected = if places == 0 { std::format!("{number}") } else { std::format!("{sign}{whole}.{part:0places$}") };
            proptest::prop_assert_eq!(built(|text| text.push_decimal(number, places as u8)), expected);
            proptest::prop_assert_eq!(built(|text| text.push_signed(number)), std::format!("{number}"));
            let number = number.cast_unsigned();
            proptest::prop_assert_eq!(built(|text| text.push_number(number)), std::format!("{number}"));
            proptest::prop_assert_eq!(built(|text| text.push_hex(number, digits as u8)), std::format!("{number:0digits$X}"));
        }
    }
}
