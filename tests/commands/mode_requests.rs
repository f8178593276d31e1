//! Requests for another flight mode: rules C-32, C-1, C-4, C-5, C-8, C-9, D-3.

use super::modes::{ACCEPTED, CUSTOM, DENIED, INF, NAN, SET, SET_STANDARD};
use crate::support::pilot::*;
use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::{Address, LinkId, ModeRequest, Outcome, Peer};

/// Sends each of `rows` as COMMAND_LONG and as COMMAND_INT: the parameters, and the requested mode, or `None` for DENIED.
fn check_rows<const W: u8>(id: MavCmd, rows: &[(&[f32], Option<u32>)]) {
    let mut world = world::<1, W>();
    for (params, mode) in rows {
        let result = command(&mut world, 0, id, params);
        assert_eq!(result, if mode.is_some() { ACCEPTED } else { DENIED }, "{params:?}");
        assert_eq!(asked(&mut world), Vec::from_iter(*mode), "{params:?}");
        let [p1, p2, p3, p4, ..] = seven(params);
        world.gcs[0].command_int(id, [p1, p2, p3, p4]);
        assert_eq!(world.expect::<CommandAck>(0, millis(10)).result, result, "{params:?}");
        assert_eq!(asked(&mut world), Vec::from_iter(*mode), "{params:?}");
    }
    assert_eq!(world.vehicle.commands, 0, "the hook for commands is not called");
}

/// C-8, C-9: PX4's encoding: a main mode and a sub-mode, or both in one number.
#[test]
fn do_set_mode_with_main_and_sub_mode() {
    check_rows::<PX4>(
        SET,
        &[
            (&[CUSTOM, 3.0, 0.0], Some(POSITION)),
            (&[CUSTOM, 4.0, 3.0], Some(HOLD)),
            (&[209.0, 4.0, 5.0, NAN, NAN, NAN, NAN], Some(RETURN)),
            (&[CUSTOM, 3.0, NAN], Some(POSITION)),
            (&[CUSTOM, HOLD as f32, 0.0], Some(HOLD)),
            (&[CUSTOM, RETURN as f32, NAN], Some(RETURN)),
            // Unknown: a main mode, a sub-mode, a number that is a mode of other autopilots, and the neighbour of a known one.
            (&[CUSTOM, 5.0, 0.0], None),
            (&[CUSTOM, 4.0, 0.0], None),
            (&[CUSTOM, 4.0, 9.0], None),
            (&[CUSTOM, TEST as f32, 0.0], None),
            (&[CUSTOM, ODD as f32, 0.0], None),
            // A whole mode has no sub-mode.
            (&[CUSTOM, HOLD as f32, 3.0], None),
            // Not selectable.
            (&[CUSTOM, 9.0, 0.0], None),
            // Not numbers.
            (&[CUSTOM, NAN, 0.0], None),
            (&[CUSTOM, INF, 0.0], None),
            (&[CUSTOM, -3.0, 0.0], None),
            (&[CUSTOM, 3.5, 0.0], None),
            (&[CUSTOM, 4.0, 3.5], None),
            (&[CUSTOM, 4.0, -1.0], None),
            (&[CUSTOM, 4.0, 259.0], None),
            (&[CUSTOM, 4.0, INF], None),
        ],
    );
}

/// Without CUSTOM_MODE_ENABLED the flags name no mode. The armed flag is ignored.
#[test]
fn do_set_mode_needs_the_custom_flag() {
    check_rows::<PX4>(
        SET,
        &[
            (&[1.0, 4.0, 3.0], Some(HOLD)),
            (&[129.0, 4.0, 3.0], Some(HOLD)),
            (&[255.0, 4.0, 3.0], Some(HOLD)),
            (&[0.0, 4.0, 3.0], None),
            (&[128.0, 4.0, 3.0], None),
            (&[220.0, 4.0, 3.0], None),
            (&[257.0, 4.0, 3.0], None),
            (&[1.5, 4.0, 3.0], None),
            (&[-1.0, 4.0, 3.0], None),
            (&[NAN, 4.0, 3.0], None),
            (&[INF, 4.0, 3.0], None),
        ],
    );
}

/// C-8, C-9: ArduPilot's encoding: the whole mode in parameter 2.
#[test]
fn do_set_mode_with_a_whole_mode() {
    check_rows::<ARDUPILOT>(
        SET,
        &[
            (&[CUSTOM, TEST as f32], Some(TEST)),
            (&[CUSTOM, TEST as f32, NAN], Some(TEST)),
            (&[CUSTOM, HOLD as f32], Some(HOLD)),
            // A sub-mode means PX4's encoding.
            (&[CUSTOM, TEST as f32, 3.0], None),
            (&[CUSTOM, 4.0, 3.0], None),
            (&[CUSTOM, 8.0], None),
            (&[CUSTOM, AFLOAT as f32], None),
            (&[CUSTOM, NAN], None),
            (&[CUSTOM, 7.25], None),
            (&[CUSTOM, 4_294_967_296.0], None),
            (&[CUSTOM, -7.0], None),
        ],
    );
}

/// C-9: MAV_CMD_DO_SET_STANDARD_MODE, for the standard modes that the vehicle has.
#[test]
fn do_set_standard_mode() {
    check_rows::<PX4>(
        SET_STANDARD,
        &[
            (&[1.0], Some(POSITION)),
            (&[6.0, NAN, NAN, NAN, NAN, NAN, NAN], Some(MISSION)),
            (&[5.0], Some(RETURN)),
            // NON_STANDARD, two that the vehicle lacks, one that is not selectable, and an undefined one.
            (&[0.0], None),
            (&[2.0], None),
            (&[8.0], None),
            (&[7.0], None),
            (&[9.0], None),
            (&[261.0], None),
            (&[1.5], None),
            (&[-1.0], None),
            (&[NAN], None),
            (&[INF], None),
        ],
    );
}

/// C-32: SET_MODE is answered by a COMMAND_ACK with its message id, to its sender on the same link. It accepts any mode number.
#[test]
fn set_mode_is_answered() {
    let mut world = world::<2, PX4>();
    for (base_mode, custom_mode, result) in [
        (1, HOLD, ACCEPTED),
        (1, TEST, ACCEPTED),
        (1, ODD, ACCEPTED),
        // QGroundControl sends the first to an armed vehicle. The armed flag alone does not arm.
        (129, HOLD, ACCEPTED),
        (0, HOLD, DENIED),
        (128, HOLD, DENIED),
        (1, 0, DENIED),
        (1, ODD - 1, DENIED),
        (1, 4, DENIED),
        (1, AFLOAT, DENIED),
    ] {
        world.gcs[1].send_from(OTHER_STATION, &set_mode(base_mode, custom_mode));
        let ack: CommandAck = world.expect(1, millis(10));
        let to = Address::new(ack.target_system, ack.target_component);
        assert_eq!((ack.command, ack.result, to), (MavCmd(11), result, OTHER_STATION), "{base_mode} {custom_mode:#x}");
        let from = Peer { address: OTHER_STATION, link: LinkId(1) };
        let expected = (custom_mode, ModeRequest { from, class: LinkClass::Normal, age: None, is_broadcast: false });
        let asked = std::mem::take(&mut world.vehicle.asked);
        assert_eq!(asked, Vec::from_iter((result == ACCEPTED).then_some(expected)));
    }
    world.gcs[1].send(&SetMode { target_system: 2, ..set_mode(1, HOLD) });
    world.expect_no::<CommandAck>(1, millis(20));
    world.expect_no::<CommandAck>(0, millis(20));
    assert_eq!((asked(&mut world), &world.vehicle.messages), (vec![], &vec![]), "the hook for messages is not called");
}

/// D-3: a SET_MODE without room for its answer is not carried out.
#[test]
fn set_mode_without_room_is_not_carried_out() {
    let mut world = world::<1, PX4>();
    world.run_for(millis(10));
    world.uarts[0].stall_writes_until(world.now() + millis(100));
    for _ in 0..6 {
        world.gcs[0].send(&set_mode(1, HOLD));
    }
    world.run_for(millis(300));
    assert_eq!(world.vehicle.asked.len(), 4, "no room for the answer, no change");
    assert_eq!(world.gcs[0].count_of::<CommandAck>(), 4);
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().no_answer_slot, 2);
}

/// C-4: the vehicle's outcome is sent, whichever message requested the mode.
#[test]
fn outcome_of_the_vehicle_is_sent() {
    let mut world = world::<1, PX4>();
    world.vehicle.verdict = Outcome { result: MavResult::TEMPORARILY_REJECTED, result_param2: -5 };
    world.gcs[0].command_long(SET, seven(&[CUSTOM, 4.0, 3.0]));
    world.gcs[0].command_long(SET_STANDARD, seven(&[1.0]));
    world.gcs[0].send(&set_mode(1, HOLD));
    for command in [SET, SET_STANDARD, MavCmd(11)] {
        let ack: CommandAck = world.expect(0, millis(10));
        let said = (ack.command, ack.result, ack.result_param2, ack.progress);
        assert_eq!(said, (command, MavResult::TEMPORARILY_REJECTED, -5, 255));
    }
}

/// C-1: the vehicle sees that a request was a broadcast.
#[test]
fn broadcasts_are_marked() {
    let mut world = world::<1, PX4>();
    let broadcast = CommandLong { target_system: 0, ..world.gcs[0].long(SET, seven(&[CUSTOM, 4.0, 3.0])) };
    world.gcs[0].send(&broadcast);
    world.gcs[0].send(&CommandLong { command: SET_STANDARD, ..broadcast });
    world.gcs[0].send(&SetMode { target_system: 0, ..set_mode(1, HOLD) });
    world.gcs[0].send(&set_mode(1, HOLD));
    world.run_for(millis(10));
    let marks: Vec<_> = world.vehicle.asked.iter().map(|(_, request)| request.is_broadcast).collect();
    assert_eq!(marks, [true, true, true, false]);
}

/// C-5: the declared policy for MAV_CMD_DO_SET_MODE also applies to SET_MODE, which must not bypass it.
#[test]
fn policy_applies_to_both_messages() {
    let mut world = world::<1, DECLARED>();
    let both = |world: &mut Piloted<1, DECLARED>, target_system| {
        let long = CommandLong { target_system, ..world.gcs[0].long(SET, seven(&[CUSTOM, 4.0, 3.0])) };
        world.gcs[0].send(&long);
        world.gcs[0].send(&SetMode { target_system, ..set_mode(1, HOLD) });
        let results = [0, 0].map(|link| world.expect::<CommandAck>(link, millis(10)).result);
        assert_eq!(results[0], results[1]);
        (results[0], asked(world).len())
    };
    assert_eq!(both(&mut world, 0), (DENIED, 0));
    assert_eq!(both(&mut world, 1), (ACCEPTED, 2));
    world.vehicle.controller = Some(OTHER_STATION);
    assert_eq!(both(&mut world, 1), (MavResult::NOT_IN_CONTROL, 0));
    assert_eq!(both(&mut world, 0), (MavResult::NOT_IN_CONTROL, 0), "control is checked first");
    world.vehicle.controller = Some(STATION);
    assert_eq!(both(&mut world, 1), (ACCEPTED, 2));
    // Without a declaration every station may set the mode.
    world.vehicle.controller = Some(OTHER_STATION);
    assert_eq!(command(&mut world, 0, SET_STANDARD, &[1.0]), ACCEPTED);
}

/// Returns the texts that the station of link 0 has received since the last call.
fn texts(world: &mut Piloted<1, PX4>) -> Vec<String> {
    let gcs = &mut world.gcs[0];
    let texts = std::iter::from_fn(|| gcs.take::<Statustext>());
    texts.map(|(_, text)| text.text.as_str().unwrap().to_owned()).collect()
}

/// Asks for Hold by each of the three messages, or for Position as a standard mode.
const WAYS: [fn(&mut Piloted<1, PX4>) -> u32; 3] = [
    |world| {
        assert_eq!(command(world, 0, SET, &[CUSTOM, 4.0, 3.0]), ACCEPTED);
        HOLD
    },
    |world| {
        assert_eq!(command(world, 0, SET_STANDARD, &[1.0]), ACCEPTED);
        POSITION
    },
    |world| {
        world.gcs[0].send(&set_mode(1, HOLD));
        assert_eq!(world.expect::<CommandAck>(0, millis(10)).result, ACCEPTED);
        HOLD
    },
];

/// C-18: a mode that the vehicle has accepted, and does not report within a second, is counted and reported, once, whichever
/// message asked for it. In a fault no mode is reported.
#[test]
fn accepted_mode_that_is_not_reported_is_counted() {
    for ask in WAYS {
        for is_faulty in [false, true] {
            let mut world = world::<1, PX4>();
            let mode = ask(&mut world);
            if is_faulty {
                world.vehicle.enter(mode);
                world.vehicle.state = None;
            }
            let fault = "Accepted mode was not reported".to_owned();
            world.run_for(millis(900));
            assert_eq!((texts(&mut world), world.stack.hook_faults().unreported_modes), (vec![], 0));
            world.run_for(millis(200));
            assert_eq!((texts(&mut world), world.stack.hook_faults().unreported_modes), (vec![fault], 1));
            world.run_for(secs(5));
            assert_eq!((texts(&mut world), world.stack.hook_faults().unreported_modes), (vec![], 1));
        }
    }
}

/// C-18: a mode that is reported within a second is no fault, even if another one follows at once. Neither is a refused one. A
/// sleeping loop notices the fault in time.
#[test]
fn accepted_mode_that_is_reported_is_not_counted() {
    for ask in WAYS {
        let mut world = world::<1, PX4>();
        let mode = ask(&mut world);
        world.run_for(millis(900));
        world.vehicle.enter(mode);
        world.run_for(millis(20));
        world.vehicle.enter(RETURN);
        world.run_for(secs(3));
        // The present mode, and a refused one.
        world.vehicle.enter(mode);
        ask(&mut world);
        world.vehicle.enter(TEST);
        world.run_for(secs(3));
        world.vehicle.verdict = MavResult::TEMPORARILY_REJECTED.into();
        world.gcs[0].send(&set_mode(1, RETURN));
        world.run_for(secs(3));
        assert_eq!((texts(&mut world), world.stack.hook_faults().unreported_modes), (vec![], 0));
    }
    let mut world = world::<1, PX4>();
    world.gcs[0].send(&set_mode(1, RETURN));
    world.sleep_for(millis(1_050));
    assert_eq!(world.stack.hook_faults().unreported_modes, 1);
}

/// C-20: IN_PROGRESS for a mode is a promise that nothing ends: FAILED, counted, with a text.
#[test]
fn mode_in_progress_fails() {
    let mut world = world::<1, PX4>();
    world.vehicle.verdict = MavResult::IN_PROGRESS.into();
    for number in 1..=3 {
        world.run_for(secs(2));
        match number {
            1 => world.gcs[0].command_long(SET, seven(&[CUSTOM, 4.0, 3.0])),
            2 => world.gcs[0].command_long(SET_STANDARD, seven(&[1.0])),
            _ => world.gcs[0].send(&set_mode(1, HOLD)),
        }
        assert_eq!(world.expect::<CommandAck>(0, millis(10)).result, MavResult::FAILED);
        world.run_for(millis(50));
        assert_eq!(texts(&mut world), ["IN_PROGRESS without a slot"]);
        assert_eq!(world.stack.hook_faults().unfinished, number);
    }
}
