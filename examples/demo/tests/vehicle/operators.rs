//! Operator control over MAVLink: rule O-5 as used by the vehicle.

use crate::support::wire::{ControlStatus, STATION, Wire};
use mavstack::Address;
use mavstack::dialect::*;
use mavstack_demo::{COMPANION, Mode, TELEMETRY};

const REQUEST: MavCmd = MavCmd(32_100);
/// A station that is connected to the companion link.
const OTHER: Address = Address::new(254, 190);

fn beat(wire: &mut Wire) {
    let heartbeat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
    wire.send_as(TELEMETRY, STATION, &heartbeat);
    wire.send_as(COMPANION, OTHER, &heartbeat);
    wire.run(20);
}

/// Sends a command of the other station. Returns its result.
fn other(wire: &mut Wire, command: MavCmd, param1: f32) -> MavResult {
    let message = CommandLong { command, param1, target_system: 1, target_component: 1, ..CommandLong::default() };
    wire.send_as(COMPANION, OTHER, &message);
    wire.answer(command).result
}

/// O-5, C-5: a station that is not in control neither lands the vehicle nor changes its mode, until it is in control.
#[test]
fn a_station_that_is_not_in_control_changes_nothing() {
    let mut wire = Wire::airborne();
    beat(&mut wire);
    assert_eq!(wire.long(REQUEST, &[1.0, 0.0, 10.0]), MavResult::ACCEPTED);
    for command in [MavCmd::NAV_LAND, MavCmd::DO_SET_STANDARD_MODE, MavCmd::COMPONENT_ARM_DISARM] {
        assert_eq!(other(&mut wire, command, 0.0), MavResult::NOT_IN_CONTROL, "{command:?}");
    }
    assert_eq!(other(&mut wire, REQUEST, 1.0), MavResult::FAILED);
    let message =
        SetMode { target_system: 1, base_mode: MavModeFlag::CUSTOM_MODE_ENABLED, custom_mode: Mode::Land.number() };
    wire.send_as(COMPANION, OTHER, &message);
    assert_eq!(wire.answer(MavCmd(11)).result, MavResult::NOT_IN_CONTROL);
    assert!(wire.vehicle().mode() == Mode::Hold && wire.vehicle().is_armed());

    assert_eq!(wire.long(REQUEST, &[0.0]), MavResult::ACCEPTED);
    wire.run(20);
    let (_, status) = wire.take::<ControlStatus>().pop().unwrap();
    assert_eq!((status.flags, status.gcs_main), (3, 0));
    assert_eq!(other(&mut wire, REQUEST, 1.0), MavResult::ACCEPTED);
    assert_eq!(wire.long(MavCmd::NAV_LAND, &[]), MavResult::NOT_IN_CONTROL);
    assert_eq!(other(&mut wire, MavCmd::NAV_LAND, 0.0), MavResult::ACCEPTED);
    assert_eq!(wire.vehicle().mode(), Mode::Land);
}
