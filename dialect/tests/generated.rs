//! The generated text: it compiles, agrees with the model on the wire, is formatted by rustfmt, and is up to date where
//! it is checked in.

mod support;
#[path = "generated/tricky.rs"]
mod tricky;

use mavstack::message::{Char, Dialect, Field};
use mavstack::{Message, Text};
use mavstack_dialect::{Options, generate, load};
use std::{
    io::Write,
    path::Path,
    process::{Command, Stdio},
};
use support::{path, xml_files};
use tricky::{
    Bits, EmptyOne, Invalids, Lonely, NameTaken, NameTakenEnum, OddNames, OptionEnum, OptionMessage, Signed,
    SomeMessage, Tricky,
};

/// Asserts that a checked-in file is up to date.
fn assert_current(input: &Path, crate_path: &str, output: &Path, how: &str) {
    let options = Options { crate_path: crate_path.into(), ..Options::for_file(input) };
    let text = generate(&load(input, &[]).expect("a definition"), &options).expect("declarations");
    let old = std::fs::read_to_string(output).expect("the checked-in file");
    assert!(old == text, "{} is not up to date; {how}", output.display());
}

#[test]
fn the_checked_in_dialect_is_current() {
    assert_current(&path("definitions/common.xml"), "crate", &path("../src/dialect/common.rs"), "run `cargo dialect`");
}

#[test]
fn edge_cases_compile_and_are_current() {
    let how =
        "run `cargo run -p mavstack-dialect -- dialect/tests/generated/tricky.xml dialect/tests/generated/tricky.rs`";
    assert_current(&path("tests/generated/tricky.xml"), "mavstack", &path("tests/generated/tricky.rs"), how);
}

/// SEC-15: keys and passwords have a type that is not logged and does not change the wire format.
#[test]
fn keys_and_passwords_are_secrets() {
    let input = path("definitions/common.xml");
    let dialect = load(&input, &[]).expect("a definition");
    let text = |only: Option<&str>| {
        let options = Options { only: only.map(|name| vec![name.to_owned()]), ..Options::for_file(&input) };
        generate(&dialect, &options).expect("declarations")
    };
    let all = text(None);
    let secrets: Vec<_> = all.lines().filter(|line| line.contains("Secret<")).map(str::trim).collect();
    let expected = [
        "passkey: Secret<Text<25>>,",
        "key: Secret<Text<32>>,",
        "secret_key: Secret<[u8; 32]>,",
        "password: Secret<Text<64>>,",
        "pin: Secret<Text<16>>,",
        "new_pin: Secret<Text<16>>,",
        "puk: Secret<Text<16>>,",
    ];
    assert_eq!(secrets, expected);
    assert!(text(Some("SETUP_SIGNING")).contains("use mavstack::message::Secret;\n"));
    assert!(!text(Some("STATUSTEXT")).contains("Secret"));
}

/// The macros and the generator compute the wire format independently.
#[test]
fn the_macros_agree_with_the_model() {
    let dialect = load(&path("tests/generated/tricky.xml"), &[]).expect("a definition");
    assert_eq!(Tricky::MESSAGES.rows().len(), dialect.messages.len());
    for (row, message) in Tricky::MESSAGES.rows().iter().zip(&dialect.messages) {
        let offset = |offset: Option<u8>| offset.map(usize::from);
        assert_eq!(row.id(), message.id);
        assert_eq!(row.crc_extra(), message.crc_extra(), "{}", message.name);
        assert_eq!(usize::from(row.base_len()), message.base_len(), "{}", message.name);
        assert_eq!(usize::from(row.max_len()), message.max_len(), "{}", message.name);
        assert_eq!(offset(row.target_system()), message.offset("target_system"), "{}", message.name);
        assert_eq!(offset(row.target_component()), message.offset("target_component"), "{}", message.name);
    }
}

#[test]
fn names_and_types_are_as_documented() {
    let message =
        NameTaken { r#type: NameTakenEnum::ONE, r#match: Char(b'x'), r#fn: Text::new("y"), ..Default::default() };
    let mut payload = [0; NameTaken::MAX_LEN];
    assert_eq!(message.encode(&mut payload), Some(12));
    assert_eq!(payload[..4], [1, b'x', b'y', 0]);
    assert_eq!(NameTaken::NAME, "NAME_TAKEN");

    // An enumeration has the integer type of most of its fields; the other fields are integers.
    let OptionMessage { camelCase, signed, signed_again, signed_wide } = OptionMessage::default();
    let _: (OptionEnum, [Signed; 3], Signed, i32) = (camelCase, signed, signed_again, signed_wide);
    assert_eq!((Signed::MINUS.0, Signed::_3D.0, Signed::_3D_.0), (-1_i8, 3, 16));
    let SomeMessage { bits, narrow, rest } = SomeMessage::default();
    let _: (Bits, u8, [f32; 61]) = (bits, narrow, rest);
    assert_eq!((Bits::EMPTY.0, Bits::EMPTY_.0, Bits::TOP.0), (0, 1, 1 << 63));
    assert_eq!((OddNames::X.0, OddNames::Y.0), (7_u16, 8));
    assert_eq!(Lonely::SOMETHING_ELSE.0, 300_u16);
    assert_eq!(EmptyOne::SIZE, 1);
    assert_eq!((tricky::Array1_2::ID, tricky::Array12::ID), (902, 903));
}

/// `UNKNOWN` has the values of the attribute `invalid`, in all of its notations.
#[test]
fn unknown_has_the_invalid_values_in_all_notations() {
    let Invalids { all, first, each, zeros, limit, nan, number, entry, entries, signed_wide, letter, word, none, most } =
        Invalids::UNKNOWN;
    assert_eq!((all, first), ([u16::MAX; 4], [i16::MIN, 0, 0, 0]));
    assert_eq!((each, zeros, limit), ([1, 0, 3, 0], [0, 0], 65_535.0));
    assert!(nan.is_nan());
    assert_eq!((number, entry, entries), ([-1.5; 2], OptionEnum::SOME, [OptionEnum(255); 2]));
    assert_eq!((signed_wide, letter, most), (-1, Char(0x7F), u64::MAX));
    assert_eq!((word, none), (Text::from_wire([63, 0, 0]), Text::EMPTY));
    // Without the attribute, it equals the default.
    assert_eq!(SomeMessage::UNKNOWN, SomeMessage::default());
}

#[test]
fn selection_has_the_selected_messages_and_their_enums() {
    let input = path("definitions/common.xml");
    let only = ["HEARTBEAT", "SYSTEM_TIME", "MAV_GOTO"].map(str::to_owned).to_vec();
    let options = Options { only: Some(only), name: "Few".into(), ..Options::for_file(&input) };
    let text = generate(&load(&input, &[]).expect("a definition"), &options).expect("declarations");
    let declared: Vec<_> = text.lines().filter_map(|line| line.trim().strip_prefix("pub struct ")).collect();
    assert_eq!(
        declared,
        [
            "MavAutopilot: u8 {",
            "MavGoto: u8 {",
            "MavModeFlag: u8 {",
            "MavState: u8 {",
            "MavType: u8 {",
            "Heartbeat: HEARTBEAT = 0, crc_extra = 50 {",
            "SystemTime: SYSTEM_TIME = 2, crc_extra = 137 {",
            "Few: [",
        ]
    );
}

#[test]
fn the_text_is_formatted_by_rustfmt() {
    let config = path("../rustfmt.toml");
    if Command::new("rustfmt").arg("--version").output().is_err() {
        assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "CI has no rustfmt");
        support::say("SKIPPED: rustfmt is not installed, so the formatting is not checked");
        return;
    }
    let directories = [path("definitions"), path("tests/definitions"), path("tests/generated")];
    for file in xml_files(&directories) {
        let dialect = load(&file, &directories).expect("a definition");
        let text = generate(&dialect, &Options::for_file(&file)).expect("declarations");
        let mut rustfmt = Command::new("rustfmt")
            .args(["--check", "--edition", "2024", "--config-path"])
            .arg(&config)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("rustfmt runs");
        rustfmt.stdin.take().expect("its input").write_all(text.as_bytes()).expect("written");
        let output = rustfmt.wait_with_output().expect("rustfmt ends");
        assert!(output.status.success(), "{}: {}", file.display(), String::from_utf8_lossy(&output.stdout));
    }
}
