//! Jumps, and where the mission is told to begin, to go on and to end.

mod support;

use mavstack::dialect::{MavCmd, MavMissionResult, MavResult, MissionState};
use mavstack::{Item, PlanFault, PlanType, Plans};
use mavstack_demo::Mode;
use support::{Flight, act, jump, waypoint};

fn delay(seconds: f32) -> Item {
    act(MavCmd::NAV_DELAY, [seconds, -1.0, -1.0, -1.0])
}

/// M-72: a jump is taken as often as it says, then passed over.
#[test]
fn a_jump_is_repeated_as_often_as_it_says() {
    for (repeat, reached) in [(0.0, vec![0, 1, 3]), (1.0, vec![0, 1, 0, 1, 3]), (3.0, vec![0, 1, 0, 1, 0, 1, 0, 1, 3])]
    {
        let mut flight =
            Flight::flying(&[waypoint(10.0, 0.0), waypoint(0.0, 0.0), jump(0, repeat), waypoint(0.0, 5.0)]);
        flight.until_end(120);
        assert_eq!(flight.reached(), reached, "{repeat}");
        assert_eq!(flight.mission(), (3, MissionState::COMPLETE));
    }
}

#[test]
fn a_jump_may_go_on_forever() {
    let mut flight = Flight::flying(&[delay(1.0), delay(1.0), jump(1, -1.0), waypoint(99.0, 0.0)]);
    flight.run(60_000);
    let reached = flight.reached();
    assert!((57..=60).contains(&reached.len()) && reached[0] == 0 && reached[1..].iter().all(|&seq| seq == 1));
    assert_eq!(flight.mission(), (1, MissionState::ACTIVE));
}

/// Each jump has its own counter; one that is used up stays so in a loop around it, as with other autopilots.
#[test]
fn jumps_may_be_nested_and_lead_forward() {
    let mut flight = Flight::flying(&[
        delay(0.1),   // 0
        jump(4, 1.0), // 1: the first time over 2 and 3
        delay(0.1),   // 2
        jump(2, 2.0), // 3
        delay(0.1),   // 4
        jump(0, 2.0), // 5
    ]);
    flight.until_end(10);
    assert_eq!(flight.reached(), [0, 4, 0, 2, 2, 2, 4, 0, 2, 4]);
}

/// A loop without anything to fly ends the mission instead of the flight loop; the text says why.
#[test]
fn a_loop_without_a_leg_ends() {
    let speed = act(MavCmd::DO_CHANGE_SPEED, [1.0, 3.0, 0.0, 0.0]);
    for plan in [
        vec![waypoint(0.0, 0.0), jump(1, -1.0)],
        vec![waypoint(0.0, 0.0), speed, jump(3, -1.0), speed, jump(1, -1.0), waypoint(9.0, 0.0)],
    ] {
        let mut flight = Flight::flying(&plan);
        flight.until_end(10);
        assert_eq!(flight.said(), ["Mission ends: a loop without a leg"], "{plan:?}");
        assert_eq!((flight.mission().1, flight.reached()), (MissionState::COMPLETE, vec![0]));
        assert!(flight.vehicle.is_armed());
    }
}

/// A loop that comes to an end does, with or without anything to fly in it (M-73): what is behind it is flown.
#[test]
fn a_loop_of_conditions_is_gone_round() {
    let wait = act(MavCmd::CONDITION_DELAY, [0.5, 0.0, 0.0, 0.0]);
    let mut flight = Flight::flying(&[waypoint(0.0, 0.0), wait, jump(1, 3.0), waypoint(9.0, 0.0)]);
    flight.until_end(20);
    assert_eq!(flight.reached(), [0, 3]);
    // The way behind it leads elsewhere than it seemed to from before it.
    let mut flight =
        Flight::flying(&[waypoint(0.0, 0.0), wait, jump(1, 3.0), jump(5, 1.0), waypoint(9.0, 0.0), waypoint(0.0, 9.0)]);
    flight.until_end(30);
    assert_eq!(flight.reached(), [0, 5]);
}

/// A waypoint whose radius is smaller than it flies exactly is reached nevertheless.
#[test]
fn a_tiny_radius_is_reached() {
    let mut flight = Flight::flying(&[Item { params: [0.0, 0.001, 0.0, 0.0], ..waypoint(9.0, 0.0) }]);
    flight.until_end(20);
    assert_eq!(flight.reached(), [0]);
}

/// There are counters for so many jumps, and a plan with more names the first without one.
#[test]
fn more_jumps_than_counters_are_refused() {
    let mut plan = vec![waypoint(0.0, 0.0)];
    plan.extend((0..16).map(|_| jump(0, 1.0)));
    let mut flight = Flight::airborne();
    assert_eq!(flight.change(PlanType::Mission, &plan, 0), Ok(()));
    flight.start(None, None);
    flight.until_end(10);
    assert_eq!(flight.reached(), [0; 17], "all of them count");
    plan.insert(1, jump(0, 1.0));
    let fault = PlanFault { seq: Some(17), result: MavMissionResult::NO_SPACE };
    assert_eq!(flight.change(PlanType::Mission, &plan, 0), Err(fault));
}

/// M-92: with reset the jumps begin anew, without they do not.
#[test]
fn set_current_with_reset_counts_jumps_anew() {
    for (reset, reached) in [(false, vec![0, 2]), (true, vec![0, 0, 2])] {
        let mut flight = Flight::flying(&[delay(1.0), jump(0, 1.0), delay(1.0)]);
        flight.until("at the last", 10, |vehicle| vehicle.progress().current == 2);
        flight.reached();
        assert_eq!(flight.vehicle.set_current(0, reset), MavResult::ACCEPTED);
        assert_eq!(flight.mission(), (0, MissionState::ACTIVE));
        flight.until_end(10);
        assert_eq!(flight.reached(), reached, "{reset}");
    }
}

/// M-92: the mode stays as it is; under way the vehicle turns to the item at once, and it is reached again.
#[test]
fn set_current_takes_effect_at_once_and_keeps_the_mode() {
    let plan = [waypoint(50.0, 0.0), waypoint(0.0, 50.0), waypoint(0.0, -50.0)];
    let mut flight = Flight::airborne();
    flight.upload(&plan);
    assert_eq!(flight.vehicle.set_current(1, false), MavResult::ACCEPTED);
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((1, MissionState::NOT_STARTED), Mode::Hold));
    flight.start(None, None);
    flight.run(4_000);
    assert!(flight.vehicle.velocity().east > 5.0);
    assert_eq!(flight.vehicle.set_current(2, true), MavResult::ACCEPTED);
    flight.run(8_000);
    assert!(flight.vehicle.velocity().east < -5.0);
    flight.set_mode(Mode::Hold);
    assert_eq!(flight.vehicle.set_current(1, false), MavResult::ACCEPTED);
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((1, MissionState::PAUSED), Mode::Hold));
    assert_eq!(flight.vehicle.set_current(3, false), MavResult::FAILED);
    flight.set_mode(Mode::Mission);
    flight.until_end(60);
    assert_eq!(flight.reached(), [1, 2]);
}

/// M-92: with reset a mission that was complete is paused, and goes on from there; without it stays complete.
#[test]
fn set_current_opens_a_complete_mission() {
    for (reset, state) in [(true, MissionState::PAUSED), (false, MissionState::COMPLETE)] {
        let mut flight = Flight::flying(&[delay(0.1), delay(0.1), delay(0.1)]);
        flight.until_end(10);
        flight.reached();
        assert_eq!(flight.mission(), (2, MissionState::COMPLETE));
        flight.vehicle.set_current(1, reset);
        assert_eq!(flight.mission(), (1, state));
        flight.start(None, None);
        assert_eq!(flight.mission(), (1, MissionState::ACTIVE));
        flight.until_end(10);
        assert_eq!(flight.reached(), [1, 2]);
    }
}

/// M-95
#[test]
fn mission_start_minds_the_first_and_the_last_item() {
    for (first, last, reached) in [
        (Some(1), Some(2), vec![1, 2]),
        (Some(2), None, vec![2, 3]),
        (None, Some(1), vec![0, 1]),
        (Some(3), Some(3), vec![3]),
        (None, None, vec![0, 1, 2, 3]),
    ] {
        let mut flight = Flight::airborne();
        flight.upload(&[waypoint(0.0, 0.0), waypoint(10.0, 0.0), waypoint(20.0, 0.0), waypoint(30.0, 0.0)]);
        assert_eq!(flight.start(first, last), MavResult::ACCEPTED);
        flight.until_end(60);
        assert_eq!(flight.reached(), reached, "{first:?} {last:?}");
        assert_eq!(flight.mission(), (*reached.last().unwrap(), MissionState::COMPLETE));
        assert_eq!(flight.said(), ["Mission complete"]);
        // The next flight is the whole plan again.
        flight.start(None, None);
        flight.until_end(60);
        assert_eq!(flight.reached(), [0, 1, 2, 3]);
    }
}

/// A jump beyond the last item ends the mission like that item.
#[test]
fn a_jump_does_not_lead_beyond_the_last_item() {
    let mut flight = Flight::airborne();
    flight.upload(&[delay(0.1), jump(3, -1.0), delay(0.1), delay(0.1)]);
    flight.start(None, Some(2));
    flight.until_end(10);
    assert_eq!((flight.reached(), flight.mission()), (vec![0], (2, MissionState::COMPLETE)));
}

#[test]
fn mission_start_refuses_what_it_cannot_fly() {
    let mut flight = Flight::airborne();
    assert_eq!(flight.start(None, None), MavResult::FAILED);
    assert_eq!(flight.said(), ["Mission refused: there is none"]);
    flight.upload(&[delay(0.1), delay(0.1), delay(60.0)]);
    flight.start(None, None);
    flight.until_current(2, 10);
    flight.set_mode(Mode::Hold);
    assert_eq!(flight.start(None, Some(1)), MavResult::DENIED, "it is beyond that item");
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((2, MissionState::PAUSED), Mode::Hold));
}

/// A start that is refused changes nothing.
#[test]
fn a_start_that_is_refused_keeps_the_place() {
    let mut flight = Flight::new();
    flight.run(2_500);
    flight.upload(&[delay(0.1), delay(0.1), delay(0.1)]);
    flight.vehicle.set_current(1, false);
    assert_eq!(flight.start(Some(0), Some(0)), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(flight.mission(), (1, MissionState::NOT_STARTED));
    flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    flight.start(None, None);
    flight.until_end(10);
    assert_eq!(flight.reached(), [1, 2]);
}

/// An item behind the one that the flight was to end with: the operator wants to go further.
#[test]
fn set_current_behind_the_last_item_lifts_that() {
    let mut flight = Flight::airborne();
    flight.upload(&[delay(9.0), delay(0.1), delay(0.1), delay(0.1)]);
    flight.start(None, Some(1));
    flight.vehicle.set_current(2, false);
    flight.until_end(10);
    assert_eq!(flight.reached(), [2, 3]);
}

/// A pause does not lose its place; what was reached before it is not told again, and waiting begins anew.
#[test]
fn a_mission_is_paused_and_gone_on_with() {
    let mut flight = Flight::flying(&[waypoint(0.0, 0.0), waypoint(100.0, 0.0), delay(5.0)]);
    flight.run(4_000);
    flight.set_mode(Mode::Hold);
    assert_eq!(flight.mission(), (1, MissionState::PAUSED));
    let (before, at) = (flight.speed(), flight.vehicle.local_position());
    flight.run(10_000);
    assert!(before > 5.0 && flight.speed() < 0.1);
    assert!(flight.distance(at.north, at.east) < before * before / 6.0 + 0.2, "it stops as fast as it can, and stays");
    flight.set_mode(Mode::Mission);
    assert_eq!(flight.mission(), (1, MissionState::ACTIVE));
    flight.until_current(2, 30);
    flight.run(3_000);
    flight.set_mode(Mode::Hold);
    flight.set_mode(Mode::Mission);
    let took = flight.until_end(20);
    assert!((5.0..5.2).contains(&took), "{took}");
    assert_eq!(flight.reached(), [0, 1, 2]);
}

/// An item that was reached and is still stayed at when the mission is paused was told once.
#[test]
fn a_pause_at_an_item_does_not_reach_it_again() {
    let hold = Item { params: [10.0, 0.0, 0.0, f32::NAN], ..waypoint(0.0, 0.0) };
    let mut flight = Flight::flying(&[hold, waypoint(10.0, 0.0)]);
    flight.run(2_000);
    flight.set_mode(Mode::Hold);
    flight.run(1_000);
    flight.set_mode(Mode::Mission);
    flight.until_end(60);
    assert_eq!(flight.reached(), [0, 1]);
}

/// M-39, M-94: a new plan under way is begun at its first item, whether it is shorter or longer than the old one.
#[test]
fn the_plan_may_change_in_flight() {
    let long = [waypoint(0.0, 0.0), waypoint(60.0, 0.0), waypoint(60.0, 60.0), waypoint(0.0, 60.0)];
    let mut flight = Flight::flying(&long);
    flight.until_current(2, 30);
    flight.upload(&[waypoint(60.0, -10.0)]);
    assert_eq!(flight.mission(), (0, MissionState::ACTIVE));
    flight.until_end(30);
    assert_eq!(flight.reached(), [0, 1, 0]);
    assert!(flight.distance(60.0, -10.0) < 3.0);
    flight.start(None, None);
    flight.change(PlanType::Mission, &long, 3).unwrap();
    assert_eq!(flight.mission(), (3, MissionState::ACTIVE));
    flight.until_end(30);
    assert_eq!((flight.reached(), flight.mission()), (vec![3], (3, MissionState::COMPLETE)));
}

/// Without a plan it stays where it is, and there is nothing to start.
#[test]
fn an_empty_plan_holds_the_vehicle() {
    let mut flight = Flight::flying(&[waypoint(0.0, 0.0), waypoint(90.0, 0.0)]);
    flight.run(3_000);
    flight.upload(&[]);
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((0, MissionState::NOT_STARTED), Mode::Hold));
    let at = flight.vehicle.local_position();
    flight.run(10_000);
    assert!(flight.distance(at.north, at.east) < 11.0 && (flight.height() - 10.0).abs() < 1.0);
    assert!(flight.vehicle.is_armed());
    assert_eq!(flight.start(None, None), MavResult::FAILED);
    assert_eq!(flight.vehicle.set_current(0, true), MavResult::FAILED);
}

/// A new plan that is not flown yet waits to be started, with its jumps fresh.
#[test]
fn a_new_plan_begins_anew() {
    let plan = [delay(0.1), jump(0, 1.0)];
    let mut flight = Flight::flying(&plan);
    flight.until_end(10);
    assert_eq!(flight.reached(), [0, 0]);
    flight.upload(&plan);
    assert_eq!(flight.mission(), (0, MissionState::NOT_STARTED));
    flight.start(None, None);
    flight.until_end(10);
    assert_eq!(flight.reached(), [0, 0]);
}
