//! Errors in a definition are reported with file, line and element, and the output is not changed.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};
use tempfile::TempDir;

/// A definition with these messages; the first is on line 3.
fn messages(text: &str) -> String {
    format!("<mavlink>\n<messages>\n{text}\n</messages>\n</mavlink>\n")
}

/// A definition with these enumerations; the first is on line 3.
fn enums(text: &str) -> String {
    format!("<mavlink>\n<enums>\n{text}\n</enums>\n</mavlink>\n")
}

/// A definition of a message with these fields.
fn fields(text: &str) -> String {
    messages(&format!("<message id=\"1\" name=\"M\">\n{text}\n</message>"))
}

fn directory(files: &[(&str, &str)]) -> TempDir {
    let dir = tempfile::tempdir().expect("a directory");
    for (name, text) in files {
        fs::write(dir.path().join(name), text).expect("written");
    }
    dir
}

fn run(dir: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mavstack-dialect"))
        .current_dir(dir)
        .args(arguments)
        .output()
        .expect("the tool runs")
}

/// Runs the tool with `files`, the first as input. Asserts that it fails with a line that begins with `place` and
/// contains `says`.
fn refuses(files: &[(&str, &str)], place: &str, says: &str) {
    let dir = directory(files);
    fs::write(dir.path().join("out.rs"), "as it was").expect("written");
    let output = run(dir.path(), &[files[0].0, "out.rs"]);
    let message = String::from_utf8(output.stderr).expect("text");
    assert_eq!(output.status.code(), Some(1), "{place}: {message}");
    assert!(message.starts_with(place) && message.contains(says), "expected `{place} …{says}…`, was `{message}`");
    assert_eq!(message.lines().count(), 1, "{message}");
    assert_eq!(fs::read_to_string(dir.path().join("out.rs")).expect("the output"), "as it was");
    assert_eq!(fs::read_dir(dir.path()).expect("a directory").count(), files.len() + 1, "no other file is left");
}

fn refuses_file(text: &str, place: &str, says: &str) {
    refuses(&[("bad.xml", text)], &format!("bad.xml:{place}: "), says);
}

const FIELD: &str = "<field type=\"uint8_t\" name=\"a\"/>";

#[test]
fn bad_fields() {
    for (text, line, element, says) in [
        ("<field type=\"uint7_t\" name=\"a\"/>", 4, "field M.a", "unknown type `uint7_t`; use one of uint8_t, "),
        ("<field type=\"uint8_t[0]\" name=\"a\"/>", 4, "field M.a", "from 1 to 255"),
        ("<field type=\"uint8_t[256]\" name=\"a\"/>", 4, "field M.a", "from 1 to 255"),
        ("<field type=\"uint8_t[4\" name=\"a\"/>", 4, "field M.a", "from 1 to 255"),
        ("<field name=\"a\"/>", 4, "field M.a", "`type` is missing"),
        ("<field type=\"uint8_t\"/>", 4, "field of M", "`name` is missing"),
        ("<field type=\"uint8_t\" name=\"a b\"/>", 4, "field of M", "`a b` is not a name"),
        ("<field type=\"uint8_t\" name=\"1a\"/>", 4, "field of M", "`1a` is not a name"),
        ("<field type=\"uint8_t\" name=\"größe\"/>", 4, "field of M", "`größe` is not a name"),
        ("<field type=\"uint8_t\" name=\"self\"/>", 4, "field M.self", "use another"),
        ("<field type=\"uint8_t\" name=\"a\" enum=\"E\"/>", 4, "field M.a", "there is no enum E"),
        ("<field type=\"uint8_t\" name=\"a\" minValue=\"low\"/>", 4, "field M.a", "minValue: `low`"),
        ("<field type=\"uint8_t\" name=\"a\" instance=\"maybe\"/>", 4, "field M.a", "`true` or `false`"),
        (
            "<field type=\"uint8_t\" name=\"a\" invalid=\"none\"/>",
            4,
            "field M.a",
            "invalid: `none` is not a value; use",
        ),
        ("<field type=\"uint8_t\" name=\"a\" invalid=\"NaN\"/>", 4, "field M.a", "invalid: `NaN` is not a value"),
        (
            "<field type=\"uint8_t\" name=\"a\" invalid=\"UINT16_MAX\"/>",
            4,
            "field M.a",
            "65535 does not fit in uint8_t",
        ),
        ("<field type=\"uint8_t\" name=\"a\" invalid=\"-1\"/>", 4, "field M.a", "use a value from 0 to 255"),
        ("<field type=\"float\" name=\"a\" invalid=\"1e99\"/>", 4, "field M.a", "invalid: `1e99`"),
        (
            "<field type=\"uint8_t[2]\" name=\"a\" invalid=\"[1,2,3]\"/>",
            4,
            "field M.a",
            "than the array has elements, 2",
        ),
        (
            "<field type=\"uint8_t\" name=\"a\" unit=\"m\"/>",
            4,
            "field M.a",
            "no such attribute: unit; use one of type, ",
        ),
        (&format!("{FIELD}\n{FIELD}"), 5, "field M.a", "taken by the field in line 4"),
        (&format!("{FIELD}\n<extensions/>\n{FIELD}"), 6, "field M.a", "taken by the field in line 4"),
        (&format!("{FIELD}\n<extensions/>\n<extensions/>"), 6, "message M", "twice"),
        (&format!("<extensions/>\n{FIELD}"), 3, "message M", "at least one"),
        ("", 3, "message M", "at least one"),
        ("<feild type=\"uint8_t\" name=\"a\"/>", 4, "feild", "<field>"),
        ("<field type=\"uint64_t[31]\" name=\"a\"/><field type=\"uint64_t\" name=\"b\"/>", 3, "message M", "256 bytes"),
        (&format!("{FIELD}<extensions/><field type=\"char[255]\" name=\"b\"/>"), 3, "message M", "256 bytes"),
    ] {
        refuses_file(&fields(text), &format!("{line}: {element}"), says);
    }
}

#[test]
fn more_than_64_fields() {
    let many = |count| (0..count).map(|n| format!("<field type=\"uint8_t\" name=\"f{n}\"/>")).collect::<String>();
    refuses_file(&fields(&many(65)), "3: message M", "65 fields");
    let dir = directory(&[("good.xml", &fields(&many(64)))]);
    assert!(run(dir.path(), &["good.xml", "out.rs"]).status.success());
}

#[test]
fn bad_messages() {
    let message = |attributes: &str| format!("<message {attributes}>{FIELD}</message>");
    let pair = |a: &str, b: &str| format!("{}\n{}", message(a), message(b));
    for (text, line, element, says) in [
        (message("name=\"M\""), 3, "message M", "`id` is missing"),
        (message("id=\"1\""), 3, "message", "`name` is missing"),
        (message("id=\"x\" name=\"M\""), 3, "message M", "id: `x`"),
        (message("id=\"-1\" name=\"M\""), 3, "message M", "id: `-1`"),
        (message("id=\"16777216\" name=\"M\""), 3, "message M", "24 bits"),
        (message("id=\"99999999999\" name=\"M\""), 3, "message M", "id: `99999999999`"),
        (message("id=\"1\" name=\"M-1\""), 3, "message", "`M-1` is not a name"),
        (message("id=\"1\" name=\"\""), 3, "message", "`` is not a name"),
        (message("id=\"1\" name=\"M\" wip=\"true\""), 3, "message M", "no such attribute: wip"),
        (pair("id=\"1\" name=\"M\"", "id=\"1\" name=\"N\""), 4, "message N", "id 1 is taken by M at bad.xml:3"),
        (pair("id=\"1\" name=\"M\"", "id=\"2\" name=\"M\""), 4, "message M", "name is taken by M at bad.xml:3"),
        ("<enum name=\"E\"/>".into(), 3, "enum", "<message>"),
    ] {
        refuses_file(&messages(&text), &format!("{line}: {element}"), says);
    }
}

#[test]
fn bad_enums() {
    let entry = |attributes: &str| format!("<enum name=\"E\">\n<entry {attributes}/>\n</enum>");
    let pair = |a: &str, b: &str| format!("<enum name=\"E\">\n<entry {a}/>\n<entry {b}/>\n</enum>");
    let param = |attributes: &str| {
        format!("<enum name=\"E\"><entry name=\"A\" value=\"1\">\n<param {attributes}/></entry></enum>")
    };
    for (text, line, element, says) in [
        ("<enum/>".into(), 3, "enum", "`name` is missing"),
        ("<enum name=\"E\" bitmask=\"no\"/>".into(), 3, "enum E", "bitmask: `no`"),
        (entry("value=\"1\""), 4, "entry of E", "`name` is missing"),
        (entry("name=\"A\" value=\"one\""), 4, "entry E.A", "`one` is not a number"),
        (entry("name=\"A\" value=\"\""), 4, "entry E.A", "`` is not a number"),
        (entry("name=\"A\" value=\"1.5\""), 4, "entry E.A", "`1.5` is not a number"),
        (entry("name=\"A\" value=\"2**64\""), 4, "entry E.A", "64 bits"),
        (entry("name=\"A\" value=\"2**999\""), 4, "entry E.A", "`2**999` is not a number"),
        (entry("name=\"A B\" value=\"1\""), 4, "entry of E", "`A B` is not a name"),
        (entry("name=\"A\" value=\"1\" hasLocation=\"x\""), 4, "entry E.A", "hasLocation"),
        (entry("name=\"A\" value=\"1\" haslocation=\"true\""), 4, "entry E.A", "no such attribute: haslocation"),
        (param("index=\"1\" minvalue=\"0\""), 4, "param of entry E.A", "no such attribute: minvalue"),
        ("<enum name=\"E\" bitmap=\"true\"/>".into(), 3, "enum E", "no such attribute: bitmap"),
        (
            pair("name=\"A\" value=\"1\"", "name=\"B\" value=\"1\""),
            5,
            "entry E.B",
            "value 1 is taken by A at bad.xml:4",
        ),
        (pair("name=\"A\" value=\"1\"", "name=\"A\" value=\"2\""), 5, "entry E.A", "name is taken by A at bad.xml:4"),
        (param("label=\"x\""), 4, "param of entry E.A", "`index` is missing"),
        (param("index=\"8\""), 4, "param of entry E.A", "params 1 to 7"),
        (param("index=\"1\" maxValue=\"x\""), 4, "param of entry E.A", "maxValue: `x`"),
        (param("index=\"1\"/><param index=\"1\""), 4, "entry E.A", "param 1 is defined twice"),
        ("<enum name=\"E\"><deprecated since=\"2020-01\"/></enum>".into(), 3, "enum E", "`replaced_by` is missing"),
    ] {
        refuses_file(&enums(&text), &format!("{line}: {element}"), says);
    }
}

#[test]
fn not_a_definition() {
    refuses_file("<mavlink>\n<messages>\n</mavlink>\n", "3: XML", "expected 'messages' tag");
    refuses_file("", "1: XML", "well-formed");
    refuses_file("<!DOCTYPE x [<!ENTITY a \"b\">]>\n<mavlink/>", "1: XML", "DTD");
    refuses_file("\n<html/>", "2: html", "<mavlink>");
    refuses_file("<mavlink>\n<message/></mavlink>", "2: message", "<messages>");
    refuses_file("<mavlink>\n<version>high</version></mavlink>", "2: version", "from 0 to 255");
}

#[test]
fn clashes_between_several_files() {
    let common = enums("<enum name=\"E\"><entry name=\"A\" value=\"1\"/></enum>");
    let clash = "<mavlink><include>common.xml</include>\n<enums><enum name=\"E\">\n<entry name=\"B\" value=\"1\"/></enum></enums></mavlink>";
    refuses(&[("own.xml", clash), ("common.xml", &common)], "own.xml:3: entry E.B: ", "by A at common.xml:3");

    let common = fields(FIELD);
    let clash = format!(
        "<mavlink><include>common.xml</include>\n<messages>\n<message id=\"1\" name=\"N\">{FIELD}</message></messages></mavlink>"
    );
    refuses(&[("own.xml", &clash), ("common.xml", &common)], "own.xml:3: message N: ", "by M at common.xml:3");
    let included = "<mavlink>\n<include>bad.xml</include></mavlink>";
    refuses(&[("own.xml", included), ("bad.xml", &fields(""))], "bad.xml:3: message M: ", "at least one");
}

#[test]
fn missing_and_circular_includes() {
    let include = |name: &str| format!("<mavlink>\n<include>{name}</include>\n</mavlink>");
    refuses(&[("a.xml", &include("b.xml"))], "a.xml:2: include b.xml: ", "--include-dir");
    refuses(&[("a.xml", &include("a.xml"))], "a.xml:2: include a.xml: ", "a.xml → a.xml");
    refuses(
        &[("a.xml", &include("b.xml")), ("b.xml", &include("c.xml")), ("c.xml", &include("b.xml"))],
        "c.xml:2: include b.xml: ",
        "b.xml → c.xml → b.xml",
    );
}

#[test]
fn a_file_that_is_included_twice_is_read_once() {
    let top = "<mavlink><include>left.xml</include><include>right.xml</include><messages/></mavlink>";
    let side = "<mavlink><include>base.xml</include></mavlink>";
    let dir = directory(&[("top.xml", top), ("left.xml", side), ("right.xml", side), ("base.xml", &fields(FIELD))]);
    let output = run(dir.path(), &["top.xml", "out.rs"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = fs::read_to_string(dir.path().join("out.rs")).expect("the output");
    assert_eq!(text.matches("pub struct M: M = 1,").count(), 1, "{text}");
    assert!(text.contains("pub struct Top: ["), "{text}");
}

#[test]
fn files_that_cannot_be_read_or_written() {
    let dir = directory(&[("good.xml", &fields(FIELD))]);
    for (arguments, says) in [
        (["none.xml", "out.rs"], "none.xml: the file: cannot be read"),
        (["good.xml", "no/such/directory/out.rs"], "no/such/directory/out.rs: the output: cannot be written"),
    ] {
        let output = run(dir.path(), &arguments);
        let message = String::from_utf8(output.stderr).expect("text");
        assert_eq!(output.status.code(), Some(1));
        assert!(message.starts_with(says), "{message}");
    }
    fs::write(dir.path().join("latin.xml"), b"<mavlink>\xE4</mavlink>").expect("written");
    let message = String::from_utf8(run(dir.path(), &["latin.xml", "out.rs"]).stderr).expect("text");
    assert!(message.starts_with("latin.xml: the file: ") && message.contains("UTF-8"), "{message}");
}

#[test]
fn unknown_names_and_stale_outputs() {
    let dir = directory(&[("good.xml", &fields(FIELD))]);
    let fails = |arguments: &[&str], says: &str| {
        let output = run(dir.path(), arguments);
        let message = String::from_utf8(output.stderr).expect("text");
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains(says), "{message}");
    };
    fails(&["--only", "M,N", "good.xml", "out.rs"], "good.xml: --only N: there is no message");
    fails(&["--name", "lower", "good.xml", "out.rs"], "good.xml: --name lower: ");
    fails(&["--check", "good.xml", "out.rs"], "out.rs: the file: is not up to date with the definition");
    assert!(!dir.path().join("out.rs").exists());
    assert!(run(dir.path(), &["good.xml", "out.rs"]).status.success());
    assert!(run(dir.path(), &["--check", "good.xml", "out.rs"]).status.success());
    fs::write(dir.path().join("out.rs"), "stale").expect("written");
    fails(&["--check", "good.xml", "out.rs"], "out.rs: the file: ");
    assert_eq!(fs::read_to_string(dir.path().join("out.rs")).expect("the output"), "stale");
}

/// With --beside-common, definitions that contradict common are refused.
#[test]
fn contradictions_to_common() {
    let heartbeat = |name: &str, field: &str| {
        messages(&format!("<message id=\"0\" name=\"{name}\">\n<field type=\"uint32_t\" name=\"{field}\"/></message>"))
    };
    let entry = |name: &str, value: u32| {
        enums(&format!("<enum name=\"MAV_STATE\">\n<entry name=\"MAV_STATE_{name}\" value=\"{value}\"/></enum>"))
    };
    for (text, place, says) in [
        (heartbeat("HEARTBEAT", "custom_mode"), "bad.xml:3: message HEARTBEAT: ", "another HEARTBEAT with id 0"),
        (heartbeat("PULSE", "custom_mode"), "bad.xml:3: message PULSE: ", "another HEARTBEAT with id 0"),
        (entry("ACTIVE", 77), "bad.xml:4: entry MAV_STATE.MAV_STATE_ACTIVE: ", "MAV_STATE_ACTIVE = 4"),
        (entry("TIRED", 4), "bad.xml:4: entry MAV_STATE.MAV_STATE_TIRED: ", "MAV_STATE_ACTIVE = 4"),
    ] {
        let dir = directory(&[("bad.xml", &text)]);
        let output = run(dir.path(), &["--beside-common", "bad.xml", "out.rs"]);
        let message = String::from_utf8(output.stderr).expect("text");
        assert_eq!(output.status.code(), Some(1), "{place}: {message}");
        assert!(message.starts_with(place) && message.contains(says), "expected `{place} …{says}…`, was `{message}`");
        assert!(!dir.path().join("out.rs").exists());
    }
}
