//! A vehicle's declarations of its commands: the stack refuses commands that a declaration does not admit.
//!
//! Rules C-1, C-4 to C-9, C-12 and SEC-14. A declaration is data; only declared commands cost flash.

use super::duplicates::ExecutionLimit;
use crate::dialect::{MavCmd, MavFrame, MavMissionResult, MavResult};
use crate::message::{CommandRule, Value};
use crate::types::{Command, CommandPosition, Refusal, RefusalReason};

const UNSUPPORTED_FRAME: MavResult = MavResult::COMMAND_UNSUPPORTED_MAV_FRAME;

/// The code before that of parameter 1: the difference is the number of the parameter.
const BEFORE_PARAM1: u8 = MavMissionResult::INVALID_PARAM1.0 - 1;

/// Only COMMAND_INT.
const INT_ONLY: u8 = 1;
/// Only COMMAND_LONG.
const LONG_ONLY: u8 = 2;
/// Not as a broadcast.
const NO_BROADCAST: u8 = 4;
/// Not to be carried out twice.
const ONCE: u8 = 8;
/// With [`ONCE`]: again for each repetition on one link; see [`ExecutionLimit::OncePerPress`].
const PER_PRESS: u8 = 16;

/// The declaration of a command that a vehicle accepts: an entry of [`Commands::POLICIES`](crate::Commands::POLICIES).
///
/// ```
/// use mavstack::dialect::MavFrame;
/// use mavstack::dialect::rules::{
///     COMPONENT_ARM_DISARM, DO_REPEAT_SERVO, DO_SET_ROI_LOCATION, NAV_TAKEOFF,
/// };
/// use mavstack::command::CommandPolicy;
/// use mavstack::message::ParamRule;
///
/// const POLICIES: &[CommandPolicy] = &[
///     // Not as a broadcast to every vehicle in range.
///     CommandPolicy::new(COMPONENT_ARM_DISARM).no_broadcast(),
///     // MAVSDK and QGroundControl send NaN for "as high as configured".
///     CommandPolicy::new(NAV_TAKEOFF.altitude_optional()).long_frame(MavFrame::GLOBAL_RELATIVE_ALT),
///     // Degrees in a float have a resolution of about a metre. (Not for DO_REPOSITION: QGroundControl sends it as a
///     // COMMAND_LONG to pause.)
///     CommandPolicy::new(DO_SET_ROI_LOCATION).int_only(),
///     // A duplicate must not repeat it.
///     CommandPolicy::new(DO_REPEAT_SERVO).once(),
/// ];
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CommandPolicy {
    rule: CommandRule,
    long_frame: MavFrame,
    flags: u8,
}

impl CommandPolicy {
    /// Declares a command in both forms. `rule` defines its frame, parameters and position: one of
    /// [`dialect::rules`](crate::dialect::rules), or derived from it.
    pub const fn new(rule: CommandRule) -> Self {
        Self { rule, long_frame: MavFrame::GLOBAL, flags: 0 }
    }

    const fn with(self, flag: u8) -> Self {
        Self { flags: self.flags | flag, ..self }
    }

    const fn has(&self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// Accepts only COMMAND_INT: a COMMAND_LONG is answered COMMAND_INT_ONLY.
    #[must_use]
    pub const fn int_only(self) -> Self {
        self.with(INT_ONLY)
    }

    /// Accepts only COMMAND_LONG: a COMMAND_INT is answered COMMAND_LONG_ONLY.
    #[must_use]
    pub const fn long_only(self) -> Self {
        self.with(LONG_ONLY)
    }

    /// Sets the frame of the position in a COMMAND_LONG, which has no frame field (C-6). The default is [`MavFrame::GLOBAL`].
    #[must_use]
    pub const fn long_frame(self, frame: MavFrame) -> Self {
        Self { long_frame: frame, ..self }
    }

    /// Refuses broadcasts: a command to all systems is DENIED (C-1).
    #[must_use]
    pub const fn no_broadcast(self) -> Self {
        self.with(NO_BROADCAST)
    }

    /// Declares that the command must not be carried out twice: a duplicate gets the first command's answer and is not carried
    /// out (C-12). A duplicate comes from the same sender, with the same parameters and in the same form,
    ///
    /// - on another link, or on the same link with a higher `confirmation`, within three seconds of the first;
    /// - on the same link with the same `confirmation` and target, within a second of the previous duplicate and three seconds
    ///   of the first: that is how clients retransmit an unanswered command. So two presses of a button within a second count
    ///   as one; see [`once_per_press`](Self::once_per_press);
    /// - on a high-latency link within a minute, as long as no other command needs the slot, unless it was signed more than three
    ///   seconds after the first. After such a delay it may also be a new command. Unless that is ruled out, the answer is
    ///   `TEMPORARILY_REJECTED`, and a sender that means a new command sends it again.
    ///
    /// The command needs one of the slots that `commands` in [`#[stack]`](macro@crate::Stack) declares; without the entry it does not
    /// compile. It is `TEMPORARILY_REJECTED` while no slot is free.
    #[must_use]
    pub const fn once(self) -> Self {
        self.with(ONCE)
    }

    /// Like [`once`](Self::once), but every press of a button counts, however fast: the same command on the same link with the
    /// same `confirmation` is carried out again. The drawback: when an ACK is lost and the client retransmits without raising
    /// `confirmation`, as MAVSDK does after half a second, the command is carried out twice.
    #[must_use]
    pub const fn once_per_press(self) -> Self {
        self.with(ONCE | PER_PRESS)
    }

    /// Checks the declarations of a vehicle without slots, in which duplicates would be found: none may be
    /// [`once`](Self::once) (C-12).
    #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
    #[doc(hidden)]
    pub const fn check_without_slots(policies: &[Self]) {
        let mut i = 0;
        while i < policies.len() {
            assert!(
                !policies[i].has(ONCE),
                "`once` and `once_per_press` need slots: add `commands: {{ slots: 2 }}` to `#[stack]`"
            );
            i += 1;
        }
    }

    /// Returns the command's id.
    pub const fn command(&self) -> MavCmd {
        self.rule.command()
    }

    /// Returns the declaration of `command`, if there is one.
    pub(super) fn find(policies: &'static [Self], command: MavCmd) -> Option<&'static Self> {
        policies.iter().find(|policy| policy.command() == command)
    }

    /// Returns how often the command may be executed.
    pub(super) const fn execution_limit(&self) -> ExecutionLimit {
        match self.flags & (ONCE | PER_PRESS) {
            0 => ExecutionLimit::None,
            ONCE => ExecutionLimit::Once,
            _ => ExecutionLimit::OncePerPress,
        }
    }

    /// Checks the rules that do not depend on the vehicle's state, in the order of C-5.
    /// `has_terrain`: whether the vehicle has a model of the terrain (M-49).
    pub(super) fn check(
        &self,
        command: &Command,
        has_terrain: bool,
        is_in_control: impl FnOnce() -> bool,
    ) -> Result<(), Refusal> {
        let out_of_range = |index| Refusal::denied(RefusalReason::Param(index));
        let (is_int, frame) = match command.position {
            CommandPosition::Int { frame, .. } => (true, frame),
            CommandPosition::Long { .. } => (false, self.long_frame),
        };
        if is_int && self.has(LONG_ONLY) {
            return Err(MavResult::COMMAND_LONG_ONLY.into());
        }
        if !is_int && self.has(INT_ONLY) {
            return Err(MavResult::COMMAND_INT_ONLY.into());
        }
        if !is_in_control() {
            return Err(MavResult::NOT_IN_CONTROL.into());
        }
        if command.is_broadcast && self.has(NO_BROADCAST) {
            return Err(Refusal::BROADCAST);
        }
        if !has_terrain && self.rule.needs_terrain(frame, &command.params) {
            // A COMMAND_LONG has no frame: the altitude, or the frame in a parameter, is out of range.
            let index = if command.id == MavCmd::DO_CHANGE_ALTITUDE { 2 } else { 7 };
            return Err(if is_int { UNSUPPORTED_FRAME.into() } else { out_of_range(index) });
        }
        if !self.rule.is_located() {
            // The frame of a command without a position is ignored (C-7).
            let [p1, p2, p3, p4] = command.params;
            let (p5, p6) = command.position.params();
            let mut params = (1..).zip([p1, p2, p3, p4, p5, p6, command.z]);
            let bad = params.find(|&(index, value)| !self.rule.admits(index, Value::of_float(value)));
            return bad.map_or(Ok(()), |(index, _)| Err(out_of_range(index)));
        }
        self.rule.check(&command.located_item(self.long_frame)?).map_err(|fault| match fault {
            MavMissionResult::UNSUPPORTED_FRAME if is_int => UNSUPPORTED_FRAME.into(),
            MavMissionResult::UNSUPPORTED_FRAME => out_of_range(7),
            _ => out_of_range(fault.0.saturating_sub(BEFORE_PARAM1)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::rules::{
        CONDITION_CHANGE_ALT, DO_CHANGE_ALTITUDE, DO_CHANGE_SPEED, NAV_TAKEOFF, OVERRIDE_GOTO,
    };
    use crate::message::{Address, ComponentId};
    use crate::types::{LinkClass, LinkId, Peer};

    fn command(id: MavCmd, params: [f32; 4], position: CommandPosition) -> Command {
        Command {
            id,
            params,
            position,
            z: 20.0,
            from: Peer { address: Address::new(255, 190), link: LinkId(0) },

            trust: crate::types::Trust::Open,
            class: LinkClass::Normal,
            age: None,
            component: ComponentId::new(1),
            is_broadcast: false,
            confirmation: 0,
        }
    }

    /// M-49, C-5: without a model of the terrain, an altitude above it is COMMAND_UNSUPPORTED_MAV_FRAME in a COMMAND_INT and DENIED
    /// in a COMMAND_LONG. The frame of a command without an altitude means nothing (C-7).
    #[test]
    fn altitudes_above_terrain_need_a_model_of_it() {
        let long = CommandPosition::Long { param5: 47.0, param6: 8.0 };
        for frame in [0, 3, 5, 6, 10, 11].map(MavFrame) {
            let int = CommandPosition::Int { frame, x: 0, y: 0 };
            let own_frame = [20.0, frame.0.into(), 0.0, 0.0];
            for (rule, params, index) in [
                (NAV_TAKEOFF, [0.0; 4], Some(7)),
                (CONDITION_CHANGE_ALT, [0.0; 4], Some(7)),
                (DO_CHANGE_ALTITUDE, own_frame, Some(2)),
                (DO_CHANGE_SPEED, [0.0; 4], None),
            ] {
                let policy = CommandPolicy::new(rule).long_frame(frame);
                let is_refused = frame.0 >= 10 && index.is_some();
                let result = |position, has_terrain| {
                    policy.check(&command(rule.command(), params, position), has_terrain, || true)
                };
                let refused = |refusal| if is_refused { Err(refusal) } else { Ok(()) };
                let out_of_range = Refusal::denied(RefusalReason::Param(index.unwrap_or(0)));
                assert_eq!(result(int, false), refused(UNSUPPORTED_FRAME.into()), "{rule:?} {frame:?}");
                assert_eq!(result(long, false), refused(out_of_range));
                assert_eq!([result(int, true), result(long, true)], [Ok(()), Ok(())]);
            }
            // A frame in parameter 3, beside that of the position.
            let int = CommandPosition::Int { frame: MavFrame::GLOBAL, x: 0, y: 0 };
            let goto = command(MavCmd::OVERRIDE_GOTO, [0.0, 2.0, frame.0.into(), 0.0], int);
            let expected = if frame.0 >= 10 { Err(UNSUPPORTED_FRAME.into()) } else { Ok(()) };
            assert_eq!(CommandPolicy::new(OVERRIDE_GOTO).check(&goto, false, || true), expected, "{frame:?}");
        }
    }
}
