//! Encoding: messages to frames, with trimmed payload, sequence number and checksum (S-1, S-2, S-5).

use core::ops::Range;

use super::{STX_V1, STX_V2, Version};
use crate::crc;
use crate::message::{Address, Message, MessageInfo};

/// Why a message could not be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum EncodeError {
    /// The buffer is shorter than the header, [`MAX_LEN`](Message::MAX_LEN) bytes of payload and the checksum, and the
    /// signature if there is one.
    BufferTooSmall,
    /// The message's id is above 255, which a MAVLink 1 frame cannot carry (S-10).
    NeedsV2,
}

impl core::fmt::Display for EncodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::BufferTooSmall => "the buffer is smaller than the message's longest frame: take MAX_FRAME_LEN bytes",
            Self::NeedsV2 => "a message id above 255 needs MAVLink 2: encode it with Version::V2",
        })
    }
}

impl core::error::Error for EncodeError {}

/// Writes `message` as one unsigned frame to the front of `out` and returns the frame's length in bytes.
///
/// A MAVLink 2 payload is sent without its trailing zeros, but never without its first byte (S-5). A MAVLink 1 payload
/// is all base fields (S-8). `out` must hold the untrimmed frame: the header, [`MAX_LEN`](Message::MAX_LEN) and 2
/// bytes. [`MAX_FRAME_LEN`](super::MAX_FRAME_LEN) bytes suffice for every message.
///
/// # Errors
///
/// `out` is too small, or the message needs MAVLink 2. `out` may then be partly overwritten.
///
/// ```
/// use mavstack::frame::{Version, encode};
/// use mavstack::{Address, dialect::Heartbeat};
/// let mut frame = [0; 32];
/// let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
/// let len = encode(&heartbeat, Version::V2, Address::new(1, 1), 0, &mut frame)?;
/// assert_eq!(len, 21);
/// # Ok::<(), mavstack::frame::EncodeError>(())
/// ```
#[inline]
pub fn encode<M: Message>(
    message: &M,
    version: Version,
    source: Address,
    seq: u8,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let payload_at = version.header_len();
    let payload = out.get_mut(payload_at..).ok_or(EncodeError::BufferTooSmall)?;
    message.encode(payload).ok_or(EncodeError::BufferTooSmall)?;
    let frame = wrap(const { &M::INFO }, version, 0, source, seq, out, payload_at)?;
    Ok(frame.end)
}

/// Writes header and checksum around the untrimmed payload at `payload_at`, and returns where the frame is. The caller
/// appends the signature that the flags announce. A MAVLink 1 frame has no flags. Not generic, so it is compiled once
/// for all messages.
pub(crate) fn wrap(
    info: &MessageInfo,
    version: Version,
    incompat_flags: u8,
    source: Address,
    seq: u8,
    out: &mut [u8],
    payload_at: usize,
) -> Result<Range<usize>, EncodeError> {
    let too_small = EncodeError::BufferTooSmall;
    let [id0, id1, id2, _] = info.id().to_le_bytes();
    let (system, component) = (source.system.wire(), source.component.wire());
    let (header, payload) = out.split_at_mut_checked(payload_at).ok_or(too_small)?;
    let payload_len = match version {
        Version::V2 => {
            let payload_len = trimmed_len(payload, info.max_len());
            *header.last_chunk_mut::<10>().ok_or(too_small)? =
                [STX_V2, payload_len, incompat_flags, 0, seq, system, component, id0, id1, id2];
            payload_len
        }
        Version::V1 => {
            if info.id() > 255 {
                return Err(EncodeError::NeedsV2);
            }
            let payload_len = info.base_len();
            *header.last_chunk_mut::<6>().ok_or(too_small)? = [STX_V1, payload_len, seq, system, component, id0];
            payload_len
        }
    };
    let start = payload_at.wrapping_sub(version.header_len());
    let end = payload_at.wrapping_add(usize::from(payload_len));
    let summed = out.get(start.wrapping_add(1)..end).ok_or(too_small)?;
    let sum = crc::checksum(summed, info.crc_extra());
    *out.get_mut(end..).and_then(<[u8]>::first_chunk_mut).ok_or(too_small)? = sum.to_le_bytes();
    Ok(start..end.wrapping_add(2))
}

/// Returns the payload's length without trailing zeros, at least 1 (S-5).
fn trimmed_len(payload: &[u8], max_len: u8) -> u8 {
    let mut len = max_len;
    while len > 1 && payload.get(usize::from(len.wrapping_sub(1))) == Some(&0) {
        len = len.wrapping_sub(1);
    }
    len
}
