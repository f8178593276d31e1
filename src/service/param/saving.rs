//! When parameters are written to storage: behind the changes, together, and not often (P-17, SEC-12).
//!
//! A write begins a second after the first change, with all that came since, and not within ten seconds of the write before,
//! unless the operator asks for it. A change during a write may or may not be included, and causes another write. After many
//! writes, writes become less frequent (C-15).

use crate::service::wear::Wear;
use crate::time::{Duration, Instant};

/// How long changes are collected.
const COLLECT: Duration = Duration::from_secs(1);
/// How long the storage rests after a write, and after a failure.
const REST: Duration = Duration::from_secs(10);

/// What is to be written, and when.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
#[derive(Clone, Copy, Debug)]
pub(super) struct Saving {
    /// Whether there is storage.
    attached: bool,
    /// Whether the table differs from what is stored, as far as that was noticed.
    dirty: bool,
    /// Whether a write is under way.
    busy: bool,
    /// Whether the last one failed, which was told.
    failed: bool,
    /// Whether the stored values are to come back.
    reload: bool,
    /// The generation that is stored, or that is being written.
    stored: u32,
    /// When the next write may begin.
    due: Instant,
    /// When the storage has rested.
    rested: Instant,
    /// Whether the next write is requested at once.
    is_urgent: bool,
    wear: Wear,
}

#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
impl Saving {
    pub(super) const fn new() -> Self {
        Self {
            attached: false,
            dirty: false,
            busy: false,
            failed: false,
            reload: false,
            stored: 0,
            due: Instant::ZERO,
            rested: Instant::ZERO,
            is_urgent: false,
            wear: Wear::NONE,
        }
    }

    pub(super) const fn is_attached(&self) -> bool {
        self.attached
    }

    /// The table of this generation is as the storage has it. Where that could not be read after all, what was to be written still
    /// is.
    pub(super) fn loaded(&mut self, generation: u32, is_read: bool) {
        self.reload = false;
        if self.attached && !is_read {
            return;
        }
        *self = Self { attached: true, stored: generation, rested: self.rested, wear: self.wear, ..Self::new() };
    }

    /// Handles a second attempt to read. Pending changes are written after a successful read; otherwise the write is deferred,
    /// so that it does not replace what is still unread.
    pub(super) fn reread(&mut self, now: Instant, generation: u32, is_read: bool) {
        if self.busy || self.dirty {
            (self.busy, self.dirty) = (false, true);
            self.due = if is_read { self.due } else { now.after(REST) };
        } else if is_read {
            self.stored = generation;
        }
    }

    /// Looks whether there is something to write.
    #[inline(never)]
    pub(super) fn notice(&mut self, now: Instant, generation: u32) {
        if self.attached && !self.dirty && !self.busy && generation != self.stored {
            self.dirty = true;
            self.due = now.after(COLLECT).max(self.rested);
        }
    }

    /// Makes a write due now, if a change was [noticed](Self::notice).
    pub(super) fn hurry(&mut self, now: Instant) {
        self.due = now;
        self.is_urgent = self.dirty;
    }

    /// Sets the interval of writes in the long run.
    pub(super) fn limit(&mut self, refill: Duration) {
        self.wear.limit(refill);
    }

    /// Whether the token bucket is too empty for a write. A write is needed if the request `will_change` something, or if
    /// changes are pending (C-15).
    pub(super) fn is_worn(&self, now: Instant, will_change: bool) -> bool {
        self.attached && (will_change || self.dirty) && !self.wear.has(now, 1)
    }

    /// The operator wants the stored values back; what is not written yet is given up.
    pub(super) fn reload(&mut self) {
        self.reload = true;
    }

    pub(super) const fn wants_reload(&self) -> bool {
        self.reload
    }

    /// The number of the write that is under way, or begins now.
    pub(super) fn job(&mut self, now: Instant, generation: u32) -> Option<u32> {
        self.notice(now, generation);
        if self.dirty && now >= self.due && (self.is_urgent || self.wear.has(now, 1)) {
            self.wear.spend(now, 1);
            (self.dirty, self.is_urgent) = (false, false);
            self.busy = true;
            self.stored = generation;
        }
        self.busy.then_some(self.stored)
    }

    pub(super) fn saved(&mut self, now: Instant) {
        self.busy = false;
        self.failed = false;
        self.rested = now.after(REST);
    }

    /// True when it is the first failure after a success.
    pub(super) fn not_saved(&mut self, now: Instant) -> bool {
        self.busy = false;
        self.dirty = true;
        self.rested = now.after(REST);
        self.due = self.rested;
        !core::mem::replace(&mut self.failed, true)
    }

    /// When there is something to write.
    pub(super) fn deadline(&self) -> Instant {
        match (self.busy || self.reload, self.dirty) {
            (true, _) => Instant::ZERO,
            (_, true) if self.is_urgent => self.due,
            (_, true) => self.due.max(self.wear.ready_at()),
            _ => Instant::NEVER,
        }
    }
}
