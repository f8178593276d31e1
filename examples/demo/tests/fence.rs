//! Fences: where the vehicle stops, and what it may do there.

mod support;

use mavstack::dialect::{MavCmd, MavMissionResult, MavResult, MissionState};
use mavstack::{Item, PlanFault, PlanType};
use mavstack_demo::Mode;
use support::{Flight, act, at, waypoint};

/// An area of a fence, m from home.
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

    /// By the angles under which the corners are seen, which add up to a full turn from inside.
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

/// In the air at home, with this fence.
fn within(fence: &[Item]) -> Flight {
    let mut flight = Flight::airborne();
    flight.change(PlanType::Fence, fence, 0).unwrap();
    flight
}

/// Flies to a place at some speed until it stops by itself, before the border of `area` and not long before.
fn is_held(flight: &mut Flight, area: &Area, is_inclusion: bool, what: &str) {
    assert_eq!(flight.start(None, None), MavResult::ACCEPTED);
    flight.run(10);
    let deadline = flight.millis + 60_000;
    let mut course = (0.0, 0.0);
    while flight.vehicle.mode() == Mode::Mission || flight.speed() > 0.01 {
        flight.go_round(10);
        let (here, speed) = (flight.vehicle.local_position(), flight.speed());
        assert_eq!(area.contains(here.north, here.east), is_inclusion, "{what}: beyond it at {here:?}");
        assert!(flight.millis < deadline, "{what}: goes on");
        if speed > 0.5 {
            course = (flight.vehicle.velocity().north / speed, flight.vehicle.velocity().east / speed);
        }
    }
    assert_eq!(flight.said(), ["Holding at the fence"], "{what}");
    assert_eq!((flight.mission(), flight.vehicle.mode()), ((1, MissionState::PAUSED), Mode::Hold), "{what}");
    let here = flight.vehicle.local_position();
    // Walking on in steps of a decimetre: the border comes after half a metre.
    let is_beyond = |step: u8| {
        let metres = f32::from(step) / 10.0;
        area.contains(here.north + course.0 * metres, here.east + course.1 * metres) != is_inclusion
    };
    let border = (0..=50).find(|&step| is_beyond(step));
    assert!(matches!(border, Some(5..=7)), "{what}: stops {border:?} dm before it, at {here:?}");
}

fn fly_to(north: f32, east: f32, speed: f32) -> [Item; 2] {
    [act(MavCmd::DO_CHANGE_SPEED, [1.0, speed, -1.0, 0.0]), waypoint(north, east)]
}

fn directions(count: u8) -> impl Iterator<Item = (f32, f32)> {
    (0..count).map(move |i| (f32::from(i) / f32::from(count) * std::f32::consts::TAU).sin_cos()).map(|(e, n)| (n, e))
}

/// Areas around home, approached from inside in many directions, also into their corners.
#[test]
fn it_stops_inside_inclusion_areas() {
    let concave = [(30.0, -30.0), (30.0, 40.0), (10.0, 8.0), (-40.0, 25.0), (-10.0, -20.0)];
    for area in [Area::square(0.0, 0.0, 25.0), Area::Circle(5.0, -5.0, 30.0), Area::Polygon(concave.to_vec())] {
        for speed in [2.0, 8.0, 20.0] {
            for (north, east) in directions(16) {
                let mut flight = within(&area.items(true, 0));
                flight.upload(&fly_to(200.0 * north, 200.0 * east, speed));
                is_held(&mut flight, &area, true, &format!("{area:?} at {speed} m/s to {north}, {east}"));
            }
        }
    }
}

/// Areas in the way, approached from outside in many directions; one is a wall as thin as a step is long.
#[test]
fn it_stops_outside_exclusion_areas() {
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
                is_held(&mut flight, &area, false, &format!("{area:?} at {speed} m/s"));
            }
        }
    }
}

/// Held at the fence it is held again, each time with one text and without creeping nearer; home it may fly.
#[test]
fn what_leads_further_out_is_held_again() {
    for (area, is_inclusion) in [
        (Area::square(0.0, 0.0, 25.0), true),
        (Area::Circle(0.0, 0.0, 25.0), true),
        (Area::square(40.0, 0.0, 10.0), false),
        (Area::Circle(40.0, 0.0, 10.0), false),
    ] {
        let mut flight = within(&area.items(is_inclusion, 0));
        flight.upload(&fly_to(90.0, 0.0, 8.0));
        is_held(&mut flight, &area, is_inclusion, "first");
        let held = flight.vehicle.local_position();
        for _ in 0..20 {
            flight.start(None, None);
            flight.run(3_000);
            assert_eq!(flight.said(), ["Holding at the fence"]);
            assert_eq!(flight.vehicle.mode(), Mode::Hold);
            // A landing and a take-off there, which begin with a flight.
            for command in [MavCmd::NAV_LAND, MavCmd::NAV_TAKEOFF] {
                let [degrees, longitude] = [47.400_45, 8.545_594];
                assert_eq!(
                    flight.command(command, &[0.0, 0.0, 0.0, 0.0, degrees, longitude, 10.0]),
                    MavResult::ACCEPTED
                );
                flight.run(3_000);
                assert_eq!(flight.said(), ["Holding at the fence"], "{command:?}");
            }
        }
        assert!(flight.distance(held.north, held.east) < 0.1, "{:?}", flight.vehicle.local_position());
        flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
        flight.until("home", 60, |vehicle| !vehicle.is_armed());
        assert!(flight.distance(0.0, 0.0) < 1.5);
        assert_eq!(flight.said(), ["Landed, disarmed"]);
    }
}

/// Up and down it may go where it is, and along the fence.
#[test]
fn near_the_fence_it_flies_freely() {
    let area = Area::Polygon(vec![(-0.8, -50.0), (-0.8, 50.0), (30.0, 50.0), (30.0, -50.0)]);
    let mut flight = Flight::ready();
    flight.change(PlanType::Fence, &area.items(true, 0), 0).unwrap();
    flight.command(MavCmd::NAV_TAKEOFF, &[]);
    flight.until("up", 10, |vehicle| vehicle.mode() == Mode::Hold);
    flight.upload(&[waypoint(0.0, 40.0), waypoint(0.0, -40.0), waypoint(27.0, -47.0), waypoint(0.0, 0.0)]);
    flight.start(None, None);
    flight.until_end(90);
    assert_eq!(flight.reached(), [0, 1, 2, 3]);
    flight.command(MavCmd::NAV_LAND, &[]);
    flight.until("down", 60, |vehicle| !vehicle.is_armed());
    assert_eq!(flight.said(), ["Mission complete", "Landed, disarmed"]);
}

/// In one group the vehicle stays inside all areas, as with PX4 and ArduPilot; of several groups one is enough, and it
/// passes from one to the other where they overlap.
#[test]
fn inclusion_groups() {
    let (west, east) = (Area::square(0.0, -20.0, 40.0), Area::Circle(0.0, 30.0, 40.0));
    let fence = |groups: [u8; 2]| [west.items(true, groups[0]), east.items(true, groups[1])].concat();
    let mut flight = within(&fence([0, 0]));
    flight.upload(&fly_to(0.0, 60.0, 8.0));
    is_held(&mut flight, &west, true, "one group");
    let mut flight = within(&fence([3, 31]));
    flight.upload(&fly_to(0.0, 60.0, 3.0));
    flight.start(None, None);
    flight.until_end(60);
    assert_eq!((flight.said(), flight.distance(0.0, 60.0) < 3.0), (vec!["Mission complete"], true));
    flight.upload(&fly_to(0.0, 120.0, 3.0));
    is_held(&mut flight, &east, true, "two groups");
    // Too many of them for the vehicle.
    let fault = MavMissionResult::INVALID_PARAM2.into();
    assert_eq!(flight.change(PlanType::Fence, &fence([0, 32]), 0), Err(fault));
}

/// Exclusions count in every group, and several areas together.
#[test]
fn areas_of_all_kinds_together() {
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
        is_held(&mut flight, area, is_inclusion, &format!("{to:?}"));
    }
    let mut flight = within(&fence);
    flight.upload(&[waypoint(60.0, -30.0), waypoint(60.0, 40.0), waypoint(25.0, 25.0), waypoint(0.0, 0.0)]);
    flight.start(None, None);
    flight.until_end(90);
    assert_eq!(flight.reached(), [0, 1, 2, 3], "there is a way round");
}

/// M-82: armed, a fence that it is outside of is refused, and one that it could not stop inside of.
#[test]
fn a_fence_that_is_breached_at_once_is_refused_while_armed() {
    let denied = || Err(PlanFault::from(MavMissionResult::DENIED));
    let mut flight = Flight::flying(&[waypoint(0.0, 90.0)]);
    flight.until("fast", 20, |vehicle| vehicle.velocity().east > 7.5);
    let here = flight.vehicle.local_position();
    for (area, is_inclusion, is_taken) in [
        (Area::square(-200.0, 0.0, 50.0), true, false),
        (Area::square(here.north, here.east, 30.0), false, false),
        (Area::Circle(here.north, here.east, 7.0), true, false),
        (Area::Circle(here.north, here.east + 5.0, 1.0), false, false),
        (Area::Circle(here.north, here.east, 15.0), true, true),
        (Area::Circle(here.north, here.east - 5.0, 1.0), false, true),
    ] {
        let result = flight.change(PlanType::Fence, &area.items(is_inclusion, 0), 0);
        assert_eq!(result, if is_taken { Ok(()) } else { denied() }, "{area:?}");
        let text = ["Fence refused: the vehicle is outside of it"];
        assert_eq!(flight.said(), if is_taken { &[][..] } else { &text }, "{area:?}");
    }
    assert_eq!(flight.change(PlanType::Fence, &[], 0), Ok(()), "no fence is no breach");
}

/// Disarmed any fence is taken; outside of it the vehicle does not arm, but by force.
#[test]
fn outside_its_fence_it_does_not_arm() {
    let mut flight = Flight::new();
    flight.change(PlanType::Fence, &Area::square(500.0, 0.0, 50.0).items(true, 0), 0).unwrap();
    flight.run(2_500);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(flight.said(), ["Arming refused: outside the fence"]);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0, 21_196.0]), MavResult::ACCEPTED);
    flight.command(MavCmd::NAV_TAKEOFF, &[]);
    flight.run(5_000);
    assert_eq!(flight.said(), ["Holding: outside the fence"]);
    assert!(flight.vehicle.is_landed());
    flight.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0]);
    flight.change(PlanType::Fence, &[], 0).unwrap();
    flight.run(100);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
}

/// A fence that was taken when the vehicle was inside goes live when its storage is done, and by then the vehicle may have
/// left: it holds, and may come back and come down.
#[test]
fn a_fence_that_came_late_stops_the_vehicle() {
    let fence = Area::Circle(0.0, 0.0, 20.0).items(true, 0);
    for command in [MavCmd::NAV_RETURN_TO_LAUNCH, MavCmd::NAV_LAND] {
        let mut flight = Flight::flying(&[waypoint(90.0, 0.0)]);
        flight.until("beyond", 20, |vehicle| vehicle.local_position().north > 25.0);
        flight.fence = fence.clone();
        flight.run(5_000);
        assert_eq!((flight.vehicle.mode(), flight.mission().1), (Mode::Hold, MissionState::PAUSED));
        assert!(flight.speed() < 0.1);
        flight.start(None, None);
        flight.run(1_000);
        assert_eq!(flight.said(), ["Holding: outside the fence"; 2]);
        let at = flight.vehicle.local_position();
        flight.command(command, &[]);
        flight.until("down", 60, |vehicle| !vehicle.is_armed());
        let is_home = command == MavCmd::NAV_RETURN_TO_LAUNCH;
        assert!(if is_home { flight.distance(0.0, 0.0) } else { flight.distance(at.north, at.east) } < 1.5);
        assert_eq!(flight.said(), ["Landed, disarmed"]);
    }
}

/// Without its fence it flies on.
#[test]
fn a_fence_that_is_cleared_holds_nothing() {
    let area = Area::square(0.0, 0.0, 25.0);
    let mut flight = within(&area.items(true, 0));
    flight.upload(&fly_to(60.0, 0.0, 8.0));
    is_held(&mut flight, &area, true, "fenced");
    flight.change(PlanType::Fence, &[], 0).unwrap();
    flight.start(None, None);
    flight.until_end(30);
    assert_eq!(flight.said(), ["Mission complete"]);
}
