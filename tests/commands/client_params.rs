//! Parameters that the vehicle reads of other components: rules K-6, S-10, S-18.

use super::client::{AUTHORISER, COMPANION, Carrier, GIMBAL, NOTHING, POINT, REQUEST, Sky, beat, sky};
use crate::support::*;
use mavstack::config::TxVersion;
use mavstack::dialect::*;
use mavstack::{Instant, LinkConfig, Text};

/// K-6: a parameter is read by its name, and the request repeated until it is answered.
#[test]
fn parameters_are_read() {
    let mut world = sky();
    assert!(world.stack.read_param(GIMBAL, POINT));
    world.run_for(secs(1));
    let requests = world.gcs[COMPANION].all::<ParamRequestRead>();
    assert_eq!(requests.len(), 2);
    let (_, request) = requests[0];
    assert_eq!((request.param_index, request.param_id.as_str()), (-1, Some("GIMB_MODE")));
    assert_eq!((request.target_system, request.target_component), (1, 154));
    let value =
        |name: &str, param_value: f32| ParamValue { param_value, param_id: Text::new(name), ..ParamValue::default() };
    world.gcs[COMPANION].send_from(GIMBAL, &value("GIMB_MODE2", 1.0));
    world.gcs[COMPANION].send_from(AUTHORISER, &value("GIMB_MODE", 2.0));
    world.run_for(millis(10));
    assert_eq!(world.vehicle.params, [], "another parameter, another component");
    // What follows the NUL is no part of the name (S-18).
    let mut answer = value("", 3.0);
    answer.param_id = Text::from_wire(*b"GIMB_MODE\0junk!!");
    world.gcs[COMPANION].send_from(GIMBAL, &answer);
    world.run_for(secs(5));
    assert_eq!(world.vehicle.params, [(POINT, Ok(3.0))]);
    assert_eq!(world.gcs[COMPANION].all::<ParamRequestRead>().len(), 2);
}

/// K-6: extended parameters, such as a camera's, are read by their own messages.
#[test]
fn extended_parameters_are_read() {
    let mut world = sky();
    let is_requested = world.stack.with_context(Instant::ZERO, |cx| cx.read_ext_param::<Carrier>(GIMBAL, REQUEST));
    assert!(is_requested);
    world.run_for(millis(50));
    let (_, request) = world.gcs[COMPANION].all::<ParamExtRequestRead>()[0];
    assert_eq!((request.param_index, request.param_id.as_str()), (-1, Some("CAM_EXPOSURE_CMP")), "16 bytes");
    let (param_id, param_value, param_type) = (request.param_id, Text::new("A\u{1}"), MavParamExtType::INT32);
    // An answer of the other protocol is none.
    world.gcs[COMPANION].send_from(GIMBAL, &ParamValue { param_id, ..ParamValue::default() });
    world.gcs[COMPANION]
        .send_from(GIMBAL, &ParamExtValue { param_id, param_value, param_type, ..ParamExtValue::default() });
    world.run_for(millis(10));
    assert_eq!(world.vehicle.params, [(REQUEST, Ok(321.0))]);
}

/// K-6: PARAM_ERROR ends a request, and so do silence and a component that is not there.
#[test]
fn parameters_that_are_not_read_are_reported() {
    let mut world = sky();
    assert!(world.stack.read_param(GIMBAL, POINT) && world.stack.read_param(AUTHORISER, REQUEST));
    assert!(world.stack.read_param(GIMBAL, NOTHING));
    // Only commands are cancelled.
    assert!(world.stack.cancel_sent_command(POINT));
    world.run_for(millis(50));
    let error = MavParamError::DOES_NOT_EXIST;
    let (param_id, target_system, target_component) = (Text::new("GIMB_MODE"), 1, 1);
    let error = ParamError { error, param_id, target_system, target_component, ..ParamError::default() };
    world.gcs[COMPANION].send_from(GIMBAL, &error);
    world.run_for(millis(50));
    beat(&mut world, COMPANION, GIMBAL, MavType::GIMBAL);
    assert!(world.stack.read_param(GIMBAL, REQUEST));
    world.run_for(secs(4));
    let expected = [
        (REQUEST, Err("not sent")),
        (NOTHING, Err("not sent")),
        (POINT, Err("does not exist")),
        (REQUEST, Err("timed out")),
    ];
    assert_eq!(world.vehicle.params, expected);
    assert_eq!(world.vehicle.replies, []);
}

/// K-6, S-10: a link that sends MAVLink 1 cannot carry a request for an extended parameter.
#[test]
fn extended_parameter_needs_mavlink_2() {
    let v1 = LinkConfig::uart(115_200).with_own_system(true).with_version(TxVersion::V1);
    let mut world = Sky::of(Setup { links: [v1; 3], ..Setup::new() });
    world.run_for(millis(20));
    beat(&mut world, COMPANION, GIMBAL, MavType::GIMBAL);
    assert!(world.stack.read_ext_param(GIMBAL, REQUEST));
    world.run_for(secs(4));
    assert_eq!(world.vehicle.params, [(REQUEST, Err("not sent"))]);
}
