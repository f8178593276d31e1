//! Commands that must be carried out once although a client retransmits them on its link with the same confirmation: rule C-12.

use crate::support::*;
use mavstack::dialect::*;

const ONCE: MavCmd = MavCmd::DO_REPEAT_SERVO;
const PARAMS: [f32; 7] = [1.0, 0.0, 3.0, 0.5, 0.0, 0.0, f32::NAN];

fn world() -> World<2> {
    let mut world = World::new(Setup::<2>::new());
    world.vehicle.outcomes.insert(ONCE.0, MavResult::ACCEPTED.into());
    world.run_for(millis(10));
    world
}

/// Returns the answers that the ground station of `link` received since the last call.
fn answers(world: &mut World<2>, link: usize) -> Vec<MavResult> {
    let gcs = &mut world.gcs[link];
    std::iter::from_fn(|| gcs.take::<CommandAck>()).map(|(_, ack)| ack.result).collect()
}

/// Sends `message` at these times (ms) on these links and returns the times at which it was carried out. Each message must get
/// the same answer.
fn carried_out(world: &mut World<2>, message: &CommandLong, times: &[(u64, usize)]) -> Vec<u64> {
    let mut done = Vec::new();
    let start = world.now();
    for &(at, link) in times {
        world.run_for((start + millis(at)) - world.now());
        let before = world.vehicle.commands().len();
        world.gcs[link].send(message);
        world.run_for(millis(4));
        assert_eq!(answers(world, link), [MavResult::ACCEPTED], "at {at}");
        if world.vehicle.commands().len() > before {
            done.push(at);
        }
    }
    done
}

/// C-12: a retransmission on the same link with the same confirmation is not carried out. MAVSDK retransmits after 0.5, 1.0 and
/// 1.5 s. A duplicate is received within a second of the previous one and within three seconds of the first. A later command
/// is new.
#[test]
fn retransmission_after_lost_answer_is_not_carried_out() {
    for (times, expected) in [
        (&[0, 500, 1_000, 1_500][..], &[0][..]),
        // One retransmission after the other.
        (&[0, 500, 1_490, 2_980], &[0, 2_980]),
        (&[0, 990], &[0]),
        (&[0, 1_010], &[0, 1_010]),
        (&[0, 10, 20, 30, 1_040], &[0, 1_040]),
        // However long the client retransmits, a command is new after three seconds.
        (&[0, 700, 1_400, 2_100, 2_800, 3_500, 4_200], &[0, 3_500]),
    ] {
        for confirmation in [0, 3] {
            let mut world = world();
            let message = CommandLong { confirmation, ..world.gcs[0].long(ONCE, PARAMS) };
            let times: Vec<_> = times.iter().map(|&at| (at, 1)).collect();
            assert_eq!(carried_out(&mut world, &message, &times), expected, "{times:?}");
        }
    }
}

/// C-12: a command that is retransmitted on both links is carried out once, whichever frames are lost. The rule for the other
/// link is the same.
#[test]
fn retransmissions_on_two_links_are_one_command() {
    for times in [
        &[(0, 0), (100, 1), (500, 0), (600, 1), (1_000, 0), (1_100, 1), (1_500, 0), (1_600, 1)][..],
        // Link 0 fails after the first.
        &[(0, 0), (900, 1), (1_400, 1), (1_900, 1), (2_400, 1)],
        &[(0, 0), (500, 0), (1_000, 0), (2_900, 1), (2_950, 1), (2_960, 1)],
    ] {
        let mut world = world();
        let message = world.gcs[0].long(ONCE, PARAMS);
        assert_eq!(carried_out(&mut world, &message, times), [0], "{times:?}");
    }
    let mut world = world();
    let message = world.gcs[0].long(ONCE, PARAMS);
    let times = [(0, 0), (2_000, 1), (2_500, 0), (3_600, 0), (3_700, 1)];
    // The first command is then 3.6 s old, so this one is new.
    assert_eq!(carried_out(&mut world, &message, &times), [0, 3_600]);
}

/// C-12: on the same link, other parameters or another sender make a new command, however soon it is received.
#[test]
fn other_parameters_are_a_new_command() {
    let mut world = world();
    let first = world.gcs[0].long(ONCE, PARAMS);
    let others = [
        CommandLong { param1: 2.0, ..first },
        CommandLong { param7: 0.0, ..first },
        CommandLong { target_system: 0, ..first },
    ];
    for message in others {
        let before = world.vehicle.commands().len();
        world.gcs[0].send(&first);
        world.gcs[0].send(&message);
        world.gcs[0].send_from(OTHER_STATION, &first);
        world.run_for(millis(5));
        assert_eq!(world.vehicle.commands().len(), before + 3, "{message:?}");
        world.run_for(secs(4));
    }
}

/// C-12: where the vehicle declares that every press counts, a duplicate needs another link or a higher confirmation.
#[test]
fn each_press_counts_if_declared() {
    const PRESS: MavCmd = MavCmd::DO_REPEAT_RELAY;
    let mut world = world();
    world.vehicle.outcomes.insert(PRESS.0, MavResult::ACCEPTED.into());
    let message = world.gcs[0].long(PRESS, [1.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    let times = [(0, 0), (200, 0), (300, 1), (310, 1), (400, 0)];
    assert_eq!(carried_out(&mut world, &message, &times), [0, 200, 400]);
    let repeated = CommandLong { confirmation: 1, ..message };
    assert_eq!(carried_out(&mut world, &repeated, &[(0, 0), (100, 0), (200, 1)]), []);
}

/// C-21: a running command that runs once is answered IN_PROGRESS like any other. Sent again after its end, it starts again.
#[test]
fn running_command_is_in_progress_also_if_it_runs_once() {
    let mut world = world();
    world.vehicle.outcomes.remove(&ONCE.0);
    world.vehicle.long.insert(ONCE.0);
    for _ in 0..4 {
        world.gcs[0].command_long(ONCE, PARAMS);
        world.run_for(millis(400));
    }
    assert!(answers(&mut world, 0).iter().all(|answer| *answer == MavResult::IN_PROGRESS));
    world.stack.long_commands_mut().finish(ONCE, MavResult::FAILED);
    for _ in 0..2 {
        world.gcs[0].command_long(ONCE, PARAMS);
        world.run_for(millis(600));
    }
    assert_eq!(answers(&mut world, 0), [MavResult::FAILED; 3], "the final ACK, and one for each retransmission");
    assert_eq!(world.vehicle.commands().len(), 1);
    world.run_for(secs(3));
    world.gcs[0].command_long(ONCE, PARAMS);
    world.run_for(millis(5));
    assert_eq!(answers(&mut world, 0), [MavResult::IN_PROGRESS]);
}

/// C-12: after TEMPORARILY_REJECTED the same command on the same link asks the vehicle again, which may accept it now. A
/// duplicate on another link does not.
#[test]
fn temporarily_rejected_command_can_be_sent_again() {
    const NOT_NOW: MavResult = MavResult::TEMPORARILY_REJECTED;
    for confirmation in [0, 3] {
        let mut world = world();
        let message = CommandLong { confirmation, ..world.gcs[0].long(ONCE, PARAMS) };
        let mut ask = |link: usize, outcome: MavResult| {
            world.vehicle.outcomes.insert(ONCE.0, outcome.into());
            world.gcs[link].send(&message);
            world.run_for(millis(200));
            (answers(&mut world, link), world.vehicle.commands().len())
        };
        assert_eq!(ask(0, NOT_NOW), (vec![NOT_NOW], 1));
        assert_eq!(ask(1, MavResult::ACCEPTED), (vec![NOT_NOW], 1), "a duplicate");
        assert_eq!(ask(0, NOT_NOW), (vec![NOT_NOW], 2), "asked again");
        assert_eq!(ask(0, MavResult::ACCEPTED), (vec![MavResult::ACCEPTED], 3), "and again");
        assert_eq!(ask(0, MavResult::FAILED), (vec![MavResult::ACCEPTED], 3), "carried out once");
        for _ in 0..2 {
            assert_eq!(ask(1, MavResult::FAILED), (vec![MavResult::ACCEPTED], 3), "duplicates");
        }
    }
}
