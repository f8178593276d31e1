//! The compiler's checks of the rows of [`parameters!`](crate::parameters) (P-1, P-3, P-20).
//!
//! The compiler shows the panic of a constant at the macro as a whole. So each check is a bound instead, on the type of the
//! default: the compiler points at the default of the row, and the message has the name of the parameter.

use core::marker::PhantomData;
use core::ops::RangeInclusive;

use super::info::{HASH_NAME, MAX_PARAMS, ParamFault, ParamInfo};
use crate::dialect::MavParamType;

macro_rules! rows_of {
    ($($ty:ident: $wire:ident = |$value:ident| $bits:expr;)+) => {
        /// The constructors of rows for [`parameters!`](crate::parameters), named after the types.
        #[doc(hidden)]
        impl ParamInfo { $(
            pub const fn $ty(name: &str, default: $ty, range: &RangeInclusive<$ty>) -> Row {
                #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; nothing is cut off")]
                const fn bits($value: $ty) -> u32 {
                    $bits
                }
                let range = [bits(*range.start()), bits(*range.end())];
                Row(Self::checked(name.as_bytes(), MavParamType::$wire, bits(default), range))
            }
        )+ }
    };
}

rows_of! {
    u8: UINT8 = |value| value as u32;
    i8: INT8 = |value| value.cast_unsigned() as u32;
    u16: UINT16 = |value| value as u32;
    i16: INT16 = |value| value.cast_unsigned() as u32;
    u32: UINT32 = |value| value;
    i32: INT32 = |value| value.cast_unsigned();
    f32: REAL32 = |value| value.to_bits();
}

/// A row, valid or not.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct Row(Result<ParamInfo, ParamFault>);

impl Row {
    /// Returns the declaration; a vacant one for an invalid row, which [`Checked::row`] reports.
    pub const fn info(self) -> ParamInfo {
        match self.0 {
            Ok(info) => info,
            Err(_) => ParamInfo::VACANT,
        }
    }

    /// Whether the name is valid.
    pub const fn is_named(&self, name: &str) -> bool {
        let [reserved @ .., _, _, _, _, _] = &HASH_NAME;
        !matches!(self.0, Err(ParamFault::Name)) && !is_same(name.as_bytes(), reserved)
    }

    /// Whether the default and the range are valid.
    pub const fn is_within_range(&self) -> bool {
        !matches!(self.0, Err(ParamFault::Default))
    }
}

/// The name is valid. `P` has the name of the parameter, for the compiler's message.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "the name of the parameter `{P}` is not valid",
    label = "a parameter's name has 1 to 16 bytes, all of them ASCII, and is not `_HASH_CHECK`"
)]
pub trait Named<P, const IS_NAMED: bool> {}

impl<T, P> Named<P, true> for T {}

/// The default and the range are valid.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "the default of the parameter `{P}` is not within its range",
    label = "a parameter's default lies within its range, and floats are finite"
)]
pub trait WithinRange<P, const IS_WITHIN_RANGE: bool> {}

impl<T, P> WithinRange<P, true> for T {}

/// The row is in its place.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "the parameter `{P}` is not in order",
    label = "the parameters of a table must be in ASCII order, each name once: sort their lines"
)]
pub trait InOrder<P, const IS_IN_ORDER: bool> {}

impl<T, P> InOrder<P, true> for T {}

/// The names of its values are valid.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "the `values` of the parameter `{P}` are not valid",
    label = "a parameter's named values lie within its range, each once"
)]
pub trait ValuesNamed<P, const ARE_VALID: bool> {}

impl<T, P> ValuesNamed<P, true> for T {}

/// The names of its bits are valid.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "the `bitmask` of the parameter `{P}` is not valid",
    label = "a parameter with named bits is an integer without named values; each bit, such as 4 for bit 2, lies within its range, \
             and stands once"
)]
pub trait BitsNamed<P, const ARE_VALID: bool> {}

impl<T, P> BitsNamed<P, true> for T {}

/// The number of decimals and the step are valid.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "the `decimals` or the `increment` of the parameter `{P}` are not valid",
    label = "only an `f32` has decimals, and an increment is greater than 0"
)]
pub trait Stepped<P, const IS_VALID: bool> {}

impl<T, P> Stepped<P, true> for T {}

/// It may be the system id, if it is meant to be that.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "the parameter `{P}` cannot be the system id",
    label = "a system id is an integer with a range within 1..=254 (255 is a ground station's), not volatile, and the only one"
)]
pub trait SystemId<P, const IS_VALID: bool> {}

impl<T, P> SystemId<P, true> for T {}

/// The results of the checks of the attributes of the row of the parameter that `P` names, whose default is a `T`.
#[doc(hidden)]
#[derive(Debug)]
pub struct Detailed<P, T, const VALUES: bool, const BITS: bool, const STEPS: bool, const SYSTEM_ID: bool>(
    PhantomData<(P, T)>,
);

impl<P, T, const VALUES: bool, const BITS: bool, const STEPS: bool, const SYSTEM_ID: bool>
    Detailed<P, T, VALUES, BITS, STEPS, SYSTEM_ID>
{
    /// Fails to compile for invalid attributes. The compiler points at the argument, the default of the parameter.
    pub const fn row(_: T)
    where
        T: Copy + ValuesNamed<P, VALUES> + BitsNamed<P, BITS> + Stepped<P, STEPS> + SystemId<P, SYSTEM_ID>,
    {
    }
}

/// The results of the checks of the row of the parameter that `P` names, whose default is a `T`.
#[doc(hidden)]
#[derive(Debug)]
pub struct Checked<P, T, const NAME: bool, const RANGE: bool, const ORDER: bool>(PhantomData<(P, T)>);

impl<P, T, const NAME: bool, const RANGE: bool, const ORDER: bool> Checked<P, T, NAME, RANGE, ORDER> {
    /// Fails to compile for an invalid row. The compiler points at the argument, the default of the parameter.
    pub const fn row(_: T)
    where
        T: Copy + Named<P, NAME> + WithinRange<P, RANGE> + InOrder<P, ORDER>,
    {
    }
}

/// Returns the index of the first parameter with this name. Panics, at compile time, if the table is too long.
#[doc(hidden)]
#[allow(clippy::as_conversions, clippy::arithmetic_side_effects, reason = "const-evaluated, and at most MAX_PARAMS")]
pub const fn position(names: &[&str], name: &str) -> u16 {
    assert!(names.len() <= MAX_PARAMS, "a table has at most 32,768 parameters");
    let (mut index, mut rest) = (0, names);
    while let [first, others @ ..] = rest
        && !is_same(first.as_bytes(), name.as_bytes())
    {
        (index, rest) = (index + 1, others);
    }
    index
}

/// Whether this name is behind the one before it.
#[doc(hidden)]
pub const fn is_in_order(names: &[&str], name: &str) -> bool {
    let (mut is_in_order, mut rest) = (true, names);
    while let [first, others @ ..] = rest {
        if let [second, ..] = others
            && is_same(second.as_bytes(), name.as_bytes())
        {
            is_in_order &= is_less(first.as_bytes(), second.as_bytes());
        }
        rest = others;
    }
    is_in_order
}

const fn is_less(mut a: &[u8], mut b: &[u8]) -> bool {
    while let ([first, others @ ..], [own, rest @ ..]) = (a, b) {
        if *first != *own {
            return *first < *own;
        }
        (a, b) = (others, rest);
    }
    a.len() < b.len()
}

const fn is_same(a: &[u8], b: &[u8]) -> bool {
    !is_less(a, b) && !is_less(b, a)
}
