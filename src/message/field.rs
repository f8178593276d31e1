//! The fields of a payload: size, type name on the wire, little-endian encoding (S-19).

/// A type that a field of a message can have.
///
/// Implemented for the integers and floats of MAVLink, for arrays of them, for [`Text`](crate::Text), and by
/// [`wire_enum!`](crate::wire_enum) and [`wire_bitmask!`](crate::wire_bitmask).
pub trait Field: Copy {
    /// Size on the wire, in bytes.
    const SIZE: usize;
    /// Size of one element in bytes, by which the wire order sorts the fields (S-4). Of an array it is the size of an
    /// element, not of the array.
    const ELEMENT: usize;
    /// Name of the element's type, which is a part of `CRC_EXTRA` (S-3).
    const WIRE_TYPE: &'static str;
    /// Whether the array length is a part of `CRC_EXTRA`: true for arrays and texts, even with one element.
    const IS_ARRAY: bool = false;
    /// The value whose bytes are all zero.
    const ZERO: Self;

    /// Reads the field that begins at `payload[at]`. A number that does not lie within the payload reads as zero.
    fn read(payload: &[u8], at: usize) -> Self;

    /// Writes the field to `payload[at..]`. A number that does not lie within the payload is not written.
    fn write(&self, payload: &mut [u8], at: usize);
}

macro_rules! number {
    ($($ty:ty = $wire:literal, $zero:literal;)+) => { $(
        impl Field for $ty {
            const SIZE: usize = size_of::<$ty>();
            const ELEMENT: usize = size_of::<$ty>();
            const WIRE_TYPE: &'static str = $wire;
            const ZERO: Self = $zero;

            #[inline(always)]
            fn read(payload: &[u8], at: usize) -> Self {
                match payload.get(at..).and_then(<[u8]>::first_chunk) {
                    Some(bytes) => <$ty>::from_le_bytes(*bytes),
                    None => $zero,
                }
            }

            #[inline(always)]
            fn write(&self, payload: &mut [u8], at: usize) {
                if let Some(bytes) = payload.get_mut(at..).and_then(<[u8]>::first_chunk_mut) {
                    *bytes = self.to_le_bytes();
                }
            }
        }
    )+ };
}

number! {
    u8 = "uint8_t", 0;
    i8 = "int8_t", 0;
    u16 = "uint16_t", 0;
    i16 = "int16_t", 0;
    u32 = "uint32_t", 0;
    i32 = "int32_t", 0;
    u64 = "uint64_t", 0;
    i64 = "int64_t", 0;
    f32 = "float", 0.0;
    f64 = "double", 0.0;
}

impl<T: Field, const N: usize> Field for [T; N] {
    #[allow(clippy::arithmetic_side_effects, reason = "const-evaluated: an overflow is a compile error")]
    const SIZE: usize = T::SIZE * N;
    const ELEMENT: usize = T::ELEMENT;
    const WIRE_TYPE: &'static str = T::WIRE_TYPE;
    const IS_ARRAY: bool = true;
    const ZERO: Self = [T::ZERO; N];

    #[inline(always)]
    fn read(payload: &[u8], at: usize) -> Self {
        core::array::from_fn(|i| T::read(payload, at.wrapping_add(i.wrapping_mul(T::SIZE))))
    }

    #[inline(always)]
    fn write(&self, payload: &mut [u8], at: usize) {
        if Self::ELEMENT == 1 && Self::SIZE > 8 && Self::SIZE <= 32 {
            return write_elements(self, payload, at);
        }
        for (i, element) in self.iter().enumerate() {
            element.write(payload, at.wrapping_add(i.wrapping_mul(T::SIZE)));
        }
    }
}

/// Writes 9 to 32 bytes: a loop is smaller than `memcpy`.
#[inline(never)]
fn write_elements<T: Field>(elements: &[T], payload: &mut [u8], at: usize) {
    for (element, at) in elements.iter().zip((at..).step_by(T::SIZE)) {
        element.write(payload, at);
    }
}

/// A single `char`: one byte of text. The type of `char[N]` is [`Text<N>`](crate::Text).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Char(pub u8);

impl Field for Char {
    const SIZE: usize = 1;
    const ELEMENT: usize = 1;
    const WIRE_TYPE: &'static str = "char";
    const ZERO: Self = Self(0);

    #[inline(always)]
    fn read(payload: &[u8], at: usize) -> Self {
        Self(u8::read(payload, at))
    }

    #[inline(always)]
    fn write(&self, payload: &mut [u8], at: usize) {
        self.0.write(payload, at);
    }
}

/// Reads a message's fields in order. Once it is inlined, every offset is a constant and unused fields cost nothing.
#[doc(hidden)]
#[derive(Debug)]
pub struct FieldReader<'a> {
    payload: &'a [u8],
    at: usize,
}

impl<'a> FieldReader<'a> {
    #[inline(always)]
    pub const fn new(payload: &'a [u8]) -> Self {
        Self { payload, at: 0 }
    }

    #[inline(always)]
    pub fn take<T: Field>(&mut self) -> T {
        let field = T::read(self.payload, self.at);
        self.at = self.at.wrapping_add(T::SIZE);
        field
    }
}

/// Writes a message's fields in order.
#[doc(hidden)]
#[derive(Debug)]
pub struct FieldWriter<'a> {
    payload: &'a mut [u8],
    at: usize,
}

impl<'a> FieldWriter<'a> {
    #[inline(always)]
    pub const fn new(payload: &'a mut [u8]) -> Self {
        Self { payload, at: 0 }
    }

    #[inline(always)]
    pub fn push<T: Field>(&mut self, field: T) {
        field.write(self.payload, self.at);
        self.at = self.at.wrapping_add(T::SIZE);
    }
}
