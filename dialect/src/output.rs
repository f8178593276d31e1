//! Writes generated text to a file atomically.

use crate::Error;
use std::{
    fs, io,
    path::{Path, PathBuf},
    process,
};

/// Replaces the content of `file` with `text` atomically. Does not touch a file that has this content already.
///
/// # Errors
///
/// The directory does not exist, or permission is denied. The file is then unchanged.
pub fn write(file: &Path, text: &str) -> Result<(), Error> {
    if is_current(file, text) {
        return Ok(());
    }
    let temporary = temporary(file);
    fs::write(&temporary, text).and_then(|()| fs::rename(&temporary, file)).map_err(|error: io::Error| {
        // Report the first error: the temporary file may not exist.
        let _ = fs::remove_file(&temporary);
        Error::whole(file, "the output", format!("cannot be written: {error}"))
    })
}

/// Returns whether the content of `file` is `text`.
pub fn is_current(file: &Path, text: &str) -> bool {
    fs::read(file).is_ok_and(|old| old == text.as_bytes())
}

/// Returns a name in the same directory, so that renaming is atomic.
fn temporary(file: &Path) -> PathBuf {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!(".{name}.{}", process::id()))
}
