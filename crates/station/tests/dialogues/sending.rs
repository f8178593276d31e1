//! Stations that send only to a vehicle that is disarmed.

use crate::vehicle::rig;
use mavstack::Duration;
use mavstack::dialect::{CommandLong, MavCmd};
use mavstack::frame::{Version, encode};
use mavstack::{Address, Instant};
use mavstack_station::kit::{Firmware, Rig};
use mavstack_station::{Client, Drive, GroundStation, Sending, Station};

const SECOND: Duration = Duration::from_secs(1);

/// Returns the bytes that were sent to the vehicle.
fn sent<F: Firmware>(rig: &Rig<F>) -> u64 {
    rig.line(0).ends().1.written()
}

/// Arms or disarms the vehicle, as a pilot does without a ground station.
fn arm<F: Firmware>(rig: &Rig<F>, arm: f32) {
    let command = CommandLong {
        command: MavCmd::COMPONENT_ARM_DISARM,
        param1: arm,
        target_system: 1,
        target_component: 1,
        ..CommandLong::default()
    };
    let mut frame = [0; 64];
    let len = encode(&command, Version::V2, Address::new(255, 1), 0, &mut frame).expect("room");
    rig.line(0).send(&frame[..len]);
}

#[test]
fn nothing_is_sent_to_an_armed_vehicle() {
    for sending in [Sending::WhileDisarmed, Sending::UnlessArmed] {
        let mut rig = rig(Client::QGroundControl, 0.0, 1);
        rig.station().set_sending(sending);
        rig.connect().expect("it is disarmed");
        rig.set_interval::<mavstack::dialect::Attitude>(SECOND).expect("it is disarmed");

        arm(&rig, 1.0);
        rig.until(SECOND * 2, |rig| rig.seen().vehicles().any(|vehicle| vehicle.is_armed()));
        let before = sent(&rig);
        assert!(rig.station().is_any_armed() && !rig.station().may_send());
        rig.parameters().expect_err("the request is not sent");
        rig.station().send_raw(&[1; 100]);
        rig.run_for(SECOND * 5);
        assert_eq!(sent(&rig), before, "{sending:?}");

        arm(&rig, 0.0);
        rig.run_for(SECOND * 2);
        assert_eq!(rig.parameters().map(|parameters| parameters.len()), Ok(22), "{sending:?}");
    }
}

/// Before the first heartbeat a vehicle is not known to be disarmed.
#[test]
fn a_station_that_has_heard_nothing() {
    let silent = |sending| {
        let mut station = Station::new(Client::QGroundControl);
        station.set_sending(sending);
        station.poll(Instant::ZERO);
        station.take_output().is_empty()
    };
    assert!(silent(Sending::WhileDisarmed) && silent(Sending::Never));
    assert!(!silent(Sending::UnlessArmed) && !silent(Sending::Always));
}

/// What was to be sent is dropped, and the first heartbeat does not wait.
#[test]
fn a_station_that_stops_and_begins_again() {
    let mut station = Station::new(Client::QGroundControl);
    station.poll(Instant::ZERO);
    station.set_sending(Sending::Never);
    assert_eq!(station.take_output(), []);
    station.poll(Instant::from_millis(1_500));
    station.set_sending(Sending::Always);
    station.poll(Instant::from_millis(1_501));
    assert_eq!(station.take_output().len(), 21);
}
