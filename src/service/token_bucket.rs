//! A token bucket that limits the storage writes that peers cause (C-15).
//!
//! Flash endures some 10,000 erases of a unit. A peer on an open link can request writes at line rate, so the writes that peers
//! cause are rate-limited. A write of the parameters, of the key, or of a plan of up to a quarter of plan memory takes one token;
//! a larger plan takes up to four. [`Config::storage_refill`](crate::Config::storage_refill) has the arithmetic.

use crate::time::{Duration, Instant};

/// Number of tokens in a full bucket: enough for 32 of the largest plans.
const CAPACITY: u64 = 128;

/// The bucket of one kind of content. It stores when it will be full again instead of a number of tokens, so that refilling needs no
/// arithmetic.
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
