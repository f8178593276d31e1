//! Basic flight of the demo vehicle in simulated time.

use crate::support::{Flight, HOME, command, waypoint};
use mavstack::command::CommandPosition;
use mavstack::dialect::{MavCmd, MavFrame, MavModeFlag, MavResult, MavState};
use mavstack::{Command, Vehicle};
use mavstack_demo::Mode;

#[test]
fn arming_needs_a_gps_fix() {
    let mut flight = Flight::new();
    flight.run(1_900);
    assert_eq!(flight.vehicle.global_position(), None);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(flight.texts(), ["Arming refused: no GPS fix yet"]);
    assert_eq!(flight.vehicle.state().unwrap().system_status, MavState::BOOT);
    flight.run(200);
    assert_eq!(flight.vehicle.global_position().map(|position| (position.latitude, position.longitude)), Some(HOME));
    assert_eq!(flight.vehicle.state().unwrap().system_status, MavState::STANDBY);
    for _ in 0..2 {
        assert_eq!(
            flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]),
            MavResult::ACCEPTED,
            "a retransmission too (C-11)"
        );
    }
    let state = flight.vehicle.state().unwrap();
    assert!(state.base_mode.contains(MavModeFlag::SAFETY_ARMED));
    assert_eq!(state.system_status, MavState::ACTIVE);
}

#[test]
fn disarming_in_flight_needs_force() {
    let mut flight = Flight::airborne();
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0]), MavResult::TEMPORARILY_REJECTED);
    assert!(flight.vehicle.is_armed());
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0, 21_196.0]), MavResult::ACCEPTED);
    flight.run(2_000);
    assert!(flight.vehicle.is_landed() && !flight.vehicle.is_armed());
}

#[test]
fn takes_off_holds_and_lands() {
    let mut flight = Flight::armed();
    assert_eq!(
        flight.command(MavCmd::NAV_TAKEOFF, &[0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, 5.0]),
        MavResult::ACCEPTED
    );
    flight.until("up", 10, |vehicle| vehicle.mode() == Mode::Hold);
    flight.run(20_000);
    assert!((flight.height() - 5.0).abs() < 0.05, "{}", flight.height());
    assert_eq!(flight.command(MavCmd::NAV_LAND, &[]), MavResult::ACCEPTED);
    flight.until("down", 30, |vehicle| !vehicle.is_armed());
    assert!(flight.vehicle.is_landed());
    assert_eq!(flight.command(MavCmd::NAV_LAND, &[]), MavResult::ACCEPTED, "already landed (C-11)");
}

/// The altitude of COMMAND_LONG, which has no frame, is above home. COMMAND_INT names its frame (C-6, C-7).
#[test]
fn takeoff_altitude_follows_its_frame() {
    let table = [
        (MavFrame::GLOBAL, 500.0, MavResult::ACCEPTED, 12.0),
        (MavFrame::GLOBAL_RELATIVE_ALT, 7.0, MavResult::ACCEPTED, 7.0),
        (MavFrame::GLOBAL, 100.0, MavResult::DENIED, 0.0),
    ];
    for (frame, z, result, height) in table {
        let mut flight = Flight::armed();
        let position = CommandPosition::Int { frame, x: i32::MAX, y: i32::MAX };
        let command = Command { position, z, ..command(MavCmd::NAV_TAKEOFF, [f32::NAN; 4]) };
        assert_eq!(flight.send(command), result, "{frame:?} {z}");
        flight.run(10_000);
        assert!((flight.height() - height).abs() < 0.6, "{frame:?} {z}: {}", flight.height());
    }
}

#[test]
fn flight_commands_need_an_armed_vehicle() {
    let mut flight = Flight::new();
    flight.run(2_500);
    flight.upload(&[waypoint(0.0, 0.0)]);
    for id in [MavCmd::NAV_TAKEOFF, MavCmd::NAV_RETURN_TO_LAUNCH] {
        assert_eq!(flight.command(id, &[]), MavResult::TEMPORARILY_REJECTED, "{id:?}");
    }
    assert_eq!(flight.start(None, None), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(flight.command(MavCmd::DO_REPEAT_SERVO, &[]), MavResult::UNSUPPORTED);
}

#[test]
fn the_battery_drains_faster_in_flight_and_warns_when_low() {
    let mut flight = Flight::armed();
    // Shorter than the time after which the vehicle disarms on the ground.
    let before = flight.vehicle.battery().remaining;
    flight.run(9_000);
    let ground = before - flight.vehicle.battery().remaining;
    flight.command(MavCmd::NAV_TAKEOFF, &[]);
    flight.run(5_000);
    let before = flight.vehicle.battery().remaining;
    flight.run(9_000);
    assert!(before - flight.vehicle.battery().remaining > 3.0 * ground && ground > 0.0);
    flight.until("low", 1_200, |vehicle| vehicle.battery().remaining < 0.15);
    assert_eq!(flight.texts(), ["Battery low"]);
    assert_eq!(flight.vehicle.state().unwrap().system_status, MavState::CRITICAL);
}

/// The same input gives the same flight, whatever the loop rate.
#[test]
fn flights_are_deterministic() {
    let fly = |period: u64| {
        let mut flight = Flight::flying(&[waypoint(22.0, 8.0), waypoint(0.0, 4.0)]);
        for _ in 0..20_000 / period {
            flight.step(period);
        }
        (flight.vehicle.local_position(), flight.vehicle.attitude(), flight.vehicle.battery())
    };
    assert_eq!(fly(1), fly(1));
    assert_eq!(fly(1), fly(5));
}
