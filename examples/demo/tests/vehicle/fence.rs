//! Fences: where the vehicle stops, and how it may continue.

use crate::support::{Flight, act, at, waypoint};
use mavstack::dialect::{MavCmd, MavMissionResult, MavResult, MissionState};
use mavstack::plan::PlanFault;
use mavstack::{Item, PlanType};
use mavstack_demo::Mode;

/// An area of a fence, in metres from home.
#[derive(Clone, Debug)]
enum Area {
    Polygon(Vec<(f32, f32)>),
    Circle(f32, f32, f32),
}

impl Area {
    fn square(north: f32, east: f32, half: f32) -> Self {
        Self::Polygon(
            [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
                .map(|(n, e)| (north + n * half, east + e * half))
                .to_vec(),
        )
    }

    fn items(&self, is_inclusion: bool, group: u8) -> Vec<Item> {
        let group = f32::from(group);
        match self {
            Self::Polygon(corners) => {
                let command = if is_inclusion {
                    MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION
                } else {
                    MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION
                };
                corners.iter().map(|&(n, e)| at(command, [corners.len() as f32, group, 0.0, 0.0], n, e, 0.0)).collect()
            }
            Self::Circle(north, east, radius) => {
                let command =
                    if is_inclusion { MavCmd::NAV_FENCE_CIRCLE_INCLUSION } else { MavCmd::NAV_FENCE_CIRCLE_EXCLUSION };
                vec![at(command, [*radius, group, 0.0, 0.0], *north, *east, 0.0)]
            }
        }
    }

    /// Uses the winding number: the angles between the corners, seen from inside, add up to a full turn.
    fn contains(&self, north: f32, east: f32) -> bool {
        match self {
            Self::Circle(n, e, radius) => (north - n).hypot(east - e) <= *radius,
            Self::Polygon(corners) => {
                let angle = |(n, e): (f32, f32)| f64::from(e - east).atan2(f64::from(n - north));
                let turn: f64 = (0..corners.len())
                    .map(|i| angle(corners[i]) - angle(corners[(i + 1) % corners.len()]))
                    .map(|turn| (turn + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI)
                    .sum();
                turn.abs() > 3.0
            }
        }
    }
}

/// Returns a vehicle in the air at home, with this fence.
fn within(fence: &[Item]) -> Flight {
    let mut flight = Flight::airborne();
    flight.change(PlanType::Fence, fence, 0).unwrap();
    flight
}

/// Flies the mission and asserts that the vehicle stops just before the border of `area`.
fn assert_stops_at_fence(flight: &mut Flight, area: &Area, is_inclusion: bool, what: &str) {
    assert_eq!(flight.start(None, None), MavResult::ACCEPTED);
    flight.run(10);
    let deadline = flight.millis + 60_000;
    let mut course = (0.0, 0.0);
    while flight.vehicle.mode() == Mode::Mission || flight.speed() > 0.01 {
        flight.step(10);
        let (here, speed) = (flight.vehicle.local_position(), flight.speed());
        assert_eq!(area.contains(here.north, here.east), is_inclusion, "{what}: beyond the fence at {here:?}");
        assert!(flight.millis < deadline, "{what}: does not stop");
        if speed > 0.5 {
            course = (flight.vehicle.velocity().north / speed, flight.vehicle.velocity().east / speed);
        }
    }
    assert_eq!(flight.texts(), ["Holding at the fence"], "{what}");
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((1, MissionState::PAUSED), Mode::Hold), "{what}");
    let here = flight.vehicle.local_position();
    // Search ahead in steps of 0.1 m: the border must be about half a metre away.
    let is_beyond = |step: u8| {
        let metres = f32::from(step) / 10.0;
        area.contains(here.north + course.0 * metres, here.east + course.1 * metres) != is_inclusion
    };
    let border = (0..=50).find(|&step| is_beyond(step));
    assert!(matches!(border, Some(5..=7)), "{what}: stops {border:?} dm before the fence, at {here:?}");
}

fn fly_to(north: f32, east: f32, speed: f32) -> [Item; 2] {
    [act(MavCmd::DO_CHANGE_SPEED, [1.0, speed, -1.0, 0.0]), waypoint(north, east)]
}

fn directions(count: u8) -> impl Iterator<Item = (f32, f32)> {
    (0..count).map(move |i| (f32::from(i) / f32::from(count) * std::f32::consts::TAU).sin_cos()).map(|(e, n)| (n, e))
}

/// Areas around home, approached from inside in many directions, including corners.
#[test]
fn stops_inside_inclusion_areas() {
    let concave = [(30.0, -30.0), (30.0, 40.0), (10.0, 8.0), (-40.0, 25.0), (-10.0, -20.0)];
    for area in [Area::square(0.0, 0.0, 25.0), Area::Circle(5.0, -5.0, 30.0), Area::Polygon(concave.to_vec())] {
        for speed in [2.0, 8.0, 20.0] {
            for (north, east) in directions(16) {
                let mut flight = within(&area.items(true, 0));
                flight.upload(&fly_to(200.0 * north, 200.0 * east, speed));
                assert_stops_at_fence(&mut flight, &area, true, &format!("{area:?} at {speed} m/s to {north}, {east}"));
            }
        }
    }
}

/// Areas in the path, approached from outside in many directions. One is a wall as thin as the length of a step.
#[test]
fn stops_outside_exclusion_areas() {
    let wall = [(59.9, -40.0), (59.9, 40.0), (60.1, 40.0), (60.1, -40.0)];
    let turn = |(north, east): (f32, f32), by: (f32, f32)| (north * by.0 - east * by.1, north * by.1 + east * by.0);
    for speed in [2.0, 8.0, 20.0] {
        for by in directions(16) {
            let (north, east) = turn((60.0, 0.0), by);
            for area in [
                Area::square(north, east, 12.0),
                Area::Circle(north, east, 15.0),
                Area::Polygon(wall.map(|corner| turn(corner, by)).to_vec()),
            ] {
                let mut flight = within(&area.items(false, 0));
                flight.upload(&fly_to(2.0 * north, 2.0 * east, speed));
                assert_stops_at_fence(&mut flight, &area, false, &format!("{area:?} at {speed} m/s"));
            }
        }
    }
}

/// At the fence every attempt to fly further out is stopped, with one text each and without creeping forward. A return is
/// allowed.
#[test]
fn repeated_attempts_are_stopped_at_the_fence() {
    for (area, is_inclusion) in [
        (Area::square(0.0, 0.0, 25.0), true),
        (Area::Circle(0.0, 0.0, 25.0), true),
        (Area::square(40.0, 0.0, 10.0), false),
        (Area::Circle(40.0, 0.0, 10.0), false),
    ] {
        let mut flight = within(&area.items(is_inclusion, 0));
        flight.upload(&fly_to(90.0, 0.0, 8.0));
        assert_stops_at_fence(&mut flight, &area, is_inclusion, "first");
        let held = flight.vehicle.local_position();
        for _ in 0..20 {
            flight.start(None, None);
            flight.run(3_000);
            assert_eq!(flight.texts(), ["Holding at the fence"]);
            assert_eq!(flight.vehicle.mode(), Mode::Hold);
            // A landing and a takeoff beyond the fence, which begin with a flight there.
            for command in [MavCmd::NAV_LAND, MavCmd::NAV_TAKEOFF] {
                let [degrees, longitude] = [47.400_45, 8.545_594];
                assert_eq!(
                    flight.command(command, &[0.0, 0.0, 0.0, 0.0, degrees, longitude, 10.0]),
                    MavResult::ACCEPTED
                );
                flight.run(3_000);
                assert_eq!(flight.texts(), ["Holding at the fence"], "{command:?}");
            }
        }
        assert!(flight.distance(held.north, held.east) < 0.1, "{:?}", flight.vehicle.local_position());
        flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
        flight.until("home", 60, |vehicle| !vehicle.is_armed());
        assert!(flight.distance(0.0, 0.0) < 1.5);
        assert_eq!(flight.texts(), ["Landed, disarmed"]);
    }
}

/// Near the fence the vehicle may climb, descend and fly along it.
#[test]
fn flies_freely_along_the_fence() {
    let area = Area::Polygon(vec![(-0.8, -50.0), (-0.8, 50.0), (30.0, 50.0), (30.0, -50.0)]);
    let mut flight = Flight::armed();
    flight.change(PlanType::Fence, &area.items(true, 0), 0).unwrap();
    flight.command(MavCmd::NAV_TAKEOFF, &[]);
    flight.until("up", 10, |vehicle| vehicle.mode() == Mode::Hold);
    flight.upload(&[waypoint(0.0, 40.0), waypoint(0.0, -40.0), waypoint(27.0, -47.0), waypoint(0.0, 0.0)]);
    flight.start(None, None);
    flight.until_end(90);
    assert_eq!(flight.reached(), [0, 1, 2, 3]);
    flight.command(MavCmd::NAV_LAND, &[]);
    flight.until("down", 60, |vehicle| !vehicle.is_armed());
    assert_eq!(flight.texts(), ["Mission complete", "Landed, disarmed"]);
}

/// With one group the vehicle stays inside all areas, as with PX4 and ArduPilot. With several groups one is enough, and the
/// vehicle passes between them where they overlap.
#[test]
fn inclusion_groups() {
    let (west, east) = (Area::square(0.0, -20.0, 40.0), Area::Circle(0.0, 30.0, 40.0));
    let fence = |groups: [u8; 2]| [west.items(true, groups[0]), east.items(true, groups[1])].concat();
    let mut flight = within(&fence([0, 0]));
    flight.upload(&fly_to(0.0, 60.0, 8.0));
    assert_stops_at_fence(&mut flight, &west, true, "one group");
    let mut flight = within(&fence([3, 31]));
    flight.upload(&fly_to(0.0, 60.0, 3.0));
    flight.start(None, None);
    flight.until_end(60);
    assert_eq!(flight.texts(), ["Mission complete"]);
    assert!(flight.distance(0.0, 60.0) < 3.0);
    flight.upload(&fly_to(0.0, 120.0, 3.0));
    assert_stops_at_fence(&mut flight, &east, true, "two groups");
    // Group 32 is not supported.
    let fault = MavMissionResult::INVALID_PARAM2.into();
    assert_eq!(flight.change(PlanType::Fence, &fence([0, 32]), 0), Err(fault));
}

/// Exclusion areas apply to every group. All kinds of areas may be combined.
#[test]
fn areas_of_all_kinds_combined() {
    let limit = Area::Circle(0.0, 0.0, 80.0);
    let exclusions = [Area::square(40.0, 0.0, 10.0), Area::Circle(0.0, 40.0, 10.0)];
    let return_point = at(MavCmd::NAV_FENCE_RETURN_POINT, [0.0; 4], 0.0, 0.0, 20.0);
    let fence =
        [vec![return_point], exclusions[0].items(false, 0), limit.items(true, 1), exclusions[1].items(false, 0)]
            .concat();
    for (to, area, is_inclusion) in
        [((60.0, 0.0), &exclusions[0], false), ((0.0, 60.0), &exclusions[1], false), ((-90.0, 0.0), &limit, true)]
    {
        let mut flight = within(&fence);
        flight.upload(&fly_to(to.0, to.1, 8.0));
        assert_stops_at_fence(&mut flight, area, is_inclusion, &format!("{to:?}"));
    }
    let mut flight = within(&fence);
    flight.upload(&[waypoint(60.0, -30.0), waypoint(60.0, 40.0), waypoint(25.0, 25.0), waypoint(0.0, 0.0)]);
    flight.start(None, None);
    flight.until_end(90);
    assert_eq!(flight.reached(), [0, 1, 2, 3], "a path around the areas exists");
}

/// M-82: while armed, a fence that excludes the vehicle is refused, and so is one within which it could not stop.
#[test]
fn an_immediately_breached_fence_is_refused_while_armed() {
    let denied = || Err(PlanFault::from(MavMissionResult::DENIED));
    let mut flight = Flight::flying(&[waypoint(0.0, 90.0)]);
    flight.until("fast", 20, |vehicle| vehicle.velocity().east > 7.5);
    let here = flight.vehicle.local_position();
    for (area, is_inclusion, is_accepted) in [
        (Area::square(-200.0, 0.0, 50.0), true, false),
        (Area::square(here.north, here.east, 30.0), false, false),
        (Area::Circle(here.north, here.east, 7.0), true, false),
        (Area::Circle(here.north, here.east + 5.0, 1.0), false, false),
        (Area::Circle(here.north, here.east, 15.0), true, true),
        (Area::Circle(here.north, here.east - 5.0, 1.0), false, true),
    ] {
        let result = flight.change(PlanType::Fence, &area.items(is_inclusion, 0), 0);
        assert_eq!(result, if is_accepted { Ok(()) } else { denied() }, "{area:?}");
        let text = ["Fence refused: the vehicle is outside it"];
        assert_eq!(flight.texts(), if is_accepted { &[][..] } else { &text }, "{area:?}");
    }
    assert_eq!(flight.change(PlanType::Fence, &[], 0), Ok(()), "without a fence there is no breach");
}

/// While disarmed any fence is accepted. Outside the fence arming needs force.
#[test]
fn arming_outside_the_fence_needs_force() {
    let mut flight = Flight::new();
    flight.change(PlanType::Fence, &Area::square(500.0, 0.0, 50.0).items(true, 0), 0).unwrap();
    flight.run(2_500);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(flight.texts(), ["Arming refused: outside the fence"]);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0, 21_196.0]), MavResult::ACCEPTED);
    flight.command(MavCmd::NAV_TAKEOFF, &[]);
    flight.run(5_000);
    assert_eq!(flight.texts(), ["Holding: outside the fence"]);
    assert!(flight.vehicle.is_landed());
    flight.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0]);
    flight.change(PlanType::Fence, &[], 0).unwrap();
    flight.run(100);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
}

/// A fence becomes live only when it is stored. If the vehicle has left its area by then, the vehicle holds, and may return
/// or land.
#[test]
fn a_late_fence_stops_the_vehicle() {
    let fence = Area::Circle(0.0, 0.0, 20.0).items(true, 0);
    for command in [MavCmd::NAV_RETURN_TO_LAUNCH, MavCmd::NAV_LAND] {
        let mut flight = Flight::flying(&[waypoint(90.0, 0.0)]);
        flight.until("beyond", 20, |vehicle| vehicle.local_position().north > 25.0);
        flight.go_live(PlanType::Fence, &fence);
        flight.run(5_000);
        assert_eq!((flight.vehicle.mode(), flight.mission().1), (Mode::Hold, MissionState::PAUSED));
        assert!(flight.speed() < 0.1);
        flight.start(None, None);
        flight.run(1_000);
        assert_eq!(flight.texts(), ["Holding: outside the fence"; 2]);
        let at = flight.vehicle.local_position();
        flight.command(command, &[]);
        flight.until("down", 60, |vehicle| !vehicle.is_armed());
        let is_home = command == MavCmd::NAV_RETURN_TO_LAUNCH;
        assert!(if is_home { flight.distance(0.0, 0.0) } else { flight.distance(at.north, at.east) } < 1.5);
        assert_eq!(flight.texts(), ["Landed, disarmed"]);
    }
}

/// After the fence is cleared the mission continues.
#[test]
fn a_cleared_fence_stops_nothing() {
    let area = Area::square(0.0, 0.0, 25.0);
    let mut flight = within(&area.items(true, 0));
    flight.upload(&fly_to(60.0, 0.0, 8.0));
    assert_stops_at_fence(&mut flight, &area, true, "fenced");
    flight.change(PlanType::Fence, &[], 0).unwrap();
    flight.start(None, None);
    flight.until_end(30);
    assert_eq!(flight.texts(), ["Mission complete"]);
}
