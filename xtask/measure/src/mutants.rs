//! `cargo measure mutants`: changes of the library in one place at a time, and whether a test catches each.
//!
//! `cargo-mutants` makes the changes. Each mutant is tested with the tests beside the code first, which takes seconds. Mutants that
//! survive are tested with those files of `tests/` that are about that area. `xtask/measure/mutants.txt` lists the survivors that are
//! accepted, each with its reason; any other survivor fails.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::figures::{Figure, Figures, grouped, number, settle};
use crate::system::{Result, cargo, root, run, succeeds, target_dir, test_files};
use crate::toolchain::{self, Choice};

/// The accepted survivors, with their reasons.
const LISTED: &str = "xtask/measure/mutants.txt";

/// The least share of viable mutants that are caught, in each area (%), whatever the reasons for the others.
const CAUGHT: f64 = 95.0;
/// How many percent a figure may differ from the accepted one.
const TOLERANCE: f64 = 5.0;

/// An area of the library, and the files of `tests/` that are about it.
struct Area {
    name: &'static str,
    files: &'static [&'static str],
    tests: &'static [&'static str],
}

const AREAS: [Area; 4] = [
    Area {
        name: "signing",
        files: &["src/service/signing/**", "src/frame/signing.rs"],
        tests: &[
            "high_latency/delayed_signed",
            "signing/protocol",
            "signing/replay",
            "signing/setup",
            "signing/vectors",
            "storage/signing_key",
            "wire/secrets",
        ],
    },
    Area {
        name: "frame",
        files: &["src/crc.rs", "src/frame/decoder.rs", "src/frame/encoder.rs", "src/frame/mod.rs"],
        tests: &[
            "api/errors",
            "links/peers",
            "links/transports",
            "stack/properties",
            "wire/byte_stream",
            "wire/golden",
            "wire/secrets",
            "wire/single_frame",
        ],
    },
    Area {
        name: "mission",
        files: &["src/service/mission/**", "src/message/item.rs", "src/message/rules.rs", "src/types/plans.rs"],
        tests: &[
            "commands/typed",
            "links/transports",
            "plans/mission",
            "plans/mission_lossy",
            "plans/progress",
            "plans/rules",
            "stack/minimal",
            "stack/no_block",
            "storage/power_cut",
        ],
    },
    Area {
        name: "storage",
        files: &[
            "src/stack/storage.rs",
            "src/storage/*.rs",
            // When content is stored.
            "src/service/write_schedule.rs",
        ],
        tests: &["api/errors", "storage/flash_garbage", "storage/pace", "storage/power_cut", "storage/signing_key"],
    },
];

/// Options of a run.
pub struct Options {
    /// The areas; all if empty.
    pub areas: Vec<String>,
    /// Only a part of the mutants, such as `2/8`.
    pub shard: Option<String>,
    /// Only mutants in the lines that this file changes, the output of `git diff`.
    pub in_diff: Option<PathBuf>,
    /// Whether the figures become the accepted ones.
    pub accepts: bool,
}

/// The results of an area's mutants: their names, without the place in the file.
#[derive(Default)]
struct Outcome {
    caught: Vec<String>,
    /// The tests took more than five times as long as usual: caught as well.
    timeout: Vec<String>,
    /// It does not compile.
    unviable: Vec<String>,
    missed: Vec<String>,
}

/// Tests the mutants of each area, and prints the figures.
pub fn run_areas(options: &Options) -> Result {
    let known = AREAS.map(|area| area.name);
    if let Some(unknown) = options.areas.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(format!("there is no area {unknown}; there are {}", known.join(", ")));
    }
    let listed = fs::read_to_string(root().join(LISTED)).map_err(|error| format!("{LISTED}: {error}"))?;
    let missing = missing(&listed);
    if !missing.is_empty() {
        return Err(missing.join("\n       "));
    }
    if !succeeds("cargo", &["mutants", "--version"]) {
        println!("Installing cargo-mutants: cargo install cargo-mutants --locked");
        run(Command::new(cargo()).args(["install", "--quiet", "cargo-mutants", "--locked"]))?;
    }
    let is_asked = |area: &&Area| options.areas.is_empty() || options.areas.iter().any(|name| name == area.name);
    let (mut lines, mut faults, mut figures) = (Vec::new(), Vec::new(), Vec::new());
    let is_whole = options.shard.is_none() && options.in_diff.is_none();
    for area in AREAS.iter().filter(is_asked) {
        let outcome = area.run(options)?;
        let mut allowed = count(listed.lines());
        let surprises: Vec<_> = outcome.missed.iter().filter(|name| !takes(&mut allowed, name)).collect();
        lines.push(outcome.line(area.name, surprises.len()));
        faults.extend(surprises.iter().map(|name| format!("survives, and is not listed in {LISTED}: {name}")));
        if is_whole {
            if outcome.percent_caught() < CAUGHT {
                faults.push(format!("{}: less than {CAUGHT} % are caught", area.name));
            }
            figures.push((format!("{}.viable", area.name), outcome.viable() as u64));
            figures.push((format!("{}.caught", area.name), outcome.caught() as u64));
            // A listed mutant that did not survive needs no reason any more.
            let all = [&outcome.caught, &outcome.timeout, &outcome.unviable];
            for name in all.into_iter().flatten().filter(|name| takes(&mut allowed, name)) {
                lines.push(format!("  listed in {LISTED} more often than it survives: {name}"));
            }
        }
    }
    println!(
        "\n{:<10} {:>6} {:>7} {:>8} {:>9} {:>9} {:>10} {:>8}",
        "area", "viable", "caught", "timeout", "survived", "unlisted", "unviable", "% caught"
    );
    lines.iter().for_each(|line| println!("{line}"));
    if !faults.is_empty() {
        return Err(faults.join("\n       "));
    }
    if !is_whole {
        return Ok(());
    }
    let figures = with_other_areas(&figures, &Figures::read()?);
    settle("mutants", &toolchain::release(Choice::Rustup), &figures, options.accepts)
}

/// Returns the figures of all areas and their sums. Areas that were not run have their accepted figures, as far as there are any;
/// without them the sums stay, too.
fn with_other_areas(new: &[(String, u64)], accepted: &Figures) -> Vec<Figure> {
    let mut figures = Vec::new();
    let mut sums = [0, 0];
    for area in &AREAS {
        for (what, sum) in ["viable", "caught"].into_iter().zip(&mut sums) {
            let key = format!("{}.{what}", area.name);
            let measured = new.iter().find(|(known, _)| *known == key).map(|(_, count)| *count);
            let accepted = || accepted.get(&format!("mutants.{key}")).and_then(number).map(|count| count as u64);
            if let Some(count) = measured.or_else(accepted) {
                figures.push(Figure::new(key, grouped(count)).within(TOLERANCE));
                *sum += count;
            }
        }
    }
    let [viable, caught] = sums;
    let percent = 100.0 * caught as f64 / viable.max(1) as f64;
    let is_whole = figures.len() == 2 * AREAS.len();
    for (key, value) in [("viable", grouped(viable)), ("percent", format!("{percent:.1}"))] {
        let accepted = accepted.get(&format!("mutants.{key}")).map(str::to_owned);
        let value = if is_whole { Some(value) } else { accepted };
        figures.extend(value.map(|value| Figure::new(key, value).within(TOLERANCE)));
    }
    figures
}

impl Area {
    fn run(&self, options: &Options) -> Result<Outcome> {
        let folder = target_dir().join("mutants").join(self.name);
        // A new run must not continue with results of an earlier one.
        if folder.exists() {
            fs::remove_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        }
        fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        println!("\n{}: the tests beside the code", self.name);
        run_mutants(self.command(options, &folder).args(["--", "--lib"]))?;
        let mut outcome = Outcome::default();
        outcome.read(&folder);
        if !outcome.missed.is_empty() {
            println!("\n{}: the survivors, with {}", self.name, self.tests.join(", "));
            let (targets, filters) = test_files(self.tests)?;
            let tests = targets.iter().map(String::as_str).chain(["--"]).chain(filters.iter().map(String::as_str));
            // Skips mutants that were caught, and those that do not compile.
            run_mutants(self.command(options, &folder).args(["--iterate", "--"]).args(tests))?;
            outcome.missed.clear();
            outcome.timeout.clear();
            outcome.read(&folder);
        }
        Ok(outcome)
    }

    /// Returns the command of cargo-mutants. It works on a copy of the sources, and runs the unchanged tests first to time them.
    fn command(&self, options: &Options, folder: &Path) -> Command {
        let mut command = Command::new(cargo());
        command.args(["mutants", "--package", "mavstack", "--features", "signing,storage"]);
        command.args(["--no-shuffle", "--timeout-multiplier", "5", "--output"]).arg(folder);
        command.args(self.files.iter().flat_map(|glob| ["--file", glob]));
        command.args(options.shard.iter().flat_map(|part| ["--shard", part.as_str()]));
        if let Some(file) = &options.in_diff {
            command.arg("--in-diff").arg(file);
        }
        // Most of the time is for builds. A few cases of each property find gross errors.
        command
            .env("CARGO_INCREMENTAL", "1")
            .env("CARGO_PROFILE_DEV_DEBUG", "0")
            .env("CARGO_PROFILE_DEV_OPT_LEVEL", "1");
        command.env("PROPTEST_CASES", "16").env("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "1");
        // A shared target folder would be rebuilt for each copy. CI would make tests fail where pymavlink is missing.
        command.env_remove("CARGO_TARGET_DIR").env_remove("CI");
        command.arg("--dir").arg(root());
        command
    }
}

/// Returns what is wrong with the files of the areas, and of the accepted survivors in `listed`: those that do not exist.
fn missing(listed: &str) -> Vec<String> {
    // A pattern stands for the files of a folder.
    let exists = |path: &str| {
        let path = root().join(path);
        match path.parent() {
            Some(folder) if path.ends_with("**") || path.ends_with("*.rs") => folder.is_dir(),
            _ => path.is_file(),
        }
    };
    let of_areas = AREAS.iter().flat_map(|area| area.files.iter().map(|file| (*file, "xtask/measure/src/mutants.rs")));
    let of_survivors = count(listed.lines()).into_keys().filter_map(|name| Some((name.split_once(':')?.0, LISTED)));
    let missing = of_areas.chain(of_survivors).filter(|(path, _)| !exists(path));
    missing
        .map(|(path, list)| format!("{list} names {path}, which does not exist: correct the path, or remove it"))
        .collect()
}

/// Survivors and timeouts are results; other exit codes are failures.
fn run_mutants(command: &mut Command) -> Result {
    let status = command.status().map_err(|error| format!("cargo mutants could not be started: {error}"))?;
    match status.code() {
        Some(0 | 2 | 3) => Ok(()),
        _ => Err(format!("cargo mutants failed ({status})")),
    }
}

impl Outcome {
    /// Adds the results of the last pass. Without mutants there are no files.
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

    fn caught(&self) -> usize {
        self.caught.len() + self.timeout.len()
    }

    fn percent_caught(&self) -> f64 {
        100.0 * self.caught() as f64 / self.viable().max(1) as f64
    }

    fn line(&self, area: &str, unlisted: usize) -> String {
        let [caught, timeout, missed, unviable] =
            [&self.caught, &self.timeout, &self.missed, &self.unviable].map(Vec::len);
        let (viable, percent) = (self.viable(), self.percent_caught());
        format!(
            "{area:<10} {viable:>6} {caught:>7} {timeout:>8} {missed:>9} {unlisted:>9} {unviable:>10} {percent:>8.1}"
        )
    }
}

/// Turns `src/a.rs:12:34: replace …` into `src/a.rs: replace …`, because places change with every line above.
fn without_place(name: &str) -> String {
    let mut parts = name.splitn(4, ':');
    match (parts.next(), parts.next(), parts.next(), parts.next()) {
        (Some(file), Some(_), Some(_), Some(what)) => format!("{file}:{what}"),
        _ => name.to_owned(),
    }
}

/// Counts how often each mutant is listed: the same change at two places of a function has one name.
fn count<'a>(lines: impl Iterator<Item = &'a str>) -> BTreeMap<&'a str, usize> {
    let mut counts = BTreeMap::new();
    for line in lines.filter(|line| line.starts_with("src/")) {
        *counts.entry(line).or_default() += 1;
    }
    counts
}

/// Takes `name` off the list. Returns whether it was there.
fn takes(counts: &mut BTreeMap<&str, usize>, name: &str) -> bool {
    let left = counts.get_mut(name).filter(|left| **left > 0);
    left.map(|left| *left -= 1).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_exists() {
        for area in &AREAS {
            test_files(area.tests).expect(area.name);
        }
        let listed = fs::read_to_string(root().join(LISTED)).expect("the list is readable");
        assert_eq!(missing(&listed), [""; 0]);
        let gone = "src/gone.rs: replace f with ()\nsrc/lib.rs: replace g with ()";
        assert_eq!(
            missing(gone),
            [format!("{LISTED} names src/gone.rs, which does not exist: correct the path, or remove it")]
        );
    }

    #[test]
    fn mutants_are_known_by_what_they_change() {
        let name = "src/crc.rs:47:17: replace < with == in f::<u8>";
        assert_eq!(without_place(name), "src/crc.rs: replace < with == in f::<u8>");
    }

    #[test]
    fn the_sums_are_over_all_areas() {
        let new = |area: &str| [(format!("{area}.viable"), 500), (format!("{area}.caught"), 480)];
        let values = |new: &[(String, u64)], accepted: &str| {
            let figures = with_other_areas(new, &Figures::parse(accepted).expect("figures"));
            let is_sum = |figure: &&Figure| ["viable", "percent"].iter().any(|key| figure.is(key));
            figures.iter().filter(is_sum).cloned().collect::<Vec<_>>()
        };
        let sums = |viable: &str, percent: &str| {
            [("viable", viable), ("percent", percent)].map(|(key, value)| Figure::new(key, value).within(TOLERANCE))
        };
        let all: Vec<_> = AREAS.iter().flat_map(|area| new(area.name)).collect();
        assert_eq!(values(&all, ""), sums("2,000", "96.0"));
        // Of an area that was not run, the accepted figures count.
        let storage = "[mutants]\nstorage.viable = \"1,000\"\nstorage.caught = \"1,000\"\n";
        assert_eq!(values(&all[..6], storage), sums("2,500", "97.6"));
        // Without them the sums stay.
        assert_eq!(values(&all[..6], "[mutants]\nviable = \"7\"\npercent = \"8\"\n"), sums("7", "8"));
        assert_eq!(values(&all[..6], ""), []);
    }

    #[test]
    fn each_line_of_the_list_excuses_one() {
        let mut counts = count("# Why.\nsrc/a.rs: x\nsrc/a.rs: x\n".lines());
        assert!(takes(&mut counts, "src/a.rs: x") && takes(&mut counts, "src/a.rs: x"));
        assert!(!takes(&mut counts, "src/a.rs: x") && !takes(&mut counts, "# Why."));
    }
}
