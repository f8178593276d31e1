//! Reading a file.

use super::MAX_DATA;
use super::packet::Packet;
use super::requests::{Answered, Gone, Requests};
use super::rules::{Closing, Filling, Step};
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::Instant;
use mavstack::dialect::{MavFtpErr, MavFtpOpcode};

/// How a file is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reading {
    /// By BurstReadFile, and its gaps by ReadFile: what every client does by default.
    #[default]
    Burst,
    /// By ReadFile alone, as MAVSDK does without `use_burst`.
    Single,
}

/// Reads a file. Ends with its content.
///
/// The real MAVSDK fails to read an empty file by a burst, and so does this one.
#[derive(Debug)]
pub struct Download {
    path: String,
    reading: Reading,
    /// Bytes of data in a packet; `None` as the client does.
    block: Option<u8>,
    transfer: Option<Transfer>,
}

impl Download {
    /// Reads the file `path`, for example `@PARAM/param.pck`.
    pub fn new(path: impl Into<String>) -> Self {
        Self { path: path.into(), reading: Reading::default(), block: None, transfer: None }
    }

    /// Reads it in another way.
    #[must_use]
    pub fn with_reading(mut self, reading: Reading) -> Self {
        self.reading = reading;
        self
    }

    /// Requests packets of this many bytes, from 1 to 239, as the setting `burst_read_size` of MAVProxy and pymavlink does.
    #[must_use]
    pub fn with_block(mut self, bytes: u8) -> Self {
        self.block = Some(bytes.clamp(1, MAX_DATA));
        self
    }
}

impl Dialogue for Download {
    type Output = Vec<u8>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<u8>, Failure>> {
        let transfer = self.transfer.get_or_insert_with(|| {
            let block = self.block.unwrap_or(io.client().ftp_block());
            Transfer::begin(io, &self.path, self.reading, block)
        });
        transfer.poll(io)
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let (Some(transfer), Some(packet)) = (&mut self.transfer, Packet::of(io, frame)) {
            transfer.take(io, &packet);
        }
    }
}

/// A file that is being read.
#[derive(Debug)]
struct Transfer {
    reading: Reading,
    /// Bytes of data in a packet.
    block: u8,
    requests: Requests,
    phase: Phase,
    content: Vec<u8>,
    /// The announced size (bytes).
    size: u32,
    /// What is missing before `at`, in pieces of one packet.
    gaps: Vec<Gap>,
    /// The end of what the burst has brought.
    at: u32,
    burst: Burst,
    result: Option<Result<(), Failure>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Open,
    Burst,
    /// The burst has ended: the gaps are read.
    Gaps,
    Close,
}

/// A part that is missing.
#[derive(Clone, Copy, Debug)]
struct Gap {
    offset: u32,
    len: u32,
    is_requested: bool,
}

/// A running burst.
#[derive(Clone, Copy, Debug, Default)]
struct Burst {
    /// The request, as it was sent last.
    offset: u32,
    due: Instant,
    /// How often it was sent since the last answer, or since a burst was complete: as the client counts.
    sends: u32,
    /// When the next gap may be read.
    next_gap: Instant,
}

impl Transfer {
    fn begin(io: &mut Io<'_>, path: &str, reading: Reading, block: u8) -> Self {
        let mut requests = Requests::begin(io, path);
        let path = io.client().ftp_path(path);
        requests.send(io, Step::Open, Packet::request(MavFtpOpcode::OPENFILERO, 0, &path));
        Self {
            reading,
            block,
            requests,
            phase: Phase::Open,
            content: Vec::new(),
            size: 0,
            gaps: Vec::new(),
            at: 0,
            burst: Burst::default(),
            result: None,
        }
    }

    fn client(&self) -> Client {
        self.requests.client()
    }

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<u8>, Failure>> {
        if self.result.is_none() {
            self.time_out(io);
        }
        match self.result.take()? {
            Ok(()) => Some(Ok(std::mem::take(&mut self.content))),
            Err(failure) => Some(Err(self.requests.abort(io, failure))),
        }
    }

    fn time_out(&mut self, io: &mut Io<'_>) {
        if let Err(gone) = self.requests.repeat_overdue(io) {
            self.give_up(gone);
        } else if self.phase == Phase::Burst && io.now() >= self.burst.due {
            self.continue_stalled(io);
        } else if matches!(self.phase, Phase::Burst | Phase::Gaps) {
            self.read_gaps(io);
        }
    }

    fn give_up(&mut self, gone: Gone) {
        let loosely = matches!(self.client().ftp_closing(), Closing::Reset | Closing::TerminateLoosely)
            // MAVSDK has all data, and takes the missing answer for a success.
            || self.reading == Reading::Burst;
        self.result = Some(match gone.step {
            Step::Close if loosely => Ok(()),
            _ => Err(self.requests.timed_out(gone)),
        });
    }

    fn fail(&mut self, failure: Failure) {
        self.result = Some(Err(failure));
    }

    fn take(&mut self, io: &mut Io<'_>, packet: &Packet) {
        if self.result.is_some() || !self.requests.is_ours(packet) {
            return;
        }
        if packet.request == MavFtpOpcode::BURSTREADFILE {
            if self.phase == Phase::Burst && !self.requests.is_old(packet) {
                self.take_burst(io, packet);
            }
        } else if let Some(answered) = self.requests.answer(io, packet) {
            match answered.step {
                Step::Open => self.take_open(io, packet, &answered),
                Step::Read => self.take_gap(io, packet, &answered),
                _ => self.take_close(packet),
            }
        }
    }

    fn take_open(&mut self, io: &mut Io<'_>, packet: &Packet, answered: &Answered) {
        match packet.error() {
            None => self.size = packet.number_32().unwrap_or(0),
            // The first request was carried out, and the file is open already.
            Some(MavFtpErr::FAIL) if self.client() == Client::MavProxy && answered.sends > 1 => {}
            Some(error) => return self.fail(self.requests.refusal(error)),
        }
        match self.reading {
            Reading::Burst => self.request_burst(io, 0),
            Reading::Single => {
                self.miss_until(self.size);
                self.end_burst(io);
            }
        }
    }

    /// Requests the rest by a burst.
    fn request_burst(&mut self, io: &mut Io<'_>, offset: u32) {
        self.phase = Phase::Burst;
        self.burst.sends = 0;
        self.send_burst(io, offset);
    }

    fn send_burst(&mut self, io: &mut Io<'_>, offset: u32) {
        let request = Packet::read(MavFtpOpcode::BURSTREADFILE, offset, self.block);
        self.requests.send_and_forget(io, request);
        self.burst.offset = offset;
        self.burst.sends += 1;
        self.burst.due = io.now() + self.requests.timeout(Step::Burst);
    }

    /// Nothing has come for a while: the request, its answer or the end of the burst was lost.
    fn continue_stalled(&mut self, io: &mut Io<'_>) {
        let limit = self.client().ftp_patience(Step::Burst).sends;
        if self.burst.sends >= limit || self.requests.is_hopeless(io.now()) {
            let gone = Gone { step: Step::Burst, sends: self.burst.sends };
            return self.fail(self.requests.timed_out(gone));
        }
        match self.client() {
            Client::QGroundControl => {
                self.requests.reuse_number();
                self.send_burst(io, self.at);
            }
            Client::Mavsdk if self.size > 0 && self.at > 0 => {
                self.miss_until(self.size);
                self.end_burst(io);
            }
            _ => self.send_burst(io, self.at),
        }
    }

    fn take_burst(&mut self, io: &mut Io<'_>, packet: &Packet) {
        match packet.error() {
            None => self.take_burst_data(io, packet),
            Some(MavFtpErr::EOF) => self.take_burst_end(io, packet),
            Some(error) => self.fail(self.requests.refusal(error)),
        }
    }

    fn take_burst_data(&mut self, io: &mut Io<'_>, packet: &Packet) {
        self.requests.follow(io, packet);
        self.burst.due = io.now() + self.requests.timeout(Step::Burst);
        if self.client() != Client::QGroundControl {
            self.burst.sends = 1;
        }
        if packet.offset < self.at {
            // A duplicate, or a gap that another burst has brought.
            if let Some(index) = self.gap_at(packet.offset, packet.data.len()) {
                self.gaps.remove(index);
                self.store(packet);
            }
            return;
        }
        self.miss_until(packet.offset);
        self.store(packet);
        self.at = packet.offset + packet.data.len() as u32;
        let is_short = packet.data.len() < usize::from(self.block);
        let is_end = match self.client() {
            // It waits for the answer that the file has ended.
            Client::QGroundControl => false,
            Client::Mavsdk => self.at >= self.size,
            Client::MavProxy | Client::Pymavlink => packet.is_last && is_short,
        };
        if is_end {
            self.end_burst(io);
        } else if packet.is_last {
            self.request_burst(io, self.at);
        }
    }

    /// The server says that the file has ended.
    fn take_burst_end(&mut self, io: &mut Io<'_>, packet: &Packet) {
        match self.client() {
            Client::QGroundControl if !self.requests.is_in_order(packet) => {
                self.requests.follow(io, &Packet { is_last: true, ..packet.clone() });
                self.request_burst(io, self.at);
            }
            Client::Mavsdk => self.fail(self.requests.refusal(MavFtpErr::EOF)),
            // The end of the burst was lost: the stalled burst will be continued.
            Client::MavProxy | Client::Pymavlink if packet.offset > self.at => {}
            _ => self.end_burst(io),
        }
    }

    /// Notes that everything from `at` to `end` is missing.
    fn miss_until(&mut self, end: u32) {
        let block = u32::from(self.block);
        while self.at < end {
            let len = block.min(end - self.at);
            self.gaps.push(Gap { offset: self.at, len, is_requested: false });
            self.at += len;
        }
    }

    fn end_burst(&mut self, io: &mut Io<'_>) {
        self.phase = Phase::Gaps;
        self.read_gaps(io);
    }

    /// Requests what is missing, as much at once as the client does; closes the file if nothing is.
    fn read_gaps(&mut self, io: &mut Io<'_>) {
        let filling = self.client().ftp_filling();
        if self.phase == Phase::Burst && filling != Filling::During {
            return;
        }
        if self.gaps.is_empty() && self.phase == Phase::Gaps {
            return self.close(io);
        }
        while self.requests.waiting(Step::Read) < self.client().ftp_window() && io.now() >= self.burst.next_gap {
            let Some(gap) = self.gaps.iter_mut().find(|gap| !gap.is_requested) else { return };
            gap.is_requested = true;
            let request = Packet::read(MavFtpOpcode::READFILE, gap.offset, gap.len as u8);
            self.requests.send(io, Step::Read, request);
            if let Filling::Paced(pause) = filling {
                self.burst.next_gap = io.now() + pause;
            }
        }
    }

    fn gap_at(&self, offset: u32, len: usize) -> Option<usize> {
        self.gaps.iter().position(|gap| gap.offset == offset && gap.len as usize == len)
    }

    fn take_gap(&mut self, io: &mut Io<'_>, packet: &Packet, answered: &Answered) {
        if let Some(error) = packet.error() {
            return self.fail(self.requests.refusal(error));
        }
        let asked = answered.request.offset;
        let Some(index) = self.gaps.iter().position(|gap| gap.offset == asked) else { return };
        let (gap, len) = (&mut self.gaps[index], packet.data.len() as u32);
        if packet.offset != asked || len == 0 || len > gap.len {
            let what = format!("{len} bytes from {} were sent for {} from {asked}", packet.offset, gap.len);
            return self.fail(Failure::Protocol(what));
        }
        *gap = Gap { offset: gap.offset + len, len: gap.len - len, is_requested: false };
        if gap.len == 0 {
            self.gaps.remove(index);
        }
        self.store(packet);
        self.read_gaps(io);
    }

    fn store(&mut self, packet: &Packet) {
        let (begin, end) = (packet.offset as usize, packet.offset as usize + packet.data.len());
        self.content.resize(self.content.len().max(end), 0);
        self.content[begin..end].copy_from_slice(&packet.data);
    }

    fn close(&mut self, io: &mut Io<'_>) {
        self.phase = Phase::Close;
        self.requests.clear();
        if self.client() == Client::QGroundControl && self.content.len() as u32 != self.size {
            let what = format!("the file has {} bytes instead of the announced {}", self.content.len(), self.size);
            return self.fail(Failure::Protocol(what));
        }
        let terminate = Packet::request(MavFtpOpcode::TERMINATESESSION, 0, &[]);
        match self.client().ftp_closing() {
            Closing::Reset => {
                self.requests.send(io, Step::Close, Packet::request(MavFtpOpcode::RESETSESSION, 0, &[]));
            }
            Closing::Terminate | Closing::TerminateLoosely => self.requests.send(io, Step::Close, terminate),
            Closing::TerminateAndForget => {
                self.requests.send_and_forget(io, terminate);
                self.result = Some(Ok(()));
            }
        }
    }

    fn take_close(&mut self, packet: &Packet) {
        self.result = Some(match packet.error() {
            Some(error) if self.client().ftp_closing() == Closing::Terminate => Err(self.requests.refusal(error)),
            _ => Ok(()),
        });
    }
}
