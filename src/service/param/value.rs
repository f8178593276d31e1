//! How a parameter's value stands in memory and on the wire (P-2, P-3).
//!
//! In memory a value is 32 bits: those of the float, or the integer in the low bytes with zeros above it. That is also
//! the byte-wise form of the wire.

use crate::dialect::MavParamType;
use crate::num;

const SIGN: u32 = 1 << 31;

/// How integers stand in the float that PARAM_VALUE and PARAM_SET have for a value (P-2). A `f32` is the same in both.
///
/// A PARAM_SET of an integer may name another integer type than the parameter's. Its bytes are read in that type, or as a
/// number with C casts, and the value is accepted if it fits (P-14).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ParamEncoding {
    /// The integer's bytes, put where the float's would stand. What QGroundControl and MAVSDK expect of every autopilot but
    /// ArduPilot.
    Bytewise,
    /// The integer as a number, rounded to a float: beyond 2^24 not every one survives. What pymavlink and MAVProxy expect of
    /// every autopilot but PX4.
    CCast,
}

/// What a parameter can be: the types that PARAM_VALUE has room for (P-3). Implemented by nothing else.
pub trait ParamType: Copy + sealed::Sealed {}

mod sealed {
    /// The crate's own half of [`ParamType`](super::ParamType).
    pub trait Sealed {
        #[doc(hidden)]
        fn to_bits(self) -> u32;
        #[doc(hidden)]
        fn from_bits(bits: u32) -> Self;
    }
}

pub(super) use sealed::Sealed;

macro_rules! param_type {
    ($($ty:ident),+: integers) => { $(
        impl ParamType for $ty {}

        impl Sealed for $ty {
            #[inline]
            fn to_bits(self) -> u32 {
                let mut bits = [0; 4];
                for (to, from) in bits.iter_mut().zip(self.to_le_bytes()) {
                    *to = from;
                }
                u32::from_le_bytes(bits)
            }

            #[inline]
            fn from_bits(bits: u32) -> Self {
                let bits = bits.to_le_bytes();
                bits.first_chunk().map_or(0, |low| Self::from_le_bytes(*low))
            }
        }
    )+ };
}

param_type! { u8, i8, u16, i16, u32, i32: integers }

impl ParamType for f32 {}

impl Sealed for f32 {
    #[inline]
    fn to_bits(self) -> u32 {
        Self::to_bits(self)
    }

    #[inline]
    fn from_bits(bits: u32) -> Self {
        Self::from_bits(bits)
    }
}

/// Bytes that a value of this type has.
pub(super) const fn size(r#type: MavParamType) -> usize {
    match r#type {
        MavParamType::UINT8 | MavParamType::INT8 => 1,
        MavParamType::UINT16 | MavParamType::INT16 => 2,
        _ => 4,
    }
}

/// Bits above a value of this type.
const fn spare_bits(r#type: MavParamType) -> u32 {
    match size(r#type) {
        1 => 24,
        2 => 16,
        _ => 0,
    }
}

const fn is_signed(r#type: MavParamType) -> bool {
    matches!(r#type, MavParamType::INT8 | MavParamType::INT16 | MavParamType::INT32)
}

/// Whether it is a type that we can have (P-3).
pub(super) const fn is_supported(r#type: MavParamType) -> bool {
    matches!(
        r#type,
        MavParamType::UINT8
            | MavParamType::INT8
            | MavParamType::UINT16
            | MavParamType::INT16
            | MavParamType::UINT32
            | MavParamType::INT32
            | MavParamType::REAL32
    )
}

/// A number with the same order as the values of a type; `None` for NaN and the infinities, which are none.
pub(super) const fn rank(r#type: MavParamType, bits: u32) -> Option<u32> {
    if !matches!(r#type, MavParamType::REAL32) {
        let high = bits.wrapping_shl(spare_bits(r#type));
        return Some(if is_signed(r#type) { high ^ SIGN } else { high });
    }
    match bits {
        // Minus zero is not less than zero.
        SIGN => Some(SIGN),
        _ if bits & 0x7F80_0000 == 0x7F80_0000 => None,
        _ if bits & SIGN == 0 => Some(bits | SIGN),
        _ => Some(!bits),
    }
}

/// The value as PARAM_VALUE has it.
pub(super) fn to_wire(encoding: ParamEncoding, r#type: MavParamType, bits: u32) -> f32 {
    if encoding == ParamEncoding::Bytewise || r#type == MavParamType::REAL32 {
        return f32::from_bits(bits);
    }
    if is_signed(r#type) { num::f32_from_i32(extended(r#type, bits)) } else { num::f32_from_u32(bits) }
}

/// The value that PARAM_SET has; `None` when it is none of this type. Of the bytes of a small integer those above it do not
/// count: clients differ in what stands there.
pub(super) fn from_wire(encoding: ParamEncoding, r#type: MavParamType, value: f32) -> Option<u32> {
    let spare = spare_bits(r#type);
    let low = |bits: u32| bits.wrapping_shl(spare).wrapping_shr(spare);
    if encoding == ParamEncoding::Bytewise || r#type == MavParamType::REAL32 {
        return Some(low(value.to_bits()));
    }
    if !is_signed(r#type) {
        return num::unsigned(value).filter(|bits| low(*bits) == *bits);
    }
    let integer = num::integer::<i32>(value)?;
    let bits = low(integer.cast_unsigned());
    (extended(r#type, bits) == integer).then_some(bits)
}

/// Converts the value `bits` from one integer type to another; `None` when it does not fit. From float to float the bits are
/// unchanged.
pub(super) fn converted(from: MavParamType, to: MavParamType, bits: u32) -> Option<u32> {
    let spare = spare_bits(to);
    let (value, is_negative) = number(from, bits);
    let low = value.wrapping_shl(spare).wrapping_shr(spare);
    (number(to, low) == (value, is_negative)).then_some(low)
}

/// Returns a value as 32 bits, and whether it is negative.
fn number(r#type: MavParamType, bits: u32) -> (u32, bool) {
    if !is_signed(r#type) {
        return (bits, false);
    }
    let value = extended(r#type, bits);
    (value.cast_unsigned(), value < 0)
}

/// The signed integer.
fn extended(r#type: MavParamType, bits: u32) -> i32 {
    let spare = spare_bits(r#type);
    bits.wrapping_shl(spare).cast_signed().wrapping_shr(spare)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ParamEncoding::{Bytewise, CCast};
    use proptest::prelude::*;

    /// T-P7, P-2: the bytes of a small negative integer, with zeros above; and the same as a number.
    #[test]
    fn both_encodings_of_both_ends_of_every_type() {
        let rows = [
            (MavParamType::UINT8, Sealed::to_bits(255u8), 0x0000_00FF, 255.0),
            (MavParamType::INT8, Sealed::to_bits(-1i8), 0x0000_00FF, -1.0),
            (MavParamType::INT8, Sealed::to_bits(i8::MIN), 0x0000_0080, -128.0),
            (MavParamType::UINT16, Sealed::to_bits(u16::MAX), 0x0000_FFFF, 65_535.0),
            (MavParamType::INT16, Sealed::to_bits(-2i16), 0x0000_FFFE, -2.0),
            (MavParamType::INT16, Sealed::to_bits(i16::MIN), 0x0000_8000, -32_768.0),
            (MavParamType::UINT32, Sealed::to_bits(1u32 << 31), 0x8000_0000, 2_147_483_648.0),
            (MavParamType::INT32, Sealed::to_bits(-3i32), 0xFFFF_FFFD, -3.0),
            (MavParamType::INT32, Sealed::to_bits(i32::MIN), 0x8000_0000, -2_147_483_648.0),
            (MavParamType::REAL32, Sealed::to_bits(-2.5f32), 0xC020_0000, -2.5),
        ];
        for (r#type, bits, bytes, number) in rows {
            assert_eq!(bits, bytes);
            assert_eq!(to_wire(Bytewise, r#type, bits).to_bits(), bytes);
            assert_eq!(from_wire(Bytewise, r#type, f32::from_bits(bytes)), Some(bits));
            assert_eq!(to_wire(CCast, r#type, bits), number);
            assert_eq!(from_wire(CCast, r#type, number), Some(bits));
        }
        // A client that extends the sign, or leaves what was there.
        assert_eq!(from_wire(Bytewise, MavParamType::INT8, f32::from_bits(0xFFFF_FFFE)), Some(0xFE));
        assert_eq!(from_wire(Bytewise, MavParamType::UINT16, f32::from_bits(0xAAAA_0001)), Some(1));
        // Beyond 2^24 a cast rounds.
        assert_eq!(to_wire(CCast, MavParamType::UINT32, (1 << 24) + 1), 16_777_216.0);
    }

    #[test]
    fn what_a_cast_cannot_be() {
        for (r#type, number) in [
            (MavParamType::UINT8, 256.0),
            (MavParamType::UINT8, -1.0),
            (MavParamType::UINT8, 1.5),
            (MavParamType::INT8, 128.0),
            (MavParamType::INT8, -129.0),
            (MavParamType::UINT16, 65_536.0),
            (MavParamType::INT16, -32_769.0),
            (MavParamType::UINT32, 4_294_967_296.0),
            (MavParamType::UINT32, -1.0),
            (MavParamType::INT32, 2_147_483_648.0),
            (MavParamType::INT32, f32::NAN),
            (MavParamType::UINT32, f32::INFINITY),
        ] {
            assert_eq!(from_wire(CCast, r#type, number), None, "{type:?} {number}");
        }
    }

    #[test]
    fn no_number_has_no_rank() {
        for bits in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY].map(f32::to_bits) {
            assert_eq!(rank(MavParamType::REAL32, bits), None);
        }
        assert_eq!(rank(MavParamType::REAL32, (-0.0f32).to_bits()), rank(MavParamType::REAL32, 0));
    }

    const INTEGERS: [(MavParamType, i64, i64); 6] = [
        (MavParamType::UINT8, 0, u8::MAX as i64),
        (MavParamType::INT8, i8::MIN as i64, i8::MAX as i64),
        (MavParamType::UINT16, 0, u16::MAX as i64),
        (MavParamType::INT16, i16::MIN as i64, i16::MAX as i64),
        (MavParamType::UINT32, 0, u32::MAX as i64),
        (MavParamType::INT32, i32::MIN as i64, i32::MAX as i64),
    ];

    /// Returns the bits of an integer in `type`, padded with zeros.
    fn bits_of(r#type: MavParamType, value: i64) -> u32 {
        value as u32 & (u32::MAX >> spare_bits(r#type))
    }

    /// P-14, P-2: integers convert between all types if the value fits, checked at the limits of each type.
    #[test]
    fn an_integer_of_another_type_is_the_same_number_or_none() {
        let borders = INTEGERS.iter().flat_map(|(_, min, max)| [*min, *max]).flat_map(|at| [at - 1, at, at + 1]);
        for value in borders.chain([-2, -1, 0, 1, 2]) {
            for (from, ..) in INTEGERS.iter().filter(|(_, min, max)| (min..=max).contains(&&value)) {
                for (to, min, max) in &INTEGERS {
                    let expected = (min..=max).contains(&&value).then(|| bits_of(*to, value));
                    assert_eq!(converted(*from, *to, bits_of(*from, value)), expected, "{value}: {from:?} to {to:?}");
                }
            }
        }
        let float = (-2.5f32).to_bits();
        assert_eq!(converted(MavParamType::REAL32, MavParamType::REAL32, float), Some(float));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5_000))]

        /// P-14
        #[test]
        fn conversions_keep_the_number(bits: u32, from in 0usize..6, to in 0usize..6) {
            let ((from, ..), (to, min, max)) = (INTEGERS[from], INTEGERS[to]);
            let bits = bits_of(from, i64::from(bits));
            let value = if is_signed(from) { i64::from(extended(from, bits)) } else { i64::from(bits) };
            prop_assert_eq!(converted(from, to, bits), (min..=max).contains(&value).then(|| bits_of(to, value)));
        }

        #[test]
        fn ranks_are_in_the_order_of_the_values(a: u32, b: u32) {
            macro_rules! same_order {
                ($($ty:ident $wire:ident),+) => { $(
                    let (x, y) = (<$ty as Sealed>::from_bits(a), <$ty as Sealed>::from_bits(b));
                    let bits = (Sealed::to_bits(x), Sealed::to_bits(y));
                    if let (Some(p), Some(q)) = (rank(MavParamType::$wire, bits.0), rank(MavParamType::$wire, bits.1)) {
                        prop_assert_eq!(x.partial_cmp(&y), Some(p.cmp(&q)));
                    }
                )+ };
            }
            same_order!(u8 UINT8, i8 INT8, u16 UINT16, i16 INT16, u32 UINT32, i32 INT32, f32 REAL32);
        }

        /// T-P7: what a client reads and sends back is the same, byte-wise always, cast up to 2^24.
        #[test]
        fn a_value_survives_the_way_out_and_back(bits: u32) {
            for (r#type, bits) in [
                (MavParamType::UINT8, bits & 0xFF),
                (MavParamType::INT8, bits & 0xFF),
                (MavParamType::UINT16, bits & 0xFFFF),
                (MavParamType::INT16, bits & 0xFFFF),
                (MavParamType::UINT32, bits),
                (MavParamType::INT32, bits),
            ] {
                prop_assert_eq!(from_wire(Bytewise, r#type, to_wire(Bytewise, r#type, bits)), Some(bits));
                if extended(r#type, bits).unsigned_abs() <= 1 << 24 && bits <= 1 << 24 {
                    prop_assert_eq!(from_wire(CCast, r#type, to_wire(CCast, r#type, bits)), Some(bits));
                }
            }
        }
    }
}
