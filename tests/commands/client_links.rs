//! To which component, and on which link, the vehicle sends its requests: rules K-3, K-4 and K-5.

use super::client::{AUTHORISER, COMPANION, EQUAL, GIMBAL, POINT, REQUEST, Sky, answer, beat, sent, sky};
use crate::support::*;
use mavstack::dialect::*;
use mavstack::{Address, CommandReply, Duration, LinkId, Peer, Recipient, Text};

const BACKUP: usize = 0;
const PITCHYAW: MavCmd = MavCmd::DO_GIMBAL_MANAGER_PITCHYAW;

/// The links on which a command is sent that nobody answers, by its confirmation.
fn links(world: &mut Sky, to: impl Into<Recipient>) -> [usize; 5] {
    for link in [BACKUP, COMPANION] {
        world.gcs[link].forget();
    }
    assert!(world.stack.send_command(to, POINT));
    let mut links = [usize::MAX; 5];
    for _ in 0..5 {
        world.run_for(millis(700));
        // It stays alive.
        for link in [BACKUP, COMPANION] {
            beat(world, link, GIMBAL, MavType::GIMBAL);
        }
    }
    // Late answers to it are no longer expected either.
    world.run_for(millis(2_100));
    for link in [BACKUP, COMPANION] {
        sent(world, link).into_iter().for_each(|(.., confirmation)| links[usize::from(confirmation)] = link);
    }
    links
}

/// The component answers a command on a link.
fn point(world: &mut Sky, link: usize) {
    let peer = Peer { address: GIMBAL, link: LinkId(link as u8) };
    assert!(world.stack.send_command(peer, POINT));
    world.run_for(millis(20));
    answer(
        world,
        link,
        GIMBAL,
        CommandAck { command: PITCHYAW, target_system: 1, target_component: 1, ..CommandAck::UNKNOWN },
    );
    assert_eq!(world.vehicle.replies.pop().map(|(token, _)| token), Some(POINT));
}

/// K-4: a heartbeat can be forged. On another open link it does not take the first transmission from the link on which the component
/// was heard before; the others take turns, because that link may be dead.
#[test]
fn component_is_asked_where_it_was_heard_first() {
    for to in [Recipient::Address(GIMBAL), Recipient::Type(MavType::GIMBAL)] {
        let mut world = sky();
        beat(&mut world, BACKUP, GIMBAL, MavType::GIMBAL);
        assert_eq!(links(&mut world, to), [COMPANION, BACKUP, COMPANION, BACKUP, COMPANION]);
    }
}

/// K-4: where the component has answered last, three of five transmissions are sent, and the first two; the others take over if that
/// link is dead. An answer on another link makes that the first.
#[test]
fn component_is_asked_where_it_has_answered() {
    let mut world = sky();
    beat(&mut world, BACKUP, GIMBAL, MavType::GIMBAL);
    point(&mut world, COMPANION);
    let companion_first = [COMPANION, COMPANION, BACKUP, COMPANION, BACKUP];
    assert_eq!(links(&mut world, GIMBAL), companion_first);
    assert_eq!(links(&mut world, Address::new(1, 0)), companion_first, "one of all components");
    point(&mut world, BACKUP);
    assert_eq!(links(&mut world, GIMBAL), [BACKUP, BACKUP, COMPANION, BACKUP, COMPANION]);
    let wanted = Peer { address: GIMBAL, link: LinkId(COMPANION as u8) };
    assert_eq!(links(&mut world, wanted), [COMPANION, BACKUP, COMPANION, BACKUP, COMPANION], "the wanted link");
    // A parameter is an answer too.
    assert!(world.stack.read_param(wanted, POINT));
    world.run_for(millis(20));
    world.gcs[COMPANION].send_from(GIMBAL, &ParamValue { param_id: Text::new("GIMB_MODE"), ..ParamValue::default() });
    world.run_for(millis(20));
    assert_eq!(links(&mut world, GIMBAL), companion_first);
}

/// K-4, D-3: a link that takes nothing gets no second attempt, even if the component has answered there.
#[test]
fn stalled_link_gets_no_second_attempt() {
    let mut world = sky();
    beat(&mut world, BACKUP, GIMBAL, MavType::GIMBAL);
    point(&mut world, COMPANION);
    let until = world.now() + Duration::from_secs(60);
    world.uarts[COMPANION].stall_writes_until(until);
    assert!(world.stack.send_command(GIMBAL, REQUEST));
    world.run_for(millis(720));
    assert_eq!(sent(&world, BACKUP).len(), 1);
}

/// The component to which each COMMAND_CANCEL is addressed.
fn cancels(world: &Sky) -> Vec<u8> {
    let cancels = world.gcs[COMPANION].all::<CommandCancel>().into_iter();
    cancels
        .inspect(|(_, cancel)| assert_eq!(cancel.target_system, 10))
        .map(|(_, cancel)| cancel.target_component)
        .collect()
}

/// K-3, K-5, C-23: COMMAND_CANCEL needs an exact target. A command to all components of a system that none has answered is cancelled
/// at the living ones in turn, and only at the one that runs it once that is known.
#[test]
fn command_to_all_components_is_cancelled_at_each() {
    let (first, second) = (AUTHORISER, Address::new(10, 7));
    let servo = |result| CommandAck {
        command: MavCmd::DO_SET_SERVO,
        result,
        target_system: 1,
        target_component: 1,
        ..CommandAck::UNKNOWN
    };
    for progress in [false, true] {
        let mut world = sky();
        for from in [first, second] {
            beat(&mut world, COMPANION, from, MavType::ONBOARD_CONTROLLER);
        }
        assert!(world.stack.send_command(Address::new(10, 0), EQUAL));
        world.run_for(millis(50));
        assert!(world.stack.cancel_sent_command(EQUAL));
        world.run_for(millis(750));
        assert_eq!(cancels(&world), [1, 7]);
        assert_eq!(sent(&world, COMPANION).len(), 1, "the command itself is not repeated");
        if progress {
            answer(&mut world, COMPANION, second, servo(MavResult::IN_PROGRESS));
            world.run_for(millis(1_450));
            assert_eq!(cancels(&world), [1, 7, 7, 7, 7]);
            answer(&mut world, COMPANION, first, servo(MavResult::CANCELLED));
            answer(&mut world, COMPANION, second, servo(MavResult::CANCELLED));
            let done = CommandReply::Done { result: MavResult::CANCELLED, result_param2: 0 };
            assert_eq!(world.vehicle.replies, [(EQUAL, CommandReply::InProgress(255)), (EQUAL, done)]);
        } else {
            world.run_for(secs(4));
            assert_eq!(cancels(&world), [1, 7, 1, 7, 1]);
            assert_eq!(world.vehicle.replies, [(EQUAL, CommandReply::TimedOut)]);
        }
    }
}

/// K-3, C-23: if no component of the system is alive any more, none is told.
#[test]
fn command_to_nobody_is_not_cancelled() {
    let mut world = sky();
    beat(&mut world, COMPANION, AUTHORISER, MavType::ONBOARD_CONTROLLER);
    world.run_for(millis(4_900));
    assert!(world.stack.send_command(Address::new(10, 0), EQUAL));
    world.run_for(millis(300));
    assert!(world.stack.cancel_sent_command(EQUAL));
    world.run_for(secs(4));
    assert_eq!(cancels(&world), []);
    assert_eq!(world.vehicle.replies, [(EQUAL, CommandReply::TimedOut)]);
}

/// a component hears both of two redundant links and answers over the second only. All 20 commands are answered: the first when it
/// is sent there too, the others at once.
#[test]
fn answers_over_the_second_link() {
    let mut world = sky();
    beat(&mut world, BACKUP, GIMBAL, MavType::GIMBAL);
    let mut times = Vec::new();
    for round in 0..20 {
        let begin = world.now();
        assert!(world.stack.send_command(GIMBAL, POINT));
        for _ in 0..200 {
            beat(&mut world, [BACKUP, COMPANION][round % 2], GIMBAL, MavType::GIMBAL);
            let is_sent = [BACKUP, COMPANION].iter().any(|link| !sent(&world, *link).is_empty());
            if is_sent {
                world.gcs.iter_mut().for_each(Gcs::forget);
                let ack =
                    CommandAck { command: PITCHYAW, target_system: 1, target_component: 1, ..CommandAck::UNKNOWN };
                answer(&mut world, BACKUP, GIMBAL, ack);
            }
            if !world.vehicle.replies.is_empty() {
                break;
            }
        }
        let done = CommandReply::Done { result: MavResult::ACCEPTED, result_param2: 0 };
        assert_eq!(world.vehicle.replies.drain(..).collect::<Vec<_>>(), [(POINT, done)], "round {round}");
        times.push((world.now() - begin).as_millis());
        // A second answer to the same command is no longer expected.
        world.run_for(millis(2_100));
    }
    assert!(times[0] <= 1_600 && times[1..].iter().all(|ms| *ms <= 60), "{times:?}");
}
