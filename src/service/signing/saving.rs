//! When the key and the time are stored, and the state of a key that could not be read (G-13, G-15, G-18, SEC-8).

use super::Signing;
use super::timestamp::Timestamp;
use crate::frame::SigningKey;
use crate::service::write_schedule::{TokenBucket, WriteSchedule};
use crate::time::{Duration, Instant};

/// How long before our time reaches the stored timestamp the next one is stored: longer than writing takes.
const AHEAD: Duration = Duration::from_secs(5);

/// The minimum average time between stored timestamps, whatever peers send: a little less than without peers (C-15).
const TIME_REFILL: Duration = Duration::from_secs(50);

/// The state of persistence.
#[derive(Clone, Copy, Debug)]
pub(super) struct Saving {
    /// Its bucket limits the writes that SETUP_SIGNING causes.
    schedule: WriteSchedule,
    /// The stored timestamp: no later one is in use, if storage keeps up.
    reserved: Timestamp,
    /// The timestamp that is being stored.
    next: Timestamp,
    /// Whether there may be a stored key that cannot be read.
    is_key_lost: bool,
    /// Whether storage may have a key that was replaced or removed since.
    has_old_key: bool,
    /// Limits the writes that the progress of time causes: a peer's frames can advance it.
    times: TokenBucket,
}

impl Saving {
    pub(super) const NEW: Self = Self {
        schedule: WriteSchedule::NEW,
        reserved: Timestamp::ZERO,
        next: Timestamp::ZERO,
        is_key_lost: false,
        has_old_key: false,
        times: TokenBucket::NONE,
    };

    /// Whether a peer may cause another key to be stored (C-15).
    pub(super) fn has_token(&self, now: Instant) -> bool {
        self.schedule.bucket.has(now, 1)
    }

    /// Counts a key that a peer causes to be stored.
    pub(super) fn spend_token(&mut self, now: Instant) {
        self.schedule.bucket.spend(now, 1);
    }

    /// Requests a write, because the key was set or removed. `had_other_key`: it replaces another one.
    pub(super) const fn key_changed(&mut self, had_other_key: bool) {
        self.has_old_key |= had_other_key;
        self.is_key_lost = false;
        self.schedule.request();
    }

    /// Whether the stored key is unreadable, and no other was set since.
    pub(super) const fn is_key_lost(&self) -> bool {
        self.is_key_lost
    }
}

/// The interface to storage (G-13, G-15).
impl Signing {
    /// Restores the stored key and time. Time starts there, unless it is later already.
    pub(crate) fn restore(&mut self, now: Instant, key: Option<SigningKey>, timestamp: u64) {
        self.key = key;
        self.advance(now, Timestamp(timestamp));
        self.saving.schedule.clear();
        self.saving.reserved = Timestamp(timestamp);
        self.saving.is_key_lost = false;
        self.saving.has_old_key = false;
    }

    /// Storage is attached. Until it is read there may be a key, so links that need one stay closed (G-18).
    /// `refill`: the time in which storage regains a token for one more key (C-15).
    pub(crate) fn attach_storage(&mut self, refill: Duration) {
        self.saving.is_key_lost = true;
        self.saving.has_old_key = true;
        self.saving.schedule.bucket.set_refill(refill);
        self.saving.times.set_refill(if refill == Duration::ZERO { refill } else { TIME_REFILL });
    }

    /// Records that the stored key cannot be read. Until a key is set or removed, links that need one stay closed
    /// (G-18). A key that the vehicle has set before stays in use. It is stored, unless the stored one may become
    /// readable.
    pub(crate) const fn lost(&mut self, may_come_back: bool) {
        if may_come_back {
            self.saving.schedule.clear();
        }
        self.saving.is_key_lost = may_come_back || !self.is_active();
        self.saving.has_old_key = true;
    }

    /// Records that no stored key can become readable: the key that the vehicle has set must be stored.
    pub(crate) const fn nothing_stored(&mut self) {
        self.saving.has_old_key = false;
        if core::mem::replace(&mut self.saving.is_key_lost, false) && self.is_active() {
            self.saving.schedule.request();
        }
    }

    /// Whether the stored key is unreadable, and no other was set since.
    pub(crate) const fn is_lost(&self) -> bool {
        self.saving.is_key_lost
    }

    /// Returns the number of the version to store now, if any. The same number means the same content.
    pub(crate) fn pending_write(&mut self, now: Instant) -> Option<u16> {
        let time = self.unbounded_time(now);
        let is_active = self.is_active();
        let Saving { schedule, reserved, next, is_key_lost, times, .. } = &mut self.saving;
        if *is_key_lost || schedule.is_resting(now) {
            return None;
        }
        let is_due = is_active && reserved.since(time) <= AHEAD;
        if is_due && !schedule.is_pending() && times.has(now, 1) {
            times.spend(now, 1);
            schedule.request();
        }
        if schedule.is_dirty() {
            // A restart skips at most this minute (G-15).
            *next = time.minute_later();
        }
        schedule.begin(now, 0)
    }

    /// Returns the content to be stored: the key, and the timestamp to start with.
    pub(crate) fn content(&self) -> (Option<&SigningKey>, u64) {
        (self.key.as_ref(), self.saving.next.0)
    }

    /// Requests a write of the key.
    pub(crate) const fn save_again(&mut self) {
        self.saving.schedule.request();
    }

    /// Whether storage has an old key, which must be erased (SEC-15).
    pub(crate) const fn has_old_key(&self) -> bool {
        self.saving.has_old_key
    }

    /// Records that the version is stored.
    pub(crate) fn on_saved(&mut self, now: Instant) {
        self.saving.has_old_key = false;
        self.saving.schedule.on_saved(now, Duration::ZERO);
        self.saving.reserved = self.saving.next;
    }

    /// Records that storing failed. It is tried again later.
    pub(crate) fn on_save_failed(&mut self, now: Instant) {
        self.saving.schedule.on_failed(now);
    }
}
