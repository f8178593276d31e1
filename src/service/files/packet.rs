//! The payload of FILE_TRANSFER_PROTOCOL (F-1).

use super::Outcome;
use super::session::Key;
use crate::crc32::Crc32;
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::frame::Frame;

/// The maximum length of the data in a packet.
pub(super) const MAX_DATA: usize = 239;

/// The position of the header, of the operation and of the data in the message's payload.
const HEADER_AT: usize = 3;
const OPCODE_AT: usize = 6;
const DATA_AT: usize = 15;

/// The part of a request that its answer repeats.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    pub(super) seq: u16,
    pub(super) opcode: MavFtpOpcode,
    /// The length of the request's data, or of the data that it requests.
    pub(super) size: u8,
    pub(super) offset: u32,
}

impl Head {
    pub(super) const EMPTY: Self = Self { seq: 0, opcode: MavFtpOpcode::NONE, size: 0, offset: 0 };

    /// Returns the length of the requested data. A client that gives none gets as much as fits.
    pub(super) const fn wanted(&self) -> u8 {
        if self.size == 0 { 239 } else { self.size }
    }
}

/// Whether a frame is a request to change files or directories, or a part of an upload (O-5).
pub fn changes(frame: &Frame<'_>) -> bool {
    let opcode = frame.payload().get(OPCODE_AT).copied().unwrap_or(0);
    matches!(
        MavFtpOpcode(opcode),
        MavFtpOpcode::CREATEFILE
            | MavFtpOpcode::WRITEFILE
            | MavFtpOpcode::REMOVEFILE
            | MavFtpOpcode::CREATEDIRECTORY
            | MavFtpOpcode::REMOVEDIRECTORY
            | MavFtpOpcode::OPENFILEWO
            | MavFtpOpcode::TRUNCATEFILE
            | MavFtpOpcode::RENAME
    )
}

/// A received request.
#[derive(Clone, Copy)]
pub(super) struct Request<'a> {
    pub(super) head: Head,
    /// The number that the client has given its session (F-12).
    pub(super) session: u8,
    /// The data without trailing zeros, which MAVLink 2 does not send.
    pub(super) data: &'a [u8],
    /// Identifies the request: only identical ones share it (F-13). It is not 0.
    pub(super) digest: u32,
}

impl<'a> Request<'a> {
    pub(super) fn of(payload: &'a [u8]) -> Self {
        let mut header = [0; DATA_AT];
        crate::message::zero_extend(payload, &mut header);
        let [_, _, _, seq0, seq1, session, opcode, size, _, _, _, a, b, c, d] = header;
        let end = DATA_AT.saturating_add(usize::from(size)).min(payload.len());
        let mut digest = Crc32::new();
        digest.add(payload.get(HEADER_AT..end).unwrap_or_default());
        Self {
            head: Head {
                seq: u16::from_le_bytes([seq0, seq1]),
                opcode: MavFtpOpcode(opcode),
                size,
                offset: u32::from_le_bytes([a, b, c, d]),
            },
            session,
            data: payload.get(DATA_AT..end).unwrap_or_default(),
            digest: digest.sum() | 1,
        }
    }
}

/// The result of a read of a virtual file.
#[derive(Debug)]
pub enum Body {
    /// The number of bytes that were read. 0 is the end.
    Data(usize),
    /// It takes another call.
    Later,
    /// It cannot be read.
    Refused(MavFtpErr),
}

/// The payload of the message: header and data.
pub(super) type Payload = [u8; 254];

/// Returns the place of the data.
pub(super) fn data(payload: &mut Payload) -> &mut [u8] {
    payload.get_mut(DATA_AT..).unwrap_or_default()
}

/// Writes the header of the answer to `head` in front of the data, whose length is given. Returns false if there is nothing to
/// send.
pub(super) fn complete(payload: &mut Payload, key: Key, head: &Head, content: Outcome, ends: bool) -> bool {
    let (opcode, size) = match content {
        Ok(len) => (MavFtpOpcode::ACK, u8::try_from(len).unwrap_or(0)),
        Err(stop) => {
            let Some(error) = stop.error() else { return false };
            if let Some(first) = data(payload).first_mut() {
                *first = error.0;
            }
            (MavFtpOpcode::NAK, 1)
        }
    };
    let [system, component, _, session] = key.bytes();
    let [seq0, seq1] = head.seq.wrapping_add(1).to_le_bytes();
    let [a, b, c, d] = head.offset.to_le_bytes();
    if let Some(front) = payload.first_chunk_mut() {
        *front =
            [0, system, component, seq0, seq1, session, opcode.0, size, head.opcode.0, u8::from(ends), 0, a, b, c, d];
    }
    // What is behind the data is not sent. A loop of its own: the compiler would link a call that clears memory.
    for byte in data(payload).get_mut(usize::from(size)..).unwrap_or_default() {
        *byte = core::hint::black_box(0);
    }
    true
}
