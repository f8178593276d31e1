//! Component metadata: files that describe a vehicle's parameters and events to ground stations, with units, ranges and texts.
//!
//! Implements the component's side of <https://mavlink.io/en/services/component_information.html> (O-1, EVT-8). A ground
//! station requests COMPONENT_METADATA, which names a *general* file, which names the others:
//!
//! ```text
//!   REQUEST_MESSAGE(397) ─▶ COMPONENT_METADATA { uri, file_crc } ─▶ general.json ─┬─▶ parameters.json
//!                                                                                 └─▶ events.json
//! ```
//!
//! QGroundControl and MAVSDK fetch `mftp` URIs from the vehicle itself, and `http` and `https` URIs:
//!
//! 1. Generate the files from the parameter table and the [`events!`](crate::events!) of the firmware. Its build script can do that if
//!    the declarations are in files of their own, which the script includes too: `examples/metadata`. Put the files into the firmware,
//!    as constant [`Files`](crate::Files), whose URI is `mftp:///general.json`; or on a web server.
//! 2. In the firmware, declare [`ComponentMetadata`] in [`Telemetry::STREAMS`](crate::Telemetry::STREAMS) and fill in
//!    the general file's URI.
//!
//! The second step, with `GENERAL_CRC` from the first:
//!
//! ```
//! # use mavstack::prelude::*;
//! use mavstack::dialect::ComponentMetadata;
//!
//! # const GENERAL_CRC: u32 = 0;
//! # struct Rover;
//! impl Telemetry for Rover {
//!     const STREAMS: &'static [Stream] = &[Stream::of::<ComponentMetadata>()];
//!
//!     fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
//!         let uri = Text::new("mftp:///general.json");
//!         let time_boot_ms = out.now().time_boot_ms();
//!         id == ComponentMetadata::ID && out.put(&ComponentMetadata { time_boot_ms, file_crc: GENERAL_CRC, uri })
//!     }
//! }
//! ```
//!
//! Files may be compressed to the format ".xz", if their names end with it. They then take a quarter of the flash and of the time.
//! `file_crc` is the checksum of the compressed file. The build script of `examples/metadata` does all this; by hand it is
//! `xz -9 --check=crc32`.
//!
//! A firmware without this message refuses the request; clients then know that there is no metadata (Q-1).
//!
//! ```
//! use mavstack::metadata;
//!
//! mavstack::parameters! {
//!     pub struct Tuning {
//!         /// Voltage below which the rover returns home.
//!         BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
//!     }
//! }
//!
//! let mut parameters = String::new();
//! metadata::parameters::<Tuning>(&mut parameters)?;
//! assert!(parameters.contains(r#""name":"BAT_LOW","type":"Float","shortDesc":"Voltage below which the rover returns home.""#));
//!
//! let mut general = String::new();
//! let crc = metadata::file_crc(parameters.as_bytes());
//! let file = metadata::MetadataFile::parameters("https://rover.example/1.0/parameters.json", crc);
//! metadata::general(&mut general, &[file])?;
//! // For COMPONENT_METADATA.file_crc.
//! let crc = metadata::file_crc(general.as_bytes());
//! # let _ = crc;
//! # Ok::<(), core::fmt::Error>(())
//! ```
//!
//! [`ComponentMetadata`]: crate::dialect::ComponentMetadata

mod events;

pub use events::events;

use core::fmt::{Result, Write};

use crate::crc32::Crc32;
use crate::dialect::{CompMetadataType, MavParamType};
use crate::service::param::{ParamDetails, ParamInfo, ParamTable};

/// The version of the general file and of that with the parameters. MAVLink's schema of the parameters asks for 3 since 2026, but
/// QGroundControl reads only version 1, which PX4 writes too.
const VERSION: u8 = 1;

/// A file that the general file names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MetadataFile<'a> {
    /// The subject of the file, such as the parameters.
    pub r#type: CompMetadataType,
    /// Where it is.
    pub uri: &'a str,
    /// Its [`file_crc`].
    pub crc: u32,
}

impl<'a> MetadataFile<'a> {
    /// Returns the file with the [`parameters`].
    pub const fn parameters(uri: &'a str, crc: u32) -> Self {
        Self { r#type: CompMetadataType::PARAMETER, uri, crc }
    }

    /// Returns the file with the [`events`].
    pub const fn events(uri: &'a str, crc: u32) -> Self {
        Self { r#type: CompMetadataType::EVENTS, uri, crc }
    }
}

/// Writes the general file, which names the others.
///
/// # Errors
///
/// The errors of `out`.
pub fn general(out: &mut impl Write, files: &[MetadataFile<'_>]) -> Result {
    write!(out, r#"{{"version":{VERSION},"metadataTypes":["#)?;
    for (index, MetadataFile { r#type, uri, crc }) in files.iter().enumerate() {
        separate(out, index)?;
        write!(out, r#"{{"type":{},"uri":"#, r#type.0)?;
        string(out, uri)?;
        write!(out, r#","fileCrc":{crc}}}"#)?;
    }
    out.write_str("]}")
}

/// Writes a comma before all elements but the first.
fn separate(out: &mut impl Write, index: usize) -> Result {
    if index > 0 { out.write_char(',') } else { Ok(()) }
}

/// Writes the file with the parameters of table `T`.
///
/// A parameter's doc comment is its description; the first sentence is the short description. The part of its name
/// before the first `_` is its group, unless the row has another `group`. [`parameters!`](crate::parameters) shows the other
/// attributes of a row: names of values and of bits, categories, decimals, flags. A table that is filled at run time has none of
/// these, so that this does not compile:
///
/// ```compile_fail
/// # use mavstack::{metadata, param::RuntimeTable};
/// metadata::parameters::<RuntimeTable<8>>(&mut String::new());
/// ```
///
/// # Errors
///
/// The errors of `out`.
pub fn parameters<T: ParamTable>(out: &mut impl Write) -> Result {
    const {
        assert!(T::DETAILS.len() == T::INFO.len(), "only a table made by `parameters!` has units and descriptions");
    }
    write!(out, r#"{{"version":{VERSION},"parameters":["#)?;
    for (index, (info, details)) in T::INFO.iter().zip(T::DETAILS).enumerate() {
        separate(out, index)?;
        parameter(out, info, details)?;
    }
    out.write_str("]}")
}

fn parameter(out: &mut impl Write, info: &ParamInfo, details: &ParamDetails) -> Result {
    let group = details.group.or(info.name().split('_').next()).unwrap_or_default();
    let description = details.description.trim();
    // A description of one sentence is only the short one.
    let short = description.split_once(". ").map_or(description, |(first, _)| first);
    let [min, max] = info.range_bits();
    text(out, '{', "name", info.name())?;
    text(out, ',', "type", type_name(info.param_type()))?;
    text(out, ',', "shortDesc", short)?;
    if short.len() < description.len() {
        text(out, ',', "longDesc", description)?;
    }
    text(out, ',', "group", group)?;
    if let Some(category) = details.category {
        text(out, ',', "category", category)?;
    }
    if !details.unit.is_empty() {
        text(out, ',', "units", details.unit)?;
    }
    for (key, bits) in [("default", info.default_bits()), ("min", min), ("max", max)] {
        write!(out, r#","{key}":"#)?;
        number(out, info.param_type(), bits)?;
    }
    if let Some(decimals) = details.decimals {
        write!(out, r#","decimalPlaces":{decimals}"#)?;
    }
    if let Some(increment) = details.increment {
        out.write_str(r#","increment":"#)?;
        exact(out, info.param_type(), increment)?;
    }
    let flags = [
        ("rebootRequired", info.is_reboot_required()),
        ("volatile", info.is_volatile()),
        ("readOnly", info.is_read_only()),
    ];
    for (key, _) in flags.into_iter().filter(|(_, is_set)| *is_set) {
        write!(out, r#","{key}":true"#)?;
    }
    list(out, "values", details.values.iter(), |out, (value, name)| {
        out.write_str(r#"{"value":"#)?;
        exact(out, info.param_type(), *value)?;
        text(out, ',', "description", name)
    })?;
    list(out, "bitmask", details.bitmask.iter(), |out, (index, name)| {
        write!(out, r#"{{"index":{index}"#)?;
        text(out, ',', "description", name)
    })?;
    out.write_char('}')
}

/// Writes a value of a parameter of this type. As an `f64`, that of an `f32` would have digits that nobody wrote.
#[allow(clippy::as_conversions, reason = "the value of an `f32` is not rounded")]
fn exact(out: &mut impl Write, r#type: MavParamType, value: f64) -> Result {
    if r#type == MavParamType::REAL32 { write!(out, "{}", value as f32) } else { write!(out, "{value}") }
}

/// Writes a list of objects, whose ends `object` leaves out; nothing if there are none.
fn list<W: Write, T>(
    out: &mut W,
    key: &str,
    items: impl ExactSizeIterator<Item = T>,
    object: impl Fn(&mut W, T) -> Result,
) -> Result {
    if items.len() == 0 {
        return Ok(());
    }
    write!(out, r#","{key}":["#)?;
    for (index, item) in items.enumerate() {
        separate(out, index)?;
        object(out, item)?;
        out.write_char('}')?;
    }
    out.write_char(']')
}

/// Returns the type's name in the files.
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

/// Writes a value, given by its bits in the table.
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

/// Writes a JSON string.
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

/// Returns the checksum of a file, for COMPONENT_METADATA.file_crc and for the general file.
///
/// It is MAVLink's CRC-32, with initial value 0 and without inversion. Ground stations cache the file until it changes.
pub fn file_crc(file: &[u8]) -> u32 {
    let mut crc = Crc32::ZERO;
    crc.add(file);
    !crc.sum()
}
