//! The commands that the vehicle obeys at once.

use mavstack::dialect::{MavCmd, MavFrame, MavResult, MavSeverity};
use mavstack::{Command, CommandPosition, Commands, Outcome};

use super::{Mode, Quadrotor};
use crate::body::Vector;
use crate::plan::Maneuver;
use crate::tuning::Tuning;

/// MAV_CMD_COMPONENT_ARM_DISARM: parameter 2 that forces it (C-31).
const FORCE: f32 = 21_196.0;

impl Commands for Quadrotor {
    fn command(&mut self, command: &Command) -> Outcome {
        let [p1, p2, ..] = command.params;
        let result = match command.id {
            MavCmd::COMPONENT_ARM_DISARM => self.arm_disarm(p1, p2, command.is_broadcast),
            MavCmd::NAV_TAKEOFF => self.take_off(command),
            MavCmd::NAV_LAND => self.start(Mode::Land, Maneuver::Land(self.place(command))),
            MavCmd::NAV_RETURN_TO_LAUNCH => self.start(Mode::Return, Maneuver::Return),
            MavCmd::DO_SET_MODE => self.set_mode(command),
            _ => MavResult::UNSUPPORTED,
        };
        result.into()
    }
}

impl Quadrotor {
    fn arm_disarm(&mut self, p1: f32, p2: f32, is_broadcast: bool) -> MavResult {
        let is_forced = p2 == FORCE;
        if !(is_forced || is_default(p2)) {
            return MavResult::DENIED;
        }
        if p1 == 0.0 {
            if self.armed && !self.is_landed() && !is_forced {
                return self.refuse(MavResult::DENIED, "Disarming refused: flying");
            }
            self.hold();
            self.armed = false;
        } else if p1 == 1.0 {
            if is_broadcast {
                return self.refuse(MavResult::DENIED, "Arming refused: sent to all vehicles");
            }
            if !self.has_fix() && self.tuning.get(Tuning::COM_ARM_WO_GPS) == 0 && !is_forced {
                return self.refuse(MavResult::TEMPORARILY_REJECTED, "Arming refused: no GPS fix yet");
            }
            if !self.armed && self.is_outside && !is_forced {
                return self.refuse(MavResult::TEMPORARILY_REJECTED, "Arming refused: outside the fence");
            }
            let least = f32::from(self.tuning.get(Tuning::COM_ARM_BAT_MIN)) / 100.0;
            if !self.armed && self.battery.remaining < least && !is_forced {
                return self.refuse(MavResult::TEMPORARILY_REJECTED, "Arming refused: battery low");
            }
            self.armed = true;
        } else {
            return MavResult::DENIED;
        }
        MavResult::ACCEPTED
    }

    fn take_off(&mut self, command: &Command) -> MavResult {
        // COMMAND_LONG has no frame; its altitude is taken as above home.
        let frame = match command.position {
            CommandPosition::Long { .. } => MavFrame::GLOBAL_RELATIVE_ALT,
            CommandPosition::Int { frame, .. } => frame,
        };
        if self.home.to_height(frame, 0.0).is_none() {
            return MavResult::COMMAND_UNSUPPORTED_MAV_FRAME;
        }
        let height =
            if is_default(command.z) { Some(self.takeoff_height()) } else { self.home.to_height(frame, command.z) };
        match height {
            Some(height) if height > 0.0 => {
                self.start(Mode::Takeoff, Maneuver::Climb(Vector { down: -height, ..self.place(command) }))
            }
            _ => MavResult::DENIED,
        }
    }

    /// MAV_CMD_DO_SET_MODE: a main mode and a sub-mode, or a whole `custom_mode` in the first of them.
    fn set_mode(&mut self, command: &Command) -> MavResult {
        let [base, custom, sub, _] = command.params;
        let is_custom = whole(base).is_some_and(|base| base & 1 != 0);
        let sub = if sub.is_nan() { Some(0) } else { whole(sub) };
        let number = match (whole(custom), sub) {
            (Some(main @ ..=255), Some(sub @ ..=255)) => Some(main << 16 | sub << 24),
            (whole, Some(0)) => whole,
            _ => None,
        };
        let mode = Mode::ALL.into_iter().find(|mode| Some(mode.number()) == number);
        let Some(mode) = mode.filter(|_| is_custom) else { return MavResult::DENIED };
        let here = self.body.rest();
        match mode {
            Mode::Hold => {
                self.hold();
                MavResult::ACCEPTED
            }
            Mode::Takeoff => {
                let down = here.down.min(-self.takeoff_height());
                self.start(mode, Maneuver::Climb(Vector { down, ..here }))
            }
            Mode::Mission => self.fly_on(),
            Mode::Return => self.start(mode, Maneuver::Return),
            Mode::Land => self.start(mode, Maneuver::Land(here)),
        }
    }

    pub(super) fn start(&mut self, mode: Mode, maneuver: Maneuver) -> MavResult {
        if mode == Mode::Land && self.is_landed() {
            return MavResult::ACCEPTED;
        }
        if !self.armed {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Refused: not armed");
        }
        self.enter(mode, maneuver);
        MavResult::ACCEPTED
    }

    fn takeoff_height(&self) -> f32 {
        self.tuning.get(Tuning::MIS_TAKEOFF_ALT)
    }

    /// The place that a command names, at our height; where we come to rest, when it names none.
    fn place(&self, command: &Command) -> Vector {
        let here = self.body.rest();
        match command.position.lat_lon() {
            // A client that fills what it does not use with zeros means no place in the Gulf of Guinea.
            (Some(latitude), Some(longitude)) if (latitude, longitude) != (0, 0) => {
                let (north, east) = self.home.to_local(latitude, longitude);
                Vector { north, east, ..here }
            }
            _ => here,
        }
    }

    pub(super) fn refuse(&mut self, result: MavResult, why: &'static str) -> MavResult {
        self.say(MavSeverity::WARNING, why);
        result
    }
}

/// Whether a parameter is left to us (C-8).
fn is_default(parameter: f32) -> bool {
    parameter == 0.0 || parameter.is_nan()
}

/// The whole number that a parameter holds, if it is one (C-9).
fn whole(parameter: f32) -> Option<u32> {
    let whole = parameter as u32;
    (whole as f32 == parameter).then_some(whole)
}
