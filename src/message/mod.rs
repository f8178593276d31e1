//! Messages: the types of payloads, with their encoding and the table of their ids.
//!
//! Implements <https://mavlink.io/en/guide/serialization.html>: field order, zero extension, `CRC_EXTRA`. A message is
//! a plain struct that [`message!`](crate::message!) generates from a declaration. There is no enum of all messages: a
//! service matches on a frame's id and decodes the messages that it uses, and the linker removes the rest.

mod address;
mod command;
mod field;
mod item;
#[macro_use]
mod macros;
mod rules;
mod secret;
mod table;
mod text;
mod typed;

pub use address::{Address, ComponentId, SystemId};
pub use field::{Char, Field, FieldReader, FieldWriter};
pub(crate) use item::{Digest, Position, position};
pub use item::{Item, LatLon};
pub use rules::{CommandRule, ParamRule};
pub(crate) use rules::{Value, has_position, is_above_terrain, is_scaled, is_zero_here};
pub use secret::Secret;
pub use table::{Dialect, FieldInfo, MessageInfo, MessageTable};
pub use text::Text;
pub(crate) use text::front;
pub use typed::{CommandParam, CommandParams, Location, TypedCommand};

/// A MAVLink message: its id, name and lengths, and how it is encoded.
///
/// Implemented by [`message!`](crate::message!).
pub trait Message: Sized {
    /// The message id, 24 bits.
    const ID: u32;
    /// The name in MAVLink's definitions, for example `MISSION_COUNT`.
    const NAME: &'static str;
    /// The last byte of the checksum's input: a digest of the names, types and order of the base fields (S-3).
    const CRC_EXTRA: u8;
    /// Length of the base fields in bytes: the payload of a MAVLink 1 frame (S-8).
    const BASE_LEN: usize;
    /// Length with all extension fields in bytes: the longest payload that is sent.
    const MAX_LEN: usize;
    /// This message's row of a [`MessageTable`].
    const INFO: MessageInfo;

    /// Decodes a payload of any length. A short one is extended with zeros (S-6); bytes after
    /// [`MAX_LEN`](Self::MAX_LEN) are ignored (S-7). It cannot fail: every bit pattern is a value (S-17, S-19).
    fn decode(payload: &[u8]) -> Self;

    /// Writes the untrimmed payload, [`MAX_LEN`](Self::MAX_LEN) bytes, and returns its length. If `payload` is shorter,
    /// returns `None` and writes nothing.
    fn encode(&self, payload: &mut [u8]) -> Option<usize>;
}

/// Returns the front of `payload`, extended with zeros (S-6). For the short messages that every vehicle receives, a loop
/// is smaller than `memcpy`, and about as fast as a call of it.
#[doc(hidden)]
#[inline]
pub fn zero_extended<const N: usize>(payload: &[u8]) -> [u8; N] {
    if N <= 64 {
        return core::array::from_fn(|offset| payload.get(offset).copied().unwrap_or(0));
    }
    let mut extended = [0; N];
    zero_extend(payload, &mut extended);
    extended
}

/// Copies as much of `from` to `to` as fits, and returns how many bytes. The rest of `to` is unchanged: zeros, where a payload is
/// extended (S-6).
pub(crate) fn zero_extend(from: &[u8], to: &mut [u8]) -> usize {
    let len = from.len().min(to.len());
    if let (Some(from), Some(to)) = (from.get(..len), to.get_mut(..len)) {
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
    fn fields_are_encoded_in_wire_order_and_extensions_last() {
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
    fn short_payload_is_extended_with_zeros_and_short_buffer_is_refused() {
        // S-6: the payload ends within field `a`.
        assert_eq!(Kinds::decode(&[1, 2]), Kinds { a: 0x0201, ..Kinds::default() });
        assert_eq!(Kinds::default().encode(&mut [0; 28]), None);
    }
}
