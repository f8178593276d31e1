//! The flight dynamics: a point mass that accelerates within limits and tilts accordingly.

use libm::{atan2f, fabsf, sqrtf};
use mavstack::Context;

use crate::tuning::Tuning;

/// A position (m) or velocity (m/s) in the local NED frame. The origin is the position at boot. The ground is flat, at
/// down = 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Vector {
    /// North.
    pub north: f32,
    /// East.
    pub east: f32,
    /// Down: negative in the air.
    pub down: f32,
}

impl Vector {
    /// The origin: the position at boot, or no velocity.
    pub const ZERO: Self = Self { north: 0.0, east: 0.0, down: 0.0 };

    /// Returns the horizontal distance to `other` (m).
    pub fn distance(self, other: Self) -> f32 {
        let (north, east) = (other.north - self.north, other.east - self.east);
        sqrtf(north * north + east * east)
    }
}

const GRAVITY: f32 = 9.81;
/// Below this height (m) the vehicle only moves vertically.
pub const CLEARANCE: f32 = 1.0;
/// Below this speed (m/s) the vehicle has no course.
const DRIFT: f32 = 0.05;
/// Time constant of roll and pitch (s).
const TILT_TIME: f32 = 0.15;

/// The vehicle's performance limits.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Horizontal acceleration (m/s²): 3 is a tilt of 17°.
    pub acceleration: f32,
    /// Climb rate (m/s).
    pub climb: f32,
    /// Descent rate (m/s).
    pub sink: f32,
    /// Descent rate below the height `flare` (m/s).
    pub touch_down: f32,
    /// Height (m).
    pub flare: f32,
    /// Approach speed per metre of remaining distance (1/s).
    pub approach: f32,
    /// Yaw rate (rad/s).
    pub turn: f32,
    /// Whether the nose points along the course unless a heading is given.
    pub follows_course: bool,
}

impl Limits {
    pub fn of(cx: &Context<'_>) -> Self {
        Self {
            acceleration: cx.parameter(Tuning::MPC_ACC_HOR),
            climb: cx.parameter(Tuning::MPC_Z_VEL_MAX_UP),
            sink: cx.parameter(Tuning::MPC_Z_VEL_MAX_DN),
            touch_down: cx.parameter(Tuning::MPC_LAND_SPEED),
            flare: cx.parameter(Tuning::MPC_LAND_ALT),
            approach: cx.parameter(Tuning::MPC_XY_P),
            turn: cx.parameter(Tuning::MPC_YAWRAUTO_MAX).to_radians(),
            follows_course: cx.parameter(Tuning::MPC_YAW_MODE) == 0,
        }
    }
}

/// The direction in which to point the nose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Nose {
    /// Along the course.
    Course,
    /// In another direction: the remaining turn to the right (rad), and the yaw rate (rad/s).
    Turn { remaining: f32, rate: f32 },
}

/// The vehicle's position, velocity and attitude.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    pub position: Vector,
    pub velocity: Vector,
    /// Horizontal acceleration, low-pass filtered (m/s², north and east). It determines the tilt.
    smooth_acceleration: (f32, f32),
    /// Roll and pitch (rad).
    tilt: [f32; 2],
    /// Roll rate and pitch rate (rad/s).
    pub tilt_rate: [f32; 2],
    /// Direction of the nose as a unit vector (north, east).
    heading: (f32, f32),
    /// Yaw rate (rad/s), positive to the right.
    pub yaw_rate: f32,
    pub nose: Nose,
    pub limits: Limits,
}

impl Body {
    pub const AT_HOME: Self = Self {
        position: Vector::ZERO,
        velocity: Vector::ZERO,
        smooth_acceleration: (0.0, 0.0),
        tilt: [0.0; 2],
        tilt_rate: [0.0; 2],
        heading: (1.0, 0.0),
        yaw_rate: 0.0,
        nose: Nose::Course,
        limits: Limits {
            acceleration: 3.0,
            climb: 3.0,
            sink: 2.0,
            touch_down: 0.7,
            flare: 4.0,
            approach: 2.0,
            turn: 1.5,
            follows_course: true,
        },
    };

    pub fn is_on_ground(&self) -> bool {
        self.position.down >= 0.0
    }

    /// Returns roll, pitch and yaw (rad).
    pub fn attitude(&self) -> [f32; 3] {
        let [roll, pitch] = self.tilt;
        [roll, pitch, self.yaw()]
    }

    /// Returns the heading (rad), clockwise from north.
    pub fn yaw(&self) -> f32 {
        atan2f(self.heading.1, self.heading.0)
    }

    /// Whether the last turn is complete.
    pub fn is_turned(&self) -> bool {
        !matches!(self.nose, Nose::Turn { remaining, .. } if fabsf(remaining) > 0.001)
    }

    /// Returns where the vehicle comes to rest if it brakes now, at its current height.
    pub fn rest(&self) -> Vector {
        self.ahead(0.0)
    }

    /// Returns the point `margin` metres beyond [`rest`](Self::rest) along the course. Without a course it is `rest`.
    pub fn ahead(&self, margin: f32) -> Vector {
        let Vector { north, east, .. } = self.velocity;
        let speed = sqrtf(north * north + east * east);
        let seconds = speed / (2.0 * self.limits.acceleration) + if speed > DRIFT { margin / speed } else { 0.0 };
        let Vector { north: at_north, east: at_east, down } = self.position;
        Vector { north: at_north + north * seconds, east: at_east + east * seconds, down }
    }

    /// Flies towards `goal` for `dt` seconds, at `cruise` m/s or less.
    pub fn fly(&mut self, goal: Vector, cruise: f32, dt: f32) {
        let distance = self.position.distance(goal);
        let Limits { acceleration, approach, .. } = self.limits;
        let is_clear = -self.position.down >= CLEARANCE;
        // Slow enough to brake in time, and proportional to the distance at the end.
        let speed =
            if is_clear { cruise.min(sqrtf(2.0 * acceleration * distance)).min(approach * distance) } else { 0.0 };
        let scale = if distance > 0.01 { speed / distance } else { 0.0 };
        let wanted = ((goal.north - self.position.north) * scale, (goal.east - self.position.east) * scale);
        let course = (distance > 2.0 && speed > 0.0).then_some(wanted);
        self.travel(wanted, goal.down - self.position.down, course, dt);
    }

    /// Returns the next point to fly to on a circle, in the direction of the sign of `angle`: clockwise if it is positive.
    pub fn around(&self, center: Vector, radius: f32, angle: f32) -> Vector {
        /// Cosine and sine of the angle to that point: 0.5 rad.
        const AHEAD: (f32, f32) = (0.877_582_6, 0.479_425_54);
        let distance = self.position.distance(center);
        // From the centre itself, to the north.
        let (north, east) = match distance > 0.1 {
            true => ((self.position.north - center.north) / distance, (self.position.east - center.east) / distance),
            false => (1.0, 0.0),
        };
        let (cos, sin) = (AHEAD.0, AHEAD.1.copysign(angle));
        Vector {
            north: center.north + radius * (north * cos - east * sin),
            east: center.east + radius * (east * cos + north * sin),
            down: center.down,
        }
    }

    /// Returns the rate at which the vehicle flies around a point (rad/s), clockwise positive; 0 away from the circle.
    pub fn angle_about(&self, center: Vector, radius: f32) -> f32 {
        let (north, east) = (self.position.north - center.north, self.position.east - center.east);
        let square = north * north + east * east;
        if square < 0.25 * radius * radius || square > 2.25 * radius * radius {
            return 0.0;
        }
        (north * self.velocity.east - east * self.velocity.north) / square
    }

    /// Flies manually for `dt` seconds: velocity forward, right and down (m/s), yaw rate `rate` (rad/s).
    pub fn steer(&mut self, [forward, right, down]: [f32; 3], rate: f32, dt: f32) {
        let (north, east) = self.heading;
        let wanted = if -self.position.down >= CLEARANCE {
            (forward * north - right * east, forward * east + right * north)
        } else {
            (0.0, 0.0)
        };
        self.nose = Nose::Turn { remaining: rate * dt, rate: fabsf(rate) };
        self.travel(wanted, down, None, dt);
    }

    /// Flies with a velocity (m/s) for `dt` seconds, within the limits.
    pub fn go(&mut self, velocity: Vector, dt: f32) {
        let wanted = if -self.position.down >= CLEARANCE { (velocity.north, velocity.east) } else { (0.0, 0.0) };
        self.travel(wanted, velocity.down, None, dt);
    }

    /// Moves for `dt` seconds towards the wanted velocity, within the limits.
    fn travel(&mut self, wanted: (f32, f32), down: f32, course: Option<(f32, f32)>, dt: f32) {
        let Limits { acceleration, climb, sink, touch_down, flare, .. } = self.limits;
        let change = (wanted.0 - self.velocity.north, wanted.1 - self.velocity.east);
        let size = sqrtf(change.0 * change.0 + change.1 * change.1);
        let share = if size > acceleration * dt { acceleration * dt / size } else { 1.0 };
        self.velocity.north += change.0 * share;
        self.velocity.east += change.1 * share;
        self.yaw_rate = 0.0;
        if !self.is_on_ground() {
            self.turn(course, dt);
        }
        self.tilt_by((change.0 * share / dt, change.1 * share / dt), dt);
        let sink = if -self.position.down < flare { touch_down } else { sink };
        self.velocity.down = down.min(sink).max(-climb);
        self.move_on(dt);
    }

    /// Falls for `dt` seconds, with the motors off.
    pub fn fall(&mut self, dt: f32) {
        self.tilt_by((0.0, 0.0), dt);
        self.yaw_rate = 0.0;
        self.velocity.down += GRAVITY * dt;
        self.move_on(dt);
    }

    /// Derives roll and pitch from the acceleration.
    fn tilt_by(&mut self, (north, east): (f32, f32), dt: f32) {
        let share = dt / TILT_TIME;
        let smooth = &mut self.smooth_acceleration;
        smooth.0 += (north - smooth.0) * share;
        smooth.1 += (east - smooth.1) * share;
        let forward = smooth.0 * self.heading.0 + smooth.1 * self.heading.1;
        let right = smooth.1 * self.heading.0 - smooth.0 * self.heading.1;
        let [roll, pitch] = self.tilt;
        self.tilt = [atan2f(right, GRAVITY), atan2f(-forward, GRAVITY)];
        self.tilt_rate = [(self.tilt[0] - roll) / dt, (self.tilt[1] - pitch) / dt];
    }

    fn turn(&mut self, course: Option<(f32, f32)>, dt: f32) {
        let (north, east) = self.heading;
        let (remaining, rate) = match (self.nose, course) {
            (Nose::Turn { remaining, rate }, _) => (remaining, rate),
            // A turn of exactly half a circle goes to the right.
            (Nose::Course, Some(to)) if self.limits.follows_course => {
                (atan2f(north * to.1 - east * to.0, north * to.0 + east * to.1), self.limits.turn)
            }
            (Nose::Course, _) => return,
        };
        let angle = remaining.min(rate * dt).max(-rate * dt);
        self.yaw_rate = angle / dt;
        if let Nose::Turn { remaining, .. } = &mut self.nose {
            *remaining -= angle;
        }
        // Small-angle approximation: sin(x) = x.
        let (north, east) = (north - east * angle, east + north * angle);
        let length = sqrtf(north * north + east * east);
        self.heading = (north / length, east / length);
    }

    fn move_on(&mut self, dt: f32) {
        self.position.north += self.velocity.north * dt;
        self.position.east += self.velocity.east * dt;
        self.position.down += self.velocity.down * dt;
        if self.is_on_ground() {
            self.position.down = 0.0;
            self.velocity = Vector::ZERO;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use core::f32::consts::FRAC_PI_2;

    const DT: f32 = 0.01;

    fn airborne() -> Body {
        Body { position: Vector { down: -10.0, ..Vector::ZERO }, ..Body::AT_HOME }
    }

    #[test]
    fn reaches_the_goal_with_little_overshoot() {
        let goal = Vector { north: 60.0, east: -80.0, down: -20.0 };
        let mut body = airborne();
        let mut furthest: f32 = 0.0;
        for _ in 0..4_000 {
            body.fly(goal, 8.0, DT);
            furthest = furthest.max(body.position.distance(Vector::ZERO));
        }
        assert!(body.position.distance(goal) < 0.5 && (body.position.down + 20.0).abs() < 0.1, "{body:?}");
        assert!(furthest < 101.0, "{furthest}");
    }

    #[test]
    fn tilts_and_turns_towards_the_course() {
        let mut body = airborne();
        (0..50).for_each(|_| body.fly(Vector { east: 500.0, down: -10.0, ..Vector::ZERO }, 8.0, DT));
        let [roll, _, _] = body.attitude();
        assert!(roll > 0.1, "still heading north, it rolls right to fly east: {roll}");
        (0..200).for_each(|_| body.fly(Vector { east: 500.0, down: -10.0, ..Vector::ZERO }, 8.0, DT));
        assert!((body.yaw() - FRAC_PI_2).abs() < 0.1, "{}", body.yaw());
    }

    #[test]
    fn turns_by_the_angle_and_at_the_rate_requested() {
        for (angle, yaw) in [(FRAC_PI_2, FRAC_PI_2), (-FRAC_PI_2, -FRAC_PI_2), (3.0 * FRAC_PI_2, -FRAC_PI_2)] {
            let mut body = Body { nose: Nose::Turn { remaining: angle, rate: 0.5 }, ..airborne() };
            let seconds = angle.abs() / 0.5;
            let mut turn_for = |share: f32| {
                (0..(seconds * share / DT) as u32).for_each(|_| body.fly(body.position, 8.0, DT));
                body
            };
            assert!(!turn_for(0.9).is_turned(), "{angle}");
            let body = turn_for(0.2);
            assert!(body.is_turned() && (body.yaw() - yaw).abs() < 0.01, "{angle}: {}", body.yaw());
        }
    }

    #[test]
    fn comes_to_rest_at_the_predicted_point() {
        for cruise in [1.0, 8.0, 25.0] {
            let mut body = airborne();
            (0..1_500).for_each(|_| body.fly(Vector { north: 900.0, east: 500.0, down: -10.0 }, cruise, DT));
            let rest = body.rest();
            let further = body.ahead(2.0);
            assert!((rest.distance(further) - 2.0).abs() < 0.01);
            let mut furthest: f32 = 0.0;
            for _ in 0..2_000 {
                body.fly(rest, cruise, DT);
                furthest = furthest.max(body.position.distance(airborne().position));
            }
            assert!(body.position.distance(rest) < 0.1, "{body:?}");
            let beyond = furthest - rest.distance(airborne().position);
            assert!(beyond < 0.2, "{cruise}: {beyond}");
            assert_eq!(body.ahead(2.0), body.rest(), "at rest there is no course");
        }
    }

    #[test]
    fn does_not_slide_on_the_ground_or_sink_below_it() {
        let mut body = Body::AT_HOME;
        (0..100).for_each(|_| body.fly(Vector { north: 50.0, east: 0.0, down: 5.0 }, 8.0, DT));
        assert_eq!(body.position, Vector::ZERO);
        let mut body = airborne();
        (0..300).for_each(|_| body.fall(DT));
        assert!(body.is_on_ground() && body.velocity == Vector::ZERO);
    }
}
