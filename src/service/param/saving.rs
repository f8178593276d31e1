//! Schedules the writes of parameters to storage: changes are collected and written together (P-17, SEC-12).
//!
//! A write begins a second after the first change and includes all later ones. It does not begin within ten seconds of the
//! previous write, unless the operator requests it. A change during a write may or may not be included, and causes another
//! write. After many writes, a token bucket makes them less frequent (C-15).

use crate::service::wear::Wear;
use crate::time::{Duration, Instant};

/// How long changes are collected.
const COLLECT: Duration = Duration::from_secs(1);
/// Minimum time from the end of a write, or from a failure, to the next write.
const COOLDOWN: Duration = Duration::from_secs(10);

/// What must be written, and when.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the service's own"))]
#[derive(Clone, Copy, Debug)]
pub(super) struct Saving {
    /// Whether storage is attached.
    attached: bool,
    /// Whether a difference between the table and storage was noticed.
    dirty: bool,
    /// Whether a write is in progress.
    busy: bool,
    /// Whether the last write failed, which was reported.
    failed: bool,
    /// Whether the stored values must be loaded again.
    reload: bool,
    /// The generation of the table that is stored or being written.
    stored: u32,
    /// When the next write may begin.
    due: Instant,
    /// When the time between writes has passed.
    rested: Instant,
    /// Whether the operator has requested the next write.
    is_urgent: bool,
    bucket: Wear,
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
            bucket: Wear::NONE,
        }
    }

    pub(super) const fn is_attached(&self) -> bool {
        self.attached
    }

    /// Records that the stored values were loaded: the table of this generation is equal to storage. If they could not be read,
    /// pending writes stay pending.
    pub(super) fn loaded(&mut self, generation: u32, is_read: bool) {
        self.reload = false;
        if self.attached && !is_read {
            return;
        }
        *self = Self { attached: true, stored: generation, rested: self.rested, bucket: self.bucket, ..Self::new() };
    }

    /// Handles a second attempt to read. Pending changes are written after a successful read; otherwise the write is deferred,
    /// so that it does not replace what is still unread.
    pub(super) fn reread(&mut self, now: Instant, generation: u32, is_read: bool) {
        if self.busy || self.dirty {
            (self.busy, self.dirty) = (false, true);
            self.due = if is_read { self.due } else { now.after(COOLDOWN) };
        } else if is_read {
            self.stored = generation;
        }
    }

    /// Checks whether there is something to write.
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

    /// Sets the time in which the bucket regains one token: the interval of writes in the long run.
    pub(super) fn limit(&mut self, refill: Duration) {
        self.bucket.limit(refill);
    }

    /// Whether the token bucket is too empty for a write. A write is needed if the request `will_change` something, or if
    /// changes are pending (C-15).
    pub(super) fn is_rate_limited(&self, now: Instant, will_change: bool) -> bool {
        self.attached && (will_change || self.dirty) && !self.bucket.has(now, 1)
    }

    /// Requests that the stored values are loaded again; changes that are not written yet are dropped.
    pub(super) fn reload(&mut self) {
        self.reload = true;
    }

    pub(super) const fn wants_reload(&self) -> bool {
        self.reload
    }

    /// Returns the number of the write that is in progress or begins now.
    pub(super) fn job(&mut self, now: Instant, generation: u32) -> Option<u32> {
        self.notice(now, generation);
        if self.dirty && now >= self.due && (self.is_urgent || self.bucket.has(now, 1)) {
            self.bucket.spend(now, 1);
            (self.dirty, self.is_urgent) = (false, false);
            self.busy = true;
            self.stored = generation;
        }
        self.busy.then_some(self.stored)
    }

    /// Records that a write is complete.
    pub(super) fn saved(&mut self, now: Instant) {
        self.busy = false;
        self.failed = false;
        self.rested = now.after(COOLDOWN);
    }

    /// Records that a write failed. Returns true for the first failure after a success.
    pub(super) fn not_saved(&mut self, now: Instant) -> bool {
        self.busy = false;
        self.dirty = true;
        self.rested = now.after(COOLDOWN);
        self.due = self.rested;
        !core::mem::replace(&mut self.failed, true)
    }

    /// When the next write is due.
    pub(super) fn deadline(&self) -> Instant {
        match (self.busy || self.reload, self.dirty) {
            (true, _) => Instant::ZERO,
            (_, true) if self.is_urgent => self.due,
            (_, true) => self.due.max(self.bucket.ready_at()),
            _ => Instant::NEVER,
        }
    }
}
