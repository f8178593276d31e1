//! The declaration of one parameter, checked by the compiler or at run time (P-1, P-3).

use core::borrow::Borrow;
use core::fmt;
use core::ops::RangeInclusive;

use super::value::{self, ParamType};
use crate::dialect::MavParamType;

/// The name of the hash, a pseudo parameter (P-20).
pub(super) const HASH_NAME: [u8; 16] = *b"_HASH_CHECK\0\0\0\0\0";

/// Maximum number of parameters in a table. The index in PARAM_REQUEST_READ is an `i16`; a parameter that cannot be requested again
/// could be lost for good (P-12).
pub const MAX_PARAMS: usize = 32_768;

/// The declaration of one parameter: its name, type, default, range and flags.
///
/// [`parameters!`](crate::parameters) generates a constant table of them. A [`RuntimeTable`](super::RuntimeTable) and a
/// [`ParamBackend`](super::ParamBackend) use those that are made at run time:
///
/// ```
/// use mavstack::dialect::MavParamType;
/// use mavstack::param::{ParamFault, ParamInfo};
///
/// let cruise = ParamInfo::new("CRUISE", 5.0, 0.5..=15.0)?.reboot_required();
/// assert_eq!((cruise.name(), cruise.param_type()), ("CRUISE", MavParamType::REAL32));
///
/// // From a table in C: the name is an array padded with zeros, and the type is a number.
/// let trim = ParamInfo::from_bits(b"TRIM\0\0\0\0", MavParamType::INT32, 3, [0, 10])?;
/// assert_eq!(trim, ParamInfo::new("TRIM", 3i32, 0..=10)?);
///
/// assert_eq!(ParamInfo::new("A_NAME_OF_17_BYTES", 0i32, 0..=1), Err(ParamFault::Name));
/// assert_eq!(ParamInfo::new("TRIM", 11i32, 0..=10), Err(ParamFault::Default));
/// # Ok::<(), ParamFault>(())
/// ```
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct ParamInfo {
    name: [u8; 16],
    default: u32,
    min: u32,
    max: u32,
    r#type: MavParamType,
    flags: u8,
}

const READ_ONLY: u8 = 1;
const REBOOT_REQUIRED: u8 = 2;
const VOLATILE: u8 = 4;

impl ParamInfo {
    /// An unused row: all zero bits.
    pub(super) const VACANT: Self =
        Self { name: [0; 16], default: 0, min: 0, max: 0, r#type: MavParamType(0), flags: 0 };

    /// Returns a declaration, checked. `text` ends at its first zero.
    pub(super) const fn checked(
        text: &[u8],
        r#type: MavParamType,
        default: u32,
        [min, max]: [u32; 2],
    ) -> Result<Self, ParamFault> {
        if !value::is_supported(r#type) {
            return Err(ParamFault::Type);
        }
        let mut name = [0; 16];
        let (mut places, mut rest): (&mut [u8], _) = (&mut name, text);
        while let Some((byte, after)) = rest.split_first()
            && *byte != 0
        {
            let Some((place, others)) = places.split_first_mut() else { return Err(ParamFault::Name) };
            if !byte.is_ascii_graphic() {
                return Err(ParamFault::Name);
            }
            *place = *byte;
            (places, rest) = (others, after);
        }
        if places.len() == 16 {
            return Err(ParamFault::Name);
        }
        let info = Self { name, default, min, max, r#type, flags: 0 };
        let has_range = value::is_value(r#type, min) && value::is_value(r#type, max);
        if has_range && info.is_valid(default) { Ok(info) } else { Err(ParamFault::Default) }
    }

    /// Returns the declaration of a parameter with this name, default and range.
    ///
    /// # Errors
    ///
    /// As [`from_bits`](Self::from_bits).
    pub fn new<T: ParamType>(name: &str, default: T, range: RangeInclusive<T>) -> Result<Self, ParamFault> {
        let (min, max) = range.into_inner();
        Self::from_bits(name.as_bytes(), T::TYPE, default.bits(), [min.bits(), max.bits()])
    }

    /// Returns the declaration of a parameter whose type is only known at run time. The name ends at its first zero, if it has
    /// one. The values are the bits of floats, or integers in the low bytes, padded with zeros: see [`ParamType::bits`].
    ///
    /// # Errors
    ///
    /// - [`ParamFault::Name`]: the name does not have 1 to 16 printable ASCII bytes, or is `_HASH_CHECK`.
    /// - [`ParamFault::Type`]: the type has 64 bits, or is no type.
    /// - [`ParamFault::Default`]: the default is out of range, or a float is not finite.
    pub fn from_bits(name: &[u8], param_type: MavParamType, default: u32, range: [u32; 2]) -> Result<Self, ParamFault> {
        match Self::checked(name, param_type, default, range) {
            Ok(info) if info.name == HASH_NAME => Err(ParamFault::Name),
            result => result,
        }
    }

    /// Makes it read-only: clients get PARAM_ERROR READ_ONLY (P-14); the vehicle itself can set it.
    #[must_use]
    pub const fn read_only(mut self) -> Self {
        self.flags |= READ_ONLY;
        self
    }

    /// Declares that a change takes effect only after the next start.
    #[must_use]
    pub const fn reboot_required(mut self) -> Self {
        self.flags |= REBOOT_REQUIRED;
        self
    }

    /// Excludes it from storage and from the hash (P-20).
    #[must_use]
    pub const fn volatile(mut self) -> Self {
        self.flags |= VOLATILE;
        self
    }

    /// Returns the name.
    pub fn name(&self) -> &str {
        core::str::from_utf8(self.name_bytes()).unwrap_or_default()
    }

    /// Returns the type as in messages.
    pub const fn param_type(&self) -> MavParamType {
        self.r#type
    }

    /// Returns the default value: the bits of a float, or an integer in the low bytes, padded with zeros.
    pub const fn default_bits(&self) -> u32 {
        self.default
    }

    /// Returns the minimum and the maximum, in the form of [`default_bits`](Self::default_bits).
    pub const fn range_bits(&self) -> [u32; 2] {
        [self.min, self.max]
    }

    /// Whether only the vehicle itself can set it.
    pub const fn is_read_only(&self) -> bool {
        self.flags & READ_ONLY != 0
    }

    /// Whether a change takes effect only after the next start.
    pub const fn is_reboot_required(&self) -> bool {
        self.flags & REBOOT_REQUIRED != 0
    }

    /// Whether it is excluded from storage and from the hash.
    pub const fn is_volatile(&self) -> bool {
        self.flags & VOLATILE != 0
    }

    /// Returns the name without the padding.
    pub(super) fn name_bytes(&self) -> &[u8] {
        self.name.split(|byte| *byte == 0).next().unwrap_or_default()
    }

    /// Returns the 16 bytes of the name on the wire.
    pub(crate) const fn wire_name(&self) -> &[u8; 16] {
        &self.name
    }

    /// Whether these bits are a valid value.
    pub(crate) const fn is_valid(&self, bits: u32) -> bool {
        value::is_within(self.r#type, bits, [self.min, self.max])
    }
}

/// The parameters of a firmware with their values, wherever they are.
pub trait Rows {
    /// A declaration.
    type Info: Borrow<ParamInfo>;

    /// Returns the number of parameters.
    fn count(&self) -> u16;

    /// Returns a parameter and its value.
    fn get(&self, index: u16) -> Option<(Self::Info, u32)>;

    /// Returns the index of the parameter with this name.
    fn find(&self, name: &[u8; 16]) -> Option<u16>;
}

/// Why a declaration, or a table of them, cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ParamFault {
    /// The name does not have 1 to 16 printable ASCII bytes, or is `_HASH_CHECK` (P-1).
    Name,
    /// PARAM_VALUE cannot carry the type (P-3).
    Type,
    /// The default is out of range, or a float is not finite.
    Default,
    /// Another parameter has the same name (P-1).
    Taken,
    /// There is no room for another parameter: declare more.
    NoRoom,
    /// The table is in use, so it must not change any more (P-1): add all parameters before the first poll.
    Sealed,
    /// The names are not in ASCII order, although the backend says so (P-20).
    Order,
    /// The backend has no declaration or no valid value for one of its indices.
    Missing,
}

impl fmt::Display for ParamFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Name => "a parameter's name has 1 to 16 printable ASCII bytes, and is not _HASH_CHECK",
            Self::Type => "a parameter has an integer type of up to 32 bits, or REAL32",
            Self::Default => "a parameter's default is finite and within its range",
            Self::Taken => "two parameters have the same name",
            Self::NoRoom => "there is no room for another parameter: declare more",
            Self::Sealed => "the table is in use: add all parameters before the first poll",
            Self::Order => "the names are not in ASCII order",
            Self::Missing => "a parameter has no declaration, or no valid value",
        })
    }
}

impl core::error::Error for ParamFault {}

impl fmt::Debug for ParamInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ParamInfo").field("name", &self.name()).field("type", &self.r#type).finish_non_exhaustive()
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for ParamInfo {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{=str}", self.name());
    }
}
