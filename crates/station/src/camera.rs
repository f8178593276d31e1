//! Cameras: [`Identify`], [`Capture`], and the settings by extended parameters ([`ListSettings`], [`SetSetting`]).
//!
//! | | QGroundControl | MAVSDK | MAVProxy, pymavlink |
//! |---|---|---|---|
//! | looks for cameras at | components that send heartbeats: of the type camera, or 100 to 105 | components 100 to 105 that send heartbeats | components 100 to 105 |
//! | CAMERA_INFORMATION without an answer | is requested 10 times, every second time by the old command | as every message | is requested again every 5 s |
//! | images that were not reported | are not missed | are requested, every 0.5 s, 3 times | are not missed |
//! | PARAM_EXT_SET is sent | 4 times, every 3 s | 4 times, every 0.5 s | 3 times, every 3.5 s |
//! | a setting that was not read is requested | 4 times, every 3.5 s | 4 times, every 0.5 s | 3 times, every 3.5 s |
//!
//! All of them take a camera of the autopilot too, if it answers.
//!
//! Sources: QGroundControl's `QGCCameraManager.cc` and `QGCCameraIO.cc`, MAVSDK's `camera_impl.cpp` and
//! `mavlink_parameter_client.cpp`, MAVProxy's `mavproxy_camera`.

mod capture;
mod identify;
mod settings;

pub use capture::Capture;
pub use identify::{Identified, Identify};
pub use settings::{ListSettings, SetSetting, Setting, Value};

use crate::Io;
use mavstack::Address;
use mavstack::dialect::MavType;

/// MAV_COMP_ID_CAMERA to MAV_COMP_ID_CAMERA6.
const CAMERAS: std::ops::RangeInclusive<u8> = 100..=105;

/// Returns the first camera of the vehicle that was heard: a component of the type camera, or with a camera's id.
fn first_camera(io: &Io<'_>) -> Option<Address> {
    let is_camera = |address: Address, is_type: bool| {
        address.system == io.target().system && (is_type || CAMERAS.contains(&address.component.wire()))
    };
    let mut components = io.seen().components();
    let found = components.find(|component| {
        let is_type = component.heartbeat.is_some_and(|heartbeat| heartbeat.r#type == MavType::CAMERA);
        component.heartbeat.is_some() && is_camera(component.address, is_type)
    });
    found.map(|component| component.address)
}
