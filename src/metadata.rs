//! Component metadata: the files that tell a ground station what a vehicle's parameters mean, with units and ranges.
//!
//! Implements the producing side of <https://mavlink.io/en/services/component_information.html> (O-1). A ground station asks
//! for COMPONENT_METADATA, which names a *general* file, and that one names a file with the parameters:
//!
//! ```text
//!   REQUEST_MESSAGE(397) ─▶ COMPONENT_METADATA { uri, file_crc } ─▶ general.json ─▶ parameters.json
//! ```
//!
//! The vehicle itself needs no file server: QGroundControl and MAVSDK also follow `http` and `https`. The files are made on
//! the host, from the table that the firmware is built with, and put where the ground can reach them; the firmware declares
//! [`ComponentMetadata`] in [`Telemetry::STREAMS`](crate::Telemetry::STREAMS) and fills in where. One that does not declare it
//! refuses the request, which every client takes for a no (Q-1).
//!
//! ```
//! use mavstack::metadata;
//!
//! mavstack::parameters! {
//!     pub struct Tuning {
//!         /// Voltage under which it goes home.
//!         BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
//!     }
//! }
//!
//! let mut parameters = String::new();
//! metadata::parameters::<Tuning>(&mut parameters)?;
//! assert!(parameters.contains(r#""name":"BAT_LOW","type":"Float","shortDesc":"Voltage under which it goes home.""#));
//!
//! let mut general = String::new();
//! let crc = metadata::file_crc(parameters.as_bytes());
//! metadata::general(&mut general, "https://rover.example/1.0/parameters.json", crc)?;
//! // For COMPONENT_METADATA.file_crc.
//! let crc = metadata::file_crc(general.as_bytes());
//! # let _ = crc;
//! # Ok::<(), core::fmt::Error>(())
//! ```
//!
//! [`ComponentMetadata`]: crate::dialect::ComponentMetadata

use core::fmt::{Result, Write};

use crate::crc32::Crc32;
use crate::dialect::{CompMetadataType, MavParamType};
use crate::service::param::{ParamInfo, ParamTable};

/// The version of both files' form.
const VERSION: u8 = 1;

/// Writes the general file, which names the file with the parameters: its URI, and its [`file_crc`].
///
/// # Errors
///
/// What `out` reports.
pub fn general(out: &mut impl Write, parameters_uri: &str, parameters_crc: u32) -> Result {
    let r#type = CompMetadataType::PARAMETER.0;
    write!(out, r#"{{"version":{VERSION},"metadataTypes":[{{"type":{type},"uri":"#)?;
    string(out, parameters_uri)?;
    write!(out, r#","fileCrc":{parameters_crc}}}]}}"#)
}

/// Writes the file with the parameters of a table. Their descriptions are its doc comments: what stands before the first
/// full stop is the short one. The group is what stands before the name's first `_`.
///
/// # Errors
///
/// What `out` reports.
pub fn parameters<T: ParamTable>(out: &mut impl Write) -> Result {
    write!(out, r#"{{"version":{VERSION},"parameters":["#)?;
    for (index, info) in T::INFO.iter().enumerate() {
        if index > 0 {
            out.write_char(',')?;
        }
        let unit = T::UNITS.get(index).copied().unwrap_or_default();
        let description = T::DESCRIPTIONS.get(index).copied().unwrap_or_default();
        parameter(out, info, unit, description.trim())?;
    }
    out.write_str("]}")
}

fn parameter(out: &mut impl Write, info: &ParamInfo, unit: &str, description: &str) -> Result {
    let group = info.name().split('_').next().unwrap_or_default();
    // A description of one sentence is the short one.
    let short = description.split_once(". ").map_or(description, |(first, _)| first);
    let [min, max] = info.range_bits();
    text(out, '{', "name", info.name())?;
    text(out, ',', "type", type_name(info.param_type()))?;
    text(out, ',', "shortDesc", short)?;
    if short.len() < description.len() {
        text(out, ',', "longDesc", description)?;
    }
    text(out, ',', "group", group)?;
    if !unit.is_empty() {
        text(out, ',', "units", unit)?;
    }
    for (key, bits) in [("default", info.default_bits()), ("min", min), ("max", max)] {
        write!(out, r#","{key}":"#)?;
        number(out, info.param_type(), bits)?;
    }
    for (key, is_set) in [("rebootRequired", info.is_reboot_required()), ("volatile", info.is_volatile())] {
        if is_set {
            write!(out, r#","{key}":true"#)?;
        }
    }
    out.write_char('}')
}

/// The type as the files call it.
const fn type_name(r#type: MavParamType) -> &'static str {
    match r#type {
        MavParamType::UINT8 => "Uint8",
        MavParamType::INT8 => "Int8",
        MavParamType::UINT16 => "Uint16",
        MavParamType::INT16 => "Int16",
        MavParamType::UINT32 => "Uint32",
        MavParamType::INT32 => "Int32",
        _ => "Float",
    }
}

/// A value from the bits that a table has of it.
fn number(out: &mut impl Write, r#type: MavParamType, bits: u32) -> Result {
    let [low, second, ..] = bits.to_le_bytes();
    match r#type {
        MavParamType::INT8 => write!(out, "{}", low.cast_signed()),
        MavParamType::INT16 => write!(out, "{}", i16::from_le_bytes([low, second])),
        MavParamType::INT32 => write!(out, "{}", bits.cast_signed()),
        MavParamType::REAL32 => write!(out, "{}", f32::from_bits(bits)),
        _ => write!(out, "{bits}"),
    }
}

fn text(out: &mut impl Write, before: char, key: &str, value: &str) -> Result {
    write!(out, r#"{before}"{key}":"#)?;
    string(out, value)
}

/// A string as JSON has it.
fn string(out: &mut impl Write, value: &str) -> Result {
    out.write_char('"')?;
    for c in value.chars() {
        match c {
            '"' | '\\' => write!(out, "\\{c}")?,
            c if c < ' ' => write!(out, "\\u{:04x}", u32::from(c))?,
            c => out.write_char(c)?,
        }
    }
    out.write_char('"')
}

/// The checksum of a file, for COMPONENT_METADATA.file_crc and for the general file: MAVLink's CRC-32, which begins with 0
/// and is not inverted at the end. Ground stations keep the file until it changes.
pub fn file_crc(file: &[u8]) -> u32 {
    let mut crc = Crc32::ZERO;
    crc.add(file);
    !crc.sum()
}
