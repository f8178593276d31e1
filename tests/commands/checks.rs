//! Checks of a command before it reaches the vehicle: rules C-1, C-5 to C-9, C-14. Also what the stack does not check (C-10,
//! SEC-13) and commands with special answers (C-30).

use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::{LinkConfig, LinkId};

const NAN: f32 = f32::NAN;
/// Has both forms and a position; its frame is GLOBAL_RELATIVE_ALT.
const PLACE: MavCmd = MavCmd::NAV_VTOL_TAKEOFF;
/// COMMAND_LONG only; no broadcast.
const MOTOR: MavCmd = MavCmd::DO_MOTOR_TEST;
/// COMMAND_INT only.
const FLY: MavCmd = MavCmd::DO_REPOSITION;

/// A world whose vehicle accepts every command that passes the checks.
fn world() -> World<1> {
    let mut world = World::new(Setup::new());
    for command in [PLACE, MOTOR, FLY, MavCmd::DO_REPEAT_SERVO] {
        world.vehicle.outcomes.insert(command.0, MavResult::ACCEPTED.into());
    }
    world
}

/// Returns the only answer. Asserts that the vehicle received the command exactly if it was accepted.
fn answer(world: &mut World<1>) -> MavResult {
    let before = world.vehicle.commands().len();
    let ack: CommandAck = world.expect(0, millis(10));
    world.expect_no::<CommandAck>(0, millis(5));
    let heard = world.vehicle.commands().len() - before;
    assert_eq!(heard, usize::from(ack.result == MavResult::ACCEPTED), "{:?}", ack.result);
    ack.result
}

fn long(world: &mut World<1>, command: MavCmd, params: [f32; 7]) -> MavResult {
    world.gcs[0].command_long(command, params);
    answer(world)
}

fn int(world: &mut World<1>, message: CommandInt) -> MavResult {
    world.gcs[0].send(&CommandInt { target_system: 1, target_component: 1, ..message });
    answer(world)
}

fn at(command: MavCmd, frame: MavFrame, x: i32, y: i32, z: f32) -> CommandInt {
    CommandInt { command, frame, x, y, z, ..CommandInt::default() }
}

/// C-4: a command is accepted only in the forms that it has.
#[test]
fn form_is_checked() {
    let mut world = world();
    let motor = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(long(&mut world, MOTOR, motor), MavResult::ACCEPTED);
    let message = CommandInt { param1: 1.0, command: MOTOR, ..CommandInt::default() };
    assert_eq!(int(&mut world, message), MavResult::COMMAND_LONG_ONLY);
    assert_eq!(long(&mut world, FLY, [0.0; 7]), MavResult::COMMAND_INT_ONLY);
    assert_eq!(int(&mut world, at(FLY, MavFrame::GLOBAL, 0, 0, 5.0)), MavResult::ACCEPTED);
}

/// C-7: a command with a position must have a frame that the vehicle supports; without a position the frame is ignored.
#[test]
fn frame_is_checked_where_there_is_a_position() {
    let mut world = world();
    for frame in 0..=30 {
        let frame = MavFrame(frame);
        let knows = matches!(frame, MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT);
        let expected = if knows { MavResult::ACCEPTED } else { MavResult::COMMAND_UNSUPPORTED_MAV_FRAME };
        assert_eq!(int(&mut world, at(PLACE, frame, 473_977_418, 85_455_938, 20.0)), expected, "{frame:?}");
        // Parameter 1 makes each command unique, because this one is carried out once.
        let servo =
            CommandInt { param1: f32::from(frame.0), param3: 1.0, ..at(MavCmd::DO_REPEAT_SERVO, frame, 0, 0, 0.0) };
        assert_eq!(int(&mut world, servo), MavResult::ACCEPTED, "{frame:?}");
        world.run_for(secs(4));
    }
    // A COMMAND_LONG has no frame.
    assert_eq!(long(&mut world, PLACE, [0.0, 0.0, 0.0, NAN, 47.4, 8.5, 20.0]), MavResult::ACCEPTED);
}

/// C-6, C-7, C-8, SEC-14: a position must be on the globe, or absent where the command allows it. The bits of a NaN in an
/// integer are refused.
#[test]
fn position_is_checked() {
    let mut world = world();
    let frame = MavFrame::GLOBAL_RELATIVE_ALT;
    let none = i32::MAX;
    let nan = f32::NAN.to_bits().cast_signed();
    for (x, y, z, good) in [
        (900_000_000, -1_800_000_000, 0.0, true),
        (none, none, 10.0, true),
        (none, 0, 10.0, false),
        (0, none, 10.0, false),
        (900_000_001, 0, 0.0, false),
        (0, 1_800_000_001, 0.0, false),
        (nan, nan, 0.0, false),
        (i32::MIN, 0, 0.0, false),
        (0, 0, NAN, false),
        (0, 0, f32::INFINITY, false),
    ] {
        let expected = if good { MavResult::ACCEPTED } else { MavResult::DENIED };
        assert_eq!(int(&mut world, at(PLACE, frame, x, y, z)), expected, "{x}, {y}, {z}");
    }
    for (lat, lon, good) in [
        (90.0, -180.0, true),
        (NAN, NAN, true),
        (NAN, 8.0, false),
        (90.001, 0.0, false),
        (0.0, 180.1, false),
        (300.0, 0.0, false),
        (f32::NEG_INFINITY, 0.0, false),
    ] {
        let expected = if good { MavResult::ACCEPTED } else { MavResult::DENIED };
        assert_eq!(long(&mut world, PLACE, [0.0, 0.0, 0.0, 0.0, lat, lon, 1.0]), expected, "{lat}, {lon}");
    }
}

/// C-8, C-9: parameters must match their definition: integers whole and in range, enum values listed, NaN only where it has a
/// meaning.
#[test]
fn parameters_are_checked() {
    let mut world = world();
    let good = [1.0, 2.0, 55.5, 0.0, 1.0, 2.0, NAN];
    assert_eq!(long(&mut world, MOTOR, good), MavResult::ACCEPTED);
    for (index, value) in [
        (0, 0.0),
        (0, 1.5),
        (0, NAN),
        (0, 1e10),
        (1, 4.0),
        (1, -1.0),
        (2, f32::INFINITY),
        (3, -0.5),
        (4, 0.5),
        (5, 3.0),
        (5, NAN),
        (6, f32::NEG_INFINITY),
    ] {
        let mut params = good;
        params[index] = value;
        assert_eq!(long(&mut world, MOTOR, params), MavResult::DENIED, "parameter {} of {value}", index + 1);
    }
}

/// C-5: the order of checks is form, control, frame, parameters, and then the vehicle's own decision.
#[test]
fn checks_run_in_order() {
    let mut world = world();
    world.vehicle.controller = Some(OTHER_STATION);
    world.vehicle.outcomes.insert(PLACE.0, MavResult::FAILED.into());
    let mut wrong = at(PLACE, MavFrame::LOCAL_NED, i32::MIN, 0, NAN);
    let in_form = CommandInt { command: MOTOR, ..wrong };
    assert_eq!(int(&mut world, in_form), MavResult::COMMAND_LONG_ONLY);
    assert_eq!(int(&mut world, wrong), MavResult::NOT_IN_CONTROL);
    world.vehicle.controller = Some(STATION);
    assert_eq!(int(&mut world, wrong), MavResult::COMMAND_UNSUPPORTED_MAV_FRAME);
    wrong.frame = MavFrame::GLOBAL_RELATIVE_ALT;
    assert_eq!(int(&mut world, wrong), MavResult::DENIED);
    (wrong.x, wrong.z) = (0, 0.0);
    world.gcs[0].send(&CommandInt { target_system: 1, target_component: 1, ..wrong });
    assert_eq!(world.expect::<CommandAck>(0, millis(10)).result, MavResult::FAILED);
    // The stack checks no parameter of a command that the vehicle does not declare.
    world.vehicle.controller = Some(OTHER_STATION);
    assert_eq!(long(&mut world, MavCmd::NAV_LAND, [f32::INFINITY; 7]), MavResult::ACCEPTED);
}

/// C-1: a command that is declared without broadcasts is refused when it is sent to all systems.
#[test]
fn broadcast_is_refused_where_declared() {
    let mut world = world();
    let motor = CommandLong { target_system: 0, ..world.gcs[0].long(MOTOR, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]) };
    world.gcs[0].send(&motor);
    assert_eq!(answer(&mut world), MavResult::DENIED);
    let place = CommandLong { target_system: 0, ..world.gcs[0].long(PLACE, [0.0; 7]) };
    world.gcs[0].send(&place);
    assert_eq!(answer(&mut world), MavResult::ACCEPTED);
    assert!(world.vehicle.commands()[0].is_broadcast);
}

/// C-30: the vehicle learns when the last byte of its answer was sent, and reboots then.
#[test]
fn reboot_is_answered_before_it_happens() {
    let lines = [LineConfig::radio(9_600, millis(0))];
    let mut world = World::new(Setup { lines, ..Setup::<1>::new() });
    world.vehicle.outcomes.insert(246, MavResult::ACCEPTED.into());
    world.run_for(millis(100));
    assert!(world.stack.has_answered(LinkId(0)));
    world.uarts[0].stall_writes_until(world.now() + secs(1));
    world.gcs[0].command_long(MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert!(world.run_until(millis(500), |world| !world.vehicle.commands().is_empty()));
    let asked = world.now();
    assert!(!world.stack.has_answered(LinkId(0)));
    assert!(world.run_until(secs(3), |world| world.stack.has_answered(LinkId(0))));
    assert!(world.now() - asked >= millis(500), "not while the link is backpressured");
    assert!(world.stack.has_answered(LinkId(9)), "a link that does not exist has nothing pending");
    // The vehicle has rebooted; the bytes in its UART still arrive.
    let later = world.now() + millis(100);
    world.clock.set(later);
    world.gcs[0].poll(later);
    let (_, ack) = world.gcs[0].take::<CommandAck>().unwrap();
    assert_eq!(ack.result, MavResult::ACCEPTED);
}

/// C-10: `confirmation` alone does not identify a retransmission: most clients leave it at 0, and COMMAND_INT has none.
/// Whatever its value, a running command is answered and not started again, and an ordinary one is carried out each time.
#[test]
fn retransmission_is_recognised_without_confirmation() {
    for confirmations in [[0, 0, 0, 0], [0, 1, 2, 3], [3, 0, 255, 1]] {
        let mut world = world();
        let (calibrate, land) = (MavCmd::PREFLIGHT_CALIBRATION, MavCmd::NAV_LAND);
        world.vehicle.long.insert(calibrate.0);
        for confirmation in confirmations {
            for command in [calibrate, land] {
                let message = world.gcs[0].long(command, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
                world.gcs[0].send(&CommandLong { confirmation, ..message });
            }
            world.run_for(millis(50));
        }
        let count = |command| world.vehicle.commands().iter().filter(|other| other.id == command).count();
        assert_eq!((count(calibrate), count(land)), (1, 4), "{confirmations:?}");
        let results: Vec<_> = world.gcs[0].all::<CommandAck>().iter().map(|(_, ack)| ack.result).collect();
        assert_eq!(results, [[MavResult::IN_PROGRESS, MavResult::ACCEPTED]; 4].concat(), "{confirmations:?}");
    }
    let mut world = world();
    world.vehicle.long.insert(MavCmd::PREFLIGHT_CALIBRATION.0);
    for _ in 0..4 {
        world.gcs[0].command_int(MavCmd::PREFLIGHT_CALIBRATION, [1.0, 0.0, 0.0, 0.0]);
        world.run_for(millis(50));
    }
    assert_eq!((world.vehicle.commands().len(), world.gcs[0].count_of::<CommandAck>()), (1, 4));
}

/// SEC-13: only the vehicle decides whether to disarm or reboot in flight. It gets each command with all its parameters; no
/// parameter value makes the stack refuse or carry out anything by itself.
#[test]
fn only_the_vehicle_refuses_to_disarm_or_reboot_in_flight() {
    let (disarm, reboot) = (MavCmd::COMPONENT_ARM_DISARM, MavCmd::PREFLIGHT_REBOOT_SHUTDOWN);
    for (command, params) in [
        (disarm, [0.0; 7]),
        (disarm, [0.0, 21_196.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (reboot, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (reboot, [1.0, 0.0, 0.0, 0.0, 0.0, 20_190_226.0, 0.0]),
        (reboot, [42.0, 24.0, 71.0, 93.0, 0.0, 0.0, 0.0]),
    ] {
        for verdict in [MavResult::TEMPORARILY_REJECTED, MavResult::DENIED, MavResult::ACCEPTED] {
            let mut world = world();
            world.vehicle.state.as_mut().unwrap().base_mode |= MavModeFlag::SAFETY_ARMED;
            world.vehicle.outcomes.insert(command.0, verdict.into());
            world.gcs[0].command_long(command, params);
            assert_eq!(world.expect::<CommandAck>(0, millis(10)).result, verdict);
            let [heard] = world.vehicle.commands()[..] else { panic!("{:?}", world.vehicle.calls) };
            let (param5, param6) = heard.position.params();
            let [p1, p2, p3, p4] = heard.params;
            assert_eq!([p1, p2, p3, p4, param5, param6, heard.z], params);
            world.run_for(secs(2));
            assert!(world.gcs[0].count_of::<Heartbeat>() >= 2, "the stack does nothing by itself");
        }
    }
}

/// C-14: a broadcast that resets, erases or restarts is refused with a text. The same commands addressed to this vehicle are
/// carried out, and so are broadcasts that are meant for a fleet.
#[test]
fn broadcast_cannot_reset_or_erase() {
    // Storage, reboot, calibrations, CAN, upgrade, memory card, camera, compass; of other dialects the bootloader and the
    // system id.
    let never = [245, 246, 241, 242, 243, 247, 500, 526, 529, 42_006, 42_424, 42_650, 42_651, 610].map(MavCmd);
    let fleet = [MavCmd::COMPONENT_ARM_DISARM, MavCmd::NAV_LAND, MavCmd::DO_FLIGHTTERMINATION, MavCmd::MISSION_START];
    for (command, is_denied) in never.map(|id| (id, true)).into_iter().chain(fleet.map(|id| (id, false))) {
        for is_long in [true, false] {
            let mut world = world();
            world.vehicle.outcomes.insert(command.0, MavResult::ACCEPTED.into());
            let send = |world: &mut World<1>, target_system, target_component| {
                let params = [2.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
                let long = world.gcs[0].long(command, params);
                let int = CommandInt { command, param1: 2.0, param2: -1.0, ..CommandInt::default() };
                if is_long {
                    world.gcs[0].send(&CommandLong { target_system, target_component, ..long });
                } else {
                    world.gcs[0].send(&CommandInt { target_system, target_component, ..int });
                }
                world.expect::<CommandAck>(0, millis(10)).result
            };
            for target_component in [0, 1] {
                world.stack.parameters_mut().set(Tuning::CRUISE, 9.0);
                let heard = world.vehicle.commands().len();
                let result = send(&mut world, 0, target_component);
                assert_eq!(result == MavResult::DENIED, is_denied, "{command:?}");
                if is_denied {
                    assert_eq!(world.vehicle.commands().len(), heard, "{command:?}");
                    assert_eq!(world.stack.parameters().get(Tuning::CRUISE), 9.0);
                }
            }
            world.run_for(millis(50));
            let why = format!("Command {} refused: sent to 0; use system 1", command.0);
            let texts = world.gcs[0].all::<Statustext>();
            let is_told = texts.iter().any(|(_, text)| text.text.as_bytes() == why.as_bytes());
            assert_eq!(is_told, is_denied && cfg!(feature = "plan-texts"), "{command:?}: {texts:?}");
            assert_eq!(send(&mut world, 1, 0), MavResult::ACCEPTED, "{command:?}");
            let is_reset = world.stack.parameters().get(Tuning::CRUISE) != 9.0;
            assert_eq!(is_reset, command == MavCmd::PREFLIGHT_STORAGE);
        }
    }
}

/// C-14: a PREFLIGHT_STORAGE broadcast is denied whatever it requests: read, write, reset, or nothing.
#[test]
fn preflight_storage_broadcast_is_denied() {
    for parameters in [0.0, 1.0, 2.0, 4.0, -1.0, NAN] {
        let mut world = world();
        let storage = world.gcs[0].long(MavCmd::PREFLIGHT_STORAGE, [parameters, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.gcs[0].send(&CommandLong { target_system: 0, ..storage });
        assert_eq!(answer(&mut world), MavResult::DENIED);
    }
}

/// C-14, L-4: over a high-latency link the refusal is an answer only; the text is sent on no link.
#[test]
fn refused_broadcast_over_satellite_has_no_text() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = World::<1>::new(Setup { links: [satellite], ..Setup::new() });
    let reboot = world.gcs[0].long(MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.gcs[0].send(&CommandLong { target_system: 0, ..reboot });
    assert_eq!(answer(&mut world), MavResult::DENIED);
    assert_eq!(world.gcs[0].received.len(), 1);
}
