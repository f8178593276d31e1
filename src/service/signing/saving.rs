//! When the key and the time are written to storage, and what is known of a key that could not be read (G-13, G-15, G-18).

use super::{MINUTE, Signing};
use crate::frame::SigningKey;
use crate::service::wear::Wear;
use crate::time::{Duration, Instant};

/// So far ahead the timestamp is stored (10 µs): what a restart skips at most (G-15).
const RESERVATION: u64 = MINUTE;

/// So long before it is reached the next one is stored (10 µs): longer than writing takes.
const AHEAD: u64 = 500_000;

/// So far apart time is stored in the long run, whatever peers tell: a little less than it is without them (C-15).
const TIME_REFILL: Duration = Duration::from_secs(50);

/// After storage failed it is left alone for so long.
const RETRY: Duration = Duration::from_secs(10);

/// Where the storing stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Saving {
    /// The timestamp that is stored: none beyond it is in use, if storage keeps up.
    pub(super) reserved: u64,
    /// The one that is being stored.
    pub(super) next: Option<u64>,
    /// Counts what is to be stored.
    pub(super) job: u32,
    /// Whether the key is not stored yet.
    pub(super) is_new: bool,
    /// Not before this moment.
    pub(super) rests_until: Instant,
    /// Whether there may be a stored key that cannot be read.
    pub(super) is_lost: bool,
    /// Writes because of SETUP_SIGNING.
    pub(super) keys: Wear,
    /// Writes because time went on, which a peer's frames can make it do.
    pub(super) times: Wear,
}

impl Saving {
    pub(super) const fn new() -> Self {
        Self {
            reserved: 0,
            next: None,
            job: 0,
            is_new: false,
            rests_until: Instant::ZERO,
            is_lost: false,
            keys: Wear::NONE,
            times: Wear::NONE,
        }
    }
}

/// What the store asks (G-13, G-15).
impl Signing {
    /// What was stored: time begins there, unless it is beyond already.
    pub(crate) fn restore(&mut self, now: Instant, key: Option<SigningKey>, timestamp: u64) {
        self.key = key;
        self.advance(now, timestamp);
        (self.saving.is_new, self.saving.next, self.saving.reserved) = (false, None, timestamp);
        self.saving.is_lost = false;
    }

    /// From now on there is storage, which bears one more key in this time (C-15).
    pub(crate) fn limit(&mut self, refill: Duration) {
        self.saving.keys.limit(refill);
        self.saving.times.limit(if refill == Duration::ZERO { refill } else { TIME_REFILL });
    }

    /// What was stored cannot be read, or not yet. Until a key is set or taken away, links stay closed where there is none (G-18).
    /// A key that the vehicle has set before stays in use; it is stored unless the stored one may come back.
    pub(crate) const fn lost(&mut self, may_come_back: bool) {
        if may_come_back {
            (self.saving.is_new, self.saving.next) = (false, None);
        }
        self.saving.is_lost = may_come_back || !self.is_active();
    }

    /// There is no stored key that could come back: what the vehicle has set is to be stored.
    pub(crate) const fn nothing_stored(&mut self) {
        if self.saving.is_lost {
            (self.saving.is_lost, self.saving.is_new) = (false, self.is_active());
        }
    }

    /// Whether what was stored has not come back, and nothing else was set since.
    pub(crate) const fn is_lost(&self) -> bool {
        self.saving.is_lost
    }

    /// What is to be stored by now: a number for it. The same number, the same content.
    pub(crate) fn unsaved(&mut self, now: Instant) -> Option<u32> {
        if now < self.saving.rests_until || self.saving.is_lost {
            return None;
        }
        let time = self.time(now);
        if self.saving.next.is_none() {
            let is_due = self.is_active() && time.saturating_add(AHEAD) >= self.saving.reserved;
            if !self.saving.is_new {
                if !is_due || !self.saving.times.has(now, 1) {
                    return None;
                }
                self.saving.times.spend(now, 1);
            }
            self.saving.next = Some(time.saturating_add(RESERVATION));
            self.saving.is_new = false;
            self.saving.job = self.saving.job.wrapping_add(1);
        }
        Some(self.saving.job)
    }

    /// The content of the job: the key, and the timestamp to begin with.
    pub(crate) fn content(&self) -> (Option<&SigningKey>, u64) {
        (self.key.as_ref(), self.saving.next.unwrap_or(0))
    }

    /// It is stored.
    pub(crate) const fn saved(&mut self) {
        if let Some(timestamp) = self.saving.next.take() {
            self.saving.reserved = timestamp;
        }
    }

    /// It is not, and is tried again later.
    pub(crate) fn not_saved(&mut self, now: Instant) {
        (self.saving.is_new, self.saving.next) = (true, None);
        self.saving.rests_until = now.after(RETRY);
    }
}
