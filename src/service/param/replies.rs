//! Sends the pending answers, and the values of a list.

use core::borrow::Borrow;
use core::num::Saturating;

use super::info::{HASH_NAME, ParamInfo, Rows};
use super::list::ParamList;
use super::table::Table;
use super::value;
use super::vehicle::{ParamHash, ParamOptions};
use crate::dialect::{MavParamType, ParamValue};
use crate::link::{Outbox, Port};
use crate::message::Text;
use crate::time::Instant;
use crate::types::LinkMask;

/// `param_index` of a value that is not in the table.
const NO_INDEX: u16 = u16::MAX;

impl<R: Rows> Table<'_, R> {
    /// Takes the next step of the hash, if it is pending and takes more than one.
    pub(super) fn compute_hash(&mut self) {
        let state = &mut *self.state;
        if !state.hash_pending.is_empty() && !state.hash.is_ready(&self.rows) {
            state.hash.step(&self.rows);
        }
    }

    /// Sends a refusal, the hash or a pending value. Returns false if none is ready.
    pub(super) fn send_answer(&mut self, options: ParamOptions, list: &mut ParamList, tx: &mut Outbox) -> bool {
        let link = LinkMask::of(tx.link());
        let state = &mut *self.state;
        // The refusal is sent before the value: MAVSDK gives up after a PARAM_ERROR, but retries after the old value.
        if options.has_errors && state.refusals.next(tx) {
            return true;
        }
        let has_hash = options.hash != ParamHash::Never && state.hash_pending.intersects(link);
        if has_hash && state.hash.is_ready(&self.rows) {
            state.hash_pending = state.hash_pending.without(link);
            let sum = f32::from_bits(state.hash.sum(&self.rows));
            return self.send_as(NO_INDEX, &HASH_NAME, MavParamType::UINT32, sum, tx);
        }
        let mut is_sent = false;
        if let Some(index) = self.next_pending(link, list.search_from.0) {
            list.search_from = Saturating(index) + Saturating(1);
            is_sent = self.send_value(options, index, tx);
        }
        if self.next_pending(link, list.search_from.0).is_none() {
            self.state.pending = self.state.pending.without(link);
        }
        is_sent
    }

    /// Returns the next value that is pending on a link: from `start` on, then from the beginning.
    fn next_pending(&self, link: LinkMask, start: u16) -> Option<u16> {
        if !self.state.pending.intersects(link) {
            return None;
        }
        let (before, after) = self.marks.split_at_checked(usize::from(start))?;
        let mut rows = (start..).zip(after).chain((0..).zip(before));
        rows.find(|(_, marks)| marks.intersects(link)).map(|(index, _)| index)
    }

    /// Sends the next value of the list (P-11).
    pub(super) fn send_listed(
        &mut self,
        options: ParamOptions,
        now: Instant,
        list: &mut ParamList,
        port: &mut Port,
    ) -> bool {
        let index = list.next();
        list.advance(now, self.count(), port.config.bytes_per_second);
        self.send_value(options, index, &mut port.outbox)
    }

    fn send_value(&mut self, options: ParamOptions, index: u16, tx: &mut Outbox) -> bool {
        if let Some(marks) = self.marks.get_mut(usize::from(index)) {
            *marks = marks.without(LinkMask::of(tx.link()));
        }
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
