//! Who gets the slots of commands, who may cancel one, and what a dead link or a peer that never ends keeps: rules.

use super::client::{COMPANION, EQUAL, GIMBAL, POINT, REQUEST, Sky, answer, beat, sent, sky};
use crate::support::*;
use mavstack::dialect::*;
use mavstack::message::SystemId;
use mavstack::{Address, CommandReply, LinkConfig};

const CALIBRATE: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
const ONCE: MavCmd = MavCmd::DO_REPEAT_SERVO;
const REJECTED: MavResult = MavResult::TEMPORARILY_REJECTED;
const RUNNING: MavResult = MavResult::IN_PROGRESS;
/// The link of the pilot, [`STATION`], and that of the others.
const PILOT: usize = 0;
const OTHERS: usize = 1;

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 2, commands: { slots: 3 }, operator_control)]
struct Controlled;

type Places = World<2, Controlled>;

fn world() -> Places {
    let mut world = Places::of(Setup { links: [LinkConfig::uart(115_200); 2], ..Setup::new() });
    world.vehicle.long.extend([CALIBRATE.0, 241, 242, 243]);
    world.vehicle.outcomes.insert(ONCE.0, MavResult::ACCEPTED.into());
    beat_all(&mut world);
    world
}

fn beat_all(world: &mut Places) {
    world.gcs[PILOT].send(&Gcs::heartbeat());
    world.gcs[OTHERS].send_from(OTHER_STATION, &Gcs::heartbeat());
    world.run_for(millis(20));
}

/// Gives a command, and returns its last answer.
fn give(world: &mut Places, link: usize, from: Address, command: MavCmd, param: u16) -> Option<MavResult> {
    let message = world.gcs[link].long(command, [1.0, f32::from(param), 3.0, 0.5, 0.0, 0.0, 0.0]);
    world.gcs[link].forget();
    world.gcs[link].send_from(from, &message);
    world.run_for(millis(10));
    world.gcs[link].all::<CommandAck>().last().map(|(_, ack)| ack.result)
}

/// a station that gives another command ten times a second had nearly all slots of commands that must not be carried out twice:
/// 3 of the pilot's 20 were carried out, and now all are. Also if that station uses the pilot's address on its own link, or a new
/// address each time.
#[test]
fn once_slots() {
    let names: [fn(u8) -> Address; 3] = [|_| OTHER_STATION, |_| STATION, |number| Address::new(10 + number % 200, 1)];
    let carried_out = names.map(|name| {
        let mut world = world();
        let mut number = 0u16;
        let pilots = (0..20).filter(|&command| {
            for _ in 0..35 {
                give(&mut world, OTHERS, name(number as u8), ONCE, number);
                number += 1;
                world.run_for(millis(90));
            }
            give(&mut world, PILOT, STATION, ONCE, command) == Some(MavResult::ACCEPTED)
        });
        pilots.count()
    });
    assert_eq!(carried_out, [20; 3]);
}

/// X-3, C-12: the sender with the most slots loses the one that ended first, and no other. A sender that has as many is rejected.
#[test]
fn oldest_of_the_most_gives_way() {
    let mut world = world();
    for (link, from, param) in [(OTHERS, OTHER_STATION, 1), (OTHERS, OTHER_STATION, 2), (PILOT, STATION, 3)] {
        assert_eq!(give(&mut world, link, from, ONCE, param), Some(MavResult::ACCEPTED));
    }
    assert_eq!(give(&mut world, OTHERS, OTHER_STATION, ONCE, 4), Some(REJECTED), "it has the most itself");
    assert_eq!(give(&mut world, PILOT, STATION, ONCE, 5), Some(MavResult::ACCEPTED));
    let given = world.vehicle.commands().len();
    for (link, from, param) in [(OTHERS, OTHER_STATION, 2), (PILOT, STATION, 3), (PILOT, STATION, 5)] {
        assert_eq!(give(&mut world, link, from, ONCE, param), Some(MavResult::ACCEPTED), "a known duplicate");
    }
    assert_eq!(world.vehicle.commands().len(), given);
}

/// invented senders on another link take no slot of a pilot who has as many as that link: a late duplicate of the pilot's command is
/// still known. Before, the third of them made the vehicle forget it, and it was carried out twice.
#[test]
fn invented_senders_make_no_link_forget() {
    let mut world = world();
    assert_eq!(give(&mut world, PILOT, STATION, ONCE, 1), Some(MavResult::ACCEPTED));
    for number in 0..20 {
        give(&mut world, OTHERS, Address::new(10 + number, 1), ONCE, 100 + u16::from(number));
    }
    let given = world.vehicle.commands().len();
    assert_eq!(give(&mut world, PILOT, STATION, ONCE, 1), Some(MavResult::ACCEPTED), "a known duplicate");
    assert_eq!(world.vehicle.commands().len(), given);
}

/// whoever waits, a running command goes on, and its end is answered.
#[test]
fn running_commands_keep_their_slots() {
    let mut world = world();
    for command in [241, 242, 243].map(MavCmd) {
        assert_eq!(give(&mut world, OTHERS, OTHER_STATION, command, 0), Some(RUNNING));
    }
    for param in 0..30 {
        assert_eq!(give(&mut world, PILOT, STATION, ONCE, param), Some(REJECTED));
        world.run_for(millis(990));
    }
    world.gcs[OTHERS].forget();
    assert!(world.stack.long_commands_mut().finish(MavCmd(241), MavResult::ACCEPTED));
    world.run_for(millis(20));
    assert!(world.gcs[OTHERS].all::<CommandAck>().iter().any(|(_, ack)| ack.result == MavResult::ACCEPTED));
    assert_eq!(give(&mut world, PILOT, STATION, ONCE, 99), Some(MavResult::ACCEPTED), "at once: the others have three");
}

/// three final answers that a dead link does not take held their slots for ten seconds, and now hold them for three, as others do.
/// That is so before the link counts as dead, and after it.
#[test]
fn dead_link() {
    for dead_for in [0, 20] {
        let mut world = world();
        for command in [241, 242, 243].map(MavCmd) {
            assert_eq!(give(&mut world, OTHERS, OTHER_STATION, command, 0), Some(RUNNING));
        }
        world.uarts[OTHERS].stall_writes_until(world.now() + secs(120));
        world.run_for(secs(dead_for));
        for command in [241, 242, 243].map(MavCmd) {
            assert!(world.stack.long_commands_mut().finish(command, MavResult::ACCEPTED));
        }
        world.run_for(millis(2_900));
        assert_eq!(give(&mut world, PILOT, STATION, CALIBRATE, 0), Some(REJECTED), "their answers may be sent");
        world.run_for(millis(150));
        assert_eq!(give(&mut world, PILOT, STATION, CALIBRATE, 0), Some(RUNNING));
    }
}

/// How a station asks to cancel the calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Cancel,
    Zeros,
}

/// Whether a running calibration of one station is cancelled by another.
fn is_cancelled(world: &mut Places, of: (usize, Address), by: (usize, Address), form: Form) -> bool {
    assert_eq!(give(world, of.0, of.1, CALIBRATE, 0), Some(RUNNING));
    match form {
        Form::Cancel => {
            let cancel = CommandCancel { command: CALIBRATE, target_system: 1, target_component: 1 };
            world.gcs[by.0].send_from(by.1, &cancel);
        }
        Form::Zeros => {
            let zeros = world.gcs[by.0].long(CALIBRATE, [0.0; 7]);
            world.gcs[by.0].send_from(by.1, &zeros);
        }
    }
    world.run_for(millis(20));
    let is_running = world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED);
    // Neither is remembered.
    world.run_for(secs(4));
    beat_all(world);
    !is_running
}

/// X-3, C-23: a command is cancelled by its sender on its link, and by the system in control. A secondary system in the same or another
/// name cancelled the owner's calibration, 4 of 4 times, and now 0 of 4. While nobody is in control everyone may cancel.
#[test]
fn cancel() {
    let (pilot, other, forger) = ((PILOT, STATION), (OTHERS, OTHER_STATION), (OTHERS, Address::new(254, 7)));
    for form in [Form::Cancel, Form::Zeros] {
        let mut world = world();
        for (of, by) in [(pilot, other), (other, pilot), (pilot, pilot)] {
            assert!(is_cancelled(&mut world, of, by, form), "{form:?}: nobody is in control");
        }
        world.stack.operator_control_mut().set_secondaries(&[SystemId::new(254)]);
        world.gcs[PILOT].command_long(MavCmd(32_100), [1.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0]);
        world.run_for(millis(20));
        assert_eq!(world.stack.operator(world.now()), Some(SystemId::new(255)));
        let expected = [
            (pilot, other, false),
            (pilot, forger, false),
            (other, other, true),
            (other, pilot, true),
            (pilot, pilot, true),
        ];
        for (of, by, is_expected) in expected {
            assert_eq!(is_cancelled(&mut world, of, by, form), is_expected, "{form:?}: {of:?} by {by:?}");
        }
    }
}

/// Answers with progress every second for so many seconds.
fn progress(world: &mut Sky, commands: &[MavCmd], seconds: u64, progress: impl Fn(u64) -> u8) {
    for second in 0..seconds {
        beat(world, COMPANION, GIMBAL, MavType::GIMBAL);
        for &command in commands {
            let ack = CommandAck {
                command,
                result: RUNNING,
                progress: progress(second),
                target_system: 1,
                target_component: 1,
                ..CommandAck::UNKNOWN
            };
            answer(world, COMPANION, GIMBAL, ack);
        }
        world.run_for(millis(990 - 10 * commands.len() as u64));
    }
}

/// Two slots, both taken by commands that the gimbal says it is carrying out.
fn both_running() -> (Sky, [MavCmd; 2]) {
    let mut world = sky();
    for token in [POINT, REQUEST] {
        assert!(world.stack.send_command(GIMBAL, token));
    }
    world.run_for(millis(20));
    (world, [MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, MavCmd::REQUEST_MESSAGE])
}

fn timed_out(world: &Sky) -> Vec<u16> {
    let replies = world.vehicle.replies.iter();
    replies.filter(|(_, reply)| *reply == CommandReply::TimedOut).map(|&(token, _)| token).collect()
}

fn is_sent(world: &Sky) -> bool {
    sent(world, COMPANION).iter().any(|&(_, command, _)| command == MavCmd::DO_SET_SERVO)
}

/// a peer that always answers with the same progress held a slot for ever: the third request was not sent within 120 s. Now it is
/// sent 30 s after the last change, and only one of the two gives way.
#[test]
fn progress_for_ever() {
    let (mut world, commands) = both_running();
    assert!(world.stack.send_command(GIMBAL, EQUAL));
    progress(&mut world, &commands, 29, |_| 255);
    assert_eq!((timed_out(&world), is_sent(&world)), (vec![], false));
    progress(&mut world, &commands, 4, |_| 255);
    assert_eq!((timed_out(&world).len(), is_sent(&world)), (1, true));
    progress(&mut world, &commands, 60, |_| 255);
    // The third has got no answer, and its slot is free.
    assert_eq!(timed_out(&world).len(), 2);
    assert!(timed_out(&world).contains(&EQUAL));
}

/// a calibration that takes long goes on while nothing waits; and while something waits, as long as its progress changes.
#[test]
fn honest_progress_goes_on() {
    let (mut world, commands) = both_running();
    progress(&mut world, &commands, 120, |_| 255);
    assert_eq!(timed_out(&world), []);
    // The change comes every 20 s.
    progress(&mut world, &commands, 1, |_| 0);
    assert!(world.stack.send_command(GIMBAL, EQUAL));
    progress(&mut world, &commands, 200, |second| (second / 20) as u8);
    assert_eq!((timed_out(&world), is_sent(&world)), (vec![], false));
}
