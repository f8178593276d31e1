//! Operations of one request.

use super::packet::Packet;
use super::requests::Requests;
use super::rules::Step;
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::MavFtpOpcode;

/// Changes files or directories, or ends sessions, by one request.
///
/// QGroundControl removes files, and has no button for the rest: it is sent as its RemoveFile would be.
#[derive(Debug)]
pub struct Operation {
    inner: Exchange,
}

/// Requests the checksum of a file's content. Ends with it; [`crc32`](super::crc32) computes the one to expect.
#[derive(Debug)]
pub struct Checksum {
    inner: Exchange,
}

impl Operation {
    fn new(opcode: MavFtpOpcode, path: &str, more: Option<&str>, offset: u32) -> Self {
        let paths = [Some(path), more].into_iter().flatten().map(str::to_owned).collect();
        Self { inner: Exchange { opcode, paths, offset, state: None } }
    }

    /// Removes a file.
    pub fn remove(path: &str) -> Self {
        Self::new(MavFtpOpcode::REMOVEFILE, path, None, 0)
    }

    /// Renames or moves a file.
    pub fn rename(from: &str, to: &str) -> Self {
        Self::new(MavFtpOpcode::RENAME, from, Some(to), 0)
    }

    /// Cuts a file, or fills it with zeros, to `size` bytes.
    pub fn truncate(path: &str, size: u32) -> Self {
        Self::new(MavFtpOpcode::TRUNCATEFILE, path, None, size)
    }

    /// Creates a directory.
    pub fn create_directory(path: &str) -> Self {
        Self::new(MavFtpOpcode::CREATEDIRECTORY, path, None, 0)
    }

    /// Removes an empty directory.
    pub fn remove_directory(path: &str) -> Self {
        Self::new(MavFtpOpcode::REMOVEDIRECTORY, path, None, 0)
    }

    /// Ends all sessions of the station.
    pub fn reset_sessions() -> Self {
        Self { inner: Exchange { opcode: MavFtpOpcode::RESETSESSION, paths: Vec::new(), offset: 0, state: None } }
    }
}

impl Checksum {
    /// Requests that of the file `path`.
    pub fn new(path: &str) -> Self {
        Self { inner: Operation::new(MavFtpOpcode::CALCFILECRC, path, None, 0).inner }
    }
}

impl Dialogue for Operation {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        Some(self.inner.poll(io)?.map(drop))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        self.inner.receive(io, frame);
    }
}

impl Dialogue for Checksum {
    type Output = u32;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<u32, Failure>> {
        let sum = |packet: Packet| {
            packet.number_32().ok_or_else(|| Failure::Protocol("a checksum without its 4 bytes".to_owned()))
        };
        Some(self.inner.poll(io)?.and_then(sum))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        self.inner.receive(io, frame);
    }
}

/// A request and its answer.
#[derive(Debug)]
struct Exchange {
    opcode: MavFtpOpcode,
    paths: Vec<String>,
    offset: u32,
    state: Option<State>,
}

#[derive(Debug)]
struct State {
    requests: Requests,
    answer: Option<Packet>,
}

impl Exchange {
    fn begin(&self, io: &mut Io<'_>) -> State {
        let mut requests = Requests::begin(io, self.paths.first().map_or("", String::as_str));
        // Two paths are separated by a NUL. MAVSDK sends one behind the last path too.
        let mut data = self.paths.join("\0").into_bytes();
        if io.client() == Client::Mavsdk && !data.is_empty() {
            data.push(0);
        }
        requests.send(io, Step::Operation, Packet::request(self.opcode, self.offset, &data));
        State { requests, answer: None }
    }

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Packet, Failure>> {
        if self.state.is_none() {
            self.state = Some(self.begin(io));
        }
        let state = self.state.as_mut()?;
        let failure = match &state.answer {
            Some(packet) => match packet.error() {
                Some(error) => state.requests.refusal(error),
                None => return Some(Ok(packet.clone())),
            },
            None => {
                let gone = state.requests.repeat_overdue(io).err()?;
                state.requests.timed_out(gone)
            }
        };
        Some(Err(state.requests.abort(io, failure)))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let (Some(state), Some(packet)) = (&mut self.state, Packet::of(io, frame))
            && state.requests.answer(io, &packet).is_some()
        {
            if io.client() == Client::MavProxy {
                state.requests.send_and_forget(io, Packet::request(MavFtpOpcode::TERMINATESESSION, 0, &[]));
            }
            state.answer = Some(packet);
        }
    }
}
