//! The demo vehicle's parameters: each one affects its behaviour.

use crate::support::wire::Wire;
use crate::support::{Flight, HOME, waypoint};
use mavstack::dialect::*;
use mavstack::param::{ParamTable, ParamType};
use mavstack::{Param, Vehicle};
use mavstack_demo::{Mode, TELEMETRY, Tuning};

fn set<T: ParamType>(flight: &mut Flight, param: Param<Tuning, T>, value: T) {
    assert!(flight.stack.parameters_mut().set(param, value), "out of range");
}

fn get<T: ParamType>(flight: &Flight, param: Param<Tuning, T>) -> T {
    flight.stack.parameters().get(param)
}

/// Returns an armed vehicle with modified parameters.
fn armed(tune: impl FnOnce(&mut Flight)) -> Flight {
    let mut flight = Flight::new();
    tune(&mut flight);
    flight.run(2_500);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    flight
}

/// Returns a hovering vehicle with modified parameters.
fn airborne(tune: impl FnOnce(&mut Flight)) -> Flight {
    let mut flight = armed(tune);
    assert_eq!(flight.command(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
    flight.until("up", 60, |vehicle| vehicle.mode() == Mode::Hold);
    flight
}

/// Lands, and returns how long it took (s).
fn landing_time(flight: &mut Flight) -> f32 {
    assert_eq!(flight.command(MavCmd::NAV_LAND, &[]), MavResult::ACCEPTED);
    let start = flight.millis;
    flight.until("down", 120, |vehicle| vehicle.is_landed());
    (flight.millis - start) as f32 / 1_000.0
}

/// P-19: every client can read and set these two types. They are PX4's too.
#[test]
fn the_table_has_the_types_that_every_client_sets() {
    assert!(Tuning::INFO.len() >= 30);
    for info in Tuning::INFO {
        assert!([MavParamType::INT32, MavParamType::REAL32].contains(&info.param_type()), "{}", info.name());
    }
}

#[test]
fn takeoff_and_landing_follow_the_parameters() {
    let mut flight = airborne(|flight| {
        set(flight, Tuning::MIS_TAKEOFF_ALT, 24.0);
        set(flight, Tuning::MPC_Z_VEL_MAX_UP, 6.0);
    });
    assert!((flight.height() - 24.0).abs() < 0.6, "{}", flight.height());
    let default = landing_time(&mut airborne(|flight| set(flight, Tuning::MIS_TAKEOFF_ALT, 24.0)));
    set(&mut flight, Tuning::MPC_Z_VEL_MAX_DN, 4.0);
    set(&mut flight, Tuning::MPC_LAND_SPEED, 2.0);
    set(&mut flight, Tuning::MPC_LAND_ALT, 2.0);
    let quick = landing_time(&mut flight);
    assert!((quick - 6.5).abs() < 1.0 && default > 14.0, "{quick} {default}");
}

#[test]
fn the_climb_rate_follows_its_parameter() {
    let climb = |speed: f32| {
        let mut flight = armed(|flight| set(flight, Tuning::MPC_Z_VEL_MAX_UP, speed));
        flight.command(MavCmd::NAV_TAKEOFF, &[]);
        flight.run(2_000);
        flight.height()
    };
    assert!((climb(1.0) - 2.0).abs() < 0.1 && (climb(4.0) - 7.5).abs() < 0.6, "{} {}", climb(1.0), climb(4.0));
}

#[test]
fn a_mission_follows_the_parameters() {
    let fly = |tune: &dyn Fn(&mut Flight)| {
        let mut flight = airborne(|_| ());
        tune(&mut flight);
        flight.upload(&[waypoint(100.0, 0.0), waypoint(100.0, 100.0)]);
        assert_eq!(flight.start(None, None), MavResult::ACCEPTED);
        flight.run(8_000);
        let speed = flight.speed();
        let end = flight.until_current(1, 120);
        (speed, end, flight.distance(100.0, 0.0))
    };
    let (speed, default, short) = fly(&|_| ());
    assert!((speed - 8.0).abs() < 0.1 && short > 1.5 && short < 2.1, "{speed} {short}");
    let (speed, slow, _) = fly(&|flight| set(flight, Tuning::MPC_XY_CRUISE, 4.0));
    assert!((speed - 4.0).abs() < 0.1 && slow > default + 8.0, "{speed} {slow} {default}");
    let (_, _, short) = fly(&|flight| set(flight, Tuning::NAV_ACC_RAD, 20.0));
    assert!(short > 15.0 && short < 20.1, "{short}");
    let (speed, _, _) = fly(&|flight| set(flight, Tuning::MPC_ACC_HOR, 0.5));
    assert!((speed - 4.0).abs() < 0.2, "{speed}");
    let (_, gentle, _) = fly(&|flight| set(flight, Tuning::MPC_XY_P, 0.1));
    assert!(gentle > default + 10.0, "{gentle} {default}");
}

#[test]
fn yaw_follows_the_parameters() {
    let turn = |tune: &dyn Fn(&mut Flight)| {
        let mut flight = airborne(|_| ());
        tune(&mut flight);
        flight.upload(&[waypoint(0.0, 100.0)]);
        assert_eq!(flight.start(None, None), MavResult::ACCEPTED);
        flight.run(2_000);
        flight.heading()
    };
    assert!((turn(&|_| ()) - 90.0).abs() < 1.0);
    let slow = turn(&|flight| set(flight, Tuning::MPC_YAWRAUTO_MAX, 20.0));
    assert!((slow - 40.0).abs() < 2.0, "{slow}");
    assert_eq!(turn(&|flight| set(flight, Tuning::MPC_YAW_MODE, 1)), 0.0);
}

#[test]
fn a_return_follows_the_parameters() {
    let fly = |tune: &dyn Fn(&mut Flight)| {
        let mut flight = airborne(|_| ());
        tune(&mut flight);
        let rally = crate::support::at(MavCmd::NAV_RALLY_POINT, [0.0; 4], 30.0, 0.0, 5.0);
        flight.change(mavstack::PlanType::Rally, &[rally], 0).unwrap();
        flight.upload(&[waypoint(40.0, 0.0)]);
        flight.start(None, None);
        flight.until_end(60);
        assert_eq!(flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]), MavResult::ACCEPTED);
        let mut highest: f32 = 0.0;
        for _ in 0..900 {
            flight.run(100);
            highest = highest.max(flight.height());
        }
        assert!(!flight.vehicle.is_armed(), "not landed: {:?}", flight.texts());
        (flight.distance(30.0, 0.0) < 2.0, highest)
    };
    let (at_rally, highest) = fly(&|_| ());
    assert!(at_rally && (highest - 15.0).abs() < 0.6, "{highest}");
    let (at_rally, highest) = fly(&|flight| {
        set(flight, Tuning::RTL_TYPE, 1);
        set(flight, Tuning::RTL_RETURN_ALT, 40.0);
    });
    assert!(!at_rally && (highest - 40.0).abs() < 0.6, "{highest}");
    let (_, highest) = fly(&|flight| set(flight, Tuning::GF_MAX_VER_DIST, 12.0));
    assert!(highest <= 12.0, "{highest}");
}

#[test]
fn the_fence_follows_the_parameters() {
    let fly = |tune: &dyn Fn(&mut Flight)| {
        let mut flight = airborne(|_| ());
        set(&mut flight, Tuning::GF_MAX_HOR_DIST, 50.0);
        tune(&mut flight);
        flight.upload(&[waypoint(80.0, 0.0)]);
        assert_eq!(flight.start(None, None), MavResult::ACCEPTED);
        flight.until_end(60);
        flight.run(5_000);
        (flight.vehicle.mode(), flight.distance(0.0, 0.0), flight.texts())
    };
    let (mode, distance, texts) = fly(&|_| ());
    assert_eq!(mode, Mode::Hold);
    assert_eq!(texts, ["Holding at the fence"]);
    assert!(distance > 48.5 && distance < 50.0, "{distance}");
    let (_, distance, _) = fly(&|flight| set(flight, Tuning::GF_MARGIN, 10.0));
    assert!(distance > 38.5 && distance < 40.5, "{distance}");
    let (_, distance, texts) = fly(&|flight| set(flight, Tuning::GF_ACTION, 0));
    assert!(distance > 75.0 && texts == ["Mission complete"], "{distance} {texts:?}");
    let (_, distance, texts) = fly(&|flight| set(flight, Tuning::GF_ACTION, 1));
    assert!(distance > 75.0 && texts == ["Leaving the fence", "Mission complete"], "{distance} {texts:?}");
    let (mode, _, texts) = fly(&|flight| set(flight, Tuning::GF_ACTION, 3));
    assert_eq!(mode, Mode::Return);
    assert_eq!(texts, ["Returning: fence reached"]);
    let mut flight = armed(|flight| set(flight, Tuning::GF_MAX_VER_DIST, 8.0));
    flight.command(MavCmd::NAV_TAKEOFF, &[]);
    flight.run(20_000);
    assert!(flight.height() > 7.0 && flight.height() <= 8.0, "{}", flight.height());
}

#[test]
fn the_battery_follows_the_parameters() {
    let mut flight = Flight::new();
    set(&mut flight, Tuning::BAT_N_CELLS, 4);
    set(&mut flight, Tuning::BAT_V_CHARGED, 4.3);
    set(&mut flight, Tuning::BAT_R_INTERNAL, 0.0);
    set(&mut flight, Tuning::SIM_BAT_START, 50);
    set(&mut flight, Tuning::BAT_V_EMPTY, 3.3);
    flight.run(100);
    let battery = flight.vehicle.battery();
    assert!((battery.voltage - 15.2).abs() < 0.01 && (battery.remaining - 0.5).abs() < 0.01, "{battery:?}");
    let drawn = |tune: &dyn Fn(&mut Flight)| {
        let mut flight = armed(|flight| {
            // Keeps the vehicle armed for the whole minute.
            set(flight, Tuning::COM_DISARM_PRFLT, 0.0);
            tune(flight);
        });
        let before = flight.vehicle.battery();
        flight.run(60_000);
        let idle = flight.vehicle.battery();
        flight.command(MavCmd::NAV_TAKEOFF, &[]);
        flight.run(10_000);
        (before.current, idle.current, flight.vehicle.battery().current, before.remaining - idle.remaining)
    };
    let (off, idle, air, used) = drawn(&|_| ());
    assert_eq!((off, idle, air), (0.3, 2.0, 18.0));
    let (off, idle, air, _) = drawn(&|flight| {
        set(flight, Tuning::SIM_AMP_OFF, 1.0);
        set(flight, Tuning::SIM_AMP_IDLE, 5.0);
        set(flight, Tuning::SIM_AMP_FLIGHT, 30.0);
    });
    assert_eq!((off, idle, air), (1.0, 5.0, 30.0));
    let (_, _, _, twice) = drawn(&|flight| set(flight, Tuning::BAT_CAPACITY, 2_500.0));
    assert!((twice / used - 2.0).abs() < 0.05, "{twice} {used}");
}

#[test]
fn the_critical_battery_action_follows_its_parameter() {
    for (action, mode) in [(0, Mode::Hold), (1, Mode::Return), (2, Mode::Land)] {
        let mut flight = airborne(|flight| {
            set(flight, Tuning::COM_LOW_BAT_ACT, action);
            set(flight, Tuning::BAT_CAPACITY, 200.0);
            set(flight, Tuning::BAT_LOW_THR, 0.5);
            set(flight, Tuning::BAT_CRIT_THR, 0.4);
        });
        flight.until("critical", 60, |vehicle| vehicle.battery().remaining < 0.4);
        flight.run(20);
        assert_eq!(flight.vehicle.mode(), mode);
        assert_eq!(flight.texts(), ["Battery low", "Battery critical"]);
        assert_eq!(flight.vehicle.state().unwrap().system_status, MavState::CRITICAL);
    }
}

#[test]
fn arming_and_disarming_follow_the_parameters() {
    let arm = |tune: &dyn Fn(&mut Flight), millis| {
        let mut flight = Flight::new();
        tune(&mut flight);
        flight.run(millis);
        flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0])
    };
    assert_eq!(arm(&|_| (), 500), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(arm(&|flight| set(flight, Tuning::COM_ARM_WO_GPS, 1), 500), MavResult::ACCEPTED);
    assert_eq!(arm(&|flight| set(flight, Tuning::SIM_GPS_FIX_TIME, 300), 500), MavResult::ACCEPTED);
    let weak = |flight: &mut Flight| {
        set(flight, Tuning::SIM_BAT_START, 20);
        set(flight, Tuning::COM_ARM_BAT_MIN, 0.3);
    };
    assert_eq!(arm(&weak, 3_000), MavResult::TEMPORARILY_REJECTED);
    // A battery that would cause a return in flight prevents arming.
    for (action, result) in [(0, MavResult::ACCEPTED), (1, MavResult::TEMPORARILY_REJECTED)] {
        let spent = |flight: &mut Flight| {
            set(flight, Tuning::SIM_BAT_START, 5);
            set(flight, Tuning::COM_LOW_BAT_ACT, action);
        };
        assert_eq!(arm(&spent, 3_000), result, "{action}");
    }

    let mut flight = airborne(|flight| set(flight, Tuning::COM_DISARM_LAND, 3.0));
    landing_time(&mut flight);
    flight.run(2_900);
    assert!(flight.vehicle.is_armed());
    flight.run(200);
    assert!(!flight.vehicle.is_armed());
}

/// P-16: read-only parameters count flights and flight time. The flight time can be limited.
#[test]
fn flights_are_counted_and_limited() {
    let mut flight = airborne(|flight| set(flight, Tuning::COM_FLT_TIME_MAX, 30));
    assert_eq!((get(&flight, Tuning::STAT_FLIGHTS), get(&flight, Tuning::STAT_FLIGHT_TIME)), (1, 0));
    flight.until("returning", 31, |vehicle| vehicle.mode() == Mode::Return);
    assert_eq!(flight.texts(), ["Returning: flight time limit reached"]);
    flight.until("down", 60, |vehicle| !vehicle.is_armed());
    let time = get(&flight, Tuning::STAT_FLIGHT_TIME);
    assert!((35..60).contains(&time), "{time}");
    assert_eq!(get(&flight, Tuning::STAT_FLIGHTS), 1);
}

#[test]
fn the_action_after_takeoff_follows_its_parameter() {
    for (action, mode) in [(0, Mode::Hold), (1, Mode::Mission)] {
        let mut flight = armed(|flight| set(flight, Tuning::COM_TAKEOFF_ACT, action));
        flight.upload(&[waypoint(100.0, 0.0)]);
        flight.command(MavCmd::NAV_TAKEOFF, &[]);
        flight.until("up", 20, |vehicle| vehicle.mode() != Mode::Takeoff);
        assert_eq!(flight.vehicle.mode(), mode);
    }
}

#[test]
fn home_is_the_position_at_boot() {
    let mut flight = Flight::new();
    set(&mut flight, Tuning::SIH_LOC_LAT0, -HOME.0);
    set(&mut flight, Tuning::SIH_LOC_LON0, 1_799_999_999);
    set(&mut flight, Tuning::SIH_LOC_H0, -3.5);
    flight.run(2_500);
    // A change takes effect at the next boot.
    set(&mut flight, Tuning::SIH_LOC_LAT0, 0);
    flight.run(500);
    let position = flight.vehicle.global_position().unwrap();
    assert_eq!((position.latitude, position.longitude, position.altitude), (-HOME.0, 1_799_999_999, -3.5));
}

/// The vehicle with its stack, and a client that sets parameters.
struct World(Wire);

impl World {
    /// Sets a parameter and returns the answer.
    fn set(&mut self, name: &str, r#type: MavParamType, bits: u32) -> Result<u32, MavParamError> {
        let set = ParamSet {
            target_system: 1,
            target_component: 1,
            param_id: mavstack::Text::new(name),
            param_type: r#type,
            param_value: f32::from_bits(bits),
        };
        let Self(wire) = self;
        wire.send(TELEMETRY, &set);
        wire.run(50);
        // A refusal is followed by the current value.
        let refusal = wire.take::<ParamError>().pop();
        let values = wire.take::<ParamValue>();
        let value = values.iter().find(|(_, value)| value.param_id.as_str() == Some(name));
        match (refusal, value) {
            (Some((_, refusal)), _) => Err(refusal.error),
            (None, Some((_, value))) => Ok(value.param_value.to_bits()),
            (None, None) => panic!("no answer about {name}"),
        }
    }

    fn real(&mut self, name: &str, value: f32) -> Result<f32, MavParamError> {
        self.set(name, MavParamType::REAL32, value.to_bits()).map(f32::from_bits)
    }

    fn command(&mut self, id: MavCmd, first: f32) {
        assert_eq!(self.0.long(id, &[first]), MavResult::ACCEPTED);
    }
}

/// P-14: PARAM_SET over MAVLink, and its refusals.
/// P-19: integers as clients send them: MAVSDK's `set_param_int` and QGroundControl send an `i32`'s bytes, and MAVProxy's `param set`
/// a float. The bits that MAVSDK sends for a smaller integer, NaN, change nothing: here they would switch off the action at a
/// critical battery.
#[test]
fn integers_are_set_by_every_client() {
    let mut world = World(Wire::new());
    for (r#type, bits, expected) in [
        (MavParamType::INT32, 2, Ok(2)),
        (MavParamType::REAL32, 1.0f32.to_bits(), Ok(1)),
        (MavParamType::UINT8, 0x7FC0_0000, Err(MavParamError::VALUE_OUT_OF_RANGE)),
        (MavParamType::INT16, 0x7FC0_0000, Err(MavParamError::VALUE_OUT_OF_RANGE)),
        (MavParamType::INT32, 0x7FC0_0000, Err(MavParamError::VALUE_OUT_OF_RANGE)),
        (MavParamType::REAL32, 0x7FC0_0000, Err(MavParamError::VALUE_OUT_OF_RANGE)),
        (MavParamType::UINT8, 0x3F80_0000, Ok(1)),
        (MavParamType::UINT8, 2, Ok(2)),
    ] {
        let before = world.0.app.stack().parameters().get(Tuning::COM_LOW_BAT_ACT);
        assert_eq!(world.set("COM_LOW_BAT_ACT", r#type, bits), expected, "{type:?} {bits:#x}");
        let now = world.0.app.stack().parameters().get(Tuning::COM_LOW_BAT_ACT);
        assert_eq!(now, expected.map_or(before, u32::cast_signed), "{type:?} {bits:#x}");
    }
}

#[test]
fn invalid_parameter_changes_are_refused() {
    const DENIED: MavParamError = MavParamError::PERMISSION_DENIED;
    let mut world = World(Wire::new());
    assert_eq!(world.real("BAT_LOW_THR", 0.3), Ok(0.3));
    assert_eq!(world.real("BAT_CRIT_THR", 0.31), Err(MavParamError::VALUE_OUT_OF_RANGE));
    assert_eq!(world.real("BAT_LOW_THR", 0.06), Err(MavParamError::VALUE_OUT_OF_RANGE));
    assert_eq!(world.real("BAT_CAPACITY", 4_000.0), Ok(4_000.0));
    assert_eq!(world.set("STAT_FLIGHTS", MavParamType::INT32, 9), Err(MavParamError::READ_ONLY));
    let south = (-123_456_789_i32).cast_unsigned();
    assert_eq!(world.set("SIH_LOC_LAT0", MavParamType::INT32, south), Ok(south));
    while !world.0.app.vehicle().has_fix() {
        world.real("MPC_XY_CRUISE", 7.5).unwrap();
        assert!(world.0.millis < 60_000, "no fix");
    }
    world.command(MavCmd::COMPONENT_ARM_DISARM, 1.0);
    world.command(MavCmd::NAV_TAKEOFF, 0.0);
    while world.0.app.vehicle().local_position().down > -5.0 {
        assert_eq!(world.set("MAV_SYS_ID", MavParamType::INT32, 3), Err(DENIED));
        assert!(world.0.millis < 60_000, "no climb");
    }
    assert_eq!(world.real("GF_MAX_VER_DIST", 4.5), Err(DENIED));
    assert_eq!(world.real("BAT_CAPACITY", 3_000.0), Err(DENIED));
    assert_eq!(world.real("GF_MAX_VER_DIST", 60.0), Ok(60.0));
}
