//! Components that the vehicle talks to by itself: a gimbal, and an arm authoriser (O-3).

use crate::support::wire::{STATION, Wire, command_long};
use mavstack::dialect::*;
use mavstack::{Address, LinkId, Text};
use mavstack_demo::{COMPANION, TELEMETRY, Tuning};

/// The vehicle has a gimbal and a camera of its own; these are other ones.
const GIMBAL: Address = Address::new(1, 171);
const CAMERA: Address = Address::new(1, 101);
const AUTHORISER: Address = Address::new(10, 190);
const ARM: MavCmd = MavCmd::COMPONENT_ARM_DISARM;

fn beat(wire: &mut Wire, link: LinkId, from: Address, r#type: MavType) {
    wire.send_as(link, from, &Heartbeat { r#type, ..Heartbeat::default() });
    wire.run(20);
}

/// A vehicle whose arming an authoriser on the companion's link must permit.
fn supervised() -> Wire {
    let mut wire = Wire::booted();
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::COM_ARM_AUTH_ID, 10));
    beat(&mut wire, COMPANION, AUTHORISER, MavType::GCS);
    wire
}

fn arm(wire: &mut Wire) {
    wire.send(TELEMETRY, &command_long(1, ARM, &[1.0]));
    wire.run(50);
}

fn authorise(wire: &mut Wire, result: MavResult, result_param2: i32) {
    let command = MavCmd::ARM_AUTHORIZATION_REQUEST;
    let ack =
        CommandAck { command, result, result_param2, target_system: 1, target_component: 1, ..CommandAck::UNKNOWN };
    wire.send_as(COMPANION, AUTHORISER, &ack);
    wire.run(50);
}

/// Returns the results of the command to arm, without those of other commands.
fn results(wire: &mut Wire) -> Vec<MavResult> {
    let acks = wire.take::<CommandAck>().into_iter();
    acks.filter(|(_, ack)| ack.command == ARM && ack.target_system == STATION.system.wire())
        .map(|(_, ack)| ack.result)
        .collect()
}

/// O-3: the command to arm is answered IN_PROGRESS until the authoriser has said, and then with what it said.
#[test]
fn arming_waits_for_the_authoriser() {
    let mut wire = supervised();
    arm(&mut wire);
    let requests = wire.take::<CommandLong>();
    let [(_, request)] = &requests[..] else { panic!("{requests:?}") };
    assert_eq!((request.command, request.param1), (MavCmd::ARM_AUTHORIZATION_REQUEST, 1.0));
    assert_eq!((request.target_system, request.target_component), (10, 0));
    assert_eq!(results(&mut wire), [MavResult::IN_PROGRESS]);
    authorise(&mut wire, MavResult::IN_PROGRESS, 0);
    wire.run(3_000);
    assert!(!wire.vehicle().is_armed());
    assert_eq!(wire.take::<CommandLong>().len(), 0, "IN_PROGRESS ends the retransmissions");
    wire.take::<CommandAck>();
    authorise(&mut wire, MavResult::ACCEPTED, 30);
    assert!(wire.vehicle().is_armed());
    assert_eq!(results(&mut wire), [MavResult::ACCEPTED]);
}

/// O-3, C-31: a refusal is passed on with its reason, and so is silence.
#[test]
fn refused_arming_has_a_reason() {
    let mut wire = supervised();
    arm(&mut wire);
    wire.texts();
    authorise(&mut wire, MavResult::DENIED, i32::from(MavArmAuthDeniedReason::BAD_WEATHER.0));
    assert_eq!(results(&mut wire).last(), Some(&MavResult::DENIED));
    assert_eq!(wire.texts(), ["Arming refused by the authoriser: bad weather"]);

    wire.run(6_000);
    beat(&mut wire, COMPANION, AUTHORISER, MavType::GCS);
    arm(&mut wire);
    wire.run(3_600);
    assert_eq!(wire.take::<CommandLong>().len(), 6, "five times, and once before");
    assert_eq!(results(&mut wire).last(), Some(&MavResult::FAILED));
    assert!(wire.texts().contains(&"Arming refused: the authoriser does not answer".into()));

    // By now it is not alive.
    wire.run(6_000);
    arm(&mut wire);
    assert_eq!(results(&mut wire), [MavResult::IN_PROGRESS, MavResult::TEMPORARILY_REJECTED]);
    assert!(wire.texts().contains(&"Arming refused: no authoriser".into()));
    assert!(!wire.vehicle().is_armed());
}

/// O-3, K-1, C-21, C-24: over lines that lose a fifth of all frames in each direction, the authoriser decides, the vehicle arms once
/// or not at all, and the station that repeats its command is told which.
#[test]
fn lossy_arming_is_decided_once() {
    const SEEDS: u64 = 60;
    let mut decided = 0;
    for seed in 0..SEEDS {
        let mut wire = supervised();
        for line in &wire.lines {
            line.set_seed(seed);
            line.set_loss(0.2);
        }
        let permits = seed % 2 == 0;
        let result = if permits { MavResult::ACCEPTED } else { MavResult::DENIED };
        let (mut end, mut armings, mut was_armed) = (None, 0, false);
        wire.take::<CommandLong>();
        for pass in 0..80 {
            // The station repeats the command until it is told the end.
            if pass % 10 == 0 {
                wire.send(TELEMETRY, &CommandLong { confirmation: pass / 10, ..command_long(1, ARM, &[1.0]) });
            }
            if pass % 10 == 5 {
                beat(&mut wire, COMPANION, AUTHORISER, MavType::GCS);
            }
            wire.run(100);
            for (_, request) in wire.take::<CommandLong>() {
                if request.command == MavCmd::ARM_AUTHORIZATION_REQUEST {
                    authorise(&mut wire, result, 30);
                }
            }
            let is_armed = wire.vehicle().is_armed();
            armings += u32::from(is_armed && !was_armed);
            was_armed = is_armed;
            let last = results(&mut wire).into_iter().find(|result| *result != MavResult::IN_PROGRESS);
            end = end.or(last);
            if end.is_some() {
                break;
            }
        }
        match end {
            Some(MavResult::ACCEPTED) => assert!(permits && armings == 1, "seed {seed}"),
            Some(MavResult::DENIED) => assert!(!permits && armings == 0, "seed {seed}"),
            // All five requests or their answers were lost.
            Some(MavResult::FAILED) => assert_eq!(armings, 0, "seed {seed}"),
            end => panic!("seed {seed}: {end:?}"),
        }
        decided += u64::from(end != Some(MavResult::FAILED));
    }
    assert!(decided * 20 >= SEEDS * 19, "{decided} of {SEEDS}");
}

/// C-23: COMMAND_CANCEL ends the waiting, and a late permission does not arm. C-21: until then the same command is rejected
/// for now, to disarm too.
#[test]
fn cancelled_arming_stays_disarmed() {
    let mut wire = supervised();
    arm(&mut wire);
    wire.take::<CommandAck>();
    assert_eq!(wire.long(ARM, &[0.0]), MavResult::TEMPORARILY_REJECTED);
    wire.send(TELEMETRY, &CommandCancel { command: ARM, target_system: 1, target_component: 1 });
    wire.run(100);
    assert!(results(&mut wire).contains(&MavResult::CANCELLED));
    assert!(!wire.take::<CommandCancel>().is_empty(), "the authoriser is told");
    authorise(&mut wire, MavResult::ACCEPTED, 30);
    wire.run(1_000);
    assert!(!wire.vehicle().is_armed());
}

/// A late answer to a cancelled request decides nothing about the next one.
#[test]
fn each_arming_needs_its_own_permission() {
    let mut wire = supervised();
    arm(&mut wire);
    wire.send(TELEMETRY, &CommandCancel { command: ARM, target_system: 1, target_component: 1 });
    wire.run(100);
    assert_eq!(wire.long(ARM, &[0.0]), MavResult::ACCEPTED);
    arm(&mut wire);
    authorise(&mut wire, MavResult::ACCEPTED, 30);
    assert!(!wire.vehicle().is_armed(), "that was the cancelled one");
    // The next request follows when no more answers to the first are expected.
    wire.take::<CommandLong>();
    wire.run(2_500);
    assert_eq!(wire.take::<CommandLong>().len(), 1);
    authorise(&mut wire, MavResult::ACCEPTED, 30);
    assert!(wire.vehicle().is_armed());
}

/// The conditions for arming are checked again when the permission comes.
#[test]
fn permission_does_not_override_the_checks() {
    let mut wire = supervised();
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::COM_ARM_BAT_MIN, 0.9));
    assert!(
        stack.parameters_mut().set(Tuning::SIM_AMP_OFF, 5.0) && stack.parameters_mut().set(Tuning::BAT_CAPACITY, 100.0)
    );
    arm(&mut wire);
    authorise(&mut wire, MavResult::IN_PROGRESS, 0);
    wire.run(9_000);
    wire.texts();
    authorise(&mut wire, MavResult::ACCEPTED, 30);
    assert!(!wire.vehicle().is_armed());
    assert_eq!(wire.texts(), ["Arming refused: battery low"]);
    assert_eq!(results(&mut wire).last(), Some(&MavResult::TEMPORARILY_REJECTED));
}

/// A reboot ends the waiting: the command to arm gets a final result, and a late permission does not arm.
#[test]
fn reboot_cancels_arming() {
    let mut wire = supervised();
    arm(&mut wire);
    wire.send(TELEMETRY, &command_long(1, MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]));
    wire.run(20);
    authorise(&mut wire, MavResult::ACCEPTED, 30);
    assert!(!wire.vehicle().is_armed());
    assert_eq!(results(&mut wire), [MavResult::IN_PROGRESS, MavResult::CANCELLED]);
}

/// A command to the gimbal becomes GIMBAL_DEVICE_SET_ATTITUDE to the gimbal, on its link only.
#[test]
fn gimbal_is_pointed() {
    let mut wire = Wire::booted();
    let point = |wire: &mut Wire, pitch: f32, yaw: f32| {
        wire.long(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, &[pitch, yaw, f32::NAN, f32::NAN, 32.0, 0.0, 171.0])
    };
    assert_eq!(point(&mut wire, -30.0, 90.0), MavResult::TEMPORARILY_REJECTED);
    beat(&mut wire, COMPANION, Address::new(2, 171), MavType::GIMBAL);
    assert_eq!(point(&mut wire, -30.0, 90.0), MavResult::TEMPORARILY_REJECTED, "another system's");
    beat(&mut wire, COMPANION, GIMBAL, MavType::GIMBAL);
    assert_eq!(point(&mut wire, -30.0, 90.0), MavResult::ACCEPTED);
    wire.run(50);
    assert_eq!(
        (wire.count::<GimbalDeviceSetAttitude>(COMPANION), wire.count::<GimbalDeviceSetAttitude>(TELEMETRY)),
        (1, 0)
    );
    // When it was found it was asked what it is.
    let asked: Vec<_> =
        wire.take::<CommandLong>().into_iter().map(|(_, asked)| (asked.command, asked.param1)).collect();
    assert_eq!(asked, [(MavCmd::REQUEST_MESSAGE, 283.0)]);
    let model_name = Text::new("Brushless 3");
    let foreign = Address::new(2, 171);
    wire.send_as(COMPANION, foreign, &GimbalDeviceInformation { model_name, ..GimbalDeviceInformation::default() });
    assert!(!wire.texts().iter().any(|text| text.starts_with("Gimbal: ")), "another system's");
    wire.send_as(COMPANION, GIMBAL, &GimbalDeviceInformation { model_name, ..GimbalDeviceInformation::default() });
    assert!(wire.texts().contains(&"Gimbal: Brushless 3".into()));
    let (_, set) = wire.take::<GimbalDeviceSetAttitude>()[0];
    assert_eq!((set.target_system, set.target_component), (1, 171));
    // Yaw by 90°, then pitch by -30°.
    let expected = [0.683_012_7, 0.183_012_7, -0.183_012_7, 0.683_012_7];
    for (is, should) in set.q.into_iter().zip(expected) {
        assert!((is - should).abs() < 1e-6, "{:?}", set.q);
    }
    assert!(set.angular_velocity_x.is_nan());
    assert_eq!(point(&mut wire, -91.0, 0.0), MavResult::DENIED);
}

/// A camera's mode is read when the camera is found.
#[test]
fn camera_is_asked_for_its_mode() {
    let mut wire = Wire::booted();
    beat(&mut wire, COMPANION, CAMERA, MavType::CAMERA);
    wire.run(50);
    let (_, read) = wire.take::<ParamExtRequestRead>()[0];
    assert_eq!((read.param_id.as_str(), read.target_component), (Some("CAM_MODE"), 101));
    let value = ParamExtValue { param_id: read.param_id, param_value: Text::new("\u{2}"), ..ParamExtValue::default() };
    wire.send_as(COMPANION, CAMERA, &value);
    assert_eq!(wire.texts(), ["Camera: mode 2"]);
}

/// C-16: another press of the button gets the reason again, also if the refusal comes later than the command.
#[test]
fn refused_arming_has_its_reason_again() {
    let mut wire = Wire::booted();
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::COM_ARM_AUTH_ID, 10));
    for _ in 0..3 {
        wire.texts();
        arm(&mut wire);
        wire.run(100);
        assert!(wire.texts().contains(&"Arming refused: no authoriser".into()));
        wire.run(3_500);
    }
}
