//! The files of the vehicle: the descriptions of its parameters and of its events for ground stations (O-1, EVT-8). The stack itself has
//! the parameters.

use mavstack::dialect::ComponentMetadata;
use mavstack::files::StaticFile;
use mavstack::{Files, Text};

use crate::vehicle::Quadrotor;

macro_rules! built {
    ($name:literal) => {
        StaticFile::new($name, include_bytes!(concat!(env!("OUT_DIR"), "/", $name)))
    };
}

/// The description of the parameters, made from the table: a test in `examples/sitl` compares it. The build script compresses it.
pub const PARAMETERS: StaticFile = built!("parameters.json.xz");

/// The description of the events, made from their declaration in the same way.
pub const EVENTS: StaticFile = built!("events.json.xz");

/// The file that names both. The build script makes it.
pub const GENERAL: StaticFile = built!("general.json");

/// Where ground stations find the files.
pub const PARAMETERS_URI: &str = "mftp:///parameters.json.xz";
/// The same of the events.
pub const EVENTS_URI: &str = "mftp:///events.json.xz";
/// Its checksum, by the build script.
const GENERAL_CRC: u32 = include!(concat!(env!("OUT_DIR"), "/general.crc"));
const GENERAL_URI: &[u8; 20] = b"mftp:///general.json";

impl Files for Quadrotor {
    const FILES: &'static [StaticFile] = &[GENERAL, PARAMETERS, EVENTS];
}

/// COMPONENT_METADATA, without the time.
pub(crate) static METADATA: ComponentMetadata =
    ComponentMetadata { time_boot_ms: 0, file_crc: GENERAL_CRC, uri: Text::from_wire(padded(GENERAL_URI)) };

/// Returns a text as it is on the wire.
const fn padded(text: &[u8]) -> [u8; 100] {
    let mut wire = [0; 100];
    wire.split_at_mut(text.len()).0.copy_from_slice(text);
    wire
}
