//! Commands that a satellite delays: superseded commands, and duplicates of commands that must be carried out once.
//! L-10 to L-16, C-12, C-24.

use crate::support::*;
use crate::{World, run, satellite};
use mavstack::config::LinkClass;
use mavstack::dialect::{CommandAck, HighLatency2, MavCmd, MavResult};
use mavstack::high_latency::HighLatencyConfig;
use mavstack::{Address, LinkConfig, Outcome};
use proptest::prelude::*;
use std::collections::VecDeque;

pub(super) const RADIO: usize = 0;
pub(super) const SAT: usize = 1;
pub(super) const START: f32 = 1.0;
pub(super) const STOP: f32 = 0.0;
pub(super) const DONE: MavResult = MavResult::ACCEPTED;
pub(super) const LATER: MavResult = MavResult::TEMPORARILY_REJECTED;
pub(super) const ONCE: MavCmd = MavCmd::DO_REPEAT_SERVO;
const CALIBRATE: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
const PARAMS: [f32; 7] = [1.0, 0.0, 3.0, 0.5, 0.0, 0.0, f32::NAN];

pub(super) const LINKS: [LinkConfig; 2] =
    [LinkConfig::uart(57_600), LinkConfig::uart(9_600).with_class(LinkClass::HighLatency)];

/// A telemetry radio and a satellite modem; one ground station uses both.
fn world() -> World<2> {
    let mut world = World::of(Setup { links: LINKS, ..Setup::new() });
    world.stack.high_latency.set_config(HighLatencyConfig::DEFAULT);
    world.vehicle.long.insert(CALIBRATE.0);
    world.vehicle.outcomes.insert(ONCE.0, Outcome { result: DONE, result_param2: 7 });
    run(&mut world, secs(1));
    world
}

/// Sends a command and returns the answer on its link.
fn send(world: &mut World<2>, link: usize, command: MavCmd, params: [f32; 7], confirmation: u8) -> MavResult {
    // Drops earlier ACKs, such as the progress of a running command.
    while world.gcs[link].take::<CommandAck>().is_some() {}
    let mut message = world.gcs[link].long(command, params);
    message.confirmation = confirmation;
    world.gcs[link].send(&message);
    let ack: CommandAck = world.expect(link, millis(100));
    assert_eq!(ack.command, command);
    ack.result
}

fn control(world: &mut World<2>, link: usize, enable: f32) -> MavResult {
    send(world, link, MavCmd::CONTROL_HIGH_LATENCY, [enable, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0)
}

/// Sends START or STOP; returns the answer, and whether messages are on afterwards.
fn switch(world: &mut World<2>, link: usize, enable: f32) -> (MavResult, bool) {
    let result = control(world, link, enable);
    (result, satellite(world).is_on())
}

/// Returns the number of HIGH_LATENCY2 received since the last call.
fn count(world: &mut World<2>) -> usize {
    std::iter::from_fn(|| world.gcs[SAT].take::<HighLatency2>()).count()
}

/// C-12, L-15: START and STOP are sent over both links. The satellite delivers its duplicates after the STOP, and they change
/// nothing. A further START is a new command.
#[test]
fn delayed_duplicate_of_start_does_not_restart() {
    let mut world = world();
    for _ in 0..3 {
        assert_eq!(control(&mut world, RADIO, START), DONE);
        run(&mut world, secs(1));
    }
    assert_eq!(switch(&mut world, RADIO, STOP), (DONE, false));
    // The others would have been sent ten seconds later (L-17).
    assert_eq!(count(&mut world), 1);
    run(&mut world, secs(20));
    for copy in 0..3 {
        assert_eq!(switch(&mut world, SAT, START), (LATER, false), "duplicate {copy}");
    }
    assert_eq!(switch(&mut world, SAT, STOP), (DONE, false));
    run(&mut world, secs(20));
    assert_eq!((count(&mut world), satellite(&mut world).counters().reports), (0, 1));
    assert_eq!(switch(&mut world, SAT, START), (DONE, true), "a fourth START is not a duplicate");
    assert_eq!(switch(&mut world, SAT, STOP), (DONE, false), "nor is the STOP after it on the same link");
}

/// In the other direction: a duplicate STOP does not end the messages.
#[test]
fn delayed_duplicate_of_stop_does_not_stop() {
    let mut world = world();
    control(&mut world, RADIO, START);
    control(&mut world, RADIO, STOP);
    assert_eq!(switch(&mut world, RADIO, START), (DONE, true));
    run(&mut world, secs(25));
    assert_eq!(count(&mut world), 2);
    assert_eq!(switch(&mut world, SAT, START), (DONE, true));
    assert_eq!(switch(&mut world, SAT, STOP), (LATER, true));
    assert_eq!(switch(&mut world, SAT, START), (DONE, true));
    run(&mut world, secs(5));
    assert_eq!(count(&mut world), 0, "a duplicate sends no message");
    assert_eq!(switch(&mut world, SAT, STOP), (DONE, false), "not a duplicate");
}

/// A radio delays nothing. What looks like a duplicate of a command by satellite is a new command, and supersedes the
/// satellite's commands that are still in flight.
#[test]
fn command_by_radio_is_never_a_delayed_duplicate() {
    let mut world = world();
    world.gcs[RADIO].heartbeat_period = Some(secs(1));
    control(&mut world, SAT, STOP);
    control(&mut world, SAT, START);
    assert_eq!(switch(&mut world, SAT, STOP), (DONE, false));
    run(&mut world, secs(5));
    assert_eq!(switch(&mut world, RADIO, STOP), (DONE, false));
    assert_eq!(switch(&mut world, SAT, START), (LATER, false));
    assert_eq!(switch(&mut world, RADIO, START), (DONE, true));
    assert_eq!(switch(&mut world, RADIO, STOP), (DONE, false));
}

/// C-12: a duplicate is recognised for a minute, and only from the same sender.
#[test]
fn start_after_a_minute_or_from_another_sender_is_new() {
    for (wait, other, result) in [(58, false, LATER), (61, false, DONE), (10, true, DONE)] {
        let mut world = world();
        control(&mut world, RADIO, START);
        control(&mut world, RADIO, STOP);
        run(&mut world, secs(wait));
        if other {
            world.gcs[SAT].address = OTHER_STATION;
        }
        assert_eq!(switch(&mut world, SAT, START), (result, result == DONE), "{wait} s, {other}");
    }
    // Many STARTs by radio long ago do not make the satellite expect as many duplicates.
    let mut world = world();
    for _ in 0..5 {
        control(&mut world, RADIO, START);
        control(&mut world, RADIO, STOP);
    }
    run(&mut world, secs(61));
    control(&mut world, RADIO, START);
    control(&mut world, RADIO, STOP);
    assert_eq!(switch(&mut world, SAT, START), (LATER, false));
    assert_eq!(switch(&mut world, SAT, START), (DONE, true));
}

/// C-12: a delayed retransmission of a START, with a higher confirmation, does not undo a STOP, nor a stop by the firmware.
#[test]
fn retransmitted_start_does_not_undo_a_stop() {
    let mut world = world();
    let start = [START, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    control(&mut world, SAT, START);
    control(&mut world, RADIO, STOP);
    assert_eq!(send(&mut world, SAT, MavCmd::CONTROL_HIGH_LATENCY, start, 1), LATER);
    assert!(!satellite(&mut world).is_on());
    control(&mut world, RADIO, START);
    satellite(&mut world).stop();
    assert_eq!(send(&mut world, SAT, MavCmd::CONTROL_HIGH_LATENCY, start, 2), LATER);
    assert!(!satellite(&mut world).is_on());
    // Retransmissions of a duplicate do not either.
    let mut world = self::world();
    control(&mut world, RADIO, START);
    control(&mut world, RADIO, STOP);
    for confirmation in 0..3 {
        assert_eq!(send(&mut world, SAT, MavCmd::CONTROL_HIGH_LATENCY, start, confirmation), LATER);
    }
    assert_eq!(switch(&mut world, SAT, START), (DONE, true), "not a duplicate");
}

/// L-15, L-16: a START by satellite follows a STOP by radio from the same sender. While the sender is alive on the radio, the
/// START is superseded. If it is not, or after a minute, the START is carried out.
#[test]
fn satellite_does_not_override_a_sender_that_is_alive_on_radio() {
    for (is_heard, wait, result) in [(true, 15, LATER), (true, 61, DONE), (false, 15, DONE)] {
        let mut world = world();
        world.gcs[RADIO].heartbeat_period = Some(secs(1));
        run(&mut world, secs(5));
        assert_eq!(switch(&mut world, RADIO, STOP), (DONE, false));
        if !is_heard {
            world.gcs[RADIO].heartbeat_period = None;
        }
        run(&mut world, secs(wait));
        assert_eq!(switch(&mut world, SAT, START), (result, result == DONE), "{is_heard}, after {wait} s");
        run(&mut world, secs(5));
        assert_eq!(count(&mut world), usize::from(result == DONE));
        assert_eq!(switch(&mut world, RADIO, START), (DONE, true), "the same sender can by radio");
    }
    // The same for a STOP after a START by radio.
    let mut world = world();
    world.gcs[RADIO].heartbeat_period = Some(secs(1));
    run(&mut world, secs(5));
    control(&mut world, RADIO, START);
    assert_eq!(switch(&mut world, SAT, STOP), (LATER, true));
    assert_eq!(switch(&mut world, RADIO, STOP), (DONE, false));
    // Another station did not send the START, although it is alive on the radio.
    world.gcs[SAT].address = OTHER_STATION;
    assert_eq!(switch(&mut world, SAT, START), (DONE, true));
}

/// L-15: a STOP that was carried out by satellite ends the wait for duplicates of an earlier START there: the next one is new.
#[test]
fn link_preserves_the_order_of_its_frames() {
    let mut world = world();
    assert_eq!(switch(&mut world, RADIO, START), (DONE, true));
    run(&mut world, secs(10));
    assert_eq!(switch(&mut world, SAT, STOP), (DONE, false));
    assert_eq!(switch(&mut world, SAT, START), (DONE, true));
}

/// L-16: STOP and then START by radio: the START by satellite is a duplicate of the latest command, and not superseded. A
/// second START by satellite is not a duplicate, and sends a message.
#[test]
fn latest_command_is_not_superseded() {
    let mut world = world();
    world.gcs[RADIO].heartbeat_period = Some(secs(1));
    run(&mut world, secs(5));
    assert_eq!(switch(&mut world, RADIO, STOP), (DONE, false));
    run(&mut world, secs(1));
    assert_eq!(switch(&mut world, RADIO, START), (DONE, true));
    run(&mut world, secs(5));
    assert_eq!(count(&mut world), 1);
    for messages in [0, 1] {
        assert_eq!(switch(&mut world, SAT, START), (DONE, true));
        run(&mut world, secs(5));
        assert_eq!(count(&mut world), messages);
    }
}

/// C-12: the first transmission of a new START is lost. Its retransmissions do not belong to the START before the STOP. They
/// are recognised for three seconds on the same link, and for a minute by satellite.
#[test]
fn retransmissions_belong_to_the_new_start() {
    for link in [RADIO, SAT] {
        let start = [START, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let mut world = world();
        assert_eq!(switch(&mut world, link, START), (DONE, true));
        run(&mut world, secs(10));
        assert_eq!(switch(&mut world, link, STOP), (DONE, false));
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
        assert_eq!(count(&mut world), usize::from(link == RADIO), "by radio it is new after three seconds");
    }
}

/// C-12: each station has its own commands and duplicates.
#[test]
fn duplicates_are_recognised_per_station() {
    let mut world = world();
    assert_eq!(switch(&mut world, RADIO, START), (DONE, true));
    world.gcs[RADIO].address = OTHER_STATION;
    assert_eq!(switch(&mut world, RADIO, START), (DONE, true));
    assert_eq!(switch(&mut world, RADIO, STOP), (DONE, false));
    run(&mut world, secs(20));
    assert_eq!(switch(&mut world, SAT, START), (LATER, false));
    world.gcs[SAT].address = OTHER_STATION;
    assert_eq!(switch(&mut world, SAT, START), (LATER, false));
    assert_eq!(switch(&mut world, SAT, STOP), (DONE, false));
    assert_eq!(switch(&mut world, SAT, START), (DONE, true), "not a duplicate");
}

/// The commands of a third station evict the oldest ones, not its own.
#[test]
fn third_station_evicts_the_oldest_commands() {
    const THIRD: Address = Address::new(253, 190);
    let mut world = world();
    for station in [STATION, OTHER_STATION, THIRD] {
        world.gcs[RADIO].address = station;
        control(&mut world, RADIO, START);
        run(&mut world, secs(1));
        assert_eq!(switch(&mut world, RADIO, STOP), (DONE, false));
        run(&mut world, secs(1));
    }
    for (station, result) in [(THIRD, LATER), (OTHER_STATION, LATER), (STATION, DONE)] {
        world.gcs[SAT].address = station;
        assert_eq!(switch(&mut world, SAT, START), (result, result == DONE));
    }
}

proptest! {
    #![proptest_config(cases(300))]

    /// A router sends every command over both links, and the satellite delivers its frames in control, up to 50 s late. The
    /// latest command by radio always decides, whether or not its sender is alive there.
    #[test]
    fn delayed_duplicates_never_override_the_latest_command(
        steps in prop::collection::vec((any::<bool>(), 0u64..20), 1..14),
        delay in 0u64..50,
        is_heard: bool,
    ) {
        let mut world = world();
        world.gcs[RADIO].heartbeat_period = is_heard.then_some(secs(1));
        run(&mut world, secs(2));
        let mut in_flight = VecDeque::new();
        let mut is_on = false;
        let mut steps = VecDeque::from(steps);
        let mut next = world.now();
        while !steps.is_empty() || !in_flight.is_empty() {
            let now = world.now();
            if in_flight.front().is_some_and(|(due, _)| *due <= now) {
                let (_, enable) = in_flight.pop_front().unwrap();
                let result = control(&mut world, SAT, enable);
                prop_assert_eq!(result, if is_on == (enable == START) { DONE } else { LATER });
            } else if next <= now && let Some((starts, wait)) = steps.pop_front() {
                let enable = if starts { START } else { STOP };
                prop_assert_eq!(control(&mut world, RADIO, enable), DONE);
                in_flight.push_back((now + secs(delay), enable));
                is_on = starts;
                next = now + secs(wait);
            }
            prop_assert_eq!(satellite(&mut world).is_on(), is_on);
            run(&mut world, millis(500));
        }
    }
}

/// C-12: a command that runs once is not carried out again when the satellite delivers its duplicate half a minute later, once
/// per original. By another radio it is new by then. The duplicate is not answered ACCEPTED, because it may be a new command.
#[test]
fn delayed_duplicate_is_not_carried_out() {
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
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), MavResult::FAILED, "a third one is not a duplicate");
    assert_eq!(
        send(&mut world, RADIO, ONCE, PARAMS, 0),
        MavResult::FAILED,
        "by radio it is a duplicate of the last one"
    );
    assert_eq!(world.vehicle.commands().len(), 3);
    run(&mut world, millis(1_100));
    assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), MavResult::FAILED);
    assert_eq!(world.vehicle.commands().len(), 4);
    // Its sender retransmits it over the satellite, where an answer is slow.
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), MavResult::FAILED);
    run(&mut world, secs(40));
    world.vehicle.outcomes.insert(ONCE.0, DONE.into());
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 1), LATER);
    assert_eq!(world.vehicle.commands().len(), 4);
    // A duplicate by satellite of a command by satellite is recognised too.
    run(&mut world, secs(61));
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), DONE);
    run(&mut world, secs(20));
    world.vehicle.outcomes.insert(ONCE.0, MavResult::FAILED.into());
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 1), DONE);
    assert_eq!(world.vehicle.commands().len(), 5);
}

/// C-12: the satellite delivers every retransmission of a command, and it is carried out once.
#[test]
fn delayed_retransmissions_are_not_carried_out() {
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

/// C-12: after a minute a command is new.
#[test]
fn command_is_remembered_for_a_minute() {
    for (wait, is_new) in [(59, false), (61, true)] {
        let mut world = world();
        send(&mut world, RADIO, ONCE, PARAMS, 0);
        run(&mut world, secs(wait));
        send(&mut world, SAT, ONCE, PARAMS, 0);
        assert_eq!(world.vehicle.commands().len(), 1 + usize::from(is_new), "{wait} s");
    }
}

/// C-22: a command that is only remembered for the satellite blocks no slot. With three slots, the last three are remembered.
#[test]
fn new_command_evicts_a_remembered_one() {
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
    // The oldest was evicted. Carrying it out again evicts the oldest of the others.
    send(&mut world, SAT, ONCE, pressed(0), 0);
    assert_eq!(world.vehicle.commands().len(), 5);
    // Two commands run and one has just ended, so there is no free slot: an ended command keeps its slot for three seconds.
    assert_eq!(send(&mut world, RADIO, CALIBRATE, PARAMS, 0), MavResult::IN_PROGRESS);
    world.vehicle.long.insert(MavCmd::NAV_LAND.0);
    world.vehicle.outcomes.remove(&MavCmd::NAV_LAND.0);
    assert_eq!(send(&mut world, RADIO, MavCmd::NAV_LAND, [0.0; 7], 0), MavResult::IN_PROGRESS);
    assert_eq!(send(&mut world, RADIO, ONCE, pressed(9), 0), LATER);
    run(&mut world, secs(4));
    assert_eq!(send(&mut world, RADIO, ONCE, pressed(9), 0), DONE);
}

/// C-12, C-24: a delayed duplicate does not restart a long command that has ended and runs once; a new command does.
#[test]
fn delayed_duplicate_does_not_restart_an_ended_command() {
    let mut world = world();
    world.vehicle.outcomes.remove(&ONCE.0);
    world.vehicle.long.insert(ONCE.0);
    assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), MavResult::IN_PROGRESS);
    run(&mut world, secs(2));
    world.stack.long_commands_mut().finish(ONCE, MavResult::FAILED);
    run(&mut world, secs(30));
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), LATER);
    assert!(!world.stack.long_commands_mut().is_running(ONCE));
    assert_eq!(send(&mut world, SAT, ONCE, PARAMS, 0), MavResult::IN_PROGRESS, "not a duplicate");
    world.stack.long_commands_mut().finish(ONCE, DONE);
    run(&mut world, secs(5));
    // By radio it is too late for a duplicate.
    assert_eq!(send(&mut world, RADIO, ONCE, PARAMS, 0), MavResult::IN_PROGRESS);
}

/// C-24: a long command that may run twice is carried out when it is sent by satellite. Answering it as done would leave the
/// vehicle where it is. Three seconds after its end it is a new command, with any confirmation.
#[test]
fn return_by_satellite_is_carried_out_again() {
    const RTL: MavCmd = MavCmd::NAV_RETURN_TO_LAUNCH;
    for confirmation in [0, 1, 2] {
        let mut world = world();
        world.vehicle.long.insert(RTL.0);
        world.vehicle.outcomes.insert(MavCmd::NAV_TAKEOFF.0, DONE.into());
        assert_eq!(send(&mut world, RADIO, RTL, [0.0; 7], 0), MavResult::IN_PROGRESS);
        run(&mut world, secs(5));
        world.stack.long_commands_mut().finish(RTL, DONE);
        run(&mut world, secs(2));
        assert_eq!(send(&mut world, SAT, RTL, [0.0; 7], 0), DONE, "its duplicate");
        assert_eq!(send(&mut world, RADIO, MavCmd::NAV_TAKEOFF, [0.0; 7], 0), DONE);
        assert_eq!(world.vehicle.commands().len(), 2);
        run(&mut world, secs(40));
        assert_eq!(send(&mut world, SAT, RTL, [0.0; 7], confirmation), MavResult::IN_PROGRESS);
        assert_eq!(world.vehicle.commands().len(), 3);
    }
}
