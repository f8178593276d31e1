//! The commands that the vehicle obeys, in flight above all; those for the ground are in [`ground`](super::ground).
//!
//! [`COMMANDS`] declares which commands are valid at all: the stack refuses the rest, with a text. Each refusal here has a text
//! with the reason too (C-31). A text that repeats within five seconds is dropped, so refusals cannot flood the operators.

use mavstack::dialect::command_rules as rules;
use mavstack::dialect::commands::{
    ComponentArmDisarm, DoFlighttermination, DoReposition, DoSetHome, NavLand, NavTakeoff,
};
use mavstack::dialect::{MavCmd, MavDoRepositionFlags, MavFrame, MavResult, MavSeverity};
use mavstack::{
    Command, CommandMemory, CommandPolicy, CommandRule, Commands, CustomMode, FlightMode, Item, LatLon, Location,
    ModeRequest, Outcome, ParamRule, Peer,
};

use super::plans::FRAMES;
use super::{Mode, Quadrotor, modes};
use crate::battery::Charge;
use crate::body::Vector;
use crate::plan::{self, Condition, LOWEST, Maneuver, Order};
use crate::tuning::Tuning;

/// MAV_CMD_COMPONENT_ARM_DISARM: parameter 2 that forces it (C-31).
const FORCE: u16 = 21_196;
/// It is told of no higher speed, m/s: the most that `MPC_XY_CRUISE` can be.
const MAX_SPEED: f32 = 25.0;
/// The frame of a take-off in a COMMAND_LONG, which has none (C-6); that of others is GLOBAL.
const ABOVE_HOME: MavFrame = MavFrame::GLOBAL_RELATIVE_ALT;
/// Home is no farther from where it was switched on, m.
const FAR: f32 = 10_000.0;

/// What is narrower than the definitions, or not for every vehicle in reach. Who disarms all of those has a reason; to arm
/// them is refused with a text.
const COMMANDS: &[CommandPolicy] = &[
    CommandPolicy::new(rules::COMPONENT_ARM_DISARM),
    located(rules::NAV_TAKEOFF.altitude_optional()).long_frame(ABOVE_HOME),
    // No landing by a beacon; "if there is one" will do.
    located(rules::NAV_LAND.with_params(&[ParamRule::integers(2, 0, 1).or_nan()]).altitude_optional()),
    CommandPolicy::new(rules::NAV_RETURN_TO_LAUNCH).no_broadcast(),
    // The nose as it is, or so far from north.
    located(rules::DO_REPOSITION.with_params(&[ParamRule::range(1, -1.0, MAX_SPEED).or_nan(), ParamRule::bits(2, 1)])),
    // The horizontal speed, and no throttle.
    CommandPolicy::new(rules::DO_CHANGE_SPEED.with_params(&[
        ParamRule::integers(1, 0, 1),
        ParamRule::range(2, -2.0, MAX_SPEED),
        ParamRule::integers(3, -2, 0).or_nan(),
    ]))
    .no_broadcast(),
    // Some of its turns begin where the nose is: twice is twice as far (C-12).
    CommandPolicy::new(rules::CONDITION_YAW).no_broadcast().once(),
    // The ground is level, and the nose points nowhere special.
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
    CommandPolicy::new(super::ground::CALIBRATION).no_broadcast(),
    CommandPolicy::new(super::ground::REBOOT).no_broadcast(),
];

const fn located(rule: CommandRule) -> CommandPolicy {
    CommandPolicy::new(rule.with_frames(FRAMES)).no_broadcast()
}

impl Commands for Quadrotor {
    const COMMANDS: &'static [CommandPolicy] = COMMANDS;
    const MODES: &'static [FlightMode] = modes::TABLE;
    const CUSTOM_MODE: CustomMode = CustomMode::MainSub;

    fn command(&mut self, command: &Command) -> Outcome {
        self.obey(command).unwrap_or_else(Outcome::from)
    }

    fn command_memory(&mut self) -> Option<&mut CommandMemory> {
        Some(&mut self.commands)
    }

    fn set_mode(&mut self, mode: &'static FlightMode, request: &ModeRequest) -> Outcome {
        let mode = Mode::ALL.into_iter().find(|ours| ours.number() == mode.custom_mode);
        if mode.is_some_and(Mode::leaves_ground) && self.may_be_late(request.class) {
            return self.refuse(MavResult::DENIED, "Mode refused: by satellite").into();
        }
        mode.map_or(MavResult::UNSUPPORTED, |mode| self.change_mode(mode)).into()
    }

    fn intended_mode(&self) -> u32 {
        self.intended.number()
    }

    fn cancel_command(&mut self, command: MavCmd, _from: Peer) -> bool {
        self.cancel_calibration(command)
    }
}

impl Quadrotor {
    fn obey(&mut self, command: &Command) -> Result<Outcome, MavResult> {
        if self.is_going_down() && command.id != MavCmd::PREFLIGHT_REBOOT_SHUTDOWN {
            return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, "Refused: rebooting"));
        }
        let [_, p2, ..] = command.params;
        let result = match command.id {
            MavCmd::COMPONENT_ARM_DISARM => self.arm_disarm(command)?,
            MavCmd::NAV_TAKEOFF if self.may_be_late(command.class) => {
                self.refuse(MavResult::DENIED, "Takeoff refused: by satellite")
            }
            MavCmd::NAV_TAKEOFF => self.take_off(command)?,
            MavCmd::NAV_LAND => self.land(command)?,
            MavCmd::NAV_RETURN_TO_LAUNCH => self.start(Mode::Return, Maneuver::Return),
            MavCmd::DO_REPOSITION => self.reposition(command)?,
            MavCmd::DO_CHANGE_SPEED => self.change_speed(p2),
            MavCmd::CONDITION_YAW => self.turn(command),
            MavCmd::DO_SET_HOME => self.set_home(command)?,
            MavCmd::DO_FLIGHTTERMINATION => self.terminate(command)?,
            MavCmd::RUN_PREARM_CHECKS => self.run_checks(),
            MavCmd::PREFLIGHT_CALIBRATION => return self.calibrate(command),
            MavCmd::PREFLIGHT_REBOOT_SHUTDOWN => self.ask_reboot(command)?,
            _ => MavResult::UNSUPPORTED,
        };
        Ok(result.into())
    }

    // None of those who decode is inlined: each takes room on the stack for its own parameters, and one at a time.

    #[inline(never)]
    fn arm_disarm(&mut self, command: &Command) -> Result<MavResult, MavResult> {
        let ComponentArmDisarm { arm, force } = command.decode()?;
        let is_forced = force == Some(FORCE);
        if !arm {
            if self.armed && !self.is_landed() && !is_forced {
                return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, "Disarming refused: flying"));
            }
            self.disarm();
            return Ok(MavResult::ACCEPTED);
        }
        if command.is_broadcast {
            return Err(self.refuse(MavResult::DENIED, "Arming refused: sent to all vehicles"));
        }
        if self.may_be_late(command.class) {
            return Err(self.refuse(MavResult::DENIED, "Arming refused: by satellite"));
        }
        if let Err(why) = self.check_arming() {
            if self.is_terminated {
                return Err(self.refuse(MavResult::FAILED, why));
            }
            // No force makes sensors that are being calibrated useful.
            if !self.armed && (!is_forced || self.is_calibrating()) {
                return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, why));
            }
        }
        if !self.armed {
            self.armed = true;
            self.times.armed = self.time;
        }
        Ok(MavResult::ACCEPTED)
    }

    /// What is in the way of arming.
    pub(crate) fn check_arming(&self) -> Result<(), &'static str> {
        let least = self.tuning.get(Tuning::COM_ARM_BAT_MIN);
        if self.is_terminated {
            return Err("Arming refused: flight terminated");
        }
        if self.is_calibrating() {
            return Err("Arming refused: calibrating");
        }
        if !self.has_fix() && self.tuning.get(Tuning::COM_ARM_WO_GPS) == 0 {
            return Err("Arming refused: no GPS fix yet");
        }
        if self.is_outside {
            return Err("Arming refused: outside the fence");
        }
        // It acts on a battery that becomes critical in flight, and on none that was.
        let is_spent = self.battery.charge == Charge::Critical && self.tuning.get(Tuning::COM_LOW_BAT_ACT) != 0;
        if self.battery.remaining < least || is_spent {
            return Err("Arming refused: battery low");
        }
        Ok(())
    }

    /// MAV_CMD_RUN_PREARM_CHECKS: a text says what is in the way of arming.
    fn run_checks(&mut self) -> MavResult {
        match self.check_arming() {
            _ if self.armed => return self.refuse(MavResult::TEMPORARILY_REJECTED, "Checks refused: armed"),
            Ok(()) => self.say(MavSeverity::INFO, "Ready to arm"),
            Err(why) => self.say(MavSeverity::WARNING, why),
        }
        MavResult::ACCEPTED
    }

    pub(super) fn disarm(&mut self) {
        self.hold();
        self.speed = None;
        self.armed = false;
    }

    /// MAV_CMD_DO_FLIGHTTERMINATION: the motors are off until it is switched on again.
    #[inline(never)]
    fn terminate(&mut self, command: &Command) -> Result<MavResult, MavResult> {
        let DoFlighttermination { terminate } = command.decode()?;
        if terminate != 1 {
            return match self.is_terminated {
                true => Err(self.refuse(MavResult::DENIED, "Refused: flight terminated; switch it off and on")),
                false => Ok(MavResult::ACCEPTED),
            };
        }
        if !self.is_terminated {
            self.is_terminated = true;
            self.disarm();
            self.say(MavSeverity::EMERGENCY, "Flight terminated");
        }
        Ok(MavResult::ACCEPTED)
    }

    #[inline(never)]
    fn take_off(&mut self, command: &Command) -> Result<MavResult, MavResult> {
        let command: NavTakeoff = command.decode()?;
        let location = &command.location;
        // 0 is what some send who leave it to us (C-8).
        let to = match location.altitude.filter(|&altitude| altitude != 0.0) {
            Some(altitude) => self.destination(location, location.frame.unwrap_or(ABOVE_HOME), Some(altitude)),
            None => self.destination(location, ABOVE_HOME, Some(self.takeoff_altitude())),
        };
        let to = to.map_err(|result| self.refuse(result, "Takeoff refused: under the ground"))?;
        let result = self.start(Mode::Takeoff, Maneuver::Climb(to));
        Ok(self.point(result, command.yaw.map(f32::to_radians)))
    }

    #[inline(never)]
    fn land(&mut self, command: &Command) -> Result<MavResult, MavResult> {
        let command: NavLand = command.decode()?;
        // How high the ground is it feels.
        let to = self.destination(&command.location, ABOVE_HOME, None)?;
        let result = self.start(Mode::Land, Maneuver::Land(to));
        Ok(self.point(result, command.yaw_angle.map(f32::to_radians)))
    }

    /// MAV_CMD_DO_REPOSITION: to a place, at a height, at a speed, where they are given; and stays there.
    #[inline(never)]
    fn reposition(&mut self, command: &Command) -> Result<MavResult, MavResult> {
        let DoReposition { speed, bitmask, yaw, location, .. } = command.decode()?;
        let to = self.destination(&location, location.frame.unwrap_or(MavFrame::GLOBAL), location.altitude);
        let to = to.map_err(|result| self.refuse(result, "Goto refused: under the ground"))?;
        if self.armed && self.is_landed() {
            return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, "Goto refused: on the ground"));
        }
        if self.mode != Mode::Hold && !bitmask.contains(MavDoRepositionFlags::CHANGE_MODE) {
            return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, "Goto refused: not holding"));
        }
        let radius = self.tuning.get(Tuning::NAV_ACC_RAD);
        let result = self.start(Mode::Hold, Maneuver::Reach { to, radius });
        if result == MavResult::ACCEPTED {
            // Less is "as it is".
            self.speed = speed.filter(|&speed| speed > 0.0).or(self.speed);
        }
        Ok(self.point(result, yaw))
    }

    /// MAV_CMD_DO_CHANGE_SPEED: until it lands, or the next mission begins.
    fn change_speed(&mut self, speed: f32) -> MavResult {
        // -1 keeps it, -2 is the default; there is nothing between them, and at 0 it would never arrive.
        self.speed = match speed {
            -2.0 => None,
            -1.0 => self.speed,
            _ if speed > 0.0 => Some(speed),
            _ => return self.refuse(MavResult::DENIED, "Speed refused: above 0, or -1, or -2"),
        };
        MavResult::ACCEPTED
    }

    /// MAV_CMD_CONDITION_YAW, outside of a mission.
    #[inline(never)]
    fn turn(&mut self, command: &Command) -> MavResult {
        if self.mode != Mode::Hold || self.is_landed() {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Turn refused: not holding in the air");
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
        if let Order::Wait(Condition::Turn(nose)) = plan::order(&item, &self.situation()) {
            self.body.nose = nose;
        }
        MavResult::ACCEPTED
    }

    /// MAV_CMD_DO_SET_HOME: here, or at a place that is given as a whole.
    #[inline(never)]
    fn set_home(&mut self, command: &Command) -> Result<MavResult, MavResult> {
        let command: DoSetHome = command.decode()?;
        if !self.has_fix() {
            return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, "Home refused: no GPS fix yet"));
        }
        let spot = if command.use_current {
            self.body.position
        } else {
            let Location { position, altitude, frame } = command.location;
            let frame = frame.unwrap_or(MavFrame::GLOBAL);
            let height = altitude.and_then(|altitude| self.home.to_height(frame, altitude));
            let (Some(position), Some(height)) = (position, height) else {
                return Err(self.refuse(MavResult::DENIED, "Home refused: give latitude, longitude, altitude"));
            };
            let (north, east) = self.home.to_local(position.latitude, position.longitude);
            Vector { north, east, down: -height }
        };
        if spot.distance(Vector::ZERO) > FAR || spot.down.abs() > FAR {
            return Err(self.refuse(MavResult::DENIED, "Home refused: too far"));
        }
        let far = self.tuning.get(Tuning::GF_MAX_HOR_DIST);
        let high = self.tuning.get(Tuning::GF_MAX_VER_DIST);
        let home = self.home.moved_to(spot);
        if self.armed && !home.is_near(far, high, self.body.position) {
            return Err(self.refuse(MavResult::DENIED, "Home refused: the fence around it"));
        }
        self.home = home;
        self.has_new_home = true;
        Ok(MavResult::ACCEPTED)
    }

    pub(super) fn start(&mut self, mode: Mode, maneuver: Maneuver) -> MavResult {
        // On the ground it lands where it stands, and disarms as after every landing.
        let maneuver = match mode == Mode::Land && self.is_landed() {
            true if !self.armed => return MavResult::ACCEPTED,
            true => Maneuver::Land(self.body.rest()),
            false => maneuver,
        };
        if !self.armed {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Refused: not armed");
        }
        // Who wants it back does not want it to take off.
        if mode == Mode::Return && self.is_landed() {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Return refused: on the ground");
        }
        self.enter(mode, maneuver);
        self.intended = mode;
        MavResult::ACCEPTED
    }

    /// Above home, m.
    pub(super) fn takeoff_altitude(&self) -> f32 {
        self.tuning.get(Tuning::MIS_TAKEOFF_ALT)
    }

    /// The place that a command names, at an altitude: what is left open is where we come to rest. DENIED when it is under
    /// the ground.
    fn destination(&self, location: &Location, frame: MavFrame, altitude: Option<f32>) -> Result<Vector, MavResult> {
        let here = self.body.rest();
        let down = match altitude.map(|altitude| self.home.to_height(frame, altitude)) {
            None => here.down,
            Some(Some(height)) if height > 0.0 => -height.max(LOWEST),
            Some(_) => return Err(MavResult::DENIED),
        };
        Ok(match location.position {
            // A client that fills what it does not use with zeros means no place in the Gulf of Guinea.
            None | Some(LatLon { latitude: 0, longitude: 0 }) => Vector { down, ..here },
            Some(LatLon { latitude, longitude }) => {
                let (north, east) = self.home.to_local(latitude, longitude);
                Vector { north, east, down }
            }
        })
    }

    /// Where a command that was accepted wants the nose to point: rad from north; `None` leaves it to us.
    fn point(&mut self, result: MavResult, yaw: Option<f32>) -> MavResult {
        if let Some(yaw) = yaw
            && result == MavResult::ACCEPTED
        {
            self.body.nose = plan::turn_to(yaw, &self.situation());
        }
        result
    }

    pub(super) fn refuse(&mut self, result: MavResult, why: &'static str) -> MavResult {
        self.say(MavSeverity::WARNING, why);
        result
    }
}
