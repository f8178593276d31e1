//! Generated text to a file: all of it, or nothing.

use crate::Error;
use std::{
    fs, io,
    path::{Path, PathBuf},
    process,
};

/// Replaces `file` by one that holds `text`, in one step; leaves one that holds it already alone.
///
/// # Errors
///
/// When there is no such directory, or no permission; the file is then as it was.
pub fn write(file: &Path, text: &str) -> Result<(), Error> {
    if is_current(file, text) {
        return Ok(());
    }
    let temporary = temporary(file);
    fs::write(&temporary, text).and_then(|()| fs::rename(&temporary, file)).map_err(|error: io::Error| {
        // It may not be there; the error that counts is the first.
        let _ = fs::remove_file(&temporary);
        Error::whole(file, "the output", format!("cannot be written: {error}"))
    })
}

/// Whether `file` holds `text`.
pub fn is_current(file: &Path, text: &str) -> bool {
    fs::read(file).is_ok_and(|old| old == text.as_bytes())
}

/// A name in the same directory, so that renaming does not copy.
fn temporary(file: &Path) -> PathBuf {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!(".{name}.{}", process::id()))
}
