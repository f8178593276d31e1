//! The representation of a parameter's value in memory and on the wire (P-2, P-3).
//!
//! In memory, a value has 32 bits: those of the float, or the integer in the low bytes, padded with zeros. The byte-wise encoding
//! on the wire is the same.

use crate::dialect::{MavParamType, MavProtocolCapability};
use crate::num;

/// The encoding of integers in the float field of PARAM_VALUE and PARAM_SET (P-2). An `f32` is the same in both encodings.
///
/// A PARAM_SET of an integer may have another integer type than the parameter. The value is decoded with that type, and
/// accepted if it fits (P-14).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ParamEncoding {
    /// The integer's bytes in place of the float's. QGroundControl and MAVSDK expect this of every autopilot except ArduPilot.
    Bytewise,
    /// The integer converted to a float, which rounds integers beyond 2^24. pymavlink and MAVProxy expect this of every autopilot
    /// except PX4.
    CCast,
}

impl ParamEncoding {
    /// Returns the capability that announces it (Q-9).
    pub(super) const fn capability(self) -> MavProtocolCapability {
        match self {
            Self::Bytewise => MavProtocolCapability::PARAM_ENCODE_BYTEWISE,
            Self::CCast => MavProtocolCapability::PARAM_ENCODE_C_CAST,
        }
    }
}

/// A type of a parameter: one of those that PARAM_VALUE can carry (P-3). This trait is sealed.
pub trait ParamType: Copy + sealed::Sealed {
    /// The type as in messages.
    const TYPE: MavParamType;

    /// Returns the value as 32 bits: those of the float, or the integer in the low bytes, padded with zeros.
    ///
    /// ```
    /// use mavstack::param::ParamType;
    ///
    /// assert_eq!([ParamType::bits(-1i8), 2u16.bits(), 1.0f32.bits()], [0xFF, 2, 0x3F80_0000]);
    /// assert_eq!(i8::of_bits(0xFF), -1);
    /// ```
    #[inline]
    fn bits(self) -> u32 {
        self.to_bits()
    }

    /// Returns the value with these [bits](Self::bits). Higher bytes are ignored.
    #[inline]
    fn of_bits(bits: u32) -> Self {
        Self::from_bits(bits)
    }
}

mod sealed {
    /// The private part of [`ParamType`](super::ParamType).
    pub trait Sealed {
        #[doc(hidden)]
        fn to_bits(self) -> u32;
        #[doc(hidden)]
        fn from_bits(bits: u32) -> Self;
    }
}

pub(super) use sealed::Sealed;

macro_rules! param_type {
    ($($ty:ident: $wire:ident),+) => { $(
        impl ParamType for $ty {
            const TYPE: MavParamType = MavParamType::$wire;
        }

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

param_type! { u8: UINT8, i8: INT8, u16: UINT16, i16: INT16, u32: UINT32, i32: INT32 }

impl ParamType for f32 {
    const TYPE: MavParamType = MavParamType::REAL32;
}

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

/// Returns the number of bytes of a value of this type.
pub(super) const fn size(r#type: MavParamType) -> usize {
    match r#type {
        MavParamType::UINT8 | MavParamType::INT8 => 1,
        MavParamType::UINT16 | MavParamType::INT16 => 2,
        _ => 4,
    }
}

/// How an integer type uses the 32 bits of a value.
#[derive(Clone, Copy)]
pub(super) struct IntegerBits {
    /// The number of high bits that are zeros.
    unused: u32,
    is_signed: bool,
}

impl IntegerBits {
    pub(super) const fn of(r#type: MavParamType) -> Self {
        let unused = match r#type {
            MavParamType::UINT8 | MavParamType::INT8 => 24,
            MavParamType::UINT16 | MavParamType::INT16 => 16,
            _ => 0,
        };
        let is_signed = matches!(r#type, MavParamType::INT8 | MavParamType::INT16 | MavParamType::INT32);
        Self { unused, is_signed }
    }

    /// Returns the bits that this type uses; the others are zeros.
    const fn low(self, bits: u32) -> u32 {
        bits.wrapping_shl(self.unused).wrapping_shr(self.unused)
    }

    /// Returns the sign-extended integer.
    pub(super) const fn extended(self, bits: u32) -> i32 {
        bits.wrapping_shl(self.unused).cast_signed().wrapping_shr(self.unused)
    }

    /// Returns the value of an integer. Unused bits are ignored.
    #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; nothing is cut off")]
    pub(super) const fn integer(self, bits: u32) -> i64 {
        if self.is_signed { self.extended(bits) as i64 } else { self.low(bits) as i64 }
    }

    /// Returns the bits of an integer in this type; `None` if it does not fit.
    pub(super) fn of_integer(self, value: i64) -> Option<u32> {
        let [a, b, c, d, ..] = value.to_le_bytes();
        let bits = u32::from_le_bytes([a, b, c, d]);
        (self.integer(bits) == value).then_some(self.low(bits))
    }
}

/// Whether a parameter can have this type (P-3).
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

/// Whether these bits are a value of this type: a finite float, or an integer that is padded with zeros.
pub(super) const fn is_value(r#type: MavParamType, bits: u32) -> bool {
    if matches!(r#type, MavParamType::REAL32) {
        f32::from_bits(bits).is_finite()
    } else {
        IntegerBits::of(r#type).low(bits) == bits
    }
}

/// Whether these bits are a value of this type within a range of values.
pub(super) const fn is_within(r#type: MavParamType, bits: u32, [min, max]: [u32; 2]) -> bool {
    if matches!(r#type, MavParamType::REAL32) {
        let value = f32::from_bits(bits);
        return f32::from_bits(min) <= value && value <= f32::from_bits(max);
    }
    let r#type = IntegerBits::of(r#type);
    let integer = r#type.integer(bits);
    r#type.low(bits) == bits && r#type.integer(min) <= integer && integer <= r#type.integer(max)
}

/// Returns the value as encoded in PARAM_VALUE.
pub(super) fn to_wire(encoding: ParamEncoding, r#type: MavParamType, bits: u32) -> f32 {
    if encoding == ParamEncoding::Bytewise || r#type == MavParamType::REAL32 {
        return f32::from_bits(bits);
    }
    let r#type = IntegerBits::of(r#type);
    if r#type.is_signed { num::f32_from_i32(r#type.extended(bits)) } else { num::f32_from_u32(bits) }
}

/// Returns the integer that is encoded in a PARAM_SET with this type; `None` if it is none (P-19).
///
/// Clients fill the unused bytes of a small integer with zeros, or with copies of its top bit. MAVSDK 4.1 sends NaN in its place,
/// and other clients send a float: its low bytes are no value.
pub(super) fn from_wire(encoding: ParamEncoding, r#type: MavParamType, value: f32) -> Option<i64> {
    let bits = value.to_bits();
    let r#type = IntegerBits::of(r#type);
    let is_extended = r#type.low(bits) == bits || r#type.extended(bits).cast_unsigned() == bits;
    if encoding == ParamEncoding::Bytewise && is_extended { Some(r#type.integer(bits)) } else { whole(value) }
}

/// Returns a float as an integer of up to 32 bits; `None` if it is not a whole number.
pub(super) fn whole(value: f32) -> Option<i64> {
    match num::unsigned(value) {
        Some(integer) => Some(i64::from(integer)),
        None => num::integer(value).map(|integer: i32| i64::from(integer)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ParamEncoding::{Bytewise, CCast};
    use proptest::prelude::*;

    /// Returns the value of a parameter that is set with its own type.
    fn from_wire(encoding: ParamEncoding, r#type: MavParamType, value: f32) -> Option<u32> {
        if r#type == MavParamType::REAL32 {
            return Some(value.to_bits());
        }
        super::from_wire(encoding, r#type, value).and_then(|integer| IntegerBits::of(r#type).of_integer(integer))
    }

    /// Returns a value of one integer type in another.
    fn converted(from: MavParamType, to: MavParamType, bits: u32) -> Option<u32> {
        IntegerBits::of(to).of_integer(IntegerBits::of(from).integer(bits))
    }

    /// P-2: both encodings at the limits of the types, and of small negative integers.
    #[test]
    fn both_encodings_at_the_limits_of_every_type() {
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
        // Beyond 2^24 a cast rounds.
        assert_eq!(to_wire(CCast, MavParamType::UINT32, (1 << 24) + 1), 16_777_216.0);
    }

    /// P-19: the unused bytes of a small integer are zeros or copies of its top bit. Everything else is read as a float. The bits
    /// that clients send: 0x7FC00000 is MAVSDK 4.1's `set_param_int`, 0x3F800000 a cast 1, and 0xAAAA0001 an uninitialised union.
    #[test]
    fn low_bytes_of_something_else_are_no_value() {
        use MavParamType as Type;
        for (r#type, bits, expected) in [
            (Type::INT8, 0xFFFF_FFFE, Some(0xFE)),
            (Type::INT8, 0x0000_00FE, Some(0xFE)),
            (Type::UINT8, 0xFFFF_FFFE, Some(0xFE)),
            (Type::UINT16, 0xFFFF_8001, Some(0x8001)),
            (Type::INT16, 0xFFFF_8001, Some(0x8001)),
            (Type::UINT8, 0xFFFF_FF01, None),
            (Type::INT8, 0xFFFF_FF01, None),
            (Type::UINT16, 0xFFFF_0008, None),
            (Type::UINT8, 0x0000_FFFE, None),
            (Type::INT8, 0x7FFF_FFFE, None),
            (Type::UINT16, 0xAAAA_0001, None),
            (Type::UINT8, 0x0000_0100, None),
            (Type::INT16, 0x0001_0000, None),
            (Type::UINT8, 0x3F80_0000, Some(1)),
            (Type::INT8, 0xBF80_0000, Some(0xFF)),
            (Type::UINT8, 0xBF80_0000, None),
            (Type::UINT8, 0x437F_0000, Some(255)),
            (Type::UINT8, 0x4380_0000, None),
            (Type::INT16, 0xC700_0000, Some(0x8000)),
            (Type::UINT16, 0x477F_FF00, Some(65_535)),
            (Type::UINT8, 0x3FC0_0000, None),
            (Type::UINT8, 0x8000_0000, Some(0)),
            // 32 bits: as the type says.
            (Type::INT32, 0x3F80_0000, Some(0x3F80_0000)),
            (Type::UINT32, 0x7FC0_0000, Some(0x7FC0_0000)),
        ] {
            assert_eq!(from_wire(Bytewise, r#type, f32::from_bits(bits)), expected, "{type:?} {bits:#x}");
        }
        for nan in [0x7FC0_0000, 0xFFC0_0000, 0x7F80_0001, 0x7F80_0000, 0xFF80_0000] {
            for r#type in [Type::UINT8, Type::INT8, Type::UINT16, Type::INT16] {
                assert_eq!(from_wire(Bytewise, r#type, f32::from_bits(nan)), None, "{type:?} {nan:#x}");
            }
        }
    }

    #[test]
    fn a_cast_that_is_not_a_value_of_the_type() {
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
    fn nan_and_infinities_are_in_no_range() {
        let all = [f32::MIN, f32::MAX].map(f32::to_bits);
        for bits in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY].map(f32::to_bits) {
            assert!(!is_value(MavParamType::REAL32, bits) && !is_within(MavParamType::REAL32, bits, all));
        }
        let zeros = [0.0f32, -0.0].map(f32::to_bits);
        for zero in zeros {
            assert!(zeros.iter().all(|bits| is_within(MavParamType::REAL32, *bits, [zero, zero])));
        }
        assert!(!is_within(MavParamType::UINT8, 0x7FC0_0000, [0, 0xFF]), "P-19");
        assert!(!is_within(MavParamType::INT16, 0xFFFF_FFFE, [0x8000, 0x7FFF]), "P-19");
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
        value as u32 & (u32::MAX >> IntegerBits::of(r#type).unused)
    }

    /// P-14, P-2: integers convert between all types if the value fits, checked at the limits of each type.
    #[test]
    fn an_integer_of_another_type_keeps_its_value_or_is_refused() {
        let limits = INTEGERS.iter().flat_map(|(_, min, max)| [*min, *max]).flat_map(|at| [at - 1, at, at + 1]);
        for value in limits.chain([-2, -1, 0, 1, 2]) {
            for (from, ..) in INTEGERS.iter().filter(|(_, min, max)| (min..=max).contains(&&value)) {
                for (to, min, max) in &INTEGERS {
                    let expected = (min..=max).contains(&&value).then(|| bits_of(*to, value));
                    assert_eq!(converted(*from, *to, bits_of(*from, value)), expected, "{value}: {from:?} to {to:?}");
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5_000))]

        /// P-14
        #[test]
        fn conversions_keep_the_value(bits: u32, from in 0usize..6, to in 0usize..6) {
            let ((from, ..), (to, min, max)) = (INTEGERS[from], INTEGERS[to]);
            let bits = bits_of(from, i64::from(bits));
            let is_signed = IntegerBits::of(from).is_signed;
            let value = if is_signed { i64::from(IntegerBits::of(from).extended(bits)) } else { i64::from(bits) };
            prop_assert_eq!(converted(from, to, bits), (min..=max).contains(&value).then(|| bits_of(to, value)));
        }

        /// P-19: an accepted value is an extension of the small one, or a float that equals it.
        #[test]
        fn a_small_integer_is_extended_or_a_whole_float(bits: u32, r#type in 0usize..4) {
            let (r#type, min, max) = INTEGERS[r#type];
            let value = f32::from_bits(bits);
            let mask = u32::MAX >> IntegerBits::of(r#type).unused;
            let top = bits & (mask ^ (mask >> 1)) != 0;
            let is_extended = bits & !mask == 0 || (top && bits | mask == u32::MAX);
            let is_whole = (f64::from(value).trunc() == f64::from(value)) && (min as f64..=max as f64).contains(&value.into());
            let expected = if is_extended { Some(bits & mask) } else { is_whole.then(|| bits_of(r#type, value as i64)) };
            prop_assert_eq!(from_wire(Bytewise, r#type, value), expected);
        }

        #[test]
        fn ranges_have_the_order_of_the_values(value: u32, min: u32, max: u32) {
            macro_rules! in_order {
                ($($ty:ident $wire:ident),+) => { $(
                    let [v, low, high] = [value, min, max].map(<$ty as Sealed>::from_bits);
                    let bits = [v, low, high].map(Sealed::to_bits);
                    if bits.iter().all(|bits| is_value(MavParamType::$wire, *bits)) {
                        let is_in_order = low <= v && v <= high;
                        prop_assert_eq!(is_within(MavParamType::$wire, bits[0], [bits[1], bits[2]]), is_in_order);
                    }
                )+ };
            }
            in_order!(u8 UINT8, i8 INT8, u16 UINT16, i16 INT16, u32 UINT32, i32 INT32, f32 REAL32);
        }

        /// P-2: a value that a client reads and sends back is unchanged: always byte-wise, with casts up to 2^24.
        #[test]
        fn a_value_survives_the_round_trip(bits: u32) {
            for (r#type, bits) in [
                (MavParamType::UINT8, bits & 0xFF),
                (MavParamType::INT8, bits & 0xFF),
                (MavParamType::UINT16, bits & 0xFFFF),
                (MavParamType::INT16, bits & 0xFFFF),
                (MavParamType::UINT32, bits),
                (MavParamType::INT32, bits),
            ] {
                prop_assert_eq!(from_wire(Bytewise, r#type, to_wire(Bytewise, r#type, bits)), Some(bits));
                if IntegerBits::of(r#type).extended(bits).unsigned_abs() <= 1 << 24 && bits <= 1 << 24 {
                    prop_assert_eq!(from_wire(CCast, r#type, to_wire(CCast, r#type, bits)), Some(bits));
                }
            }
        }
    }
}
