//! What a vehicle declares of a command, so that the stack refuses what it never takes.
//!
//! Rules C-1 and C-5 to C-9. The declaration is data; only what a vehicle declares costs flash.

use super::Once;
use super::refusal::{Refusal, Why};
use crate::dialect::{MavCmd, MavFrame, MavMissionResult, MavResult};
use crate::service::mission::{CommandRule, Item, Value};
use crate::vehicle::{Command, CommandPosition, Commands};

/// Only COMMAND_INT.
const INT_ONLY: u8 = 1;
/// Only COMMAND_LONG.
const LONG_ONLY: u8 = 2;
/// Not to every system at once.
const NO_BROADCAST: u8 = 4;
/// Not to be carried out twice.
const ONCE: u8 = 8;
/// And again for each repetition on one link: see [`Once::PerPress`].
const PER_PRESS: u8 = 16;

/// A command that a vehicle takes, and how: an entry of [`Commands::COMMANDS`](crate::Commands::COMMANDS).
///
/// ```
/// use mavstack::dialect::MavFrame;
/// use mavstack::dialect::command_rules::{
///     COMPONENT_ARM_DISARM, DO_REPEAT_SERVO, DO_SET_ROI_LOCATION, NAV_TAKEOFF,
/// };
/// use mavstack::{CommandPolicy, ParamRule};
///
/// const COMMANDS: &[CommandPolicy] = &[
///     // Not by somebody who means every vehicle in reach.
///     CommandPolicy::new(COMPONENT_ARM_DISARM).no_broadcast(),
///     // MAVSDK and QGroundControl send NaN for "as high as configured".
///     CommandPolicy::new(NAV_TAKEOFF.altitude_optional()).long_frame(MavFrame::GLOBAL_RELATIVE_ALT),
///     // A float's degrees are a metre apart. (Not DO_REPOSITION: QGroundControl's pause is one, in a COMMAND_LONG.)
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
    /// A command in both forms, whose frame, parameters and position are as `rule` has them: one of
    /// [`dialect::command_rules`](crate::dialect::command_rules), or made from it.
    pub const fn new(rule: CommandRule) -> Self {
        Self { rule, long_frame: MavFrame::GLOBAL, flags: 0 }
    }

    const fn with(self, flag: u8) -> Self {
        Self { flags: self.flags | flag, ..self }
    }

    const fn has(&self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// A COMMAND_LONG is answered COMMAND_INT_ONLY.
    #[must_use]
    pub const fn int_only(self) -> Self {
        self.with(INT_ONLY)
    }

    /// A COMMAND_INT is answered COMMAND_LONG_ONLY.
    #[must_use]
    pub const fn long_only(self) -> Self {
        self.with(LONG_ONLY)
    }

    /// The frame of its position in a COMMAND_LONG, which names none (C-6): [`MavFrame::GLOBAL`] at first.
    #[must_use]
    pub const fn long_frame(self, frame: MavFrame) -> Self {
        Self { long_frame: frame, ..self }
    }

    /// A copy that was sent to every system is DENIED (C-1).
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
    /// It needs a slot in [`Commands::command_memory`](crate::Commands::command_memory), and is `TEMPORARILY_REJECTED` when no
    /// slot is free.
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

    /// Which command.
    pub const fn command(&self) -> MavCmd {
        self.rule.command()
    }

    /// Checks what does not depend on the vehicle's state, in the order of C-5.
    fn check(&self, command: &Command, is_in_control: impl FnOnce() -> bool) -> Result<(), Refusal> {
        let is_int = matches!(command.position, CommandPosition::Int { .. });
        refuse(is_int && self.has(LONG_ONLY), MavResult::COMMAND_LONG_ONLY)?;
        refuse(!is_int && self.has(INT_ONLY), MavResult::COMMAND_INT_ONLY)?;
        refuse(!is_in_control(), MavResult::NOT_IN_CONTROL)?;
        let denied = |why| Refusal { result: MavResult::DENIED, why };
        if command.is_broadcast && self.has(NO_BROADCAST) {
            return Err(denied(Why::Broadcast));
        }
        if !self.rule.is_located() {
            // Without a position a frame says nothing (C-7).
            let [p1, p2, p3, p4] = command.params;
            let (p5, p6) = command.position.params();
            let mut params = (1..).zip([p1, p2, p3, p4, p5, p6, command.z]);
            let bad = params.find(|&(index, value)| !self.rule.admits(index, Value::of_float(value)));
            return bad.map_or(Ok(()), |(index, _)| Err(denied(Why::Param(index))));
        }
        self.rule.check(&item(command, self.long_frame)?).map_err(|fault| match fault {
            MavMissionResult::UNSUPPORTED_FRAME => MavResult::COMMAND_UNSUPPORTED_MAV_FRAME.into(),
            _ => denied(Why::Param(fault.0.wrapping_sub(MavMissionResult::INVALID_PARAM1.0).wrapping_add(1))),
        })
    }
}

/// The parameters of a command with a location; a COMMAND_LONG's are in `long_frame` (C-6).
pub(super) fn item(command: &Command, long_frame: MavFrame) -> Result<Item, MavResult> {
    let (frame, x, y) = match command.position {
        CommandPosition::Int { frame, x, y } => (frame, x, y),
        CommandPosition::Long { param5, param6 } => (long_frame, scaled(param5)?, scaled(param6)?),
    };
    Ok(Item { frame, command: command.id, autocontinue: 0, params: command.params, x, y, z: command.z })
}

/// Checks them.
pub(super) fn check_item(rule: &CommandRule, item: &Item) -> Result<(), MavResult> {
    rule.check(item).map_err(|fault| match fault {
        MavMissionResult::UNSUPPORTED_FRAME => MavResult::COMMAND_UNSUPPORTED_MAV_FRAME,
        _ => MavResult::DENIED,
    })
}

/// A float that is no number is "not given"; one that is off the globe is not.
fn scaled(degrees: f32) -> Result<i32, MavResult> {
    if degrees.is_nan() { Ok(i32::MAX) } else { crate::num::scale_1e7(degrees).ok_or(MavResult::DENIED) }
}

pub(super) fn refuse(bad: bool, result: MavResult) -> Result<(), MavResult> {
    if bad { Err(result) } else { Ok(()) }
}

/// The vehicle's declaration of `command`, if there is one.
fn declared<V: Commands>(command: MavCmd) -> Option<&'static CommandPolicy> {
    V::COMMANDS.iter().find(|policy| policy.command() == command)
}

/// Returns how often `command` may be carried out, as the vehicle declares it.
pub(super) fn once<V: Commands>(command: MavCmd) -> Once {
    match declared::<V>(command) {
        Some(policy) if policy.has(PER_PRESS) => Once::PerPress,
        Some(policy) if policy.has(ONCE) => Once::Yes,
        _ => Once::No,
    }
}

/// Checks a command by its declaration, if there is one.
#[inline(never)]
pub(super) fn check<V: Commands>(command: &Command, vehicle: &V) -> Result<(), Refusal> {
    let policy = declared::<V>(command.id);
    policy.map_or(Ok(()), |policy| policy.check(command, || vehicle.is_in_control(command)))
}
