//! Runs the rover of `examples/boards` on the host, as the smallest vehicle that a ground station accepts.

#[path = "../../examples/boards/rover/src/lib.rs"]
#[allow(dead_code, unused_attributes, reason = "it is a crate of its own, for boards")]
mod rover;

use crate::support::*;
use mavstack::Text;
use mavstack::dialect::{BatteryStatus, Heartbeat, MavCmd, MavType, ParamRequestList, ParamSet, ParamValue};
use rover::Mavlink;

/// P-18: QGroundControl considers a vehicle ready when its parameters are loaded, and needs at least one.
#[test]
fn smallest_vehicle_has_a_parameter() {
    let mut setup = Setup::<1>::new();
    setup.config = mavstack::Config { r#type: rover::CONFIG.r#type, ..setup.config };
    let mut world: World<1, Mavlink> = World::of(setup);
    assert_eq!(world.expect::<Heartbeat>(0, secs(2)).r#type, MavType::GROUND_ROVER);
    world.gcs[0].send(&ParamRequestList { target_system: 1, target_component: 1 });
    let value: ParamValue = world.expect(0, secs(1));
    assert_eq!((value.param_id.as_str(), value.param_count, value.param_index), (Some("SPEED_MAX"), 1, 0));
    world.gcs[0].send(&ParamSet {
        param_value: 5.0,
        target_system: 1,
        target_component: 1,
        param_id: Text::new("SPEED_MAX"),
        param_type: value.param_type,
    });
    assert_eq!(world.expect::<ParamValue>(0, secs(1)).param_value, 5.0);
    let speed_limit = |world: &World<1, Mavlink>| {
        world.vehicle.speed_limit(world.stack.parameters(), world.stack.has_ground_station())
    };
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.run_for(secs(2));
    assert_eq!(speed_limit(&world), 0.0, "disarmed");
    world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.run_for(millis(100));
    assert_eq!(speed_limit(&world), 5.0);
    world.gcs[0].heartbeat_period = None;
    world.run_for(secs(10));
    assert_eq!(speed_limit(&world), 0.0, "the ground station is lost");
}

/// The battery is unknown until it is measured.
#[test]
fn battery_is_reported() {
    let mut world: World<1, Mavlink> = World::of(Setup::new());
    assert_eq!(world.expect::<BatteryStatus>(0, secs(3)), BatteryStatus::UNKNOWN);
    world.vehicle.battery = 12.6;
    world.gcs[0].forget();
    assert_eq!(world.expect::<BatteryStatus>(0, secs(3)).voltages[..2], [12_600, u16::MAX]);
}
