//! Files in memory, and packets of the file transfer protocol.

use super::TestVehicle;
use mavstack::dialect::{FileTransferProtocol, MavFtpErr, MavFtpOpcode};
use mavstack::files::{FileAccess, FileChange, FileEntry, OpenFile, StaticFile};
use mavstack::{Address, Context, Files, Peer};
use std::collections::BTreeMap;

/// The greatest offset and size of a file (bytes): a client may ask for 4 GB.
const LONGEST: u32 = 1_000_000;

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
    /// The only client that may change files; `None` for all.
    pub owner: Option<Address>,
    /// The number of files that can be open at a time, if it is limited.
    pub room: Option<usize>,
    /// The number of calls of `change`, and of `write`.
    pub changes: usize,
    pub writes: usize,
    /// Whether every read fails.
    pub is_broken: bool,
}

impl MemoryFiles {
    /// Returns an error for a client that must not change files.
    fn authorise(&self, from: Peer) -> Result<(), MavFtpErr> {
        if self.owner.is_some_and(|owner| owner != from.address) { Err(MavFtpErr::FILEPROTECTED) } else { Ok(()) }
    }

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

    fn open(
        &mut self,
        _: &mut Context<'_>,
        path: &[u8],
        access: FileAccess,
        from: Peer,
    ) -> Result<OpenFile, MavFtpErr> {
        let path = text(path);
        let files = &mut self.files;
        if access != FileAccess::Read {
            files.authorise(from)?;
        }
        if path.starts_with("locked") {
            return Err(MavFtpErr::FILEPROTECTED);
        }
        if files.room.is_some_and(|room| files.open.len() >= room) {
            return Err(MavFtpErr::FAIL);
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

    fn write(
        &mut self,
        _: &mut Context<'_>,
        file: u16,
        offset: u32,
        bytes: &[u8],
        from: Peer,
    ) -> Result<(), MavFtpErr> {
        self.files.writes += 1;
        self.files.authorise(from)?;
        if offset > LONGEST {
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

    fn change(&mut self, _: &mut Context<'_>, change: FileChange<'_>, from: Peer) -> Result<(), MavFtpErr> {
        let files = &mut self.files;
        files.changes += 1;
        files.authorise(from)?;
        match change {
            FileChange::Remove(path) => files.content.remove(text(path)).map(drop).ok_or(MavFtpErr::FILENOTFOUND),
            FileChange::Truncate { size, .. } if size > LONGEST => Err(MavFtpErr::FAIL),
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
