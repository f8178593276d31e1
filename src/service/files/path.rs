//! Paths, and the directories of static files (F-9, F-10).
//!
//! Works on bytes: a `str` links code that checks UTF-8, and searches that can panic.

use super::vehicle::{FileEntry, StaticFile};

/// Returns the path in the data of a request, up to the end or the first zero, without slashes at its ends; `.` is the root.
/// `None` if it is not the one spelling of its file (F-32).
pub(super) fn parse(data: &[u8]) -> Option<&[u8]> {
    let mut path = data.split(|byte| *byte == 0).next().unwrap_or_default();
    while let [b'/', inner @ ..] | [inner @ .., b'/'] = path {
        path = inner;
    }
    match path {
        [] | b"." => Some(b""),
        _ => is_spelled_well(path, true).then_some(path),
    }
}

/// Whether a path is below a directory that the stack generates, or is that directory.
pub(super) fn is_virtual(path: &[u8]) -> bool {
    path.first() == Some(&b'@')
}

/// Whether a client can ask for a directory's entry with this name.
pub(super) fn is_name(name: &[u8]) -> bool {
    is_spelled_well(name, false)
}

/// Whether these are names of printable ASCII with slashes between them, or one name. Not allowed are empty names, `.` and `..`,
/// `\` and `:`, which some file systems take for slashes and drives.
fn is_spelled_well(path: &[u8], may_have_slashes: bool) -> bool {
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
pub(super) fn below<'a>(path: &'a str, directory: &[u8]) -> Option<&'a [u8]> {
    let path = path.as_bytes();
    if directory.is_empty() { Some(path) } else { path.strip_prefix(directory)?.strip_prefix(b"/") }
}

/// Returns the entries of a directory: static files, and directories with static files, each once.
pub(super) fn static_entries(
    files: &'static [StaticFile],
    directory: &[u8],
) -> impl Iterator<Item = FileEntry<'static>> {
    files.iter().enumerate().filter_map(move |(index, file)| {
        let path = below(file.path, directory)?;
        let name = path.split(|byte| *byte == b'/').next().unwrap_or_default();
        if name.len() == path.len() {
            return Some(FileEntry { name, size: Some(file.size()), time: 0 });
        }
        let has_name = |other: &StaticFile| {
            let inner = below(other.path, directory).and_then(|path| path.strip_prefix(name));
            inner.is_some_and(|inner| inner.starts_with(b"/"))
        };
        let is_listed = files.iter().take(index).any(has_name);
        (!is_listed).then_some(FileEntry { name, size: None, time: 0 })
    })
}
