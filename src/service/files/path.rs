//! Paths, and the directories of static files (F-9, F-10).

use super::vehicle::StaticFile;

/// Returns the path in the data of a request: up to its end or first zero, without slashes at both ends. `None` if it is not
/// allowed.
pub(super) fn of(data: &[u8]) -> Option<&str> {
    let path = data.split(|byte| *byte == 0).next().unwrap_or_default();
    if !path.iter().all(|byte| matches!(byte, b' '..=b'~')) {
        return None;
    }
    let path = core::str::from_utf8(path).ok()?.trim_matches('/');
    let path = if path == "." { "" } else { path };
    let is_allowed = path.split('/').all(|part| part != "..");
    is_allowed.then_some(path)
}

/// Returns the rest of a path below a directory.
fn below<'a>(path: &'a str, directory: &str) -> Option<&'a str> {
    if directory.is_empty() { Some(path) } else { path.strip_prefix(directory)?.strip_prefix('/') }
}

/// Returns the number of the first file in or below a directory.
pub(super) fn directory(files: &[StaticFile], path: &str) -> Option<usize> {
    files.iter().position(|file| below(file.path, path).is_some())
}

/// Returns the name of an entry of a directory, and its file; no file for a directory. `Err`: the number of entries, if there
/// are no more.
pub(super) fn entry<'a>(
    files: &'a [StaticFile],
    directory: &str,
    index: u32,
) -> Result<(&'a str, Option<&'a StaticFile>), u32> {
    let mut left = index;
    for (number, file) in files.iter().enumerate() {
        let Some(rest) = below(file.path, directory) else { continue };
        let (name, is_directory) = rest.split_once('/').map_or((rest, false), |(name, _)| (name, true));
        let is_same = |other: &StaticFile| {
            let other = below(other.path, directory).and_then(|rest| rest.split_once('/'));
            other.is_some_and(|(other, _)| other == name)
        };
        if is_directory && files.iter().take(number).any(is_same) {
            continue;
        }
        match left.checked_sub(1) {
            None => return Ok((name, Some(file).filter(|_| !is_directory))),
            Some(fewer) => left = fewer,
        }
    }
    Err(index.saturating_sub(left))
}
