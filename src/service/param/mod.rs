//! The parameter protocol: the vehicle's settings, listed, read and set.
//!
//! Implements <https://mavlink.io/en/services/parameter.html>, rules P-1 to P-32: PARAM_REQUEST_LIST, PARAM_REQUEST_READ and
//! PARAM_SET in, PARAM_VALUE and PARAM_ERROR out, `_HASH_CHECK`, and MAV_CMD_PREFLIGHT_STORAGE. The values are the vehicle's; the
//! table has a mark for every parameter and link that has not been told of its value, so a list, any number of reads and
//! every change cost no memory beside one cursor a link. What else the service keeps stands in the table too: a vehicle
//! without parameters has none of it. No parameter by FTP, and no PARAM_EXT.

mod hash;
#[macro_use]
mod macros;
mod replies;
mod requests;
mod saving;
mod state;
mod table;
mod value;
mod vehicle;

#[cfg(test)]
mod tests;

pub(crate) use replies::List;
pub use table::{MAX_PARAMS, NoParams, Param, ParamChange, ParamInfo, ParamMemory, ParamTable, TableMut};
pub use value::{ParamEncoding, ParamType};
pub use vehicle::{ParamHash, Parameters};

use core::marker::PhantomData;

use crate::dialect::{
    MavCmd, MavModeFlag, MavParamType, MavProtocolCapability, MavResult, MavSeverity, ParamRequestList,
    ParamRequestRead, ParamSet, ParamValue,
};
use crate::frame::{Frame, Version};
use crate::link::{LinkId, LinkMask, Outbox, Peer};
use crate::message::{Message, Text};
use crate::service::statustext::StatusTexts;
use crate::time::{Duration, Instant};
use crate::vehicle::{Command, Vehicle};
use saving::Saving;
use table::HASH_NAME;

/// `param_index` of what is in no table.
const NO_INDEX: u16 = u16::MAX;

/// One refusal in this time is told as a text too (P-32).
const TEXT_PAUSE: Duration = Duration::from_secs(1);

/// What the service works with beside the table.
pub(crate) struct Context<'a> {
    pub(crate) now: Instant,
    pub(crate) texts: &'a mut StatusTexts,
    /// The links that everything may be sent on.
    pub(crate) normal: LinkMask,
}

/// Who asks, on a link that sends `version`.
pub(crate) struct Caller<'a> {
    pub(crate) from: Peer,
    pub(crate) version: Version,
    pub(crate) list: &'a mut List,
}

/// What became of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Taken {
    /// It was taken, and is answered.
    Yes,
    /// Its answer has no room: it was not taken.
    NoRoom,
    /// It is not for everyone.
    OutOfPlace,
}

/// What AUTOPILOT_VERSION says of a vehicle's parameters.
pub(crate) const fn capability<V: Parameters>() -> MavProtocolCapability {
    match V::PARAM_ENCODING {
        _ if V::Table::INFO.is_empty() => MavProtocolCapability::EMPTY,
        ParamEncoding::Bytewise => MavProtocolCapability::PARAM_ENCODE_BYTEWISE,
        ParamEncoding::CCast => MavProtocolCapability::PARAM_ENCODE_C_CAST,
    }
}

/// How the service does things for this vehicle.
#[derive(Clone, Copy)]
struct Ways {
    encoding: ParamEncoding,
    hash: ParamHash,
    has_errors: bool,
}

impl Ways {
    const fn of<V: Parameters>() -> Self {
        let hash = match V::PARAM_ENCODING {
            ParamEncoding::Bytewise => V::PARAM_HASH,
            ParamEncoding::CCast => ParamHash::Never,
        };
        Self { encoding: V::PARAM_ENCODING, hash, has_errors: V::PARAM_ERROR }
    }

    /// Whether this is the hash's name, and there is one.
    fn is_hash(self, name: &[u8; 16]) -> bool {
        self.hash != ParamHash::Never && *name == HASH_NAME
    }
}

/// What of the parameter service must be known where the vehicle is not at hand. The rest stands in the vehicle's table.
#[derive(Debug)]
pub(crate) struct Params {
    /// Links that an answer is owed on.
    owed: LinkMask,
    /// Links whose lines were opened anew, of which the table does not know yet.
    restarted: LinkMask,
    /// When there is something to write.
    write_due: Instant,
}

impl Params {
    pub(crate) const fn new() -> Self {
        Self { owed: LinkMask::NONE, restarted: LinkMask::NONE, write_due: Instant::NEVER }
    }

    /// The vehicle's table.
    fn table<'v, V: Parameters>(&mut self, vehicle: &'v mut V) -> Option<TableMut<'v>> {
        let table = vehicle.parameters_mut()?.table_mut();
        self.catch_up(table.state);
        Some(table)
    }

    /// Tells the table what it does not know yet. Not inlined, as it is for every vehicle the same.
    #[inline(never)]
    fn catch_up(&mut self, state: &mut state::State) {
        if !self.restarted.is_empty() {
            state.forget(core::mem::take(&mut self.restarted));
        }
    }

    /// The table was worked with.
    fn note(&mut self, table: &TableMut<'_>) {
        self.owed = table.state.owed();
        self.write_due = table.state.saving.deadline();
    }

    /// The line of a link was opened anew: nobody is there any more who asked.
    pub(crate) fn restart(&mut self, link: LinkId, list: &mut List) {
        list.end();
        self.restarted = self.restarted.with(LinkMask::of(link));
        self.owed = self.owed.without(LinkMask::of(link));
    }

    /// Whether a message is one of ours.
    pub(crate) const fn handles(id: u32) -> bool {
        matches!(id, ParamRequestRead::ID | ParamRequestList::ID | ParamSet::ID)
    }

    /// A frame whose message [`handles`](Self::handles) names, addressed to us or to all.
    #[inline(never)]
    pub(crate) fn on_frame<V: Parameters>(
        &mut self,
        cx: &mut Context<'_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        frame: &Frame<'_>,
    ) -> Taken {
        let ways = Ways::of::<V>();
        let Some(mut table) = self.table(vehicle) else { return Taken::Yes };
        let request = table.on_request(cx, ways, caller, frame);
        self.note(&table);
        let (index, bits) = match request {
            Ok(taken) => return taken,
            Err(change) => change,
        };
        // All but the vehicle's own word is said, and there is room for a refusal.
        let change = ParamChange { index, bits, from: Some(caller.from), table: PhantomData };
        let verdict = vehicle.may_set(&change);
        if let Some(mut table) = self.table(vehicle) {
            table.set_for(cx, ways, caller, (index, bits), verdict);
            self.note(&table);
        }
        if verdict.is_ok() {
            vehicle.parameter_changed(&change);
        }
        Taken::Yes
    }

    /// MAV_CMD_PREFLIGHT_STORAGE (P-17); `None` for any other command, and where there are no parameters.
    #[inline(never)]
    pub(crate) fn on_command<V: Parameters + Vehicle>(
        &mut self,
        cx: &mut Context<'_>,
        vehicle: &mut V,
        command: &Command,
    ) -> Option<MavResult> {
        /// Neither read nor written.
        const NOTHING: i32 = -1;

        if command.id != MavCmd::PREFLIGHT_STORAGE {
            return None;
        }
        let table = self.table(vehicle)?;
        let (count, is_stored) = (table.count(), table.state.saving.is_attached());
        let [parameters, missions, ..] = command.params;
        let action = |param: f32| if param.is_nan() { Some(NOTHING) } else { crate::num::integer(param) };
        let (parameters, missions) = (action(parameters), action(missions));
        let is_known = match parameters {
            Some(NOTHING | 2 | 4) => true,
            Some(0 | 1) => is_stored,
            _ => false,
        };
        // Missions are read and written by themselves; to reset them there is MISSION_CLEAR_ALL.
        if !is_known || !matches!(missions, Some(NOTHING..=1)) {
            return Some(MavResult::DENIED);
        }
        if vehicle.state().is_some_and(|state| state.base_mode.contains(MavModeFlag::SAFETY_ARMED)) {
            return Some(MavResult::TEMPORARILY_REJECTED);
        }
        let mut table = self.table(vehicle)?;
        table.notice(cx.now);
        let will_change = matches!(parameters, Some(2 | 4));
        if (will_change || parameters == Some(1)) && table.state.saving.is_worn(cx.now, will_change) {
            return Some(MavResult::TEMPORARILY_REJECTED);
        }
        match parameters {
            Some(0) => {
                let table = self.table(vehicle)?;
                table.state.saving.reload();
                self.note(&table);
                return Some(MavResult::ACCEPTED);
            }
            Some(1) => {
                self.hurry(cx.now, vehicle);
                return Some(MavResult::ACCEPTED);
            }
            Some(NOTHING) => return Some(MavResult::ACCEPTED),
            _ => {}
        }
        let resets_all = parameters == Some(4);
        for index in 0..count {
            let info = self.table(vehicle)?.get(index)?.0;
            if resets_all || !info.is_read_only() {
                self.change(vehicle, index, info.default_bits(), cx.normal, Some(command.from));
            }
        }
        self.hurry(cx.now, vehicle);
        Some(MavResult::ACCEPTED)
    }

    /// What is not stored yet is to be written now.
    pub(crate) fn hurry<V: Parameters>(&mut self, now: Instant, vehicle: &mut V) {
        if let Some(mut table) = self.table(vehicle) {
            table.notice(now);
            table.state.saving.hurry(now);
            self.note(&table);
        }
    }

    /// Gives a parameter another value that it can have, if it has not, and tells everybody.
    fn change<V: Parameters>(&mut self, vehicle: &mut V, index: u16, bits: u32, links: LinkMask, from: Option<Peer>) {
        let Some(mut table) = self.table(vehicle) else { return };
        if table.get(index).is_none_or(|(_, old)| old == bits) {
            return;
        }
        table.put(index, bits);
        table.tell(index, links);
        self.note(&table);
        vehicle.parameter_changed(&ParamChange { index, bits, from, table: PhantomData });
    }

    /// Looks what the vehicle set since the last time (P-16).
    pub(crate) fn poll<V: Parameters>(&mut self, now: Instant, vehicle: &mut V) {
        let Some(mut table) = self.table(vehicle) else { return };
        table.notice(now);
        self.note(&table);
    }

    /// Whether an answer is owed on a link.
    pub(crate) const fn is_pending(&self, link: LinkId) -> bool {
        self.owed.contains(LinkMask::of(link))
    }

    /// Sends an answer: a refusal, the hash, or a value that somebody asked for or that has changed. False when none is
    /// ready.
    pub(crate) fn next<V: Parameters>(&mut self, vehicle: &mut V, list: &mut List, tx: &mut Outbox) -> bool {
        if !self.is_pending(tx.link()) {
            return false;
        }
        let Some(mut table) = self.table(vehicle) else { return false };
        // Before the value: MAVSDK sets again when it sees the old one, and gives up when it sees this.
        let sent = (V::PARAM_ERROR && table.state.refusals.next(tx)) || table.next_answer(Ways::of::<V>(), list, tx);
        self.note(&table);
        sent
    }

    /// Sends the next value of the list, when its turn has come on a link of so many bytes/s (P-11). False when it has not.
    pub(crate) fn next_listed<V: Parameters>(
        &mut self,
        now: Instant,
        vehicle: &mut V,
        list: &mut List,
        bytes_per_second: u32,
        tx: &mut Outbox,
    ) -> bool {
        let Some(index) = list.listed(now) else { return false };
        let Some(mut table) = self.table(vehicle) else { return false };
        // The hash goes before it.
        if table.state.hash_owed.contains(LinkMask::of(tx.link())) {
            return false;
        }
        list.go_on(now, table.count(), bytes_per_second);
        table.send_value(Ways::of::<V>(), index, tx)
    }

    /// Nothing may be written for now: nobody is to be woken for it.
    #[cfg(feature = "storage")]
    pub(crate) const fn rest(&mut self) {
        self.write_due = Instant::NEVER;
    }

    /// When there is something to write: see [`unsaved`](Self::unsaved).
    pub(crate) const fn deadline(&self) -> Instant {
        self.write_due
    }
}

/// What storage is asked for, and what comes back from it.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
impl Params {
    /// A parameter comes back from storage (P-17): the stored value, or the default of this firmware when the stored one was
    /// the default too. It stays as it is when there is none of that name and type, when it cannot have the value, or when it
    /// has a value already that it is to keep.
    pub(crate) fn load<V: Parameters>(&mut self, vehicle: &mut V, stored: &Stored, links: LinkMask, keeps_value: bool) {
        let Some(table) = self.table(vehicle) else { return };
        let Some((index, (info, old))) = table.find(&stored.name).and_then(|index| Some((index, table.get(index)?)))
        else {
            return;
        };
        let bits = if stored.is_default { info.default_bits() } else { stored.bits };
        if keeps_value && old != info.default_bits() {
            return;
        }
        if info.param_type() == stored.r#type && !info.is_volatile() && info.has_room(bits) {
            self.change(vehicle, index, bits, links, None);
        }
    }

    /// Works with what is known of the storage.
    fn saving<V: Parameters, R>(&mut self, vehicle: &mut V, work: impl FnOnce(&mut Saving, u32) -> R) -> Option<R> {
        let table = self.table(vehicle)?;
        let generation = table.generation();
        let result = work(&mut table.state.saving, generation);
        self.note(&table);
        Some(result)
    }

    /// Sets the time in which storage regains one token for a write that peers cause (C-15).
    pub(crate) fn limit<V: Parameters>(&mut self, vehicle: &mut V, refill: Duration) {
        self.saving(vehicle, |saving, _| saving.limit(refill));
    }

    /// What storage had came back, or could not be read; from now on it is kept up.
    pub(crate) fn loaded<V: Parameters>(&mut self, vehicle: &mut V, is_read: bool) {
        self.saving(vehicle, |saving, generation| saving.loaded(generation, is_read));
    }

    /// Records whether parameters that could not be read at the start have now been read. If not, parameters set since then are
    /// written later.
    pub(crate) fn reread<V: Parameters>(&mut self, now: Instant, vehicle: &mut V, is_read: bool) {
        self.saving(vehicle, |saving, generation| saving.reread(now, generation, is_read));
    }

    /// Whether the operator wants the stored values back: [`load`](Self::load) them and say [`loaded`](Self::loaded).
    pub(crate) fn wants_reload<V: Parameters>(&mut self, vehicle: &mut V) -> bool {
        self.saving(vehicle, |saving, _| saving.wants_reload()) == Some(true)
    }

    /// The number of the write that is under way, or begins now; `None` when there is nothing to write.
    pub(crate) fn unsaved<V: Parameters>(&mut self, now: Instant, vehicle: &mut V) -> Option<u32> {
        self.saving(vehicle, |saving, generation| saving.job(now, generation)).flatten()
    }

    /// Storage holds it.
    pub(crate) fn saved<V: Parameters>(&mut self, now: Instant, vehicle: &mut V) {
        self.saving(vehicle, |saving, _| saving.saved(now));
    }

    /// Storage failed; it is tried again (P-14, last row).
    #[inline(never)]
    pub(crate) fn not_saved<V: Parameters>(&mut self, cx: &mut Context<'_>, vehicle: &mut V) {
        if self.saving(vehicle, |saving, _| saving.not_saved(cx.now)) == Some(true) {
            cx.texts.push(cx.now, cx.normal, MavSeverity::ERROR, &Text::new("Parameters not saved"));
        }
    }
}

/// A parameter as storage has it.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stored {
    pub(crate) name: [u8; 16],
    pub(crate) r#type: MavParamType,
    pub(crate) bits: u32,
    /// Whether it was the default when it was stored.
    pub(crate) is_default: bool,
}

#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
impl TableMut<'_> {
    /// A parameter as it is to be stored; `None` behind the last one. A volatile one is its default.
    pub(crate) fn stored(&self, index: u16) -> Option<Stored> {
        let (info, bits) = self.get(index)?;
        let is_default = info.is_volatile() || bits == info.default_bits();
        let bits = if is_default { info.default_bits() } else { bits };
        Some(Stored { name: *info.wire_name(), r#type: info.param_type(), bits, is_default })
    }
}

impl TableMut<'_> {
    /// Sees whether there is something to write.
    fn notice(&mut self, now: Instant) {
        let generation = self.generation();
        self.state.saving.notice(now, generation);
    }

    /// Sends the hash, or a value that is owed. False when neither is ready.
    fn next_answer(&mut self, ways: Ways, list: &mut List, tx: &mut Outbox) -> bool {
        let link = LinkMask::of(tx.link());
        if ways.hash != ParamHash::Never && self.state.hash_owed.contains(link) {
            let mut hash = self.state.hash;
            let sum = hash.step(self);
            self.state.hash = hash;
            if let Some(sum) = sum {
                self.state.hash_owed = self.state.hash_owed.without(link);
                return self.send_as(NO_INDEX, &HASH_NAME, MavParamType::UINT32, f32::from_bits(sum), tx);
            }
        }
        if !self.state.untold.contains(link) {
            return false;
        }
        let Some(index) = self.next_untold(link, list.from) else {
            self.state.untold = self.state.untold.without(link);
            return false;
        };
        list.from = index.saturating_add(1);
        self.send_value(ways, index, tx)
    }

    fn send_value(&mut self, ways: Ways, index: u16, tx: &mut Outbox) -> bool {
        let Some((info, bits)) = self.get(index) else { return false };
        self.told(index, LinkMask::of(tx.link()));
        let value = value::to_wire(ways.encoding, info.param_type(), bits);
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
