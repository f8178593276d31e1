//! Manual flight over MAVLink: rules J-1 to J-4 as used by the vehicle.

use crate::support::wire::{STATION, Wire};
use mavstack::dialect::*;
use mavstack_demo::{COMPANION, Mode, TELEMETRY, Tuning, Vector};

#[path = "../../../../tests/support/radio.rs"]
#[allow(dead_code, reason = "the protocol tests use the rest")]
mod receivers;

use receivers::{ExpressLrs, Mlrs, MlrsChannels};

const POSITION: [f32; 3] = [129.0, 3.0, 0.0];
const CENTRED: [i16; 4] = [0, 0, 500, 0];

/// Sends heartbeats of a ground station, and stick positions at 10 Hz, for `millis`.
fn steer(wire: &mut Wire, [x, y, z, r]: [i16; 4], millis: u64) {
    let message = ManualControl { target: 1, x, y, z, r, ..ManualControl::default() };
    keep_sending(wire, millis, &message);
}

/// Like [`steer`], with radio channels (µs): roll, pitch, throttle, yaw.
fn radio(wire: &mut Wire, sticks: [u16; 4], millis: u64) {
    keep_sending(wire, millis, &channels(sticks));
}

fn channels([roll, pitch, throttle, yaw]: [u16; 4]) -> RcChannelsOverride {
    RcChannelsOverride {
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
    }
}

fn keep_sending<M: mavstack::Message>(wire: &mut Wire, millis: u64, message: &M) {
    for _ in 0..millis / 100 {
        if wire.millis % 1_000 < 100 {
            send_heartbeat(wire);
        }
        wire.send(TELEMETRY, message);
        wire.run(100);
    }
}

fn send_heartbeat(wire: &mut Wire) {
    wire.send(TELEMETRY, &Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() });
}

/// Returns a vehicle in manual flight.
fn in_manual_flight() -> Wire {
    let mut wire = Wire::airborne();
    send_heartbeat(&mut wire);
    steer(&mut wire, CENTRED, 1_200);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
    wire
}

fn heading(wire: &Wire) -> f32 {
    let [_, _, yaw] = wire.vehicle().attitude();
    yaw.to_degrees()
}

/// C-17: the first sticks or channels and the request for Position mode in one write, by all three ways.
#[test]
fn sticks_right_before_the_request_count() {
    let by_number = |wire: &mut Wire| wire.long(MavCmd::DO_SET_MODE, &POSITION);
    let by_standard =
        |wire: &mut Wire| wire.long(MavCmd::DO_SET_STANDARD_MODE, &[f32::from(MavStandardMode::POSITION_HOLD.0)]);
    let by_message = |wire: &mut Wire| {
        let (base_mode, custom_mode) = (MavModeFlag::CUSTOM_MODE_ENABLED, Mode::Position.number());
        wire.send(TELEMETRY, &SetMode { target_system: 1, base_mode, custom_mode });
        wire.answer(MavCmd(11)).result
    };
    for ask in [by_number, by_standard, by_message] {
        for is_radio in [false, true] {
            let mut wire = Wire::airborne();
            send_heartbeat(&mut wire);
            if is_radio {
                wire.send(TELEMETRY, &channels([1_500; 4]));
            } else {
                wire.send(TELEMETRY, &ManualControl { target: 1, z: 500, ..ManualControl::default() });
            }
            assert_eq!(ask(&mut wire), MavResult::ACCEPTED);
            wire.run(50);
            assert_eq!(wire.vehicle().mode(), Mode::Position);
        }
    }
}

/// A stop keeps the heading, even when the vehicle flies backwards.
#[test]
fn a_stop_keeps_the_heading() {
    let mut wire = in_manual_flight();
    steer(&mut wire, [-1_000, 0, 500, 0], 4_000);
    assert!(wire.vehicle().velocity().north < -6.0, "{:?}", wire.vehicle());
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &[129.0, 4.0, 3.0]), MavResult::ACCEPTED);
    wire.run(5_000);
    assert!(heading(&wire).abs() < 0.1, "{}", heading(&wire));
}

/// J-3: Position mode is refused without manual control, and after its timeout.
#[test]
fn position_mode_needs_current_input() {
    let mut wire = Wire::airborne();
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(wire.texts(), ["Position mode refused: no manual control"]);
    send_heartbeat(&mut wire);
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

/// J-3: when manual control times out the vehicle holds, with a text.
#[test]
fn lost_manual_control_makes_it_hold() {
    let mut wire = in_manual_flight();
    steer(&mut wire, [1_000, 0, 500, 0], 3_000);
    let lost = wire.millis;
    wire.until("holding", 2, |vehicle| vehicle.mode() == Mode::Hold);
    assert!((300..600).contains(&(wire.millis - lost)), "{} ms", wire.millis - lost);
    wire.run(5_000);
    let Vector { north, east, down } = wire.vehicle().velocity();
    assert!(north.abs() < 0.05 && east.abs() < 0.05 && down.abs() < 0.05);
    let texts = ["Sticks: system 255 component 190, link 0", "Sticks lost", "Manual control lost: holding"];
    assert_eq!(wire.texts(), texts);
    // When input returns, the pilot must select the mode again.
    steer(&mut wire, [1_000, 0, 500, 0], 1_000);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// J-1: forward and right relative to the heading, throttle up and down from the middle, yaw to the right. Centred sticks hold
/// the position.
#[test]
fn sticks_steer_in_the_body_frame() {
    let mut wire = in_manual_flight();
    steer(&mut wire, [0, 0, 500, 500], 2_000);
    let turned = heading(&wire);
    assert!((turned - 90.0).abs() < 6.0, "half of 90 degrees per second: {turned}");
    steer(&mut wire, [500, 0, 500, 0], 4_000);
    let Vector { north, east, .. } = wire.vehicle().velocity();
    assert!((east - 4.0).abs() < 0.1 && north.abs() < 0.5, "forward is east: {:?}", wire.vehicle().velocity());
    assert!((heading(&wire) - turned).abs() < 1.0, "the heading stays: {}", heading(&wire));
    steer(&mut wire, [0, 1_000, 500, 0], 6_000);
    let Vector { north, east, .. } = wire.vehicle().velocity();
    assert!((north + 8.0).abs() < 0.2 && east.abs() < 0.9, "right is south: {:?}", wire.vehicle().velocity());
    steer(&mut wire, CENTRED, 6_000);
    let place = wire.vehicle().local_position();
    steer(&mut wire, [20, -20, 510, 15], 2_000);
    assert!(wire.vehicle().local_position().distance(place) < 0.05, "inside the dead band");
    let height = wire.height();
    steer(&mut wire, [0, 0, 1_000, 0], 2_000);
    assert!((wire.height() - height - 6.0).abs() < 0.4, "{} {height}", wire.height());
    // An omitted or invalid axis counts as centred.
    let height = wire.height();
    steer(&mut wire, [i16::MAX, 1_001, i16::MAX, i16::MAX], 1_000);
    assert!((wire.height() - height).abs() < 0.1 && wire.vehicle().mode() == Mode::Position);
    steer(&mut wire, [0, 0, 0, 0], 2_000);
    assert!(height - wire.height() > 3.0, "{} {height}", wire.height());
}

/// Manual takeoff and landing. A disarmed vehicle stays on the ground.
#[test]
fn manual_takeoff_and_landing() {
    let mut wire = Wire::booted();
    send_heartbeat(&mut wire);
    steer(&mut wire, CENTRED, 1_200);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
    steer(&mut wire, [0, 0, 1_000, 0], 1_000);
    assert_eq!(wire.height(), 0.0, "not armed");
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    steer(&mut wire, [1_000, 0, 1_000, 0], 3_000);
    assert!(wire.height() > 8.0 && wire.vehicle().local_position().north > 3.0);
    steer(&mut wire, [0, 0, 0, 0], 20_000);
    assert!(wire.vehicle().is_landed() && wire.vehicle().is_armed());
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[0.0]), MavResult::ACCEPTED);
}

/// J-4: radio channels steer the vehicle too. RC_CHANNELS contains exactly the channels received.
#[test]
fn radio_channels_steer_and_are_reported() {
    let mut wire = Wire::airborne();
    assert_eq!(wire.long(MavCmd::REQUEST_MESSAGE, &[65.0]), MavResult::ACCEPTED);
    wire.run(10);
    let (_, channels) = wire.take::<RcChannels>().pop().unwrap();
    assert_eq!(
        (channels.chancount, channels.chan1_raw, channels.chan18_raw, channels.rssi),
        (0, u16::MAX, u16::MAX, u8::MAX)
    );
    send_heartbeat(&mut wire);
    radio(&mut wire, [1_500; 4], 1_200);
    assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
    wire.take::<RcChannels>();
    radio(&mut wire, [1_500, 1_250, 1_500, 1_500], 4_000);
    let Vector { north, east, .. } = wire.vehicle().velocity();
    assert!((north - 4.0).abs() < 0.1 && east.abs() < 0.1, "{:?}", wire.vehicle().velocity());
    let (_, channels) = wire.take::<RcChannels>().pop().unwrap();
    assert_eq!(
        (channels.chancount, channels.chan1_raw, channels.chan2_raw, channels.chan5_raw),
        (4, 1_500, 1_250, u16::MAX)
    );
    radio(&mut wire, [1_750, 1_500, 1_500, 1_500], 4_000);
    assert!((wire.vehicle().velocity().east - 4.0).abs() < 0.1, "{:?}", wire.vehicle().velocity());
    // With the throttle released the remaining channels are not enough.
    radio(&mut wire, [1_500, 1_500, 0, 1_500], 200);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// J-2: a parameter selects the source of manual control. A sender that is not a ground station must be named there.
#[test]
fn only_the_permitted_source_steers() {
    let allow = |wire: &mut Wire, system| {
        let (stack, _) = wire.app.parts();
        assert!(stack.parameters_mut().set(Tuning::MAV_GCS_SYSID, system));
    };
    let enter = |wire: &mut Wire| {
        let message = ManualControl { target: 1, z: 500, ..ManualControl::default() };
        wire.send(TELEMETRY, &message);
        wire.run(20);
        wire.long(MavCmd::DO_SET_MODE, &POSITION)
    };
    let mut wire = Wire::airborne();
    assert_eq!(enter(&mut wire), MavResult::TEMPORARILY_REJECTED, "no heartbeat");
    allow(&mut wire, STATION.system.wire().into());
    wire.run(20);
    assert_eq!(enter(&mut wire), MavResult::ACCEPTED);
    allow(&mut wire, 254);
    wire.run(600);
    assert_eq!(enter(&mut wire), MavResult::TEMPORARILY_REJECTED);
}

/// J-10 to J-13: the pilot's receiver on the second UART, beside QGroundControl's joystick on the first. It flies the vehicle without a
/// ground station, keeps the sticks while it is alive, and takes them back.
#[test]
fn receiver_flies_beside_a_joystick() {
    fn fly(write: &mut dyn FnMut(u64) -> Vec<u8>, address: (u8, u8)) {
        let mut wire = Wire::airborne();
        let mut run = |wire: &mut Wire, millis: u64, is_alive: bool, has_joystick: bool| {
            for _ in 0..millis {
                if has_joystick && wire.millis.is_multiple_of(1_000) {
                    send_heartbeat(wire);
                }
                if has_joystick && wire.millis.is_multiple_of(40) {
                    let message = ManualControl { target: 1, x: -1_000, z: 500, ..ManualControl::default() };
                    wire.send(TELEMETRY, &message);
                }
                let bytes = write(wire.millis);
                if is_alive {
                    wire.send_raw(COMPANION, &bytes);
                }
                wire.run(1);
            }
        };
        run(&mut wire, 1_000, true, false);
        assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
        run(&mut wire, 4_000, true, false);
        let Vector { north, east, .. } = wire.vehicle().velocity();
        assert!((east - 4.0).abs() < 0.1 && north.abs() < 0.1, "right: {:?}", wire.vehicle().velocity());
        run(&mut wire, 4_000, true, true);
        assert!((wire.vehicle().velocity().east - 4.0).abs() < 0.1, "the joystick is refused");
        assert_eq!(wire.vehicle().mode(), Mode::Position);
        let (system, component) = address;
        assert_eq!(wire.texts(), [format!("Sticks: system {system} component {component}, link 1")]);

        // A gap of 0.6 s: the joystick has the sticks, until the receiver is back for 500 ms.
        run(&mut wire, 600, false, true);
        assert_eq!(wire.vehicle().mode(), Mode::Hold);
        assert_eq!(wire.long(MavCmd::DO_SET_MODE, &POSITION), MavResult::ACCEPTED);
        run(&mut wire, 400, true, true);
        assert!(wire.vehicle().velocity().east < 4.0);
        run(&mut wire, 6_000, true, true);
        let Vector { north, east, .. } = wire.vehicle().velocity();
        assert!((east - 4.0).abs() < 0.1 && north.abs() < 0.1, "right again: {:?}", wire.vehicle().velocity());
    }
    let mut elrs = ExpressLrs::new();
    elrs.pulse = 1_750;
    fly(&mut |millis| elrs.write(millis), (255, 68));
    for (channels, system) in [(MlrsChannels::Override, 255), (MlrsChannels::Radio, 51)] {
        let mut mlrs = Mlrs::new(channels);
        mlrs.pulse = 1_750;
        fly(&mut |millis| mlrs.write(millis), (system, 68));
    }
}

/// The fence also applies to manual flight.
#[test]
fn the_fence_stops_manual_flight() {
    let mut wire = in_manual_flight();
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::GF_MAX_HOR_DIST, 30.0));
    steer(&mut wire, [1_000, 0, 500, 0], 10_000);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
    let north = wire.vehicle().local_position().north;
    assert!((25.0..30.0).contains(&north), "{north}");
    assert_eq!(wire.texts(), ["Sticks: system 255 component 190, link 0", "Holding at the fence"]);
}
