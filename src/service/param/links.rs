//! A cache of facts about the links, for code without access to the table.

use super::info::Rows;
use super::list::ParamList;
use super::state::ParamState;
use super::table::Table;
use crate::service::Turn;
use crate::time::Instant;
use crate::types::{LinkId, LinkMask};

/// A frame that the service sends.
#[derive(Clone, Copy, Debug)]
pub enum ParamReply {
    /// A refusal, the hash, or a value that was requested or has changed.
    Answer,
    /// The next value of the list.
    Listed,
    /// The first value of a list that no client has requested: all values of a backend may have changed.
    Unrequested,
}

/// The links on which something is pending.
#[derive(Debug)]
pub(super) struct ParamLinks {
    /// The links on which an answer is pending, and can be sent now.
    pending: LinkMask,
    /// The links on which the hash is pending.
    hash_pending: LinkMask,
    /// Whether the hash takes more polls.
    pub(super) is_hashing: bool,
    /// The links that were reopened since the last access to the table.
    reopened: LinkMask,
}

impl ParamLinks {
    pub(super) const NEW: Self =
        Self { pending: LinkMask::NONE, hash_pending: LinkMask::NONE, is_hashing: false, reopened: LinkMask::NONE };

    /// Calls `work` with the table, which is updated for reopened links before. Updates the cache after it.
    pub(super) fn with<'t, R: Rows, T>(
        &mut self,
        mut table: Table<'t, R>,
        work: impl FnOnce(&mut Table<'t, R>) -> T,
    ) -> T {
        if !self.reopened.is_empty() {
            table.state.forget(core::mem::take(&mut self.reopened));
        }
        let result = work(&mut table);
        self.update(&table);
        result
    }

    fn update<R: Rows>(&mut self, table: &Table<'_, R>) {
        let ParamState { pending, hash_pending, hash, refusals, .. } = &*table.state;
        self.pending = pending.with(refusals.links());
        self.hash_pending = *hash_pending;
        self.is_hashing = !hash_pending.is_empty() && !hash.is_ready(&table.rows);
        if !self.is_hashing {
            self.pending = self.pending.with(*hash_pending);
        }
    }

    /// Returns when the next step of the hash is due.
    pub(super) fn hash_deadline(&self) -> Instant {
        if self.is_hashing { Instant::ZERO } else { Instant::NEVER }
    }

    /// Whether an answer is pending on a link.
    pub(super) fn has_answer(&self, link: LinkId) -> bool {
        self.pending.contains(link)
    }

    /// Whether the list of a link waits for the hash, which is sent first.
    pub(super) fn is_list_held(&self, link: LinkId) -> bool {
        self.hash_pending.contains(link)
    }

    /// Returns the pending frame of a link in a turn, and when it is due.
    #[inline(always)]
    pub(super) fn pending_in(
        &self,
        turn: Turn,
        now: Instant,
        link: LinkId,
        list: &ParamList,
    ) -> Option<(Instant, ParamReply)> {
        match turn {
            Turn::ParamAnswer => self.has_answer(link).then_some((now, ParamReply::Answer)),
            _ if self.is_list_held(link) => None,
            Turn::LateParamList => Some((list.late_at(), ParamReply::Listed)),
            _ => Some((list.due(), ParamReply::Listed)),
        }
    }

    /// Ends the list and drops the pending answers of a link that was reopened.
    pub(super) fn reopen(&mut self, link: LinkId, list: &mut ParamList) {
        list.end();
        let link = LinkMask::of(link);
        self.reopened = self.reopened.with(link);
        self.pending = self.pending.without(link);
        self.hash_pending = self.hash_pending.without(link);
    }
}
