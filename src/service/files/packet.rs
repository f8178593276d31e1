//! The payload of FILE_TRANSFER_PROTOCOL (F-1).

use core::num::{NonZeroU32, Wrapping};

use crate::crc32::Crc32;
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::message::zero_extend;
use crate::service::Received;
use crate::types::{Peer, Trust};

/// The maximum length of the data in a packet.
pub(super) const MAX_DATA: usize = 239;

const DATA_AT: usize = 15;

/// Identifies a session: the client, and the number that it has chosen (F-12).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SessionId {
    pub(super) client: Peer,
    pub(super) number: u8,
}

/// The part of a request that its answer repeats.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    pub(super) seq: Wrapping<u16>,
    pub(super) opcode: MavFtpOpcode,
    /// The length of the request's data, or of the data that it requests.
    pub(super) size: u8,
    pub(super) offset: u32,
}

impl Head {
    pub(super) const EMPTY: Self = Self { seq: Wrapping(0), opcode: MavFtpOpcode::NONE, size: 0, offset: 0 };

    /// Returns the length of the requested data. A client that gives none gets as much as fits.
    pub(super) const fn requested_len(&self) -> u8 {
        if self.size == 0 { 239 } else { self.size }
    }
}

/// A received request.
#[derive(Clone, Copy)]
pub(super) struct Request<'a> {
    pub(super) session: SessionId,
    /// What proves the client.
    pub(super) trust: Trust,
    /// The rate of its link (bytes/s; 0 for no limit).
    pub(super) rate: u32,
    pub(super) head: Head,
    /// The data without trailing zeros, which MAVLink 2 does not send.
    pub(super) data: &'a [u8],
    /// Identifies the request in its session: only identical ones share it (F-13).
    pub(super) digest: NonZeroU32,
}

impl<'a> Request<'a> {
    pub(super) fn decode(received: &Received<'a>, rate: u32) -> Self {
        let payload = received.frame.payload();
        let mut front = [0; DATA_AT];
        zero_extend(payload, &mut front);
        let [_, _, _, header @ ..] = front;
        let [seq_low, seq_high, number, opcode, size, _, _, _, offset @ ..] = header;
        let data = payload.get(DATA_AT..).unwrap_or_default();
        let data = data.get(..usize::from(size)).unwrap_or(data);
        let mut digest = Crc32::new();
        digest.add(&header);
        digest.add(data);
        Self {
            session: SessionId { client: received.from, number },
            trust: received.trust,
            rate,
            head: Head {
                seq: Wrapping(u16::from_le_bytes([seq_low, seq_high])),
                opcode: MavFtpOpcode(opcode),
                size,
                offset: u32::from_le_bytes(offset),
            },
            data,
            digest: NonZeroU32::MIN | digest.sum(),
        }
    }

    /// Whether it changes files or directories, or is a part of an upload (O-5).
    pub(super) fn is_change(&self) -> bool {
        matches!(
            self.head.opcode,
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
}

/// The payload of the message: the header, and the data.
pub(super) type Payload = [u8; DATA_AT + MAX_DATA];

/// Returns the data of a packet.
pub(super) fn data(payload: &mut Payload) -> &mut [u8] {
    payload.get_mut(DATA_AT..).unwrap_or_default()
}

/// Writes the header of the answer to a request: an ACK of the data in the packet, of this length, or a NAK with the error.
pub(super) fn answer(
    payload: &mut Payload,
    session: SessionId,
    request: &Head,
    result: Result<u8, MavFtpErr>,
    ends_burst: bool,
) {
    let (opcode, size) = match result {
        Ok(len) => (MavFtpOpcode::ACK, len),
        Err(error) => {
            data(payload).iter_mut().take(1).for_each(|first| *first = error.0);
            (MavFtpOpcode::NAK, 1)
        }
    };
    // Behind the data are those of the last packet. With the condition, this is not `fill`, which links a function of its own.
    for byte in data(payload).get_mut(usize::from(size)..).unwrap_or_default() {
        if *byte != 0 {
            *byte = 0;
        }
    }
    let (system, component) = (session.client.address.system.wire(), session.client.address.component.wire());
    let [seq_low, seq_high] = (request.seq + Wrapping(1)).0.to_le_bytes();
    let [a, b, c, d] = request.offset.to_le_bytes();
    let (opcode, request_opcode, ends_burst) = (opcode.0, request.opcode.0, u8::from(ends_burst));
    if let Some(header) = payload.first_chunk_mut::<DATA_AT>() {
        let network = 0;
        let number = session.number;
        *header = [
            network,
            system,
            component,
            seq_low,
            seq_high,
            number,
            opcode,
            size,
            request_opcode,
            ends_burst,
            0,
            a,
            b,
            c,
            d,
        ];
    }
}
