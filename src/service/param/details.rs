//! What a declaration says about a parameter besides its protocol: units, descriptions, names of values. A ground station shows it.

use super::info::ParamInfo;
use super::value;
use crate::dialect::MavParamType;

/// The details of a parameter that [`parameters!`](crate::parameters) declares. The file of
/// [`metadata::parameters`](crate::metadata) has them. A firmware that does not use them does not have them in flash.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct ParamDetails {
    /// The unit; empty if there is none.
    pub unit: &'static str,
    /// The doc comment, in one line.
    pub description: &'static str,
    /// The group of a ground station's list; `None`: the part of the name before the first `_`.
    pub group: Option<&'static str>,
    /// The list that it belongs to, such as "System" or "Developer"; `None`: a ground station's default.
    pub category: Option<&'static str>,
    /// The number of decimals that a ground station shows.
    pub decimals: Option<u8>,
    /// The step by which a ground station changes it. An `f64` holds the values of all types exactly.
    pub increment: Option<f64>,
    /// Values with names, in the same form.
    pub values: &'static [(f64, &'static str)],
    /// Bits with names; bit 0 is the lowest.
    pub bitmask: &'static [(u8, &'static str)],
}

/// The attributes of a row of [`parameters!`](crate::parameters): each one is a method, so the compiler points at a wrong one.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct ParamAttributes {
    details: ParamDetails,
    is_read_only: bool,
    is_reboot_required: bool,
    is_volatile: bool,
    is_system_id: bool,
}

impl ParamAttributes {
    pub const fn new(unit: &'static str, description: &'static str) -> Self {
        let details = ParamDetails {
            unit,
            description,
            group: None,
            category: None,
            decimals: None,
            increment: None,
            values: &[],
            bitmask: &[],
        };
        Self { details, is_read_only: false, is_reboot_required: false, is_volatile: false, is_system_id: false }
    }

    #[must_use]
    pub const fn read_only(mut self) -> Self {
        self.is_read_only = true;
        self
    }

    #[must_use]
    pub const fn reboot_required(mut self) -> Self {
        self.is_reboot_required = true;
        self
    }

    #[must_use]
    pub const fn volatile(mut self) -> Self {
        self.is_volatile = true;
        self
    }

    /// The vehicle has this system id from the next start on.
    #[must_use]
    pub const fn system_id(mut self) -> Self {
        (self.is_system_id, self.is_reboot_required) = (true, true);
        self
    }

    #[must_use]
    pub const fn group(mut self, group: &'static str) -> Self {
        self.details.group = Some(group);
        self
    }

    #[must_use]
    pub const fn category(mut self, category: &'static str) -> Self {
        self.details.category = Some(category);
        self
    }

    #[must_use]
    pub const fn decimals(mut self, decimals: u8) -> Self {
        self.details.decimals = Some(decimals);
        self
    }

    #[must_use]
    pub const fn increment(mut self, increment: f64) -> Self {
        self.details.increment = Some(increment);
        self
    }

    #[must_use]
    pub const fn values(mut self, values: &'static [(f64, &'static str)]) -> Self {
        self.details.values = values;
        self
    }

    #[must_use]
    pub const fn bitmask(mut self, bitmask: &'static [(u8, &'static str)]) -> Self {
        self.details.bitmask = bitmask;
        self
    }

    pub const fn details(self) -> ParamDetails {
        self.details
    }

    /// Returns the declaration with the flags of these attributes.
    pub const fn flagged(&self, mut info: ParamInfo) -> ParamInfo {
        if self.is_read_only {
            info = info.read_only();
        }
        if self.is_reboot_required {
            info = info.reboot_required();
        }
        if self.is_volatile {
            info = info.volatile();
        }
        info
    }

    /// Whether the named values lie within the range, each once.
    pub const fn has_valid_values(&self, info: &ParamInfo) -> bool {
        let [min, max] = info.range_bits();
        let (min, max) = (number(info.param_type(), min), number(info.param_type(), max));
        let mut rest = self.details.values;
        while let [(value, _), others @ ..] = rest {
            let mut later = others;
            while let [(other, _), after @ ..] = later {
                if *other == *value {
                    return false;
                }
                later = after;
            }
            if !(min <= *value && *value <= max) {
                return false;
            }
            rest = others;
        }
        true
    }

    /// Whether the named bits are values within the range of an integer, each once, and no values have names too.
    pub const fn has_valid_bits(&self, info: &ParamInfo) -> bool {
        let (mut rest, mut seen) = (self.details.bitmask, 0u32);
        let is_float = matches!(info.param_type(), MavParamType::REAL32);
        if !rest.is_empty() && (is_float || !self.details.values.is_empty()) {
            return false;
        }
        while let [(index, _), others @ ..] = rest {
            let Some(bit) = 1u32.checked_shl(u32_from(*index)) else { return false };
            if seen & bit != 0 || !info.is_valid(bit) {
                return false;
            }
            (seen, rest) = (seen | bit, others);
        }
        true
    }

    /// Whether a number of decimals is a float's, and the step is positive.
    pub const fn has_valid_steps(&self, info: &ParamInfo) -> bool {
        let is_float = matches!(info.param_type(), MavParamType::REAL32);
        let has_valid_decimals = self.details.decimals.is_none() || is_float;
        has_valid_decimals && !matches!(self.details.increment, Some(step) if !(step > 0.0 && step.is_finite()))
    }

    /// Whether it may be the system id: a stored integer from 1 to 254, the only one among `all`.
    pub const fn has_valid_system_id(&self, info: &ParamInfo, all: &[Self]) -> bool {
        let [min, max] = info.range_bits();
        let is_integer = !matches!(info.param_type(), MavParamType::REAL32);
        let is_within = 1.0 <= number(info.param_type(), min) && number(info.param_type(), max) <= 254.0;
        !self.is_system_id || is_integer && is_within && !self.is_volatile && is_single(all)
    }
}

/// Whether at most one parameter is the system id.
const fn is_single(mut all: &[ParamAttributes]) -> bool {
    let mut has_one = false;
    while let [first, rest @ ..] = all {
        if first.is_system_id && has_one {
            return false;
        }
        has_one |= first.is_system_id;
        all = rest;
    }
    true
}

/// Returns the attributes of the parameter at this index.
#[doc(hidden)]
#[allow(clippy::as_conversions, clippy::indexing_slicing, reason = "const-evaluated: `get` is not const")]
pub const fn attributes_at(all: &[ParamAttributes], index: u16) -> ParamAttributes {
    all[index as usize]
}

/// Returns the details of all parameters.
#[doc(hidden)]
#[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated, and within the array")]
pub const fn details<const N: usize>(all: &[ParamAttributes; N]) -> [ParamDetails; N] {
    let mut details = [ParamAttributes::new("", "").details; N];
    let mut index = 0;
    while index < N {
        details[index] = all[index].details;
        index += 1;
    }
    details
}

/// Returns the index of the parameter that is the system id.
#[doc(hidden)]
#[allow(clippy::arithmetic_side_effects, reason = "const-evaluated, and at most MAX_PARAMS")]
pub const fn system_id(mut all: &[ParamAttributes]) -> Option<u16> {
    let mut index = 0;
    while let [first, rest @ ..] = all {
        if first.is_system_id {
            return Some(index);
        }
        (index, all) = (index + 1, rest);
    }
    None
}

#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; nothing is cut off")]
const fn u32_from(index: u8) -> u32 {
    index as u32
}

/// Returns a value, given by its bits in the table, as a number.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; nothing is cut off")]
const fn number(r#type: MavParamType, bits: u32) -> f64 {
    match r#type {
        MavParamType::REAL32 => f32::from_bits(bits) as f64,
        _ => value::IntegerBits::of(r#type).integer(bits) as f64,
    }
}

/// The value of an attribute of a row, which a method of [`ParamAttributes`] takes.
#[doc(hidden)]
#[macro_export]
macro_rules! __parameter_attribute {
    (bitmask $ty:ident { $($index:expr => $name:expr),+ $(,)? }) => {
        const { &[$({ let index: u8 = $index; (index, $name) }),+] }
    };
    (increment $ty:ident $step:expr) => {
        const { let step: $ty = $step; step as f64 }
    };
    ($key:ident $ty:ident { $($value:expr => $name:expr),+ $(,)? }) => {
        const { &[$({ let value: $ty = $value; (value as f64, $name) }),+] }
    };
    ($key:ident $ty:ident $value:expr) => { $value };
}
