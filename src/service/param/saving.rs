//! When parameters are written to storage: changes are collected and written together (P-17, SEC-12).
//!
//! A write begins a second after the first change and includes all later ones. It does not begin within ten seconds of the
//! previous write, unless the operator requests it. A change during a write may or may not be included, and causes another
//! write. After many writes, a token bucket makes them less frequent (C-15).

use crate::service::write_schedule::WriteSchedule;
use crate::time::{Duration, Instant};

/// How long changes are collected.
const COLLECT: Duration = Duration::from_secs(1);
/// Minimum time from the end of a write, or from a failure, to the next write.
const COOLDOWN: Duration = Duration::from_secs(10);

/// What a page of stored values replaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Replaced {
    /// All values.
    All,
    /// The values that are still defaults.
    Defaults,
    Nothing,
}

/// Whether the table must be written or loaded, and when.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Saving {
    pub(crate) schedule: WriteSchedule,
    /// Whether a value that is stored has changed since the last write began.
    has_changed: bool,
    /// Whether the stored values must be loaded again.
    pub(crate) is_reload_requested: bool,
    /// Whether a value that is stored has changed since then.
    is_overtaken: bool,
    /// Whether the stored values were not loaded yet.
    is_unloaded: bool,
}

#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
impl Saving {
    pub(super) const NEW: Self = Self {
        schedule: WriteSchedule::NEW,
        has_changed: false,
        is_reload_requested: false,
        is_overtaken: false,
        is_unloaded: false,
    };

    /// Records that storage is attached.
    pub(super) const fn attach(&mut self) {
        (self.has_changed, self.is_unloaded) = (false, true);
        self.schedule.stored_differs = false;
    }

    /// Requests that the stored values are loaded again. Refuses while a value is not stored yet, because a value that was
    /// acknowledged must not be taken back (C-15). Makes the write of that value due now if the token bucket permits it.
    /// Returns whether the request is granted.
    pub(super) fn request_reload(&mut self, now: Instant) -> bool {
        let is_unsaved = self.has_changed || self.schedule.is_pending();
        if !is_unsaved {
            (self.is_reload_requested, self.is_overtaken) = (true, false);
        } else if !self.is_rate_limited(now, false) {
            self.write_now(now);
        }
        !is_unsaved
    }

    /// Returns which values a page of stored values replaces. It replaces only defaults after an earlier attempt failed, or
    /// if a value was set since storage was attached.
    pub(crate) const fn replaced(&self, is_retry: bool) -> Replaced {
        match (self.is_reload_requested, self.is_overtaken) {
            (true, false) => Replaced::All,
            // All values were stored when they were requested, so those that differ now were set since.
            (true, true) if !is_retry => Replaced::Nothing,
            _ if is_retry || self.is_unloaded && self.has_changed => Replaced::Defaults,
            _ => Replaced::All,
        }
    }

    /// Whether the stored values were not loaded yet.
    pub(crate) const fn is_unloaded(&self) -> bool {
        self.is_unloaded
    }

    /// Records that the table has other values than storage.
    pub(super) const fn set_changed(&mut self) {
        (self.has_changed, self.is_overtaken) = (true, true);
    }

    /// Records that the stored values were loaded. Values that were set meanwhile count as changed again. If they could
    /// not be read, pending writes stay pending.
    pub(crate) const fn loaded(&mut self, is_read: bool) {
        (self.is_reload_requested, self.is_unloaded) = (false, false);
        let was_attached = self.schedule.attach();
        if !was_attached || is_read {
            self.schedule.clear();
        }
    }

    /// Handles a second attempt to read. Pending changes are written after a successful read; otherwise the write is
    /// deferred, so that it does not replace values that are still unread.
    pub(crate) fn reread(&mut self, now: Instant, is_read: bool) {
        if self.schedule.is_pending() {
            self.schedule.postpone(if is_read { Instant::ZERO } else { now + COOLDOWN });
        }
    }

    /// Makes a write of all changes due now. Damaged values are written again, which ends the report of the damage (G-18).
    pub(super) fn write_now(&mut self, now: Instant) {
        self.has_changed |= self.schedule.stored_differs;
        self.notice(now);
        self.schedule.write_now(now);
    }

    /// Schedules a write if there is something to write.
    pub(super) fn notice(&mut self, now: Instant) {
        if self.has_changed {
            self.schedule.collect(now, COLLECT);
        }
    }

    /// Whether the token bucket is too empty for a write. A write is needed if the request `will_change` something, or
    /// if changes are pending, or the stored values are damaged (C-15).
    pub(super) fn is_rate_limited(&self, now: Instant, will_change: bool) -> bool {
        let is_needed = will_change || self.schedule.stored_differs || self.schedule.is_dirty();
        self.schedule.is_attached() && is_needed && !self.schedule.bucket.has(now, 1)
    }

    /// Returns the number of the write that is in progress or begins now.
    pub(super) fn pending_write(&mut self, now: Instant) -> Option<u16> {
        self.notice(now);
        let had_begun = !self.schedule.is_dirty();
        let write = self.schedule.begin(now, 1)?;
        self.has_changed &= had_begun;
        Some(write)
    }

    /// Records that a write is complete.
    pub(super) fn on_saved(&mut self, now: Instant) {
        self.schedule.on_saved(now, COOLDOWN);
    }

    /// Returns when the next write or reload is due. Without storage, the compiler knows that none is.
    pub(super) fn deadline(&self) -> Instant {
        match self.is_reload_requested {
            _ if !self.schedule.is_attached() => Instant::NEVER,
            true => Instant::ZERO,
            false => self.schedule.deadline(),
        }
    }
}
