//! Any definition: the generator says where it is wrong, or writes it down; without a panic, and without more text than there
//! is reason for.

use mavstack_dialect::{Options, generate, load};
use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

/// Longer ones show nothing new.
const MAX_LEN: usize = 16_384;

/// The generator reads files. In memory, where there is a folder for that.
static FILE: LazyLock<PathBuf> = LazyLock::new(|| {
    let memory = PathBuf::from("/dev/shm");
    let folder = if memory.is_dir() { memory } else { std::env::temp_dir() };
    let folder = folder.join(format!("mavstack-fuzz-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a temporary folder");
    folder.join("fuzzed.xml")
});

/// Reads, and generates.
pub fn run(data: &[u8]) {
    let data = &data[..data.len().min(MAX_LEN)];
    fs::write(&*FILE, data).expect("a temporary file");
    let dialect = match load(&FILE, &[]) {
        Ok(dialect) => dialect,
        Err(error) => {
            // What is wrong with a file as a whole has no line.
            assert!(error.line.is_some() || error.element == "the file", "{error}");
            let lines = data.iter().filter(|byte| **byte == b'\n').count() + 1;
            let is_here = error.file == *FILE;
            assert!(!is_here || error.line.is_none_or(|line| (1..=lines).contains(&(line as usize))), "{error}");
            assert!(!error.problem.is_empty() && !error.element.is_empty());
            return;
        }
    };
    match generate(&dialect, &Options::for_file(&FILE)) {
        Ok(text) => {
            // Includes bring all of common with them.
            assert!(text.len() < 2_000_000 + 200 * data.len(), "{} bytes of {}", text.len(), data.len());
            assert!(text.ends_with('\n'));
        }
        Err(error) => assert!(!error.problem.is_empty()),
    }
}
