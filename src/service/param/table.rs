//! The table of parameters: what is declared of each, its value, and which links have not been told of it (P-1).
//!
//! The declarations are one `static`, the values and the marks stand in the vehicle's own memory. The number of parameters
//! appears in the outermost type only, [`ParamMemory`]; the logic works on [`TableMut`], compiled once.

use core::fmt;
use core::marker::PhantomData;
use core::ops::RangeInclusive;

use super::state::State;
use super::value::{self, ParamType};
use crate::dialect::MavParamType;
use crate::link::{LinkId, LinkMask, Peer};

/// The pseudo parameter that stands for all others (P-20).
pub(super) const HASH_NAME: [u8; 16] = *b"_HASH_CHECK\0\0\0\0\0";

/// The most parameters that a table may have: an index in PARAM_REQUEST_READ is an `i16`, and what cannot be asked for
/// again could be lost for good (P-12).
pub const MAX_PARAMS: usize = 32_768;

/// What is declared of one parameter: a row of a table that [`parameters!`](crate::parameters) makes.
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
        /// What [`parameters!`](crate::parameters) makes a row with, by its type.
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

    /// It cannot be set from outside: PARAM_ERROR READ_ONLY (P-14). The vehicle itself can.
    #[doc(hidden)]
    #[must_use]
    pub const fn read_only(mut self) -> Self {
        self.flags |= READ_ONLY;
        self
    }

    /// A change has its effect after the next start only.
    #[doc(hidden)]
    #[must_use]
    pub const fn reboot_required(mut self) -> Self {
        self.flags |= REBOOT_REQUIRED;
        self
    }

    /// It is not stored, and is no part of the hash (P-20).
    #[doc(hidden)]
    #[must_use]
    pub const fn volatile(mut self) -> Self {
        self.flags |= VOLATILE;
        self
    }

    /// A table that clients can work with (P-1, P-20). Asserts, so that what is wrong does not compile.
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

    /// Where a parameter of the table stands.
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

    /// The name.
    pub fn name(&self) -> &str {
        core::str::from_utf8(self.name_bytes()).unwrap_or_default()
    }

    /// The type as messages name it.
    pub const fn param_type(&self) -> MavParamType {
        self.r#type
    }

    /// The value that it is born with: the bits of a float, or an integer in the low bytes with zeros above it.
    pub const fn default_bits(&self) -> u32 {
        self.default
    }

    /// The least and the greatest value that it takes, in the form of [`default_bits`](Self::default_bits).
    pub const fn range_bits(&self) -> [u32; 2] {
        [self.min, self.max]
    }

    /// Whether only the vehicle itself can set it.
    pub const fn is_read_only(&self) -> bool {
        self.flags & READ_ONLY != 0
    }

    /// Whether a change has its effect after the next start only.
    pub const fn is_reboot_required(&self) -> bool {
        self.flags & REBOOT_REQUIRED != 0
    }

    /// Whether it is not stored, and no part of the hash.
    pub const fn is_volatile(&self) -> bool {
        self.flags & VOLATILE != 0
    }

    /// The name without the zeros behind it.
    pub(super) fn name_bytes(&self) -> &[u8] {
        self.name.split(|byte| *byte == 0).next().unwrap_or_default()
    }

    /// All 16 bytes of the name as they stand on the wire.
    pub(super) const fn wire_name(&self) -> &[u8; 16] {
        &self.name
    }

    /// Whether these bits are a value that it can have.
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

/// One parameter of the table `P`, which is a `T`: what [`parameters!`](crate::parameters) makes a constant of, so that the
/// flight loop reads and sets it without a search.
pub struct Param<P, T> {
    index: u16,
    table: PhantomData<fn() -> (P, T)>,
}

impl<P, T> Param<P, T> {
    #[doc(hidden)]
    pub const fn __at(index: u16) -> Self {
        Self { index, table: PhantomData }
    }

    /// Where it stands in its table: `param_index` on the wire.
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

/// A parameter that is to be set, or was. For [`Parameters::may_set`](super::Parameters::may_set) and
/// [`Parameters::parameter_changed`](super::Parameters::parameter_changed).
pub struct ParamChange<P> {
    pub(super) index: u16,
    pub(super) bits: u32,
    pub(super) from: Option<Peer>,
    pub(super) table: PhantomData<fn() -> P>,
}

impl<P> ParamChange<P> {
    /// Where the parameter stands in its table.
    pub const fn index(&self) -> u16 {
        self.index
    }

    /// Whether it is this parameter.
    pub const fn is<T>(&self, param: Param<P, T>) -> bool {
        self.index == param.index
    }

    /// The new value, if it is this parameter's.
    pub fn value<T: ParamType>(&self, param: Param<P, T>) -> Option<T> {
        self.is(param).then(|| T::from_bits(self.bits))
    }

    /// Who sets it; `None` for what comes back from storage.
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

/// Memory for `N` values, six bytes each, and for the service: a part of what [`parameters!`](crate::parameters) makes.
#[doc(hidden)]
#[derive(Clone, Debug)]
pub struct ParamMemory<const N: usize> {
    values: [u32; N],
    /// The links that have not been told of a value.
    untold: [LinkMask; N],
    state: State,
}

impl<const N: usize> ParamMemory<N> {
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        reason = "const fn: there are no iterators; the index is below both lengths"
    )]
    #[inline(never)]
    pub const fn new(table: &'static [ParamInfo]) -> Self {
        // Filled where it will be, not copied there.
        let mut memory = Self { values: [0; N], untold: [LinkMask::NONE; N], state: State::new() };
        let mut i = 0;
        while i < N && i < table.len() {
            memory.values[i] = table[i].default;
            i += 1;
        }
        memory
    }

    #[inline]
    pub fn get<P, T: ParamType>(&self, param: Param<P, T>) -> T {
        T::from_bits(self.values.get(usize::from(param.index)).copied().unwrap_or(0))
    }

    pub fn table_mut(&mut self, info: &'static [ParamInfo]) -> TableMut<'_> {
        TableMut { info, values: &mut self.values, untold: &mut self.untold, state: &mut self.state }
    }
}

/// Every link that there can be.
const ALL_LINKS: LinkMask = {
    let mut all = LinkMask::NONE;
    let mut link = 0;
    while link < 16 {
        all = all.with(LinkMask::of(LinkId(link)));
        link = link.wrapping_add(1);
    }
    all
};

/// A table whatever its length.
#[doc(hidden)]
#[derive(Debug)]
pub struct TableMut<'a> {
    info: &'static [ParamInfo],
    values: &'a mut [u32],
    untold: &'a mut [LinkMask],
    pub(super) state: &'a mut State,
}

impl TableMut<'_> {
    /// Sets a parameter for the vehicle (P-16). False when the value is none that it can have.
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
            self.tell(index, ALL_LINKS);
        }
        true
    }

    /// How many parameters there are.
    pub(crate) fn count(&self) -> u16 {
        u16::try_from(self.info.len()).unwrap_or(u16::MAX)
    }

    /// A parameter and its value.
    pub(crate) fn get(&self, index: u16) -> Option<(&'static ParamInfo, u32)> {
        let index = usize::from(index);
        Some((self.info.get(index)?, *self.values.get(index)?))
    }

    /// The parameter of this name: at most 16 comparisons.
    pub(super) fn find(&self, name: &[u8; 16]) -> Option<u16> {
        let index = self.info.binary_search_by(|info| info.name.iter().cmp(name)).ok()?;
        u16::try_from(index).ok()
    }

    /// Gives a parameter a value that it can have.
    pub(super) fn put(&mut self, index: u16, bits: u32) {
        let place = usize::from(index);
        let Some((value, info)) = self.values.get_mut(place).zip(self.info.get(place)) else { return };
        *value = bits;
        if !info.is_volatile() {
            self.state.generation = self.state.generation.wrapping_add(1);
        }
    }

    /// The links of the mask are to be told of a value.
    pub(super) fn tell(&mut self, index: u16, links: LinkMask) {
        if let Some(untold) = self.untold.get_mut(usize::from(index)) {
            *untold = untold.with(links);
        }
        self.state.untold = self.state.untold.with(links);
    }

    /// The link of the mask has been told of a value, or is about to be.
    pub(super) fn told(&mut self, index: u16, link: LinkMask) {
        if let Some(untold) = self.untold.get_mut(usize::from(index)) {
            *untold = untold.without(link);
        }
    }

    /// The next value that a link has not been told of, from `start` on and then from the beginning. Looks at each once.
    pub(super) fn next_untold(&self, link: LinkMask, start: u16) -> Option<u16> {
        let (front, back) = self.untold.split_at_checked(usize::from(start))?;
        let is_untold = |mask: &LinkMask| mask.contains(link);
        let index = match back.iter().position(is_untold) {
            Some(index) => index.checked_add(front.len())?,
            None => front.iter().position(is_untold)?,
        };
        u16::try_from(index).ok()
    }

    /// Another number when what is stored has changed.
    pub(super) const fn generation(&self) -> u32 {
        self.state.generation
    }
}

/// A table of parameters with their values: what [`parameters!`](crate::parameters) makes, or [`NoParams`].
pub trait ParamTable: Sized {
    /// What is declared of each, in the order of their indices.
    const INFO: &'static [ParamInfo];
    /// The unit of each; empty for one that has none. For tools on a host; a firmware that does not look at it has none
    /// of it in its flash.
    const UNITS: &'static [&'static str];
    /// What each is, its doc comment in one line; the same holds for it.
    const DESCRIPTIONS: &'static [&'static str];

    #[doc(hidden)]
    fn table_mut(&mut self) -> TableMut<'_>;
}

/// The table of a vehicle without parameters; there is none of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NoParams {}

impl ParamTable for NoParams {
    const INFO: &'static [ParamInfo] = &[];
    const UNITS: &'static [&'static str] = &[];
    const DESCRIPTIONS: &'static [&'static str] = &[];

    fn table_mut(&mut self) -> TableMut<'_> {
        match *self {}
    }
}
