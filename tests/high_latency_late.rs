//! What a satellite brings late: orders that others have overtaken, and copies of commands that must not be carried out
//! twice. L-10 to L-16, C-12, C-24.

#[cfg(feature = "signing")]
#[path = "support/signer.rs"]
mod signer;
mod support;

use mavstack::dialect::{CommandAck, HighLatency2, MavCmd, MavResult};
use mavstack::{Duration, HighLatency, HighLatencyConfig, LinkClass, LinkConfig, Outcome};
use proptest::prelude::*;
use std::collections::VecDeque;
use support::*;

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

/// A telemetry radio and a satellite modem, one ground station at both.
fn world() -> World<2> {
    let mut world = World::new(Setup { links: LINKS, ..Setup::new() });
    world.vehicle.satellite = Some(HighLatency::new(HighLatencyConfig::DEFAULT));
    world.vehicle.long.insert(CALIBRATE.0);
    world.vehicle.outcomes.insert(ONCE.0, Outcome { result: DONE, result_param2: 7 });
    run(&mut world, secs(1));
    world
}

fn satellite(world: &mut World<2>) -> &mut HighLatency {
    world.vehicle.satellite.as_mut().expect("it has one")
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
/// was given. By another radio that late it is a new one.
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
        assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), DONE);
    }
    assert_eq!(world.vehicle.commands().len(), 2);
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), MavResult::FAILED, "a third one is none");
    assert_eq!(
        send(&mut world, RADIO, ONCE, PARAMS, 0),
        MavResult::FAILED,
        "nor is one by radio, but of that last one"
    );
    assert_eq!(world.vehicle.commands().len(), 3);
    assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), MavResult::FAILED);
    assert_eq!(world.vehicle.commands().len(), 4);
    // Its sender repeats it over the satellite, where an answer takes its time.
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), MavResult::FAILED);
    run(&mut world, secs(40));
    world.vehicle.outcomes.insert(ONCE.0, DONE.into());
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 1), MavResult::FAILED);
    assert_eq!(world.vehicle.commands().len(), 4);
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
        assert_eq!(send(&mut world, SAT, ONCE, pressed(n), 0), DONE);
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

/// C-24: what took its time and has ended is not begun again by its copy, and may be begun anew.
#[test]
fn a_late_copy_of_what_has_ended_does_not_begin_it_again() {
    let mut world = world();
    assert_eq!(send(&mut world, RADIO, CALIBRATE, PARAMS, 0), MavResult::IN_PROGRESS);
    run(&mut world, secs(2));
    world.vehicle.memory.finish(CALIBRATE, MavResult::FAILED);
    run(&mut world, secs(30));
    assert_eq!(send(&mut world, SAT, CALIBRATE, PARAMS, 0), MavResult::FAILED);
    assert!(!world.vehicle.memory.is_running(CALIBRATE));
    assert_eq!(send(&mut world, SAT, CALIBRATE, PARAMS, 0), MavResult::IN_PROGRESS, "who means it");
    world.vehicle.memory.finish(CALIBRATE, DONE);
    run(&mut world, secs(5));
    // By radio that is too late for a copy.
    assert_eq!(send(&mut world, RADIO, CALIBRATE, PARAMS, 0), MavResult::IN_PROGRESS);
}

/// With signatures it is known when something was sent.
#[cfg(feature = "signing")]
mod signed {
    use super::*;
    use crate::signer::{KEY, NOW, Rig, Signer};
    use mavstack::dialect::{CommandLong, SetMode};
    use mavstack::{Instant, LinkSigning};

    /// Seconds, in timestamps.
    const SECOND: u64 = 100_000;

    /// A vehicle that hears signed frames only, over a radio and a satellite.
    fn rig() -> Rig {
        let mut rig = Rig::new(LINKS.map(|link| link.with_signing(LinkSigning::REQUIRED)));
        rig.set_key(KEY);
        rig.vehicle.satellite = Some(HighLatency::new(HighLatencyConfig::DEFAULT));
        rig.vehicle.outcomes.insert(ONCE.0, DONE.into());
        rig
    }

    /// A command of the station that was sent when the vehicle's clock had run for so long, over its own stream for the link.
    fn sent(link: usize, at: Duration, command: MavCmd, p1: f32) -> Vec<u8> {
        let message = CommandLong {
            command,
            target_system: 1,
            target_component: 1,
            param1: p1,
            param3: 3.0,
            param4: 0.5,
            ..CommandLong::default()
        };
        let timestamp = NOW + at.as_millis() * (SECOND / 1_000);
        Signer::new(KEY).link(link as u8).at(timestamp).frame(&message)
    }

    fn order(rig: &mut Rig, link: usize, at: Duration, enable: f32) -> (MavResult, bool) {
        answer(rig, link, &sent(link, at, MavCmd::CONTROL_HIGH_LATENCY, enable))
    }

    fn answer(rig: &mut Rig, link: usize, frame: &[u8]) -> (MavResult, bool) {
        rig.transmit(link);
        rig.receive(link, frame);
        let acks = rig.sent::<CommandAck>(link);
        assert_eq!(acks.len(), 1);
        (acks[0].decode::<CommandAck>().unwrap().result, rig.vehicle.satellite.as_ref().unwrap().is_on())
    }

    /// Until the vehicle's clock has run for so long since it had its key.
    fn until(rig: &mut Rig, at: Duration) {
        let end = Instant::from_millis(5_000).after(at);
        rig.run_for(end.since(rig.now));
    }

    /// L-16: the vehicle hears how old a command is, in whatever form, once it knows what time it is.
    #[test]
    fn a_command_says_how_old_it_is() {
        let mut rig = rig();
        until(&mut rig, secs(40));
        // What the vehicle signs itself moves its time by the last digit.
        let in_seconds = |age: Option<Duration>| age.map(|age| age.as_millis() / 1_000);
        let ages =
            |rig: &Rig| rig.vehicle.commands().iter().map(|command| command.age).map(in_seconds).collect::<Vec<_>>();
        answer(&mut rig, SAT, &sent(SAT, secs(10), MavCmd::NAV_LAND, 0.0));
        assert_eq!(ages(&rig), [None], "what comes by satellite may tell a time that is over");
        answer(&mut rig, RADIO, &sent(RADIO, secs(40), MavCmd::NAV_LAND, 0.0));
        answer(&mut rig, SAT, &sent(SAT, secs(15), MavCmd::NAV_LAND, 0.0));
        assert_eq!(ages(&rig)[1..], [Some(0), Some(25)]);
        // A clock of its own will do too.
        let mut rig = self::rig();
        until(&mut rig, secs(40));
        let unix_usec = (1_420_070_400 * SECOND + NOW + 50 * SECOND) * 10;
        let now = rig.now;
        assert!(rig.signing().set_time(now, unix_usec, Duration::MAX));
        answer(&mut rig, SAT, &sent(SAT, secs(20), MavCmd::NAV_LAND, 0.0));
        let command = rig.vehicle.commands()[0];
        assert_eq!((in_seconds(command.age), command.class), (Some(30), LinkClass::HighLatency));
        // Not where signatures are not looked at.
        let mut rig = Rig::<2>::new(LINKS);
        rig.receive(SAT, &sent(SAT, secs(0), MavCmd::NAV_LAND, 0.0));
        assert_eq!(ages(&rig), [None]);
        // SET_MODE, which comes to a vehicle with no modes as a message, is none.
        rig.receive(RADIO, &Signer::new(KEY).frame(&SetMode::default()));
        assert_eq!(rig.vehicle.commands().len(), 1);
    }

    /// L-15, L-16: a START that was sent before a STOP is overtaken by it, however late it comes, though it was not seen before
    /// and nobody is heard; one that was sent after it counts at once, though it looks like a copy.
    #[test]
    fn what_was_sent_before_is_overtaken() {
        for late in [20, 300, 890] {
            let mut rig = rig();
            until(&mut rig, secs(10));
            // A stream that is known.
            answer(&mut rig, SAT, &sent(SAT, secs(9), MavCmd::NAV_LAND, 0.0));
            assert_eq!(order(&mut rig, RADIO, secs(10), STOP), (DONE, false));
            until(&mut rig, secs(10 + late));
            assert_eq!(order(&mut rig, SAT, millis(9_990), START), (LATER, false), "{late} s");
            assert_eq!(order(&mut rig, SAT, millis(10_010), START), (DONE, true), "{late} s");
        }
        let mut rig = rig();
        until(&mut rig, secs(10));
        order(&mut rig, RADIO, secs(8), START);
        order(&mut rig, RADIO, secs(9), STOP);
        assert_eq!(order(&mut rig, SAT, secs(10), START), (DONE, true));
        assert_eq!(order(&mut rig, RADIO, secs(10), START), (DONE, true));
        // And a STOP from before that.
        until(&mut rig, secs(20));
        assert_eq!(order(&mut rig, SAT, millis(10_001), STOP), (DONE, false), "it is from after");
        order(&mut rig, RADIO, secs(20), START);
        assert_eq!(order(&mut rig, SAT, secs(19), STOP), (LATER, true));
    }

    /// A quarter of an hour later nothing is overtaken: a clock that was set wrong meanwhile must not keep a START away for
    /// ever.
    #[test]
    fn nothing_is_overtaken_for_ever() {
        let mut rig = rig();
        until(&mut rig, secs(10));
        answer(&mut rig, SAT, &sent(SAT, secs(5), MavCmd::NAV_LAND, 0.0));
        order(&mut rig, RADIO, secs(10), STOP);
        until(&mut rig, secs(911));
        assert_eq!(order(&mut rig, SAT, secs(9), START), (DONE, true));
    }

    /// C-12: a copy was sent when its original was; what was sent later by satellite is new, though it comes within the minute.
    #[test]
    fn a_copy_was_sent_when_its_original_was() {
        let mut rig = rig();
        until(&mut rig, secs(10));
        answer(&mut rig, RADIO, &sent(RADIO, secs(10), ONCE, 1.0));
        until(&mut rig, secs(40));
        answer(&mut rig, SAT, &sent(SAT, secs(10), ONCE, 1.0));
        assert_eq!(rig.vehicle.commands().len(), 1);
        let mut rig = self::rig();
        until(&mut rig, secs(10));
        answer(&mut rig, RADIO, &sent(RADIO, secs(10), ONCE, 1.0));
        until(&mut rig, secs(40));
        answer(&mut rig, SAT, &sent(SAT, secs(20), ONCE, 1.0));
        assert_eq!(rig.vehicle.commands().len(), 2);
    }
}
