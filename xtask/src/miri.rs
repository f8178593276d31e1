//! `cargo xtask miri`: the library's tests in Miri, an interpreter that sees undefined behaviour.
//!
//! The library has no `unsafe`, but what it uses has: heapless, embedded-io, postcard, sha2, zeroize.

use std::process::Command;

use crate::coverage::{FEATURES, MODEL};
use crate::system::{Result, has, nightly, root, run, target_dir};

/// Test files that are run, beside the tests inside `src`. The others simulate minutes of flight, for which the interpreter, some
/// hundred times slower than a processor, takes hours; and three start other programs.
const FILES: [&str; 10] = [
    "errors",
    "every_command",
    "fram",
    "golden",
    "metadata",
    "minimal",
    "mode_requests",
    "routing_refused",
    "secrets",
    "signing_setup",
];

/// Tests that are not run here, by a part of their names: each takes the interpreter ten minutes or more.
const LEFT_OUT: [&str; 19] = [
    // Every state of the plan engine; every event in every state; a hundred seeds.
    MODEL,
    "table::every_event_in_every_state",
    "random::live_plans_are_whole",
    "upload::a_plan_of_any_length",
    // A power cut at every byte; every bit flipped; thousands of random images.
    "storage::tests::cuts",
    "storage::tests::garbage",
    "layout::damage_is_seen",
    "params::a_cut_anywhere",
    "params::garbage_rows",
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

/// Runs the tests. Where no Miri can be had it says so, which is no error.
pub fn run_tests() -> Result {
    if !has("rustup") {
        println!("Miri comes by rustup, which is not here: nothing was run.");
        return Ok(());
    }
    nightly(&["miri", "rust-src"])?;
    run(&mut command())
}

fn command() -> Command {
    let mut command = Command::new("rustup");
    command.args(["run", "nightly", "cargo", "miri", "test", "--quiet", "--package", "mavstack"]);
    command.args(["--features", FEATURES, "--no-fail-fast", "--lib"]);
    for file in FILES {
        command.args(["--test", file]);
    }
    command.arg("--target-dir").arg(target_dir().join("miri")).arg("--");
    for test in LEFT_OUT {
        command.args(["--skip", test]);
    }
    // What cargo has told us about itself is not for the other one.
    command.env_remove("CARGO").env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTFLAGS");
    // proptest asks for the folder that it is in. What the tests' vehicles refer to is leaked; the library has no allocator.
    command.env("MIRIFLAGS", "-Zmiri-disable-isolation -Zmiri-ignore-leaks").env("PROPTEST_CASES", CASES);
    command.current_dir(root());
    command
}
