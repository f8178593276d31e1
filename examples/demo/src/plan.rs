//! Translates mission items into maneuvers and other actions.
//!
//! A copter hovers where an aeroplane circles, so it ignores the radius and direction of a loiter. Where an item omits a
//! value (NaN, no position, or 0, 0), the vehicle keeps its current one (M-48, M-70). Items on or just above the ground are
//! flown at the minimum height.

use core::f32::consts::TAU;

use libm::remainderf;
use mavstack::dialect::MavCmd;
use mavstack::{Duration, Instant, Item};

use crate::body::{CLEARANCE, Nose, Vector};
use crate::geo::Home;

/// Minimum acceptance radius of a waypoint (m). The vehicle is not guaranteed to come closer than this.
const MIN_RADIUS: f32 = 0.5;
/// Minimum height of a position to fly to (m).
pub const MIN_HEIGHT: f32 = CLEARANCE + 0.5;
/// Default radius of a circle, and the minimum radius that the vehicle can follow (m).
const CIRCLE_RADIUS: f32 = 10.0;
const MIN_CIRCLE: f32 = 2.0;
/// Longer than any battery lasts.
const FOREVER: Duration = Duration::from_micros(u64::MAX);

/// A maneuver, which ends in a known state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Maneuver {
    /// Hold this position; done at once.
    Stay(Vector),
    /// Hold a position until a time.
    Wait { at: Vector, until: Instant },
    /// Fly to within `radius` metres of a position.
    Reach { to: Vector, radius: f32 },
    /// Fly around `center`, at `radius` metres from it, until the angle flown is `angle` (rad). A negative angle is counter-clockwise.
    Circle { center: Vector, radius: f32, angle: f32 },
    /// Climb or descend to the height first, then fly to the position.
    Climb(Vector),
    /// Fly to the position at its height, then descend and touch down.
    Land(Vector),
    /// Land at home or at a rally point.
    Return,
}

/// A condition that defers the items after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Condition {
    /// A time has passed.
    Delay(Duration),
    /// The target is within this distance (m).
    Distance(f32),
    /// The turn is complete.
    Turn(Nose),
}

/// What an item requests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Fly a maneuver, stay there for a time, and point the nose in a direction (rad).
    Fly { maneuver: Maneuver, stay: Duration, yaw: Option<f32> },
    /// Change the cruise speed (m/s); `None` restores the default.
    Speed(Option<f32>),
    /// Wait for a condition.
    Wait(Condition),
    /// Continue at another item.
    Jump,
    /// Set the pulse of a servo (µs).
    Servo { number: f32, pulse: f32 },
    /// Nothing: the item marks a place in the plan.
    Mark,
    /// Operate the camera.
    Camera,
    /// Point the gimbal.
    Gimbal,
    /// An unsupported command. The vehicle's table of commands refuses plans that contain one.
    Unknown,
}

/// The vehicle's state when it begins an item.
#[derive(Clone, Copy, Debug)]
pub struct Situation {
    pub home: Home,
    pub position: Vector,
    /// Heading (rad).
    pub yaw: f32,
    /// Default acceptance radius of a waypoint (m).
    pub radius: f32,
    /// Maximum yaw rate (rad/s).
    pub turn: f32,
    /// As in [`Action::Speed`].
    pub speed: Option<f32>,
    pub time: Instant,
}

/// Whether the command is flown, and reached when it ends. Other commands are executed on the way (M-91).
pub fn is_flown(command: MavCmd) -> bool {
    matches!(
        command,
        MavCmd::NAV_WAYPOINT
            | MavCmd::NAV_LOITER_UNLIM
            | MavCmd::NAV_LOITER_TIME
            | MavCmd::NAV_LOITER_TURNS
            | MavCmd::NAV_RETURN_TO_LAUNCH
            | MavCmd::NAV_LAND
            | MavCmd::NAV_TAKEOFF
            | MavCmd::NAV_DELAY
    )
}

/// Whether the command is for the camera.
fn is_for_camera(command: MavCmd) -> bool {
    matches!(
        command,
        MavCmd::DO_SET_CAM_TRIGG_DIST
            | MavCmd::SET_CAMERA_MODE
            | MavCmd::IMAGE_START_CAPTURE
            | MavCmd::IMAGE_STOP_CAPTURE
            | MavCmd::VIDEO_START_CAPTURE
            | MavCmd::VIDEO_STOP_CAPTURE
    )
}

/// Whether the command is for the gimbal.
fn is_for_gimbal(command: MavCmd) -> bool {
    matches!(
        command,
        MavCmd::DO_GIMBAL_MANAGER_PITCHYAW
            | MavCmd::DO_GIMBAL_MANAGER_CONFIGURE
            | MavCmd::DO_SET_ROI_LOCATION
            | MavCmd::DO_SET_ROI_WPNEXT_OFFSET
            | MavCmd::DO_SET_ROI_NONE
            | MavCmd::DO_MOUNT_CONFIGURE
            | MavCmd::DO_MOUNT_CONTROL
    )
}

/// Whether the command is for the camera or the gimbal.
pub fn is_for_payload(command: MavCmd) -> bool {
    is_for_camera(command) || is_for_gimbal(command)
}

/// Returns what `item` requests.
pub fn action(item: &Item, now: &Situation) -> Action {
    let [p1, p2, p3, p4] = item.params;
    let Vector { north, east, down } = now.position;
    let (north, east) = match (item.x, item.y) {
        // Only a takeoff, landing or loiter can have 0, 0: waypoints there are refused.
        (i32::MAX, _) | (_, i32::MAX) | (0, 0) => (north, east),
        (latitude, longitude) => now.home.to_local(latitude, longitude),
    };
    let height = now.home.to_height(item.frame, item.z).unwrap_or(-down);
    let to = Vector { north, east, down: -height.max(MIN_HEIGHT) };
    let fly = |maneuver, stay| {
        let has_heading = matches!(
            item.command,
            MavCmd::NAV_WAYPOINT | MavCmd::NAV_LOITER_UNLIM | MavCmd::NAV_LAND | MavCmd::NAV_TAKEOFF
        );
        Action::Fly { maneuver, stay, yaw: Some(p4.to_radians()).filter(|yaw| has_heading && yaw.is_finite()) }
    };
    match item.command {
        MavCmd::NAV_WAYPOINT => {
            fly(Maneuver::Reach { to, radius: if p2 > 0.0 { p2.max(MIN_RADIUS) } else { now.radius } }, seconds(p1))
        }
        MavCmd::NAV_LOITER_TIME => fly(Maneuver::Reach { to, radius: now.radius }, seconds(p1)),
        MavCmd::NAV_LOITER_UNLIM => fly(Maneuver::Reach { to, radius: now.radius }, FOREVER),
        MavCmd::NAV_LOITER_TURNS => {
            let radius = if p3 == 0.0 || p3.is_nan() { CIRCLE_RADIUS } else { p3.abs().max(MIN_CIRCLE) };
            let angle = (TAU * p1.max(0.0)).copysign(p3);
            fly(Maneuver::Circle { center: to, radius, angle }, Duration::ZERO)
        }
        MavCmd::NAV_TAKEOFF => fly(Maneuver::Climb(to), Duration::ZERO),
        MavCmd::NAV_LAND => fly(Maneuver::Land(Vector { down, ..to }), Duration::ZERO),
        MavCmd::NAV_RETURN_TO_LAUNCH => fly(Maneuver::Return, Duration::ZERO),
        MavCmd::NAV_DELAY => fly(Maneuver::Wait { at: now.position, until: now.time + seconds(p1) }, Duration::ZERO),
        // Without wind airspeed equals ground speed. -1 keeps the speed, -2 restores the default.
        MavCmd::DO_CHANGE_SPEED if p2 > 0.0 => Action::Speed(Some(p2)),
        MavCmd::DO_CHANGE_SPEED if p2 == -2.0 => Action::Speed(None),
        MavCmd::DO_CHANGE_SPEED => Action::Speed(now.speed),
        MavCmd::DO_JUMP => Action::Jump,
        MavCmd::DO_SET_SERVO => Action::Servo { number: p1, pulse: p2 },
        MavCmd::DO_LAND_START => Action::Mark,
        command if is_for_camera(command) => Action::Camera,
        command if is_for_gimbal(command) => Action::Gimbal,
        MavCmd::CONDITION_DELAY => Action::Wait(Condition::Delay(seconds(p1))),
        MavCmd::CONDITION_DISTANCE => Action::Wait(Condition::Distance(p1)),
        MavCmd::CONDITION_YAW => {
            let angle = p1.to_radians();
            let remaining = match (p4 == 1.0, p3) {
                (true, ..0.0) => -angle,
                (true, _) => angle,
                (false, ..0.0) => -wrap_2pi(now.yaw - angle),
                (false, 0.0) => wrap_pi(angle - now.yaw),
                (false, _) => wrap_2pi(angle - now.yaw),
            };
            let rate = if p2 > 0.0 { p2.to_radians().min(now.turn) } else { now.turn };
            Action::Wait(Condition::Turn(Nose::Turn { remaining, rate }))
        }
        _ => Action::Unknown,
    }
}

/// Returns the shorter turn from the heading `yaw` to the heading `to` (rad), at `rate` (rad/s).
pub fn turn_to(to: f32, yaw: f32, rate: f32) -> Nose {
    Nose::Turn { remaining: wrap_pi(to - yaw), rate }
}

/// Wraps an angle to -π..π.
fn wrap_pi(angle: f32) -> f32 {
    remainderf(angle, TAU)
}

/// Wraps an angle to 0..2π. Angles of -0.01 rad or more stay negative, so that a completed turn does not go around again.
fn wrap_2pi(angle: f32) -> f32 {
    let angle = wrap_pi(angle);
    if angle < -0.01 { angle + TAU } else { angle }
}

/// Converts seconds to a duration; NaN is zero.
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

    fn fly(maneuver: Maneuver) -> Action {
        Action::Fly { maneuver, stay: Duration::ZERO, yaw: None }
    }

    /// M-70: NaN and "not given" mean the default where the command allows them.
    #[test]
    fn omitted_values_mean_defaults() {
        let action = |item: Item| action(&item, &NOW);
        let here = NOW.position;
        let nan = [f32::NAN; 4];
        let takeoff = Item { x: i32::MAX, y: i32::MAX, ..item(MavCmd::NAV_TAKEOFF, nan) };
        assert_eq!(action(takeoff), fly(Maneuver::Climb(Vector { down: -10.0, ..here })));
        let land = Item { z: f32::NAN, x: i32::MAX, y: i32::MAX, ..item(MavCmd::NAV_LAND, nan) };
        assert_eq!(action(land), fly(Maneuver::Land(here)));
        let waypoint = Item { frame: MavFrame::GLOBAL, z: 500.0, ..item(MavCmd::NAV_WAYPOINT, nan) };
        let to = Vector { down: -12.0, ..Vector::ZERO };
        assert_eq!(action(waypoint), fly(Maneuver::Reach { to, radius: 2.0 }));
        let speed = |speed| action(item(MavCmd::DO_CHANGE_SPEED, [1.0, speed, -1.0, 0.0]));
        assert_eq!([speed(-1.0), speed(-2.0), speed(3.5)], [Some(5.0), None, Some(3.5)].map(Action::Speed));
    }

    /// M-48: 0, 0 means "here" for commands that do not require a position.
    #[test]
    fn zero_position_means_here() {
        let here = NOW.position;
        let action = |command| action(&Item { x: 0, y: 0, ..item(command, [f32::NAN; 4]) }, &NOW);
        let to = Vector { down: -10.0, ..here };
        assert_eq!(action(MavCmd::NAV_TAKEOFF), fly(Maneuver::Climb(to)));
        assert_eq!(action(MavCmd::NAV_LAND), fly(Maneuver::Land(here)));
        let loiter = Maneuver::Reach { to, radius: 2.0 };
        assert_eq!(action(MavCmd::NAV_LOITER_TIME), fly(loiter));
        assert_eq!(action(MavCmd::NAV_LOITER_UNLIM), Action::Fly { maneuver: loiter, stay: FOREVER, yaw: None });
    }

    #[test]
    fn yaw_turns_in_the_direction_of_the_item() {
        // Heading; angle, direction, relative; expected turn.
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
            let Action::Wait(Condition::Turn(Nose::Turn { remaining, rate })) =
                action(&item, &Situation { yaw, ..NOW })
            else {
                panic!("{angle} {direction} {relative}");
            };
            assert!((remaining - expected).abs() < 1e-4, "{angle} {direction} {relative} from {yaw}: {remaining}");
            assert_eq!(rate, 20_f32.to_radians());
        }
    }
}
