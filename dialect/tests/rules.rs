//! The rules for commands: all rules of common agree with an independent interpretation of the attributes; some are
//! compared as text.

mod support;
#[path = "generated/tricky.rs"]
#[allow(dead_code, reason = "only the rules are tested here")]
mod tricky;

use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult, rules};
use mavstack::{CommandRule, Item};
use mavstack_dialect::{
    Dialect, Options, generate, load,
    model::{Entry, Enum, Param},
};
use std::ops::Range;
use support::path;

/// The frames that plans support: the global ones, then MISSION.
const FRAMES: [u8; 7] = [0, 3, 5, 6, 10, 11, 2];

/// The stack's integers have 32 bits.
const I32: Range<f32> = -2_147_483_648.0..2_147_483_648.0;

const INVALID_PARAM: [MavMissionResult; 7] = [
    MavMissionResult::INVALID_PARAM1,
    MavMissionResult::INVALID_PARAM2,
    MavMissionResult::INVALID_PARAM3,
    MavMissionResult::INVALID_PARAM4,
    MavMissionResult::INVALID_PARAM5_X,
    MavMissionResult::INVALID_PARAM6_Y,
    MavMissionResult::INVALID_PARAM7,
];

/// Parameters that may be NaN although they have a range or an enumeration, because MAVLink's prose says so, or because
/// MAVSDK sends it.
fn prose_allows_nan(command: &str, param: &Param) -> bool {
    match command {
        "NAV_TAKEOFF" => param.index == 3,
        "DO_ORBIT" => matches!(param.index, 3 | 4),
        "DO_SET_HOME" => matches!(param.index, 2..=4),
        "NAV_LAND" => param.index == 2,
        "DO_SET_ACTUATOR" => param.index <= 4,
        "DO_GIMBAL_MANAGER_PITCHYAW" => param.index <= 2,
        "ACTUATOR_TEST" | "DO_REPOSITION" => param.index == 1,
        "COMPONENT_ARM_DISARM" => param.index == 2,
        "PREFLIGHT_CALIBRATION" => param.index >= 6,
        "PREFLIGHT_REBOOT_SHUTDOWN" => matches!(param.index, 2..=4 | 6),
        "IMAGE_START_CAPTURE" => param.index == 4 || param.label == "Target Camera ID",
        "VIDEO_START_CAPTURE" => param.index == 2 || param.label == "Target Camera ID",
        _ => param.label == "Target Camera ID",
    }
}

fn position_is_optional(command: &str) -> bool {
    let loiter = command.starts_with("NAV_LOITER_");
    let nav = ["NAV_LAND", "NAV_TAKEOFF", "NAV_VTOL_TAKEOFF", "NAV_VTOL_LAND", "NAV_ROI"];
    let other = ["DO_ORBIT", "DO_FIGURE_EIGHT", "DO_LAND_START", "DO_REPOSITION", "DO_SET_HOME", "DO_SET_ROI"];
    loiter || nav.contains(&command) || other.contains(&command)
}

fn altitude_is_optional(command: &str) -> bool {
    ["DO_ORBIT", "DO_FIGURE_EIGHT", "DO_REPOSITION", "DO_SET_HOME", "EXTERNAL_POSITION_ESTIMATE"].contains(&command)
}

/// Returns whether the attributes allow `value` for `param`.
fn allows(dialect: &Dialect, command: &str, param: &Param, value: f32) -> bool {
    if value.is_infinite() {
        return false;
    }
    let is_used = !param.reserved && !param.label.is_empty();
    let values = dialect.enumeration(&param.enumeration);
    let is_counted = param.units.is_empty() && param.increment.is_some_and(|step| step % 1.0 == 0.0);
    let is_bound = values.is_some() || param.minimum.is_some() || param.maximum.is_some() || is_counted;
    if !is_used || !is_bound {
        return true;
    }
    if value.is_nan() {
        return param.default.is_some_and(f64::is_nan) || prose_allows_nan(command, param);
    }
    if let Some(values) = values {
        return is_listed(values, value);
    }
    let minimum = match (command, param.index) {
        ("DO_JUMP", 2) => Some(-1.0),
        ("IMAGE_START_CAPTURE", 4) => Some(0.0),
        _ => param.minimum,
    };
    if is_counted {
        let step = param.increment.unwrap_or(1.0);
        let is_far = step > 1.0;
        let above = f64::from(value) - minimum.unwrap_or(0.0);
        if value.fract() != 0.0 || !I32.contains(&value) || (is_far && above % step != 0.0) {
            return false;
        }
    }
    minimum.is_none_or(|minimum| value >= minimum as f32) && param.maximum.is_none_or(|maximum| value <= maximum as f32)
}

fn is_listed(values: &Enum, value: f32) -> bool {
    if values.bitmask {
        let all = values.entries.iter().fold(0, |all, entry| all | entry.value);
        return value.fract() == 0.0 && value >= 0.0 && I32.contains(&value) && (value as i128) & !all == 0;
    }
    values.entries.iter().any(|entry| entry.value as f64 == f64::from(value))
}

/// Values on both sides of all limits.
fn candidates(dialect: &Dialect, param: &Param) -> Vec<f32> {
    let mut values = vec![0.0, -0.0, 0.5, 1.0, -1.0, 2.0, -2.0, 3.0, 1e30, -1e30, 2_147_483_648.0, 16_777_216.0];
    values.extend([f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, f32::MIN_POSITIVE]);
    let limits = [param.minimum, param.maximum].into_iter().flatten().map(|limit| limit as f32);
    let entries = dialect.enumeration(&param.enumeration).map_or(&[][..], |values| &values.entries[..]);
    let listed = entries.iter().map(|entry| entry.value as f32);
    for limit in limits.chain(listed).collect::<Vec<_>>() {
        values.extend([limit, limit - 1.0, limit + 1.0, limit + 0.5, limit.next_up(), limit.next_down()]);
    }
    values
}

/// An item with seven parameters, as in frame MISSION; 5 and 6 must be integers or NaN.
fn item(command: u16, frame: u8, params: [f32; 7]) -> Item {
    let [p1, p2, p3, p4, x, y, z] = params;
    let integer = |value: f32| if value.is_nan() { i32::MAX } else { value as i32 };
    let (command, frame) = (MavCmd(command), MavFrame(frame));
    Item { frame, command, autocontinue: 1, params: [p1, p2, p3, p4], x: integer(x), y: integer(y), z }
}

fn rule_of(entry: &Entry) -> Option<&'static CommandRule> {
    rules::ALL.iter().find(|rule| i128::from(rule.command().0) == entry.value)
}

fn common() -> Dialect {
    load(&path("definitions/common.xml"), &[]).expect("a definition")
}

/// M-74, C-9
#[test]
fn all_rules_agree_with_the_attributes() {
    let dialect = common();
    let commands = dialect.enumeration("MAV_CMD").expect("commands");
    assert_eq!(rules::ALL.len(), commands.entries.len());
    let (mut passed, mut refused) = (0, 0);
    for entry in &commands.entries {
        let rule = rule_of(entry).unwrap_or_else(|| panic!("{} has no rule", entry.name));
        let name = entry.name.trim_start_matches("MAV_CMD_");
        let is_located = entry.has_location == Some(true);
        let unused = |index| Param { index, ..Param::default() };
        let params: Vec<_> = (1..=7)
            .map(|index| entry.params.iter().find(|param| param.index == index).cloned().unwrap_or(unused(index)))
            .collect();
        // With a position, parameters 5 and 6 are 1 here, because a waypoint at 0, 0 is refused (M-48). Parameter 7
        // must be a number if it is used.
        let allowed = |param: &Param, value: f32| match param.index {
            7 if is_located && value.is_nan() => param.label.is_empty() || altitude_is_optional(name),
            7 if is_located && value.abs() > 1e6 => false,
            _ => allows(&dialect, name, param, value),
        };
        let is_position = |param: &Param| is_located && matches!(param.index, 5 | 6);
        let sample = |param: &Param| {
            if is_position(param) { vec![1.0] } else { candidates(&dialect, param) }
        };
        let good: Vec<_> = params
            .iter()
            .map(|param| sample(param).into_iter().find(|value| allowed(param, *value)).expect("some value is good"))
            .collect();
        let good: [f32; 7] = good.try_into().expect("seven");
        let frame = if is_located { 6 } else { 2 };
        for (at, param) in params.iter().enumerate() {
            for value in sample(param) {
                let is_integer = value.is_nan() || (value.fract() == 0.0 && value.abs() < 2e9);
                if matches!(param.index, 5 | 6) && !is_integer {
                    continue;
                }
                let mut values = good;
                values[at] = value;
                let expected = if allowed(param, value) { Ok(()) } else { Err(INVALID_PARAM[at]) };
                let verdict = rule.check(&item(rule.command().0, frame, values));
                assert_eq!(verdict, expected, "{name}: {value} in {param:?}");
                if expected.is_ok() { passed += 1 } else { refused += 1 }
            }
        }
    }
    assert!(passed > 10_000 && refused > 5_000, "{passed} passed, {refused} refused");
}

/// M-4, M-70
#[test]
fn all_rules_check_frames_and_positions() {
    let dialect = common();
    for entry in &dialect.enumeration("MAV_CMD").expect("commands").entries {
        let rule = rule_of(entry).expect("a rule").with_params(&[]);
        let name = entry.name.trim_start_matches("MAV_CMD_");
        let is_located = entry.has_location == Some(true);
        for frame in 0..=u8::MAX {
            let verdict = rule.check(&item(rule.command().0, frame, [0.0; 7]));
            let is_taken = FRAMES.contains(&frame) && !(is_located && frame == 2 && name != "DO_LAND_START");
            assert_eq!(verdict == Err(MavMissionResult::UNSUPPORTED_FRAME), !is_taken, "{name} in frame {frame}");
        }
        if !is_located {
            continue;
        }
        let here = if position_is_optional(name) { Ok(()) } else { Err(MavMissionResult::INVALID_PARAM5_X) };
        let place = |x, y| {
            let good = good_params(&dialect, name, entry);
            rule.check(&Item { x, y, ..item(rule.command().0, 0, good) })
        };
        assert_eq!(place(i32::MAX, i32::MAX), here, "{name}");
        assert_eq!(place(900_000_000, -1_800_000_000), Ok(()), "{name}");
        assert_eq!(place(900_000_001, 0), Err(MavMissionResult::INVALID_PARAM5_X), "{name}");
        assert_eq!(place(0, -1_800_000_001), Err(MavMissionResult::INVALID_PARAM6_Y), "{name}");
        // Only one of latitude and longitude.
        assert_eq!(place(i32::MAX, 0), Err(MavMissionResult::INVALID_PARAM5_X), "{name}");
        assert_eq!(place(0, i32::MAX), Err(MavMissionResult::INVALID_PARAM6_Y), "{name}");
    }
}

fn good_params(dialect: &Dialect, name: &str, entry: &Entry) -> [f32; 7] {
    let mut good = [0.0; 7];
    for param in entry.params.iter().filter(|param| param.index <= 4) {
        let mut values = candidates(dialect, param).into_iter();
        let value = values.find(|value| allows(dialect, name, param, *value)).expect("some value is good");
        good[usize::from(param.index) - 1] = value;
    }
    good
}

/// The text of a dialect's rules for one command.
fn lines(text: &str, command: &str) -> String {
    let start = format!("    pub const {command}: CommandRule = ");
    let rest = text.split_once(&start).unwrap_or_else(|| panic!("{command} has no rule")).1;
    let rule = rest.split_once(";\n").expect("an end").0;
    rule.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn rules_are_written_as_constants() {
    let input = path("definitions/common.xml");
    let text = generate(&common(), &Options::for_file(&input)).expect("declarations");
    for (command, rule) in [
        (
            "NAV_WAYPOINT",
            "CommandRule::at_position(16, &[ ParamRule::at_least(1, 0.0), ParamRule::at_least(2, 0.0), ])",
        ),
        ("NAV_RETURN_TO_LAUNCH", "CommandRule::without_position(20, &[])"),
        // An enumeration with consecutive values.
        ("NAV_LAND", "CommandRule::at_position(21, &[ ParamRule::integers(2, 0, 2).or_nan(), ]).position_optional()"),
        ("DO_LAND_START", "CommandRule::at_position(189, &[]).position_optional().any_frame()"),
        // A bitmask, unused until recently.
        ("NAV_TAKEOFF", "CommandRule::at_position(22, &[ ParamRule::bits(3, 0x1).or_nan(), ]).position_optional()"),
        // −1 means forever (M-72), although the attribute does not allow it.
        (
            "DO_JUMP",
            "CommandRule::without_position(177, &[ \
             ParamRule::integers(1, 0, i32::MAX), ParamRule::integers(2, -1, i32::MAX), ])",
        ),
        (
            "DO_CHANGE_SPEED",
            "CommandRule::without_position(178, &[ \
             ParamRule::integers(1, 0, 3), ParamRule::at_least(2, -2.0), ParamRule::at_least(3, -2.0), ])",
        ),
        ("NAV_FENCE_RETURN_POINT", "CommandRule::at_position(5000, &[])"),
        (
            "NAV_FENCE_POLYGON_VERTEX_INCLUSION",
            "CommandRule::at_position(5001, &[ \
             ParamRule::integers(1, 3, i32::MAX), ParamRule::integers(2, 0, i32::MAX), ]).altitude_optional()",
        ),
        (
            "NAV_FENCE_POLYGON_VERTEX_EXCLUSION",
            "CommandRule::at_position(5002, &[ ParamRule::integers(1, 3, i32::MAX), ]).altitude_optional()",
        ),
        (
            "NAV_FENCE_CIRCLE_INCLUSION",
            "CommandRule::at_position(5003, &[ ParamRule::integers(2, 0, i32::MAX), ]).altitude_optional()",
        ),
        ("NAV_FENCE_CIRCLE_EXCLUSION", "CommandRule::at_position(5004, &[]).altitude_optional()"),
        ("NAV_RALLY_POINT", "CommandRule::at_position(5100, &[])"),
        // An enumeration with gaps, and a quantity, whose increment is ignored.
        (
            "PREFLIGHT_CALIBRATION",
            "CommandRule::without_position(241, &[ \
             ParamRule::integers(1, 0, 3), ParamRule::one_of(2, &[0, 1, 76]), ParamRule::integers(3, 0, 1), \
             ParamRule::integers(4, 0, 1), ParamRule::one_of(5, &[0, 1, 2, 3, 4, 76]), \
             ParamRule::integers(6, 0, 2).or_nan(), ParamRule::integers(7, 0, 3).or_nan(), ])",
        ),
        (
            "NAV_DELAY",
            "CommandRule::without_position(93, &[ ParamRule::at_least(1, -1.0), ParamRule::integers(2, -1, 23), \
             ParamRule::integers(3, -1, 59), ParamRule::integers(4, -1, 59), ])",
        ),
    ] {
        assert_eq!(lines(&text, command), rule, "{command}");
    }
}

#[test]
fn private_dialects_have_rules() {
    let rules: Vec<_> = tricky::rules::ALL.iter().map(|rule| rule.command().0).collect();
    assert_eq!(rules, [1, 2, 3, 4, 5, 6, 7, 8, 65_535], "an item's command has 16 bits");
    let [rule, ..] = tricky::rules::ALL else { panic!("no rules") };
    assert_eq!(*rule, tricky::rules::ALL_);
    let check = |params| rule.check(&item(1, 2, params));
    assert_eq!(check([-0.5, 0.0, f32::NAN, 7.0, 1.0, 2.0, -3.0]), Ok(()));
    assert_eq!(check([-0.5, 0.0, 0.2, 7.0, 1.0, 2.0, -3.0]), Err(MavMissionResult::INVALID_PARAM3));
    assert_eq!(check([-0.5, 0.0, 0.1, 7.0, 0.0, 2.0, -3.0]), Err(MavMissionResult::INVALID_PARAM5_X));
    assert_eq!(check([-0.5, 0.0, 0.1, 7.0, 1.0, 3.0, -3.0]), Err(MavMissionResult::INVALID_PARAM6_Y));
}

#[test]
fn selections_without_commands_have_no_rules() {
    let input = path("definitions/common.xml");
    let only = |name: &str| Options { only: Some(vec![name.to_owned()]), ..Options::for_file(&input) };
    let text = |name| generate(&common(), &only(name)).expect("declarations");
    assert!(!text("HEARTBEAT").contains("mod rules"));
    assert!(text("MISSION_ITEM_INT").contains("pub mod rules {"));
}
