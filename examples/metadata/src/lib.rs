//! A boat that describes its parameters to ground stations: QGroundControl and MAVSDK show units, names of values and check boxes.
//!
//! 1. Declare the parameters in a file of their own: `tuning.rs`.
//! 2. The build script makes the files from it.
//! 3. Serve them: [`Files`], and COMPONENT_METADATA in [`Telemetry`].
#![no_std]

mod tuning;

use mavstack::dialect::{ComponentMetadata, MavResult};
use mavstack::files::StaticFile;
use mavstack::{
    Command, Commands, Context, Files, Fill, Message, Outcome, Parameters, Stream, Telemetry, Text, Vehicle,
    VehicleState,
};
pub use tuning::Tuning;

macro_rules! built {
    ($name:literal) => {
        StaticFile::new($name, include_bytes!(concat!(env!("OUT_DIR"), "/", $name)))
    };
}

/// The checksum of the general file, which names the other.
const GENERAL_CRC: u32 = include!(concat!(env!("OUT_DIR"), "/general.crc"));

/// What the boat has of MAVLink.
#[derive(mavstack::Stack)]
#[stack(vehicle: Boat, links: 1, parameters: Tuning, streams, files: { sessions: 2 })]
pub struct Mavlink;

/// A boat.
#[derive(Debug, Default)]
pub struct Boat;

impl Vehicle for Boat {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Boat {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Parameters for Boat {
    type Table = Tuning;
}

impl Files for Boat {
    const FILES: &'static [StaticFile] = &[built!("general.json"), built!("parameters.json.xz")];
}

impl Telemetry for Boat {
    const STREAMS: &'static [Stream] = &[Stream::of::<ComponentMetadata>()];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let (time_boot_ms, uri) = (out.now().time_boot_ms(), Text::new("mftp:///general.json"));
        id == ComponentMetadata::ID && out.put(&ComponentMetadata { time_boot_ms, file_crc: GENERAL_CRC, uri })
    }
}
