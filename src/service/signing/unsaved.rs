//! Without the feature `storage`, nothing is stored.

use crate::time::Instant;

#[derive(Clone, Copy, Debug)]
pub(super) struct Saving;

#[allow(clippy::unused_self, reason = "the same methods as with storage")]
impl Saving {
    pub(super) const NEW: Self = Self;

    pub(super) const fn has_token(&self, _: Instant) -> bool {
        true
    }

    pub(super) const fn spend_token(&mut self, _: Instant) {}

    pub(super) const fn key_changed(&mut self, _: bool) {}

    pub(super) const fn is_key_lost(&self) -> bool {
        false
    }
}
