//! Commands, as each client sends them.

mod common;

use common::Rig;
use mavstack::dialect::{MavCmd, MavResult};
use mavstack_station::{Client, Failure, GroundStation};

#[test]
fn every_client_connects_and_arms() {
    for client in Client::ALL {
        let mut rig = Rig::new(client, 0.0, 1);
        assert_eq!(rig.connect().expect("a vehicle").vehicle, mavstack::Address::new(1, 1));
        rig.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]).expect("armed");
        assert!(rig.vehicle.armed, "{client}");
    }
}

#[test]
fn a_refusal_says_what_was_refused() {
    let mut rig = Rig::new(Client::QGroundControl, 0.0, 1);
    rig.connect().expect("a vehicle");
    let failure = rig.command(MavCmd::NAV_TAKEOFF, &[]).expect_err("a rover cannot fly");
    assert!(matches!(failure, Failure::Command { result: MavResult::UNSUPPORTED, .. }), "{failure}");
    assert!(failure.to_string().starts_with("the vehicle refused NAV_TAKEOFF: UNSUPPORTED"), "{failure}");
}
