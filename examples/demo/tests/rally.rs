//! Where the vehicle returns to.

mod support;

use mavstack::dialect::MavCmd;
use mavstack::{Item, PlanType};
use mavstack_demo::Mode;
use support::{Flight, act, at, waypoint};

fn rally(north: f32, east: f32, z: f32) -> Item {
    at(MavCmd::NAV_RALLY_POINT, [0.0; 4], north, east, z)
}

/// Returns, and says where it came down and how high it flew.
fn come_down(flight: &mut Flight) -> (f32, f32, f32) {
    let mut highest: f32 = 0.0;
    while flight.vehicle.is_armed() {
        flight.go_round(10);
        highest = highest.max(flight.height());
        assert!(flight.millis < 300_000, "not down");
    }
    assert!(flight.vehicle.is_landed());
    let here = flight.vehicle.local_position();
    (here.north, here.east, highest)
}

/// In the air, come to rest at a place.
fn resting_at(north: f32, east: f32) -> Flight {
    let mut flight = Flight::flying(&[waypoint(north, east)]);
    flight.until_end(60);
    flight.run(2_000);
    flight
}

/// To the nearest of home and the rally points, by command, by mode and by the plan.
#[test]
fn it_returns_to_the_nearest() {
    let points = [rally(100.0, 0.0, 20.0), rally(0.0, -80.0, 20.0)];
    for (from, to) in [
        ((70.0, 10.0), (100.0, 0.0)),
        ((30.0, 0.0), (0.0, 0.0)),
        ((0.0, -50.0), (0.0, -80.0)),
        ((0.0, 60.0), (0.0, 0.0)),
    ] {
        for how in 0..3 {
            let mut flight = resting_at(from.0, from.1);
            flight.change(PlanType::Rally, &points, 0).unwrap();
            match how {
                0 => drop(flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[])),
                1 => drop(flight.set_mode(Mode::Return)),
                _ => {
                    flight.upload(&[act(MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 4])]);
                    flight.start(None, None);
                }
            }
            let (north, east, _) = come_down(&mut flight);
            assert!((north - to.0).hypot(east - to.1) < 1.5, "{from:?}: {north}, {east}");
        }
    }
}

/// It flies there no lower than 15 m, than where it is, and than the rally point says.
#[test]
fn it_returns_high_enough() {
    for (z, height) in [(5.0, 15.0), (40.0, 40.0)] {
        let mut flight = resting_at(50.0, 0.0);
        flight.change(PlanType::Rally, &[rally(80.0, 0.0, z)], 0).unwrap();
        flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
        let (north, _, highest) = come_down(&mut flight);
        assert!((north - 80.0).abs() < 1.5 && (highest - height).abs() < 1.0, "{z}: {north}, {highest}");
    }
}

/// A rally point that the fence does not allow is none.
#[test]
fn it_does_not_return_to_a_place_outside_the_fence() {
    let mut flight = resting_at(50.0, 0.0);
    flight.change(PlanType::Rally, &[rally(70.0, 0.0, 15.0), rally(30.0, 10.0, 15.0)], 0).unwrap();
    let fence = at(MavCmd::NAV_FENCE_CIRCLE_INCLUSION, [60.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0);
    flight.change(PlanType::Fence, &[fence], 0).unwrap();
    flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
    let (north, east, _) = come_down(&mut flight);
    assert!((north - 30.0).hypot(east - 10.0) < 1.5, "{north}, {east}");
}

/// Once it is on its way it does not turn round for a point that is nearer.
#[test]
fn on_its_way_it_keeps_its_goal() {
    let mut flight = resting_at(60.0, 0.0);
    flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
    flight.run(5_000);
    flight.change(PlanType::Rally, &[rally(60.0, 0.0, 15.0)], 0).unwrap();
    let (north, east, _) = come_down(&mut flight);
    assert!(north.hypot(east) < 1.5, "{north}, {east}");
}
