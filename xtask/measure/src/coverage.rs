//! `cargo measure coverage`: the lines and branches of the library that its tests reach.
//!
//! A branch is one way out of a condition: an `if` has two. Not counted are tests inside `src`, the generated dialect, and examples in
//! the documentation. A `const fn` of which no line runs is evaluated by the compiler, and `tests/api/compile_fail.rs` tests what it
//! refuses: its lines are listed, not counted.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::{AddAssign, RangeInclusive};
use std::path::Path;
use std::process::Command;

use crate::figures::{Figure, settle};
use crate::system::{Result, nightly, output, root, run, succeeds, target_dir};

/// All features but defmt, which needs a logger to link.
pub const FEATURES: &str =
    "embedded-hal-nb,embedded-io-06,embedded-io-async,embedded-storage-async,fmt,plan-texts,signing,storage";

/// Tests that are not run here, by a part of their names.
const LEFT_OUT: [&str; 3] = [
    MODEL,
    // It runs the compiler.
    "compile_fail::",
    // They compare with pymavlink what other tests here compare with tables.
    "pymavlink::",
];

/// A model check of the plan engine. It takes a quarter of an hour here, and reaches no code that other tests do not reach.
pub const MODEL: &str = "tests::model::";

/// The least coverage of lines and of branches, in whole percent: what was measured, rounded down.
const BOUNDS: [(&str, &[&str], usize, usize); 5] = [
    ("src", &[""], 99, 99),
    ("decoder", &["frame/decoder", "crc", "frame/mod"], 100, 100),
    ("mission", &["service/mission", "stack/plans"], 99, 100),
    ("signing", &["frame/signing", "service/signing", "stack/signing", "storage/signing"], 98, 100),
    ("storage", &["storage", "stack/storage"], 99, 100),
];

/// Unreachable branches: file, line, and why the condition is there. They are not counted, unless they are taken after all.
const EXCUSED: &[(&str, &str, &str)] = &[
    ("io/ring", "if let Some(cell) = self.cell(end) {", IN_RANGE),
    ("link/outbox", "if payload.and_then(|payload| message.encode(payload)).is_none() {", IN_RANGE),
    (
        "network/forward",
        "let Some((bytes, others)) = core::mem::take(&mut rest).split_at_mut_checked(self.size) else { break };",
        "there is room for each lane",
    ),
    ("network/memory", "if let Some(held) = self.held.get_mut(usize::from(oldest.from.0)) {", IN_RANGE),
    (
        "network/memory",
        "if let (Ok(()), Some(held)) = (self.seen.push_back(seen), self.held.get_mut(usize::from(from.0))) {",
        "asked whether it has room before",
    ),
    (
        "network/queue",
        "let (Ok(len), size) = (u16::try_from(frame.len()), bytes.len()) else { return };",
        "no frame is that long",
    ),
    ("network/queue", "let Some((front, back)) = ring.split_at_mut_checked(at) else { return };", IN_RANGE),
    (
        "service/mission/download",
        "} else if let Some(oldest) = self.sessions.iter_mut().min_by_key(|session| session.at) {",
        "there are always places for sessions",
    ),
    ("service/statustext", "if !is_last && let Some(end) = chunk.last_chunk_mut::<3>() {", "a chunk is 50 bytes long"),
    ("stack", "if let Some(link) = self.link_mut(link) {", "of a link that there is not nothing is read or written"),
    ("wpl/line", "if let Some(end) = self.bytes.get_mut(self.len) {", "the longest line has room"),
    ("wpl/wide", "if let [.., high, lowest] = wide.whole() {", IN_RANGE),
    ("wpl/wide", "if let Some(lowest) = self.whole().last_mut() {", IN_RANGE),
    ("wpl/wide", "let [high, middle, lowest, rest @ ..] = self.words.get(skipped..)? else { return None };", IN_RANGE),
];
const IN_RANGE: &str = "what is asked for is there; without the condition it could panic";

/// How many percent a figure may differ from the accepted one.
const TOLERANCE: f64 = 0.2;

/// Runs the tests, prints the figures, and compares them with their bounds.
pub fn measure(names_missing: bool, accepts: bool) -> Result {
    nightly(&["llvm-tools"])?;
    if !succeeds("rustup", &["run", "nightly", "cargo", "llvm-cov", "--version"]) {
        println!("Installing cargo-llvm-cov: cargo install cargo-llvm-cov --locked");
        let install = ["run", "stable", "cargo", "install", "--quiet", "cargo-llvm-cov", "--locked"];
        run(Command::new("rustup").args(install))?;
    }
    let report = target_dir().join("coverage.info");
    run(&mut command(&report))?;
    let text = fs::read_to_string(&report).map_err(|error| format!("{}: {error}", report.display()))?;
    let files = parse(&text, &root().join("src"), |path| fs::read_to_string(path).unwrap_or_default());
    print(&files, names_missing);
    let mut figures = judge(&files)?;
    figures.push(Figure::new("excused", files.values().map(|file| file.excused.len()).sum::<usize>()));
    let version = output("rustup", &["run", "nightly", "rustc", "--version"]).unwrap_or_default();
    settle("coverage", version.split_whitespace().nth(1).unwrap_or_default(), &figures, accepts)
}

fn command(report: &Path) -> Command {
    let mut command = Command::new("rustup");
    command.args(["run", "nightly", "cargo", "llvm-cov", "--branch", "--package", "mavstack", "--features", FEATURES]);
    // A failing test is no failure here: that is for `cargo test`.
    command.args(["--quiet", "--ignore-run-fail", "--lcov", "--output-path"]).arg(report);
    command.args(["--tests", "--"]).args(LEFT_OUT.iter().flat_map(|test| ["--skip", test]));
    // The other cargo must not get the variables that cargo has set for this program. The coverage map has the lines, so debug info is
    // not needed.
    command.env_remove("CARGO").env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTFLAGS");
    command.env("CARGO_PROFILE_TEST_DEBUG", "0").env("CARGO_PROFILE_DEV_DEBUG", "0").env("CARGO_INCREMENTAL", "0");
    command.current_dir(root());
    command
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
    /// Lines that only the compiler runs.
    compile_time: usize,
    /// Branches that are not taken, for a reason, and not counted.
    excused: BTreeSet<usize>,
}

impl File {
    /// From what the report says of the file, `record`.
    fn new(name: &str, record: &str, source: &str) -> Self {
        let numbers = |line: &str| line.split(',').map(|number| number.parse().unwrap_or(0)).collect::<Vec<usize>>();
        let of = |word| record.lines().filter_map(move |line| line.strip_prefix(word)).map(numbers);
        let end = end_of_code(source);
        let mut lines: BTreeMap<_, _> =
            of("DA:").filter(|line| line[0] < end).map(|line| (line[0], line[1] > 0)).collect();
        let mut branches: Vec<_> =
            of("BRDA:").filter(|branch| branch[0] < end).map(|branch| (branch[0], branch[3] > 0)).collect();
        let mut file = Self::default();
        for function in const_functions(source) {
            if lines.range(function.clone()).all(|(_, is_reached)| !is_reached) {
                let before = lines.len();
                lines.retain(|line, _| !function.contains(line));
                branches.retain(|(line, _)| !function.contains(line));
                file.compile_time += before - lines.len();
            }
        }
        let excused = |line: usize| {
            let text = source.lines().nth(line - 1).unwrap_or_default().trim();
            EXCUSED.iter().any(|(place, excused, _)| *place == name && *excused == text)
        };
        for (line, is_reached) in lines {
            file.lines += Share { all: 1, reached: is_reached.into() };
            file.missed_lines.extend((!is_reached).then_some(line));
        }
        for (line, is_reached) in branches {
            if !is_reached && excused(line) {
                file.excused.insert(line);
                continue;
            }
            file.branches += Share { all: 1, reached: is_reached.into() };
            file.missed_branches.extend((!is_reached).then_some(line));
        }
        file
    }
}

/// The files below `folder` by their names there, without extension.
fn parse(report: &str, folder: &Path, source: impl Fn(&Path) -> String) -> BTreeMap<String, File> {
    let records = report.split("end_of_record").filter_map(|record| record.trim().strip_prefix("SF:"));
    let named = records.filter_map(|record| {
        let (path, record) = record.split_once('\n')?;
        let name = Path::new(path).strip_prefix(folder).ok()?.with_extension("").display().to_string();
        let file = is_library(&name).then(|| File::new(&name, record, &source(Path::new(path))))?;
        Some((name, file))
    });
    named.collect()
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

/// The lines of each `const fn`, from its first to the brace under it.
fn const_functions(source: &str) -> Vec<RangeInclusive<usize>> {
    let lines: Vec<_> = source.lines().collect();
    let begins = lines.iter().enumerate().filter(|(_, line)| {
        let line = line.trim_start();
        line.starts_with("const fn ") || (line.starts_with("pub") && line.contains(" const fn "))
    });
    let whole = begins.filter_map(|(at, line)| {
        let brace = format!("{}}}", &line[..line.len() - line.trim_start().len()]);
        let len = lines[at..].iter().position(|line| *line == brace)?;
        Some(at + 1..=at + len + 1)
    });
    whole.collect()
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
    let [line, branch] = ["lines", "branches"];
    println!("{:<24} {line:>8} {:>6} {:>7}   {branch:>8} {:>6} {:>7}", "module", "missed", "%", "missed", "%");
    for (name, (lines, branches)) in modules {
        print_row(&name, lines, branches);
    }
    let compile_time: usize = files.values().map(|file| file.compile_time).sum();
    let excused: usize = files.values().map(|file| file.excused.len()).sum();
    println!("\nNot counted: {compile_time} lines that only the compiler runs, {excused} unreachable conditions.");
    if names_missing {
        println!();
        for (name, File { missed_lines, missed_branches, .. }) in files {
            let list = |set: &BTreeSet<usize>| set.iter().map(usize::to_string).collect::<Vec<_>>().join(" ");
            if !missed_lines.is_empty() || !missed_branches.is_empty() {
                println!("src/{name}.rs: lines {}; branches in {}", list(missed_lines), list(missed_branches));
            }
        }
        println!();
        for (place, text, why) in EXCUSED {
            println!("src/{place}.rs: {text}\n    {why}");
        }
    }
}

fn print_row(name: &str, lines: Share, branches: Share) {
    println!(
        "{name:<24} {:>8} {:>6} {:>7}   {:>8} {:>6} {:>7}",
        lines.all,
        lines.missed(),
        lines.percent(),
        branches.all,
        branches.missed(),
        branches.percent()
    );
}

/// Prints the areas, and returns their figures; an error where a bound is broken.
fn judge(files: &BTreeMap<String, File>) -> Result<Vec<Figure>> {
    println!();
    let (mut faults, mut figures) = (Vec::new(), Vec::new());
    for (area, places, least_lines, least_branches) in BOUNDS {
        let (mut lines, mut branches) = (Share::default(), Share::default());
        for (_, file) in files.iter().filter(|(name, _)| places.iter().any(|place| name.starts_with(place))) {
            lines += file.lines;
            branches += file.branches;
        }
        print_row(area, lines, branches);
        for (what, share, least) in [("lines", lines, least_lines), ("branches", branches, least_branches)] {
            if share.all == 0 || share.hundredths() < least * 100 {
                faults.push(format!("{area}: {} % of {what} are reached, the bound is {least} %", share.percent()));
            }
            let tenths = share.hundredths() / 10;
            figures.push(
                Figure::new(format!("{area}.{what}"), format!("{}.{}", tenths / 10, tenths % 10)).within(TOLERANCE),
            );
        }
    }
    if faults.is_empty() { Ok(figures) } else { Err(faults.join("\n       ")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE: &str =
        "fn a() {\n    x\n}\n    pub const fn b() {\n        y\n    }\n\n#[cfg(test)]\nmod tests {\n}\n";
    const REPORT: &str = "SF:/p/src/frame/mod.rs\nDA:1,7\nDA:2,0\nBRDA:1,0,0,7\nBRDA:1,0,1,-\nDA:4,0\nDA:5,0\nBRDA:5,0,0,0\n\
        DA:9,0\nend_of_record\nSF:/p/src/dialect/common.rs\nDA:1,0\nend_of_record\nSF:/p/src/storage/tests/mod.rs\nDA:1,0\n\
        end_of_record\nSF:/p/tests/wire/single_frame.rs\nDA:1,0\nend_of_record\n";

    #[test]
    fn every_excused_line_is_in_the_library() {
        for (place, excused, _) in EXCUSED {
            let file = root().join(format!("src/{place}.rs"));
            let source = std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
            assert!(source.lines().any(|line| line.trim() == *excused), "{place} has no line `{excused}`");
        }
    }

    #[test]
    fn lines_and_branches_of_the_library_are_counted_without_its_tests() {
        let half = Share { all: 2, reached: 1 };
        let expected = File {
            lines: half,
            branches: half,
            missed_lines: [2].into(),
            missed_branches: [1].into(),
            compile_time: 2,
            excused: [].into(),
        };
        let files = parse(REPORT, Path::new("/p/src"), |_| SOURCE.to_owned());
        assert_eq!(files, BTreeMap::from([("frame/mod".to_owned(), expected)]));
        // A constant function that is run is counted as any other.
        let files = parse(&REPORT.replace("DA:5,0", "DA:5,1"), Path::new("/p/src"), |_| SOURCE.to_owned());
        assert_eq!(files["frame/mod"].lines, Share { all: 4, reached: 2 });
    }

    #[test]
    fn code_ends_where_tests_begin() {
        assert_eq!((end_of_code(SOURCE), const_functions(SOURCE)), (8, vec![4..=6]));
        assert_eq!(end_of_code("#[cfg(test)]\nmod tests;\nfn a() {}\n"), usize::MAX);
    }

    #[test]
    fn shares_are_rounded_down() {
        assert_eq!(Share { all: 3, reached: 2 }.percent(), "66.66");
        assert_eq!(Share::default().percent(), "100.00");
        assert_eq!(
            (module("service/mission/upload"), module("stack/plans")),
            ("service/mission".into(), "stack".into())
        );
    }
}
