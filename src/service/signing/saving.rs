//! When the key and the time are stored, and the state of a key that could not be read (G-13, G-15, G-18, SEC-8).

use super::{MINUTE, Signing};
use crate::frame::SigningKey;
use crate::service::write_schedule::{TokenBucket, WriteSchedule};
use crate::time::{Duration, Instant};

/// How far ahead the timestamp is stored (10 µs): the most that a restart skips (G-15).
const RESERVATION: u64 = MINUTE;

/// How long before our time reaches the stored timestamp the next one is stored (10 µs): longer than writing takes.
const AHEAD: u64 = 500_000;

/// The minimum average time between stored timestamps, whatever peers send: a little less than without peers (C-15).
const TIME_REFILL: Duration = Duration::from_secs(50);

/// The state of persistence.
#[derive(Clone, Copy, Debug)]
pub(super) struct Saving {
    /// Its bucket limits the writes that SETUP_SIGNING causes.
    pub(super) schedule: WriteSchedule,
    /// The stored timestamp: no later one is in use, if storage keeps up.
    pub(super) reserved: u64,
    /// The timestamp that is being stored.
    pub(super) next: u64,
    /// Whether there may be a stored key that cannot be read.
    pub(super) is_lost: bool,
    /// Whether storage may have a key that was replaced or removed since.
    pub(super) has_old_key: bool,
    /// Limits the writes that the progress of time causes: a peer's frames can advance it.
    pub(super) times: TokenBucket,
}

impl Saving {
    pub(super) const NEW: Self = Self {
        schedule: WriteSchedule::NEW,
        reserved: 0,
        next: 0,
        is_lost: false,
        has_old_key: false,
        times: TokenBucket::NONE,
    };
}

/// The interface to storage (G-13, G-15).
impl Signing {
    /// Restores the stored key and time. Time starts there, unless it is later already.
    pub(crate) fn restore(&mut self, now: Instant, key: Option<SigningKey>, timestamp: u64) {
        self.key = key;
        self.advance(now, timestamp);
        self.saving.schedule.clear();
        (self.saving.reserved, self.saving.is_lost, self.saving.has_old_key) = (timestamp, false, false);
    }

    /// Storage is attached. Until it is read there may be a key, so links that need one stay closed (G-18).
    /// `refill`: the time in which storage regains a token for one more key (C-15).
    pub(crate) fn attach_storage(&mut self, refill: Duration) {
        (self.saving.is_lost, self.saving.has_old_key) = (true, true);
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
        (self.saving.is_lost, self.saving.has_old_key) = (may_come_back || !self.is_active(), true);
    }

    /// Records that no stored key can become readable: the key that the vehicle has set must be stored.
    pub(crate) const fn nothing_stored(&mut self) {
        self.saving.has_old_key = false;
        if core::mem::replace(&mut self.saving.is_lost, false) && self.is_active() {
            self.saving.schedule.request();
        }
    }

    /// Whether the stored key is unreadable, and no other was set since.
    pub(crate) const fn is_lost(&self) -> bool {
        self.saving.is_lost
    }

    /// Returns the number of the version to store now, if any. The same number means the same content.
    pub(crate) fn pending_write(&mut self, now: Instant) -> Option<u16> {
        let time = self.time(now);
        let is_active = self.is_active();
        let Saving { schedule, reserved, next, is_lost, times, .. } = &mut self.saving;
        if *is_lost || schedule.is_resting(now) {
            return None;
        }
        let is_due = is_active && time.saturating_add(AHEAD) >= *reserved;
        if is_due && !schedule.is_pending() && times.has(now, 1) {
            times.spend(now, 1);
            schedule.request();
        }
        if schedule.is_dirty() {
            *next = time.saturating_add(RESERVATION);
        }
        schedule.begin(now, 0)
    }

    /// Returns the content to be stored: the key, and the timestamp to start with.
    pub(crate) fn content(&self) -> (Option<&SigningKey>, u64) {
        (self.key.as_ref(), self.saving.next)
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
