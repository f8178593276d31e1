//! The packets of the protocol.

use crate::{Io, Received};
use mavstack::Address;
use mavstack::dialect::{FileTransferProtocol, MavFtpErr, MavFtpOpcode};

/// The most bytes of data in a packet.
pub const MAX_DATA: u8 = 239;

/// Where the data begins in the payload of FILE_TRANSFER_PROTOCOL.
const HEADER: usize = 12;

/// A packet: the payload of FILE_TRANSFER_PROTOCOL.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// The sequence number. An answer has that of its request plus one.
    pub number: u16,
    /// The session.
    pub session: u8,
    /// The operation: a request's, or ACK or NAK.
    pub opcode: MavFtpOpcode,
    /// In an answer: the operation of the request.
    pub request: MavFtpOpcode,
    /// The size field. In a request to read it is the number of bytes that are wanted.
    pub size: u8,
    /// In an answer to BurstReadFile: whether it is the last packet of the burst.
    pub is_last: bool,
    /// The offset (bytes), or the index of a directory's entry.
    pub offset: u32,
    /// The data. Without data, the payload is filled with zeros.
    pub data: Vec<u8>,
}

impl Packet {
    /// Returns a request with data. Its number and its session are 0.
    pub fn request(opcode: MavFtpOpcode, offset: u32, data: &[u8]) -> Self {
        let data = data[..data.len().min(usize::from(MAX_DATA))].to_vec();
        Self {
            number: 0,
            session: 0,
            opcode,
            request: MavFtpOpcode::NONE,
            size: data.len() as u8,
            is_last: false,
            offset,
            data,
        }
    }

    /// Returns a request for up to `size` bytes from `offset` on.
    pub fn read(opcode: MavFtpOpcode, offset: u32, size: u8) -> Self {
        Self { size, ..Self::request(opcode, offset, &[]) }
    }

    /// Returns the packet of a received frame, if it is one of the vehicle for this station.
    pub(super) fn of(io: &Io<'_>, frame: &Received) -> Option<Self> {
        let message = frame.decode::<FileTransferProtocol>()?;
        let is_ours = frame.source() == io.target() && io.is_for_us(message.target_system, message.target_component);
        is_ours.then(|| Self::from(&message))
    }

    /// Returns the message with this packet.
    pub fn message(&self, target: Address) -> FileTransferProtocol {
        let mut payload = [0; 251];
        payload[..2].copy_from_slice(&self.number.to_le_bytes());
        payload[2..7].copy_from_slice(&[
            self.session,
            self.opcode.0,
            self.size,
            self.request.0,
            u8::from(self.is_last),
        ]);
        payload[8..HEADER].copy_from_slice(&self.offset.to_le_bytes());
        payload[HEADER..][..self.data.len()].copy_from_slice(&self.data);
        FileTransferProtocol {
            target_network: 0,
            target_system: target.system.wire(),
            target_component: target.component.wire(),
            payload,
        }
    }

    /// Returns the error of a NAK; `None` if it is none. A NAK without an error counts as [`MavFtpErr::FAIL`].
    pub fn error(&self) -> Option<MavFtpErr> {
        /// The error number of POSIX for a file that does not exist, which PX4 sends.
        const ENOENT: u8 = 2;
        match (self.opcode, &self.data[..]) {
            (MavFtpOpcode::NAK, [2, ENOENT, ..]) => Some(MavFtpErr::FILENOTFOUND),
            (MavFtpOpcode::NAK, data) => Some(data.first().map_or(MavFtpErr::FAIL, |error| MavFtpErr(*error))),
            _ => None,
        }
    }

    /// Returns the data as a number of 32 bits.
    pub(super) fn number_32(&self) -> Option<u32> {
        self.data.first_chunk().map(|bytes| u32::from_le_bytes(*bytes))
    }
}

impl From<&FileTransferProtocol> for Packet {
    fn from(message: &FileTransferProtocol) -> Self {
        let [n0, n1, session, opcode, size, request, is_last, _, o0, o1, o2, o3, data @ ..] = &message.payload;
        Self {
            number: u16::from_le_bytes([*n0, *n1]),
            session: *session,
            opcode: MavFtpOpcode(*opcode),
            request: MavFtpOpcode(*request),
            size: *size,
            is_last: *is_last != 0,
            offset: u32::from_le_bytes([*o0, *o1, *o2, *o3]),
            data: data[..usize::from((*size).min(MAX_DATA))].to_vec(),
        }
    }
}
