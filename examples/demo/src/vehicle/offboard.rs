//! Offboard flight: setpoints command a position or a velocity.
//!
//! - Positions and velocities are flown, in LOCAL_NED or in a global frame. A position takes precedence over a velocity, which
//!   is then only a hint. Horizontal and vertical parts are independent of each other. What is missing holds still.
//! - Setpoints in a frame of the body, accelerations, forces and attitudes are not flown: without a position or a velocity that
//!   the vehicle can fly, a setpoint counts as lost.

use libm::sqrtf;
use mavstack::dialect::{MavFrame, MavResult, MavSeverity};
use mavstack::setpoints::{Place, PositionSetpoint, Target};
use mavstack::{Context, Instant, StackOf};

use super::commands::{MAX_SPEED, refuse};
use super::manual::source;
use super::{DT, Mode, Quadrotor};
use crate::app::Mavlink;
use crate::body::{Nose, Vector};
use crate::plan::Maneuver;
use crate::tuning::Tuning;

/// What a setpoint asks for, in the local NED frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Course {
    horizontal: Horizontal,
    vertical: Vertical,
    turn: Turn,
}

#[derive(Clone, Copy, Debug)]
enum Horizontal {
    /// Fly to north and east (m).
    To(f32, f32),
    /// Fly north and east (m/s).
    At(f32, f32),
}

#[derive(Clone, Copy, Debug)]
enum Vertical {
    /// Down (m).
    To(f32),
    /// Down (m/s).
    At(f32),
}

#[derive(Clone, Copy, Debug)]
enum Turn {
    /// Heading (rad).
    To(f32),
    /// Yaw rate (rad/s).
    At(f32),
}

impl Quadrotor {
    /// Configures the source of setpoints from the parameters, and reads the current one.
    #[inline(never)]
    pub(crate) fn take_setpoint(&mut self, now: Instant, stack: &mut StackOf<Mavlink>) {
        let system = stack.parameters().get(Tuning::MAV_GCS_SYSID);
        let setpoints = &mut stack.setpoints;
        setpoints.set_source(source(system));
        self.course = setpoints.current(now).and_then(|setpoint| self.course_to(&setpoint.target));
    }

    /// Returns the course to a target; `None` if the vehicle cannot fly it.
    pub(super) fn course_to(&self, target: &Target) -> Option<Course> {
        match target {
            Target::Position(setpoint) => self.course(setpoint),
            Target::Attitude(_) => None,
        }
    }

    /// Returns the course of a setpoint; `None` if the vehicle cannot fly it.
    fn course(&self, setpoint: &PositionSetpoint) -> Option<Course> {
        let (place, down) = match setpoint.place {
            Place::Local(_) if setpoint.frame != MavFrame::LOCAL_NED => return None,
            Place::Local([north, east, down]) => (north.zip(east), down),
            Place::Global { latitude, longitude, altitude } => {
                let place =
                    latitude.zip(longitude).map(|(latitude, longitude)| self.home.to_local(latitude, longitude));
                // Zero only checks the frame.
                let height = self.home.to_height(setpoint.frame, altitude.unwrap_or(0.0))?;
                (place, altitude.map(|_| -height))
            }
        };
        let [north, east, sink] = setpoint.velocity;
        let horizontal = place.map(|(north, east)| Horizontal::To(north, east));
        let horizontal = horizontal.or(north.zip(east).map(|(north, east)| Horizontal::At(north, east)));
        let vertical = down.map(Vertical::To).or(sink.map(Vertical::At));
        if horizontal.is_none() && vertical.is_none() {
            return None;
        }
        let turn = setpoint.yaw.map(Turn::To).or(setpoint.yaw_rate.map(Turn::At));
        Some(Course {
            horizontal: horizontal.unwrap_or(Horizontal::At(0.0, 0.0)),
            vertical: vertical.unwrap_or(Vertical::At(0.0)),
            turn: turn.unwrap_or(Turn::At(0.0)),
        })
    }

    /// Enters [`Mode::Offboard`]. Refused without a current setpoint that the vehicle can fly.
    pub(super) fn fly_setpoints(&mut self, cx: &mut Context<'_>) -> MavResult {
        if self.course.is_none() {
            return refuse(cx, MavResult::TEMPORARILY_REJECTED, "Offboard mode refused: no setpoints to fly");
        }
        self.enter(Mode::Offboard, Maneuver::Stay(self.body.rest()));
        self.intended = Mode::Offboard;
        MavResult::ACCEPTED
    }

    /// Holds the position when the setpoints have expired.
    #[inline(never)]
    pub(super) fn watch_setpoints(&mut self, cx: &mut Context<'_>) {
        if self.mode == Mode::Offboard && self.course.is_none() {
            self.stop();
            cx.text(MavSeverity::WARNING, "Setpoints lost: holding");
        }
    }

    /// Flies one step as the setpoint asks.
    #[inline(never)]
    pub(super) fn follow_setpoints(&mut self, cx: &mut Context<'_>) {
        let Some(Course { horizontal, vertical, turn }) = self.course else { return };
        let mut next = self.body;
        next.nose = match turn {
            Turn::To(yaw) => self.turn_to(yaw),
            Turn::At(rate) => {
                // `clamp` would panic if the limits were in the wrong order.
                let rate = rate.max(-next.limits.turn).min(next.limits.turn);
                Nose::Turn { remaining: rate * DT, rate: rate.abs() }
            }
        };
        let here = next.position;
        // The vertical speed of both ways of flying is the distance to the goal in each second.
        let down = match vertical {
            Vertical::To(down) => down - here.down,
            Vertical::At(down) => down,
        };
        match horizontal {
            Horizontal::To(north, east) => {
                next.fly(Vector { north, east, down: here.down + down }, self.speed(cx), DT);
            }
            Horizontal::At(north, east) => {
                let speed = sqrtf(north * north + east * east);
                let share = if speed > MAX_SPEED { MAX_SPEED / speed } else { 1.0 };
                next.go(Vector { north: north * share, east: east * share, down }, DT);
            }
        }
        self.advance(cx, next);
    }
}
