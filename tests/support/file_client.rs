//! A client of the file transfer protocol.

use super::files::{Packet, request};
use super::{Gcs, millis};
use mavstack::dialect::{FileTransferProtocol, MavFtpErr, MavFtpOpcode};
use mavstack::{Address, Duration, Instant};
use std::collections::{BTreeMap, VecDeque};

/// A client that downloads a file by a burst and fills the gaps by reads, or uploads one, with retries: a state machine that is
/// polled.
#[derive(Debug)]
pub struct Transfer {
    pub address: Address,
    pub session: u8,
    /// The largest number of data bytes in a packet.
    pub block: u8,
    path: String,
    seq: u16,
    phase: Phase,
    due: Instant,
    tries: u32,
    /// The request that is repeated.
    last: FileTransferProtocol,
    /// The file's content as far as it is known.
    blocks: BTreeMap<u32, Vec<u8>>,
    end: Option<u32>,
    timeout: Duration,
    upload: Option<Vec<u8>>,
    seen: usize,
    queue: VecDeque<Packet>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Open,
    Burst,
    Gaps,
    Write(u32),
    Close,
    Done(Result<(), MavFtpErr>),
}

impl Transfer {
    pub fn download(address: Address, session: u8, seq: u16, path: &str) -> Self {
        Self::new(address, session, seq, path, None)
    }

    pub fn upload(address: Address, session: u8, seq: u16, path: &str, bytes: &[u8]) -> Self {
        Self::new(address, session, seq, path, Some(bytes.to_vec()))
    }

    fn new(address: Address, session: u8, seq: u16, path: &str, upload: Option<Vec<u8>>) -> Self {
        Self {
            address,
            session,
            block: 239,
            path: path.to_string(),
            seq,
            phase: Phase::Open,
            due: Instant::ZERO,
            tries: 0,
            last: request(0, 0, MavFtpOpcode::NONE, 0, 0, &[]),
            blocks: BTreeMap::new(),
            end: None,
            timeout: millis(300),
            upload,
            seen: 0,
            queue: VecDeque::new(),
        }
    }

    /// Returns the content of a downloaded file.
    pub fn content(&self) -> Vec<u8> {
        let mut content = Vec::new();
        for (offset, block) in &self.blocks {
            let begin = (*offset as usize).min(content.len());
            assert_eq!(begin, *offset as usize, "a gap at {offset}");
            content.resize(content.len().max(begin + block.len()), 0);
            content[begin..begin + block.len()].copy_from_slice(block);
        }
        content
    }

    fn first_gap(&self) -> u32 {
        let mut at = 0;
        for (offset, block) in &self.blocks {
            if *offset > at {
                return at;
            }
            at = at.max(offset + block.len() as u32);
        }
        at
    }

    fn ask(&mut self, now: Instant, gcs: &mut Gcs, opcode: MavFtpOpcode, size: u8, offset: u32, data: &[u8]) {
        self.seq = self.seq.wrapping_add(1);
        self.last = request(self.seq, self.session, opcode, size, offset, data);
        self.tries = 0;
        self.resend(now, gcs);
    }

    fn resend(&mut self, now: Instant, gcs: &mut Gcs) {
        gcs.send_from(self.address, &self.last);
        self.tries += 1;
        self.due = now + self.timeout;
    }

    fn next_gap(&mut self, now: Instant, gcs: &mut Gcs) {
        let at = self.first_gap();
        if self.end.is_some_and(|end| at >= end) {
            self.phase = Phase::Close;
            self.ask(now, gcs, MavFtpOpcode::TERMINATESESSION, 0, 0, &[]);
            return;
        }
        self.phase = Phase::Gaps;
        let next = self.blocks.keys().find(|offset| **offset > at).copied().or(self.end).unwrap_or(u32::MAX);
        let size = (next - at).min(u32::from(self.block)) as u8;
        self.ask(now, gcs, MavFtpOpcode::READFILE, size, at, &[]);
    }

    fn next_write(&mut self, now: Instant, gcs: &mut Gcs, at: u32) {
        let bytes = self.upload.clone().unwrap_or_default();
        let rest = &bytes[at as usize..];
        if rest.is_empty() {
            self.phase = Phase::Close;
            self.ask(now, gcs, MavFtpOpcode::TERMINATESESSION, 0, 0, &[]);
            return;
        }
        let part = &rest[..rest.len().min(usize::from(self.block))];
        self.phase = Phase::Write(at + part.len() as u32);
        self.ask(now, gcs, MavFtpOpcode::WRITEFILE, part.len() as u8, at, part);
    }

    /// Handles what was received, and sends what is due. Returns the result once the transfer has ended.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> Option<Result<(), MavFtpErr>> {
        let all = gcs.received.iter().skip(self.seen).filter_map(|frame| frame.decode::<FileTransferProtocol>());
        let to_us = |message: &FileTransferProtocol| {
            (message.target_system, message.target_component)
                == (self.address.system.wire(), self.address.component.wire())
        };
        self.queue.extend(all.filter(to_us).map(|message| Packet::of(&message)));
        self.seen = gcs.received.len();
        if self.due == Instant::ZERO {
            let opcode = if self.upload.is_some() { MavFtpOpcode::CREATEFILE } else { MavFtpOpcode::OPENFILERO };
            let path = self.path.clone();
            self.ask(now, gcs, opcode, path.len() as u8, 0, path.as_bytes());
        }
        while let Some(packet) = self.queue.pop_front() {
            if packet.session == self.session {
                self.take(now, gcs, &packet);
            }
        }
        if let Phase::Done(result) = self.phase {
            return Some(result);
        }
        if now >= self.due {
            if self.tries >= 40 {
                self.phase = Phase::Done(Err(MavFtpErr(255)));
            } else if self.phase == Phase::Burst {
                // The rest of the burst.
                self.next_gap(now, gcs);
            } else {
                self.resend(now, gcs);
            }
        }
        None
    }

    fn take(&mut self, now: Instant, gcs: &mut Gcs, packet: &Packet) {
        let is_answer = packet.seq == self.seq.wrapping_add(1);
        let is_data = matches!(packet.request, MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE);
        if is_data && packet.error().is_none() {
            self.blocks.insert(packet.offset, packet.data.clone());
            if packet.data.len() < usize::from(self.block) && packet.request == MavFtpOpcode::BURSTREADFILE {
                self.end = Some(packet.offset + packet.data.len() as u32);
            }
        }
        if is_data && packet.error() == Some(MavFtpErr::EOF) {
            let end = self.end.map_or(packet.offset, |end| end.min(packet.offset));
            self.end = Some(end);
        }
        match self.phase {
            Phase::Open if is_answer => match packet.error() {
                Some(MavFtpErr::NOSESSIONSAVAILABLE) => self.due = now + self.timeout,
                Some(error) => self.phase = Phase::Done(Err(error)),
                None if self.upload.is_some() => self.next_write(now, gcs, 0),
                None => {
                    self.phase = Phase::Burst;
                    self.ask(now, gcs, MavFtpOpcode::BURSTREADFILE, self.block, 0, &[]);
                }
            },
            Phase::Burst if packet.request == MavFtpOpcode::BURSTREADFILE => {
                self.due = now + self.timeout;
                match packet.error() {
                    Some(MavFtpErr::EOF) => self.next_gap(now, gcs),
                    Some(error) => self.phase = Phase::Done(Err(error)),
                    None if packet.is_last && packet.data.len() == usize::from(self.block) => {
                        let next = packet.offset + packet.data.len() as u32;
                        self.ask(now, gcs, MavFtpOpcode::BURSTREADFILE, self.block, next, &[]);
                    }
                    None if packet.is_last => self.next_gap(now, gcs),
                    None => {}
                }
            }
            Phase::Gaps if is_answer && packet.request == MavFtpOpcode::READFILE => match packet.error() {
                None | Some(MavFtpErr::EOF) => self.next_gap(now, gcs),
                Some(error) => self.phase = Phase::Done(Err(error)),
            },
            Phase::Write(next) if is_answer => match packet.error() {
                None => self.next_write(now, gcs, next),
                Some(error) => self.phase = Phase::Done(Err(error)),
            },
            Phase::Close if is_answer => self.phase = Phase::Done(Ok(())),
            _ => {}
        }
    }
}
