//! Commands as MAVSDK, QGroundControl and MAVProxy send them: their effects, and their refusals.

use crate::support::waypoint;
use crate::support::wire::{NORMAL, Wire, command_long};
use mavstack::dialect::*;
use mavstack_demo::{COMPANION, Mode, TELEMETRY, Tuning, Vector};

const NAN: f32 = f32::NAN;
const HOME: (i32, i32) = (473_977_420, 85_455_940);
/// One metre in 1e-7 degrees of latitude.
const METRE: f32 = 1.0 / 0.011_131_95;

/// Returns the position `metres` north of home.
fn north(metres: f32) -> (i32, i32) {
    (HOME.0 + (metres * METRE) as i32, HOME.1)
}

fn distance(wire: &Wire, north: f32) -> f32 {
    wire.vehicle().local_position().distance(Vector { north, ..Vector::ZERO })
}

fn heading(wire: &Wire) -> f32 {
    let [_, _, yaw] = wire.vehicle().attitude();
    yaw.to_degrees().rem_euclid(360.0)
}

/// MAVSDK's goto_location: COMMAND_INT, altitude above mean sea level, yaw in radians, NaN for omitted values. The vehicle
/// then holds.
#[test]
fn mavsdk_goto() {
    let mut wire = Wire::airborne();
    let (x, y) = north(40.0);
    let params = [NAN, 1.0, NAN, 90_f32.to_radians()];
    let result = wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL_INT, params, x, y, 508.0);
    assert_eq!(result, MavResult::ACCEPTED);
    wire.run(15_000);
    assert!(distance(&wire, 40.0) < 0.5 && (wire.height() - 20.0).abs() < 0.3, "{:?}", wire.vehicle());
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
    assert!((heading(&wire) - 90.0).abs() < 1.0, "{}", heading(&wire));
}

/// QGroundControl's goto, pause and altitude change: COMMAND_INT or COMMAND_LONG, -1 for the speed, NaN for the position.
#[test]
fn qgroundcontrol_goto_pause_and_altitude_change() {
    let mut wire = Wire::airborne();
    let (x, y) = north(60.0);
    let goto = [-1.0, 1.0, 0.0, NAN];
    assert_eq!(wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL, goto, x, y, 498.0), MavResult::ACCEPTED);
    wire.run(5_000);
    let stop = [-1.0, 1.0, 0.0, NAN, NAN, NAN, NAN];
    assert_eq!(wire.long(MavCmd::DO_REPOSITION, &stop), MavResult::ACCEPTED);
    wire.run(5_000);
    let place = wire.vehicle().local_position();
    assert!((10.0..50.0).contains(&place.north) && wire.vehicle().velocity().north.abs() < 0.05, "{place:?}");
    let climb = [-1.0, 1.0, 0.0, NAN, NAN, NAN, 518.0];
    assert_eq!(wire.long(MavCmd::DO_REPOSITION, &climb), MavResult::ACCEPTED);
    wire.run(10_000);
    assert!((wire.height() - 30.0).abs() < 0.3 && wire.vehicle().local_position().distance(place) < 0.3);
    // "Not given" in a COMMAND_INT (C-7).
    let int = wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL_RELATIVE_ALT, goto, i32::MAX, i32::MAX, 12.0);
    assert_eq!(int, MavResult::ACCEPTED);
    wire.run(12_000);
    assert!((wire.height() - 12.0).abs() < 0.3 && wire.vehicle().local_position().distance(place) < 0.3);
}

/// M-49: the vehicle has no model of the terrain, so it refuses every command with an altitude above the terrain.
#[test]
fn altitude_above_terrain_is_refused() {
    let mut wire = Wire::airborne();
    let (x, y) = north(10.0);
    for command in [
        MavCmd::DO_REPOSITION,
        MavCmd::DO_SET_HOME,
        MavCmd::NAV_TAKEOFF,
        MavCmd::NAV_LAND,
        MavCmd::DO_SET_ROI_LOCATION,
        MavCmd::DO_SET_ROI,
    ] {
        for frame in [MavFrame::GLOBAL_TERRAIN_ALT, MavFrame::GLOBAL_TERRAIN_ALT_INT] {
            let params = if command == MavCmd::DO_SET_ROI { [3.0, 0.0, 0.0, 0.0] } else { [0.0; 4] };
            let result = wire.int(command, frame, params, x, y, 20.0);
            assert_eq!(result, MavResult::COMMAND_UNSUPPORTED_MAV_FRAME, "{command:?} {frame:?}");
        }
    }
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// M-48: a mission from another site, uploaded before the fix, counts as not checked: no way starts it until the position is
/// known, and then it is too far away. Resuming past item 0 is not checked.
#[test]
fn mission_from_another_site_does_not_start() {
    const FAR: &str = "Mission item 0: more than 10000 m away";
    const MISSION: [f32; 3] = [1.0, 4.0, 4.0];
    let mut wire = Wire::new();
    wire.run(100);
    wire.upload(&[waypoint(-10_050.0, 0.0), waypoint(10.0, 0.0)]);
    assert!(!wire.vehicle().has_fix());
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &MISSION), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(wire.long(MavCmd::MISSION_START, &[0.0]), MavResult::TEMPORARILY_REJECTED);
    assert!(wire.texts().contains(&"Mission refused: no position yet".to_owned()));
    wire.run(3_000);
    assert!(wire.vehicle().has_fix());
    assert!(wire.texts().contains(&FAR.to_owned()), "checked when the position is known");
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    wire.run(5_000);
    wire.texts();
    assert_eq!(wire.long(MavCmd::MISSION_START, &[0.0]), MavResult::DENIED);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &MISSION), MavResult::DENIED);
    assert!(wire.texts().contains(&FAR.to_owned()));
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
    assert_eq!(wire.long(MavCmd::DO_SET_MISSION_CURRENT, &[1.0]), MavResult::ACCEPTED);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &MISSION), MavResult::ACCEPTED);
}

/// C-5 to C-9: checks of form, frame, parameters and state.
#[test]
fn goto_to_an_invalid_position_is_refused() {
    let mut wire = Wire::airborne();
    let (x, y) = north(10.0);
    let denied = MavResult::DENIED;
    for (frame, params, x, y, z, result) in [
        (MavFrame::LOCAL_NED, [NAN, 1.0, NAN, NAN], x, y, 500.0, MavResult::COMMAND_UNSUPPORTED_MAV_FRAME),
        (MavFrame::GLOBAL_TERRAIN_ALT, [NAN, 1.0, NAN, NAN], x, y, 20.0, MavResult::COMMAND_UNSUPPORTED_MAV_FRAME),
        (MavFrame::GLOBAL, [NAN, 1.0, NAN, NAN], x, y, 400.0, denied),
        (MavFrame::GLOBAL, [26.0, 1.0, NAN, NAN], x, y, 500.0, denied),
        // Relative yaw is not idempotent: a duplicate would turn twice as far.
        (MavFrame::GLOBAL, [NAN, 3.0, NAN, 1.0], x, y, 500.0, denied),
        (MavFrame::GLOBAL, [NAN, 1.0, NAN, f32::INFINITY], x, y, 500.0, denied),
        // Half a position; the bits of a NaN (C-7).
        (MavFrame::GLOBAL, [NAN, 1.0, NAN, NAN], i32::MAX, y, 500.0, denied),
        (MavFrame::GLOBAL, [NAN, 1.0, NAN, NAN], 0x7FC0_0000, 0x7FC0_0000, 500.0, denied),
    ] {
        assert_eq!(wire.int(MavCmd::DO_REPOSITION, frame, params, x, y, z), result, "{frame:?} {params:?} {x} {y} {z}");
    }
    wire.run(2_000);
    assert!(distance(&wire, 0.0) < 0.1);
    // The stack sends at most one explanation a second.
    assert_eq!(wire.texts(), ["Command 192 refused: frame not supported", "Goto refused: below ground"]);
    let goto =
        |wire: &mut Wire, flags| wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL, [NAN, flags, NAN, NAN], x, y, 500.0);
    wire.long(MavCmd::NAV_LAND, &[]);
    assert_eq!(goto(&mut wire, 0.0), MavResult::TEMPORARILY_REJECTED, "without CHANGE_MODE the mode must stay");
    assert_eq!(goto(&mut wire, 1.0), MavResult::ACCEPTED);
    wire.long(MavCmd::NAV_LAND, &[]);
    wire.until("down", 60, |vehicle| !vehicle.is_armed());
    assert_eq!(goto(&mut wire, 1.0), MavResult::TEMPORARILY_REJECTED);
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    assert_eq!(goto(&mut wire, 1.0), MavResult::TEMPORARILY_REJECTED);
    let texts = [
        "Goto refused: not in Hold mode",
        "Landed, disarmed",
        "Command refused: not armed",
        "Goto refused: on the ground",
    ];
    assert_eq!(wire.texts(), texts);
}

/// The fence stops a goto like any other flight. Home cannot move if the fence around it would then exclude the vehicle.
#[test]
fn goto_stops_at_the_fence() {
    let mut wire = Wire::airborne();
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::GF_MAX_HOR_DIST, 30.0));
    let (x, y) = north(60.0);
    let goto = [NAN, 1.0, NAN, NAN];
    assert_eq!(wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL_INT, goto, x, y, 498.0), MavResult::ACCEPTED);
    wire.run(12_000);
    let north = wire.vehicle().local_position().north;
    assert!((28.0..30.0).contains(&north), "{north}");
    assert_eq!(wire.texts(), ["Holding at the fence"]);
    let home = wire.int(MavCmd::DO_SET_HOME, MavFrame::GLOBAL, [0.0; 4], x + 10_000, y, 488.0);
    assert_eq!(home, MavResult::DENIED);
    assert_eq!(wire.texts(), ["Home refused: its fence excludes the vehicle"]);
    assert_eq!(wire.int(MavCmd::DO_SET_HOME, MavFrame::GLOBAL, [0.0; 4], x, y, 488.0), MavResult::DENIED);
    assert_eq!(
        wire.long(MavCmd::DO_SET_HOME, &[1.0]),
        MavResult::ACCEPTED,
        "the vehicle is within the fence around its own position"
    );
}

/// Takeoff and landing set the heading in degrees; NaN keeps it.
#[test]
fn takeoff_and_landing_set_the_heading() {
    let mut wire = Wire::booted();
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    assert_eq!(wire.long(MavCmd::NAV_TAKEOFF, &[0.0, 0.0, 0.0, 200.0, 0.0, 0.0, 10.0]), MavResult::ACCEPTED);
    wire.run(10_000);
    assert!((heading(&wire) - 200.0).abs() < 1.0, "{}", heading(&wire));
    wire.long(MavCmd::NAV_LAND, &[]);
    wire.run(2_000);
    assert!((heading(&wire) - 200.0).abs() < 1.0, "{}", heading(&wire));
    wire.long(MavCmd::NAV_LAND, &[0.0, 0.0, 0.0, 270.0]);
    wire.run(3_000);
    assert!((heading(&wire) - 270.0).abs() < 1.0, "{}", heading(&wire));
}

/// MAVSDK's set_current_speed, and the speed of a goto.
#[test]
fn speed_follows_the_commands() {
    let mut wire = Wire::airborne();
    let (x, y) = north(400.0);
    let speed = |wire: &mut Wire, speed| wire.long(MavCmd::DO_CHANGE_SPEED, &[1.0, speed, -1.0, 0.0]);
    let fly = |wire: &mut Wire, speed| {
        let result = wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL_INT, [speed, 1.0, NAN, NAN], x, y, 498.0);
        assert_eq!(result, MavResult::ACCEPTED);
        wire.run(6_000);
        wire.vehicle().velocity().north
    };
    assert!((fly(&mut wire, NAN) - 8.0).abs() < 0.1);
    assert_eq!(speed(&mut wire, 3.5), MavResult::ACCEPTED);
    assert!((fly(&mut wire, NAN) - 3.5).abs() < 0.1, "the speed persists");
    assert!((fly(&mut wire, 6.0) - 6.0).abs() < 0.1);
    for bad in [0.0, -0.5, -3.0, 26.0, NAN] {
        assert_eq!(speed(&mut wire, bad), MavResult::DENIED, "{bad}");
    }
    assert_eq!(
        wire.long(MavCmd::DO_CHANGE_SPEED, &[2.0, 3.0, -1.0]),
        MavResult::DENIED,
        "climb speed is not supported"
    );
    assert_eq!(wire.long(MavCmd::DO_CHANGE_SPEED, &[1.0, 3.0, 50.0]), MavResult::DENIED, "throttle is not supported");
    assert_eq!(speed(&mut wire, -1.0), MavResult::ACCEPTED);
    assert!((fly(&mut wire, -1.0) - 6.0).abs() < 0.1);
    assert_eq!(speed(&mut wire, -2.0), MavResult::ACCEPTED);
    assert!((fly(&mut wire, -1.0) - 8.0).abs() < 0.1, "the default");
}

/// MAVSDK's takeoff, land and return_to_launch. C-1: a broadcast takeoff is refused.
#[test]
fn mavsdk_takeoff_return_and_land() {
    let mut wire = Wire::booted();
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    assert_eq!(wire.long_by(TELEMETRY, 0, MavCmd::NAV_TAKEOFF, &[]), MavResult::DENIED);
    assert_eq!(wire.long(MavCmd::NAV_TAKEOFF, &[NAN, NAN, NAN, NAN, NAN, NAN, 7.0]), MavResult::ACCEPTED);
    wire.until("up", 20, |vehicle| vehicle.mode() == Mode::Hold);
    assert!((wire.height() - 7.0).abs() < 0.6, "above home: {}", wire.height());
    let (x, y) = north(20.0);
    wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL_INT, [NAN, 1.0, NAN, NAN], x, y, 500.0);
    wire.run(10_000);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &[129.0, 4.0, 5.0]), MavResult::ACCEPTED);
    wire.until("home", 60, |vehicle| !vehicle.is_armed());
    assert!(distance(&wire, 0.0) < 1.0);
    let mut wire = Wire::airborne();
    assert_eq!(wire.long(MavCmd::NAV_LAND, &[NAN, 2.0]), MavResult::DENIED, "no beacon");
    assert_eq!(wire.long(MavCmd::NAV_LAND, &[]), MavResult::ACCEPTED);
    assert_eq!(wire.vehicle().mode(), Mode::Land);
}

/// A return is refused on the ground, because it would begin with a takeoff.
#[test]
fn return_does_not_take_off() {
    let mut wire = Wire::airborne();
    let (x, y) = north(30.0);
    wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL, [NAN, 1.0, NAN, NAN], x, y, 498.0);
    wire.run(10_000);
    wire.long(MavCmd::NAV_LAND, &[]);
    wire.until("down", 60, |vehicle| !vehicle.is_armed());
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    wire.texts();
    assert_eq!(wire.long(MavCmd::NAV_RETURN_TO_LAUNCH, &[]), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &[129.0, 4.0, 5.0]), MavResult::TEMPORARILY_REJECTED);
    wire.run(3_000);
    assert!(wire.vehicle().is_landed());
    assert_eq!(wire.texts(), ["Return refused: on the ground"]);
}

/// C-31, C-9, C-1: arming accepts 0 or 1 only, and every refusal sends its reason.
#[test]
fn arming_refusals_send_the_reason() {
    let arm = MavCmd::COMPONENT_ARM_DISARM;
    let mut wire = Wire::new();
    wire.run(1_000);
    assert_eq!(wire.long(arm, &[1.0]), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(wire.long(MavCmd::RUN_PREARM_CHECKS, &[]), MavResult::ACCEPTED);
    wire.run(2_000);
    assert_eq!(wire.texts(), ["Arming refused: no GPS fix yet"], "once within two seconds");
    assert_eq!(wire.long(MavCmd::RUN_PREARM_CHECKS, &[]), MavResult::ACCEPTED);
    for params in [[0.5, 0.0], [2.0, 0.0], [NAN, 0.0], [1.0, 1.0], [1.0, 21_195.0]] {
        assert_eq!(wire.long(arm, &params), MavResult::DENIED, "{params:?}");
    }
    assert_eq!(wire.long_by(TELEMETRY, 0, arm, &[1.0]), MavResult::DENIED);
    assert_eq!(wire.long(arm, &[1.0]), MavResult::ACCEPTED);
    assert_eq!(wire.long(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
    wire.run(3_000);
    assert_eq!(wire.long(arm, &[0.0]), MavResult::TEMPORARILY_REJECTED);
    let texts = [
        "Ready to arm",
        "Command 400 refused: parameter 1 out of range",
        "Arming refused: sent to all vehicles",
        "Disarming refused: in flight",
    ];
    assert_eq!(wire.texts(), texts);
    assert_eq!(wire.long(arm, &[0.0, 21_196.0]), MavResult::ACCEPTED, "MAVSDK's kill");
    wire.run(3_000);
    assert!(wire.vehicle().is_landed() && !wire.vehicle().is_armed());
}

/// MAVSDK's terminate: the motors stay off until the next boot.
#[test]
fn flight_termination_is_permanent() {
    let mut wire = Wire::airborne();
    assert_eq!(wire.long_by(TELEMETRY, 0, MavCmd::DO_FLIGHTTERMINATION, &[1.0]), MavResult::DENIED);
    assert_eq!(wire.long(MavCmd::DO_FLIGHTTERMINATION, &[0.0]), MavResult::ACCEPTED);
    assert!(wire.vehicle().is_armed());
    for _ in 0..2 {
        assert_eq!(wire.long(MavCmd::DO_FLIGHTTERMINATION, &[1.0]), MavResult::ACCEPTED, "a retransmission too (C-11)");
    }
    wire.run(4_000);
    assert!(wire.vehicle().is_landed() && !wire.vehicle().is_armed());
    let (_, heartbeat) = wire.take::<Heartbeat>().pop().unwrap();
    assert_eq!(heartbeat.system_status, MavState::FLIGHT_TERMINATION);
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0, 21_196.0]), MavResult::FAILED);
    let texts =
        ["Command 185 refused: sent to 0; use system 1", "Flight terminated", "Arming refused: flight terminated"];
    assert_eq!(wire.texts(), texts);
    wire.run(5_000);
    assert_eq!(wire.long(MavCmd::RUN_PREARM_CHECKS, &[]), MavResult::ACCEPTED);
    assert_eq!(wire.texts(), ["Arming refused: flight terminated"]);
    let (_, status) = wire.take::<SysStatus>().pop().unwrap();
    assert!(!status.onboard_control_sensors_health.contains(MavSysStatusSensor::PREARM_CHECK));
}

/// O-6: HOME_POSITION is sent when home is first known and when it is set. A return flies to the new home.
#[test]
fn home_is_announced_and_used() {
    let mut wire = Wire::new();
    wire.run(1_500);
    assert_eq!(wire.long(MavCmd::GET_HOME_POSITION, &[]), MavResult::DENIED, "home is not known yet");
    assert_eq!(wire.long(MavCmd::DO_SET_HOME, &[1.0]), MavResult::TEMPORARILY_REJECTED);
    wire.run(600);
    for link in NORMAL {
        assert!(wire.count::<HomePosition>(link) >= 1);
    }
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    wire.long(MavCmd::NAV_TAKEOFF, &[]);
    wire.run(6_000);
    let (x, y) = north(50.0);
    wire.take::<HomePosition>();
    let set = |wire: &mut Wire, params, x, y, z| wire.int(MavCmd::DO_SET_HOME, MavFrame::GLOBAL, params, x, y, z);
    assert_eq!(set(&mut wire, [0.0, 0.0, 0.0, NAN], x, y, 485.0), MavResult::ACCEPTED);
    wire.run(10);
    let announced = wire.take::<HomePosition>();
    assert_eq!(announced.len(), NORMAL.len());
    let (_, home) = &announced[0];
    assert!((home.latitude.abs_diff(x), home.longitude, home.altitude) <= (10, y, 485_000), "{home:?}");
    assert!((home.x - 50.0).abs() < 0.1 && home.y.abs() < 0.1 && home.z == 3.0, "{home:?}");
    wire.run(500);
    let (_, position) = wire.take::<GlobalPositionInt>().pop().unwrap();
    assert!((position.alt - position.relative_alt - 485_000).abs() <= 1, "{position:?}");
    // The origin of local coordinates does not move.
    assert_eq!(wire.long(MavCmd::REQUEST_MESSAGE, &[49.0]), MavResult::ACCEPTED);
    wire.run(10);
    let (_, origin) = wire.take::<GpsGlobalOrigin>().pop().unwrap();
    assert_eq!((origin.latitude, origin.longitude, origin.altitude), (HOME.0, HOME.1, 488_000));
    for (params, x, y, z) in [
        ([0.0, 0.0, 0.0, 0.0], i32::MAX, i32::MAX, 485.0),
        ([0.0, 0.0, 0.0, 0.0], x, y, NAN),
        ([0.0, 0.0, 0.0, 0.0], x + 10_000_000, y, 485.0),
        ([0.0, 10.0, 0.0, 0.0], x, y, 485.0),
        ([2.0, 0.0, 0.0, 0.0], x, y, 485.0),
    ] {
        assert_eq!(set(&mut wire, params, x, y, z), MavResult::DENIED, "{params:?} {x} {y} {z}");
    }
    assert_eq!(wire.long(MavCmd::NAV_RETURN_TO_LAUNCH, &[]), MavResult::ACCEPTED);
    wire.until("down", 90, |vehicle| !vehicle.is_armed());
    assert!(distance(&wire, 50.0) < 1.1);
    // The current position, as MAVProxy's and QGroundControl's buttons send it.
    assert_eq!(wire.long(MavCmd::DO_SET_HOME, &[1.0]), MavResult::ACCEPTED);
    wire.run(10);
    let (_, home) = wire.take::<HomePosition>().pop().unwrap();
    assert!((home.x - 50.0).abs() < 1.1 && home.altitude == 488_000, "{home:?}");
}

/// C-12: a relative turn that arrives on two links is executed once; a new command is executed again.
#[test]
fn a_relative_turn_is_not_duplicated_by_a_second_link() {
    let mut wire = Wire::airborne();
    let turn = [40.0, 30.0, 1.0, 1.0];
    assert_eq!(wire.long_by(TELEMETRY, 1, MavCmd::CONDITION_YAW, &turn), MavResult::ACCEPTED);
    wire.run(500);
    assert_eq!(wire.long_by(COMPANION, 1, MavCmd::CONDITION_YAW, &turn), MavResult::ACCEPTED);
    wire.run(3_000);
    assert!((heading(&wire) - 40.0).abs() < 1.0, "{}", heading(&wire));
    assert_eq!(wire.long_by(TELEMETRY, 1, MavCmd::CONDITION_YAW, &turn), MavResult::ACCEPTED);
    wire.run(3_000);
    assert!((heading(&wire) - 80.0).abs() < 1.0, "{}", heading(&wire));
    wire.long(MavCmd::NAV_LAND, &[]);
    assert_eq!(wire.long(MavCmd::CONDITION_YAW, &turn), MavResult::TEMPORARILY_REJECTED);
}

/// C-20, C-30: a reboot cancels a calibration, and the sender of the calibration gets a final result.
#[test]
fn a_reboot_cancels_a_calibration() {
    let mut wire = Wire::booted();
    assert_eq!(wire.long(MavCmd::PREFLIGHT_CALIBRATION, &[1.0, 0.0, 0.0, 0.0, 0.0]), MavResult::IN_PROGRESS);
    wire.send(TELEMETRY, &command_long(1, MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]));
    wire.run(100);
    let acks: Vec<_> = wire.take::<CommandAck>().iter().map(|(_, ack)| (ack.command, ack.result)).collect();
    let calibration = (MavCmd::PREFLIGHT_CALIBRATION, MavResult::CANCELLED);
    assert!(acks.contains(&calibration), "{acks:?}");
    assert!(acks.contains(&(MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, MavResult::ACCEPTED)), "{acks:?}");
}

/// C-20 to C-24: progress at 1 Hz or more, then a final result. Calibration is refused while armed, and arming while
/// calibrating.
#[test]
fn calibration_reports_progress() {
    const CALIBRATE: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
    let mut wire = Wire::booted();
    // QGroundControl's and MAVSDK's gyroscope calibration: zeros for the rest.
    let gyro = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(wire.long(CALIBRATE, &gyro), MavResult::IN_PROGRESS);
    let began = wire.millis;
    assert_eq!(
        wire.long(CALIBRATE, &[0.0, 1.0, 0.0, 0.0, 0.0]),
        MavResult::TEMPORARILY_REJECTED,
        "another calibration"
    );
    for force in [0.0, 21_196.0] {
        assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0, force]), MavResult::TEMPORARILY_REJECTED);
    }
    wire.take::<CommandAck>();
    wire.run(6_000);
    let acks = wire.take::<CommandAck>();
    let ((end, last), progress) = acks.split_last().unwrap();
    assert_eq!((last.command, last.result), (CALIBRATE, MavResult::ACCEPTED));
    assert!((4_900..5_200).contains(&(end - began)), "{}", end - began);
    assert!(progress.iter().all(|(_, ack)| ack.result == MavResult::IN_PROGRESS && ack.progress <= 100));
    assert!(progress.is_sorted_by_key(|(_, ack)| ack.progress) && progress.last().unwrap().1.progress > 90);
    assert!(progress.windows(2).all(|pair| pair[1].0 - pair[0].0 <= 1_000));
    assert_eq!(wire.long(CALIBRATE, &gyro), MavResult::ACCEPTED, "a lost answer is sent again (C-24)");
    wire.run(4_000);
    for params in [[2.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0, 3.0]] {
        assert_eq!(wire.long(CALIBRATE, &params), MavResult::DENIED, "{params:?}");
    }
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    assert_eq!(wire.long(CALIBRATE, &gyro), MavResult::TEMPORARILY_REJECTED);
    let texts = [
        "Calibrating: keep the vehicle still",
        "Command 241 refused: not now; try again later",
        "Arming refused: calibrating",
        "Calibration complete",
        "Command 241 refused: parameter 1 out of range",
        "Calibration refused: armed",
    ];
    assert_eq!(wire.texts(), texts);
}

/// C-23: COMMAND_CANCEL stops a calibration.
#[test]
fn calibration_can_be_cancelled() {
    const CALIBRATE: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
    let mut wire = Wire::booted();
    assert_eq!(wire.long(CALIBRATE, &[0.0, 0.0, 0.0, 0.0, 1.0]), MavResult::IN_PROGRESS);
    wire.run(2_000);
    wire.take::<CommandAck>();
    wire.send(TELEMETRY, &CommandCancel { target_system: 1, target_component: 1, command: CALIBRATE });
    wire.run(3_000);
    let results: Vec<_> = wire.take::<CommandAck>().into_iter().map(|(_, ack)| ack.result).collect();
    assert_eq!(results.last(), Some(&MavResult::CANCELLED));
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    assert_eq!(wire.texts(), ["Calibrating: keep the vehicle still", "Calibration cancelled"]);
}

/// C-23: QGroundControl cancels a calibration with the command itself and all parameters 0, as PX4 expects.
#[test]
fn calibration_can_be_cancelled_by_zeros() {
    const CALIBRATE: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
    let mut wire = Wire::booted();
    assert_eq!(wire.long(CALIBRATE, &[0.0, 0.0, 0.0, 0.0, 1.0]), MavResult::IN_PROGRESS);
    wire.run(1_500);
    wire.take::<CommandAck>();
    wire.send(TELEMETRY, &command_long(1, CALIBRATE, &[0.0; 7]));
    wire.run(3_000);
    let results: Vec<_> = wire.take::<CommandAck>().into_iter().map(|(_, ack)| ack.result).collect();
    assert_eq!(results, [MavResult::CANCELLED, MavResult::ACCEPTED]);
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    assert_eq!(wire.texts(), ["Calibrating: keep the vehicle still", "Calibration cancelled"]);
}

/// C-30: a reboot is acknowledged first, and other commands are refused meanwhile. On a stalled link the wait is bounded.
#[test]
fn reboot_is_acknowledged_first() {
    const REBOOT: MavCmd = MavCmd::PREFLIGHT_REBOOT_SHUTDOWN;
    let mut wire = Wire::booted();
    assert_eq!(wire.long(REBOOT, &[1.0]), MavResult::ACCEPTED);
    assert!(!wire.app.wants_reboot(), "the last bytes may still be in the UART");
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(wire.long(REBOOT, &[1.0]), MavResult::ACCEPTED, "a retransmission (C-11)");
    wire.run(60);
    assert!(wire.app.wants_reboot());

    let mut wire = Wire::booted();
    wire.uarts[0].stall_writes_until(mavstack::Instant::NEVER);
    wire.send(TELEMETRY, &command_long(1, REBOOT, &[1.0]));
    wire.run(900);
    assert!(!wire.app.wants_reboot());
    wire.run(200);
    assert!(wire.app.wants_reboot());
}

/// C-30, SEC-13, C-14: a reboot is refused in flight, needs force when armed, and restarts the autopilot only.
#[test]
fn unsafe_reboots_are_refused() {
    const REBOOT: MavCmd = MavCmd::PREFLIGHT_REBOOT_SHUTDOWN;
    let force = [1.0, NAN, NAN, NAN, NAN, 20_190_226.0];
    let mut wire = Wire::booted();
    assert_eq!(wire.long_by(TELEMETRY, 0, REBOOT, &[1.0]), MavResult::DENIED);
    for params in [[2.0, 0.0], [3.0, 0.0], [1.0, 1.0], [NAN, 0.0], [0.5, 0.0]] {
        assert_eq!(wire.long(REBOOT, &params), MavResult::DENIED, "{params:?}");
    }
    assert_eq!(wire.long(REBOOT, &[0.0]), MavResult::ACCEPTED, "0 requests nothing");
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    assert_eq!(wire.long(REBOOT, &[1.0]), MavResult::TEMPORARILY_REJECTED);
    wire.long(MavCmd::NAV_TAKEOFF, &[]);
    wire.run(4_000);
    assert_eq!(wire.long(REBOOT, &force), MavResult::TEMPORARILY_REJECTED);
    wire.run(2_000);
    assert!(!wire.app.wants_reboot());
    let texts = ["Command 246 refused: sent to 0; use system 1", "Reboot refused: armed", "Reboot refused: in flight"];
    assert_eq!(wire.texts(), texts);
    let mut wire = Wire::booted();
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    assert_eq!(wire.long(REBOOT, &force), MavResult::ACCEPTED);
    wire.run(100);
    assert!(wire.app.wants_reboot() && !wire.vehicle().is_armed());
}

/// T-1, T-2: PING and TIMESYNC are answered.
#[test]
fn time_requests_are_answered() {
    let mut wire = Wire::booted();
    wire.send(TELEMETRY, &Ping { time_usec: 77, seq: 5, ..Ping::default() });
    wire.send(TELEMETRY, &Timesync { ts1: 99, ..Timesync::default() });
    wire.run(20);
    // The requests were forwarded to the companion too, because they are broadcasts.
    wire.received.retain(|frame| frame.link == TELEMETRY);
    let pings = wire.take::<Ping>();
    assert!(matches!(pings[..], [(_, Ping { time_usec: 77, seq: 5, target_system: 255, .. })]), "{pings:?}");
    let answers = wire.take::<Timesync>();
    let [(_, answer)] = &answers[..] else { panic!("{answers:?}") };
    assert_eq!((answer.ts1, answer.tc1 / 1_000_000), (99, wire.millis as i64 - 20 + 1));
}
