//! `cargo measure nightly`: the lane for checks that take too long for every change, in steps.
//!
//! The result of each step stays in `target/nightly/`, with the tested commit and the step's output. So a run may be
//! interrupted: the next run skips the steps that passed at the same commit, and restarts the interrupted step.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::thread;
use std::time::Instant;

use crate::system::{Result, cargo, output, root, target_dir};

/// A step, which can be run by itself and ends within some hours on two cores.
struct Step {
    name: &'static str,
    what: &'static str,
    /// Arguments of `cargo`.
    command: &'static [&'static str],
}

const fn step(name: &'static str, what: &'static str, command: &'static [&'static str]) -> Step {
    Step { name, what, command }
}

/// A step that runs a fuzz target for half an hour.
const fn fuzz(name: &'static str, command: &'static [&'static str; 5]) -> Step {
    step(name, "half an hour of this fuzz target", command)
}

/// All steps, short ones first.
const STEPS: [Step; 34] = [
    step(
        "signed-frames",
        "10^7 changed signed frames, none of which may be accepted",
        &["test", "--release", "--features", "signing", "--test", "signing", "--", "--include-ignored", "vectors::"],
    ),
    step(
        "operator-control",
        "operator control: every order of five frames, and every frame in every state of a model",
        &["test", "--release", "--test", "vehicle", "operator_model::", "--", "--ignored", "--nocapture"],
    ),
    step(
        "fleet",
        "250 simulated vehicles on this machine, and what they cost",
        &["test", "--release", "--package", "mavstack-sitl", "--test", "fleet", "--", "--ignored", "--nocapture"],
    ),
    step("boards", "the boards' firmwares; six run in emulators under pymavlink", &["xtask", "boards", "--run"]),
    step("doctor", "the doctor on boards in emulators, sound and made faulty", &["xtask", "boards", "--doctor"]),
    step(
        "ethernet",
        "1,000 frames a second in each direction for a minute, over smoltcp and embassy-net in QEMU",
        &["xtask", "integration", "--target", "qemu", "--file", "test_ethernet.py", "--load-seconds", "60"],
    ),
    step("packages", "each crate built from its package alone, as it would be published", &["xtask", "publish-check"]),
    step("semver", "the public interface, compared with that of the last tag", &["xtask", "semver"]),
    step("panic-free", "no panic in the firmware, at opt-level s and 3", &["measure", "panic-free"]),
    step("book", "the guides as a book, with search", &["xtask", "book"]),
    step("dialects", "ardupilotmega, generated, compiled and compared with pymavlink", &["xtask", "dialects"]),
    step("jitter", "the delay of flight beside MAVLink and storage, in QEMU", &["xtask", "jitter"]),
    step(
        "storage-cuts",
        "a power cut at every byte of a save, second cuts at every write unit, and 100,000 saves",
        &[
            "test",
            "--release",
            "--features",
            "signing,storage",
            "--lib",
            "storage::",
            "--",
            "--include-ignored",
            "--skip",
            "a_million",
        ],
    ),
    step(
        "storage-second-cuts",
        "10^6 second cuts at seeded places",
        &["test", "--release", "--features", "signing,storage", "--lib", "a_million_second_cuts", "--", "--ignored"],
    ),
    step(
        "storage-scripts",
        "10^7 random images, records, and scripts of saves, power cuts and damage",
        &[
            "test",
            "--release",
            "--manifest-path",
            "fuzz/Cargo.toml",
            "--target-dir",
            "target/fuzz/test",
            "--lib",
            "ten_million",
            "--",
            "--ignored",
        ],
    ),
    step("loom", "the snapshot in every interleaving", &["measure", "loom"]),
    step("size", "flash and RAM of the library, at opt-level z too", &["measure", "size"]),
    step("options", "flash and RAM of each option, and of whole vehicles", &["measure", "options"]),
    step("coverage", "lines and branches that the tests reach", &["measure", "coverage"]),
    step("compare", "the other libraries beside this one", &["measure", "compare"]),
    step("bench", "the benchmarks", &["bench"]),
    step("miri", "the tests in an interpreter that detects undefined behaviour", &["measure", "miri"]),
    fuzz("fuzz-decode", &["xtask", "fuzz", "--seconds", "1800", "decode"]),
    fuzz("fuzz-wpl", &["xtask", "fuzz", "--seconds", "1800", "wpl"]),
    fuzz("fuzz-roundtrip", &["xtask", "fuzz", "--seconds", "1800", "roundtrip"]),
    fuzz("fuzz-sign", &["xtask", "fuzz", "--seconds", "1800", "sign"]),
    fuzz("fuzz-record", &["xtask", "fuzz", "--seconds", "1800", "record"]),
    fuzz("fuzz-dialect", &["xtask", "fuzz", "--seconds", "1800", "dialect"]),
    fuzz("fuzz-files", &["xtask", "fuzz", "--seconds", "1800", "files"]),
    fuzz("fuzz-session", &["xtask", "fuzz", "--seconds", "1800", "session"]),
    step("mutants-signing", "mutants of signing that no test catches", &["measure", "mutants", "signing"]),
    step("mutants-frame", "mutants of framing that no test catches", &["measure", "mutants", "frame"]),
    step("mutants-mission", "mutants of the plan engine that no test catches", &["measure", "mutants", "mission"]),
    step("mutants-storage", "mutants of storage that no test catches", &["measure", "mutants", "storage"]),
];

/// Options of a run.
pub struct Options {
    /// Runs the steps whose names start with one of these; all steps if empty.
    pub names: Vec<String>,
    /// Also runs the steps that have passed at this commit.
    pub again: bool,
    /// Runs nothing, and prints the steps and their results.
    pub lists: bool,
}

/// Runs the steps that have not passed at this commit. A failed step does not stop the others.
pub fn run(options: &Options) -> Result {
    let steps = select(&options.names)?;
    let folder = target_dir().join("nightly");
    fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let here = Source::current();
    if options.lists {
        for step in steps {
            let state = kept(&folder, step).map_or(String::new(), |kept| kept.state(&here));
            println!("{:16} {state:28} {}", step.name, step.what);
        }
        return Ok(());
    }
    if here.has_changes {
        println!("There are uncommitted changes: results are kept, but the next run will not skip these steps.");
    }
    let (mut lines, mut failed) = (Vec::new(), Vec::new());
    for step in steps {
        // Asked before each step, because a commit may be made while the others run.
        let has_passed = |kept: Kept| kept.is_passed && kept.is_of(&Source::current());
        if !options.again && kept(&folder, step).is_some_and(has_passed) {
            lines.push(format!("   -  {}: has passed at this commit", step.name));
            continue;
        }
        println!("\n==== {}: {}", step.name, step.what);
        let kept = play(step, &folder)?;
        let verdict = if kept.is_passed { "" } else { "  FAILED" };
        lines.push(format!("{:4}  {}{verdict}", kept.seconds.div_ceil(60), step.name));
        if !kept.is_passed {
            failed.push(step.name);
        }
    }
    println!("\n==== minutes; results and output are in {}\n{}", folder.display(), lines.join("\n"));
    if failed.is_empty() { Ok(()) } else { Err(format!("failed: {}", failed.join(", "))) }
}

/// Returns the steps whose names start with one of `names`.
fn select(names: &[String]) -> Result<Vec<&'static Step>> {
    let begins = |step: &Step, name: &String| step.name.starts_with(name.as_str());
    if let Some(unknown) = names.iter().find(|name| !STEPS.iter().any(|step| begins(step, name))) {
        let known: Vec<_> = STEPS.iter().map(|step| step.name).collect();
        return Err(format!("there is no step {unknown}; there are {}", known.join(", ")));
    }
    let is_wanted = |step: &&Step| names.is_empty() || names.iter().any(|name| begins(step, name));
    Ok(STEPS.iter().filter(is_wanted).collect())
}

/// Runs a step, prints its output, and keeps output and result.
fn play(step: &Step, folder: &Path) -> Result<Kept> {
    let result = file(folder, step);
    // An interrupted step leaves no result.
    if result.exists() {
        fs::remove_file(&result).map_err(|error| format!("{}: {error}", result.display()))?;
    }
    let mut command = Command::new(cargo());
    command.args(step.command);
    let (before, began) = (Source::current(), Instant::now());
    let is_passed = print_and_keep(command.current_dir(root()), &folder.join(format!("{}.log", step.name)))?;
    let after = Source::current();
    // Changes that were committed or edited during the run may or may not have been tested.
    let has_changes = before != after || after.has_changes;
    let kept = Kept { source: Source { has_changes, ..before }, is_passed, seconds: began.elapsed().as_secs() };
    fs::write(&result, kept.text()).map_err(|error| format!("{}: {error}", result.display()))?;
    Ok(kept)
}

/// Runs `command` and returns whether it succeeds. Its output is printed and written to the file `log`.
fn print_and_keep(command: &mut Command, log: &Path) -> Result<bool> {
    let failed = |error: std::io::Error| format!("{}: {error}", log.display());
    let log = Mutex::new(File::create(log).map_err(failed)?);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let name = command.get_program().to_string_lossy();
    let mut child = child.map_err(|error| format!("{name} could not be started: {error}"))?;
    let (out, err) = (child.stdout.take(), child.stderr.take());
    thread::scope(|scope| {
        scope.spawn(|| out.map(|from| copy(from, std::io::stdout(), &log)));
        scope.spawn(|| err.map(|from| copy(from, std::io::stderr(), &log)));
    });
    child.wait().map(|status| status.success()).map_err(failed)
}

/// Copies line by line to both. A closed terminal or a full disk must not stop the step.
fn copy(from: impl Read, mut to: impl Write, log: &Mutex<File>) {
    let (mut from, mut line) = (BufReader::new(from), Vec::new());
    while from.read_until(b'\n', &mut line).is_ok_and(|count| count > 0) {
        let _ = to.write_all(&line);
        if let Ok(mut log) = log.lock() {
            let _ = log.write_all(&line);
        }
        line.clear();
    }
}

/// Returns the path of a step's result.
fn file(folder: &Path, step: &Step) -> PathBuf {
    folder.join(format!("{}.txt", step.name))
}

fn kept(folder: &Path, step: &Step) -> Option<Kept> {
    Kept::parse(&fs::read_to_string(file(folder, step)).ok()?)
}

/// The tested source.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Source {
    commit: String,
    /// Whether files differ from the commit or are not in it.
    has_changes: bool,
}

impl Source {
    fn current() -> Self {
        let git = |arguments: &[&str]| {
            let folder = root().to_string_lossy();
            output("git", &[&["-C", &folder], arguments].concat())
        };
        // Without git the tested source is not known, so nothing is skipped.
        let commit = git(&["rev-parse", "HEAD"]).unwrap_or_else(|| "unknown".to_owned());
        let changes = git(&["status", "--porcelain"]);
        Self { commit, has_changes: changes.is_none_or(|changes| !changes.is_empty()) }
    }
}

/// The result of a step.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Kept {
    source: Source,
    is_passed: bool,
    seconds: u64,
}

impl Kept {
    /// Whether the result applies to exactly this `source`.
    fn is_of(&self, source: &Source) -> bool {
        self.source == *source && !source.has_changes
    }

    /// Returns what the list says about it, where `source` is checked out.
    fn state(&self, source: &Source) -> String {
        let result = if self.is_passed { "passed" } else { "FAILED" };
        let commit = self.source.commit.get(..10).unwrap_or(&self.source.commit);
        match (self.is_of(source), self.source.has_changes) {
            (true, _) => result.to_owned(),
            (false, false) => format!("{result} at {commit}"),
            (false, true) => format!("{result} with changes"),
        }
    }

    fn text(&self) -> String {
        let Self { source: Source { commit, has_changes }, is_passed, seconds } = self;
        let changes = if *has_changes { "yes" } else { "no" };
        let result = if *is_passed { "passed" } else { "failed" };
        format!("commit: {commit}\nuncommitted changes: {changes}\nresult: {result}\nseconds: {seconds}\n")
    }

    /// Parses a result; `None` if it is incomplete.
    fn parse(text: &str) -> Option<Self> {
        let value = |key: &str| text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(": "));
        let is = |key, yes, no| match value(key)? {
            value if value == yes => Some(true),
            value if value == no => Some(false),
            _ => None,
        };
        Some(Self {
            source: Source {
                commit: value("commit")?.to_owned(),
                has_changes: is("uncommitted changes", "yes", "no")?,
            },
            is_passed: is("result", "passed", "failed")?,
            seconds: value("seconds")?.parse().ok()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The names of the fuzz targets, by their files.
    fn targets() -> Vec<String> {
        let files = fs::read_dir(root().join("fuzz/fuzz_targets")).expect("the targets").flatten();
        files.filter_map(|file| Some(file.path().file_stem()?.to_str()?.to_owned())).collect()
    }

    fn source(commit: &str, has_changes: bool) -> Source {
        Source { commit: commit.to_owned(), has_changes }
    }

    #[test]
    fn a_result_is_read_as_it_was_written_or_not_at_all() {
        for (is_passed, has_changes) in [(true, false), (false, false), (true, true)] {
            let kept = Kept { source: source("0123abcd", has_changes), is_passed, seconds: 1_834 };
            assert_eq!(Kept::parse(&kept.text()), Some(kept));
        }
        let text = Kept { source: source("0123abcd", false), is_passed: true, seconds: 9 }.text();
        for cut in 0..text.len() - 2 {
            assert_eq!(Kept::parse(&text[..cut]), None, "{:?}", &text[..cut]);
        }
    }

    #[test]
    fn only_what_passed_at_this_very_commit_counts() {
        let kept = |source| Kept { source, is_passed: true, seconds: 1 };
        assert!(kept(source("a", false)).is_of(&source("a", false)));
        assert!(!kept(source("b", false)).is_of(&source("a", false)));
        assert!(!kept(source("a", true)).is_of(&source("a", false)));
        assert!(!kept(source("a", true)).is_of(&source("a", true)), "not the same changes");
        assert_eq!(kept(source("a", false)).state(&source("a", false)), "passed");
        assert_eq!(kept(source("a", false)).state(&source("b", false)), "passed at a");
        assert_eq!(kept(source("a", true)).state(&source("a", false)), "passed with changes");
    }

    #[test]
    fn steps_are_found_by_the_beginning_of_their_names() {
        let names = |names: &[&str]| {
            let names: Vec<_> = names.iter().map(|name| (*name).to_owned()).collect();
            select(&names).map(|steps| steps.iter().map(|step| step.name).collect::<Vec<_>>())
        };
        assert_eq!(names(&[]).map(|steps| steps.len()), Ok(STEPS.len()));
        assert_eq!(names(&["fuzz-wpl", "mir"]), Ok(vec!["miri", "fuzz-wpl"]));
        assert_eq!(names(&["fuzz"]).map(|steps| steps.len()), Ok(targets().len()));
        assert!(names(&["fuzz", "nothing"]).is_err_and(|error| error.contains("nothing") && error.contains("miri")));
    }

    #[test]
    fn every_fuzz_target_has_its_step() {
        for target in targets() {
            let is_of =
                |step: &&Step| step.command.starts_with(&["xtask", "fuzz"]) && step.command.last() == Some(&&*target);
            let steps: Vec<_> = STEPS.iter().filter(is_of).collect();
            assert_eq!(steps.iter().map(|step| step.name).collect::<Vec<_>>(), [format!("fuzz-{target}")]);
        }
    }

    /// Names can be used as file names, and the scheduled workflow runs each step in a job of its own.
    #[test]
    fn the_workflow_has_every_step() {
        let path = root().join(".github/workflows/nightly.yml");
        let text = fs::read_to_string(path).expect("the workflow");
        let listed: Vec<_> = text.lines().filter_map(|line| line.strip_prefix("          - ")).collect();
        assert_eq!(listed, STEPS.iter().map(|step| step.name).collect::<Vec<_>>());
    }

    #[test]
    fn output_is_kept_and_a_failure_is_told() {
        let log = std::env::temp_dir().join(format!("mavstack-nightly-{}.log", std::process::id()));
        for (script, is_good) in [("echo out; echo err >&2", true), ("echo out; echo err >&2; exit 3", false)] {
            assert_eq!(print_and_keep(Command::new("sh").args(["-c", script]), &log), Ok(is_good));
            let kept = fs::read_to_string(&log).expect("a log");
            assert!(kept.contains("out\n") && kept.contains("err\n"), "{kept}");
        }
        fs::remove_file(&log).expect("a log");
    }
}
