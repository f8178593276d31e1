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

/// What must be written, and when.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Saving {
    pub(crate) schedule: WriteSchedule,
    /// The generation of the table that is stored or being written. A value that is loaded advances it too, so it differs from the
    /// table's only after other changes.
    stored: u32,
    /// Whether the stored values must be loaded again.
    pub(crate) is_reload_requested: bool,
    /// Whether the stored values were not loaded yet.
    is_unloaded: bool,
}

#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
impl Saving {
    pub(super) const NEW: Self =
        Self { schedule: WriteSchedule::NEW, stored: 0, is_reload_requested: false, is_unloaded: false };

    /// Records that storage is attached.
    pub(super) const fn attach(&mut self, generation: u32) {
        (self.stored, self.is_unloaded) = (generation, true);
        self.schedule.stored_differs = false;
    }

    /// Returns whether a page keeps values that are no defaults: after an earlier attempt failed, or if a value was set since
    /// storage was attached. If the operator requests the stored values, what was set before the first page is not wanted. It is
    /// still written if they cannot be read.
    pub(crate) fn keeps_values(&mut self, now: Instant, generation: u32, is_first: bool, is_late: bool) -> bool {
        if self.is_reload_requested {
            if is_first {
                self.notice(now, generation);
                self.stored = generation;
            }
            return false;
        }
        is_late || self.is_unloaded && generation != self.stored
    }

    /// Records that a change of the table was loaded from storage.
    pub(super) const fn on_value_loaded(&mut self) {
        self.stored = self.stored.wrapping_add(1);
    }

    /// Records that storage has other values than the table.
    pub(super) const fn set_unsaved(&mut self, generation: u32) {
        self.stored = generation.wrapping_sub(1);
    }

    /// Records that the stored values were loaded. What was set meanwhile is noticed again. If they could not be read, pending
    /// writes stay pending.
    pub(crate) const fn loaded(&mut self, is_read: bool) {
        (self.is_reload_requested, self.is_unloaded) = (false, false);
        let was_attached = self.schedule.attach();
        if !was_attached || is_read {
            self.schedule.clear();
        }
    }

    /// Handles a second attempt to read. Pending changes are written after a successful read; otherwise the write is deferred,
    /// so that it does not replace what is still unread.
    pub(crate) fn reread(&mut self, now: Instant, is_read: bool) {
        if self.schedule.is_pending() {
            self.schedule.postpone(if is_read { Instant::ZERO } else { now + COOLDOWN });
        }
    }

    /// Makes a write of all changes due now. Damaged values are written again, which ends the report of the damage (G-18).
    pub(super) fn write_now(&mut self, now: Instant, generation: u32) {
        if self.schedule.stored_differs {
            self.set_unsaved(generation);
        }
        self.notice(now, generation);
        self.schedule.write_now(now);
    }

    /// Checks whether there is something to write.
    pub(super) fn notice(&mut self, now: Instant, generation: u32) {
        if generation != self.stored {
            self.schedule.collect(now, COLLECT);
        }
    }

    /// Whether the token bucket is too empty for a write. A write is needed if the request `will_change` something, or if
    /// changes are pending, or what is stored is damaged (C-15).
    pub(super) fn is_rate_limited(&self, now: Instant, will_change: bool) -> bool {
        let is_needed = will_change || self.schedule.stored_differs || self.schedule.is_dirty();
        self.schedule.is_attached() && is_needed && !self.schedule.bucket.has(now, 1)
    }

    /// Returns the number of the write that is in progress or begins now.
    pub(super) fn pending_write(&mut self, now: Instant, generation: u32) -> Option<u16> {
        self.notice(now, generation);
        let had_begun = !self.schedule.is_dirty();
        let write = self.schedule.begin(now, 1)?;
        if !had_begun {
            self.stored = generation;
        }
        Some(write)
    }

    /// Records that a write is complete.
    pub(super) fn on_saved(&mut self, now: Instant) {
        self.schedule.on_saved(now, COOLDOWN);
    }

    /// When the next write is due.
    pub(super) fn deadline(&self) -> Instant {
        if self.is_reload_requested { Instant::ZERO } else { self.schedule.deadline() }
    }
}
