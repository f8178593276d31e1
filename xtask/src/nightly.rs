//! `cargo xtask nightly`: what takes too long for every change. One after the other, each with how long it took; one that fails
//! does not keep the others from running.

use std::process::Command;
use std::time::Instant;

use crate::system::{Result, cargo, root};

/// A step's name, and its command: of `cargo`, or of this program where it begins with "xtask".
const STEPS: [(&str, &[&str]); 8] = [
    ("coverage", &["xtask", "coverage"]),
    ("mutants", &["xtask", "mutants"]),
    ("miri", &["xtask", "miri"]),
    ("fuzzing, half an hour each", &["xtask", "fuzz", "--seconds", "1800"]),
    (
        "10^7 changed signed frames",
        &["test", "--release", "--features", "signing", "--test", "signing_vectors", "--", "--include-ignored"],
    ),
    ("sizes of each option", &["xtask", "size", "--options"]),
    ("the peers beside us", &["xtask", "compare"]),
    ("the benchmarks", &["bench"]),
];

/// Runs all steps, or those whose names begin with one of `names`.
pub fn run(names: &[String]) -> Result {
    let is_wanted = |step: &str| names.is_empty() || names.iter().any(|name| step.starts_with(name.as_str()));
    let steps: Vec<_> = STEPS.iter().filter(|(name, _)| is_wanted(name)).collect();
    if steps.is_empty() {
        let known: Vec<_> = STEPS.iter().map(|(name, _)| *name).collect();
        return Err(format!("there is no such step; there are: {}", known.join("; ")));
    }
    let this = std::env::current_exe().map_err(|error| format!("this program is not to be found: {error}"))?;
    let (mut times, mut failed) = (Vec::new(), Vec::new());
    for (name, arguments) in steps {
        println!("\n==== {name}");
        let began = Instant::now();
        let mut command = match arguments.split_first() {
            Some((&"xtask", task)) => {
                let mut command = Command::new(&this);
                command.args(task);
                command
            }
            _ => {
                let mut command = Command::new(cargo());
                command.args(*arguments);
                command
            }
        };
        let status = command.current_dir(root()).status();
        let is_good = status.as_ref().is_ok_and(std::process::ExitStatus::success);
        let minutes = began.elapsed().as_secs().div_ceil(60);
        times.push(format!("{minutes:4}  {name}{}", if is_good { "" } else { "  FAILED" }));
        if !is_good {
            failed.push(*name);
        }
    }
    println!("\n==== minutes\n{}", times.join("\n"));
    if failed.is_empty() { Ok(()) } else { Err(format!("failed: {}", failed.join("; "))) }
}
