//! Frames: bytes to checked packets and back, for MAVLink 1 and 2.
//!
//! Implements <https://mavlink.io/en/guide/serialization.html> and the checksum of
//! <https://mavlink.io/en/guide/crc.html>. A [`Decoder`] owns the receive buffer and yields [`Frame`]s that borrow from it;
//! [`encode`] writes a message into the caller's buffer. Nothing here knows what a message means.

pub(crate) mod crc;
mod decoder;
mod encoder;
#[cfg(feature = "signing")]
mod signing;

pub use decoder::{Decoder, RxCounters};
pub(crate) use encoder::wrap;
pub use encoder::{EncodeError, encode};
#[cfg(feature = "signing")]
pub(crate) use signing::{MAX_TIMESTAMP, signature_cost};
#[cfg(feature = "signing")]
pub use signing::{SigningKey, encode_signed};

use crate::message::{Message, MessageInfo};

/// The longest frame: v2 with 255 bytes of payload and a signature (S-1).
pub const MAX_FRAME_LEN: usize = 280;

/// Start of a v1 frame.
pub(crate) const STX_V1: u8 = 0xFE;
/// Start of a v2 frame.
pub(crate) const STX_V2: u8 = 0xFD;
/// The incompatibility flag that announces a signature; every other one is unknown to us (S-9).
pub(crate) const INCOMPAT_SIGNED: u8 = 0x01;
/// Link id, timestamp and the signature proper.
pub(crate) const SIGNATURE_LEN: usize = 13;

/// A system: a vehicle, a ground station. 0 means every system, as a target only (S-11).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SystemId(pub u8);

/// A component of a system. 0 means every component, as a target only (S-11). MAVLink's well-known ids are in
/// [`MavComponent`](crate::dialect::MavComponent).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ComponentId(pub u8);

/// Who sends, or who is meant: a component of a system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Address {
    /// The system.
    pub system: SystemId,
    /// Its component.
    pub component: ComponentId,
}

impl Address {
    /// The component `component` of system `system`.
    #[inline]
    pub const fn new(system: u8, component: u8) -> Self {
        Self { system: SystemId(system), component: ComponentId(component) }
    }
}

/// The form of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Version {
    /// MAVLink 1: ids to 255, no extensions, no signature.
    V1,
    /// MAVLink 2.
    V2,
}

impl Version {
    /// Bytes before the payload, the start byte included.
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
    /// The frame's form.
    pub version: Version,
    /// Length of the payload as sent (bytes).
    pub payload_len: u8,
    /// Incompatibility flags: bit 0 says that there is a signature, a frame with any other one is refused (S-9). 0 in a v1 frame.
    pub incompat_flags: u8,
    /// Compatibility flags; 0 in a v1 frame. Ignored, and kept when forwarding (S-9).
    pub compat_flags: u8,
    /// The sender's sequence number for the link: one more from frame to frame, 0 after 255 (S-16).
    pub seq: u8,
    /// The sender.
    pub source: Address,
    /// The message id: 24 bits, 8 in a v1 frame.
    pub id: u32,
}

impl Header {
    /// Reads a header; `None` when `bytes` is shorter than one, or does not begin with a start byte.
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

    /// Where the payload ends.
    #[inline]
    fn payload_end(&self) -> usize {
        self.version.header_len().wrapping_add(usize::from(self.payload_len))
    }

    /// Length of the whole frame.
    #[inline]
    fn frame_len(&self) -> usize {
        let signature = if self.is_signed() { SIGNATURE_LEN } else { 0 };
        self.payload_end().wrapping_add(2).wrapping_add(signature)
    }

    /// Whether a signature follows the checksum.
    #[inline]
    pub const fn is_signed(&self) -> bool {
        self.incompat_flags & INCOMPAT_SIGNED != 0
    }
}

/// What stands behind the checksum of a signed frame (G-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Signature {
    /// The sender's own number of the link that it signed for, 0 to 255: a part of what names the stream (G-8).
    pub link_id: u8,
    /// 10 µs since 2015-01-01 00:00 UTC, 48 bits (G-3).
    pub timestamp: u64,
    /// The first six bytes of the SHA-256 over key, frame, `link_id` and `timestamp` (G-2).
    pub bytes: [u8; 6],
}

/// A received frame, still in the decoder's buffer.
///
/// Its `Debug` and `defmt::Format` show the header, not the payload, which may have a key in it (SEC-15).
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
    /// The header's fields.
    #[inline]
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// The message id.
    #[inline]
    pub const fn id(&self) -> u32 {
        self.header.id
    }

    /// The sender.
    #[inline]
    pub const fn source(&self) -> Address {
        self.header.source
    }

    /// The payload as sent: a v2 sender cuts trailing zeros off (S-5).
    #[inline]
    pub const fn payload(&self) -> &'a [u8] {
        self.payload
    }

    /// All bytes as received, from the start byte to the checksum or signature: what is forwarded.
    #[inline]
    pub const fn raw(&self) -> &'a [u8] {
        self.raw
    }

    /// Whether the checksum was checked. False for a message whose `CRC_EXTRA` we do not know: such a frame may be
    /// forwarded, and is never acted on (S-12).
    #[inline]
    pub const fn is_checked(&self) -> bool {
        self.info.is_some()
    }

    /// What is known of the message; `None` when the checksum could not be checked.
    #[inline]
    pub const fn info(&self) -> Option<&'static MessageInfo> {
        self.info
    }

    /// What stands behind the checksum, when the frame is signed. Nothing is said here about its truth.
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

    /// The message `M`; `None` when this is another one, or when its checksum could not be checked.
    #[inline]
    pub fn decode<M: Message>(&self) -> Option<M> {
        (self.header.id == M::ID && self.is_checked()).then(|| M::decode(self.payload))
    }

    /// The byte of the payload at `offset`; 0 where the sender cut it off (S-6, R-15).
    #[inline]
    pub(crate) fn byte(&self, offset: u8) -> u8 {
        self.payload.get(usize::from(offset)).copied().unwrap_or(0)
    }
}
