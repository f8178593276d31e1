//! Jumps, pauses, and commands that set where the mission starts, continues and ends.

use crate::support::{Flight, act, jump, waypoint};
use mavstack::dialect::{MavCmd, MavMissionResult, MavResult, MissionState};
use mavstack::plan::PlanFault;
use mavstack::{Item, PlanType, Plans};
use mavstack_demo::Mode;

fn delay(seconds: f32) -> Item {
    act(MavCmd::NAV_DELAY, [seconds, -1.0, -1.0, -1.0])
}

/// M-72: a jump is taken as often as its repeat count says, then skipped.
#[test]
fn a_jump_follows_its_repeat_count() {
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
fn a_jump_may_repeat_forever() {
    let mut flight = Flight::flying(&[delay(1.0), delay(1.0), jump(1, -1.0), waypoint(99.0, 0.0)]);
    flight.run(60_000);
    let reached = flight.reached();
    assert!((57..=60).contains(&reached.len()) && reached[0] == 0 && reached[1..].iter().all(|&seq| seq == 1));
    assert_eq!(flight.mission(), (1, MissionState::ACTIVE));
}

/// Each jump has its own counter. A completed jump stays completed in an outer loop, as with other autopilots.
#[test]
fn jumps_may_be_nested_and_lead_forward() {
    let mut flight = Flight::flying(&[
        delay(0.1),   // 0
        jump(4, 1.0), // 1: skips 2 and 3 the first time
        delay(0.1),   // 2
        jump(2, 2.0), // 3
        delay(0.1),   // 4
        jump(0, 2.0), // 5
    ]);
    flight.until_end(10);
    assert_eq!(flight.reached(), [0, 4, 0, 2, 2, 2, 4, 0, 2, 4]);
}

/// A loop without a leg ends the mission, with a text, and does not hang the flight loop.
#[test]
fn a_loop_without_a_leg_ends_the_mission() {
    let speed = act(MavCmd::DO_CHANGE_SPEED, [1.0, 3.0, 0.0, 0.0]);
    for plan in [
        vec![waypoint(0.0, 0.0), jump(2, -1.0), jump(1, -1.0)],
        vec![waypoint(0.0, 0.0), speed, jump(3, -1.0), speed, jump(1, -1.0), waypoint(9.0, 0.0)],
    ] {
        let mut flight = Flight::flying(&plan);
        flight.until_end(10);
        assert_eq!(flight.texts(), ["Mission ended: a loop with nothing to fly"], "{plan:?}");
        assert_eq!((flight.mission().1, flight.reached()), (MissionState::COMPLETE, vec![0]));
        assert!(flight.vehicle.is_armed());
    }
}

/// A finite loop ends even without a leg in it (M-73), and the items after it are flown.
#[test]
fn a_finite_loop_of_conditions_ends() {
    let wait = act(MavCmd::CONDITION_DELAY, [0.5, 0.0, 0.0, 0.0]);
    let mut flight = Flight::flying(&[waypoint(0.0, 0.0), wait, jump(1, 3.0), waypoint(9.0, 0.0)]);
    flight.until_end(20);
    assert_eq!(flight.reached(), [0, 3]);
    // After the loop the next leg differs from the leg that was found before the loop.
    let mut flight =
        Flight::flying(&[waypoint(0.0, 0.0), wait, jump(1, 3.0), jump(5, 1.0), waypoint(9.0, 0.0), waypoint(0.0, 9.0)]);
    flight.until_end(30);
    assert_eq!(flight.reached(), [0, 5]);
}

/// A waypoint is reached even if its radius is smaller than the vehicle's accuracy.
#[test]
fn a_tiny_radius_is_reached() {
    let mut flight = Flight::flying(&[Item { params: [0.0, 0.001, 0.0, 0.0], ..waypoint(9.0, 0.0) }]);
    flight.until_end(20);
    assert_eq!(flight.reached(), [0]);
}

/// A plan with more jumps than counters is refused, with the first item that has no counter.
#[test]
fn more_jumps_than_counters_are_refused() {
    let mut plan = vec![waypoint(0.0, 0.0)];
    plan.extend((0..16).map(|_| jump(0, 1.0)));
    let mut flight = Flight::airborne();
    assert_eq!(flight.change(PlanType::Mission, &plan, 0), Ok(()));
    flight.start(None, None);
    flight.until_end(10);
    assert_eq!(flight.reached(), [0; 17], "every jump has a counter");
    plan.insert(1, jump(0, 1.0));
    let fault = PlanFault { seq: Some(17), result: MavMissionResult::NO_SPACE };
    assert_eq!(flight.change(PlanType::Mission, &plan, 0), Err(fault));
}

/// M-92: a reset restarts the jump counters.
#[test]
fn set_current_with_reset_restarts_jump_counters() {
    for (reset, reached) in [(false, vec![0, 2]), (true, vec![0, 0, 2])] {
        let mut flight = Flight::flying(&[delay(1.0), jump(0, 1.0), delay(1.0)]);
        flight.until("at the last item", 10, |vehicle| vehicle.progress().current == 2);
        flight.reached();
        assert_eq!(flight.set_current(0, reset), MavResult::ACCEPTED);
        assert_eq!(flight.mission(), (0, MissionState::ACTIVE));
        flight.until_end(10);
        assert_eq!(flight.reached(), reached, "{reset}");
    }
}

/// M-92: the mode does not change. In flight the vehicle turns to the item at once, and the item is reached again.
#[test]
fn set_current_takes_effect_at_once_and_keeps_the_mode() {
    let plan = [waypoint(50.0, 0.0), waypoint(0.0, 50.0), waypoint(0.0, -50.0)];
    let mut flight = Flight::airborne();
    flight.upload(&plan);
    assert_eq!(flight.set_current(1, false), MavResult::ACCEPTED);
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((1, MissionState::NOT_STARTED), Mode::Hold));
    flight.start(None, None);
    flight.run(4_000);
    assert!(flight.vehicle.velocity().east > 5.0);
    assert_eq!(flight.set_current(2, true), MavResult::ACCEPTED);
    flight.run(8_000);
    assert!(flight.vehicle.velocity().east < -5.0);
    flight.set_mode(Mode::Hold);
    assert_eq!(flight.set_current(1, false), MavResult::ACCEPTED);
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((1, MissionState::PAUSED), Mode::Hold));
    assert_eq!(flight.set_current(3, false), MavResult::FAILED);
    flight.set_mode(Mode::Mission);
    flight.until_end(60);
    assert_eq!(flight.reached(), [1, 2]);
}

/// M-92: with reset a complete mission becomes paused, and resumes at the item. Without reset it stays complete.
#[test]
fn set_current_reopens_a_complete_mission() {
    for (reset, state) in [(true, MissionState::PAUSED), (false, MissionState::COMPLETE)] {
        let mut flight = Flight::flying(&[delay(0.1), delay(0.1), delay(0.1)]);
        flight.until_end(10);
        flight.reached();
        assert_eq!(flight.mission(), (2, MissionState::COMPLETE));
        flight.set_current(1, reset);
        assert_eq!(flight.mission(), (1, state));
        flight.start(None, None);
        assert_eq!(flight.mission(), (1, MissionState::ACTIVE));
        flight.until_end(10);
        assert_eq!(flight.reached(), [1, 2]);
    }
}

/// M-95: MISSION_START with a first and a last item.
#[test]
fn mission_start_honours_the_first_and_last_item() {
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
        assert_eq!(flight.texts(), ["Mission complete"]);
        // The next flight covers the whole plan again.
        flight.start(None, None);
        flight.until_end(60);
        assert_eq!(flight.reached(), [0, 1, 2, 3]);
    }
}

/// A jump beyond the last item to fly ends the mission.
#[test]
fn a_jump_beyond_the_last_item_ends_the_mission() {
    let mut flight = Flight::airborne();
    flight.upload(&[delay(0.1), jump(3, -1.0), delay(0.1), delay(0.1)]);
    flight.start(None, Some(2));
    flight.until_end(10);
    assert_eq!((flight.reached(), flight.mission()), (vec![0], (2, MissionState::COMPLETE)));
}

#[test]
fn an_invalid_mission_start_is_refused() {
    let mut flight = Flight::airborne();
    assert_eq!(flight.start(None, None), MavResult::FAILED);
    assert_eq!(flight.texts(), ["Mission refused: no mission uploaded"]);
    flight.upload(&[delay(0.1), delay(0.1), delay(60.0)]);
    flight.start(None, None);
    flight.until_current(2, 10);
    flight.set_mode(Mode::Hold);
    assert_eq!(flight.start(None, Some(1)), MavResult::DENIED, "the current item is after the last item");
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((2, MissionState::PAUSED), Mode::Hold));
}

/// A refused start changes nothing.
#[test]
fn a_refused_start_keeps_the_current_item() {
    let mut flight = Flight::new();
    flight.run(2_500);
    flight.upload(&[delay(0.1), delay(0.1), delay(0.1)]);
    flight.set_current(1, false);
    assert_eq!(flight.start(Some(0), Some(0)), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(flight.mission(), (1, MissionState::NOT_STARTED));
    flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
    flight.start(None, None);
    flight.until_end(10);
    assert_eq!(flight.reached(), [1, 2]);
}

/// A new current item after the last item to fly removes that limit: the operator wants to go further.
#[test]
fn set_current_after_the_last_item_removes_the_limit() {
    let mut flight = Flight::airborne();
    flight.upload(&[delay(9.0), delay(0.1), delay(0.1), delay(0.1)]);
    flight.start(None, Some(1));
    flight.set_current(2, false);
    flight.until_end(10);
    assert_eq!(flight.reached(), [2, 3]);
}

/// A pause keeps the current item. Items reached before it are not reported again, and a delay restarts.
#[test]
fn a_mission_is_paused_and_resumed() {
    let mut flight = Flight::flying(&[waypoint(0.0, 0.0), waypoint(100.0, 0.0), delay(5.0)]);
    flight.run(4_000);
    flight.set_mode(Mode::Hold);
    assert_eq!(flight.mission(), (1, MissionState::PAUSED));
    let (before, at) = (flight.speed(), flight.vehicle.local_position());
    flight.run(10_000);
    assert!(before > 5.0 && flight.speed() < 0.1);
    assert!(flight.distance(at.north, at.east) < before * before / 6.0 + 0.2, "it stops as fast as it can, and holds");
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

/// An item that was reached before a pause is not reported again, even if its hold time has not passed.
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

/// M-39, M-94: a new plan in flight starts at its first item, whether it is shorter or longer than the old one.
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

/// Without a plan the vehicle holds its position, and MISSION_START fails.
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
    assert_eq!(flight.set_current(0, true), MavResult::FAILED);
}

/// A new plan is not started, and its jump counters restart.
#[test]
fn a_new_plan_restarts_jump_counters() {
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
