//! When the content of a service is written to storage (M-44, P-17, SEC-12), and how often peers may cause a write
//! (C-15).
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
//!
//! Flash endures some 10,000 erases of a unit, and a peer on an open link can request writes at line rate. So a token
//! bucket limits the writes that peers cause. A write of the parameters, of the key, or of a plan of up to a quarter of
//! plan memory takes one token; a larger plan takes up to four.
//! [`Config::storage_refill`](crate::Config::storage_refill) has the arithmetic.

use crate::time::{Duration, Instant};

/// The pause after a failed write.
const RETRY: Duration = Duration::from_secs(10);

/// The schedule of one kind of content. Its initial value is all zero bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WriteSchedule {
    /// Whether storage is attached.
    is_attached: bool,
    /// Whether the last write failed.
    has_failed: bool,
    /// Whether storage has other content, or none that can be used: a request then writes even unchanged content.
    pub(crate) stored_differs: bool,
    phase: Phase,
    /// Stands for the content that is being written: other content has another number. It wraps, but not during a
    /// write.
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
impl WriteSchedule {
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

    /// Changes the version because the content has changed: the pages written so far are useless.
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
    pub(crate) const fn note_failure(&mut self) -> bool {
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
        self.note_failure()
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

/// Number of tokens in a full bucket: enough for 32 of the largest plans.
const CAPACITY: u64 = 128;

/// The bucket of one kind of content. It stores when it will be full again instead of a number of tokens, so that
/// refilling needs no arithmetic.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TokenBucket {
    /// The time in which one token is refilled; zero disables the limit.
    refill: Duration,
    /// When the bucket will be full.
    full_at: Instant,
}

#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "nothing is stored"))]
impl TokenBucket {
    /// No limit: no storage is attached.
    pub(crate) const NONE: Self = Self { refill: Duration::ZERO, full_at: Instant::ZERO };

    /// Sets the time in which one token is refilled.
    pub(crate) const fn set_refill(&mut self, refill: Duration) {
        self.refill = refill;
    }

    /// Returns the time in which this many tokens are refilled.
    const fn time(&self, tokens: u64) -> Duration {
        Duration::from_micros(self.refill.as_micros().saturating_mul(tokens))
    }

    /// Whether the bucket holds at least this many tokens.
    pub(crate) fn has(&self, now: Instant, tokens: u8) -> bool {
        let left = CAPACITY.saturating_sub(tokens.into());
        self.full_at - now <= self.time(left)
    }

    /// Takes this many tokens, or all that are left.
    pub(crate) fn spend(&mut self, now: Instant, tokens: u8) {
        let full_at = self.full_at.max(now) + self.time(tokens.into());
        self.full_at = full_at.min(now + self.time(CAPACITY));
    }

    /// Returns when a token is available.
    pub(crate) fn ready_at(&self) -> Instant {
        let time = self.time(CAPACITY.saturating_sub(1));
        Instant::from_micros(self.full_at.as_micros().saturating_sub(time.as_micros()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// C-15: a burst empties the bucket; then as many tokens are available as were refilled. However long the pause,
    /// there are never more than the capacity.
    #[test]
    fn tokens_are_spent_and_refilled() {
        let mut bucket = TokenBucket::NONE;
        bucket.set_refill(Duration::from_secs(900));
        let mut now = Instant::from_millis(1);
        for tokens in [1, 2, 4] {
            for _ in 0..128 / tokens {
                assert!(bucket.has(now, tokens));
                bucket.spend(now, tokens);
            }
            assert!(!bucket.has(now, 1));
            let ready = bucket.ready_at();
            assert!(!bucket.has(Instant::from_micros(ready.as_micros() - 1), 1));
            assert!(bucket.has(ready, 1) && !bucket.has(ready, 2));
            assert_eq!(ready - now, Duration::from_secs(900));
            // Spending from an empty bucket, as for the vehicle's own writes, leaves no debt.
            bucket.spend(now, 4);
            assert_eq!(bucket.ready_at(), ready);
            now += Duration::from_secs(1_000_000_000);
        }
    }

    /// C-15: nothing is limited if no storage is attached.
    #[test]
    fn without_storage_there_is_no_limit() {
        let mut bucket = TokenBucket::NONE;
        for _ in 0..1_000 {
            assert!(bucket.has(Instant::ZERO, 4));
            bucket.spend(Instant::ZERO, 4);
        }
        assert_eq!(bucket.ready_at(), Instant::ZERO);
    }
}
