//! Any XML: the generator reports where it is wrong, or generates code. It does not panic, and the size of its output is bounded.

use mavstack_dialect::{Options, generate, load};
use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

/// Maximum length of a definition. Longer ones find nothing new.
const MAX_LEN: usize = 16_384;

/// The input file, because the generator reads files. It is in memory if /dev/shm exists.
static FILE: LazyLock<PathBuf> = LazyLock::new(|| {
    let memory = PathBuf::from("/dev/shm");
    let folder = if memory.is_dir() { memory } else { std::env::temp_dir() };
    let folder = folder.join(format!("mavstack-fuzz-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a temporary folder");
    folder.join("fuzzed.xml")
});

/// Runs the target.
pub fn run(data: &[u8]) {
    let data = &data[..data.len().min(MAX_LEN)];
    fs::write(&*FILE, data).expect("a temporary file");
    let dialect = match load(&FILE, &[]) {
        Ok(dialect) => dialect,
        Err(error) => {
            // An error of the whole file has no line.
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
            // Includes add all of common.
            assert!(text.len() < 2_000_000 + 200 * data.len(), "{} bytes of {}", text.len(), data.len());
            assert!(text.ends_with('\n'));
        }
        Err(error) => assert!(!error.problem.is_empty()),
    }
}
