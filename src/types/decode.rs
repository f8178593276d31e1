//! A received command as a [`TypedCommand`]: rules C-6 to C-9.

use super::command::{Command, CommandPosition};
use crate::dialect::{MavFrame, MavMissionResult, MavResult};
use crate::message::{CommandParams, CommandRule, Item, Location, TypedCommand, Value};

impl Command {
    /// Returns the command with named parameters, checked against the definition's rule.
    ///
    /// A field is an `Option` if that rule admits NaN, which means "default" (C-8). Position and altitude are optional: a vehicle
    /// that needs them requires them in its [`CommandPolicy`](crate::command::CommandPolicy), or refuses `None`.
    ///
    /// ```
    /// use mavstack::dialect::commands::{ComponentArmDisarm, NavTakeoff};
    /// use mavstack::dialect::{MavCmd, MavResult};
    /// use mavstack::{Command, Commands, Context, Outcome};
    ///
    /// struct Copter { armed: bool, climb_to: f32 }
    ///
    /// impl Copter {
    ///     fn carry_out(&mut self, command: &Command) -> Result<Outcome, MavResult> {
    ///         match command.id {
    ///             MavCmd::COMPONENT_ARM_DISARM => {
    ///                 let order: ComponentArmDisarm = command.decode()?;
    ///                 self.armed = order.arm;
    ///             }
    ///             MavCmd::NAV_TAKEOFF => {
    ///                 let takeoff: NavTakeoff = command.decode()?;
    ///                 if !self.armed {
    ///                     return Err(MavResult::TEMPORARILY_REJECTED);
    ///                 }
    ///                 self.climb_to = takeoff.location.altitude.unwrap_or(2.5);
    ///             }
    ///             _ => return Err(MavResult::UNSUPPORTED),
    ///         }
    ///         Ok(MavResult::ACCEPTED.into())
    ///     }
    /// }
    ///
    /// impl Commands for Copter {
    ///     fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
    ///         self.carry_out(command).unwrap_or_else(Outcome::from)
    ///     }
    /// }
    /// ```
    ///
    /// # Errors
    ///
    /// The result for the COMMAND_ACK: DENIED for a parameter that the rule does not admit (C-9), an incomplete position, or one
    /// off the globe; COMMAND_UNSUPPORTED_MAV_FRAME for the position of a COMMAND_INT in a frame that is neither global nor
    /// MISSION; UNSUPPORTED if this is another command.
    pub fn decode<T: TypedCommand>(&self) -> Result<T, MavResult> {
        self.decode_by(const { &T::LOOSE })
    }

    /// Like [`decode`](Self::decode), but checks frame, parameters, position and altitude against the vehicle's own rule. If the
    /// rule admits NaN, a field that is not an `Option` is NaN.
    ///
    /// # Errors
    ///
    /// Those of [`decode`](Self::decode); also DENIED for a value that its field cannot hold.
    pub fn decode_by<T: TypedCommand>(&self, rule: &CommandRule) -> Result<T, MavResult> {
        let mut params = CommandParams::NEW;
        self.read(&mut params, rule)?;
        // In place: a second copy would be on the call stack of the hook.
        let mut command = Ok(T::take(&mut params));
        if params.failed != 0 {
            command = Err(MavResult::DENIED);
        }
        command
    }

    // In place, so that nothing is copied; not inlined, so that all commands share it.
    #[inline(never)]
    fn read(&self, params: &mut CommandParams, rule: &CommandRule) -> Result<(), MavResult> {
        if self.id != rule.command() {
            return Err(MavResult::UNSUPPORTED);
        }
        let (p5, p6) = match self.position {
            CommandPosition::Long { param5, param6 } => (Value::of_float(param5), Value::of_float(param6)),
            CommandPosition::Int { x, y, .. } => (Value::of_integer(x), Value::of_integer(y)),
        };
        params.set(self.params, p5, p6, self.z);
        if !rule.is_located() {
            // The frame of a command without a position is ignored (C-7).
            let is_good = (1..).zip(&params.values).all(|(index, value)| rule.admits(index, *value));
            return if is_good { Ok(()) } else { Err(MavResult::DENIED) };
        }
        let item = self.located_item(MavFrame::GLOBAL);
        // By reference: it is large.
        let item = item.as_ref().map_err(|result| *result)?;
        let is_int = matches!(self.position, CommandPosition::Int { .. });
        rule.check(item).map_err(|fault| match fault {
            // A COMMAND_LONG has no frame (M-49).
            MavMissionResult::UNSUPPORTED_FRAME if is_int => MavResult::COMMAND_UNSUPPORTED_MAV_FRAME,
            _ => MavResult::DENIED,
        })?;
        params.location = Location::new(item);
        if !is_int {
            params.location.frame = None;
        }
        Ok(())
    }

    /// The command as an item of a plan, for one with a location; a COMMAND_LONG's is in `long_frame` (C-6).
    ///
    /// # Errors
    ///
    /// DENIED for a position that is off the globe.
    pub(crate) fn located_item(&self, long_frame: MavFrame) -> Result<Item, MavResult> {
        let (frame, x, y) = match self.position {
            CommandPosition::Int { frame, x, y } => (frame, x, y),
            CommandPosition::Long { param5, param6 } => (long_frame, scaled(param5)?, scaled(param6)?),
        };
        Ok(Item { frame, command: self.id, autocontinue: 0, params: self.params, x, y, z: self.z })
    }
}

/// Converts degrees to 1e-7 degrees. NaN means "not given"; a value off the globe is DENIED.
fn scaled(degrees: f32) -> Result<i32, MavResult> {
    if degrees.is_nan() { Ok(i32::MAX) } else { crate::num::scale_1e7(degrees).ok_or(MavResult::DENIED) }
}
