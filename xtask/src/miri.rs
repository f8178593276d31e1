//! `cargo xtask miri`: the library's tests in Miri, an interpreter that sees undefined behaviour.
//!
//! The library has no `unsafe`, but what it uses has: heapless, embedded-io, postcard, sha2, zeroize.

use std::process::Command;

use crate::coverage::FEATURES;
use crate::system::{Result, nightly, root, run, target_dir, tests_of_library};

/// Test files that are not run here.
const FILES_LEFT_OUT: [&str; 3] = [
    // They start other programs, and write files for them.
    "refused",
    "signing_pymavlink",
    "wpl_pymavlink",
];

/// Tests that are not run here, by a part of their names: the interpreter would take hours.
const TESTS_LEFT_OUT: [&str; 0] = [];

/// Cases of each property; otherwise it is hundreds.
const CASES: &str = "2";

/// Runs the tests. Where there is no Miri it says so, which is no error.
pub fn run_tests() -> Result {
    if let Err(error) = nightly(&["miri", "rust-src"]) {
        println!("Miri cannot be had here ({error}): nothing was run.");
        return Ok(());
    }
    run(&mut command()?)
}

fn command() -> Result<Command> {
    let mut command = Command::new("rustup");
    command.args(["run", "nightly", "cargo", "miri", "test", "--quiet", "--package", "mavstack"]);
    command.args(["--features", FEATURES, "--no-fail-fast", "--lib"]);
    for test in tests_of_library(&FILES_LEFT_OUT)? {
        command.args(["--test", &test]);
    }
    command.arg("--target-dir").arg(target_dir().join("miri")).arg("--");
    for test in TESTS_LEFT_OUT {
        command.args(["--skip", test]);
    }
    // What cargo has told us about itself is not for the other one.
    command.env_remove("CARGO").env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTFLAGS");
    // proptest asks for the folder that it is in.
    command.env("MIRIFLAGS", "-Zmiri-disable-isolation").env("PROPTEST_CASES", CASES);
    command.current_dir(root());
    Ok(command)
}
