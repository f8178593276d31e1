//! Ids, `CRC_EXTRA`, lengths, offsets and wire order of every message of every definition (S-3, S-4), against tables that
//! pymavlink's parser computed.

mod support;

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
};
use support::{assert_rows, path, table};

/// What is installed; another version may ship other definitions, and that is fine.
const PYMAVLINK: &str = "pymavlink==2.4.50";

#[test]
fn every_message_of_every_definition_has_the_wire_form_that_the_reference_gives() {
    let expected = fs::read_to_string(path("tests/definitions/wire.csv")).expect("the fixture");
    let expected: Vec<_> = expected.lines().map(str::to_owned).collect();
    assert_rows(&table(&[path("definitions"), path("tests/definitions")]), &expected);
    assert_eq!(expected.len(), 3710, "3709 messages in 20 dialects, and the header");
}

/// The definitions that pymavlink ships are older: another set of facts, and their parser is at hand to compare with.
#[test]
fn the_definitions_inside_pymavlink_give_what_its_own_parser_says() {
    let python = match pymavlink() {
        Ok(python) => python,
        Err(reason) => {
            assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "CI has no pymavlink: {reason}");
            support::say(&format!("SKIPPED: no comparison with pymavlink's parser: {reason}"));
            return;
        }
    };
    let output = Command::new(&python).arg(path("tests/mavparse_rows.py")).output().expect("python runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let expected: Vec<_> = String::from_utf8(output.stdout).expect("text").lines().map(str::to_owned).collect();

    let directory = "import os, pymavlink; print(os.path.join(os.path.dirname(pymavlink.__file__), 'dialects', 'v20'))";
    let output = Command::new(&python).args(["-c", directory]).output().expect("python runs");
    let directory = PathBuf::from(String::from_utf8(output.stdout).expect("a path").trim());
    assert_rows(&table(&[directory]), &expected);
    assert!(expected.len() > 3_000, "only {} rows", expected.len());
}

/// A Python that has pymavlink: of a virtual environment beside the build's output, made on first use.
fn pymavlink() -> Result<PathBuf, String> {
    let environment = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pymavlink");
    let python = environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let version = PYMAVLINK.rsplit('=').next().unwrap_or_default();
    let check = format!("import importlib.metadata as m; assert m.version('pymavlink') == '{version}'");
    if run(Command::new(&python).args(["-c", &check])).is_ok() {
        return Ok(python);
    }
    run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&environment))?;
    run(Command::new(&python).args(["-m", "pip", "install", "--quiet", "--no-input", "--retries", "1", PYMAVLINK]))?;
    Ok(python)
}

fn run(command: &mut Command) -> Result<ExitStatus, String> {
    let what = format!("{command:?}");
    let output = command.stdin(Stdio::null()).output().map_err(|error| format!("{what}: {error}"))?;
    if output.status.success() {
        return Ok(output.status);
    }
    Err(format!("{what}: {}", String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or("failed")))
}
