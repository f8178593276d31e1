//! Lists the entries of directories (F-9).

use super::open::{data, is_virtual};
use super::virtual_files::VirtualFiles;
use super::{Files, Outcome, path};
use crate::dialect::MavFtpErr;
use crate::service::Cx;
use crate::types::Firmware;

/// In place of the index of a static file: marks a virtual directory that is not a static one too.
const VIRTUAL: u8 = 254;
const NO_ENTRIES: u8 = 255;
/// In place of the number of a directory: the vehicle has none.
const NO_DIRECTORY: u16 = u16::MAX;

/// Longer names are skipped.
const LONGEST_NAME: usize = 200;

/// Entries of a directory as text: as many complete ones as fit.
#[derive(Debug)]
pub struct Entries<'a> {
    out: &'a mut [u8],
    /// The length of the text. Greater than the room if the text was cut off.
    len: usize,
}

impl Entries<'_> {
    fn push(&mut self, byte: u8) {
        if let Some(to) = self.out.get_mut(self.len) {
            *to = byte;
        }
        self.len = self.len.saturating_add(1);
    }

    /// Writes a part of a name.
    pub(crate) fn text(&mut self, text: &[u8]) {
        text.iter().for_each(|byte| self.push(*byte));
    }

    /// Writes a number.
    pub(crate) fn decimal(&mut self, number: u32) {
        let mut divisor = 1_000_000_000u32;
        while divisor > 0 {
            let digits = number.checked_div(divisor).unwrap_or(0);
            if digits > 0 || divisor == 1 {
                self.push(b'0'.wrapping_add(u8::try_from(digits.checked_rem(10).unwrap_or(0)).unwrap_or(0)));
            }
            divisor = divisor.checked_div(10).unwrap_or(0);
        }
    }

    /// Ends an entry behind its name. `size`: of a file.
    fn end(&mut self, size: Option<u32>, time: u32, has_time: bool) {
        let numbers = [size.or(has_time.then_some(0)), has_time.then_some(time)];
        for number in numbers.into_iter().flatten() {
            self.push(b'\t');
            self.decimal(number);
        }
        self.push(0);
    }

    /// Writes an entry.
    fn put(&mut self, name: &[u8], size: Option<u32>, time: u32, has_time: bool) {
        if name.len() > LONGEST_NAME || !path::is_name(name) {
            // Also a name that a client could not ask for (F-32).
            self.text(b"S\0");
            return;
        }
        self.push(if size.is_some() { b'F' } else { b'D' });
        self.text(name);
        self.end(size, time, has_time);
    }
}

/// Returns the number that stands for a directory: a static file that is in or below it, the length of the path, and the number
/// of the vehicle's or the virtual directory.
pub(super) fn directory<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(cx: &mut Cx<'_, F>, path: &[u8]) -> Outcome {
    let mut place = NO_ENTRIES;
    let mut number = NO_DIRECTORY;
    if is_virtual(path) {
        if let Some(directory) = (0..V::COUNT).find(|directory| V::name(*directory) == path) {
            (place, number) = (VIRTUAL, directory);
        }
    } else {
        let found = if path.is_empty() { Some(0) } else { path::directory(F::Vehicle::FILES, path) };
        place = found.and_then(|index| u8::try_from(index).ok()).unwrap_or(NO_ENTRIES);
        number = cx.vehicle.directory(path).unwrap_or(NO_DIRECTORY);
    }
    if place == NO_ENTRIES && number == NO_DIRECTORY {
        return Err(MavFtpErr::FILENOTFOUND.into());
    }
    let [low, high] = number.to_le_bytes();
    Ok(u32::from_le_bytes([place, u8::try_from(path.len()).unwrap_or(0), low, high]))
}

/// Writes the entries of a directory from an index on: as many as fit (F-9).
pub(super) fn list<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    directory: u32,
    first: u32,
    has_time: bool,
    out: &mut [u8],
) -> Outcome {
    let mut entries = Entries { out, len: 0 };
    let mut index = first;
    let mut len = 0;
    while put_entry::<F, V>(cx, directory, index, has_time, &mut entries) && entries.len <= entries.out.len() {
        len = entries.len;
        index = index.saturating_add(1);
    }
    data(len)
}

/// Writes an entry of a directory. Returns false after the last one.
fn put_entry<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    directory: u32,
    index: u32,
    has_time: bool,
    entries: &mut Entries<'_>,
) -> bool {
    let [place, path_len, low, high] = directory.to_le_bytes();
    let number = u16::from_le_bytes([low, high]);
    let mut index = index;
    if place == VIRTUAL {
        entries.push(b'F');
        let entry = u16::try_from(index).ok().and_then(|index| V::entry(cx, number, index, entries));
        let Some((size, time)) = entry else { return false };
        entries.end(Some(size), time, has_time);
        return true;
    }
    if place != NO_ENTRIES {
        let files = F::Vehicle::FILES;
        let path = files.get(usize::from(place)).and_then(|file| file.path.as_bytes().get(..usize::from(path_len)));
        match path::entry(files, path.unwrap_or_default(), index) {
            Ok((name, file)) => {
                let size = file.map(|file| u32::try_from(file.bytes.len()).unwrap_or(u32::MAX));
                entries.put(name, size, 0, has_time);
                return true;
            }
            Err(count) => index = index.saturating_sub(count),
        }
        if path_len == 0 {
            for name in (0..V::COUNT).map(V::name) {
                let Some(rest) = index.checked_sub(1) else {
                    entries.put(name, None, 0, has_time);
                    return true;
                };
                index = rest;
            }
        }
    }
    if number == NO_DIRECTORY {
        return false;
    }
    let Some(entry) = u16::try_from(index).ok().and_then(|index| cx.vehicle.entry(number, index)) else { return false };
    entries.put(entry.name, entry.size, entry.time, has_time);
    true
}
