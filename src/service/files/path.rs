//! Paths, and the directories of static files (F-9, F-10).
//!
//! Works on bytes: a `str` links code that checks UTF-8, and searches that can panic.

use super::vehicle::StaticFile;

/// Returns the path in the data of a request, up to the end or the first zero, without slashes at its ends; `.` is the root.
/// `None` if it is not the one spelling of its file (F-32).
pub(super) fn of(data: &[u8]) -> Option<&[u8]> {
    let mut path = data.split(|byte| *byte == 0).next().unwrap_or_default();
    while let Some((b'/', rest)) = path.split_first() {
        path = rest;
    }
    while let Some((b'/', rest)) = path.split_last() {
        path = rest;
    }
    match path {
        [] | b"." => Some(b""),
        _ => is_good(path, true).then_some(path),
    }
}

/// Whether a client can ask for a directory's entry with this name.
pub(super) fn is_name(name: &[u8]) -> bool {
    is_good(name, false)
}

/// Whether these are names of printable ASCII with slashes between them, or one name. Not allowed are empty names, `.` and `..`,
/// `\` and `:`, which some file systems take for slashes and drives.
fn is_good(path: &[u8], may_have_slashes: bool) -> bool {
    // The number of dots at the beginning of a name; more than two if there is anything else.
    let mut dots = 0u8;
    for byte in path {
        dots = match byte {
            b'/' if dots > 2 && may_have_slashes => 0,
            b'/' | b'\\' | b':' => return false,
            b'.' => dots.saturating_add(1),
            b' '..=b'~' => 3,
            _ => return false,
        };
    }
    dots > 2
}

/// Returns the rest of a path below a directory.
fn below<'a>(path: &'a str, directory: &[u8]) -> Option<&'a [u8]> {
    let path = path.as_bytes();
    if directory.is_empty() { Some(path) } else { path.strip_prefix(directory)?.strip_prefix(b"/") }
}

/// Returns the name at the front of a path, and whether it is the name of a directory.
fn front(path: &[u8]) -> (&[u8], bool) {
    let name = path.split(|byte| *byte == b'/').next().unwrap_or_default();
    (name, name.len() < path.len())
}

/// Returns the number of the first file in or below a directory.
pub(super) fn directory(files: &[StaticFile], path: &[u8]) -> Option<usize> {
    files.iter().position(|file| below(file.path, path).is_some())
}

/// Returns the name of an entry of a directory, and its file; no file for a directory. `Err`: the number of entries, if there
/// are no more.
pub(super) fn entry<'a>(
    files: &'a [StaticFile],
    directory: &[u8],
    index: u32,
) -> Result<(&'a [u8], Option<&'a StaticFile>), u32> {
    let mut left = index;
    let mut rest = files;
    while let Some((file, after)) = rest.split_first() {
        let before = files.get(..files.len().saturating_sub(rest.len())).unwrap_or_default();
        rest = after;
        let Some(path) = below(file.path, directory) else { continue };
        let (name, is_directory) = front(path);
        let is_same =
            |other: &StaticFile| below(other.path, directory).is_some_and(|other| front(other) == (name, true));
        if is_directory && before.iter().any(is_same) {
            continue;
        }
        match left.checked_sub(1) {
            None => return Ok((name, Some(file).filter(|_| !is_directory))),
            Some(fewer) => left = fewer,
        }
    }
    Err(index.saturating_sub(left))
}
