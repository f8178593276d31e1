//! The typed commands: the names, types and parameters of their fields, commands without a type, and selections.

mod support;
#[path = "generated/tricky.rs"]
#[allow(dead_code, reason = "only the commands are tested here")]
mod tricky;

use mavstack::Item;
use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult};
use mavstack::message::{LatLon, Location, TypedCommand};
use mavstack_dialect::{Options, generate, load};
use support::path;
use tricky::{OptionEnum, Signed, commands};

const NAN: f32 = f32::NAN;

/// An item with seven parameters, in frame MISSION.
fn item([p1, p2, p3, p4, x, y, z]: [f32; 7], command: u16) -> Item {
    let (frame, command) = (MavFrame::MISSION, MavCmd(command));
    Item { frame, command, params: [p1, p2, p3, p4], x: x as i32, y: y as i32, z, ..Item::default() }
}

/// The text generated for the selection `only`.
fn text(input: &str, only: Option<&[&str]>) -> String {
    let input = path(input);
    let only = only.map(|names| names.iter().map(|name| (*name).to_owned()).collect());
    let options = Options { only, ..Options::for_file(&input) };
    generate(&load(&input, &[]).expect("a definition"), &options).expect("declarations")
}

/// The types of commands that a text declares.
fn types(text: &str) -> Vec<&str> {
    let declared = text.lines().filter_map(|line| line.strip_prefix("        pub struct "));
    declared.map(|line| line.split(' ').next().unwrap_or_default()).collect()
}

#[test]
fn labels_become_field_names() {
    let home = LatLon { latitude: 1, longitude: -1 };
    let location = Location { position: Some(home), altitude: None, frame: Some(MavFrame::GLOBAL) };
    let item = Item {
        frame: MavFrame::GLOBAL,
        command: MavCmd(5),
        params: [1.5, 2.0, NAN, 1.0],
        x: 1,
        y: -1,
        z: NAN,
        ..Item::default()
    };
    let command = commands::OptionCommand {
        r#match: Some(1.5),
        location_2: 2.0,
        match_3: None,
        _4th_id_use_yaw: Some(true),
        location,
    };
    assert_eq!(item.decode(), Ok(command));
    assert_eq!(commands::OptionCommand::RULE, tricky::rules::OPTION);
}

#[test]
fn field_types_follow_the_rules() {
    let all = item([-0.5, 2.0, NAN, -7.0, 1.0, 2.0, -3.0], 1).decode::<commands::All>();
    let expected =
        commands::All { least: -0.5, most: 2.0, both: None, whole: -7, whole_from: 1, whole_to: 2, whole_between: -3 };
    assert_eq!(all, Ok(expected));
    let steps = item([21_196.0, 0.5, 0.25, NAN, 0.0, 0.0, 255.0], 2).decode();
    let expected = commands::Steps {
        far_apart: 21_196,
        quantity: 0.5,
        fine: 0.25,
        camera_of_next_year: None,
        target_camera_id: Some(255),
    };
    assert_eq!(steps, Ok(expected));
    // An enumeration with a signed byte, and a bitmask of 64 bits.
    let enums = item([1.0, -1.0, 1.0, 0.5, 0.0, 0.0, 0.0], u16::MAX).decode();
    let expected = commands::Enums {
        in_a_row: OptionEnum::SOME,
        with_gaps: Signed::MINUS,
        bits: tricky::Bits::EMPTY_,
        of_none: Some(0.5),
    };
    assert_eq!(enums, Ok(expected));
    let bytes = |z| item([NAN, 0.0, 0.0, 0.0, 0.0, 1.0, z], 6).decode::<commands::_3d>().map(|command| command.byte);
    assert_eq!(
        (bytes(-128.0), bytes(NAN), bytes(128.0)),
        (Ok(Some(-128)), Ok(None), Err(MavMissionResult::INVALID_PARAM7))
    );
    let named = commands::_3d { self_: None, param2: Some(0.0), bool: true, byte: Some(127) };
    assert_eq!(item([NAN, 0.0, 0.0, 0.0, 0.0, 1.0, 127.0], 6).decode(), Ok(named));
}

#[test]
fn commands_without_fields_or_with_a_local_position_have_no_type() {
    let text = text("tests/generated/tricky.xml", None);
    assert_eq!(types(&text), ["All", "Steps", "Place", "Corner", "OptionCommand", "_3d", "Enums"]);
}

#[test]
fn selection_has_the_selected_commands_and_their_enums() {
    let few =
        text("definitions/common.xml", Some(&["HEARTBEAT", "MAV_CMD_DO_REPOSITION", "MAV_CMD_NAV_GUIDED_ENABLE"]));
    assert_eq!(types(&few), ["NavGuidedEnable", "DoReposition"]);
    for declared in ["pub struct MavCmd: u16 {", "pub struct MavDoRepositionFlags: u8 {", "pub const DO_REPOSITION: "] {
        assert!(few.contains(declared), "{declared}");
    }
    assert!(!few.contains("MavBool"), "a bool needs no type");
    // `Location` is imported only if a command has one.
    let one = text("definitions/common.xml", Some(&["MAV_CMD_NAV_GUIDED_ENABLE"]));
    assert!(!one.contains("use mavstack::message::Location;"));
    for none in [&["MAV_CMD"][..], &["MAV_CMD_NAV_RETURN_TO_LAUNCH"], &["MISSION_ITEM_INT"], &["HEARTBEAT"]] {
        assert!(!text("definitions/common.xml", Some(none)).contains("pub mod commands"), "{none:?}");
    }
}
