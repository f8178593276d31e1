//! The payload of FILE_TRANSFER_PROTOCOL (F-1).

use crate::crc32::Crc32;
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::message::Address;

/// The maximum length of the data in a packet.
pub(super) const MAX_DATA: usize = 239;

/// The position of the header and of the data in the message's payload.
const HEADER_AT: usize = 3;
const DATA_AT: usize = 15;

/// A received request.
#[derive(Clone, Copy)]
pub(super) struct Request<'a> {
    pub(super) seq: u16,
    /// The number that the client has given its session (F-12).
    pub(super) session: u8,
    pub(super) opcode: MavFtpOpcode,
    pub(super) size: u8,
    pub(super) offset: u32,
    /// The data without trailing zeros, which MAVLink 2 does not send.
    pub(super) data: &'a [u8],
    /// Header and data.
    all: &'a [u8],
}

impl<'a> Request<'a> {
    pub(super) fn of(payload: &'a [u8]) -> Self {
        let mut header = [0; 12];
        crate::message::zero_extend(payload.get(HEADER_AT..).unwrap_or_default(), &mut header);
        let [seq0, seq1, session, opcode, size, _, _, _, a, b, c, d] = header;
        let end = DATA_AT.saturating_add(usize::from(size)).min(payload.len());
        Self {
            seq: u16::from_le_bytes([seq0, seq1]),
            session,
            opcode: MavFtpOpcode(opcode),
            size,
            offset: u32::from_le_bytes([a, b, c, d]),
            data: payload.get(DATA_AT..end).unwrap_or_default(),
            all: payload.get(HEADER_AT..end).unwrap_or_default(),
        }
    }

    /// Returns a digest that only identical requests share (F-13). It is not 0.
    pub(super) fn digest(&self) -> u32 {
        let mut crc = Crc32::new();
        crc.add(self.all);
        crc.sum() | 1
    }

    /// Returns the length of the data that it asks for: a client that gives none takes as much as there is room for.
    pub(super) const fn wanted(&self) -> u8 {
        if self.size == 0 { 239 } else { self.size }
    }
}

/// What an answer contains.
#[derive(Debug)]
pub enum Body {
    /// So many bytes of data, which are in the packet already.
    Data(usize),
    /// It is not sent now.
    Later,
    /// The request is refused.
    Refused(MavFtpErr),
}

/// The payload of the message: header and data.
pub(super) type Payload = [u8; 254];

/// Returns the place of the data.
pub(super) fn data(payload: &mut Payload) -> &mut [u8] {
    payload.get_mut(DATA_AT..).unwrap_or_default()
}

/// The header of an answer.
#[derive(Clone, Copy)]
pub(super) struct Head {
    pub(super) to: Address,
    pub(super) seq: u16,
    pub(super) session: u8,
    pub(super) opcode: MavFtpOpcode,
    pub(super) offset: u32,
}

/// Writes the header in front of the data. Returns false if there is nothing to send.
pub(super) fn complete(payload: &mut Payload, head: &Head, body: &Body, ends: bool) -> bool {
    let (opcode, size) = match body {
        Body::Data(len) => (MavFtpOpcode::ACK, u8::try_from(*len).unwrap_or(0)),
        Body::Later => return false,
        Body::Refused(error) => {
            if let Some(first) = data(payload).first_mut() {
                *first = error.0;
            }
            (MavFtpOpcode::NAK, 1)
        }
    };
    let [seq0, seq1] = head.seq.to_le_bytes();
    let [a, b, c, d] = head.offset.to_le_bytes();
    let (system, component) = (head.to.system.0, head.to.component.0);
    if let Some(front) = payload.first_chunk_mut() {
        *front = [
            0,
            system,
            component,
            seq0,
            seq1,
            head.session,
            opcode.0,
            size,
            head.opcode.0,
            u8::from(ends),
            0,
            a,
            b,
            c,
            d,
        ];
    }
    // What is behind the data is not sent.
    data(payload).get_mut(usize::from(size)..).unwrap_or_default().fill(0);
    true
}
