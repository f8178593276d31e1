//! Long-running commands, and commands that must be carried out once: rules C-12, C-20 to C-24, C-3, L-4. A property: no
//! sequence of frames causes a missing or a second answer.

use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::{Address, Duration, Instant, LinkConfig, LinkId, Outcome, Peer};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

const CALIBRATE: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
const ONCE: MavCmd = MavCmd::DO_REPEAT_SERVO;
const PARAMS: [f32; 7] = [1.0, 0.0, 3.0, 0.5, 0.0, 0.0, f32::NAN];

/// A world whose vehicle calibrates in the background.
fn world<const N: usize>() -> World<N> {
    let mut world = World::new(Setup::<N>::new());
    world.vehicle.long.insert(CALIBRATE.0);
    world.vehicle.outcomes.insert(ONCE.0, MavResult::ACCEPTED.into());
    world.run_for(millis(10));
    world
}

/// Returns the ACKs that the ground station of `link` received since the last call: command, result, progress, target.
fn acks<const N: usize>(world: &mut World<N>, link: usize) -> Vec<(MavCmd, MavResult, u8, Address)> {
    let gcs = &mut world.gcs[link];
    std::iter::from_fn(|| gcs.take::<CommandAck>())
        .map(|(_, ack)| (ack.command, ack.result, ack.progress, Address::new(ack.target_system, ack.target_component)))
        .collect()
}

fn results<const N: usize>(world: &mut World<N>, link: usize) -> Vec<(MavResult, u8)> {
    acks(world, link).into_iter().map(|(_, result, progress, _)| (result, progress)).collect()
}

/// Sends `command` from the ground station of `link` with this confirmation, and gives the vehicle time to answer.
fn send<const N: usize>(world: &mut World<N>, link: usize, command: MavCmd, params: [f32; 7], confirmation: u8) {
    let message = CommandLong { confirmation, ..world.gcs[link].long(command, params) };
    world.gcs[link].send(&message);
    world.run_for(millis(5));
}

const fn running(progress: u8) -> (MavResult, u8) {
    (MavResult::IN_PROGRESS, progress)
}

const fn ended(result: MavResult) -> (MavResult, u8) {
    (result, 255)
}

/// C-24: a command that is repeated within three seconds is a retransmission, unless its sender has given another one with
/// the same id meanwhile, such as to disarm after arming.
#[test]
fn another_command_ends_the_memory_of_the_first() {
    const OTHER: [f32; 7] = [0.0; 7];
    for has_other in [false, true] {
        let mut world = world::<1>();
        send(&mut world, 0, CALIBRATE, PARAMS, 0);
        assert!(world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED));
        world.run_for(millis(5));
        if has_other {
            world.vehicle.long.remove(&CALIBRATE.0);
            world.vehicle.outcomes.insert(CALIBRATE.0, MavResult::ACCEPTED.into());
            send(&mut world, 0, CALIBRATE, OTHER, 0);
            world.vehicle.outcomes.remove(&CALIBRATE.0);
            world.vehicle.long.insert(CALIBRATE.0);
        }
        results(&mut world, 0);
        send(&mut world, 0, CALIBRATE, PARAMS, 0);
        let expected = if has_other { running(255) } else { ended(MavResult::ACCEPTED) };
        assert_eq!(results(&mut world, 0), [expected]);
    }
}

/// C-24: of two runs of a command, a retransmission gets the result of the second.
#[test]
fn retransmission_gets_the_newest_result() {
    let mut world = world::<1>();
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    assert!(world.stack.long_commands_mut().finish(CALIBRATE, MavResult::FAILED));
    world.run_for(millis(5));
    world.vehicle.long.remove(&CALIBRATE.0);
    world.vehicle.outcomes.insert(CALIBRATE.0, MavResult::ACCEPTED.into());
    send(&mut world, 0, CALIBRATE, [0.0; 7], 0);
    world.vehicle.outcomes.remove(&CALIBRATE.0);
    world.vehicle.long.insert(CALIBRATE.0);
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    assert!(world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED));
    world.run_for(millis(5));
    results(&mut world, 0);
    send(&mut world, 0, CALIBRATE, PARAMS, 1);
    assert_eq!(results(&mut world, 0), [ended(MavResult::ACCEPTED)]);
}

/// C-23: PREFLIGHT_CALIBRATION with all parameters 0 is PX4's form of cancel: it ends the running calibration, whose sender gets
/// CANCELLED before the answer to the cancel. Without a running one, or if the vehicle continues, it is a command like others.
#[test]
fn calibration_is_cancelled_by_zeros() {
    const ZEROS: [f32; 7] = [0.0; 7];
    for zeros in [ZEROS, [f32::NAN; 7], [0.0, -0.0, f32::NAN, 0.0, 0.0, 0.0, 0.0]] {
        let mut world = world::<2>();
        send(&mut world, 0, CALIBRATE, PARAMS, 0);
        assert_eq!(results(&mut world, 0), [running(255)]);
        send(&mut world, 0, CALIBRATE, zeros, 0);
        world.run_for(millis(20));
        assert_eq!(results(&mut world, 0), [ended(MavResult::CANCELLED), ended(MavResult::ACCEPTED)]);
        assert!(!world.stack.long_commands().is_running(CALIBRATE));
        // From another link: each sender gets its own answer.
        world.run_for(secs(4));
        send(&mut world, 0, CALIBRATE, PARAMS, 0);
        send(&mut world, 1, CALIBRATE, zeros, 0);
        world.run_for(millis(20));
        assert_eq!(results(&mut world, 0), [running(255), ended(MavResult::CANCELLED)]);
        assert_eq!(results(&mut world, 1), [ended(MavResult::ACCEPTED)]);
    }
    let mut world = world::<1>();
    world.vehicle.cancels = false;
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    results(&mut world, 0);
    send(&mut world, 0, CALIBRATE, ZEROS, 0);
    assert_eq!(results(&mut world, 0), [ended(MavResult::TEMPORARILY_REJECTED)], "the vehicle continues");
    send(&mut world, 0, CALIBRATE, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 0);
    assert_eq!(results(&mut world, 0), [ended(MavResult::TEMPORARILY_REJECTED)]);
    assert!(world.stack.long_commands().is_running(CALIBRATE));
}

/// C-20: IN_PROGRESS is sent at once, then once a second and when the progress changes, then one final ACK.
#[test]
fn long_command_reports_progress() {
    let mut world = world::<1>();
    let start = world.now();
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    assert_eq!(results(&mut world, 0), [running(255)]);
    world.run_for(millis(3_500));
    let times: Vec<_> = world.gcs[0].all::<CommandAck>().iter().map(|(at, _)| (*at - start).as_millis()).collect();
    assert_eq!(times.len(), 4);
    for (i, at) in (0u64..).zip(times) {
        assert!((i * 1_000..i * 1_000 + 20).contains(&at), "IN_PROGRESS {i} at {at} ms");
    }
    assert_eq!(results(&mut world, 0), [running(255); 3]);
    for percent in [0, 40, 40, 40, 100] {
        world.stack.long_commands_mut().progress(CALIBRATE, percent);
        world.run_for(millis(120));
    }
    assert_eq!(results(&mut world, 0), [running(0), running(40), running(100)]);
    // A progress above 100 % means unknown.
    world.stack.long_commands_mut().progress(CALIBRATE, 101);
    world.run_for(millis(120));
    assert_eq!(results(&mut world, 0), [running(255)]);
    assert!(world.stack.long_commands_mut().is_running(CALIBRATE));
    assert!(
        !world.stack.long_commands_mut().finish(CALIBRATE, MavResult::IN_PROGRESS),
        "IN_PROGRESS is not a final result"
    );
    let outcome = Outcome { result: MavResult::FAILED, result_param2: -5 };
    assert!(world.stack.long_commands_mut().finish(CALIBRATE, outcome));
    assert!(!world.stack.long_commands_mut().finish(CALIBRATE, outcome), "a command ends once");
    world.run_for(secs(20));
    let (_, last) = world.gcs[0].all::<CommandAck>().pop().unwrap();
    assert_eq!((last.result_param2, last.target_system, last.target_component), (-5, 255, 190));
    assert_eq!(results(&mut world, 0), [ended(MavResult::FAILED)]);
    assert_eq!(world.vehicle.commands().len(), 1);
}

/// C-20, D-4: progress reported in every pass of the flight loop does not fill the link; only the latest value is sent.
#[test]
fn frequent_progress_does_not_fill_the_link() {
    let mut world = world::<2>();
    for link in [0, 1] {
        send(&mut world, link, CALIBRATE, PARAMS, 0);
    }
    for pass in 0..10_000u32 {
        world.stack.long_commands_mut().progress(CALIBRATE, (pass % 100) as u8);
        world.run_for(millis(1));
    }
    world.stack.long_commands_mut().progress(CALIBRATE, 77);
    world.run_for(millis(200));
    for link in [0, 1] {
        let told = results(&mut world, link);
        assert!((90..=103).contains(&told.len()), "{} times in 10 s", told.len());
        assert_eq!(told.last(), Some(&running(77)));
    }
}

/// C-20: a command that ends before its first answer was sent still gets both answers, in order.
#[test]
fn immediate_end_is_still_two_answers_in_order() {
    let mut world = world::<1>();
    world.uarts[0].stall_writes_until(Instant::from_millis(500));
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    world.stack.long_commands_mut().progress(CALIBRATE, 70);
    world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED);
    world.run_for(secs(1));
    assert_eq!(results(&mut world, 0), [running(255), ended(MavResult::ACCEPTED)]);
}

/// C-21: a retransmission of a running command gets the progress; another form, sender or parameter is TEMPORARILY_REJECTED.
/// Nothing starts twice.
#[test]
fn running_command_rejects_other_requests() {
    let mut world = world::<2>();
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    world.stack.long_commands_mut().progress(CALIBRATE, 30);
    world.run_for(millis(120));
    acks(&mut world, 0);
    for confirmation in [0, 0, 1, 7] {
        send(&mut world, 0, CALIBRATE, PARAMS, confirmation);
        assert_eq!(results(&mut world, 0), [running(30)]);
    }
    let busy = [ended(MavResult::TEMPORARILY_REJECTED)];
    let mut other = PARAMS;
    other[3] = 0.25;
    send(&mut world, 0, CALIBRATE, other, 0);
    assert_eq!(results(&mut world, 0), busy, "other parameters");
    world.gcs[0].command_int(CALIBRATE, [1.0, 0.0, 3.0, 0.5]);
    world.run_for(millis(5));
    assert_eq!(results(&mut world, 0), busy, "another form");
    world.gcs[1].address = OTHER_STATION;
    send(&mut world, 1, CALIBRATE, PARAMS, 0);
    assert_eq!(results(&mut world, 1), busy, "another sender");
    // Other commands are not blocked.
    send(&mut world, 1, MavCmd::NAV_LAND, [0.0; 7], 0);
    assert_eq!(results(&mut world, 1), [ended(MavResult::ACCEPTED)]);
    assert_eq!(world.vehicle.commands().len(), 2);
    world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED);
    world.run_for(millis(50));
    assert_eq!(results(&mut world, 0), [ended(MavResult::ACCEPTED)]);
    assert_eq!(results(&mut world, 1), []);
}

/// C-3: a client that sends the command on two links gets the final ACK on both.
#[test]
fn final_ack_is_sent_on_every_link_that_carried_the_command() {
    let mut world = world::<2>();
    for link in [0, 1] {
        send(&mut world, link, CALIBRATE, PARAMS, 0);
        assert_eq!(results(&mut world, link), [running(255)]);
    }
    assert_eq!(world.vehicle.commands().len(), 1);
    world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED);
    world.run_for(secs(5));
    for link in [0, 1] {
        assert_eq!(results(&mut world, link), [ended(MavResult::ACCEPTED)]);
    }
}

/// C-22: without a free slot a command does not start and can be sent again. A slot is free three seconds after its command
/// ended (C-24).
#[test]
fn command_without_free_slot_is_rejected() {
    let mut world = world::<1>();
    let commands = [241, 242, 243, 252].map(MavCmd);
    for command in commands {
        world.vehicle.long.insert(command.0);
        send(&mut world, 0, command, PARAMS, 0);
    }
    let rejected = ended(MavResult::TEMPORARILY_REJECTED);
    assert_eq!(results(&mut world, 0), [running(255), running(255), running(255), rejected]);
    send(&mut world, 0, ONCE, PARAMS, 0);
    assert_eq!(results(&mut world, 0), [rejected], "a command that runs once needs a slot too");
    let calls = world.vehicle.commands().len();
    assert_eq!(calls, 4, "and is not carried out without one");
    world.stack.long_commands_mut().finish(commands[1], MavResult::ACCEPTED);
    world.run_for(millis(2_900));
    acks(&mut world, 0);
    send(&mut world, 0, ONCE, PARAMS, 0);
    assert_eq!(results(&mut world, 0), [rejected]);
    world.run_for(millis(150));
    acks(&mut world, 0);
    send(&mut world, 0, ONCE, PARAMS, 0);
    assert_eq!(results(&mut world, 0), [ended(MavResult::ACCEPTED)]);
}

/// C-23: whoever cancels, the sender of the command gets CANCELLED on its own link. COMMAND_CANCEL needs an exact target.
#[test]
fn running_command_can_be_cancelled() {
    let mut world = world::<2>();
    let cancel = CommandCancel { command: CALIBRATE, target_system: 1, target_component: 1 };
    let cancels = |world: &World<2>| {
        let of = |call: &&Call| matches!(call, Call::CancelCommand(..));
        world.vehicle.calls.iter().filter(of).cloned().collect::<Vec<_>>()
    };
    world.gcs[1].send_from(OTHER_STATION, &cancel);
    world.run_for(secs(1));
    assert_eq!((results(&mut world, 1), cancels(&world)), (vec![], vec![]), "the command does not run");
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    acks(&mut world, 0);
    for (target_system, target_component) in [(0, 1), (1, 0), (0, 0), (2, 1), (1, 2)] {
        world.gcs[1].send(&CommandCancel { target_system, target_component, ..cancel });
    }
    world.gcs[1].send(&CommandCancel { command: ONCE, ..cancel });
    world.run_for(millis(20));
    assert_eq!(cancels(&world), []);
    world.vehicle.cancels = false;
    world.gcs[1].send_from(OTHER_STATION, &cancel);
    world.run_for(millis(1_100));
    let from = Peer { address: OTHER_STATION, link: LinkId(1) };
    assert_eq!(cancels(&world), [Call::CancelCommand(CALIBRATE, from)]);
    assert_eq!(results(&mut world, 0), [running(255)], "the command still runs");
    world.vehicle.cancels = true;
    world.gcs[1].send_from(OTHER_STATION, &cancel);
    world.gcs[1].send_from(OTHER_STATION, &cancel);
    world.run_for(secs(5));
    assert_eq!(acks(&mut world, 0), [(CALIBRATE, MavResult::CANCELLED, 255, STATION)]);
    assert_eq!(acks(&mut world, 1), [], "COMMAND_CANCEL itself is not answered");
    assert_eq!(cancels(&world).len(), 2);
}

/// C-24: for three seconds a retransmitted command gets the final ACK again; after that it is a new command.
#[test]
fn lost_final_ack_is_sent_again() {
    let mut world = world::<2>();
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    world.stack.long_commands_mut().finish(CALIBRATE, MavResult::FAILED);
    world.run_for(millis(10));
    assert_eq!(results(&mut world, 0), [running(255), ended(MavResult::FAILED)]);
    for (link, wait) in [(0, 1_000), (0, 1_000), (1, 900)] {
        world.run_for(millis(wait));
        send(&mut world, link, CALIBRATE, PARAMS, 0);
        assert_eq!(results(&mut world, link), [ended(MavResult::FAILED)]);
    }
    assert_eq!(world.vehicle.commands().len(), 1);
    // Other parameters make another command.
    let mut other = PARAMS;
    other[0] = 0.0;
    send(&mut world, 0, CALIBRATE, other, 0);
    assert_eq!(results(&mut world, 0), [running(255)]);
    world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED);
    world.run_for(millis(3_100));
    acks(&mut world, 0);
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    assert_eq!(results(&mut world, 0), [running(255)]);
    assert_eq!(world.vehicle.commands().len(), 3);
}

/// C-20: a command that the vehicle refuses after starting it does not run and occupies no slot.
#[test]
fn start_can_be_withdrawn() {
    let mut world = world::<1>();
    world.vehicle.outcomes.insert(CALIBRATE.0, MavResult::DENIED.into());
    for _ in 0..5 {
        send(&mut world, 0, CALIBRATE, PARAMS, 0);
        assert_eq!(results(&mut world, 0), [ended(MavResult::DENIED)]);
        assert!(!world.stack.long_commands_mut().is_running(CALIBRATE));
    }
    assert_eq!(world.vehicle.commands().len(), 5);
    world.vehicle.outcomes.remove(&CALIBRATE.0);
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    assert_eq!(results(&mut world, 0), [running(255)]);
}

/// C-3: a pending final ACK is not lost when the same command is sent again on another link.
#[test]
fn pending_final_ack_is_kept() {
    let mut world = world::<2>();
    world.vehicle.outcomes.remove(&ONCE.0);
    world.vehicle.long.insert(ONCE.0);
    send(&mut world, 0, ONCE, PARAMS, 0);
    world.uarts[0].stall_writes_until(world.now() + secs(6));
    world.stack.long_commands_mut().finish(ONCE, MavResult::FAILED);
    world.run_for(secs(4));
    world.vehicle.outcomes.insert(ONCE.0, MavResult::ACCEPTED.into());
    world.vehicle.long.clear();
    send(&mut world, 1, ONCE, PARAMS, 0);
    assert_eq!(results(&mut world, 1), [ended(MavResult::ACCEPTED)]);
    world.run_for(secs(4));
    assert_eq!(results(&mut world, 0), [running(255), ended(MavResult::FAILED)]);
}

/// a final ACK waits for a backpressured link, but after three seconds, before X-3 ten, another command gets its slot.
#[test]
fn dead_link_frees_its_slot() {
    let mut world = world::<2>();
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    world.uarts[0].stall_writes_until(Instant::from_millis(60_000));
    for command in [242, 243].map(MavCmd) {
        world.vehicle.long.insert(command.0);
        send(&mut world, 1, command, PARAMS, 0);
    }
    world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED);
    world.run_for(millis(2_900));
    send(&mut world, 1, CALIBRATE, [0.0; 7], 0);
    assert_eq!(results(&mut world, 1).pop(), Some(ended(MavResult::TEMPORARILY_REJECTED)));
    world.run_for(millis(150));
    send(&mut world, 1, CALIBRATE, [0.0; 7], 0);
    assert_eq!(results(&mut world, 1).pop(), Some(running(255)));
}

/// C-12: a duplicate on another link, or with a higher confirmation, is answered and not carried out. Two commands more than a
/// second apart are two commands.
#[test]
fn command_that_runs_once_ignores_duplicates() {
    let mut world = world::<2>();
    let outcome = Outcome { result: MavResult::ACCEPTED, result_param2: 7 };
    world.vehicle.outcomes.insert(ONCE.0, outcome);
    let mut done = 0;
    // Link, confirmation, delay before it in ms, whether it is a new command.
    for (step, (link, confirmation, wait, is_new)) in [
        (0, 0, 0, true),
        (1, 0, 100, false),
        (0, 1, 500, false),
        (1, 1, 5, false),
        (0, 2, 5, false),
        (0, 2, 5, false),
        (1, 2, 5, false),
        // Two more commands on link 0 while link 1 is behind. Then link 1 is first.
        (0, 0, 1_100, true),
        (0, 0, 1_100, true),
        (1, 0, 5, false),
        (1, 0, 5, false),
        (1, 0, 1_100, true),
        (0, 0, 5, false),
        (0, 0, 1_100, true),
        // A client that always sends confirmation 2.
        (1, 2, 3_100, true),
        (1, 2, 1_100, true),
        (0, 2, 5, false),
        (0, 3, 3_100, true),
        (1, 0, 2_900, false),
    ]
    .into_iter()
    .enumerate()
    {
        world.run_for(millis(wait));
        // If a duplicate were carried out, this outcome would show.
        let now = if is_new { outcome } else { MavResult::FAILED.into() };
        world.vehicle.outcomes.insert(ONCE.0, now);
        send(&mut world, link, ONCE, PARAMS, confirmation);
        done += usize::from(is_new);
        assert_eq!(world.vehicle.commands().len(), done, "step {step}");
        let (_, ack) = world.gcs[link].take::<CommandAck>().unwrap();
        assert_eq!((ack.result, ack.result_param2), (MavResult::ACCEPTED, 7), "step {step}");
        assert_eq!(results(&mut world, link), [], "step {step}");
    }
}

/// C-12: only an identical command is a duplicate.
#[test]
fn different_command_is_carried_out() {
    let mut world = world::<2>();
    send(&mut world, 0, ONCE, PARAMS, 0);
    let mut other = PARAMS;
    other[6] = 0.0;
    send(&mut world, 1, ONCE, other, 0);
    assert_eq!(world.vehicle.commands().len(), 2, "other parameters");
    world.run_for(secs(4));
    send(&mut world, 0, ONCE, PARAMS, 0);
    let message = world.gcs[1].long(ONCE, PARAMS);
    world.gcs[1].send_from(OTHER_STATION, &message);
    world.run_for(millis(5));
    assert_eq!(world.vehicle.commands().len(), 4, "another sender");
    world.run_for(secs(4));
    // The same bits in another form and in another frame.
    send(&mut world, 0, ONCE, [1.0, 0.0, 3.0, 0.5, 0.0, 0.0, 0.0], 0);
    world.gcs[1].command_int(ONCE, [1.0, 0.0, 3.0, 0.5]);
    world.run_for(millis(5));
    assert_eq!(world.vehicle.commands().len(), 6, "another form");
    let int = CommandInt { target_system: 1, target_component: 1, command: ONCE, param1: 1.0, ..CommandInt::default() };
    let int = CommandInt { param3: 3.0, param4: 0.5, frame: MavFrame::LOCAL_NED, ..int };
    world.gcs[0].send(&int);
    world.run_for(millis(5));
    assert_eq!(world.vehicle.commands().len(), 7, "another frame");
    // A command that is not declared to run once is carried out each time.
    for link in [0, 1] {
        send(&mut world, link, MavCmd::NAV_LAND, [0.0; 7], 0);
    }
    assert_eq!(world.vehicle.commands().len(), 9);
}

/// L-4: a high-latency link carries the first and the last answer only, because every byte costs money.
#[test]
fn progress_is_not_sent_over_satellite() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = World::new(Setup { links: [satellite], ..Setup::new() });
    world.vehicle.long.insert(CALIBRATE.0);
    send(&mut world, 0, CALIBRATE, PARAMS, 0);
    for percent in 0..50 {
        world.stack.long_commands_mut().progress(CALIBRATE, percent);
        world.run_for(millis(100));
    }
    world.gcs[0].send(&CommandCancel { command: CALIBRATE, target_system: 1, target_component: 1 });
    world.run_for(secs(5));
    assert_eq!(results(&mut world, 0), [running(255), ended(MavResult::CANCELLED)]);
}

/// A step of the property: a station sends a frame, or the vehicle makes progress.
#[derive(Clone, Debug)]
enum Step {
    Command { link: usize, other: bool, command: u16, form: bool, param: bool, confirmation: u8 },
    Cancel { link: usize, command: u16 },
    Progress { command: u16, percent: u8 },
    Finish { command: u16 },
    Wait { millis: u64 },
}

/// Two long-running commands, one that runs once, an ordinary one, one that is refused, and an unknown one.
const COMMANDS: [u16; 6] = [241, 243, 184, 21, 192, 42_424];

fn any_step() -> impl Strategy<Value = Step> {
    let command = || prop::sample::select(COMMANDS.to_vec());
    prop_oneof![
        8 => (0usize..2, any::<bool>(), command(), any::<bool>(), any::<bool>(), 0u8..3).prop_map(
            |(link, other, command, form, param, confirmation)| {
                Step::Command { link, other, command, form, param, confirmation }
            }
        ),
        1 => (0usize..2, command()).prop_map(|(link, command)| Step::Cancel { link, command }),
        1 => (command(), any::<u8>()).prop_map(|(command, percent)| Step::Progress { command, percent }),
        3 => command().prop_map(|command| Step::Finish { command }),
        2 => (0u64..3_500).prop_map(|millis| Step::Wait { millis }),
    ]
}

/// By command: the client that waits for a final ACK, and its links.
type Promises = BTreeMap<u16, (Address, BTreeSet<usize>)>;

/// Runs the world and asserts that it received exactly `expected`, in any order, apart from progress. With `may_run`,
/// IN_PROGRESS counts as an answer.
fn expect_only(
    world: &mut World<2>,
    promises: &Promises,
    time: Duration,
    expected: &[(usize, u16, Address)],
    may_run: bool,
) -> Vec<(usize, u16, MavResult)> {
    world.run_for(time);
    let mut left = expected.to_vec();
    let mut came = Vec::new();
    for link in [0, 1] {
        came.extend(acks(world, link).into_iter().map(|ack| (link, ack)));
    }
    // Final answers first: an earlier IN_PROGRESS must not take their place.
    came.sort_by_key(|(_, (_, result, ..))| *result == MavResult::IN_PROGRESS);
    for &(link, (command, result, progress, to)) in &came {
        let runs = result == MavResult::IN_PROGRESS;
        assert!(progress == 255 || (runs && progress <= 100));
        let wanted = left.iter().position(|wanted| *wanted == (link, command.0, to));
        if let Some(at) = wanted.filter(|_| may_run || !runs) {
            left.swap_remove(at);
        } else {
            // An unexpected answer can only be progress, sent to the command's client on one of its links.
            assert!(runs, "{command:?} on link {link}: {result:?} is unexpected");
            let (station, links) = &promises[&command.0];
            assert!(*station == to && links.contains(&link));
        }
    }
    assert_eq!(left, [], "missing answers");
    came.into_iter().map(|(link, (command, result, ..))| (link, command.0, result)).collect()
}

proptest! {
    #![proptest_config(cases(96))]

    /// C-3: no sequence of frames causes a missing or a second answer. Each retransmission is answered at once. A client that
    /// got IN_PROGRESS gets one final ACK, on each link that carried IN_PROGRESS. No other peer gets an answer.
    #[test]
    fn each_command_has_exactly_one_answer(steps in prop::collection::vec(any_step(), 1..40)) {
        let mut world = world::<2>();
        world.vehicle.long.insert(243);
        let mut promises = Promises::new();
        for step in steps {
            // Until the step, only progress may arrive.
            expect_only(&mut world, &promises, millis(3), &[], false);
            match step {
                Step::Command { link, other, command, form, param, confirmation } => {
                    let from = if other { OTHER_STATION } else { STATION };
                    let params = [if param { 1.0 } else { 2.0 }, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
                    let long = CommandLong { confirmation, ..world.gcs[link].long(MavCmd(command), params) };
                    let [param1, param2, param3, param4, ..] = params;
                    let (target_system, target_component) = (1, 1);
                    let command = MavCmd(command);
                    let int = CommandInt { target_system, target_component, command, param1, param2, param3, param4, ..CommandInt::default() };
                    if form { world.gcs[link].send_from(from, &long) } else { world.gcs[link].send_from(from, &int) }
                    let before = world.vehicle.commands().len();
                    let wanted = (link, command.0, from);
                    // A pending IN_PROGRESS may answer a retransmission too.
                    let came = expect_only(&mut world, &promises_with(&promises, wanted), millis(3), &[wanted], true);
                    prop_assert!(world.vehicle.commands().len() <= before + 1);
                    let is_final = |&&(_, id, result): &&(usize, u16, MavResult)| id == command.0 && result != MavResult::IN_PROGRESS;
                    match came.iter().filter(is_final).count() {
                        0 => { promises.entry(command.0).or_insert_with(|| (from, BTreeSet::new())).1.insert(link); }
                        finals => prop_assert_eq!(finals, 1),
                    }
                    if let Some((station, _)) = promises.get(&command.0) {
                        prop_assert!(world.stack.long_commands_mut().is_running(command));
                        prop_assert!(came.iter().all(|(_, _, result)| *result != MavResult::IN_PROGRESS) || *station == from || came.len() > 1);
                    }
                }
                Step::Cancel { link, command } => {
                    world.gcs[link].send(&CommandCancel { command: MavCmd(command), target_system: 1, target_component: 1 });
                    let before = promises.clone();
                    let finals = take_promise(&mut promises, command);
                    expect_only(&mut world, &before, millis(3), &finals, false);
                }
                Step::Progress { command, percent } => world.stack.long_commands_mut().progress(MavCmd(command), percent),
                Step::Finish { command } => {
                    let before = promises.clone();
                    let finals = take_promise(&mut promises, command);
                    let was_running = world.stack.long_commands_mut().finish(MavCmd(command), MavResult::ACCEPTED);
                    prop_assert_eq!(was_running, !finals.is_empty());
                    let came = expect_only(&mut world, &before, millis(3), &finals, false);
                    let of_it = came.iter().filter(|(_, id, result)| *id == command && *result != MavResult::IN_PROGRESS);
                    prop_assert!(of_it.cloned().all(|(_, _, result)| result == MavResult::ACCEPTED));
                }
                Step::Wait { millis: time } => { expect_only(&mut world, &promises, millis(time), &[], false); }
            }
        }
    }
}

/// Returns the promises with another one that may just have been made.
fn promises_with(promises: &Promises, (link, command, from): (usize, u16, Address)) -> Promises {
    let mut promises = promises.clone();
    promises.entry(command).or_insert_with(|| (from, BTreeSet::new())).1.insert(link);
    promises
}

/// Removes and returns the final ACKs that are due now.
fn take_promise(promises: &mut Promises, command: u16) -> Vec<(usize, u16, Address)> {
    let Some((station, links)) = promises.remove(&command) else { return Vec::new() };
    links.into_iter().map(|link| (link, command, station)).collect()
}
