//! The table of parameters: for each parameter its declaration, its value, and the links on which the value is pending (P-1).
//!
//! The declarations are a constant; values and marks are part of the stack. Only the outermost type, [`ParamValues`], is generic
//! over the number of parameters. The logic works on [`TableMut`] and is compiled once.

use core::fmt;
use core::marker::PhantomData;
use core::ops::RangeInclusive;

use super::state::State;
use super::value::{self, ParamType};
use crate::dialect::MavParamType;
use crate::types::{Context, LinkId, LinkMask, Peer, Values};

/// The name of the hash, a pseudo parameter (P-20).
pub(super) const HASH_NAME: [u8; 16] = *b"_HASH_CHECK\0\0\0\0\0";

/// Maximum number of parameters in a table. The index in PARAM_REQUEST_READ is an `i16`; a parameter that cannot be requested again
/// could be lost for good (P-12).
pub const MAX_PARAMS: usize = 32_768;

/// The declaration of one parameter: a row of a table that [`parameters!`](crate::parameters) generates.
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

macro_rules! rows_of {
    ($($ty:ident: $wire:ident = |$value:ident| $bits:expr;)+) => {
        /// The constructors of rows for [`parameters!`](crate::parameters), named after the types.
        #[doc(hidden)]
        impl ParamInfo { $(
            pub const fn $ty(name: &str, default: $ty, range: &RangeInclusive<$ty>) -> Self {
                #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; nothing is cut off")]
                const fn bits($value: $ty) -> u32 {
                    $bits
                }
                Self::row(name, MavParamType::$wire, bits(default), bits(*range.start()), bits(*range.end()))
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

impl ParamInfo {
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        reason = "const-evaluated: what fails is a compile error"
    )]
    const fn row(text: &str, r#type: MavParamType, default: u32, min: u32, max: u32) -> Self {
        let text = text.as_bytes();
        assert!(!text.is_empty() && text.len() <= 16, "a parameter's name has 1 to 16 bytes: shorten it");
        let mut name = [0; 16];
        let mut i = 0;
        while i < text.len() {
            assert!(text[i].is_ascii_graphic(), "a parameter's name is ASCII");
            name[i] = text[i];
            i += 1;
        }
        let info = Self { name, default, min, max, r#type, flags: 0 };
        assert!(info.has_room(default), "a parameter's default lies within its range");
        info
    }

    /// Makes it read-only: clients get PARAM_ERROR READ_ONLY (P-14); the vehicle itself can set it.
    #[doc(hidden)]
    #[must_use]
    pub const fn read_only(mut self) -> Self {
        self.flags |= READ_ONLY;
        self
    }

    /// Declares that a change takes effect only after the next start.
    #[doc(hidden)]
    #[must_use]
    pub const fn reboot_required(mut self) -> Self {
        self.flags |= REBOOT_REQUIRED;
        self
    }

    /// Excludes it from storage and from the hash (P-20).
    #[doc(hidden)]
    #[must_use]
    pub const fn volatile(mut self) -> Self {
        self.flags |= VOLATILE;
        self
    }

    /// Checks that clients can handle the table (P-1, P-20). Panics otherwise, so that a wrong table does not compile.
    #[doc(hidden)]
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        reason = "const-evaluated: what fails is a compile error"
    )]
    pub const fn check(table: &[Self]) {
        assert!(table.len() <= MAX_PARAMS, "a table has at most 32,768 parameters");
        let mut i = 0;
        while i < table.len() {
            assert!(!same(&table[i].name, &HASH_NAME), "_HASH_CHECK is no parameter's name");
            if i > 0 {
                assert!(
                    is_less(&table[i - 1].name, &table[i].name),
                    "the parameters of a table are in the order of ASCII, each name once: sort their lines"
                );
            }
            i += 1;
        }
    }

    /// Returns the index of a parameter in the table.
    #[doc(hidden)]
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        clippy::as_conversions,
        reason = "const-evaluated: what fails is a compile error"
    )]
    pub const fn position(table: &[Self], name: &Self) -> u16 {
        let mut i = 0;
        while !same(&table[i].name, &name.name) {
            i += 1;
        }
        i as u16
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
    pub(super) const fn wire_name(&self) -> &[u8; 16] {
        &self.name
    }

    /// Whether these bits are a valid value.
    pub(crate) const fn has_room(&self, bits: u32) -> bool {
        let rank = value::rank(self.r#type, bits);
        match (rank, value::rank(self.r#type, self.min), value::rank(self.r#type, self.max)) {
            (Some(rank), Some(min), Some(max)) => min <= rank && rank <= max,
            _ => false,
        }
    }
}

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

#[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated; the index is below 16")]
const fn is_less(a: &[u8; 16], b: &[u8; 16]) -> bool {
    let mut i = 0;
    while i < 15 && a[i] == b[i] {
        i += 1;
    }
    a[i] < b[i]
}

const fn same(a: &[u8; 16], b: &[u8; 16]) -> bool {
    !is_less(a, b) && !is_less(b, a)
}

/// A parameter of the table `P` with values of type `T`. [`parameters!`](crate::parameters) generates a constant of this type for
/// each parameter, so that the flight loop reads and sets it without a search.
pub struct Param<P, T> {
    index: u16,
    table: PhantomData<fn() -> (P, T)>,
}

impl<P, T> Param<P, T> {
    #[doc(hidden)]
    pub const fn __at(index: u16) -> Self {
        Self { index, table: PhantomData }
    }

    /// Returns its index in the table: `param_index` on the wire.
    pub const fn index(self) -> u16 {
        self.index
    }
}

impl<P, T> Clone for Param<P, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<P, T> Copy for Param<P, T> {}

impl<P, T> fmt::Debug for Param<P, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Param").field(&self.index).finish()
    }
}

/// A requested or completed change of a parameter, for [`Parameters::may_set`](super::Parameters::may_set) and
/// [`Parameters::parameter_changed`](super::Parameters::parameter_changed).
pub struct ParamChange<P> {
    pub(super) index: u16,
    pub(super) bits: u32,
    pub(super) from: Option<Peer>,
    pub(super) table: PhantomData<fn() -> P>,
}

impl<P> ParamChange<P> {
    /// Returns the parameter's index in the table.
    pub const fn index(&self) -> u16 {
        self.index
    }

    /// Whether this parameter is changed.
    pub const fn is<T>(&self, param: Param<P, T>) -> bool {
        self.index == param.index
    }

    /// Returns the new value, if this parameter is changed.
    pub fn value<T: ParamType>(&self, param: Param<P, T>) -> Option<T> {
        self.is(param).then(|| T::from_bits(self.bits))
    }

    /// Returns the client that sets it; `None` for a value loaded from storage.
    pub const fn from(&self) -> Option<Peer> {
        self.from
    }
}

impl<P> fmt::Debug for ParamChange<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { index, bits, from, .. } = self;
        f.debug_struct("ParamChange").field("index", index).field("bits", bits).field("from", from).finish()
    }
}

/// The memory of a table that [`parameters!`](crate::parameters) generates: `N` values, six bytes each, and the service's state.
#[doc(hidden)]
#[derive(Clone, Debug)]
pub struct ParamValues<const N: usize> {
    values: [u32; N],
    /// The links on which each value is pending.
    pending: [LinkMask; N],
    state: State,
}

impl<const N: usize> ParamValues<N> {
    /// All zero bits.
    pub const VACANT: Self = Self { values: [0; N], pending: [LinkMask::NONE; N], state: State::new() };

    /// Sets every parameter to its default.
    pub fn begin(&mut self, table: &'static [ParamInfo]) {
        for (value, info) in self.values.iter_mut().zip(table) {
            *value = info.default;
        }
    }

    pub const fn values(&self) -> &[u32] {
        &self.values
    }

    #[inline]
    pub fn get<P, T: ParamType>(&self, param: Param<P, T>) -> T {
        T::from_bits(self.values.get(usize::from(param.index)).copied().unwrap_or(0))
    }

    pub fn table_mut(&mut self, info: &'static [ParamInfo]) -> TableMut<'_> {
        TableMut { info, values: &mut self.values, pending: &mut self.pending, state: &mut self.state }
    }
}

/// All links that a stack can have.
const ALL_LINKS: LinkMask = {
    let mut all = LinkMask::NONE;
    let mut link = 0;
    while link < 16 {
        all = all.with(LinkMask::of(LinkId(link)));
        link = link.wrapping_add(1);
    }
    all
};

/// A table of any length.
#[doc(hidden)]
#[derive(Debug)]
pub struct TableMut<'a> {
    info: &'static [ParamInfo],
    values: &'a mut [u32],
    pending: &'a mut [LinkMask],
    pub(super) state: &'a mut State,
}

impl TableMut<'_> {
    /// Sets a parameter for the vehicle (P-16). Returns false if the value is invalid.
    #[doc(hidden)]
    pub fn set<P, T: ParamType>(&mut self, param: Param<P, T>, value: T) -> bool {
        self.set_bits(param.index, value.to_bits())
    }

    fn set_bits(&mut self, index: u16, bits: u32) -> bool {
        let Some((info, old)) = self.get(index) else { return false };
        if !info.has_room(bits) {
            return false;
        }
        if old != bits {
            self.put(index, bits);
            self.mark_pending(index, ALL_LINKS);
        }
        true
    }

    /// Returns the number of parameters.
    pub(crate) fn count(&self) -> u16 {
        u16::try_from(self.info.len()).unwrap_or(u16::MAX)
    }

    /// Returns a parameter and its value.
    pub(crate) fn get(&self, index: u16) -> Option<(&'static ParamInfo, u32)> {
        let index = usize::from(index);
        Some((self.info.get(index)?, *self.values.get(index)?))
    }

    /// Returns the index of the parameter with this name, by binary search.
    pub(super) fn find(&self, name: &[u8; 16]) -> Option<u16> {
        let index = self.info.binary_search_by(|info| info.name.iter().cmp(name)).ok()?;
        u16::try_from(index).ok()
    }

    /// Sets a parameter to a valid value.
    pub(super) fn put(&mut self, index: u16, bits: u32) {
        let place = usize::from(index);
        let Some((value, info)) = self.values.get_mut(place).zip(self.info.get(place)) else { return };
        *value = bits;
        if !info.is_volatile() {
            self.state.generation = self.state.generation.wrapping_add(1);
        }
    }

    /// Marks a value as pending on these links.
    pub(super) fn mark_pending(&mut self, index: u16, links: LinkMask) {
        if let Some(pending) = self.pending.get_mut(usize::from(index)) {
            *pending = pending.with(links);
        }
        self.state.pending = self.state.pending.with(links);
    }

    /// Clears the mark: the value has been sent on this link, or is about to be.
    pub(super) fn clear_pending(&mut self, index: u16, link: LinkMask) {
        if let Some(pending) = self.pending.get_mut(usize::from(index)) {
            *pending = pending.without(link);
        }
    }

    /// Returns the next value that is pending on a link: from `start` on, then from the beginning.
    pub(super) fn next_pending(&self, link: LinkMask, start: u16) -> Option<u16> {
        let (front, back) = self.pending.split_at_checked(usize::from(start))?;
        let is_pending = |mask: &LinkMask| mask.contains(link);
        let index = match back.iter().position(is_pending) {
            Some(index) => index.checked_add(front.len())?,
            None => front.iter().position(is_pending)?,
        };
        u16::try_from(index).ok()
    }

    /// Returns a number that changes whenever a non-volatile parameter does.
    pub(super) const fn generation(&self) -> u32 {
        self.state.generation
    }
}

/// A table of parameters with their values: generated by [`parameters!`](crate::parameters).
#[diagnostic::on_unimplemented(message = "`{Self}` is no table of parameters", note = "declare it with `parameters!`")]
pub trait ParamTable: ParamMemory + Sized {
    /// The declarations, in the order of the indices.
    const INFO: &'static [ParamInfo];
    /// The units; empty for a parameter without a unit. For tools on a host: a firmware that does not use them does not have them
    /// in flash.
    const UNITS: &'static [&'static str];
    /// The descriptions: each parameter's doc comment in one line. For tools on a host, too.
    const DESCRIPTIONS: &'static [&'static str];

    #[doc(hidden)]
    fn table_mut(&mut self) -> TableMut<'_>;
}

/// The parameters of a firmware: a table, or none.
#[doc(hidden)]
#[diagnostic::on_unimplemented(message = "`{Self}` is no table of parameters", note = "declare it with `parameters!`")]
pub trait ParamMemory: Values {
    /// All zero bits, so that it takes no flash.
    const VACANT: Self;

    /// Sets every parameter to its default.
    fn begin(&mut self);
}

/// The table of a firmware without parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoParams;

impl Values for NoParams {
    fn values(&self) -> &[u32] {
        &[]
    }
}

impl ParamMemory for NoParams {
    const VACANT: Self = Self;

    fn begin(&mut self) {}
}

impl<'a> Context<'a> {
    /// Returns the value of a parameter of the firmware's table. The result for a parameter of another table is meaningless.
    pub fn parameter<P: ParamTable, T: ParamType>(&self, param: Param<P, T>) -> T {
        T::from_bits(self.values.get(usize::from(param.index)).copied().unwrap_or(0))
    }
}
