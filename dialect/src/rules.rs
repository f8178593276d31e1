//! The rules for the parameters of commands: a `CommandRule` of `mavstack` for each command, from the attributes of
//! `MAV_CMD`'s entries (M-70, M-74).
//!
//! Attributes are interpreted as follows:
//!
//! - **No label, or reserved:** the parameter is not used. Clients send 0 or NaN. Any finite value and NaN are allowed.
//! - **Enumeration:** the parameter must have one of its values. For a bitmask, only its bits may be set.
//! - **Minimum and maximum:** the parameter must be within them.
//! - **Increment:** if it is an integer, the parameter must be an integer. If there are only a few steps, it must be
//!   one of them. A parameter with a unit is a quantity: its increment is only the step of a tool's input field, and is
//!   ignored (MAVSDK sends delays of 1.5 s).
//! - **NaN** is not allowed for a parameter with one of the attributes above, unless its default is NaN. A parameter
//!   without them may be any finite value, or NaN for "default".
//! - **Location:** a position in a global frame is required. The altitude must be a number if its parameter has a
//!   label.
//!
//! The tables below have rules that are stated only in MAVLink's prose, or that its clients rely on.

use crate::{
    Dialect,
    doc::Doc,
    model::{Entry, Enum, Param},
    names::{self, COMMANDS},
};
use std::fmt::Write as _;

/// Commands whose position may be omitted (`INT32_MAX`), which means the current position or another default.
const POSITION_OPTIONAL: [&str; 15] = [
    "MAV_CMD_NAV_LOITER_UNLIM",
    "MAV_CMD_NAV_LOITER_TURNS",
    "MAV_CMD_NAV_LOITER_TIME",
    "MAV_CMD_NAV_LOITER_TO_ALT",
    "MAV_CMD_NAV_LAND",
    "MAV_CMD_NAV_TAKEOFF",
    "MAV_CMD_NAV_VTOL_TAKEOFF",
    "MAV_CMD_NAV_VTOL_LAND",
    "MAV_CMD_NAV_ROI",
    "MAV_CMD_DO_ORBIT",
    "MAV_CMD_DO_FIGURE_EIGHT",
    "MAV_CMD_DO_LAND_START",
    "MAV_CMD_DO_REPOSITION",
    "MAV_CMD_DO_SET_HOME",
    "MAV_CMD_DO_SET_ROI",
];

/// Commands whose altitude may be NaN although it has a label.
const ALTITUDE_OPTIONAL: [&str; 5] = [
    "MAV_CMD_DO_FIGURE_EIGHT",
    "MAV_CMD_DO_ORBIT",
    "MAV_CMD_DO_REPOSITION",
    "MAV_CMD_DO_SET_HOME",
    "MAV_CMD_EXTERNAL_POSITION_ESTIMATE",
];

/// Parameters with a range or an enumeration that may be NaN: it means "default" or "ignore", or the parameter was
/// unused until recently, so that clients still send NaN. MAVSDK sends NaN for all parameters that its user does not
/// set (C-8).
const NAN: [(&str, &[u8]); 13] = [
    ("MAV_CMD_NAV_LAND", &[2]),
    ("MAV_CMD_NAV_TAKEOFF", &[3]),
    ("MAV_CMD_DO_ORBIT", &[3, 4]),
    ("MAV_CMD_DO_SET_HOME", &[2, 3, 4]),
    ("MAV_CMD_DO_SET_ACTUATOR", &[1, 2, 3, 4]),
    ("MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW", &[1, 2]),
    ("MAV_CMD_ACTUATOR_TEST", &[1]),
    ("MAV_CMD_COMPONENT_ARM_DISARM", &[2]),
    ("MAV_CMD_DO_REPOSITION", &[1]),
    ("MAV_CMD_PREFLIGHT_CALIBRATION", &[6, 7]),
    ("MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN", &[2, 3, 4, 6]),
    ("MAV_CMD_IMAGE_START_CAPTURE", &[4]),
    ("MAV_CMD_VIDEO_START_CAPTURE", &[2]),
];

/// Commands whose position is often meaningless: QGroundControl sends a landing pattern's start in the frame MISSION.
const ANY_FRAME: [&str; 1] = ["MAV_CMD_DO_LAND_START"];

/// Labels of parameters that may be NaN in all commands.
const NAN_LABELS: [&str; 1] = ["Target Camera ID"];

/// Parameters with another minimum than their attribute: −1 repeats a jump forever, 0 is a picture without a number.
const MINIMUM: [(&str, u8, f64); 2] = [("MAV_CMD_DO_JUMP", 2, -1.0), ("MAV_CMD_IMAGE_START_CAPTURE", 4, 0.0)];

/// Maximum number of steps of an increment for which the values are listed.
const MAX_STEPS: f64 = 8.0;

/// Writes the module of rules.
pub(crate) fn write(out: &mut String, dialect: &Dialect, commands: &Enum, crate_path: &str) {
    let mut doc = Doc::new();
    doc.text(&format!(
        "The rules for items with the commands of `{COMMANDS}`. A rule takes flash only if the firmware uses it."
    ));
    doc.write(out, "/// ");
    out.push_str("#[rustfmt::skip]\n");
    out.push_str(
        "#[allow(missing_docs, dead_code, reason = \"each command has a rule, with the name of the command\")]\n",
    );
    out.push_str("pub mod rules {\n");
    let mut rules = String::new();
    let mut all = Doc::new();
    for (entry, constant) in commands.entries.iter().zip(names::constants(commands)) {
        // An item's command has 16 bits.
        if u16::try_from(entry.value).is_ok() {
            command(&mut rules, dialect, entry, &constant);
            all.phrase(format!("{constant},"));
        }
    }
    let _ = writeln!(out, "    use {crate_path}::message::CommandRule;");
    if rules.contains("ParamRule::") {
        let _ = writeln!(out, "    use {crate_path}::message::ParamRule;");
    }
    let _ =
        write!(out, "\n{rules}\n    /// All rules, for tools. A vehicle lists only the commands that it supports.\n");
    out.push_str("    pub const ALL: &[CommandRule] = &[\n");
    all.write(out, "        ");
    out.push_str("    ];\n}\n");
}

fn command(out: &mut String, dialect: &Dialect, entry: &Entry, constant: &str) {
    let is_located = entry.has_location == Some(true);
    let kind = if is_located { "at_position" } else { "without_position" };
    let _ = write!(out, "    pub const {constant}: CommandRule = CommandRule::{kind}({}, &[", entry.value);
    let named = |list: &[&str]| list.contains(&entry.name.as_str());
    let mut rules = entry.params.iter().filter_map(|param| rule(dialect, entry, param)).peekable();
    if rules.peek().is_some() {
        out.push('\n');
        for rule in rules {
            let or_nan = if rule.may_be_nan { ".or_nan()" } else { "" };
            let _ = writeln!(out, "        ParamRule::{}{or_nan},", rule.values);
        }
        out.push_str("    ");
    }
    out.push_str("])");
    if is_located {
        let has_altitude = entry.params.iter().any(|param| param.index == 7 && is_used(param));
        if named(&POSITION_OPTIONAL) {
            out.push_str(".position_optional()");
        }
        if named(&ANY_FRAME) {
            out.push_str(".any_frame()");
        }
        if !has_altitude || named(&ALTITUDE_OPTIONAL) {
            out.push_str(".altitude_optional()");
        }
    }
    out.push_str(";\n");
}

pub(crate) fn is_used(param: &Param) -> bool {
    !param.reserved && !param.label.is_empty()
}

/// The rule for a parameter.
pub(crate) struct Rule<'a> {
    /// A call of one of `ParamRule`'s constructors.
    values: String,
    pub values_are: Values<'a>,
    /// Whether NaN is allowed, too.
    pub may_be_nan: bool,
}

/// The kind of a parameter's values.
pub(crate) enum Values<'a> {
    Floats,
    /// Integers, with their minimum and maximum.
    Integers(Option<f64>, Option<f64>),
    Enum(&'a Enum),
}

/// Returns the rule for a parameter; `None` if all finite values and NaN are allowed.
pub(crate) fn rule<'a>(dialect: &'a Dialect, entry: &Entry, param: &Param) -> Option<Rule<'a>> {
    // Latitude and longitude are covered by the rule for the position.
    if !is_used(param) || (entry.has_location == Some(true) && matches!(param.index, 5 | 6)) {
        return None;
    }
    let own_minimum = MINIMUM.iter().find(|(command, index, _)| *command == entry.name && *index == param.index);
    let minimum = own_minimum.map(|(_, _, minimum)| *minimum).or(param.minimum);
    let index = param.index;
    let (values, values_are) = match dialect.enumeration(&param.enumeration).filter(|e| !e.entries.is_empty()) {
        Some(enumeration) => (enumerated(index, enumeration), Values::Enum(enumeration)),
        None => ranged(param, minimum)?,
    };
    let of_command = NAN.iter().any(|(command, params)| *command == entry.name && params.contains(&index));
    let may_be_nan = of_command || NAN_LABELS.contains(&param.label.as_str()) || param.default.is_some_and(f64::is_nan);
    Some(Rule { values, values_are, may_be_nan })
}

fn enumerated(index: u8, enumeration: &Enum) -> String {
    // Values that do not fit in an `i32` are omitted.
    let values: Vec<_> = enumeration.entries.iter().filter_map(|entry| i32::try_from(entry.value).ok()).collect();
    if enumeration.bitmask {
        let mask = values.iter().fold(0, |mask, value| mask | value);
        return format!("bits({index}, {mask:#x})");
    }
    match (values.first(), values.last()) {
        (Some(first), Some(last)) if i64::from(*last) - i64::from(*first) + 1 == values.len() as i64 => {
            format!("integers({index}, {first}, {last})")
        }
        _ => one_of(index, &values),
    }
}

fn one_of(index: u8, values: &[i32]) -> String {
    let values: Vec<_> = values.iter().map(i32::to_string).collect();
    format!("one_of({index}, &[{}])", values.join(", "))
}

fn ranged<'a>(param: &Param, minimum: Option<f64>) -> Option<(String, Values<'a>)> {
    let index = param.index;
    // Bounds saturate: one that does not fit in the type excludes nothing.
    let float = |value: f64| format!("{:?}", value.clamp(f32::MIN.into(), f32::MAX.into()) as f32);
    let increment = param.increment.filter(|step| param.units.is_empty() && *step >= 1.0 && step.fract() == 0.0);
    let Some(step) = increment else {
        let values = match (minimum, param.maximum) {
            (None, None) => return None,
            (Some(minimum), None) => format!("at_least({index}, {})", float(minimum)),
            (None, Some(maximum)) => format!("at_most({index}, {})", float(maximum)),
            (Some(minimum), Some(maximum)) => format!("range({index}, {}, {})", float(minimum), float(maximum)),
        };
        return Some((values, Values::Floats));
    };
    let values_are = Values::Integers(minimum, param.maximum);
    if let (Some(minimum), Some(maximum)) = (minimum, param.maximum)
        && step > 1.0
        && (maximum - minimum) / step < MAX_STEPS
    {
        let values: Vec<_> =
            (0..).map(|n| minimum + f64::from(n) * step).take_while(|value| *value <= maximum).collect();
        let values = one_of(index, &values.iter().map(|value| *value as i32).collect::<Vec<_>>());
        return Some((values, values_are));
    }
    let bound = |bound: Option<f64>, open: &str| bound.map_or(open.to_owned(), |bound| (bound as i32).to_string());
    let minimum = bound(minimum.map(f64::ceil), "i32::MIN");
    let values = format!("integers({index}, {minimum}, {})", bound(param.maximum.map(f64::floor), "i32::MAX"));
    Some((values, values_are))
}
