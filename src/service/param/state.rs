//! The service's state for all links, besides the values and their marks. It is next to the values, so a vehicle without parameters
//! does not have it.

use super::hash::Hash;
use super::refusals::ParamRefusals;
use crate::log::RefusalLog;
use crate::time::Instant;
use crate::types::LinkMask;

/// Pending answers, and limits of reports.
#[derive(Clone, Debug)]
pub struct ParamState {
    /// The links on which a value may be pending.
    pub(super) pending: LinkMask,
    /// The links on which the hash is pending.
    pub(super) hash_pending: LinkMask,
    /// The computation of the hash.
    pub(super) hash: Hash,
    pub(super) refusals: ParamRefusals,
    /// Before this time, no text is sent about a refusal.
    pub(super) texts_from: Instant,
    /// Limits the log of refusals.
    pub(super) refusal_log: RefusalLog,
}

impl ParamState {
    pub(super) const NEW: Self = Self {
        pending: LinkMask::NONE,
        hash_pending: LinkMask::NONE,
        hash: Hash::NEW,
        refusals: ParamRefusals::NEW,
        texts_from: Instant::ZERO,
        refusal_log: RefusalLog::NEW,
    };

    /// Drops the pending answers of these links, which were reopened: the clients are gone.
    pub(super) fn forget(&mut self, links: LinkMask) {
        self.refusals.forget(links);
        self.hash_pending = self.hash_pending.without(links);
    }
}
