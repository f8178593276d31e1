//! `cargo xtask semver`: whether the public interface still fits its version.

use std::process::Command;

use crate::system::{Result, cargo, output, root, run, succeeds};

/// The packages with a library that others use. A macro's interface cannot be compared.
const LIBRARIES: [&str; 8] = [
    "mavstack",
    "mavstack-check",
    "mavstack-console",
    "mavstack-demo",
    "mavstack-fram",
    "mavstack-snapshot",
    "mavstack-station",
    "mavstack-traffic",
];

/// Compares the interfaces with those of `baseline`; by default, of the last tag. A change that breaks them needs another version.
pub fn check(baseline: Option<&str>) -> Result {
    let folder = root().display().to_string();
    let last = || output("git", &["-C", &folder, "describe", "--tags", "--abbrev=0"]);
    let baseline = baseline.map(str::to_owned).or_else(last).ok_or("there is no tag: `git fetch --tags`")?;
    println!("Comparing with {baseline}");
    prepare()?;
    let mut command = Command::new(cargo());
    command.args(["semver-checks", "check-release", "--baseline-rev", &baseline]);
    command.args(LIBRARIES.iter().flat_map(|name| ["--package", name]));
    run(command.current_dir(root()))
}

/// Installs cargo-semver-checks if it is missing.
fn prepare() -> Result {
    if !succeeds("cargo", &["semver-checks", "--version"]) {
        println!("Installing cargo-semver-checks: cargo install cargo-semver-checks --locked");
        run(Command::new(cargo()).args(["install", "--quiet", "cargo-semver-checks", "--locked"]))?;
    }
    Ok(())
}
