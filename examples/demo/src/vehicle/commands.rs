//! Commands, mainly those for flight. Commands for the ground are in [`ground`](super::ground).
//!
//! [`POLICIES`] declares the rules for commands. The stack refuses a command that violates them, with a text. Each refusal in
//! this file sends a text with the reason too (C-31). The stack drops a text that repeats within two seconds, so refusals
//! cannot flood the operator. A repeated command does no harm (C-11).

use mavstack::camera::CameraOrder;
use mavstack::command::CommandPolicy;
use mavstack::dialect::commands::{
    ComponentArmDisarm, DoFlighttermination, DoReposition, DoSetHome, NavLand, NavTakeoff,
};
use mavstack::dialect::rules;
use mavstack::dialect::{HomePosition, MavCmd, MavDoRepositionFlags, MavFrame, MavResult, MavSeverity};
use mavstack::message::{LatLon, Location, ParamRule};
use mavstack::{Command, CommandRule, Commands, Context, Item, Outcome, Peer};

use super::plans::FRAMES;
use super::{Mode, Quadrotor};
use crate::body::{Nose, Vector};
use crate::plan::{self, Action, Condition, MIN_HEIGHT, Maneuver};
use crate::tuning::Tuning;

/// Parameter 2 of MAV_CMD_COMPONENT_ARM_DISARM that forces arming or disarming (C-31).
const FORCE: u16 = 21_196;
/// Maximum speed that a command or a setpoint may set (m/s): the maximum of `MPC_XY_CRUISE`.
pub(super) const MAX_SPEED: f32 = 25.0;
/// Frame of a takeoff in COMMAND_LONG, which has no frame field (C-6). Other commands use GLOBAL.
const ABOVE_HOME: MavFrame = MavFrame::GLOBAL_RELATIVE_ALT;
/// Maximum distance of home from the position at boot (m), horizontally and vertically.
const MAX_HOME_DISTANCE: f32 = 10_000.0;

/// Commands with narrower rules than their definitions, or that refuse broadcasts. A broadcast may disarm all vehicles in an
/// emergency; a broadcast to arm is refused with a text.
const POLICIES: &[CommandPolicy] = &[
    CommandPolicy::new(rules::COMPONENT_ARM_DISARM),
    located(rules::NAV_TAKEOFF.altitude_optional()).long_frame(ABOVE_HOME),
    // Precision landing: off or opportunistic. The vehicle has no beacon receiver.
    located(rules::NAV_LAND.with_params(&[ParamRule::integers(2, 0, 1).or_nan()]).altitude_optional()),
    CommandPolicy::new(rules::NAV_RETURN_TO_LAUNCH).no_broadcast(),
    // The yaw is absolute or omitted.
    located(rules::DO_REPOSITION.with_params(&[ParamRule::range(1, -1.0, MAX_SPEED).or_nan(), ParamRule::bits(2, 1)])),
    // Horizontal speed only, without a throttle setting.
    CommandPolicy::new(rules::DO_CHANGE_SPEED.with_params(&[
        ParamRule::integers(1, 0, 1),
        ParamRule::range(2, -2.0, MAX_SPEED),
        ParamRule::integers(3, -2, 0).or_nan(),
    ]))
    .no_broadcast(),
    // `once` because relative turns are not idempotent: a duplicate would turn twice as far (C-12).
    CommandPolicy::new(rules::CONDITION_YAW).no_broadcast().once(),
    // Roll, pitch and yaw of the surface are not supported.
    located(rules::DO_SET_HOME.with_params(&[
        ParamRule::integers(2, 0, 0).or_nan(),
        ParamRule::integers(3, 0, 0).or_nan(),
        ParamRule::integers(4, 0, 0).or_nan(),
    ])),
    CommandPolicy::new(rules::DO_SET_MODE).no_broadcast(),
    // The stack checks the item.
    CommandPolicy::new(rules::DO_SET_MISSION_CURRENT.with_params(&[ParamRule::any(1), ParamRule::any(2)]))
        .no_broadcast(),
    CommandPolicy::new(rules::DO_SET_STANDARD_MODE).no_broadcast(),
    CommandPolicy::new(rules::DO_FLIGHTTERMINATION).no_broadcast(),
    CommandPolicy::new(rules::DO_GIMBAL_MANAGER_PITCHYAW).no_broadcast(),
    CommandPolicy::new(rules::DO_SET_CAM_TRIGG_DIST).no_broadcast(),
    // `once` because a duplicate would take another image (C-12).
    CommandPolicy::new(rules::DO_DIGICAM_CONTROL).no_broadcast().once(),
    CommandPolicy::new(super::plans::SET_SERVO).no_broadcast(),
    CommandPolicy::new(rules::DO_LAND_START).no_broadcast(),
    CommandPolicy::new(super::ground::CALIBRATION).no_broadcast(),
    CommandPolicy::new(super::ground::REBOOT).no_broadcast(),
];

const fn located(rule: CommandRule) -> CommandPolicy {
    CommandPolicy::new(rule.with_frames(FRAMES)).no_broadcast()
}

impl Commands for Quadrotor {
    const POLICIES: &'static [CommandPolicy] = POLICIES;

    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        self.execute(cx, command).unwrap_or_else(Outcome::from)
    }

    fn cancel_command(&mut self, cx: &mut Context<'_>, command: MavCmd, _from: Peer) -> bool {
        match command {
            MavCmd::COMPONENT_ARM_DISARM => self.cancel_authorisation(cx),
            _ => self.cancel_calibration(cx, command),
        }
    }
}

impl Quadrotor {
    fn execute(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<Outcome, MavResult> {
        if self.is_rebooting() && command.id != MavCmd::PREFLIGHT_REBOOT_SHUTDOWN {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Command refused: rebooting"));
        }
        let [p1, p2, p3, _] = command.params;
        let result = match command.id {
            MavCmd::COMPONENT_ARM_DISARM => return self.arm_disarm(cx, command),
            MavCmd::NAV_TAKEOFF if self.may_be_delayed(command.class) => {
                refuse(cx, MavResult::DENIED, "Takeoff refused: sent by satellite; use the radio")
            }
            MavCmd::NAV_TAKEOFF => self.take_off(cx, command)?,
            MavCmd::NAV_LAND => self.land(cx, command)?,
            MavCmd::NAV_RETURN_TO_LAUNCH => self.start(cx, Mode::Return, Maneuver::Return),
            MavCmd::DO_REPOSITION => self.reposition(cx, command)?,
            MavCmd::DO_CHANGE_SPEED => self.change_speed(cx, p2),
            MavCmd::CONDITION_YAW => self.turn(cx, command),
            MavCmd::DO_SET_HOME => self.set_home(cx, command)?,
            MavCmd::DO_FLIGHTTERMINATION => self.terminate(cx, command)?,
            MavCmd::DO_GIMBAL_MANAGER_PITCHYAW if !self.has_components && !self.payload.has_gimbal() => {
                MavResult::UNSUPPORTED
            }
            MavCmd::DO_GIMBAL_MANAGER_PITCHYAW => self.point_gimbal(cx, command)?,
            MavCmd::DO_SET_CAM_TRIGG_DIST | MavCmd::DO_DIGICAM_CONTROL if !self.has_components => {
                MavResult::UNSUPPORTED
            }
            MavCmd::DO_SET_CAM_TRIGG_DIST => {
                self.trigger_by_distance(p1, p3);
                MavResult::ACCEPTED
            }
            // MAVProxy asks the autopilot for an image.
            MavCmd::DO_DIGICAM_CONTROL if command.position.params().0 != 1.0 => MavResult::UNSUPPORTED,
            MavCmd::DO_DIGICAM_CONTROL if self.operate_camera_by(CameraOrder::TakeImage) => MavResult::ACCEPTED,
            MavCmd::DO_DIGICAM_CONTROL => {
                refuse(cx, MavResult::TEMPORARILY_REJECTED, "Image refused: others are pending")
            }
            MavCmd::DO_LAND_START => self.fly_landing(cx),
            MavCmd::DO_SET_SERVO => {
                self.set_servo(p1, p2);
                MavResult::ACCEPTED
            }
            MavCmd::PREFLIGHT_CALIBRATION => return self.calibrate(cx, command),
            MavCmd::PREFLIGHT_REBOOT_SHUTDOWN => self.request_reboot(cx, command)?,
            _ => MavResult::UNSUPPORTED,
        };
        Ok(result.into())
    }

    // Functions that decode parameters are not inlined. Only one of them is on the stack at a time; inlined, their stack frames
    // would add up.

    #[inline(never)]
    fn arm_disarm(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<Outcome, MavResult> {
        let ComponentArmDisarm { arm, force } = command.decode()?;
        let is_forced = force == Some(FORCE);
        if !arm {
            if self.armed && !self.is_landed() && !is_forced {
                return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Disarming refused: in flight"));
            }
            self.disarm();
            return Ok(MavResult::ACCEPTED.into());
        }
        if command.is_broadcast {
            return Err(refuse(cx, MavResult::DENIED, "Arming refused: sent to all vehicles"));
        }
        if self.may_be_delayed(command.class) {
            return Err(refuse(cx, MavResult::DENIED, "Arming refused: sent by satellite; use the radio"));
        }
        if let Err(why) = self.check_arming(cx) {
            if self.is_terminated {
                return Err(refuse(cx, MavResult::FAILED, why));
            }
            // Force does not override a running calibration.
            if !self.armed && (!is_forced || self.is_calibrating()) {
                return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, why));
            }
        }
        if !self.armed {
            if !is_forced && let Some(outcome) = self.request_authorisation(cx) {
                return Ok(outcome);
            }
            self.arm();
        }
        Ok(MavResult::ACCEPTED.into())
    }

    /// Sets the pulse (µs) of a servo, whose number a rule has checked.
    pub(super) fn set_servo(&mut self, number: f32, pulse: f32) {
        let index = (number as usize).wrapping_sub(1);
        if let Some(servo) = self.servos.get_mut(index) {
            *servo = pulse as u16;
        }
    }

    pub(super) fn arm(&mut self) {
        self.armed = true;
        self.times.armed = self.time;
    }

    pub(super) fn disarm(&mut self) {
        self.hold();
        self.speed = None;
        self.armed = false;
    }

    /// MAV_CMD_DO_FLIGHTTERMINATION: stops the motors until the next boot.
    #[inline(never)]
    fn terminate(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<MavResult, MavResult> {
        let DoFlighttermination { terminate } = command.decode()?;
        if terminate != 1 {
            return match self.is_terminated {
                true => Err(refuse(cx, MavResult::DENIED, "Refused: flight terminated; power-cycle to reset")),
                false => Ok(MavResult::ACCEPTED),
            };
        }
        if !self.is_terminated {
            self.is_terminated = true;
            self.disarm();
            cx.text(MavSeverity::EMERGENCY, "Flight terminated");
        }
        Ok(MavResult::ACCEPTED)
    }

    #[inline(never)]
    fn take_off(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<MavResult, MavResult> {
        let NavTakeoff { location, yaw, .. } = command.decode()?;
        let location = &location;
        // Some clients send 0 for the default altitude (C-8).
        let to = match location.altitude.filter(|&altitude| altitude != 0.0) {
            Some(altitude) => self.destination(location, location.frame.unwrap_or(ABOVE_HOME), Some(altitude)),
            None => self.destination(location, ABOVE_HOME, Some(takeoff_altitude(cx))),
        };
        let to = to.map_err(|result| refuse(cx, result, "Takeoff refused: below ground"))?;
        let result = self.start(cx, Mode::Takeoff, Maneuver::Climb(to));
        Ok(self.point(result, yaw.map(f32::to_radians)))
    }

    #[inline(never)]
    fn land(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<MavResult, MavResult> {
        let NavLand { location, yaw_angle, .. } = command.decode()?;
        // The altitude is ignored: the vehicle descends until it touches the ground.
        let to = self.destination(&location, ABOVE_HOME, None)?;
        if !self.armed && self.is_landed() {
            // It has landed (C-11). The mode is another question: `start` refuses it (C-18).
            return Ok(MavResult::ACCEPTED);
        }
        let result = self.start(cx, Mode::Land, Maneuver::Land(to));
        Ok(self.point(result, yaw_angle.map(f32::to_radians)))
    }

    /// MAV_CMD_DO_REPOSITION: flies to a position and holds there. Position, altitude and speed are optional.
    #[inline(never)]
    fn reposition(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<MavResult, MavResult> {
        let DoReposition { speed, bitmask, yaw, location, .. } = command.decode()?;
        let to = self.destination(&location, location.frame.unwrap_or(MavFrame::GLOBAL), location.altitude);
        let to = to.map_err(|result| refuse(cx, result, "Goto refused: below ground"))?;
        if self.armed && self.is_landed() {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Goto refused: on the ground"));
        }
        if self.mode != Mode::Hold && !bitmask.contains(MavDoRepositionFlags::CHANGE_MODE) {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Goto refused: not in Hold mode"));
        }
        let radius = cx.parameter(Tuning::NAV_ACC_RAD);
        let result = self.start(cx, Mode::Hold, Maneuver::Reach { to, radius });
        if result == MavResult::ACCEPTED {
            // 0 or less keeps the speed.
            self.speed = speed.filter(|&speed| speed > 0.0).or(self.speed);
        }
        Ok(self.point(result, yaw))
    }

    /// MAV_CMD_DO_CHANGE_SPEED: sets the speed until landing or the next mission.
    #[inline(never)]
    fn change_speed(&mut self, cx: &mut Context<'_>, speed: f32) -> MavResult {
        // -1 keeps the speed, -2 restores the default. At 0 the vehicle would never arrive.
        self.speed = match speed {
            -2.0 => None,
            -1.0 => self.speed,
            _ if speed > 0.0 => Some(speed),
            _ => return refuse(cx, MavResult::DENIED, "Speed refused: must be above 0, or -1 or -2"),
        };
        MavResult::ACCEPTED
    }

    /// MAV_CMD_CONDITION_YAW outside a mission.
    #[inline(never)]
    fn turn(&mut self, cx: &mut Context<'_>, command: &Command) -> MavResult {
        if self.mode != Mode::Hold || self.is_landed() {
            return refuse(cx, MavResult::TEMPORARILY_REJECTED, "Turn refused: needs Hold mode in the air");
        }
        let item = Item {
            frame: MavFrame::MISSION,
            command: command.id,
            autocontinue: 1,
            params: command.params,
            x: 0,
            y: 0,
            z: 0.0,
        };
        if let Action::Wait(Condition::Turn(nose)) = plan::action(&item, &self.situation(cx)) {
            self.body.nose = nose;
        }
        MavResult::ACCEPTED
    }

    /// MAV_CMD_DO_SET_HOME: sets home to the current position, or to a complete position.
    #[inline(never)]
    fn set_home(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<MavResult, MavResult> {
        let command: DoSetHome = command.decode()?;
        if !self.last.has_fix {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Home refused: no GPS fix yet"));
        }
        let spot = if command.use_current {
            self.body.position
        } else {
            let Location { position, altitude, frame } = command.location;
            let frame = frame.unwrap_or(MavFrame::GLOBAL);
            let height = altitude.and_then(|altitude| self.home.to_height(frame, altitude));
            let (Some(position), Some(height)) = (position, height) else {
                return Err(refuse(cx, MavResult::DENIED, "Home refused: needs latitude, longitude, altitude"));
            };
            let (north, east) = self.home.to_local(position.latitude, position.longitude);
            Vector { north, east, down: -height }
        };
        if spot.distance(Vector::ZERO) > MAX_HOME_DISTANCE || spot.down.abs() > MAX_HOME_DISTANCE {
            return Err(refuse(cx, MavResult::DENIED, "Home refused: too far away"));
        }
        let far = cx.parameter(Tuning::GF_MAX_HOR_DIST);
        let high = cx.parameter(Tuning::GF_MAX_VER_DIST);
        let home = self.home.moved_to(spot);
        if self.armed && !home.is_near(far, high, self.body.position) {
            return Err(refuse(cx, MavResult::DENIED, "Home refused: its fence excludes the vehicle"));
        }
        self.home = home;
        cx.announce::<HomePosition, Self>();
        Ok(MavResult::ACCEPTED)
    }

    #[inline(never)]
    pub(super) fn start(&mut self, cx: &mut Context<'_>, mode: Mode, maneuver: Maneuver) -> MavResult {
        if !self.armed {
            return refuse(cx, MavResult::TEMPORARILY_REJECTED, "Command refused: not armed");
        }
        // On the ground it lands in place, and disarms as after any landing.
        let maneuver = match mode == Mode::Land && self.is_landed() {
            true => Maneuver::Land(self.body.rest()),
            false => maneuver,
        };
        // A return must not cause a takeoff.
        if mode == Mode::Return && self.is_landed() {
            return refuse(cx, MavResult::TEMPORARILY_REJECTED, "Return refused: on the ground");
        }
        self.enter(mode, maneuver);
        self.intended = mode;
        MavResult::ACCEPTED
    }

    /// Returns the position in a command, at `altitude`. Omitted values are those of the point where the vehicle comes to rest.
    ///
    /// # Errors
    ///
    /// DENIED when the position is below ground.
    #[inline(never)]
    fn destination(&self, location: &Location, frame: MavFrame, altitude: Option<f32>) -> Result<Vector, MavResult> {
        let here = self.body.rest();
        let down = match altitude.map(|altitude| self.home.to_height(frame, altitude)) {
            None => here.down,
            Some(Some(height)) if height > 0.0 => -height.max(MIN_HEIGHT),
            Some(_) => return Err(MavResult::DENIED),
        };
        Ok(match location.position {
            // Zeros mean "not given": clients fill unused fields with them.
            None | Some(LatLon { latitude: 0, longitude: 0 }) => Vector { down, ..here },
            Some(LatLon { latitude, longitude }) => {
                let (north, east) = self.home.to_local(latitude, longitude);
                Vector { north, east, down }
            }
        })
    }

    /// Turns the nose to `yaw` (rad from north) if the command was accepted; `None` leaves the heading to the vehicle.
    #[inline(never)]
    fn point(&mut self, result: MavResult, yaw: Option<f32>) -> MavResult {
        if let Some(yaw) = yaw
            && result == MavResult::ACCEPTED
        {
            self.body.nose = self.turn_to(yaw);
        }
        result
    }

    /// Returns the turn to the heading `yaw` (rad from north).
    pub(super) fn turn_to(&self, yaw: f32) -> Nose {
        plan::turn_to(yaw, self.body.yaw(), self.body.limits.turn)
    }
}

/// Returns the default takeoff altitude (m above home).
pub(super) fn takeoff_altitude(cx: &Context<'_>) -> f32 {
    cx.parameter(Tuning::MIS_TAKEOFF_ALT)
}

/// Sends a text with the reason of a refusal, and returns `result`.
#[inline(never)]
pub(super) fn refuse(cx: &mut Context<'_>, result: MavResult, why: &str) -> MavResult {
    cx.text(MavSeverity::WARNING, why);
    result
}
