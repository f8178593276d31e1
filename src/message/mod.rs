//! Messages: what a payload means.
//!
//! Implements <https://mavlink.io/en/guide/serialization.html>: field order, zero extension, `CRC_EXTRA`. A message is a
//! plain struct that [`message!`](crate::message) makes from a declaration. There is no enum of all messages: a service looks
//! at a frame's id and decodes what it uses, and the linker drops the rest.

mod field;
#[macro_use]
mod macros;
mod secret;
mod table;
mod text;

pub use field::{Char, Field, FieldReader, FieldWriter};
pub use secret::Secret;
pub use table::{Dialect, FieldInfo, MessageInfo, MessageTable};
pub use text::Text;
pub(crate) use text::cut;

/// A MAVLink message: its numbers, and how it stands in a payload.
///
/// Implemented by [`message!`](crate::message).
pub trait Message: Sized {
    /// The message id, 24 bits.
    const ID: u32;
    /// MAVLink's own name, for example `MISSION_COUNT`.
    const NAME: &'static str;
    /// The byte that a frame's checksum ends with: a digest of names, types and order of the base fields (S-3).
    const CRC_EXTRA: u8;
    /// Length in bytes of the base fields: what a v1 frame carries (S-8).
    const BASE_LEN: usize;
    /// Length in bytes with all extensions: the longest payload that we send.
    const MAX_LEN: usize;
    /// This message's row of a [`MessageTable`].
    const INFO: MessageInfo;

    /// Reads the message from a payload of any length: a short one is extended with zeros (S-6), what is beyond
    /// [`MAX_LEN`](Self::MAX_LEN) is ignored (S-7). Cannot fail: every bit pattern is a value (S-17, S-19).
    fn decode(payload: &[u8]) -> Self;

    /// Writes the untrimmed payload, [`MAX_LEN`](Self::MAX_LEN) bytes, and returns that length; `None`, and nothing is
    /// written, when `payload` is shorter.
    fn encode(&self, payload: &mut [u8]) -> Option<usize>;
}

/// Copies the front of `payload` into `out`, whose rest stays as it is: zero, where a payload is extended (S-6). Returns
/// how many bytes were copied. Not inlined: every message's decoder shares it.
#[doc(hidden)]
#[inline(never)]
pub fn zero_extend(payload: &[u8], out: &mut [u8]) -> usize {
    let len = payload.len().min(out.len());
    if let (Some(from), Some(to)) = (payload.get(..len), out.get_mut(..len)) {
        to.copy_from_slice(from);
    }
    len
}

#[cfg(feature = "defmt")]
mod format {
    /// Logs a message's name.
    #[doc(hidden)]
    pub fn __format_name(f: defmt::Formatter<'_>, name: &'static str) {
        defmt::write!(f, "{=str}", name);
    }

    /// Logs one field of a message.
    #[doc(hidden)]
    pub fn __format_field<T: defmt::Format>(f: defmt::Formatter<'_>, name: &'static str, value: &T) {
        defmt::write!(f, " {=str}={}", name, value);
    }
}

#[cfg(feature = "defmt")]
pub use format::{__format_field, __format_name};

#[cfg(test)]
mod tests {
    use super::*;

    message! {
        /// One field of each kind.
        pub struct Kinds: KINDS = 9 {
            a: u64,
            b: [f32; 2],
            c: i16,
            d: Text<5>,
            e: u8,
        } extensions {
            f: u32,
            g: Char,
        }
    }

    #[test]
    fn layout_is_the_wire_order_and_extensions_are_not_in_the_base() {
        assert_eq!((Kinds::BASE_LEN, Kinds::MAX_LEN), (24, 29));
        let message = Kinds {
            a: 0x0102,
            b: [1.0, f32::NAN],
            c: -2,
            d: Text::new("abcdefg"),
            e: 7,
            f: 0xA0B0_C0D0,
            g: Char(b'x'),
        };
        let mut payload = [0xFF; 30];
        assert_eq!(message.encode(&mut payload), Some(29));
        assert_eq!(payload[..8], [2, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(payload[8..12], 1.0f32.to_le_bytes());
        assert_eq!(payload[16..18], [0xFE, 0xFF]);
        assert_eq!(&payload[18..23], b"abcde");
        assert_eq!(payload[24..30], [0xD0, 0xC0, 0xB0, 0xA0, b'x', 0xFF]);
        let back = Kinds::decode(&payload);
        assert_eq!((back.a, back.b[0], back.c, back.e), (0x0102, 1.0, -2, 7));
        assert_eq!((back.f, back.g), (0xA0B0_C0D0, Char(b'x')));
        assert!(back.b[1].is_nan());
    }

    #[test]
    fn short_payload_reads_as_zeros_and_a_short_buffer_is_refused() {
        // S-6: field `a` is cut in its middle.
        assert_eq!(Kinds::decode(&[1, 2]), Kinds { a: 0x0201, ..Kinds::default() });
        assert_eq!(Kinds::default().encode(&mut [0; 28]), None);
    }
}
