//! The service's state for all links, besides the values and their marks. It is part of the table, so a vehicle without
//! parameters does not have it.

use super::hash::Hash;
use super::replies::Refusals;
use super::saving::Saving;
use crate::log::RefusalLog;
use crate::time::Instant;
use crate::types::LinkMask;

/// `K` is what is kept of values that the stack owns, or of those that it does not own.
#[derive(Clone, Debug)]
pub struct State<K> {
    pub(super) kept: K,
    /// Counts the changes of non-volatile parameters that the stack owns. Wraps.
    pub(super) generation: u32,
    /// The links on which a value may be pending.
    pub(super) pending: LinkMask,
    /// The links on which the hash is pending.
    pub(super) hash_pending: LinkMask,
    /// The computation of the hash.
    pub(super) hash: Hash,
    pub(super) refusals: Refusals,
    /// Before this time, no text is sent about a refusal.
    pub(super) texts_from: Instant,
    /// When a refusal is logged.
    pub(super) refused: RefusalLog,
}

/// For values that the stack owns: when they are stored.
#[derive(Clone, Debug)]
pub struct Kept {
    pub(super) saving: Saving,
}

impl Kept {
    pub(super) const NEW: Self = Self { saving: Saving::NEW };
}

impl<K> State<K> {
    pub(super) const fn new(kept: K) -> Self {
        Self {
            kept,
            generation: 0,
            pending: LinkMask::NONE,
            hash_pending: LinkMask::NONE,
            hash: Hash::new(),
            refusals: Refusals::new(),
            texts_from: Instant::ZERO,
            refused: RefusalLog::NEW,
        }
    }

    /// Drops the pending answers of these links, which were reopened: the clients are gone.
    pub(super) fn forget(&mut self, links: LinkMask) {
        self.refusals.forget(links);
        self.hash_pending = self.hash_pending.without(links);
    }
}
