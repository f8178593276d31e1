//! The schedule for storing the key and the time, and the state of a key that could not be read (G-13, G-15, G-18).

use super::{MINUTE, Signing};
use crate::frame::SigningKey;
use crate::service::wear::Wear;
use crate::time::{Duration, Instant};

/// How far ahead the timestamp is stored (10 µs): the most that a restart skips (G-15).
const RESERVATION: u64 = MINUTE;

/// How long before our time reaches the stored timestamp the next one is stored (10 µs): longer than writing takes.
const AHEAD: u64 = 500_000;

/// The minimum average time between stored timestamps, whatever peers send: a little less than without peers (C-15).
const TIME_REFILL: Duration = Duration::from_secs(50);

/// The pause after a failed write.
const RETRY: Duration = Duration::from_secs(10);

/// The state of persistence.
#[derive(Clone, Copy, Debug)]
pub(super) struct Saving {
    /// The stored timestamp: no later one is in use, if storage keeps up.
    pub(super) reserved: u64,
    /// The timestamp that is being stored.
    pub(super) next: Option<u64>,
    /// Counts the versions to be stored.
    pub(super) job: u32,
    /// Whether the key is not stored yet.
    pub(super) is_new: bool,
    /// Nothing is stored before this moment.
    pub(super) rests_until: Instant,
    /// Whether there may be a stored key that cannot be read.
    pub(super) is_lost: bool,
    /// Limits the writes that SETUP_SIGNING causes.
    pub(super) keys: Wear,
    /// Limits the writes that the progress of time causes: a peer's frames can advance it.
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

/// The interface to the store (G-13, G-15).
impl Signing {
    /// Restores the stored key and time. Time starts there, unless it is later already.
    pub(crate) fn restore(&mut self, now: Instant, key: Option<SigningKey>, timestamp: u64) {
        self.key = key;
        self.advance(now, timestamp);
        (self.saving.is_new, self.saving.next, self.saving.reserved) = (false, None, timestamp);
        self.saving.is_lost = false;
    }

    /// Limits writes: the storage permits one more key in this time (C-15).
    pub(crate) fn limit(&mut self, refill: Duration) {
        self.saving.keys.limit(refill);
        self.saving.times.limit(if refill == Duration::ZERO { refill } else { TIME_REFILL });
    }

    /// Records that the stored key cannot be read. Until a key is set or removed, links that need one stay closed
    /// (G-18). A key that the vehicle has set before stays in use. It is stored, unless the stored one may become
    /// readable.
    pub(crate) const fn lost(&mut self, may_come_back: bool) {
        if may_come_back {
            (self.saving.is_new, self.saving.next) = (false, None);
        }
        self.saving.is_lost = may_come_back || !self.is_active();
    }

    /// Records that no stored key can become readable: the key that the vehicle has set is to be stored.
    pub(crate) const fn nothing_stored(&mut self) {
        if self.saving.is_lost {
            (self.saving.is_lost, self.saving.is_new) = (false, self.is_active());
        }
    }

    /// Whether the stored key is unreadable, and no other was set since.
    pub(crate) const fn is_lost(&self) -> bool {
        self.saving.is_lost
    }

    /// Returns the number of the version that is to be stored now, if any. The same number means the same content.
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

    /// Returns the content to be stored: the key, and the timestamp to start with.
    pub(crate) fn content(&self) -> (Option<&SigningKey>, u64) {
        (self.key.as_ref(), self.saving.next.unwrap_or(0))
    }

    /// Records that the version is stored.
    pub(crate) const fn saved(&mut self) {
        if let Some(timestamp) = self.saving.next.take() {
            self.saving.reserved = timestamp;
        }
    }

    /// Records that storing failed. It is tried again later.
    pub(crate) fn not_saved(&mut self, now: Instant) {
        (self.saving.is_new, self.saving.next) = (true, None);
        self.saving.rests_until = now.after(RETRY);
    }
}
