//! The service for parameters whose values the stack owns.

use core::marker::PhantomData;

use super::links::{ParamLinks, ParamReply};
use super::list::ParamList;
use super::requests::{ParamClient, ParamRequest, handles};
use super::saving::Saving;
use super::storage::StorageAction;
use super::table::{ParamChange, ParamTable, Stored, TableMut};
use super::vehicle::{ParamOptions, Parameters};
use crate::dialect::{MavParamError, MavResult, MavSeverity};
use crate::link::Port;
use crate::message::Address;
use crate::service::{About, Cx, Handled, Received, Request, Service, StackEvent, Turn, Verdict, View};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkId, Peer, Vehicle};

/// Lists, reads and sets parameters. Its state for all links is in the table, next to the values. This type caches
/// facts for calls without access to the table.
#[derive(Debug)]
pub struct ParamService {
    pub(super) links: ParamLinks,
    /// When the next write to storage is due.
    write_due: Instant,
    reset: Reset,
}

/// A reset of all parameters, which takes as many polls as it needs. Initially all bits are zero.
#[derive(Debug)]
struct Reset {
    /// The number of parameters that are left, up to the last.
    left: u16,
    /// Whether read-only parameters are reset, too.
    all: bool,
    /// The client.
    from: Peer,
}

impl Reset {
    const NONE: Self = Self { left: 0, all: false, from: Peer { address: Address::new(0, 0), link: LinkId(0) } };
}

const fn options<V: Parameters>() -> ParamOptions {
    ParamOptions::new(V::PARAM_ENCODING, V::PARAM_HASH, V::PARAM_ERROR)
}

impl ParamService {
    /// Calls `work` with the table, and updates the cached state after it.
    fn with_table<'t, T: ParamTable, R>(&mut self, table: &'t mut T, work: impl FnOnce(&mut TableMut<'t>) -> R) -> R {
        self.links.with(table.table_mut(), |table| {
            let result = work(table);
            self.write_due = table.rows.saving.deadline();
            result
        })
    }

    /// Sets a parameter for a client, if the vehicle permits it.
    fn set<F>(&mut self, cx: &mut Cx<'_, F>, index: u16, bits: u32, from: Peer) -> Result<(), MavParamError>
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Parameters<Table = F::Parameters>>,
    {
        let change = ParamChange { index, bits, from: Some(from), table: PhantomData };
        let (vehicle, mut context) = cx.hook();
        vehicle.may_set(&mut context, &change)?;
        self.with_table(cx.parameters, |table| {
            table.change(index, bits, cx.shared.normal);
            table.rows.saving.notice(cx.now);
        });
        let (vehicle, mut context) = cx.hook();
        vehicle.parameter_changed(&mut context, &change);
        Ok(())
    }

    /// Resets the next parameters to their defaults, as many as a poll may tell the vehicle of, and stores all after the last.
    fn continue_reset<F>(&mut self, cx: &mut Cx<'_, F>)
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Parameters<Table = F::Parameters>>,
    {
        while let Some(left) = self.reset.left.checked_sub(1) {
            if !cx.shared.may_continue() {
                cx.shared.has_acted = true;
                return;
            }
            let table = cx.parameters.table_mut();
            let index = table.count().saturating_sub(self.reset.left);
            self.reset.left = left;
            let Some((info, _)) = table.get(index) else { continue };
            let bits = info.default_bits();
            let is_reset = self.reset.all || !info.is_read_only();
            if is_reset && self.with_table(cx.parameters, |table| table.change(index, bits, cx.shared.normal)) {
                let change = ParamChange { index, bits, from: Some(self.reset.from), table: PhantomData };
                let (vehicle, mut context) = cx.hook();
                vehicle.parameter_changed(&mut context, &change);
            }
        }
        cx.shared.pending_resets = 0;
        self.write_now(cx.now, cx.parameters);
    }
}

impl<F> Service<F> for ParamService
where
    F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
{
    const NEW: Self = Self { links: ParamLinks::NEW, write_due: Instant::ZERO, reset: Reset::NONE };
    type Link = ParamList;
    const VACANT: ParamList = ParamList::NEW;
    type Reply = ParamReply;
    const ABOUT: About = if F::Parameters::INFO.is_empty() {
        About::AUTOPILOT
    } else {
        About { capabilities: F::Vehicle::PARAM_ENCODING.capability(), ..About::AUTOPILOT }
    }
    .in_turns(&[Turn::ParamAnswer, Turn::LateParamList, Turn::ParamList]);

    /// Notices values that the vehicle has set since the last call (P-16).
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ParamList>) {
        self.with_table(cx.parameters, |table| {
            table.rows.saving.notice(cx.now);
            table.compute_hash();
        });
        if self.reset.left > 0 {
            self.continue_reset(cx);
        }
        if cx.shared.is_storage_busy || !cx.vehicle.may_persist() {
            // Nothing may be written, so no poll is needed for it.
            self.write_due = Instant::NEVER;
        }
    }

    fn deadline(&self) -> Instant {
        self.links.hash_deadline()
    }

    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        list: &mut ParamList,
        received: &Received<'_>,
    ) -> Handled {
        if !handles(received.frame.id()) {
            return Handled::No;
        }
        let options = options::<F::Vehicle>().on(port);
        let client = ParamClient { now: cx.now, from: received.from, options, normal_links: cx.shared.normal };
        let request = self.with_table(cx.parameters, |table| table.on_request(cx.texts, client, list, received));
        match request {
            ParamRequest::Handled(handled) => handled,
            ParamRequest::Set { index, bits } => {
                let decision = self.set(cx, index, bits, client.from);
                self.with_table(cx.parameters, |table| table.on_decision(cx.texts, client, index, decision));
                Handled::Yes
            }
        }
    }

    /// MAV_CMD_PREFLIGHT_STORAGE (P-17).
    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        _: &mut Port,
        _: &mut ParamList,
        request: &Request,
    ) -> Option<Verdict> {
        let table = cx.parameters.table_mut();
        let (count, saving) = (table.count(), table.rows.saving);
        let action = match StorageAction::of(&request.command, saving.schedule.is_attached(), cx.vehicle)? {
            Ok(action) => action,
            Err(refusal) => return Some(Verdict::Refused(refusal)),
        };
        saving.notice(cx.now);
        let is_reset = matches!(action, StorageAction::Reset { .. });
        if (is_reset || action == StorageAction::Write) && saving.is_rate_limited(cx.now, is_reset) {
            return Some(Verdict::Refused(MavResult::TEMPORARILY_REJECTED.into()));
        }
        match action {
            StorageAction::Nothing => {}
            StorageAction::Read => {
                let now = cx.now;
                if !self.saving(cx.parameters, |saving| saving.request_reload(now)) {
                    return Some(Verdict::Refused(MavResult::TEMPORARILY_REJECTED.into()));
                }
            }
            StorageAction::Write => self.write_now(cx.now, cx.parameters),
            StorageAction::Reset { all } => {
                // The answer waits for the end. Another reset meanwhile starts again from the first one, and both are answered then,
                // so it must not leave out what the one before includes.
                let all = all || (self.reset.left > 0 && self.reset.all);
                self.reset = Reset { left: count, all, from: request.command.from };
                cx.shared.pending_resets = u8::from(count > 0);
            }
        }
        Some(Verdict::done(MavResult::ACCEPTED))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, list: &ParamList, turn: Turn) -> Option<(Instant, ParamReply)> {
        self.links.pending_in(turn, view.now, port.id, list)
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, list: &mut ParamList, reply: ParamReply) -> bool {
        let options = options::<F::Vehicle>();
        self.with_table(cx.parameters, |table| match reply {
            ParamReply::Answer => table.send_answer(options, list, &mut port.outbox),
            ParamReply::Listed | ParamReply::Unrequested => table.send_listed(options, cx.now, list, port),
        })
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Begun(_) => self.write_due = Instant::NEVER,
            StackEvent::Opened(port, list) => self.links.reopen(port.id, list),
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
        let is_kept = keeps_value && old != info.default_bits();
        if is_kept || info.is_volatile() || !info.is_valid(bits) {
            return;
        }
        if self.with_table(cx.parameters, |table| table.load(index, bits, cx.shared.normal)) {
            let (vehicle, mut context) = cx.hook();
            vehicle.parameter_changed(&mut context, &ParamChange { index, bits, from: None, table: PhantomData });
        }
    }

    /// Calls `work` with the state of storage.
    pub(crate) fn saving<T: ParamTable, R>(&mut self, table: &mut T, work: impl FnOnce(&mut Saving) -> R) -> R {
        let saving = table.table_mut().rows.saving;
        let result = work(saving);
        self.write_due = saving.deadline();
        result
    }

    /// Records that storage is attached; nothing was read yet. `refill` is the time in which it regains one token for a write
    /// that peers cause (C-15).
    pub(crate) fn attach<T: ParamTable>(&mut self, table: &mut T, refill: Duration) {
        self.saving(table, |saving| {
            saving.schedule.bucket.set_refill(refill);
            saving.attach();
        });
    }

    /// Returns when a write to storage is due.
    #[cfg(any(test, feature = "storage"))]
    pub(crate) const fn write_due(&self) -> Instant {
        self.write_due
    }

    /// Makes a write of all changes due now.
    pub(crate) fn write_now<T: ParamTable>(&mut self, now: Instant, table: &mut T) {
        self.saving(table, |saving| saving.write_now(now));
    }

    /// Requests that the values are written again.
    pub(crate) fn save_again<T: ParamTable>(&mut self, table: &mut T) {
        self.saving(table, Saving::set_changed);
    }

    /// Whether the operator has requested the stored values: the caller [loads](Self::load) them and calls
    /// [`loaded`](Saving::loaded).
    pub(crate) fn is_reload_requested<T: ParamTable>(&self, table: &mut T) -> bool {
        table.table_mut().rows.saving.is_reload_requested
    }

    /// Returns the number of the write that is in progress or begins now; `None` if there is nothing to write.
    pub(crate) fn pending_write<T: ParamTable>(&mut self, now: Instant, table: &mut T) -> Option<u16> {
        self.saving(table, |saving| saving.pending_write(now))
    }

    /// Records that the write is complete.
    pub(crate) fn on_saved<T: ParamTable>(&mut self, now: Instant, table: &mut T) {
        self.saving(table, |saving| saving.on_saved(now));
    }

    /// Records that the write failed; it is retried (P-14, last row).
    pub(crate) fn on_save_failed<F: Firmware<Parameters: ParamTable>>(&mut self, cx: &mut Cx<'_, F>) {
        let now = cx.now;
        if self.saving(cx.parameters, |saving| saving.schedule.on_failed(now)) {
            cx.text(MavSeverity::ERROR, b"Parameters not saved");
        }
    }
}
