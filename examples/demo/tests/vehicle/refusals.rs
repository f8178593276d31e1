//! Every refusal sends a text with the reason, whether the stack, the vehicle or a service refuses (C-4, C-31, C-32). Also
//! covers automatic disarming.

use crate::support::wire::{Wire, command_long};
use mavstack::dialect::*;
use mavstack_demo::{Mode, TELEMETRY, Tuning};

const NAN: f32 = f32::NAN;

/// The commands that the demo supports, each in a form that it accepts in some state.
const COMMANDS: &[(MavCmd, &[f32])] = &[
    (MavCmd::COMPONENT_ARM_DISARM, &[1.0]),
    (MavCmd::NAV_TAKEOFF, &[]),
    (MavCmd::NAV_LAND, &[]),
    (MavCmd::NAV_RETURN_TO_LAUNCH, &[]),
    (MavCmd::DO_REPOSITION, &[-1.0, 1.0, 0.0, NAN]),
    (MavCmd::DO_CHANGE_SPEED, &[1.0, 5.0, -1.0]),
    (MavCmd::CONDITION_YAW, &[90.0, 0.0, 1.0, 0.0]),
    (MavCmd::DO_SET_HOME, &[1.0]),
    (MavCmd::DO_SET_MODE, &[1.0, 4.0, 3.0]),
    (MavCmd::DO_SET_STANDARD_MODE, &[1.0]),
    (MavCmd::DO_FLIGHTTERMINATION, &[0.0]),
    (MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, &[-30.0, 45.0, NAN, NAN, 32.0, 0.0, 1.0]),
    (MavCmd::RUN_PREARM_CHECKS, &[]),
    (MavCmd::PREFLIGHT_CALIBRATION, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    (MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]),
    (MavCmd::PREFLIGHT_STORAGE, &[-1.0, -1.0]),
    (MavCmd::DO_SET_MISSION_CURRENT, &[0.0, 0.0]),
    (MavCmd::MISSION_START, &[]),
    (MavCmd::CONTROL_HIGH_LATENCY, &[0.0]),
    (MavCmd::DO_LAND_START, &[]),
    (MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, &[-1.0, -1.0, -1.0, -1.0]),
    (MavCmd::DO_SET_ROI_NONE, &[]),
    (MavCmd::LOGGING_START, &[0.0]),
    // MAV_CMD_REQUEST_OPERATOR_CONTROL.
    (MavCmd(32_100), &[0.0, 0.0]),
];

fn is_refused(result: MavResult) -> bool {
    matches!(result, MavResult::DENIED | MavResult::FAILED | MavResult::TEMPORARILY_REJECTED)
}

/// Returns the answer to a command, and the texts that are sent about it.
fn ask(wire: &mut Wire, system: u8, command: MavCmd, params: &[f32]) -> (MavResult, Vec<String>) {
    wire.texts();
    wire.send(TELEMETRY, &command_long(system, command, params));
    (wire.answer(command).result, wire.texts())
}

/// C-4, C-31: in every state, addressed and broadcast, with valid and invalid parameters.
#[test]
fn every_refusal_has_a_text() {
    type State = (&'static str, fn() -> Wire);
    let states: [State; 5] = [
        ("without a fix", Wire::new),
        ("on the ground", Wire::booted),
        ("armed", || {
            let mut wire = Wire::booted();
            let (stack, _) = wire.app.parts();
            assert!(stack.parameters_mut().set(Tuning::COM_DISARM_PRFLT, 0.0));
            wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
            wire
        }),
        ("in the air", Wire::airborne),
        ("terminated", || {
            let mut wire = Wire::airborne();
            wire.long(MavCmd::DO_FLIGHTTERMINATION, &[1.0]);
            wire.run(5_000);
            wire
        }),
    ];
    let mut refusals = 0;
    for (state, begin) in states {
        for &(command, good) in COMMANDS {
            let bad: &[f32] = &[7.5, 7.5, 7.5, 7.5, 99.0, 999.0, f32::INFINITY];
            let mut wire = begin();
            // An accepted command changes the state, so it comes last.
            for (system, params) in [(1, bad), (0, good), (1, good)] {
                let (result, mut texts) = ask(&mut wire, system, command, params);
                if is_refused(result) && texts.is_empty() {
                    // The same text within two seconds is not sent again (C-16).
                    wire.run(2_000);
                    texts = ask(&mut wire, system, command, params).1;
                }
                // A link carries at most one such text per second.
                wire.run(1_100);
                if is_refused(result) {
                    refusals += 1;
                    assert!(
                        !texts.is_empty(),
                        "{state}: {command:?} {params:?} to {system}: {result:?} without a text"
                    );
                    assert!(texts.iter().all(|text| text.len() <= 50), "{texts:?}");
                } else if result == MavResult::ACCEPTED {
                    assert!(
                        texts.iter().all(|text| !text.contains("refused:")) || command == MavCmd::RUN_PREARM_CHECKS,
                        "{texts:?}"
                    );
                }
            }
        }
    }
    assert!(refusals > 100, "{refusals}");
}

/// C-4, C-1: the text about a refused broadcast names the system id to use.
#[test]
fn a_refused_broadcast_names_the_system_to_use() {
    for (command, number) in [
        (MavCmd::NAV_TAKEOFF, 22),
        (MavCmd::NAV_LAND, 21),
        (MavCmd::NAV_RETURN_TO_LAUNCH, 20),
        (MavCmd::DO_SET_MODE, 176),
        (MavCmd::DO_CHANGE_SPEED, 178),
        (MavCmd::DO_SET_HOME, 179),
        (MavCmd::DO_REPOSITION, 192),
        (MavCmd::DO_SET_MISSION_CURRENT, 224),
        (MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, 246),
    ] {
        let (result, texts) = ask(&mut Wire::booted(), 0, command, &[]);
        let text = format!("Command {number} refused: sent to 0; use system 1");
        assert_eq!((result, texts), (MavResult::DENIED, vec![text]));
    }
}

/// C-32: refused modes of other autopilots are explained, for DO_SET_MODE and SET_MODE.
#[test]
fn an_unknown_mode_is_explained() {
    let mut wire = Wire::booted();
    // STABILIZED of PX4.
    let (result, texts) = ask(&mut wire, 1, MavCmd::DO_SET_MODE, &[1.0, 7.0, 0.0]);
    assert_eq!((result, texts), (MavResult::DENIED, vec!["Mode 458752 refused: not in AVAILABLE_MODES".to_owned()]));
    // GUIDED of ArduPilot.
    wire.run(5_500);
    wire.send(TELEMETRY, &SetMode { target_system: 1, base_mode: MavModeFlag::CUSTOM_MODE_ENABLED, custom_mode: 4 });
    assert_eq!(wire.answer(MavCmd(11)).result, MavResult::DENIED);
    assert_eq!(wire.texts(), ["Mode 4 refused: not in AVAILABLE_MODES"]);
}

/// C-31: refusals by the vehicle's own checks are explained.
#[test]
fn a_value_that_the_vehicle_refuses_is_explained() {
    let mut wire = Wire::airborne();
    let (result, texts) = ask(&mut wire, 1, MavCmd::DO_CHANGE_SPEED, &[1.0, 0.0, -1.0]);
    assert_eq!((result, texts), (MavResult::DENIED, vec!["Speed refused: must be above 0, or -1 or -2".to_owned()]));
    wire.run(1_100);
    let (result, texts) = ask(&mut wire, 1, MavCmd::NAV_TAKEOFF, &[0.0, 0.0, 0.0, NAN, NAN, NAN, -5.0]);
    assert_eq!((result, texts), (MavResult::DENIED, vec!["Takeoff refused: below ground".to_owned()]));
}

/// C-11: LAND on the ground disarms, by any command. If the vehicle is already disarmed, the command is accepted without a text, and
/// the mode is refused, because it would not be entered (C-18).
#[test]
fn landing_on_the_ground_disarms() {
    let land: &[(MavCmd, &[f32])] = &[
        (MavCmd::NAV_LAND, &[]),
        // At another position: the vehicle does not fly there.
        (MavCmd::NAV_LAND, &[0.0, 0.0, 0.0, NAN, 47.4, 8.55, 0.0]),
        (MavCmd::DO_SET_MODE, &[1.0, 4.0, 6.0]),
    ];
    for &(command, params) in land {
        let mut wire = Wire::booted();
        if command == MavCmd::DO_SET_MODE {
            assert_eq!(wire.long(command, params), MavResult::TEMPORARILY_REJECTED);
            assert_eq!(wire.texts(), ["Command refused: not armed"]);
        } else {
            assert_eq!(wire.long(command, params), MavResult::ACCEPTED, "{params:?}");
            assert_eq!(wire.texts(), [""; 0]);
        }
        assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
        assert_eq!(wire.long(command, params), MavResult::ACCEPTED, "{params:?}");
        wire.run(100);
        assert!(!wire.vehicle().is_armed() && wire.vehicle().is_landed(), "{params:?}");
        assert_eq!(wire.texts(), ["Landed, disarmed"]);
        assert_eq!(wire.vehicle().mode(), Mode::Hold);
    }
}

/// Without a takeoff the vehicle disarms ten seconds after arming, or after the time in its parameter. It does not disarm in
/// flight.
#[test]
fn disarms_without_a_takeoff() {
    let mut wire = Wire::booted();
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    wire.run(9_900);
    assert!(wire.vehicle().is_armed());
    wire.run(200);
    assert!(!wire.vehicle().is_armed());
    assert_eq!(wire.texts(), ["Disarmed: no takeoff after arming"]);
    // Arming restarts the time.
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    wire.run(9_000);
    assert_eq!(wire.long(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
    wire.run(30_000);
    assert!(wire.vehicle().is_armed() && (wire.height() - 10.0).abs() < 0.5);

    let mut wire = Wire::booted();
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::COM_DISARM_PRFLT, 0.0));
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    wire.run(60_000);
    assert!(wire.vehicle().is_armed(), "never");
}
