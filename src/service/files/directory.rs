//! Directories, and the lists of their entries (F-9).

use super::packet::Head;
use super::path;
use super::vehicle::{FileEntry, Files};
use super::virtual_files::{self, VirtualEntry, VirtualFile};
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::message::Text;
use crate::service::Cx;
use crate::types::Firmware;

/// Longer names are skipped.
const LONGEST_NAME: usize = 200;

/// In place of the index of a static file: there is none below the directory.
const NO_FILE: u8 = u8::MAX;
/// In place of the vehicle's number of a directory: it has none.
const NO_NUMBER: u16 = u16::MAX;

/// A directory of static files and of the vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Directory {
    path_len: u8,
    /// The index of a static file in or below it.
    file: u8,
    /// The vehicle's number for it.
    number: u16,
}

impl Directory {
    /// Returns the directory with this path.
    pub(super) fn find<F: Firmware<Vehicle: Files>>(cx: &mut Cx<'_, F>, path: &[u8]) -> Option<Self> {
        let file = F::Vehicle::FILES.iter().position(|file| path::below(file.path, path).is_some());
        let file = file.and_then(|index| u8::try_from(index).ok()).unwrap_or(NO_FILE);
        let number = cx.vehicle.directory(path).unwrap_or(NO_NUMBER);
        let is_found = path.is_empty() || file != NO_FILE || number != NO_NUMBER;
        let path_len = u8::try_from(path.len()).ok()?;
        is_found.then_some(Self { path_len, file, number })
    }

    /// Adds its entries to a list: static files and their directories, in the root the virtual directories, then those of the vehicle.
    pub(super) fn list<F: Firmware<Vehicle: Files>, V: VirtualFile<F>>(self, cx: &mut Cx<'_, F>, list: &mut List<'_>) {
        let path_len = usize::from(self.path_len);
        let file = F::Vehicle::FILES.get(usize::from(self.file));
        let path = file.and_then(|file| file.path.as_bytes().get(..path_len)).unwrap_or_default();
        let files = if path.len() == path_len { F::Vehicle::FILES } else { &[] };
        let names = virtual_files::names::<F, V>().filter(|_| path_len == 0);
        let virtual_directories = names.map(|name| FileEntry { name, size: None, time: 0 });
        for entry in path::static_entries(files, path).chain(virtual_directories) {
            if list.first > 0 {
                list.first = list.first.saturating_sub(1);
            } else if !list.add(&entry) {
                return;
            }
        }
        if self.number == NO_NUMBER {
            return;
        }
        let first = u16::try_from(list.first).unwrap_or(u16::MAX);
        for index in first..=u16::MAX {
            let Some(entry) = cx.vehicle.entry(self.number, index) else { break };
            if !list.add(&entry) {
                break;
            }
        }
    }
}

/// Adds the files of a virtual directory to a list.
pub(super) fn list_virtual<F: Firmware, V: VirtualFile<F>>(cx: &mut Cx<'_, F>, directory: u16, list: &mut List<'_>) {
    let first = u16::try_from(list.first).unwrap_or(u16::MAX);
    for index in first..=u16::MAX {
        let Some(VirtualEntry { name, size, time }) = V::entry(cx, directory, index) else { break };
        if !list.add(&FileEntry { name: name.as_bytes(), size: Some(size), time }) {
            break;
        }
    }
}

/// A list of entries in a packet: as many whole ones as fit.
pub(super) struct List<'a> {
    /// The number of entries to skip.
    first: u32,
    has_times: bool,
    out: &'a mut [u8],
    /// The length of the entries so far.
    len: usize,
}

impl<'a> List<'a> {
    /// Begins the answer to a request.
    pub(super) fn new(request: &Head, out: &'a mut [u8]) -> Self {
        let has_times = request.opcode == MavFtpOpcode::LISTDIRECTORYWITHTIME;
        Self { first: request.offset, has_times, out, len: 0 }
    }

    /// Returns the length of the list.
    pub(super) const fn result(&self) -> Result<usize, MavFtpErr> {
        if self.len == 0 { Err(MavFtpErr::EOF) } else { Ok(self.len) }
    }

    /// Adds an entry: its kind, its name and its numbers. Returns false if there is no room for all of it.
    fn add(&mut self, entry: &FileEntry<'_>) -> bool {
        let time = self.has_times.then_some(entry.time);
        let (size, time) = (column(entry.size.or(time.and(Some(0)))), column(time));
        let kind: &[u8] = if entry.size.is_some() { b"F" } else { b"D" };
        let parts: [&[u8]; 5] = match entry.name {
            name if name.len() <= LONGEST_NAME && path::is_name(name) => {
                [kind, name, size.as_bytes(), time.as_bytes(), b"\0"]
            }
            // Also a name that a client could not ask for (F-32).
            _ => [b"S", b"", b"", b"", b"\0"],
        };
        let len = parts.iter().fold(0usize, |len, part| len.saturating_add(part.len()));
        let rest = self.out.get_mut(self.len..).unwrap_or_default();
        let Some(to) = rest.get_mut(..len) else { return false };
        for (to, from) in to.iter_mut().zip(parts.into_iter().flatten()) {
            *to = *from;
        }
        self.len = self.len.saturating_add(len);
        true
    }
}

/// Returns a number with a tab in front of it, or nothing.
fn column(number: Option<u32>) -> Text<11> {
    let mut column = Text::EMPTY;
    if let Some(number) = number {
        column.push_str("\t");
        column.push_number(number);
    }
    column
}
