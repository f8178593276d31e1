//! Items, and the messages that carry them.

use crate::command::Place;
use mavstack::dialect::{MavCmd, MavFrame, MissionItem, MissionItemInt};
use mavstack::{Item, PlanType};

/// Returns a waypoint.
pub fn waypoint(place: Place) -> Item {
    let (x, y) = place.scaled();
    Item {
        frame: place.frame,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [0.0, 0.0, 0.0, f32::NAN],
        x,
        y,
        z: place.altitude,
    }
}

/// Returns the item of a MISSION_ITEM_INT.
pub fn from_message(message: &MissionItemInt) -> Item {
    Item {
        frame: message.frame,
        command: message.command,
        autocontinue: message.autocontinue,
        params: [message.param1, message.param2, message.param3, message.param4],
        x: message.x,
        y: message.y,
        z: message.z,
    }
}

/// Returns the item of a MISSION_ITEM: its position is converted to deg·1e7.
pub(super) fn from_float_message(message: &MissionItem) -> Item {
    let scale = if is_scaled(message.frame, message.command) { 1e7 } else { 1.0 };
    let scaled = |value: f32| if value.is_nan() { i32::MAX } else { (f64::from(value) * scale).round() as i32 };
    Item {
        frame: message.frame,
        command: message.command,
        autocontinue: message.autocontinue,
        params: [message.param1, message.param2, message.param3, message.param4],
        x: scaled(message.x),
        y: scaled(message.y),
        z: message.z,
    }
}

/// Returns the MISSION_ITEM_INT of an item. Clients mark the first item of a mission as the current one.
pub(super) fn to_message(item: &Item, seq: u16, plan: PlanType, (system, component): (u8, u8)) -> MissionItemInt {
    let [param1, param2, param3, param4] = item.params;
    MissionItemInt {
        param1,
        param2,
        param3,
        param4,
        x: item.x,
        y: item.y,
        z: item.z,
        seq,
        command: item.command,
        target_system: system,
        target_component: component,
        frame: item.frame,
        current: u8::from(seq == 0 && plan == PlanType::Mission),
        autocontinue: item.autocontinue,
        mission_type: plan.mission_type(),
    }
}

/// Returns the MISSION_ITEM of a message, as scripts send it.
pub(super) fn to_float_message(message: &MissionItemInt) -> MissionItem {
    let scale = if is_scaled(message.frame, message.command) { 1e-7 } else { 1.0 };
    let degrees = |value: i32| if value == i32::MAX { f32::NAN } else { (f64::from(value) * scale) as f32 };
    MissionItem {
        param1: message.param1,
        param2: message.param2,
        param3: message.param3,
        param4: message.param4,
        x: degrees(message.x),
        y: degrees(message.y),
        z: message.z,
        seq: message.seq,
        command: message.command,
        target_system: message.target_system,
        target_component: message.target_component,
        frame: message.frame,
        current: message.current,
        autocontinue: message.autocontinue,
        mission_type: message.mission_type,
    }
}

/// Whether parameters 5 and 6 are a position in degrees. Commands above `NAV_LAST` have none, but for these.
fn is_scaled(frame: MavFrame, command: MavCmd) -> bool {
    const WITH_POSITION: [MavCmd; 11] = [
        MavCmd::DO_SET_HOME,
        MavCmd::DO_LAND_START,
        MavCmd::DO_REPOSITION,
        MavCmd::DO_SET_ROI_LOCATION,
        MavCmd::DO_SET_ROI,
        MavCmd::NAV_FENCE_RETURN_POINT,
        MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
        MavCmd::NAV_FENCE_CIRCLE_INCLUSION,
        MavCmd::NAV_FENCE_CIRCLE_EXCLUSION,
        MavCmd::NAV_RALLY_POINT,
    ];
    let is_navigation = command.0 < MavCmd::NAV_LAST.0 && command != MavCmd::NAV_RETURN_TO_LAUNCH;
    frame != MavFrame::MISSION && (is_navigation || WITH_POSITION.contains(&command))
}
