//! Flight by hand over the wire: rules J-1 to J-4 as the vehicle makes use of them.

#[path = "support/wire.rs"]
mod wire;

use mavstack::Parameters;
use mavstack::dialect::*;
use mavstack_demo::{Mode, TELEMETRY, Tuning, Vector};
use wire::{STATION, Wire};

const POSITION: [f32; 3] = [129.0, 3.0, 0.0];
const CENTRED: [i16; 4] = [0, 0, 500, 0];

/// A ground station is there, and its sticks are like this for so long, sent ten times a second.
fn steer(wire: &mut Wire, [x, y, z, r]: [i16; 4], millis: u64) {
    let message = ManualControl { target: 1, x, y, z, r, ..ManualControl::default() };
    keep_sending(wire, millis, &message);
}

/// The same with radio channels (µs): roll, pitch, throttle, yaw.
fn radio(wire: &mut Wire, [roll, pitch, throttle, yaw]: [u16; 4], millis: u64) {
    let message = RcChannelsOverride {
        target_system: 1,
        target_component: 1,
        chan1_raw: roll,
        chan2_raw: pitch,
        chan3_raw: throttle,
        chan4_raw: yaw,
        chan5_raw: u16::MAX,
        chan6_raw: u16::MAX,
        chan7_raw: u16::MAX,
        chan8_raw: u16::MAX,
        ..RcChannelsOverride::default()
    };
    keep_sending(wire, millis, &message);
}

fn keep_sending<M: mavstack::Message>(wire: &mut Wire, millis: u64, message: &M) {
    for _ in 0..millis / 100 {
        if wire.millis % 1_000 < 100 {
            beat(wire);
        }
        wire.send(TELEMETRY, message);
        wire.run(100);
    }
}

fn beat(wire: &mut Wire) {
    wire.send(TELEMETRY, &Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() });
}

/// Up in the air, in flight by hand.
fn by_hand() -> Wire {
    let mut wire = Wire::airborne();
    beat(&mut wire);
    steer(&mut wire, CENTRED, 1_200);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
    wire
}

fn heading(wire: &Wire) -> f32 {
    let [_, _, yaw] = wire.vehicle().attitude();
    yaw.to_degrees()
}

/// It stops with its nose where it is, also backwards.
#[test]
fn a_stop_does_not_turn_it_around() {
    let mut wire = by_hand();
    steer(&mut wire, [-1_000, 0, 500, 0], 4_000);
    assert!(wire.vehicle().velocity().north < -6.0, "{:?}", wire.vehicle());
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &[129.0, 4.0, 3.0]), MavResult::ACCEPTED);
    wire.run(5_000);
    assert!(heading(&wire).abs() < 0.1, "{}", heading(&wire));
}

/// J-3: without sticks there is no flight by hand, nor with old ones.
#[test]
fn position_mode_needs_fresh_sticks() {
    let mut wire = Wire::airborne();
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(wire.said(), ["Position mode refused: no manual control"]);
    beat(&mut wire);
    steer(&mut wire, CENTRED, 1_200);
    wire.run(600);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::TEMPORARILY_REJECTED);
    steer(&mut wire, CENTRED, 200);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
    assert_eq!(wire.vehicle().mode(), Mode::Position);
    wire.run(400);
    let (_, heartbeat) = wire.take::<Heartbeat>().pop().unwrap();
    assert!(heartbeat.base_mode.contains(MavModeFlag::CUSTOM_MODE_ENABLED));
}

/// J-3: sticks that are lost are not held; the vehicle holds, and says why.
#[test]
fn lost_sticks_are_not_followed() {
    let mut wire = by_hand();
    steer(&mut wire, [1_000, 0, 500, 0], 3_000);
    let lost = wire.millis;
    wire.until("holding", 2, |vehicle| vehicle.mode() == Mode::Hold);
    assert!((300..600).contains(&(wire.millis - lost)), "{} ms", wire.millis - lost);
    wire.run(5_000);
    let Vector { north, east, down } = wire.vehicle().velocity();
    assert!(north.abs() < 0.05 && east.abs() < 0.05 && down.abs() < 0.05);
    assert_eq!(wire.said(), ["Manual control lost: holding"]);
    // Back again, it is for the pilot to say so.
    steer(&mut wire, [1_000, 0, 500, 0], 1_000);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// J-1: forward and right as the nose points, up and down from the middle, turns to the right; centred, it stays.
#[test]
fn sticks_steer_in_the_body_frame() {
    let mut wire = by_hand();
    steer(&mut wire, [0, 0, 500, 500], 2_000);
    let heading_then = heading(&wire);
    assert!((heading_then - 90.0).abs() < 6.0, "half of 90 degrees a second: {heading_then}");
    steer(&mut wire, [500, 0, 500, 0], 4_000);
    let Vector { north, east, .. } = wire.vehicle().velocity();
    assert!((east - 4.0).abs() < 0.1 && north.abs() < 0.5, "forward is east: {:?}", wire.vehicle().velocity());
    assert!((heading(&wire) - heading_then).abs() < 1.0, "the nose stays: {}", heading(&wire));
    steer(&mut wire, [0, 1_000, 500, 0], 6_000);
    let Vector { north, east, .. } = wire.vehicle().velocity();
    assert!((north + 8.0).abs() < 0.2 && east.abs() < 0.9, "right is south: {:?}", wire.vehicle().velocity());
    steer(&mut wire, CENTRED, 6_000);
    let place = wire.vehicle().local_position();
    steer(&mut wire, [20, -20, 510, 15], 2_000);
    assert!(wire.vehicle().local_position().distance(place) < 0.05, "a stick is never quite still");
    let height = wire.height();
    steer(&mut wire, [0, 0, 1_000, 0], 2_000);
    assert!((wire.height() - height - 6.0).abs() < 0.4, "{} {height}", wire.height());
    // An axis that is not given, or is no axis, is centred.
    let height = wire.height();
    steer(&mut wire, [i16::MAX, 1_001, i16::MAX, i16::MAX], 1_000);
    assert!((wire.height() - height).abs() < 0.1 && wire.vehicle().mode() == Mode::Position);
    steer(&mut wire, [0, 0, 0, 0], 2_000);
    assert!(height - wire.height() > 3.0, "{} {height}", wire.height());
}

/// From the ground and back to it; disarmed, it stands.
#[test]
fn it_takes_off_and_lands_by_hand() {
    let mut wire = Wire::switched_on();
    beat(&mut wire);
    steer(&mut wire, CENTRED, 1_200);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
    steer(&mut wire, [0, 0, 1_000, 0], 1_000);
    assert_eq!(wire.height(), 0.0, "it is not armed");
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    steer(&mut wire, [1_000, 0, 1_000, 0], 3_000);
    assert!(wire.height() > 8.0 && wire.vehicle().local_position().north > 3.0);
    steer(&mut wire, [0, 0, 0, 0], 20_000);
    assert!(wire.vehicle().is_landed() && wire.vehicle().is_armed());
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[0.0]), MavResult::ACCEPTED);
}

/// J-4: radio channels steer the same way, and RC_CHANNELS tells them, and nothing else.
#[test]
fn radio_channels_steer_too_and_are_told() {
    let mut wire = Wire::airborne();
    assert_eq!(wire.long(MavCmd::REQUEST_MESSAGE, &[65.0]), MavResult::ACCEPTED);
    wire.run(10);
    let (_, told) = wire.take::<RcChannels>().pop().unwrap();
    assert_eq!((told.chancount, told.chan1_raw, told.chan18_raw, told.rssi), (0, u16::MAX, u16::MAX, u8::MAX));
    beat(&mut wire);
    radio(&mut wire, [1_500; 4], 1_200);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
    wire.take::<RcChannels>();
    radio(&mut wire, [1_500, 1_250, 1_500, 1_500], 4_000);
    let Vector { north, east, .. } = wire.vehicle().velocity();
    assert!((north - 4.0).abs() < 0.1 && east.abs() < 0.1, "{:?}", wire.vehicle().velocity());
    let (_, told) = wire.take::<RcChannels>().pop().unwrap();
    assert_eq!((told.chancount, told.chan1_raw, told.chan2_raw, told.chan5_raw), (4, 1_500, 1_250, u16::MAX));
    radio(&mut wire, [1_750, 1_500, 1_500, 1_500], 4_000);
    assert!((wire.vehicle().velocity().east - 4.0).abs() < 0.1, "{:?}", wire.vehicle().velocity());
    // The throttle is released: those that are left are no sticks.
    radio(&mut wire, [1_500, 1_500, 0, 1_500], 200);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// J-2: who may steer is a parameter; and who is no ground station may not unless it names him.
#[test]
fn only_who_may_steers() {
    let allow = |wire: &mut Wire, system| {
        let (_, vehicle) = wire.app.parts();
        assert!(vehicle.parameters_mut().unwrap().set(Tuning::MAV_GCS_SYSID, system));
    };
    let enter = |wire: &mut Wire| {
        let message = ManualControl { target: 1, z: 500, ..ManualControl::default() };
        wire.send(TELEMETRY, &message);
        wire.run(20);
        wire.long(MavCmd::DO_SET_MODE, &POSITION)
    };
    let mut wire = Wire::airborne();
    assert_eq!(enter(&mut wire), MavResult::TEMPORARILY_REJECTED, "no heartbeat");
    allow(&mut wire, STATION.system.0);
    wire.run(20);
    assert_eq!(enter(&mut wire), MavResult::ACCEPTED);
    allow(&mut wire, 254);
    wire.run(600);
    assert_eq!(enter(&mut wire), MavResult::TEMPORARILY_REJECTED);
}

/// The fence holds for a pilot too.
#[test]
fn the_fence_stops_a_pilot() {
    let mut wire = by_hand();
    let (_, vehicle) = wire.app.parts();
    assert!(vehicle.parameters_mut().unwrap().set(Tuning::GF_MAX_HOR_DIST, 30.0));
    steer(&mut wire, [1_000, 0, 500, 0], 10_000);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
    let north = wire.vehicle().local_position().north;
    assert!((25.0..30.0).contains(&north), "{north}");
    assert_eq!(wire.said(), ["Holding at the fence"]);
}
