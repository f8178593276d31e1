//! Arm authorisation (O-3): another system, such as a ground station of an operator, must permit each arming.
//!
//! <https://mavlink.io/en/services/arm_authorization.html>. With [`Tuning::COM_ARM_AUTH_ID`], a command to arm is answered
//! IN_PROGRESS until the authoriser has answered MAV_CMD_ARM_AUTHORIZATION_REQUEST, and then with what it said.

use mavstack::command::LongCommands;
use mavstack::dialect::{MavArmAuthDeniedReason as Reason, MavCmd, MavResult, MavSeverity};
use mavstack::{Address, CommandReply, Context, Outcome, OutgoingCommand};

use super::Quadrotor;
use super::commands::refuse;
use crate::tuning::Tuning;

/// The tokens of the requests to the authoriser begin here. Each has its own: a cancelled one may still be answered.
pub(super) const AUTHORISE: u16 = 0x100;

/// A command to arm that waits for the authoriser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Authorisation {
    /// By the request with this token.
    Requested(u16),
    /// The final result of the command to arm, which the flight loop has not reported yet.
    Ended(MavResult),
}

impl Quadrotor {
    /// Returns the request to the authoriser, unless it was cancelled.
    pub(super) fn authorisation_request(&self, token: u16) -> Option<OutgoingCommand> {
        let params = [f32::from(self.system), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let is_wanted = self.authorisation == Some(Authorisation::Requested(token));
        is_wanted.then_some(OutgoingCommand::long(MavCmd::ARM_AUTHORIZATION_REQUEST, params))
    }

    /// Arms, or says why not.
    pub(super) fn on_authorisation(&mut self, cx: &mut Context<'_>, token: u16, reply: CommandReply) {
        if self.authorisation != Some(Authorisation::Requested(token)) {
            // It was cancelled meanwhile.
            return;
        }
        let result = match reply {
            CommandReply::InProgress(_) => return,
            CommandReply::NotSent => Err((MavResult::TEMPORARILY_REJECTED, "Arming refused: no authoriser")),
            CommandReply::TimedOut => Err((MavResult::FAILED, "Arming refused: the authoriser does not answer")),
            CommandReply::Done { result: MavResult::ACCEPTED, .. } => {
                self.check_arming(cx).map_err(|why| (MavResult::TEMPORARILY_REJECTED, why))
            }
            CommandReply::Done { result, result_param2 } => Err((result, reason(result_param2))),
        };
        let result = match result {
            Ok(()) => {
                self.arm();
                cx.text(MavSeverity::INFO, "Arming authorised");
                MavResult::ACCEPTED
            }
            Err((result, why)) => refuse(cx, result, why),
        };
        self.authorisation = Some(Authorisation::Ended(result));
    }

    /// Asks the authoriser, if there is one, and answers IN_PROGRESS. `None` if arming needs no authorisation.
    pub(super) fn request_authorisation(&mut self, cx: &mut Context<'_>) -> Option<Outcome> {
        let authoriser = u8::try_from(cx.parameter(Tuning::COM_ARM_AUTH_ID)).unwrap_or(0);
        if authoriser == 0 {
            return None;
        }
        let outcome = cx.start();
        self.authorisations = self.authorisations.wrapping_add(1);
        let token = AUTHORISE | u16::from(self.authorisations);
        if outcome.result != MavResult::IN_PROGRESS || !cx.send_command(Address::new(authoriser, 0), token) {
            return Some(
                refuse(cx, MavResult::TEMPORARILY_REJECTED, "Arming refused: busy with other commands").into(),
            );
        }
        self.authorisation = Some(Authorisation::Requested(token));
        cx.text(MavSeverity::INFO, "Waiting for the authoriser");
        Some(outcome)
    }

    /// Stops waiting for the authoriser. Returns whether the vehicle waited.
    pub(super) fn cancel_authorisation(&mut self, cx: &mut Context<'_>) -> bool {
        let Some(Authorisation::Requested(token)) = self.authorisation else { return false };
        self.authorisation = Some(Authorisation::Ended(MavResult::CANCELLED));
        // An authoriser that cannot be told finds its answer ignored.
        let _ = cx.cancel_sent_command(token);
        true
    }

    /// Reports the end of a command to arm that waited.
    pub(crate) fn report_arming(&mut self, commands: &mut LongCommands) {
        if let Some(Authorisation::Ended(result)) = self.authorisation {
            self.authorisation = None;
            commands.finish(MavCmd::COMPONENT_ARM_DISARM, result);
        }
    }
}

/// Says why the authoriser refused, by COMMAND_ACK.result_param2.
fn reason(result_param2: i32) -> &'static str {
    match u8::try_from(result_param2).map(Reason) {
        Ok(Reason::INVALID_WAYPOINT) => "Arming refused by the authoriser: invalid waypoint",
        Ok(Reason::TIMEOUT) => "Arming refused by the authoriser: timeout",
        Ok(Reason::AIRSPACE_IN_USE) => "Arming refused by the authoriser: airspace in use",
        Ok(Reason::BAD_WEATHER) => "Arming refused by the authoriser: bad weather",
        _ => "Arming refused by the authoriser",
    }
}
