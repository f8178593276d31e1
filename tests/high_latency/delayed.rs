//! What a satellite brings late: orders that others have overtaken, and copies of commands that must not be carried out
//! twice. L-10 to L-16, C-12, C-24.

use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::{CommandAck, HighLatency2, MavCmd, MavResult};
use mavstack::high_latency::{HighLatency, HighLatencyConfig};
use mavstack::{Address, Duration, LinkConfig, Outcome};
use proptest::prelude::*;
use std::collections::VecDeque;

const RADIO: usize = 0;
const SAT: usize = 1;
const START: f32 = 1.0;
const STOP: f32 = 0.0;
const DONE: MavResult = MavResult::ACCEPTED;
const LATER: MavResult = MavResult::TEMPORARILY_REJECTED;
const ONCE: MavCmd = MavCmd::DO_REPEAT_SERVO;
const CALIBRATE: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
const PARAMS: [f32; 7] = [1.0, 0.0, 3.0, 0.5, 0.0, 0.0, f32::NAN];

const LINKS: [LinkConfig; 2] = [LinkConfig::uart(57_600), LinkConfig::uart(9_600).with_class(LinkClass::HighLatency)];

/// A world whose vehicle declares the high-latency service.
type World<const N: usize> = crate::support::World<N, Tested<mavstack::__private::NoPlans, 8, Satellite>>;

/// A telemetry radio and a satellite modem, one ground station at both.
fn world() -> World<2> {
    let mut world = World::of(Setup { links: LINKS, ..Setup::new() });
    world.stack.high_latency_mut().set_config(HighLatencyConfig::DEFAULT);
    world.vehicle.long.insert(CALIBRATE.0);
    world.vehicle.outcomes.insert(ONCE.0, Outcome { result: DONE, result_param2: 7 });
    run(&mut world, secs(1));
    world
}

fn satellite(world: &mut World<2>) -> &mut HighLatency {
    world.stack.high_latency_mut()
}

fn run(world: &mut World<2>, duration: Duration) {
    let end = world.now().after(duration);
    while world.now() < end {
        world.skip_to(end);
    }
}

/// The answer to a command on its link.
fn send(world: &mut World<2>, link: usize, command: MavCmd, params: [f32; 7], confirmation: u8) -> MavResult {
    // What is told in between of what takes its time.
    while world.gcs[link].take::<CommandAck>().is_some() {}
    let mut message = world.gcs[link].long(command, params);
    message.confirmation = confirmation;
    world.gcs[link].send(&message);
    let ack: CommandAck = world.expect(link, millis(100));
    assert_eq!(ack.command, command);
    ack.result
}

fn order(world: &mut World<2>, link: usize, enable: f32) -> MavResult {
    send(world, link, MavCmd::CONTROL_HIGH_LATENCY, [enable, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0)
}

/// The same, and whether messages go out behind it.
fn becomes(world: &mut World<2>, link: usize, enable: f32) -> (MavResult, bool) {
    let result = order(world, link, enable);
    (result, satellite(world).is_on())
}

/// How many messages came since the last time.
fn count(world: &mut World<2>) -> usize {
    std::iter::from_fn(|| world.gcs[SAT].take::<HighLatency2>()).count()
}

/// C-12, L-15: START and STOP over both links: the satellite's copies come when all is over, and change nothing. Who means it
/// says it again.
#[test]
fn copies_of_what_was_stopped_do_not_start_again() {
    let mut world = world();
    for _ in 0..3 {
        assert_eq!(order(&mut world, RADIO, START), DONE);
        run(&mut world, secs(1));
    }
    assert_eq!(becomes(&mut world, RADIO, STOP), (DONE, false));
    assert_eq!(count(&mut world), 3);
    run(&mut world, secs(20));
    for copy in 0..3 {
        assert_eq!(becomes(&mut world, SAT, START), (LATER, false), "copy {copy}");
    }
    assert_eq!(becomes(&mut world, SAT, STOP), (DONE, false));
    run(&mut world, secs(20));
    assert_eq!((count(&mut world), satellite(&mut world).counters().reports), (0, 3));
    assert_eq!(becomes(&mut world, SAT, START), (DONE, true), "a fourth one is none");
    assert_eq!(becomes(&mut world, SAT, STOP), (DONE, false), "nor is what follows it on the same link");
}

/// The same the other way round: the copy of a STOP does not leave the ground without news.
#[test]
fn copies_of_what_was_started_do_not_stop_again() {
    let mut world = world();
    order(&mut world, RADIO, START);
    order(&mut world, RADIO, STOP);
    assert_eq!(becomes(&mut world, RADIO, START), (DONE, true));
    run(&mut world, secs(25));
    assert_eq!(count(&mut world), 2);
    assert_eq!(becomes(&mut world, SAT, START), (DONE, true));
    assert_eq!(becomes(&mut world, SAT, STOP), (LATER, true));
    assert_eq!(becomes(&mut world, SAT, START), (DONE, true));
    run(&mut world, secs(5));
    assert_eq!(count(&mut world), 0, "no copy sent one");
    assert_eq!(becomes(&mut world, SAT, STOP), (DONE, false), "who means it");
}

/// By radio nothing comes late: what looks like a copy of what came by satellite is said anew, and overtakes what is under way
/// there.
#[test]
fn nothing_is_late_by_radio() {
    let mut world = world();
    world.gcs[RADIO].heartbeat_period = Some(secs(1));
    order(&mut world, SAT, STOP);
    order(&mut world, SAT, START);
    assert_eq!(becomes(&mut world, SAT, STOP), (DONE, false));
    run(&mut world, secs(5));
    assert_eq!(becomes(&mut world, RADIO, STOP), (DONE, false));
    assert_eq!(becomes(&mut world, SAT, START), (LATER, false));
    assert_eq!(becomes(&mut world, RADIO, START), (DONE, true));
    assert_eq!(becomes(&mut world, RADIO, STOP), (DONE, false));
}

/// C-12: a copy is looked for during a minute, of the same sender.
#[test]
fn what_is_no_copy_counts() {
    for (wait, other, result) in [(58, false, LATER), (61, false, DONE), (10, true, DONE)] {
        let mut world = world();
        order(&mut world, RADIO, START);
        order(&mut world, RADIO, STOP);
        run(&mut world, secs(wait));
        if other {
            world.gcs[SAT].address = OTHER_STATION;
        }
        assert_eq!(becomes(&mut world, SAT, START), (result, result == DONE), "{wait} s, {other}");
    }
    // Long ago there were many by radio: they are no reason to expect as many copies.
    let mut world = world();
    for _ in 0..5 {
        order(&mut world, RADIO, START);
        order(&mut world, RADIO, STOP);
    }
    run(&mut world, secs(61));
    order(&mut world, RADIO, START);
    order(&mut world, RADIO, STOP);
    assert_eq!(becomes(&mut world, SAT, START), (LATER, false));
    assert_eq!(becomes(&mut world, SAT, START), (DONE, true));
}

/// C-12: a repetition of a START, late, with a higher confirmation; and what the vehicle itself stopped stays so.
#[test]
fn repetitions_and_copies_undo_no_stop() {
    let mut world = world();
    let start = [START, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    order(&mut world, SAT, START);
    order(&mut world, RADIO, STOP);
    assert_eq!(send(&mut world, SAT, MavCmd::CONTROL_HIGH_LATENCY, start, 1), LATER);
    assert!(!satellite(&mut world).is_on());
    order(&mut world, RADIO, START);
    satellite(&mut world).stop();
    assert_eq!(send(&mut world, SAT, MavCmd::CONTROL_HIGH_LATENCY, start, 2), LATER);
    assert!(!satellite(&mut world).is_on());
    // And of a copy.
    let mut world = self::world();
    order(&mut world, RADIO, START);
    order(&mut world, RADIO, STOP);
    for confirmation in 0..3 {
        assert_eq!(send(&mut world, SAT, MavCmd::CONTROL_HIGH_LATENCY, start, confirmation), LATER);
    }
    assert_eq!(becomes(&mut world, SAT, START), (DONE, true), "who means it");
}

/// L-15, L-16: a START by satellite that was never seen before comes after the STOP that its sender gave by radio: while he is
/// heard there it is old. When he is not, it is what he wants; and after a minute, in any case.
#[test]
fn who_is_heard_by_radio_would_say_it_there() {
    for (is_heard, wait, result) in [(true, 15, LATER), (true, 61, DONE), (false, 15, DONE)] {
        let mut world = world();
        world.gcs[RADIO].heartbeat_period = Some(secs(1));
        run(&mut world, secs(5));
        assert_eq!(becomes(&mut world, RADIO, STOP), (DONE, false));
        if !is_heard {
            world.gcs[RADIO].heartbeat_period = None;
        }
        run(&mut world, secs(wait));
        assert_eq!(becomes(&mut world, SAT, START), (result, result == DONE), "{is_heard}, after {wait} s");
        run(&mut world, secs(5));
        assert_eq!(count(&mut world), usize::from(result == DONE));
        assert_eq!(becomes(&mut world, RADIO, START), (DONE, true), "by radio he can");
    }
    // And a STOP, after a START by radio.
    let mut world = world();
    world.gcs[RADIO].heartbeat_period = Some(secs(1));
    run(&mut world, secs(5));
    order(&mut world, RADIO, START);
    assert_eq!(becomes(&mut world, SAT, STOP), (LATER, true));
    assert_eq!(becomes(&mut world, RADIO, STOP), (DONE, false));
    // Somebody else who is heard by radio has said nothing of the kind.
    world.gcs[SAT].address = OTHER_STATION;
    assert_eq!(becomes(&mut world, SAT, START), (DONE, true));
}

/// L-15: a STOP by satellite that was obeyed ends what that link still owed of a START by radio: what follows there is new.
#[test]
fn a_link_keeps_the_order_of_what_it_carries() {
    let mut world = world();
    assert_eq!(becomes(&mut world, RADIO, START), (DONE, true));
    run(&mut world, secs(10));
    assert_eq!(becomes(&mut world, SAT, STOP), (DONE, false));
    assert_eq!(becomes(&mut world, SAT, START), (DONE, true));
}

/// L-16: who said the opposite by radio, and then this, has not changed his mind when he says it by satellite too: the second
/// time, which is no copy, it sends a message.
#[test]
fn what_was_said_last_is_not_overtaken() {
    let mut world = world();
    world.gcs[RADIO].heartbeat_period = Some(secs(1));
    run(&mut world, secs(5));
    assert_eq!(becomes(&mut world, RADIO, STOP), (DONE, false));
    run(&mut world, secs(1));
    assert_eq!(becomes(&mut world, RADIO, START), (DONE, true));
    run(&mut world, secs(5));
    assert_eq!(count(&mut world), 1);
    for messages in [0, 1] {
        assert_eq!(becomes(&mut world, SAT, START), (DONE, true));
        run(&mut world, secs(5));
        assert_eq!(count(&mut world), messages);
    }
}

/// C-12: the first transmission of a new START is lost; its repetitions are not those of the one before the STOP. By the same
/// link within three seconds, by satellite within a minute, they are its own.
#[test]
fn repetitions_of_a_new_start_are_its_own() {
    for link in [RADIO, SAT] {
        let start = [START, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let mut world = world();
        assert_eq!(becomes(&mut world, link, START), (DONE, true));
        run(&mut world, secs(10));
        assert_eq!(becomes(&mut world, link, STOP), (DONE, false));
        run(&mut world, secs(10));
        assert_eq!(count(&mut world), 1);
        for confirmation in 1..4 {
            assert_eq!(send(&mut world, link, MavCmd::CONTROL_HIGH_LATENCY, start, confirmation), DONE);
            assert!(satellite(&mut world).is_on());
            run(&mut world, secs(1));
        }
        assert_eq!(count(&mut world), 1);
        run(&mut world, secs(20));
        assert_eq!(send(&mut world, link, MavCmd::CONTROL_HIGH_LATENCY, start, 4), DONE);
        run(&mut world, secs(5));
        assert_eq!(count(&mut world), usize::from(link == RADIO), "by radio that late it is a new one");
    }
}

/// C-12: of two stations each has its own orders, and copies of them.
#[test]
fn one_stations_copies_are_known_after_anothers_orders() {
    let mut world = world();
    assert_eq!(becomes(&mut world, RADIO, START), (DONE, true));
    world.gcs[RADIO].address = OTHER_STATION;
    assert_eq!(becomes(&mut world, RADIO, START), (DONE, true));
    assert_eq!(becomes(&mut world, RADIO, STOP), (DONE, false));
    run(&mut world, secs(20));
    assert_eq!(becomes(&mut world, SAT, START), (LATER, false));
    world.gcs[SAT].address = OTHER_STATION;
    assert_eq!(becomes(&mut world, SAT, START), (LATER, false));
    assert_eq!(becomes(&mut world, SAT, STOP), (DONE, false));
    assert_eq!(becomes(&mut world, SAT, START), (DONE, true), "who means it");
}

/// The orders of a third station take the place of the oldest, and not of its own others.
#[test]
fn the_oldest_order_gives_way() {
    const THIRD: Address = Address::new(253, 190);
    let mut world = world();
    for station in [STATION, OTHER_STATION, THIRD] {
        world.gcs[RADIO].address = station;
        order(&mut world, RADIO, START);
        run(&mut world, secs(1));
        assert_eq!(becomes(&mut world, RADIO, STOP), (DONE, false));
        run(&mut world, secs(1));
    }
    for (station, result) in [(THIRD, LATER), (OTHER_STATION, LATER), (STATION, DONE)] {
        world.gcs[SAT].address = station;
        assert_eq!(becomes(&mut world, SAT, START), (result, result == DONE));
    }
}

proptest! {
    #![proptest_config(cases(300))]

    /// A router sends every order over both links, and the satellite's come in their order up to 50 s later: what counts is
    /// the last one by radio, at any time, whether or not its sender is heard there.
    #[test]
    fn copies_never_change_what_was_ordered_last(
        steps in prop::collection::vec((any::<bool>(), 0u64..20), 1..14),
        delay in 0u64..50,
        is_heard: bool,
    ) {
        let mut world = world();
        world.gcs[RADIO].heartbeat_period = is_heard.then_some(secs(1));
        run(&mut world, secs(2));
        let mut under_way = VecDeque::new();
        let mut is_on = false;
        let mut steps = VecDeque::from(steps);
        let mut next = world.now();
        while !steps.is_empty() || !under_way.is_empty() {
            let now = world.now();
            if under_way.front().is_some_and(|(due, _)| *due <= now) {
                let (_, enable) = under_way.pop_front().unwrap();
                let result = order(&mut world, SAT, enable);
                prop_assert_eq!(result, if is_on == (enable == START) { DONE } else { LATER });
            } else if next <= now && let Some((starts, wait)) = steps.pop_front() {
                let enable = if starts { START } else { STOP };
                prop_assert_eq!(order(&mut world, RADIO, enable), DONE);
                under_way.push_back((now.after(secs(delay)), enable));
                is_on = starts;
                next = now.after(secs(wait));
            }
            prop_assert_eq!(satellite(&mut world).is_on(), is_on);
            run(&mut world, millis(500));
        }
    }
}

/// C-12: what must not be done twice is not, when its copy comes by satellite half a minute later, once for each time that it
/// was given. By another radio that late it is a new one. The answer does not say that it was done: it may be no copy.
#[test]
fn a_late_copy_is_not_carried_out() {
    let mut world = world();
    for _ in 0..2 {
        assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), DONE);
        run(&mut world, secs(5));
    }
    run(&mut world, secs(25));
    world.vehicle.outcomes.insert(ONCE.0, MavResult::FAILED.into());
    for _ in 0..2 {
        assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), LATER);
    }
    assert_eq!(world.vehicle.commands().len(), 2);
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), MavResult::FAILED, "a third one is none");
    assert_eq!(
        send(&mut world, RADIO, ONCE, PARAMS, 0),
        MavResult::FAILED,
        "nor is one by radio, but of that last one"
    );
    assert_eq!(world.vehicle.commands().len(), 3);
    run(&mut world, millis(1_100));
    assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), MavResult::FAILED);
    assert_eq!(world.vehicle.commands().len(), 4);
    // Its sender repeats it over the satellite, where an answer takes its time.
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), MavResult::FAILED);
    run(&mut world, secs(40));
    world.vehicle.outcomes.insert(ONCE.0, DONE.into());
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 1), LATER);
    assert_eq!(world.vehicle.commands().len(), 4);
    // And what was done by satellite, by satellite: that is known.
    run(&mut world, secs(61));
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), DONE);
    run(&mut world, secs(20));
    world.vehicle.outcomes.insert(ONCE.0, MavResult::FAILED.into());
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 1), DONE);
    assert_eq!(world.vehicle.commands().len(), 5);
}

/// C-12: a command that its sender retransmitted without an answer arrives by satellite as often, and is carried out
/// once.
#[test]
fn late_copies_of_repetitions_are_not_carried_out() {
    let mut world = world();
    for _ in 0..3 {
        assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), DONE);
        run(&mut world, millis(500));
    }
    run(&mut world, secs(25));
    for _ in 0..3 {
        assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), LATER);
        run(&mut world, millis(500));
    }
    assert_eq!(world.vehicle.commands().len(), 1);
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), DONE, "a new command");
    assert_eq!(world.vehicle.commands().len(), 2);
}

/// After a minute nothing is a copy.
#[test]
fn it_is_remembered_for_a_minute() {
    for (wait, is_new) in [(59, false), (61, true)] {
        let mut world = world();
        send(&mut world, RADIO, ONCE, PARAMS, 0);
        run(&mut world, secs(wait));
        send(&mut world, SAT, ONCE, PARAMS, 0);
        assert_eq!(world.vehicle.commands().len(), 1 + usize::from(is_new), "{wait} s");
    }
}

/// C-22: what is remembered for the satellite takes nobody's place. With three places the last three are remembered.
#[test]
fn what_is_past_gives_way_to_what_is_new() {
    let mut world = world();
    let pressed = |n: u8| [f32::from(n), 0.0, 3.0, 0.5, 0.0, 0.0, f32::NAN];
    for n in 0..4 {
        assert_eq!(send(&mut world, RADIO, ONCE, pressed(n), 0), DONE);
        run(&mut world, secs(4));
    }
    for n in (1..4).rev() {
        assert_eq!(send(&mut world, SAT, ONCE, pressed(n), 0), LATER);
    }
    assert_eq!(world.vehicle.commands().len(), 4);
    // The oldest has gone; carrying it out takes the place of the oldest that is left.
    send(&mut world, SAT, ONCE, pressed(0), 0);
    assert_eq!(world.vehicle.commands().len(), 5);
    // Two that run, and one that was just done: no room but for itself. Those that are done keep theirs for three seconds.
    assert_eq!(send(&mut world, RADIO, CALIBRATE, PARAMS, 0), MavResult::IN_PROGRESS);
    world.vehicle.long.insert(MavCmd::NAV_LAND.0);
    world.vehicle.outcomes.remove(&MavCmd::NAV_LAND.0);
    assert_eq!(send(&mut world, RADIO, MavCmd::NAV_LAND, [0.0; 7], 0), MavResult::IN_PROGRESS);
    assert_eq!(send(&mut world, RADIO, ONCE, pressed(9), 0), LATER);
    run(&mut world, secs(4));
    assert_eq!(send(&mut world, RADIO, ONCE, pressed(9), 0), DONE);
}

/// C-12, C-24: what took its time, has ended and must not be done twice is not begun again by its copy, and may be begun anew.
#[test]
fn a_late_copy_of_what_has_ended_does_not_begin_it_again() {
    let mut world = world();
    world.vehicle.outcomes.remove(&ONCE.0);
    world.vehicle.long.insert(ONCE.0);
    assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), MavResult::IN_PROGRESS);
    run(&mut world, secs(2));
    world.stack.long_commands_mut().finish(ONCE, MavResult::FAILED);
    run(&mut world, secs(30));
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), LATER);
    assert!(!world.stack.long_commands_mut().is_running(ONCE));
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), MavResult::IN_PROGRESS, "who means it");
    world.stack.long_commands_mut().finish(ONCE, DONE);
    run(&mut world, secs(5));
    // By radio that is too late for a copy.
    assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), MavResult::IN_PROGRESS);
}

/// C-24: what took its time and may be done twice is done when it is asked for by satellite: whoever says that it was done
/// leaves the vehicle where it is. Three seconds after its end it is a new one, with whatever confirmation.
#[test]
fn home_again_by_satellite() {
    const RTL: MavCmd = MavCmd::NAV_RETURN_TO_LAUNCH;
    for confirmation in [0, 1, 2] {
        let mut world = world();
        world.vehicle.long.insert(RTL.0);
        world.vehicle.outcomes.insert(MavCmd::NAV_TAKEOFF.0, DONE.into());
        assert_eq!(send(&mut world, RADIO, RTL, [0.0; 7], 0), MavResult::IN_PROGRESS);
        run(&mut world, secs(5));
        world.stack.long_commands_mut().finish(RTL, DONE);
        run(&mut world, secs(2));
        assert_eq!(send(&mut world, SAT, RTL, [0.0; 7], 0), DONE, "its copy");
        assert_eq!(send(&mut world, RADIO, MavCmd::NAV_TAKEOFF, [0.0; 7], 0), DONE);
        assert_eq!(world.vehicle.commands().len(), 2);
        run(&mut world, secs(40));
        assert_eq!(send(&mut world, SAT, RTL, [0.0; 7], confirmation), MavResult::IN_PROGRESS);
        assert_eq!(world.vehicle.commands().len(), 3);
    }
}
