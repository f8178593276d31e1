//! What is done on the ground: calibrating, and switching off and on again.

use mavstack::dialect::command_rules as rules;
use mavstack::dialect::commands::{PreflightCalibration, PreflightRebootShutdown};
use mavstack::dialect::{MavCmd, MavResult, MavSeverity, RebootShutdownAction, RebootShutdownConditions};
use mavstack::{Command, CommandRule, Duration, Instant, LinkId, Outcome, ParamRule};

use super::Quadrotor;

/// How long it takes to calibrate a sensor.
const TIME: Duration = Duration::from_secs(5);
/// The last byte of an answer is with the receiver after so long, at 2,400 bit/s too.
const LAST_BYTES: Duration = Duration::from_millis(50);
/// Longer than this it does not wait for a line that is stuck.
const PATIENCE: Duration = Duration::from_secs(1);

/// Its sensors: gyroscopes, compass, barometer, accelerometers. No radio, no airspeed, no motors that have to learn.
pub const CALIBRATION: CommandRule = rules::PREFLIGHT_CALIBRATION.with_params(&[
    ParamRule::integers(1, 0, 1),
    ParamRule::integers(2, 0, 1),
    ParamRule::integers(4, 0, 0),
    ParamRule::one_of(5, &[0, 1, 2, 4]),
    ParamRule::integers(6, 0, 0).or_nan(),
    ParamRule::integers(7, 0, 0).or_nan(),
]);

/// The autopilot restarts; it does not switch itself off, nor others.
pub const REBOOT: CommandRule = rules::PREFLIGHT_REBOOT_SHUTDOWN.with_params(&[
    ParamRule::integers(1, 0, 1),
    ParamRule::integers(2, 0, 0).or_nan(),
    ParamRule::integers(3, 0, 0).or_nan(),
]);

/// A reboot that was asked for.
#[derive(Clone, Copy, Debug)]
pub struct Reboot {
    link: LinkId,
    since: Instant,
}

impl Quadrotor {
    /// MAV_CMD_PREFLIGHT_CALIBRATION takes its time, and can be cancelled (C-20, C-23). With all parameters 0, as PX4 has
    /// it, it asks for nothing: one that runs is given up by COMMAND_CANCEL.
    #[inline(never)]
    pub(super) fn calibrate(&mut self, command: &Command) -> Result<Outcome, MavResult> {
        let what: PreflightCalibration = command.decode()?;
        let sensors = [what.gyro_temperature, what.magnetometer.0, what.accelerometer.0];
        if sensors == [0; 3] && !what.ground_pressure {
            return Ok(MavResult::ACCEPTED.into());
        }
        if self.armed {
            return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, "Calibration refused: armed"));
        }
        let outcome = self.commands.start(command);
        if outcome.result == MavResult::IN_PROGRESS {
            self.calibration = Some(self.time);
            self.say(MavSeverity::INFO, "Calibrating: keep it still");
        } else {
            self.refuse(outcome.result, "Calibration refused: busy with other commands");
        }
        Ok(outcome)
    }

    pub(super) fn is_calibrating(&self) -> bool {
        self.calibration.is_some()
    }

    pub(super) fn watch_calibration(&mut self) {
        const COMMAND: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;

        let Some(since) = self.calibration else { return };
        let passed = self.time.since(since);
        if passed < TIME {
            let percent = 100 * passed.as_millis() / const { TIME.as_millis() };
            return self.commands.progress(COMMAND, percent as u8);
        }
        self.calibration = None;
        self.commands.finish(COMMAND, MavResult::ACCEPTED);
        self.say(MavSeverity::INFO, "Calibrated");
    }

    pub(super) fn cancel_calibration(&mut self, command: MavCmd) -> bool {
        let is_given_up = command == MavCmd::PREFLIGHT_CALIBRATION && self.calibration.take().is_some();
        if is_given_up {
            self.say(MavSeverity::INFO, "Calibration cancelled");
        }
        is_given_up
    }

    /// MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN. In the air it is refused, forced or not (SEC-13).
    #[inline(never)]
    pub(super) fn ask_reboot(&mut self, command: &Command) -> Result<MavResult, MavResult> {
        let what: PreflightRebootShutdown = command.decode()?;
        if what.autopilot != RebootShutdownAction::REBOOT || self.reboot.is_some() {
            return Ok(MavResult::ACCEPTED);
        }
        if self.armed && !self.is_landed() {
            return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, "Reboot refused: flying"));
        }
        if self.armed && what.conditions != Some(RebootShutdownConditions::FORCE) {
            return Err(self.refuse(MavResult::TEMPORARILY_REJECTED, "Reboot refused: armed"));
        }
        // Whoever had it calibrate is to hear of the end.
        if self.cancel_calibration(MavCmd::PREFLIGHT_CALIBRATION) {
            self.commands.finish(MavCmd::PREFLIGHT_CALIBRATION, MavResult::CANCELLED);
        }
        self.disarm();
        self.reboot = Some(Reboot { link: command.from.link, since: self.time });
        Ok(MavResult::ACCEPTED)
    }

    /// Whether a reboot was asked for, and its answer has left, which `has_answered` is to say of a link; or waits for too
    /// long (C-30).
    pub(crate) fn wants_reboot(&self, has_answered: impl FnOnce(LinkId) -> bool) -> bool {
        self.reboot.is_some_and(|Reboot { link, since }| {
            let passed = self.time.since(since);
            passed >= PATIENCE || (passed >= LAST_BYTES && has_answered(link))
        })
    }

    /// Whether a reboot was asked for.
    pub(crate) fn is_going_down(&self) -> bool {
        self.reboot.is_some()
    }
}
