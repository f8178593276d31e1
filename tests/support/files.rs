//! Files in memory, and a client of the file transfer protocol.

use super::{Gcs, TestVehicle, millis};
use mavstack::dialect::{FileTransferProtocol, MavFtpErr, MavFtpOpcode};
use mavstack::files::{FileAccess, FileChange, FileEntry, OpenFile, StaticFile};
use mavstack::{Address, Context, Duration, Files, Instant};
use std::collections::{BTreeMap, VecDeque};

/// The static files of the test vehicle.
pub const STATIC: &[StaticFile] = &[
    StaticFile::new("general.json", b"{\"version\":1}"),
    StaticFile::new("docs/licence.txt", b"MIT"),
    StaticFile::new("docs/more/notes.txt", b"none"),
    StaticFile::new("docs/empty", b""),
];

/// Files that can be written.
#[derive(Clone, Debug, Default)]
pub struct MemoryFiles {
    /// The content by path. A path that ends in a slash is a directory.
    pub content: BTreeMap<String, Vec<u8>>,
    /// The open files by number.
    pub open: BTreeMap<u16, String>,
    /// The paths of the directories that were listed.
    directories: Vec<String>,
    next: u16,
    /// The number of calls of `change`, and of `write`.
    pub changes: usize,
    pub writes: usize,
    /// Whether every read fails.
    pub is_broken: bool,
}

impl MemoryFiles {
    /// The entries directly in a directory: name, and size of a file.
    fn entries(&self, directory: &str) -> Vec<(String, Option<u32>)> {
        let mut entries = Vec::new();
        for (path, bytes) in &self.content {
            let rest =
                if directory.is_empty() { Some(path.as_str()) } else { path.strip_prefix(&format!("{directory}/")) };
            let Some(rest) = rest.filter(|rest| !rest.is_empty()) else { continue };
            let entry = match rest.split_once('/') {
                Some((name, _)) => (name.to_string(), None),
                None => (rest.to_string(), Some(bytes.len() as u32)),
            };
            if !entries.contains(&entry) {
                entries.push(entry);
            }
        }
        entries
    }
}

/// Paths are ASCII.
fn text(path: &[u8]) -> &str {
    std::str::from_utf8(path).expect("ASCII")
}

impl Files for TestVehicle {
    const FILES: &'static [StaticFile] = STATIC;
    const WRITES: bool = true;

    fn directory(&mut self, path: &[u8]) -> Option<u16> {
        let path = text(path);
        let files = &mut self.files;
        if !path.is_empty() && files.entries(path).is_empty() && !files.content.contains_key(&format!("{path}/")) {
            return None;
        }
        let known = files.directories.iter().position(|other| other == path);
        let number = known.unwrap_or_else(|| {
            files.directories.push(path.to_string());
            files.directories.len() - 1
        });
        Some(number as u16)
    }

    fn entry(&mut self, directory: u16, index: u16) -> Option<FileEntry<'_>> {
        let path = self.files.directories[usize::from(directory)].clone();
        let (name, size) = self.files.entries(&path).get(usize::from(index))?.clone();
        let full = self.files.content.keys().find(|full| full.contains(&name))?;
        let at = full.find(&name)?;
        Some(FileEntry { name: &full.as_bytes()[at..at + name.len()], size, time: 1_700_000_000 })
    }

    fn open(&mut self, _: &mut Context<'_>, path: &[u8], access: FileAccess) -> Result<OpenFile, MavFtpErr> {
        let path = text(path);
        let files = &mut self.files;
        if path.starts_with("locked") {
            return Err(MavFtpErr::FILEPROTECTED);
        }
        match access {
            FileAccess::Read if !files.content.contains_key(path) => return Err(MavFtpErr::FILENOTFOUND),
            FileAccess::Read => {}
            FileAccess::Write => drop(files.content.entry(path.to_string()).or_default()),
            FileAccess::Create => drop(files.content.insert(path.to_string(), Vec::new())),
        }
        files.next += 1;
        files.open.insert(files.next, path.to_string());
        Ok(OpenFile { number: files.next, size: files.content[path].len() as u32 })
    }

    fn read(&mut self, file: u16, offset: u32, out: &mut [u8]) -> Result<usize, MavFtpErr> {
        assert!(out.len() <= 239);
        if self.files.is_broken {
            return Err(MavFtpErr::FAIL);
        }
        let path = self.files.open.get(&file).expect("an open file");
        let bytes = self.files.content.get(path).ok_or(MavFtpErr::FAIL)?;
        let rest = bytes.get(offset as usize..).unwrap_or_default();
        let len = rest.len().min(out.len());
        out[..len].copy_from_slice(&rest[..len]);
        Ok(len)
    }

    fn write(&mut self, _: &mut Context<'_>, file: u16, offset: u32, bytes: &[u8]) -> Result<(), MavFtpErr> {
        self.files.writes += 1;
        if offset > 1_000_000 {
            return Err(MavFtpErr::FAIL);
        }
        let path = self.files.open.get(&file).expect("an open file");
        let content = self.files.content.get_mut(path).ok_or(MavFtpErr::FAIL)?;
        let begin = offset as usize;
        content.resize(content.len().max(begin + bytes.len()), 0);
        content[begin..begin + bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    fn close(&mut self, _: &mut Context<'_>, file: u16) {
        assert!(self.files.open.remove(&file).is_some(), "a file is closed once");
    }

    fn change(&mut self, _: &mut Context<'_>, change: FileChange<'_>) -> Result<(), MavFtpErr> {
        let files = &mut self.files;
        files.changes += 1;
        match change {
            FileChange::Remove(path) => files.content.remove(text(path)).map(drop).ok_or(MavFtpErr::FILENOTFOUND),
            FileChange::Truncate { path, size } => files
                .content
                .get_mut(text(path))
                .map(|bytes| bytes.resize(size as usize, 0))
                .ok_or(MavFtpErr::FILENOTFOUND),
            FileChange::Rename { from, to } => {
                let (from, to) = (text(from), text(to));
                if files.content.contains_key(to) {
                    return Err(MavFtpErr::FILEEXISTS);
                }
                let bytes = files.content.remove(from).ok_or(MavFtpErr::FILENOTFOUND)?;
                files.content.insert(to.to_string(), bytes);
                Ok(())
            }
            FileChange::CreateDirectory(path) => {
                files.content.insert(format!("{}/", text(path)), Vec::new());
                Ok(())
            }
            FileChange::RemoveDirectory(path) => {
                files.content.remove(&format!("{}/", text(path))).map(drop).ok_or(MavFtpErr::FILENOTFOUND)
            }
        }
    }
}

/// A packet as its receiver sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    pub seq: u16,
    pub session: u8,
    pub opcode: MavFtpOpcode,
    pub request: MavFtpOpcode,
    pub is_last: bool,
    pub offset: u32,
    pub data: Vec<u8>,
}

impl Packet {
    pub fn of(message: &FileTransferProtocol) -> Self {
        let p = &message.payload;
        Self {
            seq: u16::from_le_bytes([p[0], p[1]]),
            session: p[2],
            opcode: MavFtpOpcode(p[3]),
            request: MavFtpOpcode(p[5]),
            is_last: p[6] != 0,
            offset: u32::from_le_bytes([p[8], p[9], p[10], p[11]]),
            data: p[12..12 + usize::from(p[4]).min(239)].to_vec(),
        }
    }

    /// Returns the error, if it is one.
    pub fn error(&self) -> Option<MavFtpErr> {
        (self.opcode == MavFtpOpcode::NAK).then(|| MavFtpErr(self.data[0]))
    }
}

/// Returns a request.
pub fn request(
    seq: u16,
    session: u8,
    opcode: MavFtpOpcode,
    size: u8,
    offset: u32,
    data: &[u8],
) -> FileTransferProtocol {
    let mut payload = [0; 251];
    payload[..2].copy_from_slice(&seq.to_le_bytes());
    (payload[2], payload[3], payload[4]) = (session, opcode.0, size);
    payload[8..12].copy_from_slice(&offset.to_le_bytes());
    payload[12..12 + data.len()].copy_from_slice(data);
    FileTransferProtocol { target_network: 0, target_system: 1, target_component: 1, payload }
}

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
        self.due = now.after(self.timeout);
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
            (message.target_system, message.target_component) == (self.address.system.0, self.address.component.0)
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
                Some(MavFtpErr::NOSESSIONSAVAILABLE) => self.due = now.after(self.timeout),
                Some(error) => self.phase = Phase::Done(Err(error)),
                None if self.upload.is_some() => self.next_write(now, gcs, 0),
                None => {
                    self.phase = Phase::Burst;
                    self.ask(now, gcs, MavFtpOpcode::BURSTREADFILE, self.block, 0, &[]);
                }
            },
            Phase::Burst if packet.request == MavFtpOpcode::BURSTREADFILE => {
                self.due = now.after(self.timeout);
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
