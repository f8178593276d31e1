//! Runs the rover of `examples/boards` on the host, as the vehicle that the porting guide begins with.

#[path = "../../examples/boards/rover/src/lib.rs"]
#[allow(dead_code, unexpected_cfgs, unused_attributes, reason = "it is a crate of its own, for boards")]
mod rover;

use crate::support::*;
use mavstack::Text;
use mavstack::dialect::*;
use mavstack::telemetry::Battery;
use rover::{HOLD, MISSION, Mavlink, Tuning};

fn world() -> World<1, Mavlink> {
    let mut setup = Setup::<1>::new();
    setup.config = mavstack::Config { r#type: rover::CONFIG.r#type, ..setup.config };
    World::of(setup)
}

/// Runs the driving loop for this time, and the stack.
fn drive(world: &mut World<1, Mavlink>, seconds: u64) {
    for _ in 0..seconds * 10 {
        let now = world.now();
        world.vehicle.drive(now, &mut world.stack);
        world.run_for(millis(100));
    }
}

fn arm(world: &mut World<1, Mavlink>) -> MavResult {
    world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.expect::<CommandAck>(0, secs(1)).result
}

/// P-18: QGroundControl considers a vehicle ready when its parameters are loaded, and needs at least one.
#[test]
fn rover_has_parameters() {
    let mut world = world();
    assert_eq!(world.expect::<Heartbeat>(0, secs(2)).r#type, MavType::GROUND_ROVER);
    world.gcs[0].send(&ParamRequestList { target_system: 1, target_component: 1 });
    let value: ParamValue = world.expect(0, secs(1));
    assert_eq!((value.param_id.as_str(), value.param_count, value.param_index), (Some("BAT_V_LOW"), 3, 0));
    world.run_for(secs(1));
    world.gcs[0].forget();
    world.gcs[0].send(&ParamSet {
        param_value: 5.0,
        target_system: 1,
        target_component: 1,
        param_id: Text::new("SPEED_MAX"),
        param_type: value.param_type,
    });
    assert_eq!(world.expect::<ParamValue>(0, secs(1)).param_value, 5.0);
    assert_eq!(world.stack.parameters().get(Tuning::SPEED_MAX), 5.0);
}

/// The rover drives its mission only while it is armed, in the mode, and a ground station is alive. QGroundControl shows "ready".
#[test]
fn rover_drives_and_holds_when_the_station_is_lost() {
    let mut world = world();
    world.gcs[0].heartbeat_period = Some(secs(1));
    drive(&mut world, 2);
    let status: SysStatus = world.expect(0, secs(2));
    assert!(status.onboard_control_sensors_health.contains(MavSysStatusSensor::PREARM_CHECK));
    let items = plan(3, 0).into_iter().map(|item| MissionItemInt {
        command: MavCmd::NAV_WAYPOINT,
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        ..item
    });
    world.upload(0, &items.collect::<Vec<_>>()).unwrap();
    let target = |world: &World<1, Mavlink>| world.vehicle.target(&world.stack).map(|item| item.command);
    let select = |world: &mut World<1, Mavlink>, mode: u32| {
        world.gcs[0].send(&SetMode {
            custom_mode: mode,
            target_system: 1,
            base_mode: MavModeFlag::CUSTOM_MODE_ENABLED,
        });
        drive(world, 1);
    };
    select(&mut world, MISSION);
    assert_eq!(target(&world), None, "disarmed");
    assert_eq!(arm(&mut world), MavResult::ACCEPTED);
    drive(&mut world, 1);
    assert_eq!(target(&world), Some(MavCmd::NAV_WAYPOINT));
    select(&mut world, HOLD);
    assert_eq!(target(&world), None, "it holds");
    select(&mut world, MISSION);
    assert_eq!(target(&world), Some(MavCmd::NAV_WAYPOINT));
    world.gcs[0].heartbeat_period = None;
    world.gcs[0].forget();
    drive(&mut world, 10);
    assert_eq!(target(&world), None, "the ground station is lost");
    let texts = world.gcs[0].all::<Statustext>();
    assert_eq!(texts[0].1.text.as_str(), Some("Ground station lost: holding"));
    world.gcs[0].forget();
    assert_eq!(world.expect::<Heartbeat>(0, secs(2)).system_status, MavState::CRITICAL);
}

/// The battery is unknown until it is measured; a low one prevents arming if the parameter says so.
#[test]
fn rover_watches_its_battery() {
    let mut world = world();
    assert_eq!(world.expect::<BatteryStatus>(0, secs(3)).voltages[0], u16::MAX);
    world.vehicle.battery = Battery { voltage: 9.5, ..Battery::UNKNOWN };
    world.gcs[0].forget();
    assert_eq!(world.expect::<BatteryStatus>(0, secs(3)).voltages[..2], [9_500, u16::MAX]);
    drive(&mut world, 1);
    assert_eq!(arm(&mut world), MavResult::ACCEPTED);
    assert!(world.stack.parameters_mut().set(Tuning::BAT_V_LOW, 10.0));
    drive(&mut world, 1);
    world.run_for(secs(3));
    world.gcs[0].forget();
    assert_eq!(arm(&mut world), MavResult::DENIED);
}
