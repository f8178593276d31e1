//! What the service keeps for all links, beside the values and their marks: in the table, so that a vehicle without
//! parameters has none of it.

use super::hash::Hash;
use super::replies::Refusals;
use super::saving::Saving;
use crate::link::LinkMask;
use crate::time::Instant;

#[derive(Clone, Debug)]
pub(super) struct State {
    /// Counts the changes of what is stored. Wraps.
    pub(super) generation: u32,
    /// Links that may not have been told of every value.
    pub(super) untold: LinkMask,
    /// Links that the hash is owed on, and how far it is.
    pub(super) hash_owed: LinkMask,
    pub(super) hash: Hash,
    pub(super) refusals: Refusals,
    pub(super) saving: Saving,
    /// Before this moment a refusal is told by no text.
    pub(super) texts_from: Instant,
}

impl State {
    pub(super) const fn new() -> Self {
        Self {
            generation: 0,
            untold: LinkMask::NONE,
            hash_owed: LinkMask::NONE,
            hash: Hash::new(),
            refusals: Refusals::new(),
            saving: Saving::new(),
            texts_from: Instant::ZERO,
        }
    }

    /// The links that an answer is owed on.
    pub(super) fn owed(&self) -> LinkMask {
        self.untold.with(self.hash_owed).with(self.refusals.links())
    }

    /// The lines of these links were opened anew: nobody is there any more who asked. Not inlined: it is rare, and would stand
    /// at each door of the service.
    #[inline(never)]
    pub(super) fn forget(&mut self, links: LinkMask) {
        self.refusals.forget(links);
        self.hash_owed = self.hash_owed.without(links);
    }
}
