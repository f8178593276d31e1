//! What is checked of a command before it reaches the vehicle: rules C-1, C-5 to C-9, C-14; what is not checked: C-10, SEC-13;
//! commands with special answers: C-30.

use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::{LinkConfig, LinkId};

const NAN: f32 = f32::NAN;
/// Of both forms, at a position; its frame is GLOBAL_RELATIVE_ALT.
const PLACE: MavCmd = MavCmd::NAV_VTOL_TAKEOFF;
/// Of COMMAND_LONG only, not for everyone.
const MOTOR: MavCmd = MavCmd::DO_MOTOR_TEST;
/// Of COMMAND_INT only.
const FLY: MavCmd = MavCmd::DO_REPOSITION;

/// A vehicle that takes whatever passes.
fn world() -> World<1> {
    let mut world = World::new(Setup::new());
    for command in [PLACE, MOTOR, FLY, MavCmd::DO_REPEAT_SERVO] {
        world.vehicle.outcomes.insert(command.0, MavResult::ACCEPTED.into());
    }
    world
}

/// The one answer to what was sent; and that the vehicle heard of the command if, and only if, it was accepted.
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

/// C-4: each form where the command has it.
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

/// C-7: the frame of a command with a position is one that the vehicle knows; of another it says nothing.
#[test]
fn frame_is_checked_where_there_is_a_position() {
    let mut world = world();
    for frame in 0..=30 {
        let frame = MavFrame(frame);
        let knows = matches!(frame, MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT);
        let expected = if knows { MavResult::ACCEPTED } else { MavResult::COMMAND_UNSUPPORTED_MAV_FRAME };
        assert_eq!(int(&mut world, at(PLACE, frame, 473_977_418, 85_455_938, 20.0)), expected, "{frame:?}");
        // Each with a number of its own, since it is not carried out twice.
        let servo =
            CommandInt { param1: f32::from(frame.0), param3: 1.0, ..at(MavCmd::DO_REPEAT_SERVO, frame, 0, 0, 0.0) };
        assert_eq!(int(&mut world, servo), MavResult::ACCEPTED, "{frame:?}");
        world.run_for(secs(4));
    }
    // A COMMAND_LONG names none.
    assert_eq!(long(&mut world, PLACE, [0.0, 0.0, 0.0, NAN, 47.4, 8.5, 20.0]), MavResult::ACCEPTED);
}

/// C-6, C-7, C-8, SEC-14: positions on the globe or, where the command may do without, none; a NaN's bits in an integer are
/// garbage.
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

/// C-8, C-9: parameters are what the definitions say: integers whole and in range, enums listed, NaN where it means
/// something.
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

/// C-5: form before control, control before frame, frame before parameters; parameters before the vehicle's own verdict.
#[test]
fn checks_have_an_order() {
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
    // What the vehicle does not declare is its own business.
    world.vehicle.controller = Some(OTHER_STATION);
    assert_eq!(long(&mut world, MavCmd::NAV_LAND, [f32::INFINITY; 7]), MavResult::ACCEPTED);
}

/// C-1: a command that is not for everyone is refused to who means everyone.
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

/// C-30: the vehicle can tell when its answer has left, to the last byte, and reboots then.
#[test]
fn reboot_is_answered_first() {
    let lines = [LineConfig::radio(9_600, millis(0))];
    let mut world = World::new(Setup { lines, ..Setup::<1>::new() });
    world.vehicle.outcomes.insert(246, MavResult::ACCEPTED.into());
    world.run_for(millis(100));
    assert!(world.stack.has_answered(LinkId(0)));
    world.uarts[0].stall_writes_until(world.now().after(secs(1)));
    world.gcs[0].command_long(MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert!(world.run_until(millis(500), |world| !world.vehicle.commands().is_empty()));
    let asked = world.now();
    assert!(!world.stack.has_answered(LinkId(0)));
    assert!(world.run_until(secs(3), |world| world.stack.has_answered(LinkId(0))));
    assert!(world.now().since(asked) >= millis(500), "not while the line takes nothing");
    assert!(world.stack.has_answered(LinkId(9)), "a link that is not there owes nothing");
    // From here on the vehicle is gone; what its UART took still arrives.
    let later = world.now().after(millis(100));
    world.clock.set(later);
    world.gcs[0].poll(later);
    let (_, ack) = world.gcs[0].take::<CommandAck>().unwrap();
    assert_eq!(ack.result, MavResult::ACCEPTED);
}

/// C-10: `confirmation` decides nothing by itself. Most clients leave it at 0 when they repeat a command, and COMMAND_INT has
/// none: a command that runs is answered and not begun again whatever it says, an ordinary one is carried out each time.
#[test]
fn repetitions_are_known_without_their_confirmation() {
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

/// SEC-13: whether it disarms or reboots in flight is the vehicle's word alone. It hears of each, with all that was sent: no
/// number in a parameter makes the stack refuse, or carry out, anything by itself.
#[test]
fn disarming_and_rebooting_in_flight_is_for_the_vehicle_to_refuse() {
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
            assert!(world.gcs[0].count_of::<Heartbeat>() >= 2, "the stack itself does nothing");
        }
    }
}

/// C-14: a broadcast that resets, erases or restarts is never carried out; a text says why. The same commands for this vehicle
/// alone are not affected, nor are broadcasts that are meant for a fleet.
#[test]
fn a_broadcast_resets_and_erases_nothing() {
    // Storage, reboot, calibrations, CAN, upgrade, memory card, camera, compass; from other dialects the bootloader and the
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

/// C-14: a PREFLIGHT_STORAGE broadcast is denied whatever it requests: to read back, to write, to reset, or nothing.
#[test]
fn no_storage_for_everyone() {
    for parameters in [0.0, 1.0, 2.0, 4.0, -1.0, NAN] {
        let mut world = world();
        let storage = world.gcs[0].long(MavCmd::PREFLIGHT_STORAGE, [parameters, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.gcs[0].send(&CommandLong { target_system: 0, ..storage });
        assert_eq!(answer(&mut world), MavResult::DENIED);
    }
}

/// C-14, L-4: by satellite there is an answer but no text, neither on that link nor later.
#[test]
fn a_denied_broadcast_by_satellite_is_only_answered() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = World::<1>::new(Setup { links: [satellite], ..Setup::new() });
    let reboot = world.gcs[0].long(MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.gcs[0].send(&CommandLong { target_system: 0, ..reboot });
    assert_eq!(answer(&mut world), MavResult::DENIED);
    assert_eq!(world.gcs[0].received.len(), 1);
}
