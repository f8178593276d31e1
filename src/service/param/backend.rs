//! The hooks of a vehicle whose parameters live elsewhere.

use core::cmp::Ordering;

use super::info::{MAX_PARAMS, ParamFault, ParamInfo};
use super::value::{ParamEncoding, ParamType};
use super::vehicle::ParamHash;
use crate::dialect::{MavParamError, MavResult, MavSeverity};
use crate::types::{Context, Peer};

/// The hooks of a vehicle whose parameters live elsewhere: in a settings store that the firmware has already.
///
/// The backend has the declarations and the values, decides about each change, and stores values at its discretion. The
/// stack has neither: it asks for a parameter when it sends it. It answers lists, reads, PARAM_SET and `_HASH_CHECK`,
/// and it checks name, type and range of a PARAM_SET before the backend decides. The stack's own storage leaves these
/// parameters out.
///
/// Implemented for a vehicle whose [`#[stack]`](macro@crate::Stack) declares [`ExternalParams`](super::ExternalParams). For an object
/// of its own, the vehicle passes the calls on.
///
/// ```
/// use mavstack::dialect::{MavParamError, MavResult};
/// use mavstack::param::{ExternalParams, ParamInfo, ParamType, ParamUpdate, ParamWrite};
/// use mavstack::{Context, ParamBackend, Stack};
/// # use mavstack::{Command, Commands, Outcome, Vehicle, VehicleState};
///
/// /// The firmware's settings: of one type, sorted by name.
/// struct Setting { name: &'static str, value: f32, default: f32, max: f32 }
///
/// struct Rover {
///     settings: [Setting; 2],
///     /// The one that the vehicle itself has set.
///     own: Option<u16>,
/// }
///
/// impl ParamBackend for Rover {
///     const SORTED: bool = true;
///
///     fn param_count(&self) -> u16 { 2 }
///
///     fn param_info(&self, index: u16) -> Option<ParamInfo> {
///         let setting = self.settings.get(usize::from(index))?;
///         ParamInfo::new(setting.name, setting.default, 0.0..=setting.max).ok()
///     }
///
///     fn param_bits(&self, index: u16) -> Option<u32> {
///         Some(self.settings.get(usize::from(index))?.value.bits())
///     }
///
///     fn set_param(&mut self, _: &mut Context<'_>, write: &ParamWrite) -> Result<(), MavParamError> {
///         let setting = self.settings.get_mut(usize::from(write.index())).ok_or(MavParamError::DOES_NOT_EXIST)?;
///         setting.value = write.value();
///         Ok(())
///     }
///
///     fn take_update(&mut self) -> ParamUpdate {
///         self.own.take().map_or(ParamUpdate::Nothing, ParamUpdate::One)
///     }
///
///     fn reset_params(&mut self, _: &mut Context<'_>, _: bool) -> MavResult {
///         self.settings.iter_mut().for_each(|setting| setting.value = setting.default);
///         MavResult::ACCEPTED
///     }
/// }
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
/// # }
///
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 1, parameters: ExternalParams<2>)]
/// struct Mavlink;
///
/// let setting = |name| Setting { name, value: 5.0, default: 5.0, max: 15.0 };
/// let rover = Rover { settings: ["BRAKE", "CRUISE"].map(setting), own: None };
/// assert_eq!(rover.check_params(2), Ok(()));
/// ```
///
/// # Cost
///
/// Each parameter takes two bytes of RAM: its marks on up to 16 links. A received frame causes at most one search for a name
/// (SEC-2): up to 16 calls of [`param_info`](Self::param_info) if the names are [sorted](Self::SORTED), otherwise as many as
/// there are parameters. [`find_param`](Self::find_param) can be replaced by a faster one. A sent value takes one call of
/// `param_info` and of [`param_bits`](Self::param_bits), and a step of the hash up to four of each.
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `ParamBackend`",
    note = "`parameters: ExternalParams<N>` in `#[stack]` needs `impl ParamBackend for {Self}`: write it, or declare a table"
)]
pub trait ParamBackend {
    /// Whether the names are in ASCII order. Otherwise, names are searched one by one, and there is no `_HASH_CHECK`, which a
    /// ground station computes in this order (P-20).
    const SORTED: bool = false;

    /// The encoding of integers on the wire. It applies to all parameters and is announced in AUTOPILOT_VERSION (P-2).
    const PARAM_ENCODING: ParamEncoding = ParamEncoding::Bytewise;

    /// When the checksum of all parameters is sent (P-20). Only with byte-wise encoding, and only if the names are sorted.
    const PARAM_HASH: ParamHash = ParamHash::ByName;

    /// Whether refused requests are answered with PARAM_ERROR: see [`Parameters::PARAM_ERROR`](super::Parameters::PARAM_ERROR).
    const PARAM_ERROR: bool = true;

    /// Returns the number of parameters. The stack goes by that of the first poll: it must not change while clients know it
    /// (P-1). Those beyond the capacity of [`ExternalParams`](super::ExternalParams) are left out.
    fn param_count(&self) -> u16;

    /// Returns a parameter's declaration, which must not change (P-1); `None` if there is no such parameter. Indices begin at 0.
    fn param_info(&self, index: u16) -> Option<ParamInfo>;

    /// Returns a parameter's value, in the form of [`ParamType::bits`]; `None` if there is no such parameter.
    fn param_bits(&self, index: u16) -> Option<u32>;

    /// Sets a parameter for a client, or refuses to. The new value differs from the current one, type and range admit it, and
    /// the parameter is not read-only. Afterwards the stack sends the actual value on all links (P-14).
    ///
    /// The stack does not limit how often it is called: collect changes before you write them to flash.
    ///
    /// # Errors
    ///
    /// The error for PARAM_ERROR (P-14): [`MavParamError::PERMISSION_DENIED`] for a matter of policy. The value must be
    /// unchanged then.
    fn set_param(&mut self, cx: &mut Context<'_>, write: &ParamWrite) -> Result<(), MavParamError>;

    /// Takes a change that was not made by [`set_param`](Self::set_param), so that it is announced (P-16). Each poll
    /// calls it up to four times, until it returns [`ParamUpdate::Nothing`].
    ///
    /// A store that only counts its changes remembers the last count that it compared here, and returns
    /// [`ParamUpdate::All`] when the count differs.
    fn take_update(&mut self) -> ParamUpdate {
        ParamUpdate::Nothing
    }

    /// Returns the index of the parameter with this name. By default a binary search if the names are
    /// [sorted](Self::SORTED), otherwise one by one.
    fn find_param(&self, name: &[u8]) -> Option<u16> {
        find(self, name)
    }

    /// Stores all values: PREFLIGHT_STORAGE 1. The stack calls it only while the vehicle is disarmed, and limits how often: see
    /// [`Config::storage_refill`](crate::Config::storage_refill) (C-15). Returns the result for COMMAND_ACK, which is not
    /// IN_PROGRESS.
    fn save_params(&mut self, cx: &mut Context<'_>) -> MavResult {
        denied(cx, "Parameters are not stored")
    }

    /// Reads the stored values again: PREFLIGHT_STORAGE 0, only while disarmed, and while the stack would let a peer store values. After
    /// ACCEPTED, the stack announces all values. Do not take back values that a client has set: store them first, and return
    /// TEMPORARILY_REJECTED until that is done (C-15).
    fn load_params(&mut self, cx: &mut Context<'_>) -> MavResult {
        denied(cx, "Parameters are not stored")
    }

    /// Resets all values to their defaults and stores them: PREFLIGHT_STORAGE 2, which leaves out read-only parameters, or 4,
    /// with `all`, which does not. Called as [`save_params`](Self::save_params). After ACCEPTED, the stack announces all values.
    fn reset_params(&mut self, cx: &mut Context<'_>, all: bool) -> MavResult {
        let _ = all;
        denied(cx, "Parameters cannot be reset")
    }

    /// Checks the assumptions of the stack, for a test or at start: `room` is the `N` of
    /// [`ExternalParams<N>`](super::ExternalParams). Searches for each name once.
    ///
    /// # Errors
    ///
    /// - [`ParamFault::NoRoom`]: there are more parameters than that, or than [`MAX_PARAMS`](crate::limits::MAX_PARAMS).
    /// - [`ParamFault::Missing`]: an index has no declaration, or no value within its range.
    /// - [`ParamFault::Order`]: the names are not in ASCII order, although they should be [`SORTED`](Self::SORTED).
    /// - [`ParamFault::Taken`]: two have the same name, or [`find_param`](Self::find_param) does not find one.
    fn check_params(&self, room: usize) -> Result<(), ParamFault> {
        check(self, room)
    }
}

/// Finds a name in a backend.
fn find<B: ParamBackend + ?Sized>(backend: &B, name: &[u8]) -> Option<u16> {
    let compare = |index| Some(backend.param_info(index)?.name_bytes().cmp(name));
    let (mut low, mut high) = (0, backend.param_count());
    if !B::SORTED {
        return (low..high).find(|index| compare(*index) == Some(Ordering::Equal));
    }
    while low < high {
        let middle = low.midpoint(high);
        match compare(middle)? {
            Ordering::Less => low = middle.saturating_add(1),
            Ordering::Equal => return Some(middle),
            Ordering::Greater => high = middle,
        }
    }
    None
}

fn check<B: ParamBackend + ?Sized>(backend: &B, room: usize) -> Result<(), ParamFault> {
    let count = backend.param_count();
    if usize::from(count) > room.min(MAX_PARAMS) {
        return Err(ParamFault::NoRoom);
    }
    let name = |index| Some(*backend.param_info(index)?.wire_name());
    let is_misplaced = |index: u16| name(index.saturating_sub(1)).zip(name(index)).is_some_and(|(a, b)| a > b);
    if B::SORTED && (1..count).any(is_misplaced) {
        return Err(ParamFault::Order);
    }
    for index in 0..count {
        let info = backend.param_info(index).ok_or(ParamFault::Missing)?;
        let bits = backend.param_bits(index).ok_or(ParamFault::Missing)?;
        if !info.is_valid(bits) {
            return Err(ParamFault::Missing);
        }
        if backend.find_param(info.name_bytes()) != Some(index) {
            return Err(ParamFault::Taken);
        }
    }
    Ok(())
}

/// Refuses a request that a backend does not support, and gives the reason (C-16).
fn denied(cx: &mut Context<'_>, why: &str) -> MavResult {
    if cfg!(feature = "plan-texts") {
        cx.text(MavSeverity::WARNING, why);
    }
    MavResult::DENIED
}

/// A change that a backend's [`take_update`](ParamBackend::take_update) reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ParamUpdate {
    /// Nothing more has changed.
    Nothing,
    /// The parameter with this index has changed. Its value is sent on every normal link.
    One(u16),
    /// Any number of parameters may have changed. All values are sent on every normal link, at the pace of a list (P-11), after
    /// a list that is being sent.
    All,
}

/// A change that a client requests, for [`ParamBackend::set_param`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParamWrite {
    pub(super) index: u16,
    pub(super) bits: u32,
    pub(super) from: Peer,
}

impl ParamWrite {
    /// Returns the parameter's index.
    pub const fn index(&self) -> u16 {
        self.index
    }

    /// Returns the new value, if `T` is the parameter's type. Otherwise the result is meaningless.
    pub fn value<T: ParamType>(&self) -> T {
        T::of_bits(self.bits)
    }

    /// Returns the new value in the form of [`ParamType::bits`].
    pub const fn bits(&self) -> u32 {
        self.bits
    }

    /// Returns the client that sets it.
    pub const fn from(&self) -> Peer {
        self.from
    }
}
