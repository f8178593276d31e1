//! The parameter protocol: the vehicle's settings, listed, read and set.
//!
//! Implements <https://mavlink.io/en/services/parameter.html>, rules P-1 to P-32. It handles PARAM_REQUEST_LIST,
//! PARAM_REQUEST_READ, PARAM_SET and MAV_CMD_PREFLIGHT_STORAGE, and sends PARAM_VALUE, PARAM_ERROR and `_HASH_CHECK`. With `files`,
//! all parameters are also a file. PARAM_EXT is not supported.
//!
//! The stack owns the table with the values. It has a mark for every parameter and link on which the value is pending. So lists,
//! reads and changes need no memory besides one cursor per link. The rest of the service's state is part of the table too: a
//! firmware without parameters does not have it.
//!
//! The declarations are checked by the compiler ([`parameters!`](crate::parameters)), or added at run time ([`RuntimeTable`]).
//! If both declarations and values live elsewhere ([`ParamBackend`]), the stack only has the marks ([`ExternalParams`]).

mod backend;
mod directory;
mod external;
mod hash;
mod info;
#[macro_use]
mod macros;
mod packed;
mod replies;
mod requests;
mod row;
mod runtime;
mod saving;
mod state;
mod table;
mod value;
mod vehicle;

#[cfg(test)]
mod tests;

pub use backend::{ParamBackend, ParamUpdate, ParamWrite};
pub use external::ExternalParams;
#[cfg(feature = "storage")]
pub use external::ExternalService;
pub use info::{MAX_PARAMS, ParamFault, ParamInfo};
pub(crate) use replies::List;
pub use row::{Checked, Row, is_in_order, position};
pub use runtime::RuntimeTable;
pub use table::{NoParams, Param, ParamChange, ParamMemory, ParamTable, ParamValues, TableMut};
pub use value::{ParamEncoding, ParamType};
pub use vehicle::{ParamHash, Parameters};

use core::borrow::Borrow;
use core::marker::PhantomData;

use super::{About, Cx, Handled, Received, Request, Service, StackEvent, Turn, Verdict, View};
use crate::dialect::{
    MavCmd, MavModeFlag, MavParamError, MavParamType, MavProtocolCapability, MavResult, MavSeverity, ParamRequestList,
    ParamRequestRead, ParamSet, ParamValue,
};
use crate::frame::Version;
use crate::link::{Outbox, Port};
use crate::message::{Message, Text};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkId, LinkMask, Peer, Refusal, Vehicle, Why};
use info::HASH_NAME;
use saving::Saving;
use state::State;
use table::{Rows, Table};

/// `param_index` of a value that is not in the table.
const NO_INDEX: u16 = u16::MAX;

/// Minimum time between texts about refusals (P-32).
const TEXT_PAUSE: Duration = Duration::from_secs(1);

/// Returns the capability bits for parameters in this encoding.
const fn capability(encoding: ParamEncoding) -> MavProtocolCapability {
    match encoding {
        ParamEncoding::Bytewise => MavProtocolCapability::PARAM_ENCODE_BYTEWISE,
        ParamEncoding::CCast => MavProtocolCapability::PARAM_ENCODE_C_CAST,
    }
}

/// The vehicle's configuration of the service.
#[derive(Clone, Copy)]
struct Options {
    encoding: ParamEncoding,
    hash: ParamHash,
    has_errors: bool,
}

impl Options {
    const fn of<V: Parameters>() -> Self {
        Self::new(V::PARAM_ENCODING, V::PARAM_HASH, V::PARAM_ERROR)
    }

    const fn new(encoding: ParamEncoding, hash: ParamHash, has_errors: bool) -> Self {
        let hash = match encoding {
            ParamEncoding::Bytewise => hash,
            ParamEncoding::CCast => ParamHash::Never,
        };
        Self { encoding, hash, has_errors }
    }

    /// Returns the options on a link: MAVLink 1 has no PARAM_ERROR (P-31).
    fn on(self, port: &Port) -> Self {
        Self { has_errors: self.has_errors && port.outbox.version() != Version::V1, ..self }
    }

    /// Whether this is the name of the hash, and the hash is enabled.
    fn is_hash(self, name: &[u8; 16]) -> bool {
        self.hash != ParamHash::Never && *name == HASH_NAME
    }
}

/// What the service sends.
#[derive(Clone, Copy, Debug)]
pub enum ParamReply {
    /// A refusal, the hash, or a value that was requested or has changed.
    Answer,
    /// The next value of the list.
    Listed,
}

/// What must be known of the links without access to the table.
#[derive(Debug)]
struct Links {
    /// The links on which an answer is pending, and can be sent now.
    pending: LinkMask,
    /// The links on which the hash is pending.
    hash: LinkMask,
    /// The hash takes more polls.
    is_hashing: bool,
    /// The links that were reopened since the last access to the table.
    restarted: LinkMask,
}

impl Links {
    const NEW: Self =
        Self { pending: LinkMask::NONE, hash: LinkMask::NONE, is_hashing: false, restarted: LinkMask::NONE };

    /// Updates the table for reopened links.
    fn catch_up<K>(&mut self, state: &mut state::State<K>) {
        if !self.restarted.is_empty() {
            state.forget(core::mem::take(&mut self.restarted));
        }
    }

    /// Updates what is known from the table.
    fn cache<R: Rows>(&mut self, table: &Table<'_, R>) {
        let State { pending, hash_pending, hash, refusals, .. } = &*table.state;
        (self.pending, self.hash, self.is_hashing) = (pending.with(refusals.links()), *hash_pending, false);
        if !hash_pending.is_empty() {
            self.is_hashing = !hash.is_ready(&table.rows);
            if !self.is_hashing {
                self.pending = self.pending.with(*hash_pending);
            }
        }
    }

    /// Returns when the next step of the hash is due.
    fn hash_deadline(&self) -> Instant {
        if self.is_hashing { Instant::ZERO } else { Instant::NEVER }
    }

    /// Whether an answer is pending on a link.
    const fn is_pending(&self, link: LinkId) -> bool {
        self.pending.contains(LinkMask::of(link))
    }

    /// Whether the list of a link waits for the hash, which is sent first.
    const fn is_list_held(&self, link: LinkId) -> bool {
        self.hash.contains(LinkMask::of(link))
    }

    fn restart(&mut self, link: LinkId) {
        let link = LinkMask::of(link);
        self.restarted = self.restarted.with(link);
        self.pending = self.pending.without(link);
        self.hash = self.hash.without(link);
    }
}

/// Lists, reads and sets parameters. Its state for all links is in the table, next to the values. This type caches what must be
/// known without access to the table.
#[derive(Debug)]
pub struct ParamService {
    links: Links,
    /// When the next write to storage is due.
    write_due: Instant,
}

/// Whether the service handles the message with this id.
const fn handles(id: u32) -> bool {
    matches!(id, ParamRequestRead::ID | ParamRequestList::ID | ParamSet::ID)
}

impl ParamService {
    /// Sets a parameter for a client, if the vehicle permits it.
    fn set<F>(&mut self, cx: &mut Cx<'_, F>, index: u16, bits: u32, from: Peer) -> Result<(), MavParamError>
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Parameters<Table = F::Parameters>>,
    {
        let change = ParamChange { index, bits, from: Some(from), table: PhantomData };
        let (vehicle, mut context) = cx.hook();
        vehicle.may_set(&mut context, &change)?;
        let mut table = self.table(cx.parameters);
        table.put(index, bits);
        table.notice(cx.now);
        let (vehicle, mut context) = cx.hook();
        vehicle.parameter_changed(&mut context, &change);
        Ok(())
    }

    /// Returns the table, updated for reopened links.
    fn table<'t, T: ParamTable>(&mut self, table: &'t mut T) -> TableMut<'t> {
        let table = table.table_mut();
        self.links.catch_up(table.state);
        table
    }

    /// Updates the cached state from the table.
    fn cache(&mut self, table: &TableMut<'_>) {
        self.links.cache(table);
        self.write_due = table.state.kept.saving.deadline();
    }

    /// Returns when a write to storage is due.
    #[cfg(any(test, feature = "storage"))]
    pub(crate) const fn write_due(&self) -> Instant {
        self.write_due
    }

    /// Makes a write of all changes due now.
    pub(crate) fn write_now<T: ParamTable>(&mut self, now: Instant, table: &mut T) {
        self.saving(table, |saving, generation| saving.write_now(now, generation));
    }

    /// Sets a parameter to a valid value, and makes it pending on `links`. Returns false if it has that value already.
    fn change<T: ParamTable>(&mut self, table: &mut T, index: u16, bits: u32, links: LinkMask) -> bool {
        let mut table = self.table(table);
        if table.get(index).is_none_or(|(_, old)| old == bits) {
            return false;
        }
        table.put(index, bits);
        table.mark_pending(index, links);
        self.cache(&table);
        true
    }
}

impl<F> Service<F> for ParamService
where
    F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
{
    const NEW: Self = Self { links: Links::NEW, write_due: Instant::ZERO };
    type Link = List;
    const VACANT: List = List::new();
    type Reply = ParamReply;
    const ABOUT: About = if F::Parameters::INFO.is_empty() {
        About::AUTOPILOT
    } else {
        About { capabilities: capability(F::Vehicle::PARAM_ENCODING), ..About::AUTOPILOT }
    }
    .in_turns(&[Turn::ParamAnswer, Turn::LateParamList, Turn::ParamList]);

    /// Notices what the vehicle has set since the last call (P-16).
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut List>) {
        let mut table = self.table(cx.parameters);
        table.notice(cx.now);
        table.compute_hash();
        self.cache(&table);
        if cx.shared.is_storage_busy || !cx.vehicle.may_persist() {
            // Nothing may be written, so no poll is needed for it.
            self.write_due = Instant::NEVER;
        }
    }

    fn deadline(&self) -> Instant {
        self.links.hash_deadline()
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, list: &mut List, received: &Received<'_>) -> Handled {
        if !handles(received.frame.id()) {
            return Handled::No;
        }
        let options = Options::of::<F::Vehicle>().on(port);
        let mut table = self.table(cx.parameters);
        let request = table.on_request(cx.now, cx.texts, options, list, received);
        self.cache(&table);
        let (index, bits) = match request {
            Ok(handled) => return handled,
            Err(set) => set,
        };
        // Everything but the vehicle's decision is checked, and there is a slot for a refusal.
        let verdict = bits.map(|bits| self.set(cx, index, bits, received.from));
        let mut table = self.table(cx.parameters);
        if let Some(verdict) = verdict {
            table.on_decided(cx.now, cx.texts, options, received.from, index, verdict);
        }
        table.mark_pending(index, cx.shared.normal);
        self.cache(&table);
        Handled::Yes
    }

    /// MAV_CMD_PREFLIGHT_STORAGE (P-17).
    fn on_command(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut List, request: &Request) -> Option<Verdict> {
        let command = &request.command;
        if command.id != MavCmd::PREFLIGHT_STORAGE {
            return None;
        }
        let refused = |refusal: Refusal| Some(Verdict::Refused(refusal));
        let mut table = self.table(cx.parameters);
        let (count, is_stored) = (table.count(), table.state.kept.saving.schedule.is_attached());
        let parameters = match storage_action(&command.params, is_stored) {
            Ok(parameters) => parameters,
            Err(why) => return refused(Refusal { result: MavResult::DENIED, why }),
        };
        if is_armed(cx.vehicle) {
            return refused(MavResult::TEMPORARILY_REJECTED.into());
        }
        table.notice(cx.now);
        let will_change = matches!(parameters, 2 | 4);
        if (will_change || parameters == 1) && table.state.kept.saving.is_rate_limited(cx.now, will_change) {
            return refused(MavResult::TEMPORARILY_REJECTED.into());
        }
        if parameters == 0 {
            table.state.kept.saving.is_reload_requested = true;
            self.cache(&table);
        }
        if will_change {
            let resets_all = parameters == 4;
            for index in 0..count {
                let Some((info, _)) = self.table(cx.parameters).get(index) else { continue };
                let (bits, is_reset) = (info.default_bits(), resets_all || !info.is_read_only());
                if is_reset && self.change(cx.parameters, index, bits, cx.shared.normal) {
                    let change = ParamChange { index, bits, from: Some(command.from), table: PhantomData };
                    let (vehicle, mut context) = cx.hook();
                    vehicle.parameter_changed(&mut context, &change);
                }
            }
        }
        if matches!(parameters, 1 | 2 | 4) {
            self.write_now(cx.now, cx.parameters);
        }
        Some(Verdict::done(MavResult::ACCEPTED))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, list: &List, turn: Turn) -> Option<(Instant, ParamReply)> {
        match turn {
            Turn::ParamAnswer => self.links.is_pending(port.id).then_some((view.now, ParamReply::Answer)),
            _ if self.links.is_list_held(port.id) => None,
            Turn::LateParamList => Some((list.late_at(), ParamReply::Listed)),
            _ => Some((list.due(), ParamReply::Listed)),
        }
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, list: &mut List, reply: ParamReply) -> bool {
        let options = Options::of::<F::Vehicle>();
        match reply {
            ParamReply::Answer => {
                let mut table = self.table(cx.parameters);
                let is_sent = table.send_answer(options, list, &mut port.outbox);
                self.cache(&table);
                is_sent
            }
            ParamReply::Listed => self.table(cx.parameters).send_listed(options, cx.now, list, port),
        }
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Begun(_) => self.write_due = Instant::NEVER,
            StackEvent::Opened(port, list) => {
                list.end();
                self.links.restart(port.id);
            }
            _ => {}
        }
    }
}

#[cfg(test)]
impl ParamService {
    /// Whether a poll has something to compute.
    pub(crate) const fn is_working(&self) -> bool {
        self.links.is_hashing
    }
}

/// The interface to storage.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
impl ParamService {
    /// Loads a parameter from storage (P-17): the stored value, or this firmware's default if the stored value was the default.
    /// Nothing changes if the value is invalid, or if `keeps_value` is set and the parameter no longer has its default.
    pub(crate) fn load<F>(&mut self, cx: &mut Cx<'_, F>, index: u16, stored: &Stored, keeps_value: bool)
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Parameters<Table = F::Parameters>>,
    {
        let Some((info, old)) = cx.parameters.table_mut().get(index) else { return };
        let bits = if stored.is_default { info.default_bits() } else { stored.bits };
        if keeps_value && old != info.default_bits() {
            return;
        }
        if !info.is_volatile() && info.has_room(bits) && self.change(cx.parameters, index, bits, cx.shared.normal) {
            cx.parameters.table_mut().state.kept.saving.on_value_loaded();
            let (vehicle, mut context) = cx.hook();
            vehicle.parameter_changed(&mut context, &ParamChange { index, bits, from: None, table: PhantomData });
        }
    }

    /// Calls `work` with the state of storage and the generation of the table.
    pub(crate) fn saving<T: ParamTable, R>(&mut self, table: &mut T, work: impl FnOnce(&mut Saving, u32) -> R) -> R {
        let table = table.table_mut();
        let generation = table.generation();
        let saving = &mut table.state.kept.saving;
        let result = work(saving, generation);
        self.write_due = saving.deadline();
        result
    }

    /// Records that storage is attached; nothing was read yet. `refill` is the time in which it regains one token for a write
    /// that peers cause (C-15).
    pub(crate) fn attach<T: ParamTable>(&mut self, table: &mut T, refill: Duration) {
        self.saving(table, |saving, generation| {
            saving.schedule.bucket.set_refill(refill);
            saving.attach(generation);
        });
    }

    /// Requests that the values are written again.
    pub(crate) fn save_again<T: ParamTable>(&mut self, table: &mut T) {
        self.saving(table, |saving, generation| saving.set_unsaved(generation));
    }

    /// Whether the operator has requested the stored values: the caller [loads](Self::load) them and calls
    /// [`loaded`](Saving::loaded).
    pub(crate) fn is_reload_requested<T: ParamTable>(&self, table: &mut T) -> bool {
        table.table_mut().state.kept.saving.is_reload_requested
    }

    /// Returns the number of the write that is in progress or begins now; `None` if there is nothing to write.
    pub(crate) fn pending_write<T: ParamTable>(&mut self, now: Instant, table: &mut T) -> Option<u16> {
        self.saving(table, |saving, generation| saving.pending_write(now, generation))
    }

    /// Records that the write is complete.
    pub(crate) fn on_saved<T: ParamTable>(&mut self, now: Instant, table: &mut T) {
        self.saving(table, |saving, _| saving.on_saved(now));
    }

    /// Records that the write failed; it is retried (P-14, last row).
    pub(crate) fn on_save_failed<F: Firmware<Parameters: ParamTable>>(&mut self, cx: &mut Cx<'_, F>) {
        let now = cx.now;
        if self.saving(cx.parameters, |saving, _| saving.schedule.on_failed(now)) {
            cx.text(MavSeverity::ERROR, b"Parameters not saved");
        }
    }
}

/// No action on the stored parameters.
const NOTHING: i32 = -1;

/// Returns the action on parameters of a PREFLIGHT_STORAGE: [`NOTHING`], 0 to read, 1 to write, 2 or 4 to reset.
///
/// # Errors
///
/// The command is invalid, or needs storage and there is none.
fn storage_action([parameters, missions, ..]: &[f32; 4], is_stored: bool) -> Result<i32, Why> {
    let action = |param: f32| if param.is_nan() { Some(NOTHING) } else { crate::num::integer(param) };
    let (parameters, missions) = (action(*parameters), action(*missions));
    // Parameter 2 was an action on missions in definitions before September 2026. Missions are loaded and stored automatically, so
    // to reset them is refused; MISSION_CLEAR_ALL does that.
    match (parameters, missions) {
        (Some(0 | 1), Some(NOTHING..=1)) if !is_stored => Err(Why::NoStorage),
        (Some(parameters @ (NOTHING..=2 | 4)), Some(NOTHING..=1)) => Ok(parameters),
        _ => Err(Why::Result),
    }
}

fn is_armed(vehicle: &impl Vehicle) -> bool {
    vehicle.state().is_some_and(|state| state.base_mode.contains(MavModeFlag::SAFETY_ARMED))
}

/// A stored value.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stored {
    pub(crate) bits: u32,
    /// Whether it was the default when it was stored.
    pub(crate) is_default: bool,
}

#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
impl TableMut<'_> {
    /// Returns a parameter as it is stored; `None` after the last one. A volatile parameter is stored as its default.
    pub(crate) fn stored(&self, index: u16) -> Option<(&ParamInfo, Stored)> {
        let (info, bits) = self.get(index)?;
        let is_default = info.is_volatile() || bits == info.default_bits();
        let bits = if is_default { info.default_bits() } else { bits };
        Some((info, Stored { bits, is_default }))
    }
}

impl TableMut<'_> {
    /// Checks whether there is something to write.
    fn notice(&mut self, now: Instant) {
        let generation = self.generation();
        self.state.kept.saving.notice(now, generation);
    }
}

impl<R: Rows> Table<'_, R> {
    /// Takes the next step of the hash, if it is pending and takes more than one.
    fn compute_hash(&mut self) {
        if !self.state.hash_pending.is_empty() && !self.state.hash.is_ready(&self.rows) {
            self.state.hash.step(&self.rows);
        }
    }

    /// Sends a refusal, the hash or a pending value. Returns false if none is ready.
    fn send_answer(&mut self, options: Options, list: &mut List, tx: &mut Outbox) -> bool {
        // The refusal is sent before the value: MAVSDK gives up after a PARAM_ERROR, but retries after the old value.
        if options.has_errors && self.state.refusals.next(tx) {
            return true;
        }
        let link = LinkMask::of(tx.link());
        if options.hash != ParamHash::Never
            && self.state.hash_pending.contains(link)
            && self.state.hash.is_ready(&self.rows)
        {
            let sum = self.state.hash.sum(&self.rows);
            self.state.hash_pending = self.state.hash_pending.without(link);
            return self.send_as(NO_INDEX, &HASH_NAME, MavParamType::UINT32, f32::from_bits(sum), tx);
        }
        if !self.state.pending.contains(link) {
            return false;
        }
        let Some(index) = self.next_pending(link, list.from) else {
            self.state.pending = self.state.pending.without(link);
            return false;
        };
        list.from = index.saturating_add(1);
        let sent = self.send_value(options, index, tx);
        if self.next_pending(link, list.from).is_none() {
            self.state.pending = self.state.pending.without(link);
        }
        sent
    }

    /// Sends the next value of the list (P-11).
    fn send_listed(&mut self, options: Options, now: Instant, list: &mut List, port: &mut Port) -> bool {
        let index = list.next();
        list.advance(now, self.count(), port.config.bytes_per_second);
        self.send_value(options, index, &mut port.outbox)
    }

    fn send_value(&mut self, options: Options, index: u16, tx: &mut Outbox) -> bool {
        self.clear_pending(index, LinkMask::of(tx.link()));
        let Some((info, bits)) = self.get(index) else { return false };
        let info: &ParamInfo = info.borrow();
        let value = value::to_wire(options.encoding, info.param_type(), bits);
        self.send_as(index, info.wire_name(), info.param_type(), value, tx)
    }

    fn send_as(
        &self,
        param_index: u16,
        name: &[u8; 16],
        param_type: MavParamType,
        param_value: f32,
        tx: &mut Outbox,
    ) -> bool {
        let (param_count, param_id) = (self.count(), Text::from_wire(*name));
        tx.send(&ParamValue { param_value, param_count, param_index, param_id, param_type })
    }
}
