//! The file with the events, in libevents' format (`validation/schema.json`): names, texts, arguments and enumerations
//! (EVT-8).

use core::fmt::{Result, Write};

use super::{separate, string, text};
use crate::service::events::{ArgumentInfo, EnumInfo, EventGroup, EventInfo, EventSet};

/// The version of the file format.
const VERSION: u8 = 2;

/// The groups, in the order of the file.
const GROUPS: [(EventGroup, &str); 3] =
    [(EventGroup::Default, "default"), (EventGroup::ArmingCheck, "arming_check"), (EventGroup::Health, "health")];

/// Writes the file with the events of the set `E`, which [`events!`](crate::events!) declares.
///
/// ```
/// mavstack::events! {
///     /// The events of this rover.
///     pub struct RoverEvents in "rover" {
///         events {
///             /// Charge soon.
///             BatteryLow(Warning) { voltage: f32 } = "Battery low: {1:.1} V";
///         }
///     }
/// }
///
/// let mut events = String::new();
/// mavstack::metadata::events::<RoverEvents>(&mut events)?;
/// assert!(events.contains(r#""name":"battery_low","message":"Battery low: {1:.1} V","description":"Charge soon.""#));
/// # Ok::<(), core::fmt::Error>(())
/// ```
///
/// # Errors
///
/// The errors of `out`.
pub fn events<E: EventSet>(out: &mut impl Write) -> Result {
    write!(out, r#"{{"version":{VERSION},"components":{{"{}":{{"namespace":"#, E::COMPONENT)?;
    string(out, E::NAMESPACE)?;
    out.write_str(r#","enums":{"#)?;
    for (index, info) in E::ENUMS.iter().enumerate() {
        separate(out, index)?;
        enumeration(out, info)?;
    }
    out.write_str(r#"},"event_groups":{"#)?;
    let has = |group| E::EVENTS.iter().any(|event| event.group == group);
    for (index, (group, name)) in GROUPS.into_iter().filter(|(group, _)| has(*group)).enumerate() {
        separate(out, index)?;
        write!(out, r#""{name}":{{"events":{{"#)?;
        for (index, info) in E::EVENTS.iter().filter(|event| event.group == group).enumerate() {
            separate(out, index)?;
            event(out, info)?;
        }
        out.write_str("}}")?;
    }
    out.write_char('}')?;
    if !E::MODE_GROUPS.is_empty() {
        out.write_str(r#","supported_protocols":["health_and_arming_check"],"navigation_mode_groups":{"groups":{"#)?;
        for (index, modes) in E::MODE_GROUPS.iter().enumerate() {
            separate(out, index)?;
            write!(out, r#""{index}":{modes:?}"#)?;
        }
        out.write_str("}}")?;
    }
    out.write_str("}}}")
}

fn event(out: &mut impl Write, info: &EventInfo) -> Result {
    write!(out, r#""{}":{{"name":""#, info.id & 0x00FF_FFFF)?;
    snake(out, info.name)?;
    out.write_char('"')?;
    text(out, ',', "message", info.message)?;
    if !info.description.is_empty() {
        text(out, ',', "description", info.description.trim())?;
    }
    if info.is_summary {
        text(out, ',', "type", "summary")?;
    }
    out.write_str(r#","arguments":["#)?;
    for (index, info) in info.arguments.iter().enumerate() {
        separate(out, index)?;
        argument(out, info)?;
    }
    out.write_str("]}")
}

fn argument(out: &mut impl Write, info: &ArgumentInfo) -> Result {
    text(out, '{', "name", info.name)?;
    out.write_str(r#","type":""#)?;
    if info.is_enum {
        enum_name(out, info.r#type)?;
    } else {
        out.write_str(info.r#type)?;
    }
    out.write_char('"')?;
    if !info.description.is_empty() {
        text(out, ',', "description", info.description.trim())?;
    }
    out.write_char('}')
}

fn enumeration(out: &mut impl Write, info: &EnumInfo) -> Result {
    out.write_char('"')?;
    enum_name(out, info.name)?;
    out.write_char('"')?;
    write!(out, r#":{{"is_bitfield":{}"#, info.is_bitmask)?;
    text(out, ',', "type", info.r#type)?;
    text(out, ',', "description", info.description.trim())?;
    out.write_str(r#","entries":{"#)?;
    for (index, entry) in info.entries.iter().enumerate() {
        separate(out, index)?;
        write!(out, r#""{}":{{"name":""#, entry.value)?;
        lower(out, entry.name)?;
        out.write_char('"')?;
        text(out, ',', "description", entry.description.trim())?;
        out.write_char('}')?;
    }
    out.write_str("}}")
}

/// Writes the name of an enumeration: `Reason` is `reason_t`.
fn enum_name(out: &mut impl Write, name: &str) -> Result {
    snake(out, name)?;
    out.write_str("_t")
}

/// Writes the name of a type in small letters, with `_` between its words.
fn snake(out: &mut impl Write, name: &str) -> Result {
    for (index, c) in name.chars().enumerate() {
        if c.is_ascii_uppercase() && index > 0 {
            out.write_char('_')?;
        }
        out.write_char(c.to_ascii_lowercase())?;
    }
    Ok(())
}

/// Writes the name of a constant in small letters.
fn lower(out: &mut impl Write, name: &str) -> Result {
    name.chars().try_for_each(|c| out.write_char(c.to_ascii_lowercase()))
}
