//! `cargo measure loom`: the snapshot in loom, which runs two threads in every interleaving.

use std::process::Command;

use crate::system::{Result, cargo, root, run, target_dir};

/// Runs the tests. Optimised, because there are about a million interleavings.
pub fn run_tests() -> Result {
    let mut command = Command::new(cargo());
    command.args(["test", "--package", "mavstack-snapshot", "--lib", "--release", "--target-dir"]);
    // A build directory of its own, because the flag changes every crate.
    command.arg(target_dir().join("loom")).env("RUSTFLAGS", "--cfg loom").current_dir(root());
    run(&mut command)
}
