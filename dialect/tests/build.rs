//! Generation in a firmware's build script: a module from a definition that includes the built-in common.

use mavstack_dialect::{Build, Options, generate, load};
use std::{fs, path::Path};
use tempfile::TempDir;

const WINCH: &str = r#"<mavlink>
<include>common.xml</include>
<enums>
<enum name="MAV_CMD">
<entry name="MAV_CMD_WINCH_STOP" value="31200"><param index="1" label="How" enum="MAV_BOOL"/></entry>
</enum>
<enum name="WINCH_STATE"><entry name="WINCH_STATE_OFF" value="0"/></enum>
</enums>
<messages>
<message id="53010" name="WINCH_REPORT">
<field type="uint8_t" name="state" enum="WINCH_STATE"/>
<field type="uint8_t" name="result" enum="MAV_RESULT"/>
</message>
</messages>
</mavlink>
"#;

fn directory(name: &str, text: &str) -> TempDir {
    let dir = tempfile::tempdir().expect("a directory");
    fs::write(dir.path().join(name), text).expect("written");
    dir
}

fn declared(text: &str) -> Vec<&str> {
    let types = text.lines().filter_map(|line| line.trim().strip_prefix("pub struct "));
    types.map(|line| line.split([':', ' ']).next().unwrap_or_default()).collect()
}

#[test]
fn beside_common_only_new_items_are_generated() {
    let dir = directory("my-winch.xml", WINCH);
    let input = dir.path().join("my-winch.xml");
    let inputs = Build::new(&input).beside_common().write_to(&dir.path().join("out")).expect("a module");
    assert_eq!(inputs, [input], "the inputs for Cargo: common is built in");

    let text = fs::read_to_string(dir.path().join("out/my-winch.rs")).expect("the module");
    assert!(text.contains("\npub mod my_winch {\n"), "{text}");
    assert_eq!(declared(&text), ["WinchState", "WinchStop", "WinchReport", "MyWinch"]);
    assert!(text.contains("pub const WINCH_STOP: MavCmd = MavCmd(31200);"), "{text}");
    assert!(text.contains("result: mavstack::dialect::MavResult,") && text.contains("state: WinchState,"), "{text}");
    assert!(text.contains("] + mavstack::dialect::Common;"), "{text}");
}

#[test]
fn without_beside_common_all_of_common_is_generated() {
    let dir = directory("winch.xml", WINCH);
    let input = dir.path().join("winch.xml");
    let dialect = load(&input, &[]).expect("a definition");
    assert!(dialect.message("HEARTBEAT").is_some() && dialect.message("WINCH_REPORT").is_some());
    let text = generate(&dialect, &Options::for_file(&input)).expect("declarations");
    assert!(declared(&text).contains(&"Heartbeat") && text.contains("WINCH_STOP = 31200"), "{}", text.len());
}

#[test]
fn a_file_beside_the_definition_replaces_the_built_in_one() {
    let dir = directory("winch.xml", "<mavlink><include>common.xml</include></mavlink>");
    let own = "<mavlink><messages><message id=\"1\" name=\"M\"><field type=\"float\" name=\"a\"/></message></messages></mavlink>";
    fs::write(dir.path().join("common.xml"), own).expect("written");
    let dialect = load(&dir.path().join("winch.xml"), &[]).expect("a definition");
    assert_eq!(dialect.messages.len(), 1);
    let inputs = Build::new(dir.path().join("winch.xml")).write_to(dir.path()).expect("a module");
    assert_eq!(inputs, [dir.path().join("common.xml"), dir.path().join("winch.xml")]);
}

#[test]
fn only_and_name() {
    let dir = directory("winch.xml", WINCH);
    let build =
        Build::new(dir.path().join("winch.xml")).beside_common().only(["WINCH_REPORT", "HEARTBEAT"]).name("Few");
    build.write_to(dir.path()).expect("a module");
    let text = fs::read_to_string(dir.path().join("winch.rs")).expect("the module");
    assert_eq!(declared(&text), ["WinchState", "WinchReport", "Few"], "HEARTBEAT is mavstack's");
    let error =
        Build::new(dir.path().join("winch.xml")).only(["WINCH"]).write_to(dir.path()).expect_err("no such name");
    assert!(error.to_string().contains("--only WINCH: there is no message"), "{error}");
}

#[test]
fn errors_have_file_and_line_and_keep_the_module() {
    let dir = directory("winch.xml", &WINCH.replace("\"uint8_t\" name=\"state\"", "\"byte\" name=\"state\""));
    fs::write(dir.path().join("winch.rs"), "as it was").expect("written");
    let error = Build::new(dir.path().join("winch.xml")).write_to(dir.path()).expect_err("no such type");
    let says = format!("{}:11: field WINCH_REPORT.state: unknown type `byte`", dir.path().join("winch.xml").display());
    assert!(error.to_string().starts_with(&says), "{error}");
    assert_eq!(fs::read_to_string(dir.path().join("winch.rs")).expect("the module"), "as it was");

    let error = Build::new(Path::new("nowhere.xml")).write_to(dir.path()).expect_err("no such file");
    assert!(error.to_string().starts_with("nowhere.xml: the file: cannot be read"), "{error}");
}
