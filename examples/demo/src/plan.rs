//! The mission items that the vehicle can fly.
//!
//! Parameter 4 (yaw) is not followed: the nose points along the course.

use mavstack::Item;
use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult};

use crate::body::Vector;
use crate::geo::Home;

/// Cruise speed, m/s.
pub const CRUISE: f32 = 8.0;
/// A waypoint counts as reached within so many metres, unless it says otherwise.
const RADIUS: f32 = 2.0;

/// Something to fly, with an end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Maneuver {
    /// Stay there; at once done.
    Stay(Vector),
    /// Fly there and come within so many metres.
    Reach { to: Vector, radius: f32 },
    /// Straight up or down first, then there.
    Climb(Vector),
    /// Fly there at this height, go down, touch down.
    Land(Vector),
    /// Fly home, not too low, and land.
    Return,
}

/// What an item asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// A maneuver, and how long to stay when it is done (s).
    Fly(Maneuver, f32),
    /// Another cruise speed (m/s).
    Speed(f32),
    /// Nothing that this vehicle knows; [`check`] lets none of it in.
    Unknown,
}

/// Whether the vehicle can fly `item`.
pub fn check(item: &Item) -> Result<(), MavMissionResult> {
    let [p1, p2, ..] = item.params;
    let is_global = matches!(
        item.frame,
        MavFrame::GLOBAL | MavFrame::GLOBAL_INT | MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT
    );
    match item.command {
        MavCmd::NAV_WAYPOINT | MavCmd::NAV_LOITER_TIME | MavCmd::NAV_TAKEOFF | MavCmd::NAV_LAND if !is_global => {
            Err(MavMissionResult::UNSUPPORTED_FRAME)
        }
        MavCmd::NAV_WAYPOINT | MavCmd::NAV_LOITER_TIME if p1.is_infinite() || p1 < 0.0 => {
            Err(MavMissionResult::INVALID_PARAM1)
        }
        MavCmd::NAV_WAYPOINT if p2.is_infinite() || p2 < 0.0 => Err(MavMissionResult::INVALID_PARAM2),
        MavCmd::NAV_WAYPOINT if item.x == i32::MAX => Err(MavMissionResult::INVALID_PARAM5_X),
        MavCmd::NAV_WAYPOINT if item.y == i32::MAX => Err(MavMissionResult::INVALID_PARAM6_Y),
        MavCmd::NAV_WAYPOINT | MavCmd::NAV_LOITER_TIME | MavCmd::NAV_TAKEOFF if !item.z.is_finite() => {
            Err(MavMissionResult::INVALID_PARAM7)
        }
        // -1 keeps the speed, -2 is the default.
        MavCmd::DO_CHANGE_SPEED if !(p2.is_finite() && p2 > 0.0 || p2 == -1.0 || p2 == -2.0) => {
            Err(MavMissionResult::INVALID_PARAM2)
        }
        MavCmd::NAV_WAYPOINT
        | MavCmd::NAV_LOITER_TIME
        | MavCmd::NAV_TAKEOFF
        | MavCmd::NAV_LAND
        | MavCmd::NAV_RETURN_TO_LAUNCH
        | MavCmd::DO_CHANGE_SPEED => Ok(()),
        _ => Err(MavMissionResult::UNSUPPORTED),
    }
}

/// What `item` asks of a vehicle that is at `position` and flies at `speed` m/s.
pub fn order(home: Home, item: &Item, position: Vector, speed: f32) -> Order {
    let [p1, p2, ..] = item.params;
    let height = home.to_height(item.frame, item.z);
    let place = if item.x == i32::MAX || item.y == i32::MAX { None } else { Some(home.to_local(item.x, item.y)) };
    let (north, east) = place.unwrap_or((position.north, position.east));
    let to = Vector { north, east, down: height.map_or(position.down, |height| -height) };
    let hold = if p1 > 0.0 { p1 } else { 0.0 };
    match item.command {
        MavCmd::NAV_WAYPOINT => Order::Fly(Maneuver::Reach { to, radius: if p2 > 0.0 { p2 } else { RADIUS } }, hold),
        MavCmd::NAV_LOITER_TIME => Order::Fly(Maneuver::Reach { to, radius: RADIUS }, hold),
        MavCmd::NAV_TAKEOFF => Order::Fly(Maneuver::Climb(to), 0.0),
        MavCmd::NAV_LAND => Order::Fly(Maneuver::Land(Vector { down: position.down, ..to }), 0.0),
        MavCmd::NAV_RETURN_TO_LAUNCH => Order::Fly(Maneuver::Return, 0.0),
        MavCmd::DO_CHANGE_SPEED if p2 > 0.0 => Order::Speed(p2),
        MavCmd::DO_CHANGE_SPEED if p2 == -2.0 => Order::Speed(CRUISE),
        MavCmd::DO_CHANGE_SPEED => Order::Speed(speed),
        _ => Order::Unknown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn item(command: MavCmd) -> Item {
        let Home { latitude, longitude, .. } = Home::DEMO;
        Item {
            frame: MavFrame::GLOBAL_RELATIVE_ALT,
            command,
            autocontinue: 1,
            params: [0.0; 4],
            x: latitude,
            y: longitude,
            z: 10.0,
        }
    }

    /// M-73: what it cannot fly is refused, each with the code that names the reason.
    #[test]
    fn what_it_cannot_fly_is_refused() {
        use MavMissionResult as R;
        let waypoint = item(MavCmd::NAV_WAYPOINT);
        let table = [
            (item(MavCmd::NAV_SPLINE_WAYPOINT), R::UNSUPPORTED),
            (item(MavCmd::DO_JUMP), R::UNSUPPORTED),
            (Item { frame: MavFrame::LOCAL_NED, ..waypoint }, R::UNSUPPORTED_FRAME),
            (Item { frame: MavFrame::GLOBAL_TERRAIN_ALT, ..item(MavCmd::NAV_LAND) }, R::UNSUPPORTED_FRAME),
            (Item { params: [-1.0, 0.0, 0.0, 0.0], ..waypoint }, R::INVALID_PARAM1),
            (Item { params: [0.0, f32::INFINITY, 0.0, 0.0], ..waypoint }, R::INVALID_PARAM2),
            (Item { x: i32::MAX, ..waypoint }, R::INVALID_PARAM5_X),
            (Item { y: i32::MAX, ..waypoint }, R::INVALID_PARAM6_Y),
            (Item { z: f32::NAN, ..waypoint }, R::INVALID_PARAM7),
            (Item { params: [0.0, f32::NAN, 0.0, 0.0], ..item(MavCmd::DO_CHANGE_SPEED) }, R::INVALID_PARAM2),
        ];
        for (item, code) in table {
            assert_eq!(check(&item), Err(code), "{item:?}");
        }
    }

    /// M-70: NaN and "not given" are defaults where the item allows them.
    #[test]
    fn defaults_are_understood() {
        let params = [f32::NAN; 4];
        let here = Vector { north: 3.0, east: 4.0, down: -7.0 };
        let order = |item: Item| {
            assert_eq!(check(&item), Ok(()));
            order(Home::DEMO, &item, here, 5.0)
        };
        let takeoff = Item { params, x: i32::MAX, y: i32::MAX, ..item(MavCmd::NAV_TAKEOFF) };
        assert_eq!(order(takeoff), Order::Fly(Maneuver::Climb(Vector { down: -10.0, ..here }), 0.0));
        let land = Item { z: f32::NAN, x: i32::MAX, ..item(MavCmd::NAV_LAND) };
        assert_eq!(order(land), Order::Fly(Maneuver::Land(here), 0.0));
        let waypoint = Item { params, frame: MavFrame::GLOBAL, z: 500.0, ..item(MavCmd::NAV_WAYPOINT) };
        let to = Vector { down: -12.0, ..Vector::ZERO };
        assert_eq!(order(waypoint), Order::Fly(Maneuver::Reach { to, radius: 2.0 }, 0.0));
        let keep = Item { params: [1.0, -1.0, 0.0, 0.0], ..item(MavCmd::DO_CHANGE_SPEED) };
        assert_eq!(order(keep), Order::Speed(5.0));
    }
}
