//! How the vehicle moves: a point that accelerates within limits, and leans as far as that takes.

use libm::{atan2f, fabsf, sqrtf};

use crate::tuning::Tuning;

/// Metres (or m/s) north, east and down of where it was switched on. The ground is at down = 0, everywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Vector {
    /// Metres north.
    pub north: f32,
    /// Metres east.
    pub east: f32,
    /// Metres down: negative in the air.
    pub down: f32,
}

impl Vector {
    /// Where it was switched on.
    pub const ZERO: Self = Self { north: 0.0, east: 0.0, down: 0.0 };

    /// Horizontal distance (m).
    pub fn distance(self, other: Self) -> f32 {
        let (north, east) = (other.north - self.north, other.east - self.east);
        sqrtf(north * north + east * east)
    }
}

const GRAVITY: f32 = 9.81;
/// Lower than this it only moves up and down.
pub const CLEARANCE: f32 = 1.0;
/// What is slower than this has no course, m/s.
const DRIFT: f32 = 0.05;
/// How long it takes to lean, s.
const LEANING: f32 = 0.15;

/// What it can do.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Horizontally, m/s²: 3 is a lean of 17°.
    pub acceleration: f32,
    /// m/s
    pub climb: f32,
    /// m/s
    pub sink: f32,
    /// Below `flare` metres, m/s.
    pub touch_down: f32,
    pub flare: f32,
    /// Speed for each metre that is left, 1/s.
    pub approach: f32,
    /// How fast it turns, rad/s.
    pub turn: f32,
    /// Whether the nose points along the course, where it is not told otherwise.
    pub has_course: bool,
}

impl Limits {
    pub fn of(tuning: &Tuning) -> Self {
        Self {
            acceleration: tuning.get(Tuning::MPC_ACC_HOR),
            climb: tuning.get(Tuning::MPC_Z_VEL_MAX_UP),
            sink: tuning.get(Tuning::MPC_Z_VEL_MAX_DN),
            touch_down: tuning.get(Tuning::MPC_LAND_SPEED),
            flare: tuning.get(Tuning::MPC_LAND_ALT),
            approach: tuning.get(Tuning::MPC_XY_P),
            turn: tuning.get(Tuning::MPC_YAWRAUTO_MAX).to_radians(),
            has_course: tuning.get(Tuning::MPC_YAW_MODE) == 0,
        }
    }
}

/// Where the nose is to point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Nose {
    /// Along the course.
    Course,
    /// Elsewhere: still so far to turn to the right (rad), at so many rad/s.
    Turn { left: f32, rate: f32 },
}

/// Where it is and how it moves.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    pub position: Vector,
    pub velocity: Vector,
    /// The horizontal acceleration that it leans into, m/s² north and east: follows the real one.
    lean: (f32, f32),
    /// Roll and pitch, rad, and how fast they change, rad/s.
    tilt: [f32; 2],
    pub tilt_rate: [f32; 2],
    /// Where the nose points, north and east, of length 1.
    heading: (f32, f32),
    /// How fast it turns to the right, rad/s.
    pub yaw_rate: f32,
    pub nose: Nose,
    pub limits: Limits,
}

impl Body {
    pub const AT_HOME: Self = Self {
        position: Vector::ZERO,
        velocity: Vector::ZERO,
        lean: (0.0, 0.0),
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
            has_course: true,
        },
    };

    pub fn is_on_ground(&self) -> bool {
        self.position.down >= 0.0
    }

    /// Roll, pitch, yaw in rad.
    pub fn attitude(&self) -> [f32; 3] {
        let [roll, pitch] = self.tilt;
        [roll, pitch, self.yaw()]
    }

    /// Where the nose points: rad from north, to the right.
    pub fn yaw(&self) -> f32 {
        atan2f(self.heading.1, self.heading.0)
    }

    /// Whether the nose points where it is to.
    pub fn is_turned(&self) -> bool {
        !matches!(self.nose, Nose::Turn { left, .. } if fabsf(left) > 0.001)
    }

    /// Where it comes to rest when it brakes now, at its height.
    pub fn rest(&self) -> Vector {
        self.ahead(0.0)
    }

    /// [`rest`](Self::rest), and `margin` metres further the same way; where it is, when it only drifts.
    pub fn ahead(&self, margin: f32) -> Vector {
        let Vector { north, east, .. } = self.velocity;
        let speed = sqrtf(north * north + east * east);
        let seconds = speed / (2.0 * self.limits.acceleration) + if speed > DRIFT { margin / speed } else { 0.0 };
        let Vector { north: at_north, east: at_east, down } = self.position;
        Vector { north: at_north + north * seconds, east: at_east + east * seconds, down }
    }

    /// `dt` seconds of flight towards `goal`, at most at `cruise` m/s.
    pub fn fly(&mut self, goal: Vector, cruise: f32, dt: f32) {
        let distance = self.position.distance(goal);
        let Limits { acceleration, approach, .. } = self.limits;
        let is_clear = -self.position.down >= CLEARANCE;
        // As fast as it can still brake from, and gently at the end.
        let speed =
            if is_clear { cruise.min(sqrtf(2.0 * acceleration * distance)).min(approach * distance) } else { 0.0 };
        let scale = if distance > 0.01 { speed / distance } else { 0.0 };
        let wanted = ((goal.north - self.position.north) * scale, (goal.east - self.position.east) * scale);
        let course = (distance > 2.0 && speed > 0.0).then_some(wanted);
        self.travel(wanted, goal.down - self.position.down, course, dt);
    }

    /// `dt` seconds of flight by hand: so fast forward, to the right and down (m/s), turning at `rate` rad/s.
    pub fn steer(&mut self, [forward, right, down]: [f32; 3], rate: f32, dt: f32) {
        let (north, east) = self.heading;
        let wanted = if -self.position.down >= CLEARANCE {
            (forward * north - right * east, forward * east + right * north)
        } else {
            (0.0, 0.0)
        };
        self.nose = Nose::Turn { left: rate * dt, rate: fabsf(rate) };
        self.travel(wanted, down, None, dt);
    }

    /// `dt` seconds with a velocity that is wanted, within the limits.
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
        self.lean_into((change.0 * share / dt, change.1 * share / dt), dt);
        let sink = if -self.position.down < flare { touch_down } else { sink };
        self.velocity.down = down.min(sink).max(-climb);
        self.move_on(dt);
    }

    /// `dt` seconds with the motors off.
    pub fn fall(&mut self, dt: f32) {
        self.lean_into((0.0, 0.0), dt);
        self.yaw_rate = 0.0;
        self.velocity.down += GRAVITY * dt;
        self.move_on(dt);
    }

    /// Roll and pitch follow the acceleration.
    fn lean_into(&mut self, (north, east): (f32, f32), dt: f32) {
        let share = dt / LEANING;
        self.lean.0 += (north - self.lean.0) * share;
        self.lean.1 += (east - self.lean.1) * share;
        let forward = self.lean.0 * self.heading.0 + self.lean.1 * self.heading.1;
        let right = self.lean.1 * self.heading.0 - self.lean.0 * self.heading.1;
        let [roll, pitch] = self.tilt;
        self.tilt = [atan2f(right, GRAVITY), atan2f(-forward, GRAVITY)];
        self.tilt_rate = [(self.tilt[0] - roll) / dt, (self.tilt[1] - pitch) / dt];
    }

    fn turn(&mut self, course: Option<(f32, f32)>, dt: f32) {
        let (north, east) = self.heading;
        let (left, rate) = match (self.nose, course) {
            (Nose::Turn { left, rate }, _) => (left, rate),
            // Exactly astern there is no shorter way round: to the right.
            (Nose::Course, Some(to)) if self.limits.has_course => {
                (atan2f(north * to.1 - east * to.0, north * to.0 + east * to.1), self.limits.turn)
            }
            (Nose::Course, _) => return,
        };
        let angle = left.min(rate * dt).max(-rate * dt);
        self.yaw_rate = angle / dt;
        if let Nose::Turn { left, .. } = &mut self.nose {
            *left -= angle;
        }
        // So small an angle is its own sine.
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
    fn it_arrives_and_stays_without_overshooting_far() {
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
    fn it_leans_and_points_where_it_flies() {
        let mut body = airborne();
        (0..50).for_each(|_| body.fly(Vector { east: 500.0, down: -10.0, ..Vector::ZERO }, 8.0, DT));
        let [roll, _, _] = body.attitude();
        assert!(roll > 0.1, "still pointing north, it leans right to go east: {roll}");
        (0..200).for_each(|_| body.fly(Vector { east: 500.0, down: -10.0, ..Vector::ZERO }, 8.0, DT));
        assert!((body.yaw() - FRAC_PI_2).abs() < 0.1, "{}", body.yaw());
    }

    #[test]
    fn it_turns_as_far_and_as_fast_as_it_is_told() {
        for (left, yaw) in [(FRAC_PI_2, FRAC_PI_2), (-FRAC_PI_2, -FRAC_PI_2), (3.0 * FRAC_PI_2, -FRAC_PI_2)] {
            let mut body = Body { nose: Nose::Turn { left, rate: 0.5 }, ..airborne() };
            let seconds = left.abs() / 0.5;
            let mut turn_for = |share: f32| {
                (0..(seconds * share / DT) as u32).for_each(|_| body.fly(body.position, 8.0, DT));
                body
            };
            assert!(!turn_for(0.9).is_turned(), "{left}");
            let body = turn_for(0.2);
            assert!(body.is_turned() && (body.yaw() - yaw).abs() < 0.01, "{left}: {}", body.yaw());
        }
    }

    #[test]
    fn it_comes_to_rest_where_it_says() {
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
            assert_eq!(body.ahead(2.0), body.rest(), "at rest there is no way ahead");
        }
    }

    #[test]
    fn it_does_not_drift_on_the_ground_or_through_it() {
        let mut body = Body::AT_HOME;
        (0..100).for_each(|_| body.fly(Vector { north: 50.0, east: 0.0, down: 5.0 }, 8.0, DT));
        assert_eq!(body.position, Vector::ZERO);
        let mut body = airborne();
        (0..300).for_each(|_| body.fall(DT));
        assert!(body.is_on_ground() && body.velocity == Vector::ZERO);
    }
}
