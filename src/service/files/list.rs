//! Directories, and their entries (F-9).

use super::open::is_virtual;
use super::packet::Body;
use super::{FileEntry, Files, Outcome, path};
use crate::dialect::MavFtpErr;
use crate::service::Cx;
use crate::service::param::PackedParams;
use crate::types::Firmware;

/// The directory of the parameters, and the file in it.
const PARAM_DIRECTORY: &[u8] = b"@PARAM";
const PARAM_FILE: &[u8] = b"param.pck";

/// Instead of the index of a static file: the directory of the parameters, and no static directory.
const PARAM_ENTRIES: u8 = 254;
const NO_ENTRIES: u8 = 255;
/// Instead of the number of a directory: the vehicle has none.
const NO_DIRECTORY: u16 = u16::MAX;

/// Returns the number that stands for a directory: a static file that is in or below it, the length of the path, and the
/// vehicle's number.
#[inline(never)]
pub(super) fn directory<F, P>(cx: &mut Cx<'_, F>, path: &[u8]) -> Outcome
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let mut place = NO_ENTRIES;
    let mut number = NO_DIRECTORY;
    if P::EXISTS && path == PARAM_DIRECTORY {
        place = PARAM_ENTRIES;
    } else if !is_virtual(path) {
        let found = if path.is_empty() { Some(0) } else { path::directory(F::Vehicle::FILES, path) };
        place = found.and_then(|index| u8::try_from(index).ok()).unwrap_or(NO_ENTRIES);
        number = cx.vehicle.directory(path).unwrap_or(NO_DIRECTORY);
    }
    if place == NO_ENTRIES && number == NO_DIRECTORY {
        return Err(MavFtpErr::FILENOTFOUND);
    }
    let [low, high] = number.to_le_bytes();
    Ok(u32::from_le_bytes([place, u8::try_from(path.len()).unwrap_or(0), low, high]))
}

/// Writes the entries of a directory from an index on: as many as there is room for (F-9).
#[inline(never)]
pub(super) fn list<F, P>(cx: &mut Cx<'_, F>, directory: u32, first: u32, has_time: bool, out: &mut [u8]) -> Body
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let mut len = 0usize;
    let mut index = first;
    while let Some(entry) = entry_of::<F, P>(cx, directory, index) {
        let Some(written) = write_entry(&entry, has_time, out.get_mut(len..).unwrap_or_default()) else { break };
        len = len.saturating_add(written);
        index = index.saturating_add(1);
    }
    if len == 0 { Body::Refused(MavFtpErr::EOF) } else { Body::Data(len) }
}

/// Returns an entry of a directory.
fn entry_of<'a, F, P>(cx: &'a mut Cx<'_, F>, directory: u32, index: u32) -> Option<FileEntry<'a>>
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let [place, path_len, low, high] = directory.to_le_bytes();
    if place == PARAM_ENTRIES {
        let size = u32::from(P::packed_count(cx)).saturating_mul(12);
        return (index == 0).then_some(FileEntry { name: PARAM_FILE, size: Some(size), time: 0 });
    }
    let mut index = index;
    if place != NO_ENTRIES {
        let files = F::Vehicle::FILES;
        let path = files.get(usize::from(place)).and_then(|file| file.path.as_bytes().get(..usize::from(path_len)));
        match path::entry(files, path.unwrap_or_default(), index) {
            Ok((name, file)) => {
                let size = file.map(|file| u32::try_from(file.bytes.len()).unwrap_or(u32::MAX));
                return Some(FileEntry { name, size, time: 0 });
            }
            Err(count) => index = index.saturating_sub(count),
        }
        if P::EXISTS && path_len == 0 {
            match index.checked_sub(1) {
                None => return Some(FileEntry { name: PARAM_DIRECTORY, size: None, time: 0 }),
                Some(rest) => index = rest,
            }
        }
    }
    let number = u16::from_le_bytes([low, high]);
    if number == NO_DIRECTORY {
        return None;
    }
    cx.vehicle.entry(number, u16::try_from(index).ok()?)
}

/// Writes an entry. Returns its length; `None` if there is no room for it.
#[inline(never)]
fn write_entry(entry: &FileEntry<'_>, has_time: bool, out: &mut [u8]) -> Option<usize> {
    let mut len = 0usize;
    let mut push = |byte: u8| {
        *out.get_mut(len)? = byte;
        len = len.saturating_add(1);
        Some(())
    };
    if entry.name.len() > 200 {
        // It is skipped.
        push(b'S')?;
        push(0)?;
        return Some(len);
    }
    push(if entry.size.is_some() { b'F' } else { b'D' })?;
    for byte in entry.name {
        push(*byte)?;
    }
    let numbers = [entry.size.or(has_time.then_some(0)), has_time.then_some(entry.time)];
    for number in numbers.into_iter().flatten() {
        push(b'\t')?;
        let mut divisor = 1_000_000_000u32;
        while divisor > 0 {
            let digits = number.checked_div(divisor).unwrap_or(0);
            if digits > 0 || divisor == 1 {
                push(b'0'.wrapping_add(u8::try_from(digits.checked_rem(10).unwrap_or(0)).unwrap_or(0)))?;
            }
            divisor = divisor.checked_div(10).unwrap_or(0);
        }
    }
    push(0)?;
    Some(len)
}
