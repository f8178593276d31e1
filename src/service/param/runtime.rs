//! A table of parameters whose declarations are only known at run time (P-1).

use super::details::ParamDetails;
use super::info::{MAX_PARAMS, ParamFault, ParamInfo};
use super::service::ParamService;
use super::table::{Param, ParamMemory, ParamTable, ParamValues, TableMut};
use super::value::ParamType;
use crate::types::Values;

/// A table of parameters that is filled at start, with room for `N`: for plug-in modules, and for tables in other crates or in C.
///
/// Each parameter for which there is room takes 38 bytes of RAM; one that [`parameters!`](crate::parameters) declares takes
/// six. Everything else is the same: lists, reads by name and by index, PARAM_SET with the vehicle's decision, PARAM_ERROR,
/// `_HASH_CHECK`, and storage.
///
/// ```
/// use mavstack::param::{ParamFault, ParamInfo, RuntimeTable};
/// # use mavstack::dialect::{MavParamError, MavResult};
/// # use mavstack::prelude::*;
/// # use mavstack::param;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
/// # }
/// type Tuning = RuntimeTable<16>;
///
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 1, parameters: Tuning)]
/// struct Mavlink;
///
/// struct Rover { cruise: Option<Param<Tuning, f32>> }
///
/// impl Parameters for Rover {
///     type Table = Tuning;
///
///     fn may_set(&mut self, _: &mut Context<'_>, change: &ParamChange<Tuning>) -> Result<(), MavParamError> {
///         let is_cruise = self.cruise.is_some_and(|cruise| change.is(cruise));
///         if is_cruise { Err(MavParamError::PERMISSION_DENIED) } else { Ok(()) }
///     }
/// }
///
/// /// Each module adds its own.
/// fn add_speeds(tuning: &mut Tuning) -> Result<(), ParamFault> {
///     tuning.add(ParamInfo::new("CRUISE", 5.0, 0.5..=15.0)?)?;
///     tuning.add(ParamInfo::new("BRAKE", 3i32, 0..=9)?.reboot_required())
/// }
///
/// # static PULSE: Pulse = Pulse::new();
/// # let config = Config::new(Address::new(1, 1), &PULSE);
/// let mut stack = StackOf::<Mavlink>::new(config, [LinkConfig::uart(57_600)]);
/// add_speeds(stack.parameters_mut())?;
/// // Then `stack.restore(…)`, if there is storage.
/// let cruise = stack.parameters_mut().param::<f32>("CRUISE");
/// let mut rover = Rover { cruise };
/// stack.poll(Instant::ZERO, &mut rover);
/// assert_eq!(cruise.map(|cruise| stack.parameters().get(cruise)), Some(5.0));
/// assert_eq!(add_speeds(stack.parameters_mut()), Err(ParamFault::Sealed));
/// # Ok::<(), ParamFault>(())
/// ```
///
/// # When it is sealed
///
/// The number of parameters and their indices must not change while clients know them (P-1). So the table is sealed by the first
/// [`poll`](crate::Stack::poll), by the first request, by `restore`, and by [`param`](Self::param): add all parameters
/// between [`begin`](crate::Stack::begin) and these calls.
#[derive(Clone, Debug)]
pub struct RuntimeTable<const N: usize> {
    /// Sorted by name. The rest is vacant.
    info: [ParamInfo; N],
    memory: ParamValues<N>,
    count: u16,
    is_sealed: bool,
}

impl<const N: usize> RuntimeTable<N> {
    /// Returns an empty table. A [`#[stack]`](macro@crate::Stack) has its own: see [`Stack::parameters_mut`](struct@crate::Stack).
    pub const fn new() -> Self {
        const {
            assert!(
                N > 0 && N <= MAX_PARAMS,
                "a run-time table has room for 1 to 32,768 parameters: `RuntimeTable<64>`"
            )
        };
        Self { info: [ParamInfo::VACANT; N], memory: ParamValues::VACANT, count: 0, is_sealed: false }
    }

    /// Adds a parameter, with its default value. Parameters are sorted by name, so the indices of others change.
    ///
    /// # Errors
    ///
    /// Returns an error, without a change, if the parameter cannot be added:
    ///
    /// - [`ParamFault::Sealed`]: the table is in use, see [above](Self#when-it-is-sealed).
    /// - [`ParamFault::NoRoom`]: there are `N` parameters already.
    /// - [`ParamFault::Taken`]: there is one with this name.
    pub fn add(&mut self, info: ParamInfo) -> Result<(), ParamFault> {
        if self.is_sealed {
            return Err(ParamFault::Sealed);
        }
        self.count = insert(&mut self.info, self.memory.values_mut(), self.count, info)?;
        Ok(())
    }

    /// Returns the declarations, ordered by index.
    pub fn info(&self) -> &[ParamInfo] {
        self.info.get(..usize::from(self.count)).unwrap_or_default()
    }

    /// Returns the parameter with this name and type, by binary search; `None` if there is none. Seals the table.
    pub fn param<T: ParamType>(&mut self, name: &str) -> Option<Param<Self, T>> {
        self.is_sealed = true;
        let info = self.info();
        let index = info.binary_search_by(|info| info.name_bytes().cmp(name.as_bytes())).ok()?;
        let is_typed = info.get(index).is_some_and(|info| info.param_type() == T::TYPE);
        Some(Param::__at(u16::try_from(index).ok().filter(|_| is_typed)?))
    }

    /// Returns a parameter's value, without a search.
    #[inline]
    pub fn get<T: ParamType>(&self, param: Param<Self, T>) -> T {
        self.memory.get(param)
    }

    /// Sets a parameter, even a read-only one, and sends the new value to the ground stations. Returns false, without a change,
    /// if the value is out of range or not a finite number. Seals the table.
    pub fn set<T: ParamType>(&mut self, param: Param<Self, T>, value: T) -> bool {
        self.table_mut().set(param, value)
    }

    /// Returns the value of the parameter with this index, in the form of [`ParamType::bits`]; `None` if there is none.
    pub fn bits(&self, index: u16) -> Option<u32> {
        self.memory.values().get(..usize::from(self.count))?.get(usize::from(index)).copied()
    }

    /// Sets the parameter with this index, as [`set`](Self::set). Returns false, without a change, if there is none, or if the
    /// value is invalid.
    pub fn set_bits(&mut self, index: u16, bits: u32) -> bool {
        self.table_mut().set_bits(index, bits)
    }
}

/// Inserts a row into the first `count` rows, which are sorted by name. Returns the new number of rows.
fn insert(rows: &mut [ParamInfo], values: &mut [u32], count: u16, info: ParamInfo) -> Result<u16, ParamFault> {
    let (used, spare) = rows.split_at_checked(usize::from(count)).ok_or(ParamFault::NoRoom)?;
    let Err(at) = used.binary_search_by(|row| row.wire_name().cmp(info.wire_name())) else {
        return Err(ParamFault::Taken);
    };
    if spare.is_empty() {
        return Err(ParamFault::NoRoom);
    }
    // Everything from there on moves by one place. The last row, which has none, is vacant.
    let mut carried = (info, info.default_bits());
    for (row, value) in rows.iter_mut().zip(values).skip(at) {
        carried = (core::mem::replace(row, carried.0), core::mem::replace(value, carried.1));
    }
    Ok(count.saturating_add(1))
}

impl<const N: usize> Default for RuntimeTable<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> ParamTable for RuntimeTable<N> {
    const INFO: &'static [ParamInfo] = &[ParamInfo::VACANT; N];
    const DETAILS: &'static [ParamDetails] = &[];

    /// Seals the table: the service is about to use it.
    fn table_mut(&mut self) -> TableMut<'_> {
        self.is_sealed = true;
        let info = self.info.get(..usize::from(self.count)).unwrap_or_default();
        self.memory.table_mut(info)
    }
}

impl<const N: usize> Values for RuntimeTable<N> {
    fn values(&self) -> &[u32] {
        self.memory.values()
    }
}

impl<const N: usize> ParamMemory for RuntimeTable<N> {
    type Service = ParamService;

    const VACANT: Self = Self::new();

    /// Nothing: each parameter gets its default when it is added.
    fn begin(&mut self) {}
}
