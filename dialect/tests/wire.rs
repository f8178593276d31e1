//! Ids, `CRC_EXTRA`, lengths, offsets and wire order of every message of every definition (S-3, S-4), against tables
//! that pymavlink's parser computed.

#[path = "../../tests/support/pymavlink.rs"]
mod pymavlink;
mod support;

use std::{fs, path::PathBuf, process::Command};
use support::{assert_rows, path, table};

#[test]
fn all_messages_agree_with_the_reference_table() {
    let expected = fs::read_to_string(path("tests/definitions/wire.csv")).expect("the fixture");
    let expected: Vec<_> = expected.lines().map(str::to_owned).collect();
    assert_rows(&table(&[path("definitions"), path("tests/definitions")]), &expected);
    assert_eq!(expected.len(), 3722, "3721 messages in 20 dialects, and the header");
}

/// The definitions in the pymavlink package are older, and so another set of inputs for a comparison with its parser.
#[test]
fn all_messages_of_pymavlinks_definitions_agree_with_its_parser() {
    let Some(python) = pymavlink::python() else { return };
    let output = Command::new(python).arg(path("tests/mavparse_rows.py")).output().expect("python runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let expected: Vec<_> = String::from_utf8(output.stdout).expect("text").lines().map(str::to_owned).collect();

    let directory = "import os, pymavlink; print(os.path.join(os.path.dirname(pymavlink.__file__), 'dialects', 'v20'))";
    let output = Command::new(python).args(["-c", directory]).output().expect("python runs");
    let directory = PathBuf::from(String::from_utf8(output.stdout).expect("a path").trim());
    assert_rows(&table(&[directory]), &expected);
    assert!(expected.len() > 3_000, "only {} rows", expected.len());
}
