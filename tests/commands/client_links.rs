//! On which link the vehicle sends its requests to a component that is alive on several: rule K-4.

use super::client::{COMPANION, GIMBAL, POINT, REQUEST, Sky, answer, beat, sent, sky};
use crate::support::*;
use mavstack::dialect::*;
use mavstack::{Address, Duration, LinkId, Peer, Recipient, Text};

const BACKUP: usize = 0;
const PITCHYAW: MavCmd = MavCmd::DO_GIMBAL_MANAGER_PITCHYAW;

/// The links on which a command is sent that nobody answers, by its confirmation.
fn links(world: &mut Sky, to: impl Into<Recipient>) -> [usize; 5] {
    [BACKUP, COMPANION].map(|link| world.gcs[link].forget());
    assert!(world.stack.send_command(to, POINT));
    let mut links = [usize::MAX; 5];
    for _ in 0..5 {
        world.run_for(millis(700));
        // It stays alive.
        [BACKUP, COMPANION].map(|link| beat(world, link, GIMBAL, MavType::GIMBAL));
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
    let until = world.now().after(Duration::from_secs(60));
    world.uarts[COMPANION].stall_writes_until(until);
    assert!(world.stack.send_command(GIMBAL, REQUEST));
    world.run_for(millis(720));
    assert_eq!(sent(&world, BACKUP).len(), 1);
}
