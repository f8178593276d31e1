//! A boat with files and logs in memory.

use mavstack::dialect::MavFtpErr;
use mavstack::files::{FileAccess, FileChange, FileEntry, OpenFile};
use mavstack::logs::{LogInfo, LogRead};
use mavstack::prelude::*;
use mavstack::{Files, Logs, Peer};
use std::collections::BTreeMap;

/// The stack of the boat.
#[derive(mavstack::Stack)]
#[stack(vehicle: Boat, links: 1, commands: { slots: 2 }, files: { sessions: 2, upload: 1024 }, logs)]
pub struct Mavlink;

/// The boat.
#[derive(Debug, Default)]
pub struct Boat {
    pub armed: bool,
    /// The files in its root by name.
    pub files: BTreeMap<String, Vec<u8>>,
    open: BTreeMap<u16, String>,
    next: u16,
    /// The logs, the oldest first.
    pub logs: Vec<Vec<u8>>,
}

impl Vehicle for Boat {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.armed))
    }
}

impl Commands for Boat {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

fn text(path: &[u8]) -> &str {
    std::str::from_utf8(path).expect("ASCII")
}

impl Files for Boat {
    const WRITES: bool = true;

    fn directory(&mut self, path: &[u8]) -> Option<u16> {
        path.is_empty().then_some(0)
    }

    fn entry(&mut self, _: u16, index: u16) -> Option<FileEntry<'_>> {
        let (name, content) = self.files.iter().nth(index.into())?;
        Some(FileEntry { name: name.as_bytes(), size: Some(content.len() as u32), time: 1_700_000_000 })
    }

    fn open(&mut self, _: &mut Context<'_>, path: &[u8], access: FileAccess, _: Peer) -> Result<OpenFile, MavFtpErr> {
        let path = text(path);
        if path.starts_with("locked") {
            return Err(MavFtpErr::FILEPROTECTED);
        }
        match access {
            FileAccess::Read if !self.files.contains_key(path) => return Err(MavFtpErr::FILENOTFOUND),
            FileAccess::Read => {}
            FileAccess::Write => drop(self.files.entry(path.to_owned()).or_default()),
            FileAccess::Create => drop(self.files.insert(path.to_owned(), Vec::new())),
        }
        self.next += 1;
        self.open.insert(self.next, path.to_owned());
        Ok(OpenFile { number: self.next, size: self.files[path].len() as u32 })
    }

    fn read(&mut self, file: u16, offset: u32, out: &mut [u8]) -> Result<usize, MavFtpErr> {
        let content = self.files.get(&self.open[&file]).ok_or(MavFtpErr::FAIL)?;
        let rest = content.get(offset as usize..).unwrap_or_default();
        let len = rest.len().min(out.len());
        out[..len].copy_from_slice(&rest[..len]);
        Ok(len)
    }

    fn write(&mut self, _: &mut Context<'_>, file: u16, offset: u32, bytes: &[u8], _: Peer) -> Result<(), MavFtpErr> {
        let content = self.files.get_mut(&self.open[&file]).ok_or(MavFtpErr::FAIL)?;
        let (begin, end) = (offset as usize, offset as usize + bytes.len());
        content.resize(content.len().max(end), 0);
        content[begin..end].copy_from_slice(bytes);
        Ok(())
    }

    fn close(&mut self, _: &mut Context<'_>, file: u16) {
        self.open.remove(&file);
    }

    fn change(&mut self, _: &mut Context<'_>, change: FileChange<'_>, _: Peer) -> Result<(), MavFtpErr> {
        match change {
            FileChange::Remove(path) => self.files.remove(text(path)).map(drop).ok_or(MavFtpErr::FILENOTFOUND),
            FileChange::Truncate { path, size } => {
                let content = self.files.get_mut(text(path)).ok_or(MavFtpErr::FILENOTFOUND)?;
                content.resize(size as usize, 0);
                Ok(())
            }
            FileChange::Rename { from, to } => {
                let content = self.files.remove(text(from)).ok_or(MavFtpErr::FILENOTFOUND)?;
                self.files.insert(text(to).to_owned(), content);
                Ok(())
            }
            FileChange::CreateDirectory(_) | FileChange::RemoveDirectory(_) => Err(MavFtpErr::FAIL),
        }
    }
}

impl Logs for Boat {
    fn log_count(&self) -> u16 {
        self.logs.len() as u16
    }

    fn log_info(&self, id: u16) -> Option<LogInfo> {
        let log = self.logs.get(usize::from(id))?;
        Some(LogInfo { size: log.len() as u32, time_utc: 1_700_000_000 + u32::from(id) })
    }

    fn read_log(&mut self, id: u16, offset: u32, out: &mut [u8]) -> LogRead {
        out.copy_from_slice(&self.logs[usize::from(id)][offset as usize..][..out.len()]);
        LogRead::Done
    }

    fn erase_logs(&mut self, _: &mut Context<'_>, _: Peer) -> bool {
        self.logs.clear();
        true
    }
}
