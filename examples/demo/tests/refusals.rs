//! Every refusal has a text with the reason, whether the stack, the vehicle or a service refuses (C-4, C-31, C-32). Also:
//! when the vehicle disarms by itself.

#[path = "support/wire.rs"]
mod wire;

use mavstack::Parameters;
use mavstack::dialect::*;
use mavstack_demo::{Mode, TELEMETRY, Tuning};
use wire::{Wire, command_long};

const NAN: f32 = f32::NAN;

/// The commands that the demo obeys, each in a form that it accepts in some state.
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
    (MavCmd::RUN_PREARM_CHECKS, &[]),
    (MavCmd::PREFLIGHT_CALIBRATION, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    (MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]),
    (MavCmd::PREFLIGHT_STORAGE, &[-1.0, -1.0]),
    (MavCmd::DO_SET_MISSION_CURRENT, &[0.0, 0.0]),
    (MavCmd::MISSION_START, &[]),
    (MavCmd::CONTROL_HIGH_LATENCY, &[0.0]),
];

fn is_refused(result: MavResult) -> bool {
    matches!(result, MavResult::DENIED | MavResult::FAILED | MavResult::TEMPORARILY_REJECTED)
}

/// Returns the answer to a command, and the texts that are sent about it.
fn ask(wire: &mut Wire, system: u8, command: MavCmd, params: &[f32]) -> (MavResult, Vec<String>) {
    wire.said();
    wire.send(TELEMETRY, &command_long(system, command, params));
    (wire.answer(command).result, wire.said())
}

/// C-4, C-31: in every state, for this vehicle and for all, with good parameters and with bad ones.
#[test]
fn every_refusal_has_a_text() {
    type State = (&'static str, fn() -> Wire);
    let states: [State; 5] = [
        ("without a fix", Wire::new),
        ("on the ground", Wire::switched_on),
        ("armed", || {
            let mut wire = Wire::switched_on();
            let (_, vehicle) = wire.app.parts();
            assert!(vehicle.parameters_mut().unwrap().set(Tuning::COM_DISARM_PRFLT, 0.0));
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
                let (result, mut said) = ask(&mut wire, system, command, params);
                if is_refused(result) && said.is_empty() {
                    // The same text within five seconds is not sent again.
                    wire.run(5_000);
                    said = ask(&mut wire, system, command, params).1;
                }
                // A link gets at most one such text a second.
                wire.run(1_100);
                if is_refused(result) {
                    refusals += 1;
                    assert!(!said.is_empty(), "{state}: {command:?} {params:?} to {system}: {result:?}, and no word");
                    assert!(said.iter().all(|text| text.len() <= 50), "{said:?}");
                } else if result == MavResult::ACCEPTED {
                    assert!(
                        said.iter().all(|text| !text.contains("refused:")) || command == MavCmd::RUN_PREARM_CHECKS,
                        "{said:?}"
                    );
                }
            }
        }
    }
    assert!(refusals > 100, "{refusals}");
}

/// C-4, C-1: a refused command for system 0 is answered with a text that names the system to use.
#[test]
fn a_broadcast_is_told_to_name_the_system() {
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
        let (result, said) = ask(&mut Wire::switched_on(), 0, command, &[]);
        let text = format!("Command {number} refused: sent to 0; use system 1");
        assert_eq!((result, said), (MavResult::DENIED, vec![text]));
    }
}

/// C-32: refused modes of other autopilots are explained, for both messages.
#[test]
fn an_unknown_mode_is_explained() {
    let mut wire = Wire::switched_on();
    // OFFBOARD of PX4.
    let (result, said) = ask(&mut wire, 1, MavCmd::DO_SET_MODE, &[1.0, 6.0, 0.0]);
    assert_eq!((result, said), (MavResult::DENIED, vec!["Mode 393216 refused: not in AVAILABLE_MODES".to_owned()]));
    // GUIDED of ArduPilot.
    wire.run(5_500);
    wire.send(TELEMETRY, &SetMode { target_system: 1, base_mode: MavModeFlag::CUSTOM_MODE_ENABLED, custom_mode: 4 });
    assert_eq!(wire.answer(MavCmd(11)).result, MavResult::DENIED);
    assert_eq!(wire.said(), ["Mode 4 refused: not in AVAILABLE_MODES"]);
}

/// C-31: refusals by the vehicle's own checks of a value are explained.
#[test]
fn a_value_that_the_vehicle_refuses_is_explained() {
    let mut wire = Wire::airborne();
    let (result, said) = ask(&mut wire, 1, MavCmd::DO_CHANGE_SPEED, &[1.0, 0.0, -1.0]);
    assert_eq!((result, said), (MavResult::DENIED, vec!["Speed refused: above 0, or -1, or -2".to_owned()]));
    wire.run(1_100);
    let (result, said) = ask(&mut wire, 1, MavCmd::NAV_TAKEOFF, &[0.0, 0.0, 0.0, NAN, NAN, NAN, -5.0]);
    assert_eq!((result, said), (MavResult::DENIED, vec!["Takeoff refused: under the ground".to_owned()]));
}

/// C-11: LAND on the ground, by whichever command, ends a flight that has not begun; when disarmed it sends no text.
#[test]
fn landing_on_the_ground_disarms() {
    let land: &[(MavCmd, &[f32])] = &[
        (MavCmd::NAV_LAND, &[]),
        // At another place: the vehicle does not fly there.
        (MavCmd::NAV_LAND, &[0.0, 0.0, 0.0, NAN, 47.4, 8.55, 0.0]),
        (MavCmd::DO_SET_MODE, &[1.0, 4.0, 6.0]),
    ];
    for &(command, params) in land {
        let mut wire = Wire::switched_on();
        assert_eq!(wire.long(command, params), MavResult::ACCEPTED, "{params:?}");
        assert_eq!(wire.said(), [""; 0]);
        assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
        assert_eq!(wire.long(command, params), MavResult::ACCEPTED, "{params:?}");
        wire.run(100);
        assert!(!wire.vehicle().is_armed() && wire.vehicle().is_landed(), "{params:?}");
        assert_eq!(wire.said(), ["Landed, disarmed"]);
        assert_eq!(wire.vehicle().mode(), Mode::Hold);
    }
}

/// Armed without a take-off, the vehicle disarms after ten seconds, or after the time in its parameter; not in the air, and
/// not after a flight.
#[test]
fn armed_without_a_take_off_it_disarms() {
    let mut wire = Wire::switched_on();
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    wire.run(9_900);
    assert!(wire.vehicle().is_armed());
    wire.run(200);
    assert!(!wire.vehicle().is_armed());
    assert_eq!(wire.said(), ["Disarmed: it did not take off"]);
    // The time starts again.
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    wire.run(9_000);
    assert_eq!(wire.long(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
    wire.run(30_000);
    assert!(wire.vehicle().is_armed() && (wire.height() - 10.0).abs() < 0.5);

    let mut wire = Wire::switched_on();
    let (_, vehicle) = wire.app.parts();
    assert!(vehicle.parameters_mut().unwrap().set(Tuning::COM_DISARM_PRFLT, 0.0));
    wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    wire.run(60_000);
    assert!(wire.vehicle().is_armed(), "never");
}
