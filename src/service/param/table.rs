//! The table of parameters: for each parameter its declaration, its value, and the links on which the value is pending (P-1, P-12).
//!
//! The declarations are a constant, or part of a [`RuntimeTable`](super::RuntimeTable); values and marks are part of the stack.
//! Only the outermost type, [`ParamValues`], is generic over the number of parameters. The logic works on [`Table`], which is
//! generic over its [rows](Rows): a firmware has one kind of them, so it is compiled once.

use core::fmt;
use core::marker::PhantomData;

use super::details::ParamDetails;
use super::info::{ParamInfo, Rows};
use super::saving::Saving;
use super::state::ParamState;
use super::value::ParamType;
use crate::message::SystemId;
use crate::service::Absent;
use crate::types::{Context, LinkMask, Peer, Values};

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
    marks: [LinkMask; N],
    state: ParamState,
    saving: Saving,
}

impl<const N: usize> ParamValues<N> {
    /// All zero bits.
    pub const VACANT: Self =
        Self { values: [0; N], marks: [LinkMask::NONE; N], state: ParamState::NEW, saving: Saving::NEW };

    /// Sets every parameter to its default.
    pub fn begin(&mut self, table: &'static [ParamInfo]) {
        for (value, info) in self.values.iter_mut().zip(table) {
            *value = info.default_bits();
        }
    }

    pub const fn values(&self) -> &[u32] {
        &self.values
    }

    #[inline]
    pub fn get<P, T: ParamType>(&self, param: Param<P, T>) -> T {
        T::from_bits(self.values.get(usize::from(param.index)).copied().unwrap_or(0))
    }

    /// Returns the values; only the first ones are in use.
    pub(super) const fn values_mut(&mut self) -> &mut [u32] {
        &mut self.values
    }

    pub fn table_mut<'a>(&'a mut self, info: &'a [ParamInfo]) -> TableMut<'a> {
        let rows = OwnRows { info, values: &mut self.values, saving: &mut self.saving };
        Table { rows, marks: &mut self.marks, state: &mut self.state }
    }
}

/// Parameters whose values the stack owns.
#[doc(hidden)]
#[derive(Debug)]
pub struct OwnRows<'a> {
    info: &'a [ParamInfo],
    values: &'a mut [u32],
    pub(super) saving: &'a mut Saving,
}

impl<'a> Rows for OwnRows<'a> {
    type Info = &'a ParamInfo;

    fn count(&self) -> u16 {
        u16::try_from(self.info.len()).unwrap_or(u16::MAX)
    }

    fn get(&self, index: u16) -> Option<(&'a ParamInfo, u32)> {
        let index = usize::from(index);
        Some((self.info.get(index)?, *self.values.get(index)?))
    }

    /// By binary search.
    fn find(&self, name: &[u8; 16]) -> Option<u16> {
        let index = self.info.binary_search_by(|info| info.wire_name().iter().cmp(name)).ok()?;
        u16::try_from(index).ok()
    }
}

/// The parameters of a firmware, and the state of their service.
#[doc(hidden)]
#[derive(Debug)]
pub struct Table<'a, R: Rows> {
    pub(super) rows: R,
    /// For each parameter, the links on which its value is pending.
    pub(super) marks: &'a mut [LinkMask],
    pub(super) state: &'a mut ParamState,
}

/// A table of any length, with its values.
#[doc(hidden)]
pub type TableMut<'a> = Table<'a, OwnRows<'a>>;

impl<R: Rows> Table<'_, R> {
    /// Returns the number of parameters.
    pub(crate) fn count(&self) -> u16 {
        self.rows.count()
    }

    /// Returns a parameter and its value.
    pub(crate) fn get(&self, index: u16) -> Option<(R::Info, u32)> {
        self.rows.get(index)
    }

    /// Queues a value on these links.
    pub(super) fn queue_value(&mut self, index: u16, links: LinkMask) {
        if let Some(marks) = self.marks.get_mut(usize::from(index)) {
            *marks = marks.with(links);
            self.state.pending = self.state.pending.with(links);
        }
    }
}

impl TableMut<'_> {
    /// Sets a parameter for the vehicle (P-16). Returns false if the value is invalid.
    #[doc(hidden)]
    pub fn set<P, T: ParamType>(&mut self, param: Param<P, T>, value: T) -> bool {
        self.set_bits(param.index, value.to_bits())
    }

    pub(super) fn set_bits(&mut self, index: u16, bits: u32) -> bool {
        let is_valid = self.get(index).is_some_and(|(info, _)| info.is_valid(bits));
        if is_valid {
            self.change(index, bits, LinkMask::ALL);
        }
        is_valid
    }

    /// Sets a parameter to a valid value, and makes it pending on `links`. Returns false if it has that value already.
    pub(super) fn change(&mut self, index: u16, bits: u32, links: LinkMask) -> bool {
        let is_stored = self.get(index).is_some_and(|(info, _)| !info.is_volatile());
        let has_changed = self.load(index, bits, links);
        if has_changed && is_stored {
            self.rows.saving.set_changed();
        }
        has_changed
    }

    /// As [`change`](Self::change), for a value that is in storage already.
    pub(super) fn load(&mut self, index: u16, bits: u32, links: LinkMask) -> bool {
        let value = self.rows.values.get_mut(usize::from(index)).filter(|value| **value != bits);
        let Some(value) = value else { return false };
        *value = bits;
        self.queue_value(index, links);
        true
    }

    /// Returns a parameter as it is stored; `None` after the last one. A volatile parameter is stored as its default.
    #[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
    pub(crate) fn stored(&self, index: u16) -> Option<(&ParamInfo, Stored)> {
        let (info, bits) = self.get(index)?;
        let is_default = info.is_volatile() || bits == info.default_bits();
        let bits = if is_default { info.default_bits() } else { bits };
        Some((info, Stored { bits, is_default }))
    }
}

/// A stored value.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stored {
    pub(crate) bits: u32,
    /// Whether it was the default when it was stored.
    pub(crate) is_default: bool,
}

/// A table of parameters with their values: generated by [`parameters!`](crate::parameters), or a
/// [`RuntimeTable`](super::RuntimeTable).
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no table of parameters",
    note = "declare it with `parameters!`, or write `RuntimeTable<N>`"
)]
pub trait ParamTable: ParamMemory + Sized {
    /// The declarations, ordered by index. A [`RuntimeTable`](super::RuntimeTable) has as many vacant ones as it has
    /// room for; [`RuntimeTable::info`](super::RuntimeTable::info) returns its own.
    const INFO: &'static [ParamInfo];
    /// The units, descriptions and names of values, ordered by index. For tools on a host: a firmware that does not use them does
    /// not have them in flash. A [`RuntimeTable`](super::RuntimeTable) has none.
    const DETAILS: &'static [ParamDetails];

    #[doc(hidden)]
    fn table_mut(&mut self) -> TableMut<'_>;
}

/// The parameters of a firmware: a table, the state that is kept for a backend, or none.
#[doc(hidden)]
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no table of parameters",
    note = "declare it with `parameters!`, or write `RuntimeTable<N>` or `ExternalParams<N>`"
)]
pub trait ParamMemory: Values {
    /// The service for them.
    type Service;

    /// All zero bits, so that it takes no flash.
    const VACANT: Self;

    /// The index of the parameter that is the vehicle's system id.
    const SYSTEM_ID: Option<u16> = None;

    /// Sets every parameter to its default.
    fn begin(&mut self);

    /// Returns the system id, if a parameter is it.
    fn system_id(&self) -> Option<SystemId> {
        let bits = self.values().get(usize::from(Self::SYSTEM_ID?))?;
        u8::try_from(*bits).map(SystemId::new).ok()
    }
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
    type Service = Absent;

    const VACANT: Self = Self;

    fn begin(&mut self) {}
}

impl<'a> Context<'a> {
    /// Returns the value of a parameter of the firmware's table. The result for a parameter of another table is meaningless.
    pub fn parameter<P: ParamTable, T: ParamType>(&self, param: Param<P, T>) -> T {
        T::from_bits(self.values.get(usize::from(param.index)).copied().unwrap_or(0))
    }
}
