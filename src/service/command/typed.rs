//! Typed commands: the parameters of a command under their own names, checked and converted.
//!
//! Rules C-6 to C-9 and M-70. A type says which parameters there are, its [`CommandRule`] what they may be. Both message
//! forms, and an item of a plan, give the same value wherever they say the same. The types of the commands that have
//! parameters are made from the definitions (see [`mod@crate::dialect::commands`]); only what a firmware decodes costs
//! flash.

use super::policy;
use crate::dialect::{MavFrame, MavMissionResult, MavResult};
use crate::message::Field;
use crate::service::mission::{CommandRule, Item, Value};
use crate::vehicle::{Command, CommandPosition};

/// A command with named parameters, made by [`command!`](crate::command!).
pub trait TypedCommand: Sized {
    /// Which command it is, and what its parameters may be.
    const RULE: CommandRule;

    /// Takes the fields out of checked parameters.
    #[doc(hidden)]
    fn take(params: &mut CommandParams) -> Self;

    /// What [`Command::decode`] checks: also a vehicle that needs less than the definition gets its command.
    #[doc(hidden)]
    const LOOSE: CommandRule = Self::RULE.any_frame().position_optional().altitude_optional().zero_position_allowed();
}

/// A type that a field can have in [`command!`](crate::command!): numbers of up to 32 bits, and types made by
/// [`wire_enum!`](crate::wire_enum) and [`wire_bitmask!`](crate::wire_bitmask), of an integer that they can hold; `f32`;
/// `bool`, of 0 and 1; an `Option` of one of these, where NaN is `None` (C-8); [`Location`], as parameter 5.
pub trait CommandParam: Sized {
    /// The field of parameter `index`.
    #[doc(hidden)]
    fn take(params: &mut CommandParams, index: u8) -> Self;
}

/// A place on the globe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LatLon {
    /// Latitude (deg·1e7), −90° to 90°.
    pub latitude: i32,
    /// Longitude (deg·1e7), −180° to 180°.
    pub longitude: i32,
}

/// Parameters 5, 6 and 7 of a command with a location.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Location {
    /// Where; `None` when it is not given, and in [`MavFrame::MISSION`], which has no positions.
    pub position: Option<LatLon>,
    /// Altitude (m) as the frame counts it, where the command has one; `None` for NaN.
    pub altitude: Option<f32>,
    /// [`MavFrame::GLOBAL`], [`MavFrame::GLOBAL_RELATIVE_ALT`] or [`MavFrame::GLOBAL_TERRAIN_ALT`], also for their `_INT`
    /// twins (M-4), or [`MavFrame::MISSION`]. `None` for a COMMAND_LONG, which names no frame (C-6).
    pub frame: Option<MavFrame>,
}

impl Location {
    const NONE: Self = Self { position: None, altitude: None, frame: None };

    /// Of an item that was checked.
    fn new(item: &Item) -> Self {
        let frame = match item.frame {
            MavFrame::GLOBAL_INT => MavFrame::GLOBAL,
            MavFrame::GLOBAL_RELATIVE_ALT_INT => MavFrame::GLOBAL_RELATIVE_ALT,
            MavFrame::GLOBAL_TERRAIN_ALT_INT => MavFrame::GLOBAL_TERRAIN_ALT,
            frame => frame,
        };
        let is_given = frame != MavFrame::MISSION && item.x != i32::MAX;
        let position = LatLon { latitude: item.x, longitude: item.y };
        Self {
            position: is_given.then_some(position),
            altitude: Some(item.z).filter(|z| !z.is_nan()),
            frame: Some(frame),
        }
    }
}

/// The checked parameters of a command, from which its fields are taken one by one.
#[doc(hidden)]
pub struct CommandParams {
    values: [Value; 7],
    location: Location,
    /// A parameter that the type of its field cannot hold, 0 for none.
    failed: u8,
}

impl CommandParams {
    const NEW: Self = Self { values: [Value::NONE; 7], location: Location::NONE, failed: 0 };

    // In place, and not inlined: all commands share it, and nothing is copied.
    #[inline(never)]
    fn read_command(&mut self, command: &Command, rule: &CommandRule) -> Result<(), MavResult> {
        policy::refuse(command.id != rule.command(), MavResult::UNSUPPORTED)?;
        let (p5, p6) = match command.position {
            CommandPosition::Long { param5, param6 } => (Value::of_float(param5), Value::of_float(param6)),
            CommandPosition::Int { x, y, .. } => (Value::of_integer(x), Value::of_integer(y)),
        };
        self.set(command.params, p5, p6, command.z);
        if !rule.is_located() {
            // Without a position a frame says nothing (C-7).
            let is_good = (1..).zip(&self.values).all(|(index, value)| rule.admits(index, *value));
            return policy::refuse(!is_good, MavResult::DENIED);
        }
        let item = policy::item(command, MavFrame::GLOBAL)?;
        policy::check_item(rule, &item)?;
        self.location = Location::new(&item);
        if matches!(command.position, CommandPosition::Long { .. }) {
            self.location.frame = None;
        }
        Ok(())
    }

    #[inline(never)]
    fn read_item(&mut self, item: &Item, rule: &CommandRule) -> Result<(), MavMissionResult> {
        if item.command != rule.command() {
            return Err(MavMissionResult::UNSUPPORTED);
        }
        rule.check(item)?;
        // The rule takes global frames otherwise.
        let value = if item.frame == MavFrame::MISSION { Value::of_integer } else { Value::of_1e7 };
        self.set(item.params, value(item.x), value(item.y), item.z);
        self.location = Location::new(item);
        Ok(())
    }

    fn set(&mut self, params: [f32; 4], p5: Value, p6: Value, z: f32) {
        // In place: an array of all of them would be on the stack twice.
        let [first @ .., x, y, altitude] = &mut self.values;
        for (value, param) in first.iter_mut().zip(params) {
            *value = Value::of_float(param);
        }
        (*x, *y, *altitude) = (p5, p6, Value::of_float(z));
    }

    /// The field of parameter `index`.
    #[inline(always)]
    pub fn take<T: CommandParam>(&mut self, index: u8) -> T {
        T::take(self, index)
    }

    #[inline(always)]
    fn value(&self, index: u8) -> Value {
        self.values.get(usize::from(index).wrapping_sub(1)).copied().unwrap_or(Value::NONE)
    }

    /// What `value` has, or `zero` and a mark that the parameter is refused.
    #[inline(always)]
    fn or_fail<T>(&mut self, index: u8, value: Option<T>, zero: T) -> T {
        value.unwrap_or_else(|| {
            self.failed = index;
            zero
        })
    }
}

/// How many low bits of an `i32` such an integer has for what is not its sign.
#[allow(
    clippy::arithmetic_side_effects,
    clippy::as_conversions,
    reason = "const-evaluated: an overflow is a compile error, and `From` cannot be called"
)]
const fn own_bits(size: usize, wire_type: &str) -> u32 {
    let sign = matches!(wire_type.as_bytes(), [b'i', ..]) as u32;
    let bits = size as u32 * 8 - sign;
    if bits < 31 { bits } else { 31 }
}

impl<T: Field> CommandParam for T {
    #[inline(always)]
    fn take(params: &mut CommandParams, index: u8) -> Self {
        // float, intN_t or uintN_t; an array has another type.
        let kind = const {
            assert!(!T::IS_ARRAY, "a parameter is one number");
            match T::WIRE_TYPE.as_bytes() {
                [kind @ (b'f' | b'i' | b'u'), ..] => *kind,
                _ => panic!("a parameter is an f32 or an integer"),
            }
        };
        let value = params.value(index);
        if kind == b'f' {
            return T::read(&value.float.to_le_bytes(), 0);
        }
        let is_signed = kind == b'i';
        let integer = value.integer().filter(|integer| {
            let rest = integer.wrapping_shr(const { own_bits(T::SIZE, T::WIRE_TYPE) });
            rest == 0 || (is_signed && rest == -1)
        });
        params.or_fail(index, integer.map(|integer| T::read(&i64::from(integer).to_le_bytes(), 0)), T::ZERO)
    }
}

impl CommandParam for bool {
    #[inline(always)]
    fn take(params: &mut CommandParams, index: u8) -> Self {
        let value = match params.value(index).integer() {
            Some(0) => Some(false),
            Some(1) => Some(true),
            _ => None,
        };
        params.or_fail(index, value, false)
    }
}

impl<T: CommandParam> CommandParam for Option<T> {
    #[inline(always)]
    fn take(params: &mut CommandParams, index: u8) -> Self {
        if params.value(index).float.is_nan() { None } else { Some(T::take(params, index)) }
    }
}

impl CommandParam for Location {
    #[inline(always)]
    fn take(params: &mut CommandParams, _: u8) -> Self {
        params.location
    }
}

impl Command {
    /// The command with its parameters under their names, checked by the definition's rule.
    ///
    /// A field is an `Option` where that rule lets NaN pass, which means "default" (C-8). A position and an altitude need not
    /// be given: a vehicle that needs them says so in its [`CommandPolicy`](crate::CommandPolicy), or refuses when they
    /// are `None`.
    ///
    /// ```
    /// use mavstack::dialect::commands::{ComponentArmDisarm, NavTakeoff};
    /// use mavstack::dialect::{MavCmd, MavResult};
    /// use mavstack::{Command, Commands, Outcome};
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
    ///     fn command(&mut self, command: &Command) -> Outcome {
    ///         self.carry_out(command).unwrap_or_else(Outcome::from)
    ///     }
    /// }
    /// ```
    ///
    /// # Errors
    ///
    /// The COMMAND_ACK's result: DENIED for a parameter that the rule does not admit (C-9), half a position, or one off
    /// the globe; COMMAND_UNSUPPORTED_MAV_FRAME for the position of a COMMAND_INT in a frame that is neither global nor
    /// MISSION; UNSUPPORTED when this is another command.
    pub fn decode<T: TypedCommand>(&self) -> Result<T, MavResult> {
        self.decode_by(const { &T::LOOSE })
    }

    /// [`decode`](Self::decode) by a rule of the vehicle's own, in all that it says of frame, position and altitude too. A
    /// NaN that such a rule admits is a NaN in a field that is no `Option`.
    ///
    /// # Errors
    ///
    /// Those of [`decode`](Self::decode); DENIED also for a value that its field cannot hold.
    pub fn decode_by<T: TypedCommand>(&self, rule: &CommandRule) -> Result<T, MavResult> {
        let mut params = CommandParams::NEW;
        params.read_command(self, rule)?;
        let command = T::take(&mut params);
        if params.failed == 0 { Ok(command) } else { Err(MavResult::DENIED) }
    }
}

impl Item {
    /// The item's command with its parameters under their names, as [`Command::decode`] has it: in a plan that went live
    /// every item passes, unless the vehicle's own rules admit what the definition does not.
    ///
    /// # Errors
    ///
    /// The MISSION_ACK's type: INVALID_PARAM1 to 7, UNSUPPORTED_FRAME, UNSUPPORTED when this is another command.
    pub fn decode<T: TypedCommand>(&self) -> Result<T, MavMissionResult> {
        self.decode_by(const { &T::LOOSE })
    }

    /// [`decode`](Self::decode) by a rule of the vehicle's own, as [`Command::decode_by`] has it.
    ///
    /// # Errors
    ///
    /// Those of [`decode`](Self::decode).
    pub fn decode_by<T: TypedCommand>(&self, rule: &CommandRule) -> Result<T, MavMissionResult> {
        let mut params = CommandParams::NEW;
        params.read_item(self, rule)?;
        let command = T::take(&mut params);
        match params.failed {
            0 => Ok(command),
            1 => Err(MavMissionResult::INVALID_PARAM1),
            2 => Err(MavMissionResult::INVALID_PARAM2),
            3 => Err(MavMissionResult::INVALID_PARAM3),
            4 => Err(MavMissionResult::INVALID_PARAM4),
            5 => Err(MavMissionResult::INVALID_PARAM5_X),
            6 => Err(MavMissionResult::INVALID_PARAM6_Y),
            _ => Err(MavMissionResult::INVALID_PARAM7),
        }
    }
}
