//! Commands for the ground: calibration and reboot.

use mavstack::command::LongCommands;
use mavstack::dialect::commands::{PreflightCalibration, PreflightRebootShutdown};
use mavstack::dialect::rules;
use mavstack::dialect::{MavCmd, MavResult, MavSeverity, RebootShutdownAction, RebootShutdownConditions};
use mavstack::message::ParamRule;
use mavstack::{Command, CommandRule, Context, Duration, Instant, LinkId, Outcome};

use super::Quadrotor;
use super::commands::refuse;

/// Duration of a calibration.
const CALIBRATION_TIME: Duration = Duration::from_secs(5);
/// Time for the last bytes of an answer to leave the UART, even at 2,400 bit/s.
const DRAIN_TIME: Duration = Duration::from_millis(50);
/// Maximum time to wait for the answer to be sent on a stalled link.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// The supported sensors: gyroscopes, compass, barometer and accelerometers. Not supported: radio, airspeed, motors.
pub const CALIBRATION: CommandRule = rules::PREFLIGHT_CALIBRATION.with_params(&[
    ParamRule::integers(1, 0, 1),
    ParamRule::integers(2, 0, 1),
    ParamRule::integers(4, 0, 0),
    ParamRule::one_of(5, &[0, 1, 2, 4]),
    ParamRule::integers(6, 0, 0).or_nan(),
    ParamRule::integers(7, 0, 0).or_nan(),
]);

/// Supports a reboot of the autopilot only: no shutdown, and no other component.
pub const REBOOT: CommandRule = rules::PREFLIGHT_REBOOT_SHUTDOWN.with_params(&[
    ParamRule::integers(1, 0, 1),
    ParamRule::integers(2, 0, 0).or_nan(),
    ParamRule::integers(3, 0, 0).or_nan(),
]);

/// A requested reboot.
#[derive(Clone, Copy, Debug)]
pub struct Reboot {
    link: LinkId,
    since: Instant,
}

impl Quadrotor {
    /// MAV_CMD_PREFLIGHT_CALIBRATION: a long-running command that can be cancelled (C-20, C-23). With all parameters 0 it does
    /// nothing, as in PX4. COMMAND_CANCEL cancels a running calibration.
    #[inline(never)]
    pub(super) fn calibrate(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<Outcome, MavResult> {
        let what: PreflightCalibration = command.decode()?;
        let sensors = [what.gyro_temperature, what.magnetometer.0, what.accelerometer.0];
        if sensors == [0; 3] && !what.ground_pressure {
            return Ok(MavResult::ACCEPTED.into());
        }
        if self.armed {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Calibration refused: armed"));
        }
        let outcome = cx.start();
        if outcome.result == MavResult::IN_PROGRESS {
            self.calibration = Some(self.time);
            cx.text(MavSeverity::INFO, "Calibrating: keep the vehicle still");
        } else {
            refuse(cx, outcome.result, "Calibration refused: busy with other commands");
        }
        Ok(outcome)
    }

    pub(super) fn is_calibrating(&self) -> bool {
        self.calibration.is_some()
    }

    pub(super) fn watch_calibration(&mut self, cx: &mut Context<'_>) {
        if self.calibration.is_some_and(|since| self.time - since >= CALIBRATION_TIME) {
            self.calibration = None;
            cx.text(MavSeverity::INFO, "Calibration complete");
        }
    }

    /// Reports the progress and the end of the calibration. Does nothing if no command is in progress.
    pub(crate) fn report_calibration(&self, commands: &mut LongCommands) {
        const COMMAND: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;

        if let Some(since) = self.calibration {
            let percent = 100 * (self.time - since).as_millis() / const { CALIBRATION_TIME.as_millis() };
            commands.progress(COMMAND, percent as u8);
        } else {
            commands.finish(COMMAND, if self.is_rebooting() { MavResult::CANCELLED } else { MavResult::ACCEPTED });
        }
    }

    pub(super) fn cancel_calibration(&mut self, cx: &mut Context<'_>, command: MavCmd) -> bool {
        let is_cancelled = command == MavCmd::PREFLIGHT_CALIBRATION && self.calibration.take().is_some();
        if is_cancelled {
            cx.text(MavSeverity::INFO, "Calibration cancelled");
        }
        is_cancelled
    }

    /// MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: in flight it is refused, even when forced (SEC-13).
    #[inline(never)]
    pub(super) fn request_reboot(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<MavResult, MavResult> {
        let what: PreflightRebootShutdown = command.decode()?;
        if what.autopilot != RebootShutdownAction::REBOOT || self.reboot.is_some() {
            return Ok(MavResult::ACCEPTED);
        }
        if self.armed && !self.is_landed() {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Reboot refused: in flight"));
        }
        if self.armed && what.conditions != Some(RebootShutdownConditions::FORCE) {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Reboot refused: armed"));
        }
        // The sender of a running calibration gets a final result.
        self.cancel_calibration(cx, MavCmd::PREFLIGHT_CALIBRATION);
        self.cancel_authorisation(cx);
        self.disarm();
        self.reboot = Some(Reboot { link: command.from.link, since: self.time });
        Ok(MavResult::ACCEPTED)
    }

    /// Whether a reboot was requested and its answer was sent or has timed out (C-30). `has_answered` says whether a link has
    /// sent its pending answers.
    pub(crate) fn wants_reboot(&self, has_answered: impl FnOnce(LinkId) -> bool) -> bool {
        self.reboot.is_some_and(|Reboot { link, since }| {
            let passed = self.time - since;
            passed >= ANSWER_TIMEOUT || (passed >= DRAIN_TIME && has_answered(link))
        })
    }

    /// Whether a reboot was requested.
    pub(crate) fn is_rebooting(&self) -> bool {
        self.reboot.is_some()
    }
}
