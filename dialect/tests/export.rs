//! The export of declarations in Rust: mavgen reads it and makes the same frames, and the generator makes the same declarations of it.

#[path = "../../tests/support/pymavlink.rs"]
mod pymavlink;
mod support;
#[path = "export/winch.rs"]
mod winch;

use mavstack::frame::{Version, encode};
use mavstack::message::{Char, TypedCommand};
use mavstack::{Address, Message, Text};
use mavstack_dialect::{Options, export, generate, load};
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::process::Command;
use support::path;
use winch::{WinchControl, WinchFault, WinchReport, WinchState};

/// Returns the folder of a test with the definition of the winch in `winch.xml`.
fn exported() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let definition = folder.path().join("winch.xml");
    fs::write(&definition, export(&path("tests/export/winch.rs")).expect("it has XML")).expect("written");
    (folder, definition)
}

/// Returns the declarations in a Rust file: without spaces, comments, paths and what is behind `#[cfg(test)]`.
fn declarations(rust: &str) -> BTreeSet<String> {
    let rust = rust.split("#[cfg(test)]").next().unwrap_or_default();
    let lines = rust.lines().map(|line| line.split("//").next().unwrap_or_default());
    let mut text: String = lines.collect::<String>().split_whitespace().collect();
    for path in ["mavstack::dialect::", "mavstack::message::", "mavstack::", "rules::", "super::"] {
        text = text.replace(path, "");
    }
    text = text.replace(",]", "]").replace(",)", ")");
    // `53_100` is `53100`.
    let digits = |at: usize| text.as_bytes().get(at).is_some_and(u8::is_ascii_digit);
    let plain: String = text
        .char_indices()
        .filter(|&(at, c)| !(c == '_' && at > 0 && digits(at - 1) && digits(at + 1)))
        .map(|(_, c)| c)
        .collect();
    let mut found = BTreeSet::new();
    for (macro_name, end) in [
        ("wire_enum!{", "}}"),
        ("wire_bitmask!{", "}}"),
        ("command!{", "}}"),
        ("message!{", "}}"),
        (":CommandRule=", ";"),
    ] {
        for (at, _) in plain.match_indices(macro_name) {
            let name_at = plain[..at].rfind("const").filter(|_| end == ";").unwrap_or(at);
            let text = plain[name_at..].split(end).next().unwrap_or_default();
            let (front, rest) = text.split_once(",crc_extra=").unwrap_or((text, ""));
            let rest = rest.trim_start_matches(|c: char| c.is_ascii_digit());
            found.insert(format!("{front}{rest}"));
        }
    }
    found
}

#[test]
fn generator_makes_the_same_declarations_of_the_export() {
    let (_folder, definition) = exported();
    let options = Options { beside_common: true, ..Options::for_file(&definition) };
    let again = generate(&load(&definition, &[]).expect("a definition"), &options).expect("declarations");
    let rust = fs::read_to_string(path("tests/export/winch.rs")).expect("the declarations");
    let (first, again) = (declarations(&rust), declarations(&again));
    assert_eq!(first.len(), 2 + 2 + 3 + 3, "{first:#?}");
    assert_eq!(first, again);
}

/// S-3, S-4: the definition means on the wire what the macros mean.
#[test]
fn export_agrees_with_the_macros() {
    let (_folder, definition) = exported();
    let dialect = load(&definition, &[]).expect("a definition");
    for info in [WinchReport::INFO, WinchControl::INFO] {
        let message = dialect.messages.iter().find(|message| message.id == info.id()).expect("exported");
        let lengths = (usize::from(info.base_len()), usize::from(info.max_len()));
        assert_eq!((message.crc_extra(), (message.base_len(), message.max_len())), (info.crc_extra(), lengths));
        let offset = |offset: Option<u8>| offset.map(usize::from);
        assert_eq!(message.offset("target_system"), offset(info.target_system()), "{}", message.name);
    }
    assert_eq!(WinchReport::NAME, "WINCH_REPORT");
}

#[test]
fn mavgen_makes_the_same_frames_of_the_export() {
    let Some(python) = pymavlink::python() else { return };
    let (folder, definition) = exported();
    for name in ["common.xml", "standard.xml", "minimal.xml"] {
        fs::copy(path("definitions").join(name), folder.path().join(name)).expect("copied");
    }
    let output = Command::new(python)
        .arg(path("tests/mavgen_frames.py"))
        .args([&definition, &folder.path().join("winch.py")])
        .output()
        .expect("python runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = WinchReport {
        time_usec: 0x0102_0304_0506_0708,
        energy: 1.5,
        line_out: 2.5,
        acceleration: [1.0, 2.0, 3.0],
        turns: -5,
        id: 7,
        faults: WinchFault::OVERLOAD | WinchFault::HOT,
        tension: 1_000,
        temperatures: [-1, 2],
        state: WinchState::LIFTING,
        result: mavstack::dialect::MavResult::FAILED,
        r#type: 9,
        trim: -8,
        grade: Char(b'x'),
        name: Text::new("hook"),
        cells: [1, 2, 3, 4],
        odometer: -6,
        last: [WinchState::LOWERING, WinchState::LIFTING],
    };
    let control = WinchControl { speed: -0.5, target_system: 1, target_component: 2 };
    let mut expected = vec![row(&report), row(&control)];
    for (id, name) in [
        (winch::WinchRun::RULE.command().0, "MAV_CMD_WINCH_RUN"),
        (winch::WinchDrop::RULE.command().0, "MAV_CMD_WINCH_DROP"),
        (winch::WinchHook::RULE.command().0, "MAV_CMD_WINCH_HOOK"),
    ] {
        expected.push(format!("{id} {name}"));
    }
    let said = String::from_utf8(output.stdout).expect("text");
    assert_eq!(said.lines().collect::<Vec<_>>(), expected);
}

/// Returns what `mavgen_frames.py` prints of a message.
fn row<M: Message>(message: &M) -> String {
    let mut frame = [0; 280];
    let len = encode(message, Version::V2, Address::new(1, 1), 0, &mut frame).expect("the buffer fits any frame");
    let frame: String = frame[..len].iter().map(|byte| format!("{byte:02x}")).collect();
    format!("{} {} {} {frame}", M::ID, M::NAME, M::CRC_EXTRA)
}

/// What has no XML is refused, with its line.
#[test]
fn errors_name_the_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("own.rs");
    for (rust, says) in [
        ("fn main() {", "own.rs: the file: is not Rust"),
        ("fn main() {}", "own.rs: the file: declares no message and no command"),
        (
            "\nmessage! {\n    struct A: A = 53_000 {\n        a: Other,\n    }\n}",
            "own.rs:4: field A.a: `Other` is no type of MAVLink, and no enumeration of this file or of common",
        ),
        ("message! { struct A: A = 53_000 { a: [u8; N] } }", "own.rs:1: field A.a: `[u8;N]` is no type of MAVLink"),
        ("message! { struct A: A = 53_000 { a: u8 = f() } }", "own.rs:1: field A.a: `f()` has no XML"),
        ("message! { struct A: A = { a: u8 } }", "own.rs:1: a declaration: a number is expected, and there is `{"),
        ("message! { struct A: A = 30 { a: u8 } }", "own.xml"),
        ("command! { struct A = RULE { a: u8 = 1 } }", "own.rs:1: command A: `RULE` is no constant of this file"),
        (
            "const RULE: CommandRule = CommandRule::any(7); command! { struct A = RULE { a: u8 = 1 } }",
            "own.rs:1: the rule RULE: write `CommandRule::without_position(…)`",
        ),
        (
            "const RULE: CommandRule = CommandRule::without_position(60_000, &[ParamRule::one_of(1, &[1, 5])]);
             command! { struct A = RULE { a: u8 = 1 } }",
            "own.rs:2: parameter a: its values have no names",
        ),
    ] {
        fs::write(&file, rust).expect("written");
        let error = export(&file).expect_err(rust).to_string();
        assert!(error.contains(says), "{error}");
    }
}
