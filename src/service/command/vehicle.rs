//! The command service's interface to the vehicle.

use super::policy::CommandPolicy;
use crate::dialect::MavCmd;
use crate::types::{Command, Context, Outcome, Peer};

/// The hooks of a vehicle for commands. Every vehicle implements this trait.
///
/// ```text
///   COMMAND_LONG ─┐                                                            ┌─▶ services ─┐
///                 ├─▶ declared? form, control, frame, parameters ─▶ duplicate? ┤             ├─▶ COMMAND_ACK
///   COMMAND_INT ──┘               (POLICIES)                        (slots)    └─▶ command ──┘
/// ```
///
/// A service of the stack carries out the commands that it handles; all others are passed to [`command`](Self::command).
///
/// The stack explains its own refusals in a STATUSTEXT on the sender's link, at most once a second (feature `plan-texts`). The
/// vehicle explains its refusals itself, with [`Context::text`].
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Commands`",
    note = "a vehicle of `#[stack]` needs `impl Commands for {Self}`: it carries out commands, or refuses them"
)]
pub trait Commands {
    /// Declares commands whose form, frame and parameters the stack checks (C-5), and commands that must not be carried out
    /// twice. Other commands are passed to [`command`](Self::command) unchecked.
    const POLICIES: &'static [CommandPolicy] = &[];

    /// Carries out `command`, [starts](Context::start) it, or refuses it. The answer to an unknown command is
    /// [`MavResult::UNSUPPORTED`](crate::dialect::MavResult::UNSUPPORTED).
    ///
    /// Called for every received duplicate too, so a repeated command must be harmless (C-11), unless it is declared
    /// [`once`](CommandPolicy::once). Every call is answered by exactly one COMMAND_ACK (C-3); a started command gets another one
    /// when it has ended.
    ///
    /// IN_PROGRESS is a promise of another answer, so return it only from [`Context::start`]. Without a slot that holds the command it
    /// is answered FAILED, counted in [`HookFaults::unfinished`](crate::command::HookFaults::unfinished), and explained by a text
    /// (C-20).
    ///
    /// A reboot is answered before it happens (C-30): return ACCEPTED, accept no more commands, and reset when
    /// [`Stack::has_answered`](crate::Stack::has_answered) returns true.
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome;

    /// Whether the sender of `command`, which is declared in [`POLICIES`](Self::POLICIES), is authorised to give it. If not, the
    /// answer is NOT_IN_CONTROL. Also called for SET_MODE and MISSION_SET_CURRENT, as MAV_CMD_DO_SET_MODE and
    /// MAV_CMD_DO_SET_MISSION_CURRENT.
    ///
    /// A vehicle that declares `operator_control` need not do this for ground stations: see
    /// [`OperatorControl`](crate::operator_control::OperatorControl).
    fn is_in_control(&self, cx: &mut Context<'_>, command: &Command) -> bool {
        let _ = (cx, command);
        true
    }

    /// Cancels the running `command` at the request of `from`: COMMAND_CANCEL, or MAV_CMD_PREFLIGHT_CALIBRATION with all parameters 0,
    /// which cancels a calibration as in PX4. While a system is in control (O-5), only it and the sender of the command can (X-3).
    /// Returns true if it was cancelled: the sender of the command then gets CANCELLED. Returns false if it continues (C-23).
    fn cancel_command(&mut self, cx: &mut Context<'_>, command: MavCmd, from: Peer) -> bool {
        let _ = (cx, command, from);
        false
    }
}
