//! Return destinations: home and rally points.

use crate::support::{Flight, act, at, waypoint};
use mavstack::dialect::MavCmd;
use mavstack::{Item, PlanType};
use mavstack_demo::Mode;

fn rally(north: f32, east: f32, z: f32) -> Item {
    at(MavCmd::NAV_RALLY_POINT, [0.0; 4], north, east, z)
}

/// Runs until the vehicle has landed. Returns its position and the maximum height (m).
fn finish_return(flight: &mut Flight) -> (f32, f32, f32) {
    let mut highest: f32 = 0.0;
    while flight.vehicle.is_armed() {
        flight.step(10);
        highest = highest.max(flight.height());
        assert!(flight.millis < 300_000, "not landed");
    }
    assert!(flight.vehicle.is_landed());
    let here = flight.vehicle.local_position();
    (here.north, here.east, highest)
}

/// Returns a vehicle that hovers at a position.
fn hovering_at(north: f32, east: f32) -> Flight {
    let mut flight = Flight::flying(&[waypoint(north, east)]);
    flight.until_end(60);
    flight.run(2_000);
    flight
}

/// A return goes to home or a rally point, whichever is nearest: by command, by mode and by mission item.
#[test]
fn returns_to_the_nearest_point() {
    let points = [rally(100.0, 0.0, 20.0), rally(0.0, -80.0, 20.0)];
    for (from, to) in [
        ((70.0, 10.0), (100.0, 0.0)),
        ((30.0, 0.0), (0.0, 0.0)),
        ((0.0, -50.0), (0.0, -80.0)),
        ((0.0, 60.0), (0.0, 0.0)),
    ] {
        for how in 0..3 {
            let mut flight = hovering_at(from.0, from.1);
            flight.change(PlanType::Rally, &points, 0).unwrap();
            match how {
                0 => drop(flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[])),
                1 => drop(flight.set_mode(Mode::Return)),
                _ => {
                    flight.upload(&[act(MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 4])]);
                    flight.start(None, None);
                }
            }
            let (north, east, _) = finish_return(&mut flight);
            assert!((north - to.0).hypot(east - to.1) < 1.5, "{from:?}: {north}, {east}");
        }
    }
}

/// The return is not lower than 15 m, the vehicle's height, and the rally point's altitude.
#[test]
fn return_height_has_a_minimum() {
    for (z, height) in [(5.0, 15.0), (40.0, 40.0)] {
        let mut flight = hovering_at(50.0, 0.0);
        flight.change(PlanType::Rally, &[rally(80.0, 0.0, z)], 0).unwrap();
        flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
        let (north, _, highest) = finish_return(&mut flight);
        assert!((north - 80.0).abs() < 1.5 && (highest - height).abs() < 1.0, "{z}: {north}, {highest}");
    }
}

/// Rally points outside the fence are ignored.
#[test]
fn rally_points_outside_the_fence_are_ignored() {
    let mut flight = hovering_at(50.0, 0.0);
    flight.change(PlanType::Rally, &[rally(70.0, 0.0, 15.0), rally(30.0, 10.0, 15.0)], 0).unwrap();
    let fence = at(MavCmd::NAV_FENCE_CIRCLE_INCLUSION, [60.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0);
    flight.change(PlanType::Fence, &[fence], 0).unwrap();
    flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
    let (north, east, _) = finish_return(&mut flight);
    assert!((north - 30.0).hypot(east - 10.0) < 1.5, "{north}, {east}");
}

/// A return keeps its destination when a nearer rally point is added.
#[test]
fn a_return_keeps_its_destination() {
    let mut flight = hovering_at(60.0, 0.0);
    flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, &[]);
    flight.run(5_000);
    flight.change(PlanType::Rally, &[rally(60.0, 0.0, 15.0)], 0).unwrap();
    let (north, east, _) = finish_return(&mut flight);
    assert!(north.hypot(east) < 1.5, "{north}, {east}");
}
