//! Offboard flight over MAVLink: rules J-6 to J-8 as used by the vehicle.

use crate::support::wire::{Wire, command_long};
use mavstack::Message;
use mavstack::dialect::*;
use mavstack_demo::{COMPANION, Mode, SATELLITE, TELEMETRY, Tuning, Vector};

const OFFBOARD: [f32; 3] = [129.0, 6.0, 0.0];
/// MAVSDK's masks.
const POSITION: PositionTargetTypemask = PositionTargetTypemask(0b1001_1111_1000);
const VELOCITY: PositionTargetTypemask = PositionTargetTypemask(0b0101_1100_0111);

/// Sends heartbeats of a ground station, and setpoints at 20 Hz, for `millis`.
fn keep_sending<M: Message>(wire: &mut Wire, millis: u64, message: &M) {
    for _ in 0..millis / 50 {
        if wire.millis % 1_000 < 50 {
            wire.send(TELEMETRY, &Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() });
        }
        wire.send(TELEMETRY, message);
        wire.run(50);
    }
}

fn local(type_mask: PositionTargetTypemask) -> SetPositionTargetLocalNed {
    SetPositionTargetLocalNed {
        target_system: 1,
        target_component: 1,
        coordinate_frame: MavFrame::LOCAL_NED,
        type_mask,
        ..Default::default()
    }
}

fn position(x: f32, y: f32, z: f32, yaw: f32) -> SetPositionTargetLocalNed {
    SetPositionTargetLocalNed { x, y, z, yaw, ..local(POSITION) }
}

fn velocity(vx: f32, vy: f32, vz: f32, yaw_rate: f32) -> SetPositionTargetLocalNed {
    SetPositionTargetLocalNed { vx, vy, vz, yaw_rate, ..local(VELOCITY) }
}

/// Returns a vehicle in offboard flight that stands still at 10 m.
fn in_offboard_flight() -> Wire {
    let mut wire = Wire::airborne();
    keep_sending(&mut wire, 1_200, &velocity(0.0, 0.0, 0.0, 0.0));
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::ACCEPTED);
    wire
}

fn heading(wire: &Wire) -> f32 {
    let [_, _, yaw] = wire.vehicle().attitude();
    yaw.to_degrees()
}

/// J-7: Offboard mode is refused without setpoints, and after their timeout.
#[test]
fn offboard_mode_needs_current_setpoints() {
    let mut wire = Wire::airborne();
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(wire.texts(), ["Offboard mode refused: no setpoints to fly"]);
    let still = velocity(0.0, 0.0, 0.0, 0.0);
    keep_sending(&mut wire, 1_200, &still);
    wire.run(600);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::TEMPORARILY_REJECTED);
    keep_sending(&mut wire, 100, &still);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::ACCEPTED);
    assert_eq!(wire.vehicle().mode(), Mode::Offboard);
    wire.run(400);
    let (_, heartbeat) = wire.take::<Heartbeat>().pop().unwrap();
    assert_eq!(heartbeat.custom_mode, 6 << 16);
}

/// C-17: the first setpoint and the request for Offboard mode in one write, as MAVSDK's offboard example sends them; also by
/// SET_MODE. A setpoint that the vehicle cannot fly, or that comes behind the request, does not count.
#[test]
fn a_setpoint_right_before_the_request_counts() {
    let still = velocity(0.0, 0.0, 0.0, 0.0);
    let heartbeat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
    let set_mode = |wire: &mut Wire| {
        let (base_mode, custom_mode) = (MavModeFlag::CUSTOM_MODE_ENABLED, Mode::Offboard.number());
        wire.send(TELEMETRY, &SetMode { target_system: 1, base_mode, custom_mode });
        wire.answer(MavCmd(11)).result
    };
    let by_command = |wire: &mut Wire| wire.long(MavCmd::DO_SET_MODE, &OFFBOARD);
    for ask in [set_mode, by_command] {
        let mut wire = Wire::airborne();
        wire.send(TELEMETRY, &heartbeat);
        wire.send(TELEMETRY, &still);
        assert_eq!(ask(&mut wire), MavResult::ACCEPTED);
        keep_sending(&mut wire, 400, &velocity(2.0, 0.0, 0.0, 0.0));
        assert_eq!(wire.vehicle().mode(), Mode::Offboard);
        assert!(wire.vehicle().velocity().north > 0.1);
    }
    let body = SetPositionTargetLocalNed { coordinate_frame: MavFrame::BODY_NED, ..still };
    let mut wire = Wire::airborne();
    wire.send(TELEMETRY, &heartbeat);
    wire.send(TELEMETRY, &body);
    assert_eq!(by_command(&mut wire), MavResult::TEMPORARILY_REJECTED);
    // Between the passes of a slow flight loop, the newest setpoint counts.
    keep_sending(&mut wire, 100, &still);
    wire.send(TELEMETRY, &body);
    assert_eq!(by_command(&mut wire), MavResult::TEMPORARILY_REJECTED);
    let mut wire = Wire::airborne();
    wire.send(TELEMETRY, &heartbeat);
    wire.send(TELEMETRY, &command_long(1, MavCmd::DO_SET_MODE, &OFFBOARD));
    wire.send(TELEMETRY, &still);
    assert_eq!(wire.answer(MavCmd::DO_SET_MODE).result, MavResult::TEMPORARILY_REJECTED);
}

/// C-17: the flight of MAVSDK's offboard example for positions: on the ground, it sends a setpoint and asks for Offboard mode
/// at once, then climbs.
#[test]
fn the_offboard_example_of_mavsdk_flies() {
    let mut wire = Wire::booted();
    wire.send(TELEMETRY, &Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() });
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    wire.send(TELEMETRY, &position(0.0, 0.0, 0.0, 0.0));
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::ACCEPTED);
    keep_sending(&mut wire, 10_000, &position(0.0, 0.0, -5.0, 0.0));
    assert!((wire.height() - 5.0).abs() < 0.2, "{}", wire.height());
    keep_sending(&mut wire, 10_000, &position(5.0, 0.0, -5.0, 1.5));
    let place = wire.vehicle().local_position();
    assert!(place.distance(Vector { north: 5.0, east: 0.0, down: -5.0 }) < 0.3, "{place:?}");
    keep_sending(&mut wire, 10_000, &position(0.0, 10.0, 0.0, 3.0));
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &[129.0, 4.0, 3.0]), MavResult::ACCEPTED);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// J-8: what the vehicle cannot fly does not start Offboard mode: attitudes, accelerations, frames of the body.
#[test]
fn setpoints_that_it_cannot_fly_are_refused() {
    let body = SetPositionTargetLocalNed { coordinate_frame: MavFrame::BODY_NED, ..velocity(1.0, 0.0, 0.0, 0.0) };
    let acceleration = SetPositionTargetLocalNed { afx: 1.0, ..local(PositionTargetTypemask(0b1100_0011_1111)) };
    let nothing = local(PositionTargetTypemask(0xDFF));
    let half = SetPositionTargetLocalNed { x: 1.0, ..local(PositionTargetTypemask(0xDFE)) };
    for message in [body, acceleration, nothing, half] {
        let mut wire = Wire::airborne();
        keep_sending(&mut wire, 1_200, &message);
        assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::TEMPORARILY_REJECTED, "{message:?}");
    }
    let mut wire = Wire::airborne();
    let attitude = SetAttitudeTarget { q: [1.0, 0.0, 0.0, 0.0], thrust: 0.5, target_system: 1, ..Default::default() };
    keep_sending(&mut wire, 1_200, &attitude);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::TEMPORARILY_REJECTED);
    // On the way, such a setpoint ends the mode.
    let mut wire = in_offboard_flight();
    wire.send(TELEMETRY, &attitude);
    wire.run(20);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// J-7: when the setpoints expire the vehicle holds, with a text. It does not resume by itself.
#[test]
fn lost_setpoints_make_it_hold() {
    let mut wire = in_offboard_flight();
    keep_sending(&mut wire, 4_000, &velocity(5.0, 0.0, 0.0, 0.0));
    assert!((wire.vehicle().velocity().north - 5.0).abs() < 0.1);
    let lost = wire.millis;
    wire.until("holding", 2, |vehicle| vehicle.mode() == Mode::Hold);
    assert!((400..520).contains(&(wire.millis - lost)), "{} ms", wire.millis - lost);
    wire.run(5_000);
    let Vector { north, east, down } = wire.vehicle().velocity();
    assert!(north.abs() < 0.05 && east.abs() < 0.05 && down.abs() < 0.05);
    assert_eq!(wire.texts(), ["Setpoints lost: holding"]);
    keep_sending(&mut wire, 1_000, &velocity(5.0, 0.0, 0.0, 0.0));
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// J-8: positions with a heading, velocities with a yaw rate, and both together, in LOCAL_NED.
#[test]
fn local_setpoints_are_flown() {
    let mut wire = in_offboard_flight();
    keep_sending(&mut wire, 9_000, &position(12.0, -6.0, -14.0, 1.0));
    let place = wire.vehicle().local_position();
    assert!(place.distance(Vector { north: 12.0, east: -6.0, down: 0.0 }) < 0.2, "{place:?}");
    assert!((place.down + 14.0).abs() < 0.2, "{place:?}");
    assert!((heading(&wire) - 57.3).abs() < 0.5, "{}", heading(&wire));

    keep_sending(&mut wire, 4_000, &velocity(0.0, 3.0, -1.0, 0.2));
    let Vector { north, east, down } = wire.vehicle().velocity();
    assert!(north.abs() < 0.05 && (east - 3.0).abs() < 0.05 && (down + 1.0).abs() < 0.05, "{north} {east} {down}");
    assert!((heading(&wire) - 57.3 - 45.8).abs() < 2.0, "0.8 rad later: {}", heading(&wire));
    // Without yaw and yaw rate it keeps the heading, and a position of north and east alone keeps the height.
    let (turned, height) = (heading(&wire), wire.height());
    keep_sending(
        &mut wire,
        9_000,
        &SetPositionTargetLocalNed { x: -3.0, y: 4.0, ..local(PositionTargetTypemask(0xDFC)) },
    );
    assert!(wire.vehicle().local_position().distance(Vector { north: -3.0, east: 4.0, down: 0.0 }) < 0.2);
    assert!((heading(&wire) - turned).abs() < 1.0 && (wire.height() - height).abs() < 0.5);
    // A velocity beside a position is a hint.
    let both = SetPositionTargetLocalNed {
        vx: 9.0,
        type_mask: PositionTargetTypemask(0xDC0),
        ..position(0.0, 0.0, -5.0, 0.0)
    };
    keep_sending(&mut wire, 9_000, &both);
    assert!(wire.vehicle().local_position().distance(Vector::ZERO) < 0.2 && (wire.height() - 5.0).abs() < 0.2);
}

/// J-8: positions on the globe, above home and above the sea.
#[test]
fn global_setpoints_are_flown() {
    let mut wire = in_offboard_flight();
    for (frame, alt) in [
        (MavFrame::GLOBAL_RELATIVE_ALT_INT, 8.0),
        (MavFrame::GLOBAL_INT, 488.0 + 12.0),
        (MavFrame::GLOBAL_TERRAIN_ALT_INT, 30.0),
    ] {
        let message = SetPositionTargetGlobalInt {
            // 10 m north.
            lat_int: 473_977_420 + 898,
            lon_int: 85_455_940,
            alt,
            target_system: 1,
            target_component: 1,
            coordinate_frame: frame,
            type_mask: POSITION,
            ..Default::default()
        };
        keep_sending(&mut wire, 8_000, &message);
        if frame == MavFrame::GLOBAL_TERRAIN_ALT_INT {
            assert_eq!(wire.vehicle().mode(), Mode::Hold, "no terrain data");
            continue;
        }
        assert_eq!(wire.vehicle().mode(), Mode::Offboard);
        let expected = Vector { north: 10.0, east: 0.0, down: 0.0 };
        assert!(wire.vehicle().local_position().distance(expected) < 0.2, "{:?}", wire.vehicle().local_position());
        assert!((wire.height() - if alt > 100.0 { 12.0 } else { 8.0 }).abs() < 0.2, "{}", wire.height());
    }
}

/// Takes off and lands by setpoints. A disarmed vehicle stays on the ground. Extreme numbers move it no faster than its limits.
#[test]
fn takeoff_and_landing_by_setpoints() {
    let mut wire = Wire::booted();
    keep_sending(&mut wire, 1_200, &position(0.0, 0.0, -5.0, 0.0));
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::ACCEPTED);
    keep_sending(&mut wire, 1_000, &position(0.0, 0.0, -5.0, 0.0));
    assert_eq!(wire.height(), 0.0, "not armed");
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    keep_sending(&mut wire, 6_000, &position(0.0, 0.0, -5.0, 0.0));
    assert!((wire.height() - 5.0).abs() < 0.2, "{}", wire.height());
    for extreme in [f32::MAX, -f32::MAX] {
        keep_sending(&mut wire, 300, &velocity(extreme, -extreme, extreme, extreme));
        keep_sending(&mut wire, 300, &position(extreme, -extreme, extreme, extreme));
        let Vector { north, east, down } = wire.vehicle().velocity();
        assert!(north.abs() < 2.0 && east.abs() < 2.0 && (-3.0..=2.0).contains(&down), "{north} {east} {down}");
    }
    keep_sending(&mut wire, 15_000, &velocity(0.0, 0.0, 1.0, 0.0));
    assert!(wire.vehicle().is_landed() && wire.vehicle().is_armed());
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[0.0]), MavResult::ACCEPTED);
}

/// J-6: a parameter selects the sender. The companion computer is followed only if it is named there.
#[test]
fn only_the_permitted_sender_is_followed() {
    let enter = |wire: &mut Wire| {
        wire.send(COMPANION, &velocity(0.0, 0.0, 0.0, 0.0));
        wire.run(20);
        wire.long(MavCmd::DO_SET_MODE, &OFFBOARD)
    };
    let mut wire = Wire::airborne();
    assert_eq!(enter(&mut wire), MavResult::TEMPORARILY_REJECTED);
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::MAV_GCS_SYSID, 255));
    wire.run(20);
    assert_eq!(enter(&mut wire), MavResult::ACCEPTED);
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::MAV_GCS_SYSID, 254));
    wire.run(20);
    assert_eq!(wire.vehicle().mode(), Mode::Hold, "the present sender is not permitted any more");
}

/// The fence also applies to offboard flight.
#[test]
fn the_fence_stops_offboard_flight() {
    let mut wire = in_offboard_flight();
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::GF_MAX_HOR_DIST, 30.0));
    keep_sending(&mut wire, 10_000, &velocity(8.0, 0.0, 0.0, 0.0));
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
    let north = wire.vehicle().local_position().north;
    assert!((25.0..30.0).contains(&north), "{north}");
    assert_eq!(wire.texts(), ["Holding at the fence"]);
}

/// L-16: offboard flight may start on the ground, so the mode is refused there by satellite.
#[test]
fn offboard_mode_on_the_ground_is_refused_by_satellite() {
    let mut wire = Wire::booted();
    keep_sending(&mut wire, 1_200, &position(0.0, 0.0, -5.0, 0.0));
    assert_eq!(wire.long_by(SATELLITE, 1, MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::DENIED);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &OFFBOARD), MavResult::ACCEPTED);
}
