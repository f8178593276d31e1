//! Flight modes over MAVLink: set by number, set as standard modes, and reported.

use crate::support::wire::Wire;
use mavstack::dialect::*;
use mavstack_demo::{Mode, TELEMETRY, Tuning};

const NAN: f32 = f32::NAN;
const SET: MavCmd = MavCmd::DO_SET_MODE;

/// DO_SET_MODE as MAVSDK sends it, with main mode and sub-mode, and as pymavlink does, with the whole `custom_mode`.
#[test]
fn modes_are_set_by_two_numbers_or_by_one() {
    let mut wire = Wire::airborne();
    for (params, mode) in [
        ([129.0, 4.0, 5.0, NAN], Mode::Return),
        ([1.0, Mode::Hold.number() as f32, 0.0, 0.0], Mode::Hold),
        ([129.0, 4.0, 6.0, NAN], Mode::Land),
        ([1.0, Mode::Takeoff.number() as f32, NAN, NAN], Mode::Takeoff),
        ([129.0, 4.0, 3.0, NAN], Mode::Hold),
    ] {
        assert_eq!(wire.long(SET, &params), MavResult::ACCEPTED, "{params:?}");
        assert_eq!(wire.vehicle().mode(), mode);
    }
    // Invalid: a base mode only, an acrobatic mode, an unknown sub-mode, a fraction, a whole `custom_mode` with a sub-mode, NaN.
    for params in
        [[0.0, 4.0, 5.0], [1.0, 5.0, 0.0], [1.0, 4.0, 9.0], [1.0, 4.5, 5.0], [1.0, 262_144.0, 5.0], [1.0, NAN, 5.0]]
    {
        assert_eq!(wire.long(SET, &params), MavResult::DENIED, "{params:?}");
    }
    assert_eq!(wire.long_by(TELEMETRY, 0, SET, &[1.0, 4.0, 6.0]), MavResult::DENIED, "no broadcast (C-1)");
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// Standard modes, and the deprecated SET_MODE, which is answered as command 11 (C-32).
#[test]
fn modes_are_set_as_standard_modes_and_by_set_mode() {
    let mut wire = Wire::airborne();
    let standard =
        |wire: &mut Wire, mode: MavStandardMode| wire.long(MavCmd::DO_SET_STANDARD_MODE, &[f32::from(mode.0)]);
    for (meaning, mode) in [
        (MavStandardMode::SAFE_RECOVERY, Mode::Return),
        (MavStandardMode::TAKEOFF, Mode::Takeoff),
        (MavStandardMode::LAND, Mode::Land),
    ] {
        assert_eq!(standard(&mut wire, meaning), MavResult::ACCEPTED);
        assert_eq!(wire.vehicle().mode(), mode);
    }
    assert_eq!(standard(&mut wire, MavStandardMode::ORBIT), MavResult::DENIED);
    assert_eq!(standard(&mut wire, MavStandardMode::MISSION), MavResult::FAILED, "no mission");
    assert_eq!(
        standard(&mut wire, MavStandardMode::POSITION_HOLD),
        MavResult::TEMPORARILY_REJECTED,
        "no manual control"
    );
    assert_eq!(wire.texts().last().unwrap(), "Position mode refused: no manual control");
    let message =
        SetMode { target_system: 1, base_mode: MavModeFlag::CUSTOM_MODE_ENABLED, custom_mode: Mode::Hold.number() };
    wire.send(TELEMETRY, &message);
    assert_eq!(wire.answer(MavCmd(11)).result, MavResult::ACCEPTED);
    assert_eq!(wire.vehicle().mode(), Mode::Hold);
}

/// C-18: ACCEPTED means that the mode is reported within a second, for each mode and by all three ways, on the ground and in the
/// air, armed and not. Land mode on the ground was accepted while disarmed, and not entered.
#[test]
fn accepted_modes_are_reported() {
    let by_number = |wire: &mut Wire, number: u32, _| wire.long(SET, &[1.0, number as f32]);
    let by_standard = |wire: &mut Wire, _, standard: MavStandardMode| {
        wire.long(MavCmd::DO_SET_STANDARD_MODE, &[f32::from(standard.0)])
    };
    let by_message = |wire: &mut Wire, custom_mode, _| {
        let base_mode = MavModeFlag::CUSTOM_MODE_ENABLED;
        wire.send(TELEMETRY, &SetMode { target_system: 1, base_mode, custom_mode });
        wire.answer(MavCmd(11)).result
    };
    let modes = [
        (Mode::Land, MavStandardMode::LAND),
        (Mode::Return, MavStandardMode::SAFE_RECOVERY),
        (Mode::Takeoff, MavStandardMode::TAKEOFF),
        (Mode::Mission, MavStandardMode::MISSION),
        (Mode::Position, MavStandardMode::POSITION_HOLD),
        (Mode::Hold, MavStandardMode::NON_STANDARD),
        (Mode::Offboard, MavStandardMode::NON_STANDARD),
    ];
    for ask in [by_number as fn(&mut Wire, u32, MavStandardMode) -> MavResult, by_standard, by_message] {
        let armed = || {
            let mut wire = Wire::booted();
            assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
            wire
        };
        for mut wire in [Wire::booted(), armed(), Wire::airborne()] {
            for (mode, standard) in modes {
                // An extra heartbeat comes at most every 200 ms (H-16), and on the ground Land mode ends at once.
                wire.run(300);
                wire.take::<Heartbeat>();
                if ask(&mut wire, mode.number(), standard) == MavResult::ACCEPTED {
                    wire.run(1_000);
                    let reported = wire.take::<Heartbeat>();
                    assert!(reported.iter().any(|(_, beat)| beat.custom_mode == mode.number()), "{mode:?}");
                }
            }
            assert_eq!(wire.app.stack().hook_faults().unreported_modes, 0);
        }
        let mut wire = Wire::booted();
        wire.texts();
        assert_eq!(ask(&mut wire, Mode::Land.number(), MavStandardMode::LAND), MavResult::TEMPORARILY_REJECTED);
        assert_eq!(wire.texts(), ["Command refused: not armed"]);
    }
}

/// CURRENT_MODE: the intended mode ends when the mode completes, but not when a failsafe replaces it.
#[test]
fn the_intended_mode_lasts_until_it_completes() {
    let intended = |wire: &mut Wire| {
        wire.run(2_100);
        let (_, current) = wire.take::<CurrentMode>().pop().unwrap();
        assert_eq!(current.custom_mode, wire.vehicle().mode().number());
        current.intended_custom_mode
    };
    let mut wire = Wire::airborne();
    assert_eq!(intended(&mut wire), Mode::Hold.number(), "the takeoff is complete");
    assert_eq!(wire.long(MavCmd::NAV_LAND, &[]), MavResult::ACCEPTED);
    assert_eq!(intended(&mut wire), Mode::Land.number());
    wire.until("down", 60, |vehicle| !vehicle.is_armed());
    assert_eq!(intended(&mut wire), Mode::Hold.number(), "the landing is complete");
    assert_eq!(wire.long(SET, &[1.0, 4.0, 6.0]), MavResult::TEMPORARILY_REJECTED, "already landed");
    assert_eq!(intended(&mut wire), Mode::Hold.number(), "it does not land again");

    let mut wire = Wire::airborne();
    let (stack, _) = wire.app.parts();
    assert!(stack.parameters_mut().set(Tuning::COM_FLT_TIME_MAX, 6));
    wire.until("returning", 10, |vehicle| vehicle.mode() == Mode::Return);
    assert_eq!(intended(&mut wire), Mode::Hold.number());
}

/// AVAILABLE_MODES names each mode. CURRENT_MODE reports the current mode and the intended one.
#[test]
fn modes_are_reported() {
    let mut wire = Wire::airborne();
    assert_eq!(wire.long(MavCmd::REQUEST_MESSAGE, &[435.0, 0.0]), MavResult::ACCEPTED);
    wire.run(100);
    let listed = wire.take::<AvailableModes>();
    let names: Vec<_> = listed.iter().map(|(_, mode)| mode.mode_name.as_str().unwrap()).collect();
    assert_eq!(names, ["Position", "Offboard", "Takeoff", "Hold", "Mission", "Return", "Land"]);
    let is_auto = |mode: &AvailableModes| mode.properties.contains(MavModeProperty::AUTO_MODE);
    assert!(listed.iter().all(|(_, mode)| is_auto(mode) != (mode.custom_mode == Mode::Position.number())));
    wire.take::<CurrentMode>();
    wire.long(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
    wire.run(20);
    let (_, current) = wire.take::<CurrentMode>().pop().unwrap();
    let number = Mode::Return.number();
    assert_eq!((current.custom_mode, current.intended_custom_mode), (number, number));
    assert_eq!(current.standard_mode, MavStandardMode::SAFE_RECOVERY);
    wire.run(1_000);
    let (_, heartbeat) = wire.take::<Heartbeat>().pop().unwrap();
    assert_eq!((heartbeat.custom_mode, heartbeat.autopilot), (number, MavAutopilot::GENERIC));
}
