//! Missions in simulated time: legs, their order, and the items executed on the way.

use crate::support::{Flight, act, at, waypoint};
use mavstack::dialect::{MavCmd, MavFrame, MavResult, MissionState};
use mavstack::{Item, Plans};
use mavstack_demo::Mode;

const NAN: f32 = f32::NAN;

fn speed(speed: f32) -> Item {
    act(MavCmd::DO_CHANGE_SPEED, [1.0, speed, -1.0, 0.0])
}

#[test]
fn waypoints_are_reached_in_order_and_once_each() {
    let corners = [(22.0, 0.0), (22.0, 15.0), (0.0, 15.0)];
    let mut flight = Flight::airborne();
    flight.upload(&corners.map(|(north, east)| waypoint(north, east)));
    assert_eq!(flight.mission(), (0, MissionState::NOT_STARTED));
    flight.start(None, None);
    for (seq, (north, east)) in (0..).zip(corners) {
        assert_eq!(flight.mission(), (seq, MissionState::ACTIVE));
        let end = |flight: &Flight| flight.mission() != (seq, MissionState::ACTIVE);
        while !end(&flight) {
            flight.run(10);
            assert!(flight.millis < 60_000);
        }
        assert!(flight.distance(north, east) < 2.1, "{seq}: {:?}", flight.vehicle.local_position());
        assert_eq!(flight.reached(), [seq], "reported before the next item is current (M-91)");
    }
    assert_eq!(flight.mission(), (2, MissionState::COMPLETE));
    assert_eq!(flight.texts(), ["Mission complete"]);
    let (north, east) = (flight.vehicle.local_position().north, flight.vehicle.local_position().east);
    flight.run(10_000);
    assert!(flight.distance(north, east) < 3.0, "it holds where the plan ended");
    assert!(flight.vehicle.is_armed() && flight.height() > 9.0);
}

/// NAV_LOITER_TURNS: clockwise with a positive radius, counter-clockwise with a negative one.
#[test]
fn circles_are_flown_in_their_direction() {
    for (turns, radius) in [(1.0, 12.0), (2.0, -8.0)] {
        let circle = at(MavCmd::NAV_LOITER_TURNS, [turns, 0.0, radius, 0.0], 40.0, 30.0, 10.0);
        let mut flight = Flight::flying(&[circle, waypoint(0.0, 0.0)]);
        let distance = |flight: &Flight| flight.distance(40.0, 30.0);
        flight.until("on the circle", 60, |_| true);
        while distance(&flight) > radius.abs() {
            flight.run(100);
        }
        // The angle flown, from the sum of the steps.
        let angle = |flight: &Flight| {
            let at = flight.vehicle.local_position();
            (at.east - 30.0).atan2(at.north - 40.0)
        };
        let (mut last, mut sum, mut furthest, mut nearest) = (angle(&flight), 0.0, 0.0_f32, f32::MAX);
        while flight.mission().0 == 0 {
            flight.run(100);
            let now = angle(&flight);
            sum += (now - last + 3.0 * std::f32::consts::PI).rem_euclid(std::f32::consts::TAU) - std::f32::consts::PI;
            last = now;
            (furthest, nearest) = (furthest.max(distance(&flight)), nearest.min(distance(&flight)));
            assert!(flight.millis < 200_000);
        }
        let whole = turns * std::f32::consts::TAU * radius.signum();
        assert!((sum - whole).abs() < 0.7, "{sum} instead of {whole}");
        assert!(nearest > 0.6 * radius.abs() && furthest < 1.4 * radius.abs(), "{nearest} to {furthest}");
        assert_eq!(flight.reached(), [0]);
    }
}

/// DO_SET_SERVO on the way: SERVO_OUTPUT_RAW shows the pulse on the outputs after those of the motors.
#[test]
fn servos_are_set_on_the_way() {
    let mut flight = Flight::flying(&[
        waypoint(10.0, 0.0),
        act(MavCmd::DO_SET_SERVO, [2.0, 1_750.0, 0.0, 0.0]),
        waypoint(20.0, 0.0),
    ]);
    assert_eq!(flight.vehicle.servos(), [0; 4]);
    flight.until_end(60);
    assert_eq!(flight.vehicle.servos(), [0, 1_750, 0, 0]);
    assert_eq!(flight.command(MavCmd::DO_SET_SERVO, &[1.0, 1_100.0]), MavResult::ACCEPTED);
    assert_eq!(flight.vehicle.servos(), [1_100, 1_750, 0, 0]);
}

/// DO_LAND_START marks where the landing begins. The command flies the mission from the nearest one on.
#[test]
fn the_landing_begins_at_its_mark() {
    let mark =
        |north| Item { frame: MavFrame::GLOBAL_RELATIVE_ALT, ..at(MavCmd::DO_LAND_START, [0.0; 4], north, 0.0, 0.0) };
    let land = |north| at(MavCmd::NAV_LAND, [0.0, 0.0, 0.0, NAN], north, 0.0, 0.0);
    let plan = [waypoint(200.0, 0.0), mark(90.0), land(90.0), mark(20.0), land(20.0)];
    let mut flight = Flight::airborne();
    assert_eq!(flight.command(MavCmd::DO_LAND_START, &[]), MavResult::FAILED);
    assert_eq!(flight.texts(), ["Landing refused: the mission has no DO_LAND_START"]);
    flight.upload(&plan);
    assert_eq!(flight.command(MavCmd::DO_LAND_START, &[]), MavResult::ACCEPTED);
    flight.until("landed", 60, |vehicle| !vehicle.is_armed());
    assert!(flight.distance(20.0, 0.0) < 1.0);
}

/// Many items at one position are each reached once and in order, even with a slow loop (M-91).
#[test]
fn items_at_one_position_are_each_reached() {
    let mut flight = Flight::flying(&[waypoint(0.0, 0.0); 40]);
    while flight.vehicle.mode() == Mode::Mission {
        flight.step(100);
    }
    assert_eq!(flight.reached(), (0..40).collect::<Vec<_>>());
}

/// M-48: an item with the position 0, 0 is flown at the vehicle's position.
#[test]
fn zero_position_means_the_vehicles_position() {
    let zero = |command, z| Item { x: 0, y: 0, ..at(command, [0.0, 0.0, 0.0, NAN], 0.0, 0.0, z) };
    let mut flight = Flight::armed();
    flight.upload(&[
        zero(MavCmd::NAV_TAKEOFF, 8.0),
        waypoint(20.0, 10.0),
        Item { params: [2.0, 0.0, 0.0, NAN], ..zero(MavCmd::NAV_LOITER_TIME, 8.0) },
        zero(MavCmd::NAV_LAND, 0.0),
    ]);
    flight.start(None, None);
    while flight.vehicle.is_armed() {
        flight.run(10);
        assert!(flight.distance(0.0, 0.0) < 30.0 && flight.millis < 120_000);
    }
    assert!(flight.distance(20.0, 10.0) < 3.0 && flight.vehicle.is_landed());
    assert_eq!(flight.reached(), [0, 1, 2, 3]);
}

#[test]
fn a_plan_from_takeoff_to_landing() {
    let mut flight = Flight::armed();
    flight.upload(&[
        Item { x: i32::MAX, y: i32::MAX, ..at(MavCmd::NAV_TAKEOFF, [0.0, 0.0, 0.0, NAN], 0.0, 0.0, 6.0) },
        speed(3.0),
        at(MavCmd::NAV_WAYPOINT, [4.0, 0.0, 0.0, NAN], 33.0, 0.0, 6.0),
        act(MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 4]),
    ]);
    flight.start(None, None);
    flight.until_current(2, 10);
    assert!((flight.height() - 6.0).abs() < 0.6);
    let mut fastest: f32 = 0.0;
    while flight.mission().0 == 2 {
        flight.run(10);
        fastest = fastest.max(flight.speed());
    }
    assert!((2.9..3.1).contains(&fastest), "at the speed that the plan sets: {fastest}");
    let mut highest: f32 = 0.0;
    while flight.vehicle.is_armed() {
        flight.run(10);
        highest = highest.max(flight.height());
        assert!(flight.millis < 200_000);
    }
    assert!((14.0..16.0).contains(&highest), "it returns at 15 m: {highest}");
    assert_eq!(flight.mission(), (3, MissionState::COMPLETE));
    assert!(flight.distance(0.0, 0.0) < 1.5 && flight.vehicle.is_landed());
    assert_eq!(flight.reached(), [0, 2, 3], "DO_ items are not reached");
    assert_eq!(flight.texts(), ["Mission complete", "Landed, disarmed"]);
}

/// A plan can keep the speed (-1) or reset it (-2). A pause does not change it.
#[test]
fn the_plan_sets_the_speed() {
    let mut flight = Flight::flying(&[
        speed(4.0),
        waypoint(40.0, 0.0),
        speed(-1.0),
        waypoint(80.0, 0.0),
        speed(-2.0),
        waypoint(160.0, 0.0),
    ]);
    let fastest_to = |flight: &mut Flight, seq: u16| {
        let mut fastest: f32 = 0.0;
        while flight.mission().1 == MissionState::ACTIVE && flight.mission().0 <= seq {
            flight.run(10);
            fastest = fastest.max(flight.speed());
            if flight.millis.is_multiple_of(7_000) {
                flight.set_mode(Mode::Hold);
                flight.run(1_000);
                flight.set_mode(Mode::Mission);
            }
        }
        fastest.round()
    };
    assert_eq!(fastest_to(&mut flight, 1), 4.0);
    assert_eq!(fastest_to(&mut flight, 3), 4.0);
    assert_eq!(fastest_to(&mut flight, 5), 8.0);
}

#[test]
fn holds_at_a_waypoint_for_its_delay() {
    let mut flight =
        Flight::flying(&[at(MavCmd::NAV_WAYPOINT, [7.0, 0.0, 0.0, NAN], 0.0, 0.0, 10.0), waypoint(5.0, 0.0)]);
    let took = flight.until_current(1, 20);
    assert!((7.0..7.2).contains(&took), "{took}");
}

#[test]
fn a_waypoint_has_its_own_acceptance_radius() {
    for (radius, expected) in [(10.0, 10.0), (0.5, 0.5), (0.0, 2.0), (NAN, 2.0)] {
        let wide = at(MavCmd::NAV_WAYPOINT, [0.0, radius, 0.0, NAN], 40.0, 0.0, 10.0);
        let mut flight = Flight::flying(&[wide, waypoint(80.0, 0.0)]);
        flight.until_current(1, 30);
        let distance = flight.distance(40.0, 0.0);
        assert!((expected - 0.5..=expected + 0.1).contains(&distance), "{radius}: {distance}");
    }
}

/// Parameter 4 is the heading at a waypoint. With NaN the heading follows the course.
#[test]
fn the_heading_follows_the_course_and_the_plan() {
    let mut flight = Flight::flying(&[
        at(MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, 270.0], 60.0, 0.0, 10.0),
        at(MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, NAN], 60.0, 60.0, 10.0),
        at(MavCmd::NAV_LAND, [0.0, 0.0, 0.0, 180.0], 60.0, 60.0, 0.0),
    ]);
    flight.run(4_000);
    assert!(flight.heading() < 1.0 || flight.heading() > 359.0, "north: {}", flight.heading());
    flight.until_current(1, 20);
    assert!((flight.heading() - 270.0).abs() < 1.0, "{}", flight.heading());
    flight.run(5_000);
    assert!((flight.heading() - 90.0).abs() < 1.0, "{}", flight.heading());
    flight.until_end(60);
    assert!((flight.heading() - 180.0).abs() < 1.0, "{}", flight.heading());
}

#[test]
fn loiter_time_ends_after_its_time() {
    let mut flight =
        Flight::flying(&[at(MavCmd::NAV_LOITER_TIME, [12.0, 0.0, 50.0, 1.0], 30.0, 0.0, 10.0), waypoint(60.0, 0.0)]);
    flight.until("arrived", 20, |vehicle| vehicle.local_position().north > 28.0);
    let took = flight.until_current(1, 30);
    assert!((12.0..13.0).contains(&took), "{took}");
    assert!(flight.distance(30.0, 0.0) < 0.5);
}

/// A loiter without a position stays at the vehicle's position. An unlimited loiter ends with DO_SET_MISSION_CURRENT.
#[test]
fn unlimited_loiter_ends_on_command() {
    let here = Item { x: i32::MAX, y: i32::MAX, ..at(MavCmd::NAV_LOITER_UNLIM, [NAN; 4], 0.0, 0.0, 12.0) };
    let mut flight = Flight::flying(&[waypoint(20.0, 0.0), here, waypoint(40.0, 0.0)]);
    flight.until_current(1, 20);
    flight.run(300_000);
    assert_eq!(flight.mission(), (1, MissionState::ACTIVE));
    assert_eq!(flight.reached(), [0, 1]);
    assert!(flight.distance(20.0, 0.0) < 3.0 && (flight.height() - 12.0).abs() < 0.1);
    assert_eq!(flight.set_current(2, false), MavResult::ACCEPTED);
    flight.until_end(20);
    assert_eq!(flight.reached(), [2]);
}

#[test]
fn nav_delay_waits() {
    let mut flight =
        Flight::flying(&[waypoint(10.0, 0.0), act(MavCmd::NAV_DELAY, [6.5, -1.0, -1.0, -1.0]), waypoint(20.0, 0.0)]);
    flight.until_current(1, 20);
    flight.run(6_000);
    assert_eq!(flight.reached(), [0], "a delay is reached at its end");
    assert!((flight.until_current(2, 20) - 0.5).abs() < 0.1);
    assert_eq!(flight.reached(), [1]);
    assert!(flight.distance(10.0, 0.0) < 2.5, "it held its position");
}

#[test]
fn lands_where_the_plan_says() {
    for (land, north, east) in [
        (at(MavCmd::NAV_LAND, [0.0, 0.0, 0.0, NAN], 30.0, -20.0, 0.0), 30.0, -20.0),
        (Item { x: i32::MAX, y: i32::MAX, z: NAN, ..at(MavCmd::NAV_LAND, [NAN; 4], 0.0, 0.0, 0.0) }, 20.0, 0.0),
    ] {
        let mut flight = Flight::flying(&[waypoint(20.0, 0.0), land]);
        flight.until_end(60);
        assert!(flight.vehicle.is_landed() && !flight.vehicle.is_armed());
        assert!(flight.distance(north, east) < 3.0, "{:?}", flight.vehicle.local_position());
        assert_eq!(flight.mission(), (1, MissionState::COMPLETE));
        assert_eq!(flight.reached(), [0, 1]);
    }
}

/// Altitudes above mean sea level and above home differ.
#[test]
fn altitudes_follow_their_frame() {
    let high = Item { frame: MavFrame::GLOBAL, ..at(MavCmd::NAV_WAYPOINT, [0.0; 4], 0.0, 0.0, 508.0) };
    let mut flight = Flight::flying(&[high]);
    flight.until_end(30);
    flight.run(5_000);
    assert!((flight.height() - 20.0).abs() < 2.1, "{}", flight.height());
}

/// Items on the ground are flown at the minimum height.
#[test]
fn items_on_the_ground_are_reached() {
    let mut flight = Flight::armed();
    let low = |command, z| at(command, [0.0, 0.0, 0.0, 90.0], 20.0, 0.0, z);
    flight.upload(&[
        low(MavCmd::NAV_TAKEOFF, 0.2),
        low(MavCmd::NAV_WAYPOINT, 0.0),
        low(MavCmd::NAV_LOITER_TIME, -100.0),
        low(MavCmd::NAV_LAND, 0.0),
    ]);
    flight.start(None, None);
    flight.until_current(3, 60);
    assert!((flight.height() - 1.5).abs() < 0.6 && flight.distance(20.0, 0.0) < 2.1);
    flight.until_end(60);
    assert_eq!(flight.reached(), [0, 1, 2, 3]);
}

/// Without autocontinue the vehicle holds after the item, whatever its command, until the operator resumes the mission.
#[test]
fn without_autocontinue_the_mission_pauses() {
    let stop = |item: Item| Item { autocontinue: 0, ..item };
    let mut flight = Flight::flying(&[stop(waypoint(20.0, 0.0)), stop(speed(3.0)), waypoint(40.0, 0.0)]);
    flight.until_end(20);
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((1, MissionState::PAUSED), Mode::Hold));
    flight.run(20_000);
    assert!(flight.distance(20.0, 0.0) < 3.0);
    flight.set_mode(Mode::Mission);
    flight.run(100);
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((2, MissionState::PAUSED), Mode::Hold));
    flight.set_mode(Mode::Mission);
    flight.until_end(30);
    assert_eq!(flight.mission(), (2, MissionState::COMPLETE));
    assert_eq!(flight.reached(), [0, 2]);
}

/// The items between two legs are executed on the way to the second one. CONDITION_DELAY defers the items after it.
#[test]
fn condition_delay_defers_a_speed_change() {
    let mut flight = Flight::flying(&[
        waypoint(0.0, 0.0),
        speed(2.0),
        act(MavCmd::CONDITION_DELAY, [5.0, 0.0, 0.0, 0.0]),
        speed(6.0),
        waypoint(100.0, 0.0),
    ]);
    flight.run(4_900);
    assert_eq!(flight.mission().0, 2, "the mission waits for the delay");
    assert!((flight.speed() - 2.0).abs() < 0.1 && flight.distance(0.0, 0.0) > 7.0, "the vehicle flies meanwhile");
    flight.run(3_000);
    assert_eq!(flight.mission().0, 4);
    assert!((flight.speed() - 6.0).abs() < 0.1, "{}", flight.speed());
}

/// Items that are still deferred at the end of the leg are waited for. None is skipped.
#[test]
fn a_delay_longer_than_its_leg_extends_the_leg() {
    let mut flight = Flight::flying(&[
        act(MavCmd::CONDITION_DELAY, [20.0, 0.0, 0.0, 0.0]),
        speed(3.0),
        waypoint(20.0, 0.0),
        waypoint(60.0, 0.0),
    ]);
    flight.run(19_900);
    assert_eq!(flight.mission(), (0, MissionState::ACTIVE));
    assert!(flight.distance(20.0, 0.0) < 0.5);
    assert_eq!(flight.reached(), [2]);
    flight.until_current(3, 1);
    flight.run(5_000);
    assert!((flight.speed() - 3.0).abs() < 0.1, "{}", flight.speed());
    flight.until_end(30);
    assert_eq!(flight.reached(), [3]);
}

#[test]
fn condition_distance_defers_until_near() {
    let mut flight = Flight::flying(&[
        act(MavCmd::CONDITION_DISTANCE, [30.0, 0.0, 0.0, 0.0]),
        speed(2.0),
        waypoint(100.0, 0.0),
        act(MavCmd::CONDITION_DISTANCE, [0.0; 4]),
        waypoint(110.0, 0.0),
    ]);
    flight.until("slow", 30, |vehicle| vehicle.progress().current == 2);
    assert!((flight.distance(100.0, 0.0) - 30.0).abs() < 0.2);
    assert!(flight.speed() > 7.0, "full speed until then");
    flight.run(5_000);
    assert!((flight.speed() - 2.0).abs() < 0.1);
    flight.until_end(60);
    assert_eq!(flight.mission(), (4, MissionState::COMPLETE), "a distance of 0 is met at the end of the leg");
}

/// CONDITION_YAW defers the items after it until the turn is complete. The heading stays for the rest of the leg.
#[test]
fn condition_yaw_defers_until_turned() {
    let mut flight = Flight::flying(&[
        act(MavCmd::CONDITION_YAW, [90.0, 15.0, -1.0, 0.0]),
        speed(3.0),
        waypoint(150.0, 0.0),
        act(MavCmd::CONDITION_YAW, [45.0, 0.0, 1.0, 1.0]),
        waypoint(150.0, 50.0),
    ]);
    flight.run(6_000);
    assert!((flight.heading() - 270.0).abs() < 1.0, "to the left at 15°/s: {}", flight.heading());
    assert!(flight.speed() > 7.0);
    let took = flight.until_current(2, 20);
    assert!((took - 12.0).abs() < 0.1, "270° at 15°/s: {took}");
    flight.run(3_000);
    assert!((flight.heading() - 90.0).abs() < 1.0 && (flight.speed() - 3.0).abs() < 0.1);
    flight.until_current(4, 60);
    assert!((flight.heading() - 135.0).abs() < 1.0, "45° further: {}", flight.heading());
    flight.until_end(30);
    flight.upload(&[act(MavCmd::CONDITION_YAW, [180.0, 5_000.0, 1.0, 1.0])]);
    flight.start(None, None);
    let took = flight.until_end(30);
    assert!((1.5..3.0).contains(&took), "limited by the maximum yaw rate: {took}");
}

/// DO_ items and conditions after the last leg are executed too.
#[test]
fn items_after_the_last_leg_are_executed() {
    let mut flight =
        Flight::flying(&[waypoint(0.0, 0.0), act(MavCmd::CONDITION_DELAY, [5.0, 0.0, 0.0, 0.0]), speed(1.0)]);
    let took = flight.until_end(20);
    assert!((5.0..5.2).contains(&took), "{took}");
    assert_eq!(flight.mission(), (2, MissionState::COMPLETE));
    flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
}

/// On the ground the vehicle cannot turn, so CONDITION_YAW does not wait there.
#[test]
fn conditions_do_not_hang_on_the_ground() {
    let mut flight = Flight::armed();
    flight.upload(&[
        act(MavCmd::CONDITION_YAW, [180.0, 0.0, 0.0, 0.0]),
        act(MavCmd::NAV_DELAY, [2.0, 0.0, 0.0, 0.0]),
        act(MavCmd::CONDITION_DISTANCE, [0.0; 4]),
        act(MavCmd::CONDITION_YAW, [180.0, 0.0, 0.0, 0.0]),
        at(MavCmd::NAV_TAKEOFF, [0.0, 0.0, 0.0, 90.0], 0.0, 0.0, 8.0),
        act(MavCmd::CONDITION_YAW, [180.0, 0.0, 0.0, 0.0]),
        at(MavCmd::NAV_LAND, [0.0, 0.0, 0.0, NAN], 0.0, 0.0, 0.0),
    ]);
    flight.start(None, None);
    flight.until_end(60);
    assert_eq!(flight.reached(), [1, 4, 6]);
    assert_eq!(flight.mission(), (6, MissionState::COMPLETE));
    assert!((flight.heading() - 180.0).abs() < 1.0, "{}", flight.heading());
}
