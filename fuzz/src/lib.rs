//! The fuzz targets, one module each. `run` takes any bytes and panics when a guarantee is violated. README.md describes how to
//! run them and how to keep their findings.
//!
//! [`arbitrary::Unstructured`] turns the bytes into a test case, from front to back and without lookahead. So a short script can be
//! written by hand ([`seeds`]), and a mutation of one byte changes one thing.

#[cfg(test)]
mod corpus;
pub mod decode;
pub mod dialect;
pub mod files;
pub mod record;
pub mod roundtrip;
pub mod seeds;
pub mod session;
pub mod sign;
pub mod wpl;

// Names that the generated messages in `all` expect in the crate root.
#[allow(unused_imports)]
use all::{command, dialect, message, wire_bitmask, wire_enum};
#[allow(unused_imports)]
mod message {
    pub use mavstack::message::{CommandRule, Location, ParamRule, Secret, Text};
}

#[path = "../../tests/golden/all.rs"]
mod all;
#[path = "../../tests/support/flash.rs"]
mod flash;
#[path = "../../tests/support/signer.rs"]
mod signer;
mod support;

/// A fuzz target.
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Runs an input.
    pub run: fn(&[u8]),
    /// Returns the seeds of its corpus.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets.
pub const TARGETS: [Target; 8] = [
    Target { name: "decode", run: decode::run, seeds: seeds::decode },
    Target { name: "session", run: session::run, seeds: seeds::session },
    Target { name: "record", run: record::run, seeds: seeds::record },
    Target { name: "sign", run: sign::run, seeds: seeds::sign },
    Target { name: "roundtrip", run: roundtrip::run, seeds: seeds::roundtrip },
    Target { name: "dialect", run: dialect::run, seeds: seeds::dialect },
    Target { name: "files", run: files::run, seeds: seeds::files },
    Target { name: "wpl", run: wpl::run, seeds: seeds::wpl },
];

#[cfg(test)]
mod tests {
    use super::{TARGETS, corpus};
    use std::fs;
    use std::io::ErrorKind;
    use std::path::{Path, PathBuf};

    /// Returns the path of a target's corpus archive.
    pub fn archive(target: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(format!("{target}.tar"))
    }

    /// Runs every input of the corpora and of `regressions/`, on a stable compiler and without the fuzzer.
    #[test]
    fn corpora_pass() {
        for target in TARGETS {
            let corpus = corpus::read(&archive(target.name)).expect("a corpus");
            assert!(!corpus.is_empty(), "no corpus of {}", target.name);
            for (name, input) in corpus {
                println!("corpus/{}.tar: {name}", target.name);
                (target.run)(&input);
            }
            let regressions = Path::new(env!("CARGO_MANIFEST_DIR")).join("regressions").join(target.name);
            let Ok(files) = fs::read_dir(regressions) else { continue };
            for file in files {
                let path = file.expect("a readable folder").path();
                println!("{}", path.display());
                (target.run)(&fs::read(&path).expect("a readable file"));
            }
        }
    }

    /// Rewriting an unchanged archive yields the same bytes.
    #[test]
    fn archives_are_canonical() {
        let folder = std::env::temp_dir().join(format!("mavstack-fuzz-corpus-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a temporary folder");
        for target in TARGETS {
            let (original, copy) = (archive(target.name), folder.join(target.name));
            corpus::write(&copy, &corpus::read(&original).expect("a corpus")).expect("a writable archive");
            let bytes = |path: &Path| fs::read(path).expect("a readable file");
            assert!(bytes(&original) == bytes(&copy), "{} is not canonical; write it again", original.display());
        }
        fs::remove_dir_all(&folder).expect("a temporary folder");
    }

    /// Runs the seeds.
    #[test]
    fn seeds_pass() {
        for target in TARGETS {
            let seeds = (target.seeds)();
            assert!(!seeds.is_empty(), "no seeds of {}", target.name);
            seeds.iter().for_each(|seed| (target.run)(seed));
        }
    }

    /// Writes the seeds to the corpora.
    #[test]
    #[ignore = "writes files: cargo test --lib -- --ignored write_seeds"]
    fn write_seeds() {
        for target in TARGETS {
            let archive = archive(target.name);
            let mut corpus = match corpus::read(&archive) {
                Err(error) if error.kind() == ErrorKind::NotFound => corpus::Corpus::new(),
                corpus => corpus.expect("a corpus"),
            };
            corpus.retain(|name, _| !name.starts_with(corpus::SEED));
            for (index, seed) in (target.seeds)().into_iter().enumerate() {
                corpus.insert(format!("{}{index:03}", corpus::SEED), seed);
            }
            corpus::write(&archive, &corpus).expect("a writable archive");
        }
    }
}
