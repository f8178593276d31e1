//! Frames of MAVLink 1 and 2: decoding, encoding, checksums and signatures.
//!
//! Implements <https://mavlink.io/en/guide/serialization.html> and the checksum of
//! <https://mavlink.io/en/guide/crc.html>. A [`Decoder`] owns the receive buffer and returns [`Frame`]s that borrow
//! from it. [`encode`] writes a message into the caller's buffer. Nothing here depends on the meaning of a message.

mod decoder;
mod encoder;
#[cfg(feature = "signing")]
mod signing;

pub(crate) use decoder::Checks;
pub use decoder::{Decoder, RxCounters};
pub(crate) use encoder::wrap;
pub use encoder::{EncodeError, encode};
#[cfg(feature = "signing")]
pub(crate) use signing::{MAX_TIMESTAMP, cost_of_sending, signature_cost};
#[cfg(feature = "signing")]
pub use signing::{SigningKey, encode_signed};

use crate::message::{Address, Message, MessageInfo};

/// Length of the longest frame in bytes: MAVLink 2 with 255 bytes of payload and a signature (S-1).
pub const MAX_FRAME_LEN: usize = 280;

/// The start byte of a MAVLink 1 frame.
pub(crate) const STX_V1: u8 = 0xFE;
/// The start byte of a MAVLink 2 frame.
pub(crate) const STX_V2: u8 = 0xFD;
/// The incompatibility flag of a signed frame. Frames with any other flag are refused (S-9).
pub(crate) const INCOMPAT_SIGNED: u8 = 0x01;
/// Bytes that follow the checksum of a signed frame: link id, timestamp and signature.
pub(crate) const SIGNATURE_LEN: usize = 13;

/// Returns the cost of the signature of a frame that is sent: without the feature `signing` there is none.
#[cfg(not(feature = "signing"))]
pub(crate) fn cost_of_sending(_: &[u8]) -> u32 {
    0
}

/// The MAVLink version of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Version {
    /// MAVLink 1: message ids up to 255, no extension fields, no signature.
    V1,
    /// MAVLink 2: message ids of 24 bits, extension fields, signatures.
    V2,
}

impl Version {
    /// Returns the length of the header in bytes, including the start byte: 6 or 10.
    #[inline]
    pub const fn header_len(self) -> usize {
        match self {
            Self::V1 => 6,
            Self::V2 => 10,
        }
    }
}

/// The fields of a frame's header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// The frame's MAVLink version.
    pub version: Version,
    /// Length of the payload as sent (bytes).
    pub payload_len: u8,
    /// Incompatibility flags. Bit 0 announces a signature; frames with any other bit are refused (S-9). 0 in a MAVLink 1
    /// frame.
    pub incompat_flags: u8,
    /// Compatibility flags. They are ignored, and forwarded as received (S-9). 0 in a MAVLink 1 frame.
    pub compat_flags: u8,
    /// The sender's sequence number for the link: it increases by one per frame, and 255 is followed by 0 (S-16).
    pub seq: u8,
    /// The sender.
    pub source: Address,
    /// The message id: 24 bits, 8 bits in a MAVLink 1 frame.
    pub id: u32,
}

impl Header {
    /// Reads a header. Returns `None` when `bytes` is too short or does not begin with a start byte.
    #[inline(always)]
    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        match *bytes {
            [STX_V2, payload_len, incompat_flags, compat_flags, seq, system, component, a, b, c, ..] => Some(Self {
                version: Version::V2,
                payload_len,
                incompat_flags,
                compat_flags,
                seq,
                source: Address::new(system, component),
                id: u32::from_le_bytes([a, b, c, 0]),
            }),
            [STX_V1, payload_len, seq, system, component, id, ..] => Some(Self {
                version: Version::V1,
                payload_len,
                incompat_flags: 0,
                compat_flags: 0,
                seq,
                source: Address::new(system, component),
                id: u32::from(id),
            }),
            _ => None,
        }
    }

    /// Returns the offset of the payload's end.
    #[inline]
    fn payload_end(&self) -> usize {
        self.version.header_len().wrapping_add(usize::from(self.payload_len))
    }

    /// Returns the length of the whole frame.
    #[inline]
    fn frame_len(&self) -> usize {
        let signature = if self.is_signed() { SIGNATURE_LEN } else { 0 };
        self.payload_end().wrapping_add(2).wrapping_add(signature)
    }

    /// Returns whether a signature follows the checksum.
    #[inline]
    pub const fn is_signed(&self) -> bool {
        self.incompat_flags & INCOMPAT_SIGNED != 0
    }
}

/// The signature that follows the checksum of a signed frame (G-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Signature {
    /// The sender's id of the link that it signed for, 0 to 255. With the source it identifies the signed stream (G-8).
    pub link_id: u8,
    /// Time of signing, in units of 10 µs since 2015-01-01 00:00 UTC, 48 bits (G-3).
    pub timestamp: u64,
    /// The first six bytes of the SHA-256 over key, frame, `link_id` and `timestamp` (G-2).
    pub bytes: [u8; 6],
}

/// A received frame that borrows from the decoder's buffer.
///
/// Its `Debug` and `defmt::Format` show the header, not the payload, which may contain a key (SEC-15).
#[derive(Clone, Copy)]
pub struct Frame<'a> {
    header: Header,
    payload: &'a [u8],
    raw: &'a [u8],
    info: Option<&'static MessageInfo>,
}

impl core::fmt::Debug for Frame<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let is_checked = self.is_checked();
        f.debug_struct("Frame").field("header", &self.header).field("is_checked", &is_checked).finish_non_exhaustive()
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Frame<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "Frame {} is_checked={=bool}", self.header, self.is_checked());
    }
}

impl<'a> Frame<'a> {
    /// Returns the header.
    #[inline]
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// Returns the message id.
    #[inline]
    pub const fn id(&self) -> u32 {
        self.header.id
    }

    /// Returns the sender.
    #[inline]
    pub const fn source(&self) -> Address {
        self.header.source
    }

    /// Returns the payload as sent: MAVLink 2 senders trim trailing zeros (S-5).
    #[inline]
    pub const fn payload(&self) -> &'a [u8] {
        self.payload
    }

    /// Returns all bytes as received, from the start byte to the checksum or signature. They are forwarded unchanged
    ///
    #[inline]
    pub const fn raw(&self) -> &'a [u8] {
        self.raw
    }

    /// Returns the checksum's bytes.
    pub(crate) fn checksum(&self) -> Option<[u8; 2]> {
        self.raw.get(self.header.payload_end()..)?.first_chunk().copied()
    }

    /// Returns whether the checksum was verified. False for a message whose `CRC_EXTRA` is unknown: such a frame may be
    /// forwarded, but is never acted on (S-12).
    #[inline]
    pub const fn is_checked(&self) -> bool {
        self.info.is_some()
    }

    /// Returns the message's row of the dialect; `None` when the checksum could not be verified.
    #[inline]
    pub const fn info(&self) -> Option<&'static MessageInfo> {
        self.info
    }

    /// Returns the signature, without verifying it; `None` when the frame is not signed.
    pub fn signature(&self) -> Option<Signature> {
        if !self.header.is_signed() {
            return None;
        }
        match *self.raw.last_chunk::<SIGNATURE_LEN>()? {
            [link_id, t0, t1, t2, t3, t4, t5, a, b, c, d, e, f] => Some(Signature {
                link_id,
                timestamp: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, 0, 0]),
                bytes: [a, b, c, d, e, f],
            }),
        }
    }

    /// Decodes the frame as message `M`. Returns `None` when it has another id, or its checksum could not be verified.
    #[inline]
    pub fn decode<M: Message>(&self) -> Option<M> {
        (self.header.id == M::ID && self.is_checked()).then(|| M::decode(self.payload))
    }

    /// Returns the byte of the payload at `offset`; 0 where the sender trimmed it (S-6, R-15).
    #[inline]
    pub(crate) fn byte(&self, offset: u8) -> u8 {
        self.payload.get(usize::from(offset)).copied().unwrap_or(0)
    }
}
