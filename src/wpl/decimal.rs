//! Exact conversion of decimal text to numbers, with integer arithmetic (W-1, W-4, W-8).

use super::Fault;
use super::wide::{INFINITY, Wide};

/// The parts of a finite number: its digits before and after the point, and its exponent.
struct Decimal<'a> {
    whole: &'a [u8],
    fraction: &'a [u8],
    exponent: i32,
}

impl Decimal<'_> {
    fn digits(&self) -> impl DoubleEndedIterator<Item = u8> + Clone {
        self.whole.iter().chain(self.fraction).map(|byte| byte.wrapping_sub(b'0'))
    }

    /// Returns the number of digits, and how many of them are before the point once the exponent is applied. The latter
    /// may be negative, or larger than the number of digits.
    fn point(&self) -> (usize, i32) {
        let count = self.whole.len().saturating_add(self.fraction.len());
        (count, i32::try_from(self.whole.len()).unwrap_or(i32::MAX).saturating_add(self.exponent))
    }

    /// Returns the bits of the nearest `f32`; `None` if that is infinity.
    fn bits(&self) -> Option<u32> {
        let (count, point) = self.point();
        let before = usize::try_from(point).unwrap_or(0);
        let mut wide = Wide::ZERO;
        // First the digits after the point, from the right.
        for digit in self.digits().rev().take(count.saturating_sub(before)) {
            wide.push_behind_point(digit);
        }
        // A number with 64 zeros after the point is below half of the smallest `f32`.
        for _ in 0..point.saturating_neg().clamp(0, 64) {
            wide.push_behind_point(0);
        }
        for digit in self.digits().take(before) {
            wide.push(digit).then_some(())?;
        }
        if !wide.is_zero() {
            for _ in count..before {
                wide.push(0).then_some(())?;
            }
        }
        wide.round()
    }

    /// Returns the magnitude times 10^`decimals`, rounded half away from zero. With `decimals` 0 it must be whole.
    fn scaled(&self, decimals: u8) -> Result<u32, Fault> {
        let (_, point) = self.point();
        let mut left = point.saturating_add(decimals.into());
        let mut digits = self.digits();
        let mut value = 0u32;
        while left > 0 {
            let digit = match digits.next() {
                Some(digit) => digit,
                None if value == 0 => return Ok(0),
                None => 0,
            };
            value = value.checked_mul(10).and_then(|value| value.checked_add(digit.into())).ok_or(Fault::Range)?;
            left = left.saturating_sub(1);
        }
        if decimals == 0 {
            return if digits.all(|digit| digit == 0) { Ok(value) } else { Err(Fault::Fraction) };
        }
        let up = left == 0 && digits.next().is_some_and(|digit| digit >= 5);
        value.checked_add(up.into()).ok_or(Fault::Range)
    }
}

/// The magnitude of a number.
enum Number<'a> {
    Nan,
    Infinite,
    Finite(Decimal<'a>),
}

/// Splits off the leading digits.
fn split_digits(text: &[u8]) -> (&[u8], &[u8]) {
    let end = text.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(text.len());
    text.split_at_checked(end).unwrap_or_default()
}

/// Splits off the sign: returns whether it is negative, and the rest.
fn split_sign(text: &[u8]) -> (bool, &[u8]) {
    match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, text),
    }
}

/// Parses `[+-] (digits [. [digits]] | . digits) [(e|E) [+-] digits]`, or `[+-] (nan | inf)` in upper or lower case
/// (W-1). Returns whether it is negative, and its magnitude.
fn split(text: &[u8]) -> Option<(bool, Number<'_>)> {
    let (negative, text) = split_sign(text);
    if text.eq_ignore_ascii_case(b"nan") {
        return Some((negative, Number::Nan));
    }
    if text.eq_ignore_ascii_case(b"inf") {
        return Some((negative, Number::Infinite));
    }
    let (whole, mut rest) = split_digits(text);
    let mut fraction: &[u8] = &[];
    if let [b'.', after @ ..] = rest {
        (fraction, rest) = split_digits(after);
    }
    let mut exponent = 0i32;
    if let [b'e' | b'E', signed @ ..] = rest {
        let (is_negative, text) = split_sign(signed);
        let (digits, after) = split_digits(text);
        if digits.is_empty() {
            return None;
        }
        for digit in digits {
            // No column is long enough to compensate an exponent of 100,000.
            let digit = digit.wrapping_sub(b'0').into();
            exponent = exponent.saturating_mul(10).saturating_add(digit).min(100_000);
        }
        exponent = if is_negative { exponent.saturating_neg() } else { exponent };
        rest = after;
    }
    let is_number = rest.is_empty() && !(whole.is_empty() && fraction.is_empty());
    is_number.then_some((negative, Number::Finite(Decimal { whole, fraction, exponent })))
}

/// Returns the nearest `f32`. A finite number that rounds to infinity is out of range.
pub(super) fn parse_f32(text: &[u8]) -> Result<f32, Fault> {
    let (negative, number) = split(text).ok_or(Fault::Number)?;
    let bits = match number {
        Number::Nan => return Ok(f32::NAN),
        Number::Infinite => INFINITY,
        Number::Finite(decimal) => decimal.bits().ok_or(Fault::Range)?,
    };
    Ok(f32::from_bits(bits | u32::from(negative) << 31))
}

/// Returns the number times 10^`decimals`, rounded half away from zero. With `decimals` 0 the number must be whole.
///
/// NaN gives `i32::MAX`, "not given" (M-70). Another number that gives `i32::MAX` is out of range, unless `decimals` is
/// 0.
pub(super) fn parse_scaled(text: &[u8], decimals: u8) -> Result<i32, Fault> {
    let (negative, number) = split(text).ok_or(Fault::Number)?;
    let magnitude = match number {
        Number::Nan => return Ok(i32::MAX),
        Number::Infinite => return Err(Fault::Range),
        Number::Finite(decimal) => decimal.scaled(decimals)?,
    };
    let value = if negative { 0i32.checked_sub_unsigned(magnitude) } else { 0i32.checked_add_unsigned(magnitude) };
    value.filter(|value| decimals == 0 || *value != i32::MAX).ok_or(Fault::Range)
}

/// Parses an integer, which has only digits.
pub(super) fn parse_integer(text: &[u8]) -> Result<u16, Fault> {
    let (digits, rest) = split_digits(text);
    if digits.is_empty() || !rest.is_empty() {
        return Err(Fault::Number);
    }
    Decimal { whole: digits, fraction: &[], exponent: 0 }.scaled(0)?.try_into().map_err(|_| Fault::Range)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wpl::line::Line;
    use crate::wpl::wide::shortest;
    use proptest::prelude::*;
    use std::format;
    use std::string::{String, ToString};

    /// Fewer in debug builds, where a case takes a twentieth of a millisecond.
    const CASES: usize = if cfg!(debug_assertions) { 5_000 } else { 1_000_000 };

    fn written(value: f32) -> String {
        let mut line = Line::new();
        line.push_f32(value);
        String::from_utf8(line.as_bytes().to_vec()).unwrap()
    }

    fn scaled(value: i32, decimals: u8) -> String {
        let mut line = Line::new();
        line.push_scaled(value, decimals);
        String::from_utf8(line.as_bytes().to_vec()).unwrap()
    }

    /// Asserts that `text` is read as `std` reads it. Numbers that `std` reads as infinite are out of range.
    fn assert_reads(text: &str) {
        let expected: f32 = text.parse().unwrap();
        let expected = if expected.is_infinite() { Err(Fault::Range) } else { Ok(expected.to_bits()) };
        assert_eq!(parse_f32(text.as_bytes()).map(f32::to_bits), expected, "{text}");
    }

    /// Asserts that the digits are those of `std`, and that they read back as the same number.
    fn assert_shortest(bits: u32) {
        let value = f32::from_bits(bits);
        let (digits, exponent) = shortest(bits);
        let digits = digits.to_string();
        let (first, rest) = digits.split_at(1);
        let point = if rest.is_empty() { "" } else { "." };
        let power = exponent + i32::try_from(rest.len()).unwrap();
        assert_eq!(format!("{first}{point}{rest}e{power}"), format!("{value:e}"));
        for value in [value, -value] {
            let text = written(value);
            assert!(text.len() <= 16, "{text}");
            assert_eq!(parse_f32(text.as_bytes()).map(f32::to_bits), Ok(value.to_bits()), "{text}");
            assert_eq!(text.parse::<f32>().unwrap().to_bits(), value.to_bits(), "{text}");
        }
    }

    /// Asserts that the midpoint to the next larger float is read correctly, and so are numbers just above and below
    /// it.
    fn assert_midpoint(bits: u32) {
        let half = |bits| f64::from(f32::from_bits(bits));
        // Exact in an `f64`: the midpoint has one bit more than an `f32`. After the largest `f32` comes 2^128.
        let next = if bits + 1 < INFINITY { half(bits + 1) } else { 2f64.powi(128) };
        let middle = format!("{:.150}", (half(bits) + next) / 2.0);
        assert_reads(&middle);
        assert_reads(&format!("{middle}000000000000000000000000001"));
        // A half bit, which a `Wide` holds exactly, and smaller differences, which it does not. There are 150 decimals.
        for (place, digit) in [(150, b'5'), (130, b'1'), (100, b'1')] {
            let mut above = middle.clone().into_bytes();
            let at = above.len() - place;
            above[at] = above[at].max(digit);
            assert_reads(&String::from_utf8(above).unwrap());
        }
        let mut below = middle.into_bytes();
        for digit in below.iter_mut().rev().filter(|byte| byte.is_ascii_digit()) {
            *digit = if *digit == b'0' { b'9' } else { *digit - 1 };
            if *digit != b'9' {
                break;
            }
        }
        assert_reads(&String::from_utf8(below).unwrap());
    }

    fn random(state: &mut u64) -> u32 {
        // Marsaglia's xorshift.
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        (*state >> 32) as u32
    }

    /// Bits of positive, finite floats: edge cases, then random ones.
    fn samples() -> impl Iterator<Item = u32> {
        let mut state = 1;
        let edges = (0..255u32).flat_map(|exponent| {
            [0, 1, 2, 0x3F_FFFF, 0x40_0000, 0x40_0001, 0x7F_FFFE, 0x7F_FFFF].map(|low| exponent << 23 | low)
        });
        edges.chain(core::iter::repeat_with(move || random(&mut state) & 0x7FFF_FFFF).filter(|bits| *bits < INFINITY))
    }

    #[test]
    fn floats_are_written_as_the_shortest_decimal_that_reads_back() {
        // W-4
        samples().take(2_040 + CASES).for_each(assert_shortest);
        // Numbers as in plans, and ties: between 2^20 and 2^24 a fraction can be halfway between two decimals.
        (0..2_000).for_each(|number: u32| assert_shortest((number as f32 / 100.0).to_bits()));
        (0..2_000).for_each(|number: u32| assert_shortest((2_097_152.0 + number as f32 / 4.0).to_bits()));
    }

    #[test]
    fn floats_are_read_as_the_nearest() {
        samples().take(2_040 + CASES / 20).for_each(assert_midpoint);
        for bits in samples().take(2_040 + CASES / 10) {
            let value = f32::from_bits(bits);
            for text in [format!("{value:e}"), format!("{value}"), format!("{value:.6}"), format!("{value:.9e}")] {
                assert_reads(&text);
                assert_reads(&format!("-{text}"));
            }
        }
    }

    #[test]
    fn numbers_of_any_length_are_read() {
        let zeros = "0".repeat(400);
        for text in [
            &format!("0.{zeros}1e401"),
            &format!("{zeros}1{zeros}e-400"),
            &format!("1{zeros}.5e-400"),
            &format!("0.{zeros}1e380"),
            &format!("1{zeros}"),
            &format!("0.{zeros}1"),
            &format!("0.{zeros}"),
            &format!("{zeros}e99999999999"),
            "1e99999999999",
            "1e-99999999999",
            "1e+000000000038",
            "16777217.000000000000000000000000000000000000000000000000000000000000000000000000000000001",
            "340282356779733661637539395458142568447.99999999999999999999999999999999999999999999999999999999999999999",
            "340282356779733661637539395458142568448",
            "0.000000000000000000000000000000000000000000000700649232162408535461864791644958065640130970938257885",
            "7.0064923216240853546186479164495806564013097093825788587853E-46",
        ] {
            assert_reads(text);
            assert_reads(&format!("-{text}"));
        }
    }

    #[test]
    fn syntax_of_numbers() {
        // W-1, W-8
        for (text, expected) in [
            ("0", 0.0),
            ("+0", 0.0),
            ("-0", -0.0),
            ("-0e5", -0.0),
            ("007", 7.0),
            ("1.", 1.0),
            (".5", 0.5),
            ("-.5", -0.5),
            ("1.5e3", 1_500.0),
            ("1E+2", 100.0),
            ("15e-1", 1.5),
            ("inf", f32::INFINITY),
            ("-Inf", f32::NEG_INFINITY),
            ("+INF", f32::INFINITY),
            ("nan", f32::NAN),
            ("-NaN", f32::NAN),
        ] {
            assert_eq!(parse_f32(text.as_bytes()).map(f32::to_bits), Ok(expected.to_bits()), "{text}");
        }
        for text in [
            "", "-", "+", ".", "-.", "e5", ".e5", "1e", "1e+", "1e5.0", "--1", "+-1", "1-", "1,5", "1 ", "0x10", "1_0",
            "1.2.3", "1f", "nan0", "nanny", "infinity", "1.#QNAN", "-1.#IND", "∞", "½", "１",
        ] {
            assert_eq!(parse_f32(text.as_bytes()), Err(Fault::Number), "{text}");
            assert_eq!(parse_scaled(text.as_bytes(), 7), Err(Fault::Number), "{text}");
            assert_eq!(parse_integer(text.as_bytes()), Err(Fault::Number), "{text}");
        }
        for text in ["1e39", "-1e39", "340282356779733661637539395458142568448", "1e100"] {
            assert_eq!(parse_f32(text.as_bytes()), Err(Fault::Range), "{text}");
        }
    }

    #[test]
    fn syntax_of_integers() {
        for (text, expected) in [
            ("0", Ok(0)),
            ("00016", Ok(16)),
            ("65535", Ok(65_535)),
            ("65536", Err(Fault::Range)),
            ("99999999999999999999", Err(Fault::Range)),
            ("-1", Err(Fault::Number)),
            ("+1", Err(Fault::Number)),
            ("1.0", Err(Fault::Number)),
            ("1e1", Err(Fault::Number)),
            ("nan", Err(Fault::Number)),
        ] {
            assert_eq!(parse_integer(text.as_bytes()), expected, "{text}");
        }
    }

    #[test]
    fn coordinates_are_exact() {
        // W-4
        for (text, decimals, expected) in [
            ("47.3977420", 7, Ok(473_977_420)),
            ("47.397741999999998", 7, Ok(473_977_420)),
            ("-8.545594", 7, Ok(-85_455_940)),
            ("0.00000005", 7, Ok(1)),
            ("-0.00000005", 7, Ok(-1)),
            ("0.0000000499999999999999999999999999", 7, Ok(0)),
            ("0.000000005", 7, Ok(0)),
            ("5e-8", 7, Ok(1)),
            ("9e-9", 7, Ok(0)),
            ("4.73977420e+01", 7, Ok(473_977_420)),
            ("473977420e-7", 7, Ok(473_977_420)),
            ("1e-100000000000", 7, Ok(0)),
            ("0e100000000000", 7, Ok(0)),
            ("-0", 7, Ok(0)),
            ("214.7483646", 7, Ok(i32::MAX - 1)),
            ("214.74836464999", 7, Ok(i32::MAX - 1)),
            ("214.7483647", 7, Err(Fault::Range)),
            ("214.74836465", 7, Err(Fault::Range)),
            ("-214.7483648", 7, Ok(i32::MIN)),
            ("-214.7483649", 7, Err(Fault::Range)),
            ("429.4967295", 7, Err(Fault::Range)),
            ("429.49672955", 7, Err(Fault::Range)),
            ("1e100000000000", 7, Err(Fault::Range)),
            ("inf", 7, Err(Fault::Range)),
            ("-NaN", 7, Ok(i32::MAX)),
            ("12.34565", 4, Ok(123_457)),
            ("-123456.7", 4, Ok(-1_234_567_000)),
            ("214748.3647", 4, Err(Fault::Range)),
            ("7.000", 0, Ok(7)),
            ("70e-1", 0, Ok(7)),
            ("-2147483648", 0, Ok(i32::MIN)),
            ("2147483647", 0, Ok(i32::MAX)),
            ("2147483648", 0, Err(Fault::Range)),
            ("nan", 0, Ok(i32::MAX)),
            ("0.5", 0, Err(Fault::Fraction)),
            ("7.0000000000000000000000000001", 0, Err(Fault::Fraction)),
            ("1e-5", 0, Err(Fault::Fraction)),
        ] {
            assert_eq!(parse_scaled(text.as_bytes(), decimals), expected, "{text}");
        }
        for (value, decimals, text) in [
            (0, 7, "0.0000000"),
            (-1, 7, "-0.0000001"),
            (473_977_420, 7, "47.3977420"),
            (10_000_000, 7, "1.0000000"),
            (i32::MIN, 7, "-214.7483648"),
            (i32::MAX, 7, "nan"),
            (i32::MAX - 1, 4, "214748.3646"),
            (0, 0, "0"),
            (-120, 0, "-120"),
        ] {
            assert_eq!(scaled(value, decimals), text);
        }
    }

    #[test]
    fn short_floats_are_written_without_exponent() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "-0"),
            (1.0, "1"),
            (-0.1, "-0.1"),
            (488.1, "488.1"),
            (16_777_216.0, "16777216"),
            (9_999_999_000.0, "9999999000"),
            (1e10, "1e10"),
            (0.000_012_345_679, "0.000012345679"),
            (0.000_001, "1e-6"),
            (f32::MAX, "3.4028235e38"),
            (f32::MIN_POSITIVE, "1.1754944e-38"),
            (f32::from_bits(1), "1e-45"),
            (f32::NAN, "nan"),
            (f32::INFINITY, "inf"),
            (f32::NEG_INFINITY, "-inf"),
        ] {
            assert_eq!(written(value), text);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]

        #[test]
        fn coordinates_survive_a_round_trip(value: i32, decimals in prop::sample::select(&[0u8, 4, 7])) {
            prop_assert_eq!(parse_scaled(scaled(value, decimals).as_bytes(), decimals), Ok(value));
        }

        #[test]
        fn coordinates_are_rounded_once(whole in 0u32..200, fraction in "[0-9]{0,20}", negative: bool) {
            // In units of 1e-20: add half of 1e-7 and truncate.
            let units = i128::from(whole) * 10i128.pow(20) + format!("{fraction:0<20}").parse::<i128>().unwrap();
            let expected = i32::try_from((units + 5 * 10i128.pow(12)) / 10i128.pow(13)).unwrap();
            let text = format!("{}{whole}.{fraction}", if negative { "-" } else { "" });
            prop_assert_eq!(parse_scaled(text.as_bytes(), 7), Ok(if negative { -expected } else { expected }));
        }

        #[test]
        fn decimals_are_read_as_by_std(text in r"-?[0-9]{0,50}\.[0-9]{1,60}(e-?[0-9]{1,2})?") {
            assert_reads(&text);
        }

        #[test]
        fn any_text_is_a_number_exactly_if_std_reads_it(text in prop_oneof![
            prop::collection::vec(any::<u8>(), 0..20),
            r"[-+]?[0-9.]{0,8}[eEnaif]?[-+0-9.]{0,8}".prop_map(String::into_bytes),
        ]) {
            let is_number = std::str::from_utf8(&text).is_ok_and(|text| text.parse::<f32>().is_ok());
            prop_assert_eq!(parse_f32(&text) != Err(Fault::Number), is_number);
            prop_assert_eq!(parse_scaled(&text, 7) != Err(Fault::Number), is_number);
        }
    }
}
