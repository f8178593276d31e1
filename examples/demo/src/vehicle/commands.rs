//! The commands that the vehicle obeys, in flight above all; those for the ground are in [`ground`](super::ground).
//!
//! What a command may be at all is in [`COMMANDS`]: the stack refuses the rest. Refusals of what may be asked for, but not
//! now, are told by a text with the reason (C-31).

use mavstack::dialect::command_rules as rules;
use mavstack::dialect::{MavCmd, MavFrame, MavResult, MavSeverity};
use mavstack::{
    Command, CommandMemory, CommandPolicy, CommandPosition, CommandRule, Commands, CustomMode, FlightMode, Item,
    ModeRequest, Outcome, ParamRule, Peer,
};

use super::plans::FRAMES;
use super::{Mode, Quadrotor, modes};
use crate::body::Vector;
use crate::plan::{self, Condition, LOWEST, Maneuver, Order};
use crate::tuning::Tuning;

/// MAV_CMD_COMPONENT_ARM_DISARM: parameter 2 that forces it (C-31).
const FORCE: i32 = 21_196;
/// It is told of no higher speed, m/s: the most that `MPC_XY_CRUISE` can be.
const MAX_SPEED: f32 = 25.0;
/// Home is no farther from where it was switched on, m.
const FAR: f32 = 10_000.0;

/// In the form that MAVSDK and QGroundControl send them: NaN for what they leave open (C-8).
const COMMANDS: &[CommandPolicy] = &[
    // Whoever disarms all vehicles in reach has a reason.
    CommandPolicy::new(
        rules::COMPONENT_ARM_DISARM
            .with_params(&[ParamRule::integers(1, 0, 1), ParamRule::one_of(2, &[0, FORCE]).or_nan()]),
    ),
    // A COMMAND_LONG has no frame; its altitude is taken as above home.
    located(rules::NAV_TAKEOFF.altitude_optional()).long_frame(MavFrame::GLOBAL_RELATIVE_ALT),
    // No landing by a beacon; "if there is one" will do.
    located(rules::NAV_LAND.with_params(&[ParamRule::integers(2, 0, 1).or_nan()]).altitude_optional()),
    CommandPolicy::new(rules::NAV_RETURN_TO_LAUNCH).no_broadcast(),
    // The nose as it is, or so far from north.
    located(
        rules::DO_REPOSITION
            .with_params(&[ParamRule::range(1, -1.0, MAX_SPEED).or_nan(), ParamRule::bits(2, 1).or_nan()]),
    ),
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
    CommandPolicy::new(rules::DO_SET_STANDARD_MODE).no_broadcast(),
    CommandPolicy::new(rules::DO_FLIGHTTERMINATION).no_broadcast(),
    CommandPolicy::new(rules::RUN_PREARM_CHECKS),
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
        if self.reboot.is_some() && command.id != MavCmd::PREFLIGHT_REBOOT_SHUTDOWN {
            return MavResult::TEMPORARILY_REJECTED.into();
        }
        let [p1, p2, ..] = command.params;
        let result = match command.id {
            MavCmd::COMPONENT_ARM_DISARM => self.arm_disarm(p1 == 1.0, p2 == FORCE as f32, command.is_broadcast),
            MavCmd::NAV_TAKEOFF => self.take_off(command),
            MavCmd::NAV_LAND => self.land(command),
            MavCmd::NAV_RETURN_TO_LAUNCH => self.start(Mode::Return, Maneuver::Return),
            MavCmd::DO_REPOSITION => self.reposition(command),
            MavCmd::DO_CHANGE_SPEED => self.change_speed(p2),
            MavCmd::CONDITION_YAW => self.turn(command),
            MavCmd::DO_SET_HOME => self.set_home(command, p1 == 1.0),
            MavCmd::DO_FLIGHTTERMINATION => self.terminate(p1 == 1.0),
            MavCmd::RUN_PREARM_CHECKS => self.run_checks(),
            MavCmd::PREFLIGHT_CALIBRATION => return self.calibrate(command),
            MavCmd::PREFLIGHT_REBOOT_SHUTDOWN => self.ask_reboot(command),
            _ => MavResult::UNSUPPORTED,
        };
        result.into()
    }

    fn command_memory(&mut self) -> Option<&mut CommandMemory> {
        Some(&mut self.commands)
    }

    fn set_mode(&mut self, mode: &'static FlightMode, _request: &ModeRequest) -> Outcome {
        let mode = Mode::ALL.into_iter().find(|ours| ours.number() == mode.custom_mode);
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
    fn arm_disarm(&mut self, arms: bool, is_forced: bool, is_broadcast: bool) -> MavResult {
        if !arms {
            if self.armed && !self.is_landed() && !is_forced {
                return self.refuse(MavResult::TEMPORARILY_REJECTED, "Disarming refused: flying");
            }
            self.disarm();
            return MavResult::ACCEPTED;
        }
        if is_broadcast {
            return self.refuse(MavResult::DENIED, "Arming refused: sent to all vehicles");
        }
        if self.is_terminated {
            return self.refuse(MavResult::FAILED, "Arming refused: flight terminated");
        }
        if let Err(why) = self.check_arming()
            && !(self.armed || is_forced)
        {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, why);
        }
        if !self.armed {
            self.armed = true;
            self.times.armed = self.time;
        }
        MavResult::ACCEPTED
    }

    /// What is in the way of arming.
    pub(crate) fn check_arming(&self) -> Result<(), &'static str> {
        let least = f32::from(self.tuning.get(Tuning::COM_ARM_BAT_MIN)) / 100.0;
        if self.is_calibrating() {
            return Err("Arming refused: calibrating");
        }
        if !self.has_fix() && self.tuning.get(Tuning::COM_ARM_WO_GPS) == 0 {
            return Err("Arming refused: no GPS fix yet");
        }
        if self.is_outside {
            return Err("Arming refused: outside the fence");
        }
        if self.battery.remaining < least {
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
    fn terminate(&mut self, terminates: bool) -> MavResult {
        if !terminates {
            return if self.is_terminated { MavResult::DENIED } else { MavResult::ACCEPTED };
        }
        if !self.is_terminated {
            self.is_terminated = true;
            self.disarm();
            self.say(MavSeverity::EMERGENCY, "Flight terminated");
        }
        MavResult::ACCEPTED
    }

    fn take_off(&mut self, command: &Command) -> MavResult {
        let z = if is_default(command.z) { self.takeoff_altitude() } else { command.z };
        let frame = if is_default(command.z) { MavFrame::GLOBAL_RELATIVE_ALT } else { frame(command) };
        let Some(to) = self.destination(command, frame, z) else { return MavResult::DENIED };
        let result = self.start(Mode::Takeoff, Maneuver::Climb(to));
        self.point(result, command.params[3].to_radians())
    }

    fn land(&mut self, command: &Command) -> MavResult {
        // How high the ground is it feels.
        let Some(to) = self.destination(command, MavFrame::GLOBAL, f32::NAN) else { return MavResult::DENIED };
        let result = self.start(Mode::Land, Maneuver::Land(to));
        self.point(result, command.params[3].to_radians())
    }

    /// MAV_CMD_DO_REPOSITION: to a place, at a height, at a speed, where they are given; and stays there.
    fn reposition(&mut self, command: &Command) -> MavResult {
        const CHANGE_MODE: f32 = 1.0;

        let [speed, flags, _, yaw] = command.params;
        let Some(to) = self.destination(command, frame(command), command.z) else {
            return self.refuse(MavResult::DENIED, "Goto refused: under the ground");
        };
        if self.armed && self.is_landed() {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Goto refused: on the ground");
        }
        if self.mode != Mode::Hold && flags != CHANGE_MODE {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Goto refused: not holding");
        }
        let radius = self.tuning.get(Tuning::NAV_ACC_RAD);
        let result = self.start(Mode::Hold, Maneuver::Reach { to, radius });
        if result == MavResult::ACCEPTED && speed > 0.0 {
            self.speed = Some(speed);
        }
        self.point(result, yaw)
    }

    /// MAV_CMD_DO_CHANGE_SPEED: until it lands, or the next mission begins.
    fn change_speed(&mut self, speed: f32) -> MavResult {
        // -1 keeps it, -2 is the default; there is nothing between them, and at 0 it would never arrive.
        self.speed = match speed {
            -2.0 => None,
            -1.0 => self.speed,
            _ if speed > 0.0 => Some(speed),
            _ => return MavResult::DENIED,
        };
        MavResult::ACCEPTED
    }

    /// MAV_CMD_CONDITION_YAW, outside of a mission.
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
    fn set_home(&mut self, command: &Command, is_here: bool) -> MavResult {
        if !self.has_fix() {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Home refused: no GPS fix yet");
        }
        let spot = if is_here {
            self.body.position
        } else {
            let height = self.home.to_height(frame(command), command.z);
            let ((Some(latitude), Some(longitude)), Some(height)) = (command.position.lat_lon(), height) else {
                return MavResult::DENIED;
            };
            let (north, east) = self.home.to_local(latitude, longitude);
            Vector { north, east, down: -height }
        };
        if spot.distance(Vector::ZERO) > FAR || spot.down.abs() > FAR {
            return self.refuse(MavResult::DENIED, "Home refused: too far");
        }
        let far = self.tuning.get(Tuning::GF_MAX_HOR_DIST);
        let high = self.tuning.get(Tuning::GF_MAX_VER_DIST);
        let home = self.home.moved_to(spot);
        if self.armed && !home.is_near(far, high, self.body.position) {
            return self.refuse(MavResult::DENIED, "Home refused: the fence around it");
        }
        self.home = home;
        self.has_new_home = true;
        MavResult::ACCEPTED
    }

    pub(super) fn start(&mut self, mode: Mode, maneuver: Maneuver) -> MavResult {
        if mode == Mode::Land && self.is_landed() {
            return MavResult::ACCEPTED;
        }
        if !self.armed {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Refused: not armed");
        }
        self.enter(mode, maneuver);
        self.intended = mode;
        MavResult::ACCEPTED
    }

    /// Above home, m.
    pub(super) fn takeoff_altitude(&self) -> f32 {
        self.tuning.get(Tuning::MIS_TAKEOFF_ALT)
    }

    /// The place that a command names, at the altitude `z`: what is left open is where we come to rest. `None` when it is
    /// under the ground.
    fn destination(&self, command: &Command, frame: MavFrame, z: f32) -> Option<Vector> {
        let here = self.body.rest();
        let down = match self.home.to_height(frame, z) {
            None => here.down,
            Some(height) if height > 0.0 => -height.max(LOWEST),
            Some(_) => return None,
        };
        Some(match command.position.lat_lon() {
            // A client that fills what it does not use with zeros means no place in the Gulf of Guinea.
            (Some(latitude), Some(longitude)) if (latitude, longitude) != (0, 0) => {
                let (north, east) = self.home.to_local(latitude, longitude);
                Vector { north, east, down }
            }
            _ => Vector { down, ..here },
        })
    }

    /// Where a command that was accepted wants the nose to point: rad from north; NaN leaves it to us.
    fn point(&mut self, result: MavResult, yaw: f32) -> MavResult {
        if result == MavResult::ACCEPTED && yaw.is_finite() {
            self.body.nose = plan::turn_to(yaw, &self.situation());
        }
        result
    }

    pub(super) fn refuse(&mut self, result: MavResult, why: &'static str) -> MavResult {
        self.say(MavSeverity::WARNING, why);
        result
    }
}

/// The frame of a command's position: as [`COMMANDS`] says where it names none.
fn frame(command: &Command) -> MavFrame {
    match command.position {
        CommandPosition::Int { frame, .. } => frame,
        CommandPosition::Long { .. } if command.id == MavCmd::NAV_TAKEOFF => MavFrame::GLOBAL_RELATIVE_ALT,
        CommandPosition::Long { .. } => MavFrame::GLOBAL,
    }
}

/// Whether a parameter is left to us (C-8).
fn is_default(parameter: f32) -> bool {
    parameter == 0.0 || parameter.is_nan()
}
