//! How the vehicle moves: a point that accelerates within limits, and leans as far as that takes.

use libm::{atan2f, sqrtf};

/// Metres (or m/s) north, east and down of home. The ground is at down = 0, everywhere.
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
    /// Home.
    pub const ZERO: Self = Self { north: 0.0, east: 0.0, down: 0.0 };

    /// Horizontal distance (m).
    pub fn distance(self, other: Self) -> f32 {
        let (north, east) = (other.north - self.north, other.east - self.east);
        sqrtf(north * north + east * east)
    }
}

const GRAVITY: f32 = 9.81;
/// Horizontal acceleration, m/s²: a lean of 17°.
const ACCELERATION: f32 = 3.0;
const CLIMB: f32 = 3.0;
const SINK: f32 = 2.0;
/// Below [`FLARE`] metres, m/s.
const TOUCH_DOWN: f32 = 0.7;
const FLARE: f32 = 4.0;
/// Lower than this it only moves up and down.
const CLEARANCE: f32 = 1.0;
/// How fast the nose follows the course: a share of the difference a second.
const TURN: f32 = 2.0;

/// Where it is and how it moves.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    pub position: Vector,
    pub velocity: Vector,
    /// Horizontal, of the last step.
    acceleration: (f32, f32),
    /// Where the nose points, north and east, of length 1.
    heading: (f32, f32),
}

impl Body {
    pub const AT_HOME: Self =
        Self { position: Vector::ZERO, velocity: Vector::ZERO, acceleration: (0.0, 0.0), heading: (1.0, 0.0) };

    pub fn is_on_ground(&self) -> bool {
        self.position.down >= 0.0
    }

    /// Roll, pitch, yaw in rad.
    pub fn attitude(&self) -> [f32; 3] {
        let (north, east) = self.acceleration;
        let forward = north * self.heading.0 + east * self.heading.1;
        let right = east * self.heading.0 - north * self.heading.1;
        [atan2f(right, GRAVITY), atan2f(-forward, GRAVITY), atan2f(self.heading.1, self.heading.0)]
    }

    /// `dt` seconds of flight towards `goal`, at most at `cruise` m/s.
    pub fn fly(&mut self, goal: Vector, cruise: f32, dt: f32) {
        let distance = self.position.distance(goal);
        // As fast as it can still brake from.
        let speed =
            if -self.position.down < CLEARANCE { 0.0 } else { cruise.min(sqrtf(2.0 * ACCELERATION * distance)) };
        let scale = if distance > 0.01 { speed / distance } else { 0.0 };
        let wanted = ((goal.north - self.position.north) * scale, (goal.east - self.position.east) * scale);
        let change = (wanted.0 - self.velocity.north, wanted.1 - self.velocity.east);
        let size = sqrtf(change.0 * change.0 + change.1 * change.1);
        let share = if size > ACCELERATION * dt { ACCELERATION * dt / size } else { 1.0 };
        self.velocity.north += change.0 * share;
        self.velocity.east += change.1 * share;
        self.acceleration = (change.0 * share / dt, change.1 * share / dt);
        if distance > 2.0 && speed > 0.0 {
            self.turn(wanted.0 / speed, wanted.1 / speed, dt);
        }
        let sink = if -self.position.down < FLARE { TOUCH_DOWN } else { SINK };
        self.velocity.down = (goal.down - self.position.down).clamp(-CLIMB, sink);
        self.travel(dt);
    }

    /// `dt` seconds with the motors off.
    pub fn fall(&mut self, dt: f32) {
        self.acceleration = (0.0, 0.0);
        self.velocity.down += GRAVITY * dt;
        self.travel(dt);
    }

    fn turn(&mut self, north: f32, east: f32, dt: f32) {
        let north = self.heading.0 + (north - self.heading.0) * TURN * dt;
        let east = self.heading.1 + (east - self.heading.1) * TURN * dt;
        let length = sqrtf(north * north + east * east);
        // Exactly astern there is no shorter way round: turn right.
        self.heading = if length > 0.01 { (north / length, east / length) } else { (-self.heading.1, self.heading.0) };
    }

    fn travel(&mut self, dt: f32) {
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
        let [_, _, yaw] = body.attitude();
        assert!((yaw - core::f32::consts::FRAC_PI_2).abs() < 0.1, "{yaw}");
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
