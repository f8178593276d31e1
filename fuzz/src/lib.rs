//! What the fuzz targets do with their bytes, one module each: `run` takes any bytes and panics when a promise is broken.
//! README.md says how to run them, and how to keep what they find.
//!
//! Bytes become a test case by [`arbitrary::Unstructured`], front to back and without looking ahead, so that a short
//! script of them can be written by hand ([`seeds`]) and a change of one byte changes one thing.

pub mod decode;
pub mod dialect;
pub mod record;
pub mod roundtrip;
pub mod seeds;
pub mod session;
pub mod sign;
pub mod wpl;

// What the generated messages, compiled once more by `all`, ask the crate root for.
#[allow(unused_imports)]
use all::{command, dialect, message, wire_bitmask, wire_enum};
#[allow(unused_imports)]
use mavstack::{CommandRule, Location, ParamRule, Secret, Text};

#[path = "../../tests/golden/all.rs"]
mod all;
#[path = "../../tests/support/flash.rs"]
mod flash;
#[path = "../../tests/support/signer.rs"]
mod signer;
mod support;

/// A target.
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// What it does with its bytes.
    pub run: fn(&[u8]),
    /// What it begins with.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All of them.
pub const TARGETS: [Target; 7] = [
    Target { name: "decode", run: decode::run, seeds: seeds::decode },
    Target { name: "session", run: session::run, seeds: seeds::session },
    Target { name: "record", run: record::run, seeds: seeds::record },
    Target { name: "sign", run: sign::run, seeds: seeds::sign },
    Target { name: "roundtrip", run: roundtrip::run, seeds: seeds::roundtrip },
    Target { name: "dialect", run: dialect::run, seeds: seeds::dialect },
    Target { name: "wpl", run: wpl::run, seeds: seeds::wpl },
];

#[cfg(test)]
mod tests {
    use super::TARGETS;
    use std::fs;
    use std::path::{Path, PathBuf};

    fn folder(kind: &str, target: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join(kind).join(target)
    }

    /// What was found once, and the curated inputs, on a stable compiler and without the fuzzer.
    #[test]
    fn corpora_pass() {
        for target in TARGETS {
            let mut count = 0;
            for kind in ["corpus", "regressions"] {
                let Ok(files) = fs::read_dir(folder(kind, target.name)) else { continue };
                for file in files {
                    let path = file.expect("a folder that can be read").path();
                    println!("{}", path.display());
                    (target.run)(&fs::read(&path).expect("a file that can be read"));
                    count += 1;
                }
            }
            assert!(count > 0, "no corpus of {}", target.name);
        }
    }

    /// The seeds themselves.
    #[test]
    fn seeds_pass() {
        for target in TARGETS {
            let seeds = (target.seeds)();
            assert!(!seeds.is_empty(), "no seeds of {}", target.name);
            seeds.iter().for_each(|seed| (target.run)(seed));
        }
    }

    /// Writes the seeds to where the corpora are.
    #[test]
    #[ignore = "writes files: cargo test --lib -- --ignored write_seeds"]
    fn write_seeds() {
        for target in TARGETS {
            let folder = folder("corpus", target.name);
            fs::create_dir_all(&folder).expect("a folder that can be made");
            for (index, seed) in (target.seeds)().into_iter().enumerate() {
                fs::write(folder.join(format!("seed-{index:03}")), seed).expect("a file that can be written");
            }
        }
    }
}
