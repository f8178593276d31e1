//! Conversions between floats and integers. No other module uses `as` for them.
//!
//! They are defined for all inputs, including NaN and infinities. They do not use `f64`, which microcontrollers emulate
//! in software. Degrees are scaled by integer arithmetic on the float's parts, so the result is the exact product,
//! rounded once (C-6, M-37). Conversions to integers saturate (L-22).

use core::num::NonZeroU32;

/// Number of bits of an `f32` below the exponent.
const FRACTION_BITS: u32 = 23;
const FRACTION: u32 = (1 << FRACTION_BITS) - 1;

/// Returns `degrees`·1e7, rounded half away from zero. `None` for NaN, infinities, results that do not fit in an `i32`,
/// and `i32::MAX`, which means "not given" on the wire (M-70).
pub(crate) fn scale_1e7(degrees: f32) -> Option<i32> {
    let bits = degrees.to_bits();
    let exponent = (bits >> FRACTION_BITS) & 0xFF;
    // degrees = significand · 2^-shift. A shift below 16 means 256 degrees or more, or not a number.
    let shift = 150u32.checked_sub(exponent.max(1)).filter(|shift| *shift >= 16)?;
    let hidden = if exponent == 0 { 0 } else { 1 << FRACTION_BITS };
    let product = u64::from((bits & FRACTION) | hidden).wrapping_mul(10_000_000);
    // The product has at most 48 bits: a shift of 49 or more gives zero, even with rounding.
    let shift = shift.min(49);
    let half = 1u64.wrapping_shl(shift.wrapping_sub(1));
    let magnitude = i64::try_from(product.wrapping_add(half).wrapping_shr(shift)).ok()?;
    let value = if degrees.is_sign_negative() { magnitude.wrapping_neg() } else { magnitude };
    i32::try_from(value).ok().filter(|value| *value != i32::MAX)
}

/// Returns `scaled`/1e7, correctly rounded; NaN for `i32::MAX`, which means "not given" (M-70).
pub(crate) fn from_1e7(scaled: i32) -> f32 {
    /// 5^7. As 1e7 is 5^7·2^7, the rest only changes the exponent.
    const FIVES: u32 = 78_125;

    match scaled {
        0 => return 0.0,
        i32::MAX => return f32::NAN,
        _ => {}
    }
    let magnitude = scaled.unsigned_abs();
    // Long division to 15 more bits than a 32-bit quotient has, with a sticky bit for the remainder. The quotient has
    // at least 30 bits, which the conversion to a float rounds once to 24.
    let zeros = magnitude.leading_zeros();
    let dividend = magnitude.wrapping_shl(zeros);
    let rest = (dividend % FIVES).wrapping_shl(15);
    let quotient = (dividend / FIVES).wrapping_shl(15) | (rest / FIVES) | u32::from(!rest.is_multiple_of(FIVES));
    // quotient = magnitude / 5^7 · 2^(zeros + 15)
    let exponent = zeros.wrapping_add(15 + 7).wrapping_shl(FRACTION_BITS);
    let sign = if scaled < 0 { 1 << 31 } else { 0 };
    f32::from_bits(f32_from_u32(quotient).to_bits().wrapping_sub(exponent) | sign)
}

/// Returns the nearest float; NaN for `i32::MAX`, which means "not given".
#[allow(clippy::as_conversions, reason = "integer to float is total: it rounds to the nearest")]
pub(crate) fn from_i32(value: i32) -> f32 {
    if value == i32::MAX { f32::NAN } else { value as f32 }
}

/// Returns the nearest float, also for `i32::MAX`.
#[allow(clippy::as_conversions, reason = "integer to float is total: it rounds to the nearest")]
pub(crate) fn f32_from_i32(value: i32) -> f32 {
    value as f32
}

/// Returns the nearest float.
#[allow(clippy::as_conversions, reason = "integer to float is total: it rounds to the nearest")]
pub(crate) fn f32_from_u32(value: u32) -> f32 {
    value as f32
}

/// Returns `value` as an integer; `None` for NaN, infinities, fractions, and values that do not fit in a `u32`.
#[allow(clippy::as_conversions, reason = "saturates, and a saturated value does not compare equal")]
pub(crate) fn unsigned(value: f32) -> Option<u32> {
    let integer = value as u32;
    // 2^32 - 1 is not an `f32`: see `exact`.
    (integer as f32 == value && integer != u32::MAX).then_some(integer)
}

/// Returns `value` rounded towards zero and saturated to the range of a `u32`; 0 for NaN.
#[allow(clippy::as_conversions, reason = "float to integer is total: it saturates")]
pub(crate) fn saturated(value: f32) -> u32 {
    value as u32
}

/// Returns the quotient, rounded down. The divisor must be below 2^16. It replaces the compiler's 64-bit division,
/// which takes 900 bytes of flash.
// Out of line: it has several callers.
#[inline(never)]
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; u32 to u64")]
#[allow(clippy::arithmetic_side_effects, reason = "the divisor is not 0, and `digits` is at most 4")]
pub(crate) const fn quotient(dividend: u64, divisor: NonZeroU32) -> u64 {
    let (mut left, mut quotient, mut rest) = (dividend, 0u64, 0u32);
    let mut digits = 0;
    // Long division with digits of 16 bits: the rest is below the divisor, so it fits in front of the next digit.
    while digits < 4 {
        let [high, low, ..] = left.to_be_bytes();
        left = left.wrapping_shl(16);
        let part = rest.wrapping_shl(16) | u32::from_be_bytes([0, 0, high, low]);
        quotient = quotient.wrapping_shl(16) | (part / divisor.get()) as u64;
        rest = part % divisor.get();
        digits += 1;
    }
    quotient
}

/// Returns `value` rounded half away from zero and clamped to `min` and `max`; `unknown` for NaN.
// Out of line: it has several callers.
#[inline(never)]
#[allow(clippy::as_conversions, reason = "both are total: float to integer saturates, integer to float rounds")]
pub(crate) fn nearest(value: f32, min: i32, max: i32, unknown: i32) -> i32 {
    if value.is_nan() {
        return unknown;
    }
    let whole = value as i32;
    // Exact below 2^23, where floats have fractions. Above, `rest` only has to leave the saturated integer unchanged.
    let rest = value - whole as f32;
    let step = i32::from(rest >= 0.5).saturating_sub(i32::from(rest <= -0.5));
    whole.saturating_add(step).min(max).max(min)
}

/// Returns the low byte of a number, which is all of it if a `u8` or an `i8` can hold it.
pub(crate) fn byte(value: i32) -> u8 {
    let [low, ..] = value.to_le_bytes();
    low
}

/// Returns the lower half of a number, which is all of it if a `u16` or an `i16` can hold it.
pub(crate) fn half(value: i32) -> u16 {
    let [low, high, ..] = value.to_le_bytes();
    u16::from_le_bytes([low, high])
}

/// Returns `value` as an integer; `None` for NaN, infinities, fractions, and values that do not fit in `T` or an `i32`.
pub(crate) fn integer<T: TryFrom<i32>>(value: f32) -> Option<T> {
    exact(value).and_then(|integer| T::try_from(integer).ok())
}

/// Returns `value` as an integer, as [`integer`].
// Out of line: it has several callers.
#[inline(never)]
#[allow(clippy::as_conversions, reason = "saturates, and a saturated value does not compare equal")]
fn exact(value: f32) -> Option<i32> {
    let integer = value as i32;
    // 2^31 - 1 is not an `f32`: converted back, the saturated value becomes 2^31 and would compare equal to it.
    (integer as f32 == value && integer != i32::MAX).then_some(integer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn reference_scale(degrees: f32) -> Option<i32> {
        // 24 bits times 24 bits: the product is exact in an `f64`, which rounds half away from zero.
        let product = (f64::from(degrees) * 1e7).round();
        (product >= f64::from(i32::MIN) && product < f64::from(i32::MAX)).then_some(product as i32)
    }

    #[test]
    fn degrees_scale_exactly_at_the_edges() {
        for (degrees, scaled) in [
            (0.0, Some(0)),
            (-0.0, Some(0)),
            (90.0, Some(900_000_000)),
            (-180.0, Some(-1_800_000_000)),
            (f32::from_bits(1), Some(0)),
            (0.5e-7, Some(1)),
            (-0.5e-7, Some(-1)),
            (0.499e-7, Some(0)),
            (256.0, None),
            (-214.8, None),
            (f32::MAX, None),
            (f32::NAN, None),
            (f32::INFINITY, None),
            (f32::NEG_INFINITY, None),
        ] {
            assert_eq!(scale_1e7(degrees), scaled, "{degrees:e}");
        }
        let mut degrees = 214.748;
        while degrees < 214.749 {
            assert_eq!(scale_1e7(degrees), reference_scale(degrees), "{degrees}");
            assert_eq!(scale_1e7(-degrees), reference_scale(-degrees), "-{degrees}");
            degrees = degrees.next_up();
        }
    }

    #[test]
    fn not_given_is_nan() {
        assert!(from_1e7(i32::MAX).is_nan());
        assert!(from_i32(i32::MAX).is_nan());
        assert_eq!((from_1e7(0), from_i32(0)), (0.0, 0.0));
    }

    #[test]
    fn only_integral_values_convert_to_integers() {
        assert_eq!(integer::<i32>(-1.0), Some(-1));
        assert_eq!(integer::<u16>(-1.0), None);
        assert_eq!(integer::<u16>(65_535.0), Some(65_535));
        assert_eq!(integer::<u16>(65_536.0), None);
        assert_eq!(integer::<i32>(-0.0), Some(0));
        assert_eq!(integer::<i32>(-2_147_483_648.0), Some(i32::MIN));
        for value in [0.5, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 2_147_483_648.0, -3e9, f32::MIN_POSITIVE] {
            assert_eq!(integer::<i32>(value), None, "{value:e}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn scaling_equals_f64(bits: u32) {
            let degrees = f32::from_bits(bits);
            prop_assert_eq!(scale_1e7(degrees), reference_scale(degrees));
        }

        #[test]
        fn scaling_equals_f64_on_the_globe(degrees in -215.0f32..215.0) {
            prop_assert_eq!(scale_1e7(degrees), reference_scale(degrees));
        }

        #[test]
        fn degrees_are_the_nearest_float(scaled: i32) {
            prop_assume!(scaled != i32::MAX);
            let degrees = from_1e7(scaled);
            // In units of 2^-60 everything here is an integer: a float below 256 has no bit under 2^-47.
            let exact = |value: f32| (f64::from(value) * 1e7 * (1u64 << 60) as f64) as i128;
            let wanted = i128::from(scaled) << 60;
            let error = (exact(degrees) - wanted).abs();
            for neighbour in [degrees.next_up(), degrees.next_down()] {
                prop_assert!(error <= (exact(neighbour) - wanted).abs(), "{} is nearer than {}", neighbour, degrees);
            }
        }

        #[test]
        fn degrees_survive_a_round_trip(degrees in -180.0f32..180.0) {
            // From 1 degree on, a float's step is at least 1.2e-7, more than that of the integer.
            prop_assume!(degrees.abs() >= 1.0);
            prop_assert_eq!(from_1e7(scale_1e7(degrees).unwrap()), degrees);
        }

        #[test]
        fn integers_survive_a_round_trip(value in -(1i32 << 24)..(1 << 24)) {
            prop_assert_eq!(integer(from_i32(value)), Some(value));
        }

        #[test]
        fn integer_agrees_with_f64(bits: u32) {
            let value = f32::from_bits(bits);
            let wide = f64::from(value);
            let expected = (wide.trunc() == wide && wide >= f64::from(i32::MIN) && wide <= f64::from(i32::MAX))
                .then_some(wide as i32);
            prop_assert_eq!(integer::<i32>(value), expected);
            let expected = (wide.trunc() == wide && wide >= 0.0 && wide <= f64::from(u32::MAX)).then_some(wide as u32);
            prop_assert_eq!(unsigned(value), expected);
        }

        #[test]
        fn quotient_agrees_with_the_compilers_division(dividend: u64, shift in 0u32..64, divisor in 1u32..1 << 16) {
            let dividend = dividend >> shift;
            let by = NonZeroU32::new(divisor).unwrap();
            prop_assert_eq!(quotient(dividend, by), dividend / u64::from(divisor));
        }

        #[test]
        fn nearest_agrees_with_f64(bits: u32, min in -70_000i32..0, max in 0i32..70_000) {
            let value = f32::from_bits(bits);
            let expected = f64::from(value).round().clamp(f64::from(min), f64::from(max));
            let unknown = 123_456;
            let or_unknown = |expected: f64| if value.is_nan() { unknown } else { expected as i32 };
            prop_assert_eq!(nearest(value, min, max, unknown), or_unknown(expected));
            let expected = f64::from(value).round().clamp(f64::from(i32::MIN), f64::from(i32::MAX));
            prop_assert_eq!(nearest(value, i32::MIN, i32::MAX, unknown), or_unknown(expected));
        }

        #[test]
        fn nearest_agrees_with_f64_around_the_halves(halves in -600i32..600, ulps in -2i32..3) {
            let value = halves as f32 / 2.0;
            let value = f32::from_bits(value.to_bits().wrapping_add_signed(if halves == 0 { ulps.abs() } else { ulps }));
            let expected = f64::from(value).round() as i32;
            prop_assert_eq!(nearest(value, i32::MIN, i32::MAX, 0), expected);
        }

        #[test]
        fn integers_convert_to_the_nearest_float(bits: u32) {
            prop_assert_eq!(f64::from(f32_from_u32(bits)), f64::from(f64::from(bits) as f32));
            let signed = bits.cast_signed();
            prop_assert_eq!(f64::from(f32_from_i32(signed)), f64::from(f64::from(signed) as f32));
        }
    }
}
