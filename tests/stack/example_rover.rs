//! Runs the rover of `examples/boards` on the host, as the smallest vehicle that a ground station accepts.

#[path = "../../examples/boards/rover/src/lib.rs"]
#[allow(dead_code, unused_attributes, reason = "it is a crate of its own, for boards")]
mod rover;

use crate::support::*;
use mavstack::Text;
use mavstack::dialect::{CommandAck, Heartbeat, MavCmd, MavResult, MavType, ParamRequestList, ParamSet, ParamValue};
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
    assert_eq!(world.vehicle.speed_limit(world.stack.parameters()), 0.0, "disarmed");
    world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.run_for(millis(100));
    assert_eq!(world.vehicle.speed_limit(world.stack.parameters()), 5.0);
}

/// a vehicle without streams accepts a request for HEARTBEAT's interval, keeps it unchanged, and cannot be told to
/// stop HEARTBEAT. For other messages the stack answers. Q-1: HEARTBEAT can be requested.
#[test]
fn vehicle_without_streams_keeps_its_heartbeat() {
    let (yes, no) = (MavResult::ACCEPTED, MavResult::DENIED);
    let mut world: World<1, Mavlink> = World::of(Setup::new());
    for (command, params, result) in [
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, 100_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], yes),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, 0.0, f32::NAN, 0.0, 0.0, 0.0, f32::NAN], yes),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0], no),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0], no),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], no),
        (MavCmd::SET_MESSAGE_INTERVAL, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0], no),
        (MavCmd::SET_MESSAGE_INTERVAL, [30.0, 100_000.0, 0.0, 0.0, 0.0, 0.0, 0.0], MavResult::UNSUPPORTED),
        (MavCmd::REQUEST_MESSAGE, [0.0; 7], yes),
    ] {
        world.gcs[0].command_long(command, params);
        assert_eq!(world.expect::<CommandAck>(0, millis(100)).result, result, "{command:?} {params:?}");
    }
    world.run_for(secs(1));
    world.gcs[0].forget();
    world.run_for(secs(10));
    assert_eq!(world.gcs[0].count_of::<Heartbeat>(), 10);
}
