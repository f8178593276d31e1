//! The parameter protocol: the vehicle's settings, listed, read and set.
//!
//! Implements <https://mavlink.io/en/services/parameter.html>, rules P-1 to P-32: PARAM_REQUEST_LIST, PARAM_REQUEST_READ and
//! PARAM_SET in, PARAM_VALUE and PARAM_ERROR out, `_HASH_CHECK`, and MAV_CMD_PREFLIGHT_STORAGE. The values are the vehicle's; the
//! table has a mark for every parameter and link that has not been told of its value, so a list, any number of reads and
//! every change cost no memory beside one cursor a link. No parameter by FTP, and no PARAM_EXT.

mod hash;
#[macro_use]
mod macros;
mod replies;
mod saving;
mod table;
mod value;
mod vehicle;

#[cfg(test)]
mod tests;

pub(crate) use replies::Replies;
pub use table::{MAX_PARAMS, NoParams, Param, ParamChange, ParamInfo, ParamMemory, ParamTable, TableMut};
pub use value::{ParamEncoding, ParamType};
pub use vehicle::{ParamHash, Parameters};

use core::marker::PhantomData;

use crate::dialect::{
    MavCmd, MavModeFlag, MavParamError, MavParamType, MavProtocolCapability, MavResult, MavSeverity, ParamRequestList,
    ParamRequestRead, ParamSet, ParamValue,
};
use crate::frame::{Frame, Version};
use crate::link::{LinkMask, Outbox, Peer};
use crate::message::{Message, Text};
use crate::service::statustext::{MAX_TEXT_LEN, StatusTexts};
use crate::time::{Duration, Instant};
use crate::vehicle::{Command, Vehicle};
use hash::Hash;
use replies::Refusal;
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
    pub(crate) replies: &'a mut Replies,
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
}

impl Ways {
    const fn of<V: Parameters>() -> Self {
        let hash = match V::PARAM_ENCODING {
            ParamEncoding::Bytewise => V::PARAM_HASH,
            ParamEncoding::CCast => ParamHash::Never,
        };
        Self { encoding: V::PARAM_ENCODING, hash }
    }

    /// Whether this is the hash's name, and there is one.
    fn is_hash(self, name: &[u8; 16]) -> bool {
        self.hash != ParamHash::Never && *name == HASH_NAME
    }
}

/// The parameter service of a vehicle, for all links.
#[derive(Debug)]
pub(crate) struct Params {
    /// Links that may not have been told of every value.
    untold: LinkMask,
    hash: Hash,
    saving: Saving,
    /// Before this moment a refusal is told by no text.
    texts_from: Instant,
}

impl Params {
    pub(crate) const fn new() -> Self {
        Self { untold: LinkMask::NONE, hash: Hash::new(), saving: Saving::new(), texts_from: Instant::ZERO }
    }

    /// Whether a message is one of ours.
    pub(crate) const fn handles(id: u32) -> bool {
        matches!(id, ParamRequestRead::ID | ParamRequestList::ID | ParamSet::ID)
    }

    /// A frame whose message [`handles`](Self::handles) names, addressed to us or to all.
    pub(crate) fn on_frame<V: Parameters>(
        &mut self,
        cx: &mut Context<'_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        frame: &Frame<'_>,
    ) -> Taken {
        let ways = Ways::of::<V>();
        let Some(table) = vehicle.parameters_mut() else { return Taken::Yes };
        let (index, bits) = match self.on_request(cx, &mut table.table_mut(), ways, caller, frame) {
            Ok(taken) => return taken,
            Err(change) => change,
        };
        // All but the vehicle's own word is said, and there is room for a refusal.
        let change = ParamChange { index, bits, from: Some(caller.from), table: PhantomData };
        let verdict = vehicle.may_set(&change);
        if let Some(table) = vehicle.parameters_mut() {
            self.set(cx, &mut table.table_mut(), caller, (index, bits), verdict);
        }
        if verdict.is_ok() {
            vehicle.parameter_changed(&change);
        }
        Taken::Yes
    }

    /// Takes a request, but for setting a parameter to another value that it can have, which is left: its index and the
    /// value.
    fn on_request(
        &mut self,
        cx: &mut Context<'_>,
        table: &mut TableMut<'_>,
        ways: Ways,
        caller: &mut Caller<'_>,
        frame: &Frame<'_>,
    ) -> Result<Taken, (u16, u32)> {
        match frame.id() {
            ParamRequestList::ID => {
                let is_first = caller.replies.list(cx.now);
                // Who begins again did not want the hash (P-10).
                caller.replies.hash |= is_first && ways.hash == ParamHash::InList;
                Ok(Taken::Yes)
            }
            ParamRequestRead::ID => {
                Ok(self.on_read(cx, table, ways, caller, &ParamRequestRead::decode(frame.payload())))
            }
            _ => self.on_set(cx, table, ways, caller, &ParamSet::decode(frame.payload())),
        }
    }

    /// P-13.
    fn on_read(
        &mut self,
        cx: &mut Context<'_>,
        table: &mut TableMut<'_>,
        ways: Ways,
        caller: &mut Caller<'_>,
        read: &ParamRequestRead,
    ) -> Taken {
        let name = wire_name(&read.param_id);
        let found = match u16::try_from(read.param_index) {
            Ok(index) => table.get(index).map(|_| index),
            Err(_) if ways.is_hash(&name) => {
                caller.replies.hash = true;
                return Taken::Yes;
            }
            Err(_) => table.find(&name),
        };
        let Some(index) = found else {
            let index = read.param_index.max(-1);
            return self.refuse(cx, caller, false, MavParamError::DOES_NOT_EXIST, index, &name);
        };
        self.tell(table, index, LinkMask::of(caller.from.link));
        Taken::Yes
    }

    /// P-14, up to the vehicle's own word.
    fn on_set(
        &mut self,
        cx: &mut Context<'_>,
        table: &mut TableMut<'_>,
        ways: Ways,
        caller: &mut Caller<'_>,
        set: &ParamSet,
    ) -> Result<Taken, (u16, u32)> {
        if set.target_system == 0 {
            // Every vehicle in reach would be set to the same.
            return Ok(Taken::OutOfPlace);
        }
        let name = wire_name(&set.param_id);
        if ways.is_hash(&name) {
            // Who has all values needs no list. No answer: QGroundControl would take it for a new hash, and set it again.
            caller.replies.end_list();
            caller.replies.hash = false;
            return Ok(Taken::Yes);
        }
        if caller.replies.is_full() {
            return Ok(Taken::NoRoom);
        }
        let Some((index, (info, old))) = table.find(&name).and_then(|index| Some((index, table.get(index)?))) else {
            return Ok(self.refuse(cx, caller, true, MavParamError::DOES_NOT_EXIST, -1, &name));
        };
        match check(info, ways.encoding, set) {
            Ok(bits) if bits != old => return Err((index, bits)),
            Ok(_) => self.tell(table, index, cx.normal),
            Err(error) => self.set(cx, table, caller, (index, old), Err(error)),
        }
        Ok(Taken::Yes)
    }

    /// Sets a parameter, or refuses to, for which there is room. Everybody is told of the value that it has now (P-14).
    fn set(
        &mut self,
        cx: &mut Context<'_>,
        table: &mut TableMut<'_>,
        caller: &mut Caller<'_>,
        (index, bits): (u16, u32),
        verdict: Result<(), MavParamError>,
    ) {
        let Some((info, _)) = table.get(index) else { return };
        match verdict {
            Ok(()) => {
                event!("parameter {=u16} set by {}", index, caller.from);
                table.put(index, bits);
                self.saving.notice(cx.now, table.generation());
            }
            Err(error) => {
                self.refuse(cx, caller, true, error, -1, info.wire_name());
            }
        }
        self.tell(table, index, cx.normal);
    }

    /// The links of the mask are to be told of a value.
    fn tell(&mut self, table: &mut TableMut<'_>, index: u16, links: LinkMask) {
        table.tell(index, links);
        self.untold = self.untold.with(links);
    }

    /// Owes a PARAM_ERROR. For clients that do not know it there is a text too: when something was to be set, and where
    /// MAVLink 1 has nothing else (P-31, P-32). Not inlined: a second copy would cost 300 bytes.
    #[inline(never)]
    fn refuse(
        &mut self,
        cx: &mut Context<'_>,
        caller: &mut Caller<'_>,
        is_set: bool,
        error: MavParamError,
        index: i16,
        name: &[u8; 16],
    ) -> Taken {
        let is_v1 = caller.version == Version::V1;
        if !is_v1 && !caller.replies.refuse(Refusal { to: caller.from.address, error, index, name: *name }) {
            return Taken::NoRoom;
        }
        event!("parameter of {} refused: {=u8}", caller.from, error.0);
        if cfg!(feature = "plan-texts") && (is_set || is_v1) && cx.now >= self.texts_from {
            self.texts_from = cx.now.after(TEXT_PAUSE);
            let mut text = [0; MAX_TEXT_LEN];
            crate::message::zero_extend(name, &mut text);
            let mut text = Text::from_wire(text);
            text.push_str(reason(error));
            cx.texts.push(cx.now, LinkMask::of(caller.from.link), MavSeverity::WARNING, &text);
        }
        Taken::Yes
    }

    /// MAV_CMD_PREFLIGHT_STORAGE (P-17); `None` for any other command, and where there are no parameters.
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
        let count = vehicle.parameters_mut()?.table_mut().count();
        let [parameters, missions, ..] = command.params;
        let action = |param: f32| if param.is_nan() { Some(NOTHING) } else { crate::num::integer(param) };
        let (parameters, missions) = (action(parameters), action(missions));
        // Missions are read and written by themselves; to reset them there is MISSION_CLEAR_ALL.
        if !matches!(missions, Some(NOTHING..=1)) {
            return Some(MavResult::DENIED);
        }
        if vehicle.state().is_some_and(|state| state.base_mode.contains(MavModeFlag::SAFETY_ARMED)) {
            return Some(MavResult::TEMPORARILY_REJECTED);
        }
        let resets_all = match parameters {
            Some(NOTHING) => return Some(MavResult::ACCEPTED),
            Some(0) if self.saving.is_attached() => {
                self.saving.reload();
                return Some(MavResult::ACCEPTED);
            }
            Some(1) if self.saving.is_attached() => {
                self.hurry(cx.now, vehicle);
                return Some(MavResult::ACCEPTED);
            }
            Some(2) => false,
            Some(4) => true,
            _ => return Some(MavResult::DENIED),
        };
        for index in 0..count {
            let info = vehicle.parameters_mut()?.table_mut().get(index)?.0;
            if resets_all || !info.is_read_only() {
                self.change(vehicle, index, info.default_bits(), cx.normal, Some(command.from));
            }
        }
        self.hurry(cx.now, vehicle);
        Some(MavResult::ACCEPTED)
    }

    /// What is not stored yet is to be written now.
    fn hurry<V: Parameters>(&mut self, now: Instant, vehicle: &mut V) {
        if let Some(table) = vehicle.parameters_mut() {
            self.saving.hurry(now, table.table_mut().generation());
        }
    }

    /// Gives a parameter another value that it can have, if it has not, and tells everybody.
    fn change<V: Parameters>(&mut self, vehicle: &mut V, index: u16, bits: u32, links: LinkMask, from: Option<Peer>) {
        let Some(table) = vehicle.parameters_mut() else { return };
        let mut table = table.table_mut();
        if table.get(index).is_none_or(|(_, old)| old == bits) {
            return;
        }
        table.put(index, bits);
        self.tell(&mut table, index, links);
        vehicle.parameter_changed(&ParamChange { index, bits, from, table: PhantomData });
    }

    /// Looks what the vehicle set since the last time (P-16).
    pub(crate) fn poll<V: Parameters>(&mut self, now: Instant, vehicle: &mut V, normal: LinkMask) {
        let Some(table) = vehicle.parameters_mut() else { return };
        let mut table = table.table_mut();
        if table.take_news() {
            self.untold = self.untold.with(normal);
        }
        self.saving.notice(now, table.generation());
    }

    /// Whether an answer is owed on a link.
    pub(crate) fn is_pending(&self, replies: &Replies, tx: &Outbox) -> bool {
        replies.has_any() || self.untold.contains(LinkMask::of(tx.link()))
    }

    /// Sends an answer: a refusal, the hash, or a value that somebody asked for or that has changed. False when none is
    /// ready.
    pub(crate) fn next<V: Parameters>(&mut self, vehicle: &mut V, replies: &mut Replies, tx: &mut Outbox) -> bool {
        let Some(table) = vehicle.parameters_mut() else { return false };
        self.next_answer(&mut table.table_mut(), Ways::of::<V>(), replies, tx)
    }

    fn next_answer(&mut self, table: &mut TableMut<'_>, ways: Ways, replies: &mut Replies, tx: &mut Outbox) -> bool {
        // Before the value: MAVSDK sets again when it sees the old one, and gives up when it sees this.
        if replies.next_refusal(tx) {
            return true;
        }
        if ways.hash != ParamHash::Never
            && replies.hash
            && let Some(hash) = self.hash.step(table)
        {
            replies.hash = false;
            return send_as(table, NO_INDEX, &HASH_NAME, MavParamType::UINT32, f32::from_bits(hash), tx);
        }
        let link = LinkMask::of(tx.link());
        if !self.untold.contains(link) {
            return false;
        }
        let Some(index) = table.next_untold(link, replies.from) else {
            self.untold = self.untold.without(link);
            return false;
        };
        replies.from = index.saturating_add(1);
        send_value(table, ways, index, tx)
    }

    /// Sends the next value of the list, when its turn has come on a link of so many bytes/s (P-11). False when it has not.
    pub(crate) fn next_listed<V: Parameters>(
        &mut self,
        now: Instant,
        vehicle: &mut V,
        replies: &mut Replies,
        bytes_per_second: u32,
        tx: &mut Outbox,
    ) -> bool {
        let Some(table) = vehicle.parameters_mut() else { return false };
        let Some(index) = replies.listed(now) else { return false };
        let mut table = table.table_mut();
        replies.list_on(now, table.count(), bytes_per_second);
        send_value(&mut table, Ways::of::<V>(), index, tx)
    }

    /// When the list of a link goes on; never, when there is none.
    pub(crate) const fn list_due(replies: &Replies) -> Instant {
        replies.list_due()
    }

    /// When there is something to write: see [`unsaved`](Self::unsaved).
    pub(crate) fn deadline(&self) -> Instant {
        self.saving.deadline()
    }
}

/// What storage is asked for, and what comes back from it.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
impl Params {
    /// A parameter comes back from storage (P-17): the stored value, or the default of this firmware when the stored one was
    /// the default too. It stays as it is when there is none of that name and type, or when it cannot have the value.
    pub(crate) fn load<V: Parameters>(&mut self, vehicle: &mut V, stored: &Stored, links: LinkMask) {
        let Some(table) = vehicle.parameters_mut() else { return };
        let table = table.table_mut();
        let Some((index, (info, _))) = table.find(&stored.name).and_then(|index| Some((index, table.get(index)?)))
        else {
            return;
        };
        let bits = if stored.is_default { info.default_bits() } else { stored.bits };
        if info.param_type() == stored.r#type && !info.is_volatile() && info.has_room(bits) {
            self.change(vehicle, index, bits, links, None);
        }
    }

    /// All that storage had came back; from now on it is kept up.
    pub(crate) fn loaded<V: Parameters>(&mut self, vehicle: &mut V) {
        if let Some(table) = vehicle.parameters_mut() {
            self.saving.loaded(table.table_mut().generation());
        }
    }

    /// Whether the operator wants the stored values back: [`load`](Self::load) them and say [`loaded`](Self::loaded).
    pub(crate) const fn wants_reload(&self) -> bool {
        self.saving.wants_reload()
    }

    /// The number of the write that is under way, or begins now; `None` when there is nothing to write.
    pub(crate) fn unsaved<V: Parameters>(&mut self, now: Instant, vehicle: &mut V) -> Option<u32> {
        self.saving.job(now, vehicle.parameters_mut()?.table_mut().generation())
    }

    /// Storage holds it.
    pub(crate) fn saved(&mut self, now: Instant) {
        self.saving.saved(now);
    }

    /// Storage failed; it is tried again (P-14, last row).
    pub(crate) fn not_saved(&mut self, cx: &mut Context<'_>) {
        if self.saving.not_saved(cx.now) {
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

/// The value that a PARAM_SET asks for, or why not.
fn check(info: &ParamInfo, encoding: ParamEncoding, set: &ParamSet) -> Result<u32, MavParamError> {
    // Who casts need not know the type, and pymavlink says REAL32 of everything.
    let is_ours = set.param_type == info.param_type() || encoding == ParamEncoding::CCast;
    if !value::is_supported(set.param_type) {
        return Err(MavParamError::TYPE_UNSUPPORTED);
    } else if !is_ours {
        return Err(MavParamError::TYPE_MISMATCH);
    } else if info.is_read_only() {
        return Err(MavParamError::READ_ONLY);
    }
    let bits = value::from_wire(encoding, info.param_type(), set.param_value);
    // Not clamped: a client that reads something else back sets it again, and fails (P-14).
    bits.filter(|bits| info.has_room(*bits)).ok_or(MavParamError::VALUE_OUT_OF_RANGE)
}

fn send_value(table: &mut TableMut<'_>, ways: Ways, index: u16, tx: &mut Outbox) -> bool {
    let Some((info, bits)) = table.get(index) else { return false };
    table.told(index, LinkMask::of(tx.link()));
    let value = value::to_wire(ways.encoding, info.param_type(), bits);
    send_as(table, index, info.wire_name(), info.param_type(), value, tx)
}

fn send_as(
    table: &TableMut<'_>,
    param_index: u16,
    name: &[u8; 16],
    param_type: MavParamType,
    param_value: f32,
    tx: &mut Outbox,
) -> bool {
    let (param_count, param_id) = (table.count(), Text::from_wire(*name));
    tx.send(&ParamValue { param_value, param_count, param_index, param_id, param_type })
}

/// A name with zeros behind it, whatever stood there.
fn wire_name(text: &Text<16>) -> [u8; 16] {
    let mut name = [0; 16];
    crate::message::zero_extend(text.as_bytes(), &mut name);
    name
}

/// Why a parameter is refused.
fn reason(error: MavParamError) -> &'static str {
    match error {
        MavParamError::DOES_NOT_EXIST => ": no such parameter",
        MavParamError::VALUE_OUT_OF_RANGE => ": out of range",
        MavParamError::READ_ONLY => ": read-only",
        MavParamError::TYPE_UNSUPPORTED | MavParamError::TYPE_MISMATCH => ": wrong type",
        _ => ": not now",
    }
}
