//! `cargo xtask coverage`: which lines and branches of the library its own tests reach.
//!
//! A branch is one way out of a condition: an `if` has two. Tests inside `src` and the generated dialect do not count, nor do
//! the examples that are in the documentation.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::AddAssign;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::system::{Result, nightly, root, run, succeeds, target_dir, tests_of_library};

/// All but defmt, which needs a logger to link.
pub const FEATURES: &str = "embedded-hal-nb,embedded-io-06,embedded-io-async,fmt,plan-texts,signing,storage";

/// Test files that are not run here.
const LEFT_OUT: [&str; 3] = [
    // It gives programs to the compiler.
    "refused",
    // They compare with pymavlink what others here hold against tables.
    "signing_pymavlink",
    "wpl_pymavlink",
];

/// What has to be reached at least, in whole percent: of lines, of branches. What was measured, rounded down.
const BOUNDS: [(&str, &[&str], usize, usize); 5] = [
    ("src", &[""], 0, 0),
    ("decoder", &["frame/decoder", "frame/crc", "frame/mod"], 0, 0),
    ("mission", &["service/mission", "stack/plans"], 0, 0),
    ("signing", &["frame/signing", "service/signing", "stack/signing", "stack/key", "storage/signing"], 0, 0),
    ("storage", &["storage", "stack/storage"], 0, 0),
];

/// Runs the tests, prints the figures, and compares them with their bounds.
pub fn measure(names_missing: bool) -> Result {
    nightly(&["llvm-tools"])?;
    if !succeeds("rustup", &["run", "nightly", "cargo", "llvm-cov", "--version"]) {
        println!("Installing cargo-llvm-cov: cargo install cargo-llvm-cov --locked");
        let install = ["run", "stable", "cargo", "install", "--quiet", "cargo-llvm-cov", "--locked"];
        run(Command::new("rustup").args(install))?;
    }
    let report = target_dir().join("coverage.info");
    run(&mut command(&report)?)?;
    let text = fs::read_to_string(&report).map_err(|error| format!("{}: {error}", report.display()))?;
    let files = parse(&text, &root().join("src"), |path| {
        fs::read_to_string(path).map(|source| end_of_code(&source)).unwrap_or(usize::MAX)
    });
    print(&files, names_missing);
    judge(&files)
}

fn command(report: &Path) -> Result<Command> {
    let mut command = Command::new("rustup");
    command.args(["run", "nightly", "cargo", "llvm-cov", "--branch", "--package", "mavstack", "--features", FEATURES]);
    command.args(["--quiet", "--lcov", "--output-path"]).arg(report).arg("--lib");
    for test in tests_of_library(&LEFT_OUT)? {
        command.args(["--test", &test]);
    }
    // What cargo has told us about itself is not for the other one. Names of lines are in the coverage map, not in debug info.
    command.env_remove("CARGO").env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTFLAGS");
    command.env("CARGO_PROFILE_TEST_DEBUG", "0").env("CARGO_PROFILE_DEV_DEBUG", "0").env("CARGO_INCREMENTAL", "0");
    command.current_dir(root());
    Ok(command)
}

/// How much there is, and how much of it was reached.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Share {
    all: usize,
    reached: usize,
}

impl Share {
    /// In hundredths of a percent, rounded down; what does not exist is reached.
    fn hundredths(self) -> usize {
        (self.reached * 10_000).checked_div(self.all).unwrap_or(10_000)
    }

    fn missed(self) -> usize {
        self.all - self.reached
    }

    fn percent(self) -> String {
        let hundredths = self.hundredths();
        format!("{}.{:02}", hundredths / 100, hundredths % 100)
    }
}

impl AddAssign for Share {
    fn add_assign(&mut self, other: Self) {
        self.all += other.all;
        self.reached += other.reached;
    }
}

/// A source file's lines and branches.
#[derive(Debug, Default, PartialEq)]
struct File {
    lines: Share,
    branches: Share,
    /// Lines that were not reached, and those of branches that were not taken.
    missed_lines: BTreeSet<usize>,
    missed_branches: BTreeSet<usize>,
}

/// The files below `folder` by their names there, without extension; of each the lines before the one that `end` tells.
fn parse(text: &str, folder: &Path, end: impl Fn(&Path) -> usize) -> BTreeMap<String, File> {
    let mut files = BTreeMap::new();
    let mut current = None;
    for line in text.lines() {
        let (word, rest) = line.split_once(':').unwrap_or((line, ""));
        let numbers: Vec<_> = rest.split(',').map(|number| number.parse().unwrap_or(0)).collect();
        match (word, &numbers[..], &mut current) {
            ("SF", ..) => {
                let path = PathBuf::from(rest);
                let name = path.strip_prefix(folder).ok().map(|name| name.with_extension("").display().to_string());
                current = name.filter(|name| is_library(name)).map(|name| (name, end(&path), File::default()));
            }
            ("DA", &[at, count, ..], Some((_, end, file))) if at < *end => {
                file.lines += Share { all: 1, reached: usize::from(count > 0) };
                file.missed_lines.extend((count == 0).then_some(at));
            }
            ("BRDA", &[at, _, _, count], Some((_, end, file))) if at < *end => {
                file.branches += Share { all: 1, reached: usize::from(count > 0) };
                file.missed_branches.extend((count == 0).then_some(at));
            }
            ("end_of_record", ..) => files.extend(current.take().map(|(name, _, file)| (name, file))),
            _ => {}
        }
    }
    files
}

/// Neither generated nor a test.
fn is_library(name: &str) -> bool {
    !name.starts_with("dialect/") && !name.split('/').any(|part| part == "tests")
}

/// The number of the line with which a file's tests begin.
fn end_of_code(source: &str) -> usize {
    let lines: Vec<_> = source.lines().collect();
    let tests = lines.windows(2).position(|two| two == ["#[cfg(test)]", "mod tests {"]);
    tests.map_or(usize::MAX, |at| at + 1)
}

/// The folder, and where there is none the file; a service is a folder of its own.
fn module(name: &str) -> String {
    let depth = if name.starts_with("service/") { 2 } else { 1 };
    name.split('/').take(depth).collect::<Vec<_>>().join("/")
}

fn print(files: &BTreeMap<String, File>, names_missing: bool) {
    let mut modules: BTreeMap<_, (Share, Share)> = BTreeMap::new();
    for (name, file) in files {
        let (lines, branches) = modules.entry(module(name)).or_default();
        *lines += file.lines;
        *branches += file.branches;
    }
    println!(
        "{:<24} {:>6} {:>6} {:>7}   {:>8} {:>6} {:>7}",
        "module", "lines", "missed", "%", "branches", "missed", "%"
    );
    for (name, (lines, branches)) in modules {
        print_row(&name, lines, branches);
    }
    if names_missing {
        println!();
        for (name, File { missed_lines, missed_branches, .. }) in files {
            let list = |set: &BTreeSet<usize>| set.iter().map(usize::to_string).collect::<Vec<_>>().join(" ");
            if !missed_lines.is_empty() || !missed_branches.is_empty() {
                println!("src/{name}.rs: lines {}; branches in {}", list(missed_lines), list(missed_branches));
            }
        }
    }
}

fn print_row(name: &str, lines: Share, branches: Share) {
    println!(
        "{name:<24} {:>6} {:>6} {:>7}   {:>8} {:>6} {:>7}",
        lines.all,
        lines.missed(),
        lines.percent(),
        branches.all,
        branches.missed(),
        branches.percent()
    );
}

fn judge(files: &BTreeMap<String, File>) -> Result {
    println!();
    let mut faults = Vec::new();
    for (area, places, least_lines, least_branches) in BOUNDS {
        let (mut lines, mut branches) = (Share::default(), Share::default());
        for (_, file) in files.iter().filter(|(name, _)| places.iter().any(|place| name.starts_with(place))) {
            lines += file.lines;
            branches += file.branches;
        }
        print_row(area, lines, branches);
        for (what, share, least) in [("lines", lines, least_lines), ("branches", branches, least_branches)] {
            if share.all == 0 || share.hundredths() < least * 100 {
                faults.push(format!("{area}: {} % of {what} are reached, and {least} were", share.percent()));
            }
        }
    }
    if faults.is_empty() { Ok(()) } else { Err(faults.join("\n       ")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REPORT: &str = "SF:/p/src/frame/mod.rs\nDA:3,7\nDA:4,0\nBRDA:3,0,0,7\nBRDA:3,0,1,-\nDA:9,0\nend_of_record\n\
        SF:/p/src/dialect/common.rs\nDA:1,0\nend_of_record\nSF:/p/src/storage/tests/mod.rs\nDA:1,0\nend_of_record\n\
        SF:/p/tests/frame.rs\nDA:1,0\nend_of_record\n";

    #[test]
    fn lines_and_branches_of_the_library_are_counted_without_its_tests() {
        let files = parse(REPORT, Path::new("/p/src"), |_| 9);
        let half = Share { all: 2, reached: 1 };
        let expected = File { lines: half, branches: half, missed_lines: [4].into(), missed_branches: [3].into() };
        assert_eq!(files, BTreeMap::from([("frame/mod".to_owned(), expected)]));
    }

    #[test]
    fn code_ends_where_tests_begin() {
        assert_eq!(end_of_code("fn a() {}\n\n#[cfg(test)]\nmod tests {\n}\n"), 3);
        assert_eq!(end_of_code("#[cfg(test)]\nmod tests;\nfn a() {}\n"), usize::MAX);
    }

    #[test]
    fn shares_are_rounded_down() {
        assert_eq!(Share { all: 3, reached: 2 }.percent(), "66.66");
        assert_eq!(Share::default().percent(), "100.00");
        assert_eq!((module("service/mission/upload"), module("stack/key")), ("service/mission".into(), "stack".into()));
    }
}
