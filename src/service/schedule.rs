//! When the content of a service is written to storage (M-44, P-17, SEC-12).
//!
//! ```text
//!              request, collect            due          on_saved
//!   saved ──────────────────────▶ dirty ────────▶ writing ────────▶ saved
//!                                   ▲                │
//!                                   └── on_failed: retried after 10 s
//! ```
//!
//! The services differ in how they use it, and by a few constants:
//!
//! | | a write begins | content that changes meanwhile | after a write |
//! |---|---|---|---|
//! | plans | at once | starts a new write | storage rests for 200 ms, so that the answer is sent first |
//! | parameters | after collecting changes for 1 s | may or may not be included, and causes another write | 10 s to the next write, unless the operator requests it |
//! | key | at once | starts a new write | |

use super::token_bucket::TokenBucket;
use crate::time::{Duration, Instant};

/// The pause after a failed write.
const RETRY: Duration = Duration::from_secs(10);

/// The schedule of one kind of content. Its initial value is all zero bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Schedule {
    /// Whether storage is attached.
    is_attached: bool,
    /// Whether the last write failed.
    has_failed: bool,
    /// Whether storage has other content, or none that can be used: a request then writes even what has not changed.
    pub(crate) stored_differs: bool,
    phase: Phase,
    /// Stands for the content that is being written: other content has another number. It wraps, but not during a write.
    version: u16,
    /// When the next write may begin.
    due: Instant,
    /// Limits the writes that peers cause.
    pub(crate) bucket: TokenBucket,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Storage has the content.
    Saved,
    /// The content must be written, and no write of it has begun.
    Dirty,
    /// As `Dirty`, and the write needs no token, because it was requested.
    Urgent,
    Writing,
}

#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "nothing is stored"))]
impl Schedule {
    /// No storage is attached.
    pub(crate) const NEW: Self = Self {
        is_attached: false,
        has_failed: false,
        stored_differs: false,
        phase: Phase::Saved,
        version: 0,
        due: Instant::ZERO,
        bucket: TokenBucket::NONE,
    };

    /// Attaches storage. Returns whether it was attached already.
    pub(crate) const fn attach(&mut self) -> bool {
        core::mem::replace(&mut self.is_attached, true)
    }

    /// Whether storage is attached. Without the feature `storage` the compiler knows that it is not.
    pub(crate) const fn is_attached(&self) -> bool {
        cfg!(any(feature = "storage", test)) && self.is_attached
    }

    /// Whether content must be written, and no write of it has begun.
    pub(crate) const fn is_dirty(&self) -> bool {
        matches!(self.phase, Phase::Dirty | Phase::Urgent)
    }

    /// Whether content is pending or being written.
    pub(crate) fn is_pending(&self) -> bool {
        self.phase != Phase::Saved
    }

    /// Whether the pause after the last write or failure is not over. Collecting counts as a pause, too.
    pub(crate) fn is_resting(&self, now: Instant) -> bool {
        now < self.due
    }

    /// Returns the version of the content.
    pub(crate) const fn version(&self) -> u16 {
        self.version
    }

    /// Records that storage has the content.
    pub(crate) const fn clear(&mut self) {
        (self.phase, self.has_failed, self.stored_differs) = (Phase::Saved, false, false);
    }

    /// Changes the version because the content has changed: what was written so far is useless.
    pub(crate) const fn restart(&mut self) {
        self.version = self.version.wrapping_add(1);
    }

    /// Requests a write of content that has changed.
    pub(crate) const fn request(&mut self) {
        self.restart();
        self.phase = Phase::Dirty;
    }

    /// Requests a write after changes were collected for this time, unless one is pending.
    pub(crate) fn collect(&mut self, now: Instant, time: Duration) {
        if self.is_attached() && !self.is_pending() {
            self.phase = Phase::Dirty;
            self.due = (now + time).max(self.due);
        }
    }

    /// Makes a requested write due now, whatever the pause and the tokens.
    pub(crate) const fn write_now(&mut self, now: Instant) {
        if self.is_dirty() {
            (self.due, self.phase) = (now, Phase::Urgent);
        }
    }

    /// Returns the version that is being written. Begins the requested write if it is due and there are tokens for it.
    pub(crate) fn begin(&mut self, now: Instant, tokens: u8) -> Option<u16> {
        if self.is_dirty() && now >= self.due && (self.phase == Phase::Urgent || self.bucket.has(now, tokens)) {
            self.bucket.spend(now, tokens);
            self.restart();
            self.phase = Phase::Writing;
        }
        (self.phase == Phase::Writing).then_some(self.version)
    }

    /// Puts a pending write off until this time, also one that is in progress.
    pub(crate) fn postpone(&mut self, until: Instant) {
        (self.phase, self.due) = (Phase::Dirty, self.due.max(until));
    }

    /// Records that the write is complete, and pauses.
    pub(crate) fn on_saved(&mut self, now: Instant, pause: Duration) {
        self.clear();
        self.due = now + pause;
    }

    /// Records a failure. Returns true for the first one after a success.
    pub(crate) const fn has_newly_failed(&mut self) -> bool {
        !core::mem::replace(&mut self.has_failed, true)
    }

    /// Pauses after a failure.
    pub(crate) fn pause(&mut self, now: Instant) {
        self.due = now + RETRY;
    }

    /// Records a failure, after which the content is written again. Returns true for the first one after a success.
    pub(crate) fn on_failed(&mut self, now: Instant) -> bool {
        self.pause(now);
        self.phase = Phase::Dirty;
        self.has_newly_failed()
    }

    /// When the next write, which needs a token, can begin.
    pub(crate) fn deadline(&self) -> Instant {
        match self.phase {
            Phase::Saved => Instant::NEVER,
            Phase::Dirty => self.due.max(self.bucket.ready_at()),
            Phase::Urgent => self.due,
            Phase::Writing => Instant::ZERO,
        }
    }
}
