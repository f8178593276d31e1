//! `cargo measure miri`: the tests of the library and of the snapshot in Miri, an interpreter that detects undefined behaviour.
//!
//! The library has no `unsafe`, but its dependencies have: heapless, embedded-io, postcard, sha2, zeroize. The snapshot has.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use crate::coverage::{FEATURES, MODEL};
use crate::figures::{Figure, settle};
use crate::system::{Result, has, nightly, output, root, run, target_dir, test_files};

/// The test files that are run, besides the tests inside `src`. The interpreter is some hundred times slower than a processor: it
/// takes hours for the other files, which simulate minutes of flight. Three of them start other programs.
const FILES: [&str; 10] = [
    "api/errors",
    "commands/every_command",
    "commands/mode_requests",
    "routing/refused",
    "signing/setup",
    "stack/minimal",
    "storage/partition",
    "vehicle/metadata",
    "wire/golden",
    "wire/secrets",
];

/// Tests that are not run, by a part of their names: the interpreter takes ten minutes or more for each.
const LEFT_OUT: [&str; 17] = [
    // Every state of the plan engine; every event in every state; a hundred seeds.
    MODEL,
    "table::every_event_in_every_state",
    "random::live_plans_are_whole",
    "upload::a_plan_of_any_length",
    // A power cut at every byte; every bit flipped; thousands of records.
    "storage::tests::cuts",
    "storage::tests::records_come_back",
    "page::tests::each_flipped_bit",
    "plans_are_kept",
    "plans_that_cannot_be_read",
    "parameters_that_cannot_be_read",
    // A million numbers.
    "decimal::tests::floats_are",
    // Minutes of a line's time.
    "tests::whole_rates_are_exact",
    "tests::intervals_are_kept",
    "tests::a_line_that_stood_for_long",
    "list::a_lossy_line",
    "tests::line_is_full_and_yet",
    "memory::tests::places_are_shared",
];

/// Cases of each property; otherwise it is hundreds.
const CASES: &str = "1";

/// Schedules of the snapshot's threads. Miri chooses one at random for each.
const SCHEDULES: &str = "-Zmiri-many-seeds=0..32";

/// Runs the tests. Without rustup it prints that nothing was run, which is no error.
pub fn run_tests(accepts: bool) -> Result {
    if !has("rustup") {
        println!("Miri needs rustup, which is not installed: nothing was run.");
        return Ok(());
    }
    nightly(&["miri", "rust-src"])?;
    // Not in the figure, which counts the library's tests.
    run(&mut snapshot())?;
    let (options, filters) = test_files(&FILES)?;
    // Two runs, because a filter that names files would leave out the tests inside `src`.
    let library = passed(&mut command(&["--lib".to_owned()], &[]));
    let files = passed(&mut command(&options, &filters));
    let figures = [Figure::new("tests", library? + files?)];
    let version = output("rustup", &["run", "nightly", "rustc", "--version"]).unwrap_or_default();
    settle("miri", version.split_whitespace().nth(1).unwrap_or_default(), &figures, accepts)
}

/// Runs tests, prints their output, and returns how many have passed.
fn passed(command: &mut Command) -> Result<u64> {
    let mut child = command.stdout(Stdio::piped()).spawn().map_err(|error| format!("Miri: {error}"))?;
    let mut passed = 0;
    if let Some(output) = child.stdout.take() {
        for line in BufReader::new(output).lines().map_while(std::result::Result::ok) {
            println!("{line}");
            passed += passed_in(&line);
        }
    }
    let status = child.wait().map_err(|error| format!("Miri: {error}"))?;
    if status.success() { Ok(passed) } else { Err(format!("Miri failed ({status})")) }
}

/// Returns how many tests have passed, by the last line of a test program.
fn passed_in(line: &str) -> u64 {
    let count = line.strip_prefix("test result: ok. ").and_then(|rest| rest.split_once(" passed"));
    count.and_then(|(count, _)| count.parse().ok()).unwrap_or(0)
}

fn command(targets: &[String], filters: &[String]) -> Command {
    let mut command = miri("mavstack");
    command.args(["--features", FEATURES, "--no-fail-fast"]).args(targets).arg("--").args(filters);
    for test in LEFT_OUT {
        command.args(["--skip", test]);
    }
    // proptest reads the current folder, and the tests' vehicles leak what they refer to.
    command.env("MIRIFLAGS", "-Zmiri-disable-isolation -Zmiri-ignore-leaks").env("PROPTEST_CASES", CASES);
    command
}

fn snapshot() -> Command {
    let mut command = miri("mavstack-snapshot");
    command.args(["--test", "threads"]).env("MIRIFLAGS", SCHEDULES);
    command
}

/// Returns the command that runs the tests of a package.
fn miri(package: &str) -> Command {
    let mut command = Command::new("rustup");
    command.args(["run", "nightly", "cargo", "miri", "test", "--quiet", "--package", package, "--target-dir"]);
    command.arg(target_dir().join("miri")).current_dir(root());
    // The other cargo must not get the variables that cargo has set for this program.
    command.env_remove("CARGO").env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTFLAGS");
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_exists() {
        let (options, filters) = test_files(&FILES).expect("files of `tests/`");
        assert!(options.contains(&"--test=wire".to_owned()) && filters.contains(&"golden::".to_owned()));
    }

    #[test]
    fn passed_tests_are_counted() {
        let line = "test result: ok. 524 passed; 0 failed; 2 ignored; 0 measured; 19 filtered out; finished in 1.00s";
        assert_eq!((passed_in(line), passed_in("running 524 tests"), passed_in("")), (524, 0, 0));
    }
}
