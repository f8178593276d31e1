//! `cargo xtask mutants`: would the tests notice a fault? The library is changed in one place at a time, and the tests run.
//!
//! `cargo-mutants` makes the changes. Each is tried with the tests beside the code first, which is a matter of seconds, and what
//! these let pass with those files of `tests/` that are about it. What passes both is a survivor. `xtask/mutants.txt` lists
//! those that may: each has a reason, and one that it does not list fails.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::system::{Result, cargo, root, run, succeeds, target_dir};

/// Survivors with their reasons, as the file itself says.
const LISTED: &str = "xtask/mutants.txt";

/// So much of what compiles has to be noticed, in each area (%), however good the reasons for the others are.
const NOTICED: f64 = 95.0;

/// A part of the library, and the files of `tests/` that are about it.
struct Area {
    name: &'static str,
    files: &'static [&'static str],
    tests: &'static [&'static str],
}

const AREAS: [Area; 4] = [
    Area {
        name: "signing",
        files: &["src/service/signing/**", "src/frame/signing.rs", "src/storage/signing.rs"],
        tests: &[
            "high_latency_signed",
            "secrets",
            "signing",
            "signing_replay",
            "signing_setup",
            "signing_storage",
            "signing_vectors",
        ],
    },
    Area {
        name: "frame",
        files: &["src/frame/crc.rs", "src/frame/decoder.rs", "src/frame/encoder.rs", "src/frame/mod.rs"],
        tests: &["errors", "frame", "frames", "golden", "links", "peers", "properties", "secrets"],
    },
    Area {
        name: "mission",
        files: &["src/service/mission/**"],
        tests: &[
            "links",
            "minimal",
            "mission",
            "mission_lossy",
            "no_block",
            "power_cut",
            "progress",
            "rules",
            "typed_commands",
        ],
    },
    Area {
        name: "storage",
        files: &[
            "src/storage/fram.rs",
            "src/storage/params.rs",
            "src/storage/plans.rs",
            "src/storage/record.rs",
            "src/storage/mod.rs",
        ],
        tests: &["errors", "flash_garbage", "fram", "power_cut", "signing_storage"],
    },
];

/// What is to be tried.
pub struct Options {
    /// All, when none is named.
    pub areas: Vec<String>,
    /// `2/8`: this part of them only.
    pub shard: Option<String>,
    /// Only what this file, the output of `git diff`, touches.
    pub in_diff: Option<PathBuf>,
}

/// What became of the mutants of an area: their names, without the place in the file.
#[derive(Default)]
struct Outcome {
    caught: Vec<String>,
    /// The tests went on for ever, or five times as long as they should: noticed as well.
    timeout: Vec<String>,
    /// Does not compile.
    unviable: Vec<String>,
    missed: Vec<String>,
}

/// Tries the areas one after the other, and prints their figures.
pub fn survive(options: &Options) -> Result {
    let known = AREAS.map(|area| area.name);
    if let Some(unknown) = options.areas.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(format!("there is no area {unknown}; there are {}", known.join(", ")));
    }
    if !succeeds("cargo", &["mutants", "--version"]) {
        println!("Installing cargo-mutants: cargo install cargo-mutants --locked");
        run(Command::new(cargo()).args(["install", "--quiet", "cargo-mutants", "--locked"]))?;
    }
    let listed = fs::read_to_string(root().join(LISTED)).map_err(|error| format!("{LISTED}: {error}"))?;
    let is_asked = |area: &&Area| options.areas.is_empty() || options.areas.iter().any(|name| name == area.name);
    let mut lines = Vec::new();
    let mut faults = Vec::new();
    for area in AREAS.iter().filter(is_asked) {
        let outcome = area.run(options)?;
        let mut allowed = count(listed.lines());
        let surprises: Vec<_> = outcome.missed.iter().filter(|name| !takes(&mut allowed, name)).collect();
        lines.push(outcome.line(area.name, surprises.len()));
        faults.extend(surprises.iter().map(|name| format!("survives, and is not listed in {LISTED}: {name}")));
        if options.shard.is_none() && options.in_diff.is_none() {
            if outcome.noticed() < NOTICED {
                faults.push(format!("{}: less than {NOTICED} % are noticed", area.name));
            }
            // What is listed and did not survive needs no reason any more.
            let all = [&outcome.caught, &outcome.timeout, &outcome.unviable];
            for name in all.into_iter().flatten().filter(|name| takes(&mut allowed, name)) {
                lines.push(format!("  listed in {LISTED}, and does not survive, or there are fewer of it: {name}"));
            }
        }
    }
    println!(
        "\n{:<10} {:>6} {:>7} {:>8} {:>9} {:>9} {:>10} {:>8}",
        "area", "viable", "caught", "timeout", "survived", "unlisted", "unviable", "noticed"
    );
    lines.iter().for_each(|line| println!("{line}"));
    if faults.is_empty() { Ok(()) } else { Err(faults.join("\n       ")) }
}

impl Area {
    fn run(&self, options: &Options) -> Result<Outcome> {
        let folder = target_dir().join("mutants").join(self.name);
        // What an earlier run found is not to be gone on with.
        if folder.exists() {
            fs::remove_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        }
        fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        println!("\n{}: the tests beside the code", self.name);
        run_mutants(self.command(options, &folder).args(["--", "--lib"]))?;
        let mut outcome = Outcome::default();
        outcome.read(&folder);
        if !outcome.missed.is_empty() {
            println!("\n{}: what they let pass, with {}", self.name, self.tests.join(", "));
            let tests = self.tests.iter().flat_map(|name| ["--test", name]);
            // Leaves out what was caught, and what does not compile.
            run_mutants(self.command(options, &folder).args(["--iterate", "--"]).args(tests))?;
            outcome.missed.clear();
            outcome.timeout.clear();
            outcome.read(&folder);
        }
        Ok(outcome)
    }

    /// cargo-mutants, on a copy of the sources of its own. It runs the unchanged tests first, which tells how long they may take.
    fn command(&self, options: &Options, folder: &Path) -> Command {
        let mut command = Command::new(cargo());
        command.args(["mutants", "--package", "mavstack", "--features", "signing,storage"]);
        command.args(["--no-shuffle", "--timeout-multiplier", "5", "--output"]).arg(folder);
        command.args(self.files.iter().flat_map(|glob| ["--file", glob]));
        command.args(options.shard.iter().flat_map(|part| ["--shard", part.as_str()]));
        if let Some(file) = &options.in_diff {
            command.arg("--in-diff").arg(file);
        }
        // Building is most of it. Random tests need no more cases than find what is grossly wrong.
        command
            .env("CARGO_INCREMENTAL", "1")
            .env("CARGO_PROFILE_DEV_DEBUG", "0")
            .env("CARGO_PROFILE_DEV_OPT_LEVEL", "1");
        command.env("PROPTEST_CASES", "16").env("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "1");
        // A folder of builds in common would be built anew for each copy; CI is for who installs what tests compare with.
        command.env_remove("CARGO_TARGET_DIR").env_remove("CI");
        command.arg("--dir").arg(root());
        command
    }
}

/// Survivors and endless tests are what we are here for; else it failed.
fn run_mutants(command: &mut Command) -> Result {
    let status = command.status().map_err(|error| format!("cargo mutants could not be started: {error}"))?;
    match status.code() {
        Some(0 | 2 | 3) => Ok(()),
        _ => Err(format!("cargo mutants failed ({status})")),
    }
}

impl Outcome {
    /// Adds what the last pass found. Where nothing was to be tried there are no files.
    fn read(&mut self, folder: &Path) {
        let lists = [
            ("caught", &mut self.caught),
            ("timeout", &mut self.timeout),
            ("unviable", &mut self.unviable),
            ("missed", &mut self.missed),
        ];
        for (name, list) in lists {
            let text = fs::read_to_string(folder.join("mutants.out").join(format!("{name}.txt"))).unwrap_or_default();
            list.extend(text.lines().map(without_place));
        }
    }

    fn viable(&self) -> usize {
        self.caught.len() + self.timeout.len() + self.missed.len()
    }

    /// How many of the viable ones (%).
    fn noticed(&self) -> f64 {
        100.0 * (self.caught.len() + self.timeout.len()) as f64 / self.viable().max(1) as f64
    }

    fn line(&self, area: &str, unlisted: usize) -> String {
        let [caught, timeout, missed, unviable] =
            [&self.caught, &self.timeout, &self.missed, &self.unviable].map(Vec::len);
        let (viable, noticed) = (self.viable(), self.noticed());
        format!(
            "{area:<10} {viable:>6} {caught:>7} {timeout:>8} {missed:>9} {unlisted:>9} {unviable:>10} {noticed:>7.1}%"
        )
    }
}

/// `src/a.rs:12:34: replace …` as `src/a.rs: replace …`: places change with every line above.
fn without_place(name: &str) -> String {
    let mut parts = name.splitn(4, ':');
    match (parts.next(), parts.next(), parts.next(), parts.next()) {
        (Some(file), Some(_), Some(_), Some(what)) => format!("{file}:{what}"),
        _ => name.to_owned(),
    }
}

/// How often each mutant is listed: the same change at two places of a function has one name.
fn count<'a>(lines: impl Iterator<Item = &'a str>) -> BTreeMap<&'a str, usize> {
    let mut counts = BTreeMap::new();
    for line in lines.filter(|line| line.starts_with("src/")) {
        *counts.entry(line).or_default() += 1;
    }
    counts
}

/// Whether `name` is listed once more; takes it off.
fn takes(counts: &mut BTreeMap<&str, usize>, name: &str) -> bool {
    let left = counts.get_mut(name).filter(|left| **left > 0);
    left.map(|left| *left -= 1).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mutants_are_known_by_what_they_change() {
        let name = "src/frame/crc.rs:47:17: replace < with == in f::<u8>";
        assert_eq!(without_place(name), "src/frame/crc.rs: replace < with == in f::<u8>");
    }

    #[test]
    fn each_line_of_the_list_excuses_one() {
        let mut counts = count("# Why.\nsrc/a.rs: x\nsrc/a.rs: x\n".lines());
        assert!(takes(&mut counts, "src/a.rs: x") && takes(&mut counts, "src/a.rs: x"));
        assert!(!takes(&mut counts, "src/a.rs: x") && !takes(&mut counts, "# Why."));
    }
}
