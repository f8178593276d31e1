//! What a command's parameters may be: one rule a command, as data.
//!
//! Implements the checks of one item (M-38, M-74, SEC-14) and of a command's parameters (C-8, C-9). The rules of all
//! commands are made from the definitions (see [`mod@crate::dialect::rules`]); a vehicle names those of the commands that it flies in
//! [`Plans::MISSION_COMMANDS`](crate::Plans::MISSION_COMMANDS), narrowed or widened as it needs, and only what it names
//! costs flash.

use super::item::{Item, Position, position};
use crate::dialect::{MavCmd, MavFrame, MavMissionResult, rules};
use crate::num;

// In words of the processor: on a microcontroller 20 bytes a command, and 16 a parameter that has a rule.
const _: () = assert!(size_of::<CommandRule>() == 5 * size_of::<usize>());
const _: () = assert!(size_of::<ParamRule>() == 4 * size_of::<usize>());

/// Farther up or down is no place for a vehicle, m (M-38).
const MAX_ALTITUDE: f32 = 1e6;
/// Greatest latitude, deg·1e7.
const MAX_LATITUDE: u32 = 900_000_000;
/// Greatest longitude, deg·1e7.
const MAX_LONGITUDE: u32 = 1_800_000_000;

/// From this number on, a parameter 5 or 6 outside [`MavFrame::MISSION`] was scaled like degrees by its sender (M-75).
const SCALED: u32 = 1_000_000;

/// The commands of common without a position.
#[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
const WITHOUT_POSITION: &[u16] = {
    const COUNT: usize = {
        let (mut count, mut rest) = (0, rules::ALL);
        while let [rule, tail @ ..] = rest {
            count += if rule.is_located() { 0 } else { 1 };
            rest = tail;
        }
        count
    };
    const IDS: [u16; COUNT] = {
        let (mut ids, mut at, mut rest) = ([0; COUNT], 0, rules::ALL);
        while let [rule, tail @ ..] = rest {
            if !rule.is_located() {
                ids[at] = rule.command.0;
                at += 1;
            }
            rest = tail;
        }
        ids
    };
    &IDS
};

/// Whether parameters 5 and 6 of a command are a position. The command's own description says so, not the frame that a sender
/// writes (M-75). One that common does not know may have a position.
pub(crate) const fn has_position(command: MavCmd) -> bool {
    let mut rest = WITHOUT_POSITION;
    while let [id, tail @ ..] = rest {
        if *id == command.0 {
            return false;
        }
        rest = tail;
    }
    true
}

/// Whether a number in parameter 5 or 6 of a command without a position was scaled by its sender (M-75).
pub(crate) fn is_scaled(number: i32, frame: MavFrame) -> bool {
    frame != MavFrame::MISSION && number != i32::MAX && number.unsigned_abs() >= SCALED
}

/// What one parameter of a command may be. What no rule names may be any number and NaN, but not infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParamRule {
    index: u8,
    nan: bool,
    values: Values,
}

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Values {
    Range(f32, f32),
    Integers(i32, i32),
    Bits(u32),
    Listed(&'static [i32]),
}

impl ParamRule {
    const fn new(index: u8, values: Values) -> Self {
        Self { index, nan: false, values }
    }

    /// Parameter `index` may be anything but infinite: the same as no rule, to lift one of the definitions.
    pub const fn any(index: u8) -> Self {
        Self::range(index, f32::MIN, f32::MAX).or_nan()
    }

    /// Parameter `index`, from 1 to 7, is from `min` to `max`, both included.
    pub const fn range(index: u8, min: f32, max: f32) -> Self {
        Self::new(index, Values::Range(min, max))
    }

    /// Parameter `index` is `min` or more, but not infinite.
    pub const fn at_least(index: u8, min: f32) -> Self {
        Self::range(index, min, f32::MAX)
    }

    /// Parameter `index` is `max` or less, but not infinite.
    pub const fn at_most(index: u8, max: f32) -> Self {
        Self::range(index, f32::MIN, max)
    }

    /// Parameter `index` is an integer from `min` to `max`, both included.
    pub const fn integers(index: u8, min: i32, max: i32) -> Self {
        Self::new(index, Values::Integers(min, max))
    }

    /// Parameter `index` has no bits but those of `mask`. A float has 24 of them without gaps; bit 31 is never taken.
    pub const fn bits(index: u8, mask: u32) -> Self {
        Self::new(index, Values::Bits(mask))
    }

    /// Parameter `index` is one of these integers.
    pub const fn one_of(index: u8, values: &'static [i32]) -> Self {
        Self::new(index, Values::Listed(values))
    }

    /// NaN passes too: it means "default" (M-70), and the vehicle knows one.
    #[must_use]
    pub const fn or_nan(self) -> Self {
        Self { nan: true, ..self }
    }

    /// The parameter's number, from 1 to 7.
    pub const fn index(&self) -> u8 {
        self.index
    }

    /// Whether the parameter may be this.
    pub fn admits(&self, value: f32) -> bool {
        self.admits_value(Value::of_float(value))
    }

    fn admits_value(&self, value: Value) -> bool {
        let float = value.float;
        if float.is_nan() {
            return self.nan;
        }
        let integer = value.integer();
        match self.values {
            Values::Range(min, max) => min <= float && float <= max,
            Values::Integers(min, max) => integer.is_some_and(|value| min <= value && value <= max),
            Values::Bits(mask) => integer.is_some_and(|value| value >= 0 && value.cast_unsigned() & !mask == 0),
            // Not `contains`, which is unrolled.
            Values::Listed(values) => values.iter().any(|value| Some(*value) == integer),
        }
    }
}

/// A parameter as it came.
#[derive(Clone, Copy)]
pub(crate) struct Value {
    /// NaN when it is not given.
    pub float: f32,
    /// What came as an integer, which may be no float; `i32::MAX` if it came as a float. Not an `Option`: seven of these are on the call
    /// stack of a hook that decodes a command.
    exact: i32,
}

impl Value {
    /// Not given.
    pub const NONE: Self = Self { float: f32::NAN, exact: i32::MAX };

    pub fn of_float(float: f32) -> Self {
        Self { float, exact: i32::MAX }
    }

    /// One that was scaled like degrees.
    pub fn of_1e7(scaled: i32) -> Self {
        Self::of_float(num::from_1e7(scaled))
    }

    /// `i32::MAX` is "not given" (C-7).
    pub fn of_integer(integer: i32) -> Self {
        Self { float: num::from_i32(integer), exact: integer }
    }

    /// The integer that it is.
    pub fn integer(self) -> Option<i32> {
        if self.exact == i32::MAX { num::integer(self.float) } else { Some(self.exact) }
    }
}

/// One of the kinds of frame that plans know, for a set of them: a frame and its `_INT` twin are one (M-4).
const fn frame_bit(frame: MavFrame) -> u8 {
    match frame {
        MavFrame::GLOBAL | MavFrame::GLOBAL_INT => 1,
        MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT => 2,
        MavFrame::GLOBAL_TERRAIN_ALT | MavFrame::GLOBAL_TERRAIN_ALT_INT => TERRAIN,
        MavFrame::MISSION => 8,
        _ => 0,
    }
}

/// Above the terrain.
const TERRAIN: u8 = 4;
/// The global frames.
const GLOBAL: u8 = 1 | 2 | TERRAIN;
/// All that plans know.
const ANY_FRAME: u8 = GLOBAL | 8;

/// Parameters 5, 6, 7 are a position.
const LOCATED: u8 = 1;
/// It need not be given.
const POSITION_OPTIONAL: u8 = 2;
/// z need not be a number.
const ALTITUDE_OPTIONAL: u8 = 4;
/// A position of 0, 0 means "not set" and is refused.
const ZERO_REFUSED: u8 = 8;

/// The flags of a command with a position: ground stations write 0, 0 when no position was set, and a waypoint without a
/// position is meaningless (M-48).
const fn located(command: MavCmd) -> u8 {
    match command {
        MavCmd::NAV_WAYPOINT
        | MavCmd::NAV_ARC_WAYPOINT
        | MavCmd::NAV_SPLINE_WAYPOINT
        | MavCmd::WAYPOINT_USER_1
        | MavCmd::WAYPOINT_USER_2
        | MavCmd::WAYPOINT_USER_3
        | MavCmd::WAYPOINT_USER_4
        | MavCmd::WAYPOINT_USER_5 => LOCATED | ZERO_REFUSED,
        _ => LOCATED,
    }
}

/// Whether a position of 0, 0 is "here" to this command: not to a waypoint, which has it only where the vehicle says that it is a
/// place like others (M-48).
pub(crate) const fn is_zero_here(command: MavCmd) -> bool {
    located(command) & ZERO_REFUSED == 0
}

/// What the items of one command may be.
///
/// ```
/// use mavstack::dialect::rules::{DO_JUMP, NAV_LAND, NAV_TAKEOFF, NAV_WAYPOINT};
/// use mavstack::dialect::{MavCmd, MavFrame};
/// use mavstack::CommandRule;
/// use mavstack::message::ParamRule;
///
/// /// What our copter flies. It has no model of the terrain, passes no waypoint at a distance, and takes off where it
/// /// stands; its winch has a command of its own.
/// const COMMANDS: &[CommandRule] = &[
///     NAV_WAYPOINT
///         .with_frames(&[MavFrame::GLOBAL, MavFrame::GLOBAL_RELATIVE_ALT])
///         .with_params(&[ParamRule::integers(3, 0, 0).or_nan()]),
///     NAV_TAKEOFF.any_frame(),
///     NAV_LAND,
///     DO_JUMP,
///     CommandRule::any(MavCmd(31_010)),
/// ];
/// # assert_eq!(COMMANDS[2].command(), MavCmd::NAV_LAND);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CommandRule {
    command: MavCmd,
    frames: u8,
    flags: u8,
    /// From the definitions.
    params: &'static [ParamRule],
    /// The vehicle's own, which go before.
    own: &'static [ParamRule],
}

impl CommandRule {
    /// Every item of this command passes that has a frame that plans know, no infinite number, and in a global frame a
    /// position on the globe or none. A command that common defines without a position has none here either, and its
    /// parameters 5 and 6 are plain numbers (M-75). One of the firmware's own without a position is
    /// [`without_position`](Self::without_position).
    pub const fn any(command: MavCmd) -> Self {
        if !has_position(command) {
            return Self::without_position(command.0, &[]);
        }
        Self::at_position(command.0, &[]).any_frame().position_optional().altitude_optional().zero_position_allowed()
    }

    /// A command whose parameters 5, 6, 7 are a position, in a global frame. For generated code.
    pub const fn at_position(command: u16, params: &'static [ParamRule]) -> Self {
        let command = MavCmd(command);
        Self { command, frames: GLOBAL, flags: located(command), params, own: &[] }
    }

    /// A command without a position, with the rules of its parameters. Its frame says nothing: MISSION is the right one, and
    /// the global ones are what older ground stations write. Parameters 5 and 6 are plain numbers in all of them. An item with
    /// 1,000,000 and more there is refused outside MISSION, because its sender has scaled it like degrees (M-75).
    pub const fn without_position(command: u16, params: &'static [ParamRule]) -> Self {
        Self { command: MavCmd(command), frames: ANY_FRAME, flags: 0, params, own: &[] }
    }

    /// The vehicle's rules; each replaces the definition's rule for that parameter. Calling it again replaces the
    /// rules of
    /// the call before.
    #[must_use]
    pub const fn with_params(self, params: &'static [ParamRule]) -> Self {
        Self { own: params, ..self }
    }

    /// Only these frames, and their `_INT` twins. A plan's frames are the global ones and MISSION; others are left out.
    #[must_use]
    pub const fn with_frames(self, frames: &[MavFrame]) -> Self {
        let mut set = 0;
        let mut rest = frames;
        while let [frame, tail @ ..] = rest {
            set |= frame_bit(*frame);
            rest = tail;
        }
        Self { frames: set, ..self }
    }

    /// Also the frame MISSION, in which there is no position: parameters 5 and 6 are then plain numbers.
    #[must_use]
    pub const fn any_frame(self) -> Self {
        Self { frames: ANY_FRAME, ..self }
    }

    /// x and y may both be `i32::MAX`: "here", or what else is the command's default (M-70).
    #[must_use]
    pub const fn position_optional(self) -> Self {
        Self { flags: self.flags | POSITION_OPTIONAL, ..self }
    }

    /// x and y must be given.
    #[must_use]
    pub const fn position_required(self) -> Self {
        Self { flags: self.flags & !POSITION_OPTIONAL, ..self }
    }

    /// Accepts a latitude and longitude of 0, 0. The vehicle decides what it means: for example "here" in a take-off, a
    /// landing or a loiter. This is the default, except for waypoints (M-48). The item is stored and downloaded as
    /// received.
    #[must_use]
    pub const fn zero_position_allowed(self) -> Self {
        Self { flags: self.flags & !ZERO_REFUSED, ..self }
    }

    /// Refuses a latitude and longitude of 0, 0 in a global frame, as "not set", with `INVALID_PARAM5_X`. This is the
    /// default for NAV_WAYPOINT, NAV_SPLINE_WAYPOINT, NAV_ARC_WAYPOINT and WAYPOINT_USER_1 to 5 (M-48).
    #[must_use]
    pub const fn zero_position_refused(self) -> Self {
        Self { flags: self.flags | ZERO_REFUSED, ..self }
    }

    /// z may be NaN: "as it is", or what else is the command's default.
    #[must_use]
    pub const fn altitude_optional(self) -> Self {
        Self { flags: self.flags | ALTITUDE_OPTIONAL, ..self }
    }

    /// z must be a number.
    #[must_use]
    pub const fn altitude_required(self) -> Self {
        Self { flags: self.flags & !ALTITUDE_OPTIONAL, ..self }
    }

    /// Which command.
    pub const fn command(&self) -> MavCmd {
        self.command
    }

    const fn has(&self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// Whether parameters 5, 6, 7 are a position.
    pub(crate) const fn is_located(&self) -> bool {
        self.has(LOCATED)
    }

    /// Whether parameter `index` may be `value`: never infinite.
    pub(crate) fn admits(&self, index: u8, value: Value) -> bool {
        let of = |rules: &'static [ParamRule]| rules.iter().find(|rule| rule.index == index);
        let rule = of(self.own).or_else(|| of(self.params));
        !value.float.is_infinite() && rule.is_none_or(|rule| rule.admits_value(value))
    }

    /// Whether the command has an altitude above the terrain: in `frame`, or in that of a parameter (M-49).
    pub(crate) fn needs_terrain(&self, frame: MavFrame, params: &[f32; 4]) -> bool {
        let [_, second, third, _] = *params;
        let (own_frame, has_altitude) = match self.command {
            MavCmd::DO_CHANGE_ALTITUDE => (second, false),
            MavCmd::OVERRIDE_GOTO => (third, true),
            MavCmd::NAV_CONTINUE_AND_CHANGE_ALT | MavCmd::CONDITION_CHANGE_ALT => (0.0, true),
            _ => (0.0, self.is_located()),
        };
        // 10 and 11 are the frames above the terrain.
        own_frame == 10.0 || own_frame == 11.0 || (has_altitude && is_above_terrain(frame))
    }

    /// Like [`check`](Self::check), for a vehicle with or without a model of the terrain (M-49).
    pub(crate) fn check_for(&self, item: &Item, has_terrain: bool) -> Result<(), MavMissionResult> {
        let is_unknown = !has_terrain && self.needs_terrain(item.frame, &item.params);
        refuse(is_unknown, MavMissionResult::UNSUPPORTED_FRAME)?;
        self.check(item)
    }

    /// Checks an item of this command.
    ///
    /// # Errors
    ///
    /// The code of the first fault; the order is frame, parameters 1 to 4, x, y, z.
    pub fn check(&self, item: &Item) -> Result<(), MavMissionResult> {
        let position = position(item.frame).filter(|_| self.frames & frame_bit(item.frame) != 0);
        let is_global = position.ok_or(MavMissionResult::UNSUPPORTED_FRAME)? == Position::Global;
        for (index, &param) in (1u8..).zip(&item.params) {
            // INVALID_PARAM1 to INVALID_PARAM4.
            let result = MavMissionResult(MavMissionResult::INVALID_PARAM1.0.wrapping_add(index).wrapping_sub(1));
            refuse(!self.admits(index, Value::of_float(param)), result)?;
        }
        let (is_x_bad, is_y_bad) = if self.has(LOCATED) && is_global {
            // Half a position is none.
            let is_absent = item.x == i32::MAX && item.y == i32::MAX && self.has(POSITION_OPTIONAL);
            let is_bad = |value: i32, limit| !is_absent && value.unsigned_abs() > limit;
            let is_unset = item.x == 0 && item.y == 0 && self.has(ZERO_REFUSED);
            (is_unset || is_bad(item.x, MAX_LATITUDE), is_bad(item.y, MAX_LONGITUDE))
        } else {
            // Plain numbers in every frame. Importers scale them like degrees outside MISSION (M-75).
            let is_bad =
                |index, number| is_scaled(number, item.frame) || !self.admits(index, Value::of_integer(number));
            (is_bad(5, item.x), is_bad(6, item.y))
        };
        refuse(is_x_bad, MavMissionResult::INVALID_PARAM5_X)?;
        refuse(is_y_bad, MavMissionResult::INVALID_PARAM6_Y)?;
        // Without a position z is a parameter like others, and clients send NaN for one that the command does not use.
        let is_altitude = self.has(LOCATED) && is_global;
        let is_absent = item.z.is_nan() && !self.has(ALTITUDE_OPTIONAL);
        let is_z_bad =
            !self.admits(7, Value::of_float(item.z)) || (is_altitude && (is_absent || item.z.abs() > MAX_ALTITUDE));
        refuse(is_z_bad, MavMissionResult::INVALID_PARAM7)
    }
}

/// Whether the frame's altitudes are above the terrain.
pub(crate) const fn is_above_terrain(frame: MavFrame) -> bool {
    matches!(frame, MavFrame::GLOBAL_TERRAIN_ALT | MavFrame::GLOBAL_TERRAIN_ALT_INT)
}

fn refuse(bad: bool, result: MavMissionResult) -> Result<(), MavMissionResult> {
    if bad { Err(result) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::rules::{DO_GIMBAL_MANAGER_PITCHYAW, NAV_TAKEOFF, NAV_WAYPOINT};
    use proptest::prelude::*;

    const NAN: f32 = f32::NAN;
    const HERE: Item = Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [0.0, 0.0, 0.0, NAN],
        x: i32::MAX,
        y: i32::MAX,
        z: 10.0,
    };

    fn any_item() -> impl Strategy<Value = Item> {
        let floats = any::<[u32; 5]>().prop_map(|bits| bits.map(f32::from_bits));
        (floats, any::<(i32, i32, u8)>()).prop_map(|([p1, p2, p3, p4, z], (x, y, frame))| Item {
            frame: MavFrame(frame),
            params: [p1, p2, p3, p4],
            x,
            y,
            z,
            ..HERE
        })
    }

    #[test]
    fn a_rule_admits_its_values() {
        let infinite = f32::INFINITY;
        for (rule, good, bad) in [
            (ParamRule::range(1, -1.5, 2.0), &[-1.5, 0.0, 2.0][..], &[-1.6, 2.1, infinite, -infinite, NAN][..]),
            (ParamRule::at_least(1, 3.0), &[3.0, f32::MAX], &[2.9, infinite, NAN]),
            (ParamRule::at_most(1, 3.0), &[3.0, f32::MIN], &[3.1, -infinite, NAN]),
            (ParamRule::integers(1, -2, 7), &[-2.0, -0.0, 7.0], &[-3.0, 8.0, 0.5, 1e20, infinite, NAN]),
            (ParamRule::integers(1, i32::MIN, i32::MAX), &[-2_147_483_648.0, 2_147_483_520.0], &[2_147_483_648.0, NAN]),
            (ParamRule::bits(1, 0b101), &[0.0, 1.0, 4.0, 5.0], &[2.0, 8.0, -1.0, 0.5, infinite, NAN]),
            (ParamRule::one_of(1, &[-7, 400]), &[-7.0, 400.0], &[0.0, -7.5, 401.0, NAN]),
            (ParamRule::one_of(1, &[]), &[], &[0.0]),
            (ParamRule::integers(1, 0, 1).or_nan(), &[NAN, -NAN, 1.0], &[2.0, infinite]),
            (ParamRule::any(1), &[NAN, f32::MAX, f32::MIN], &[infinite, -infinite]),
        ] {
            assert!(good.iter().all(|value| rule.admits(*value)), "{rule:?}");
            assert!(!bad.iter().any(|value| rule.admits(*value)), "{rule:?}");
        }
    }

    /// M-74: the vehicle's word goes before the definitions'.
    #[test]
    fn a_vehicle_narrows_and_widens() {
        let item = Item { x: 0, y: 1, params: [-1.0, 99.0, 3.0, NAN], ..HERE };
        let code = |rule: CommandRule| rule.check(&item);
        assert_eq!(code(NAV_WAYPOINT), Err(MavMissionResult::INVALID_PARAM1));
        const OWN: &[ParamRule] = &[ParamRule::any(1), ParamRule::range(2, 0.0, 50.0)];
        assert_eq!(code(NAV_WAYPOINT.with_params(OWN)), Err(MavMissionResult::INVALID_PARAM2));
        const FREE: CommandRule = NAV_WAYPOINT.with_params(&[ParamRule::any(1)]);
        assert_eq!(code(FREE), Ok(()));
        const YAW: &[ParamRule] = &[ParamRule::any(1), ParamRule::range(4, -180.0, 180.0)];
        assert_eq!(code(NAV_WAYPOINT.with_params(YAW)), Err(MavMissionResult::INVALID_PARAM4), "NaN is out of a range");
    }

    /// M-4: a frame and its twin are one.
    #[test]
    fn frames_come_in_pairs() {
        let taken = |rule: CommandRule| {
            let passes = |frame: u8| rule.check(&Item { x: 0, y: 1, frame: MavFrame(frame), ..HERE }).is_ok();
            (0..=u8::MAX).filter(|frame| passes(*frame)).collect::<std::vec::Vec<_>>()
        };
        assert_eq!(taken(NAV_WAYPOINT), [0, 3, 5, 6, 10, 11]);
        assert_eq!(taken(NAV_WAYPOINT.any_frame()), [0, 2, 3, 5, 6, 10, 11]);
        assert_eq!(taken(NAV_WAYPOINT.with_frames(&[MavFrame::GLOBAL_RELATIVE_ALT_INT])), [3, 6]);
        assert_eq!(taken(NAV_WAYPOINT.with_frames(&[MavFrame::GLOBAL, MavFrame::LOCAL_NED])), [0, 5]);
        assert_eq!(taken(NAV_WAYPOINT.with_frames(&[])), [] as [u8; 0]);
    }

    /// M-70
    #[test]
    fn here_is_a_place_where_the_command_has_one() {
        assert_eq!(NAV_TAKEOFF.check(&HERE), Ok(()));
        assert_eq!(NAV_TAKEOFF.position_required().check(&HERE), Err(MavMissionResult::INVALID_PARAM5_X));
        assert_eq!(NAV_WAYPOINT.check(&HERE), Err(MavMissionResult::INVALID_PARAM5_X));
        assert_eq!(NAV_WAYPOINT.check(&Item { x: 0, ..HERE }), Err(MavMissionResult::INVALID_PARAM6_Y));
        assert_eq!(NAV_WAYPOINT.position_optional().check(&HERE), Ok(()));
        let any_altitude = Item { z: NAN, ..HERE };
        assert_eq!(NAV_TAKEOFF.check(&any_altitude), Err(MavMissionResult::INVALID_PARAM7));
        assert_eq!(NAV_TAKEOFF.altitude_optional().check(&any_altitude), Ok(()));
        assert_eq!(NAV_TAKEOFF.altitude_optional().altitude_required(), NAV_TAKEOFF);
        // In MISSION there is no place, and no altitude to miss.
        let mission = Item { frame: MavFrame::MISSION, x: i32::MIN, y: 2_000_000_000, z: NAN, ..HERE };
        assert_eq!(NAV_TAKEOFF.any_frame().check(&mission), Ok(()));
    }

    /// M-48: a waypoint at 0, 0 in a global frame is refused, unless the vehicle accepts it; other commands accept it.
    #[test]
    fn zero_is_no_waypoint() {
        let zero = |frame| Item { frame, x: 0, y: 0, ..HERE };
        let refused = Err(MavMissionResult::INVALID_PARAM5_X);
        let above_home = MavFrame::GLOBAL_RELATIVE_ALT;
        for rule in rules::ALL.iter().filter(|rule| rule.is_located()) {
            let is_waypoint = matches!(rule.command().0, 16 | 36 | 82 | 31_000..=31_004);
            let item = Item { command: rule.command(), params: [0.0; 4], ..zero(above_home) };
            let near = Item { x: -1, ..item };
            assert_eq!(rule.check(&item) == refused && rule.check(&near).is_ok(), is_waypoint, "{rule:?}");
            assert_eq!(rule.zero_position_allowed().check(&item), rule.zero_position_allowed().check(&near));
            if rule.check(&near).is_ok() {
                assert_eq!(rule.zero_position_refused().check(&item), refused, "{rule:?}");
            }
        }
        for item in [zero(MavFrame::GLOBAL), zero(MavFrame::GLOBAL_TERRAIN_ALT_INT)] {
            assert_eq!(NAV_WAYPOINT.check(&item), refused);
            assert_eq!(NAV_WAYPOINT.position_optional().check(&item), refused, "\"not given\" is i32::MAX");
            assert_eq!(NAV_WAYPOINT.check(&Item { x: 1, ..item }), Ok(()));
            assert_eq!(NAV_WAYPOINT.check(&Item { y: -1, ..item }), Ok(()));
        }
        assert_eq!(NAV_WAYPOINT.any_frame().check(&zero(MavFrame::MISSION)), Ok(()), "this frame has no position");
        assert_eq!(CommandRule::any(MavCmd::NAV_WAYPOINT).check(&zero(above_home)), Ok(()));
    }

    /// M-75: parameters 5 and 6 of a command without a position are plain numbers in every frame. QGroundControl and MAVSDK's
    /// importers scale them outside MISSION: those are refused.
    #[test]
    fn without_a_place_five_and_six_are_plain_numbers() {
        let rule = DO_GIMBAL_MANAGER_PITCHYAW;
        let item = Item { frame: MavFrame::MISSION, params: [0.0; 4], x: 12, y: i32::MIN, z: NAN, ..HERE };
        assert_eq!(rule.check(&item), Ok(()));
        let too_much = Item { x: 1024, ..item };
        assert_eq!(rule.check(&too_much), Err(MavMissionResult::INVALID_PARAM5_X));
        let any = CommandRule::any(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW);
        for frame in [0, 3, 5, 6, 10, 11].map(MavFrame) {
            let at = |x, y| Item { frame, x, y, ..item };
            for rule in [rule, any] {
                for (x, y) in [(12, 0), (0, -999_999), (0, 999_999), (12, i32::MAX)] {
                    assert_eq!(rule.check(&at(x, y)), Ok(()), "{frame:?} {x} {y}");
                }
                for (number, result) in [1_000_000, -1_000_000, 120_000_000, i32::MIN].map(|number| (number, 10)) {
                    assert_eq!(rule.check(&at(number, 0)), Err(MavMissionResult(result)), "{frame:?} {number}");
                    assert_eq!(rule.check(&at(0, number)), Err(MavMissionResult(result + 1)), "{frame:?} {number}");
                }
            }
        }
        assert_eq!(any.check(&Item { x: 120_000_000, ..item }), Ok(()), "MISSION is never scaled");
    }

    /// M-75: the definitions say whether a command has a position; of unknown ones nothing is known.
    #[test]
    fn positions_are_those_of_the_definitions() {
        for rule in rules::ALL {
            assert_eq!(has_position(rule.command()), rule.is_located(), "{rule:?}");
        }
        assert!(has_position(MavCmd::DO_SET_ROI) && !has_position(MavCmd::DO_JUMP));
        assert!(has_position(MavCmd(65_535)) && CommandRule::any(MavCmd(65_535)).is_located());
    }

    proptest! {
        /// Whatever comes, nothing panics; what passes has no infinite number and a frame that plans know.
        #[test]
        fn any_item_is_checked(item in any_item(), which in 0..rules::ALL.len(), frame in 0u8..12) {
            let rule = rules::ALL[which];
            for rule in [rule, CommandRule::any(rule.command())] {
                for item in [item, Item { frame: MavFrame(frame), ..item }] {
                    let is_finite = !item.params.iter().chain([&item.z]).any(|value| value.is_infinite());
                    if rule.check(&item).is_ok() {
                        prop_assert!(is_finite && position(item.frame).is_some());
                    }
                }
            }
        }
    }
}
