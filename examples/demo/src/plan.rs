//! The mission items that the vehicle can fly, and what each asks of it.
//!
//! A copter hovers where an aeroplane circles: radii and directions of circles are of no use to it. Where an item leaves
//! something open (NaN, no position, or 0, 0), the vehicle keeps its current value (M-48, M-70). An item on the ground or just
//! above it is flown at the vehicle's minimum altitude.

use core::f32::consts::TAU;

use libm::remainderf;
use mavstack::dialect::MavCmd;
use mavstack::{Duration, Instant, Item};

use crate::body::{CLEARANCE, Nose, Vector};
use crate::geo::Home;

/// It comes no closer to one for sure, m.
const MIN_RADIUS: f32 = 0.5;
/// It flies to no place lower than this, m.
pub const LOWEST: f32 = CLEARANCE + 0.5;
/// Longer than any battery lasts.
const FOREVER: Duration = Duration::from_micros(u64::MAX);

/// Something to fly, with an end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Maneuver {
    /// Stay there; at once done.
    Stay(Vector),
    /// Stay there until then.
    Wait { at: Vector, until: Instant },
    /// Fly there and come within so many metres.
    Reach { to: Vector, radius: f32 },
    /// Straight up or down first, then there.
    Climb(Vector),
    /// Fly there at this height, go down, touch down.
    Land(Vector),
    /// Land at home or at a rally point.
    Return,
}

/// What holds back the items behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Condition {
    /// Time has to pass.
    Delay(Duration),
    /// The place that it flies to has to be within so many metres.
    Distance(f32),
    /// The nose has to turn.
    Turn(Nose),
}

/// What an item asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// A maneuver, how long to stay when it is done, and where to point the nose then (rad).
    Fly { maneuver: Maneuver, stay: Duration, yaw: Option<f32> },
    /// Another cruise speed (m/s); `None` for the vehicle's own.
    Speed(Option<f32>),
    /// To wait for something.
    Wait(Condition),
    /// To go on elsewhere in the plan.
    Jump,
    /// Nothing that this vehicle knows; its table lets none of it in.
    Unknown,
}

/// How the vehicle is when an item's turn comes.
#[derive(Clone, Copy, Debug)]
pub struct Situation {
    pub home: Home,
    pub position: Vector,
    /// rad
    pub yaw: f32,
    /// A waypoint counts as reached within so many metres, unless it says otherwise.
    pub radius: f32,
    /// It turns no faster than this, rad/s.
    pub turn: f32,
    /// As in [`Order::Speed`].
    pub speed: Option<f32>,
    pub time: Instant,
}

/// Whether an item of this command is flown: it has an end to be reached. The others are carried out on the way (M-91).
pub fn is_flown(command: MavCmd) -> bool {
    matches!(
        command,
        MavCmd::NAV_WAYPOINT
            | MavCmd::NAV_LOITER_UNLIM
            | MavCmd::NAV_LOITER_TIME
            | MavCmd::NAV_RETURN_TO_LAUNCH
            | MavCmd::NAV_LAND
            | MavCmd::NAV_TAKEOFF
            | MavCmd::NAV_DELAY
    )
}

/// What `item` asks for.
pub fn order(item: &Item, now: &Situation) -> Order {
    let [p1, p2, p3, p4] = item.params;
    let Vector { north, east, down } = now.position;
    let (north, east) = match (item.x, item.y) {
        // Only a take-off, a landing or a loiter gets here with 0, 0: a waypoint there is refused.
        (i32::MAX, _) | (_, i32::MAX) | (0, 0) => (north, east),
        (latitude, longitude) => now.home.to_local(latitude, longitude),
    };
    let height = now.home.to_height(item.frame, item.z).unwrap_or(-down);
    let to = Vector { north, east, down: -height.max(LOWEST) };
    let fly = |maneuver, stay| {
        let is_at_a_heading = matches!(
            item.command,
            MavCmd::NAV_WAYPOINT | MavCmd::NAV_LOITER_UNLIM | MavCmd::NAV_LAND | MavCmd::NAV_TAKEOFF
        );
        Order::Fly { maneuver, stay, yaw: Some(p4.to_radians()).filter(|yaw| is_at_a_heading && yaw.is_finite()) }
    };
    match item.command {
        MavCmd::NAV_WAYPOINT => {
            fly(Maneuver::Reach { to, radius: if p2 > 0.0 { p2.max(MIN_RADIUS) } else { now.radius } }, seconds(p1))
        }
        MavCmd::NAV_LOITER_TIME => fly(Maneuver::Reach { to, radius: now.radius }, seconds(p1)),
        MavCmd::NAV_LOITER_UNLIM => fly(Maneuver::Reach { to, radius: now.radius }, FOREVER),
        MavCmd::NAV_TAKEOFF => fly(Maneuver::Climb(to), Duration::ZERO),
        MavCmd::NAV_LAND => fly(Maneuver::Land(Vector { down, ..to }), Duration::ZERO),
        MavCmd::NAV_RETURN_TO_LAUNCH => fly(Maneuver::Return, Duration::ZERO),
        MavCmd::NAV_DELAY => {
            fly(Maneuver::Wait { at: now.position, until: now.time.after(seconds(p1)) }, Duration::ZERO)
        }
        // Without wind the speed through the air is that over the ground. -1 keeps it, -2 is the default.
        MavCmd::DO_CHANGE_SPEED if p2 > 0.0 => Order::Speed(Some(p2)),
        MavCmd::DO_CHANGE_SPEED if p2 == -2.0 => Order::Speed(None),
        MavCmd::DO_CHANGE_SPEED => Order::Speed(now.speed),
        MavCmd::DO_JUMP => Order::Jump,
        MavCmd::CONDITION_DELAY => Order::Wait(Condition::Delay(seconds(p1))),
        MavCmd::CONDITION_DISTANCE => Order::Wait(Condition::Distance(p1)),
        MavCmd::CONDITION_YAW => {
            let angle = p1.to_radians();
            let left = match (p4 == 1.0, p3) {
                (true, ..0.0) => -angle,
                (true, _) => angle,
                (false, ..0.0) => -rightward(now.yaw - angle),
                (false, 0.0) => shorter(angle - now.yaw),
                (false, _) => rightward(angle - now.yaw),
            };
            let rate = if p2 > 0.0 { p2.to_radians().min(now.turn) } else { now.turn };
            Order::Wait(Condition::Turn(Nose::Turn { left, rate }))
        }
        _ => Order::Unknown,
    }
}

/// The shorter way to `to` (rad).
pub fn turn_to(to: f32, now: &Situation) -> Nose {
    Nose::Turn { left: shorter(to - now.yaw), rate: now.turn }
}

/// The same direction, from -π to π.
fn shorter(angle: f32) -> f32 {
    remainderf(angle, TAU)
}

/// The same direction, from 0 to 2π; what is all but there already does not go round.
fn rightward(angle: f32) -> f32 {
    let angle = shorter(angle);
    if angle < -0.01 { angle + TAU } else { angle }
}

/// Not a number is none.
fn seconds(seconds: f32) -> Duration {
    Duration::from_micros((seconds * 1e6) as u64)
}

#[cfg(test)]
mod tests {
    use core::f32::consts::{FRAC_PI_2, PI};

    use mavstack::dialect::MavFrame;

    use super::*;

    const NOW: Situation = Situation {
        home: Home::DEMO,
        position: Vector { north: 3.0, east: 4.0, down: -7.0 },
        yaw: 0.0,
        radius: 2.0,
        turn: 1.5,
        speed: Some(5.0),
        time: Instant::from_millis(1_000),
    };

    fn item(command: MavCmd, params: [f32; 4]) -> Item {
        let Home { latitude, longitude, .. } = Home::DEMO;
        let frame = MavFrame::GLOBAL_RELATIVE_ALT;
        Item { frame, command, autocontinue: 1, params, x: latitude, y: longitude, z: 10.0 }
    }

    fn fly(maneuver: Maneuver) -> Order {
        Order::Fly { maneuver, stay: Duration::ZERO, yaw: None }
    }

    /// M-70: NaN and "not given" are defaults where the item allows them.
    #[test]
    fn defaults_are_understood() {
        let order = |item: Item| order(&item, &NOW);
        let here = NOW.position;
        let nan = [f32::NAN; 4];
        let takeoff = Item { x: i32::MAX, y: i32::MAX, ..item(MavCmd::NAV_TAKEOFF, nan) };
        assert_eq!(order(takeoff), fly(Maneuver::Climb(Vector { down: -10.0, ..here })));
        let land = Item { z: f32::NAN, x: i32::MAX, y: i32::MAX, ..item(MavCmd::NAV_LAND, nan) };
        assert_eq!(order(land), fly(Maneuver::Land(here)));
        let waypoint = Item { frame: MavFrame::GLOBAL, z: 500.0, ..item(MavCmd::NAV_WAYPOINT, nan) };
        let to = Vector { down: -12.0, ..Vector::ZERO };
        assert_eq!(order(waypoint), fly(Maneuver::Reach { to, radius: 2.0 }));
        let speed = |speed| order(item(MavCmd::DO_CHANGE_SPEED, [1.0, speed, -1.0, 0.0]));
        assert_eq!([speed(-1.0), speed(-2.0), speed(3.5)], [Some(5.0), None, Some(3.5)].map(Order::Speed));
    }

    /// M-48: 0, 0 means "here" for items that make sense without a position.
    #[test]
    fn zero_is_here() {
        let here = NOW.position;
        let order = |command| order(&Item { x: 0, y: 0, ..item(command, [f32::NAN; 4]) }, &NOW);
        let to = Vector { down: -10.0, ..here };
        assert_eq!(order(MavCmd::NAV_TAKEOFF), fly(Maneuver::Climb(to)));
        assert_eq!(order(MavCmd::NAV_LAND), fly(Maneuver::Land(here)));
        let loiter = Maneuver::Reach { to, radius: 2.0 };
        assert_eq!(order(MavCmd::NAV_LOITER_TIME), fly(loiter));
        assert_eq!(order(MavCmd::NAV_LOITER_UNLIM), Order::Fly { maneuver: loiter, stay: FOREVER, yaw: None });
    }

    #[test]
    fn the_nose_turns_the_way_that_the_item_says() {
        // From where it points: angle, direction, relative; to turn.
        for (yaw, [angle, direction, relative], expected) in [
            (0.0, [90.0, 0.0, 0.0], FRAC_PI_2),
            (0.0, [270.0, 0.0, 0.0], -FRAC_PI_2),
            (0.0, [270.0, 1.0, 0.0], 3.0 * FRAC_PI_2),
            (0.0, [90.0, -1.0, 0.0], -3.0 * FRAC_PI_2),
            (FRAC_PI_2, [180.0, 1.0, 1.0], PI),
            (FRAC_PI_2, [180.0, -1.0, 1.0], -PI),
            (FRAC_PI_2, [45.0, 0.0, 1.0], PI / 4.0),
            (FRAC_PI_2 + 0.001, [90.0, 1.0, 0.0], -0.001),
            (-3.0, [180.0, 0.0, 0.0], 3.0 - PI),
        ] {
            let item = item(MavCmd::CONDITION_YAW, [angle, 20.0, direction, relative]);
            let Order::Wait(Condition::Turn(Nose::Turn { left, rate })) = order(&item, &Situation { yaw, ..NOW })
            else {
                panic!("{angle} {direction} {relative}");
            };
            assert!((left - expected).abs() < 1e-4, "{angle} {direction} {relative} from {yaw}: {left}");
            assert_eq!(rate, 20_f32.to_radians());
        }
    }
}
