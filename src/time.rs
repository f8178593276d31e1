//! Time as the stack sees it: an argument, never a clock.
//!
//! Microseconds since boot in a `u64`, which lasts 584,000 years; only fields on the wire wrap (D-1).

use core::num::NonZeroU32;

use crate::num;

/// Microseconds of a millisecond.
const THOUSAND: NonZeroU32 = NonZeroU32::MIN.saturating_add(999);

/// A moment: microseconds since boot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Instant(u64);

impl Instant {
    /// The moment of boot.
    pub const ZERO: Self = Self(0);
    /// Later than any other: the deadline of what has none.
    pub const NEVER: Self = Self(u64::MAX);

    /// `micros` µs after boot.
    #[inline]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// `millis` ms after boot.
    #[inline]
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

    /// Microseconds since boot.
    #[inline]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Milliseconds since boot, rounded down.
    #[inline]
    pub const fn as_millis(self) -> u64 {
        num::quotient(self.0, THOUSAND)
    }

    /// The time in units of 1,024 µs, for what is kept once a link and may be wrong once in 50 days, when this wraps: compare by
    /// difference.
    #[inline]
    pub(crate) const fn ticks(self) -> u32 {
        let [.., b3, b2, b1, b0] = (self.0 >> 10).to_be_bytes();
        u32::from_be_bytes([b3, b2, b1, b0])
    }

    /// How long ago `earlier` was; zero when it is in the future.
    #[inline(never)]
    pub const fn since(self, earlier: Self) -> Duration {
        Duration(self.0.saturating_sub(earlier.0))
    }

    /// `duration` later.
    #[inline(never)]
    #[must_use]
    pub const fn after(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(duration.0))
    }
}

/// A span of time in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Duration(u64);

impl Duration {
    /// No time.
    pub const ZERO: Self = Self(0);
    /// Longer than any other.
    pub const MAX: Self = Self(u64::MAX);

    /// `micros` µs.
    #[inline]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// `millis` ms.
    #[inline]
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

    /// `secs` s.
    #[inline]
    pub const fn from_secs(secs: u64) -> Self {
        Self(secs.saturating_mul(1_000_000))
    }

    /// Microseconds.
    #[inline]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Milliseconds, rounded down.
    #[inline]
    pub const fn as_millis(self) -> u64 {
        num::quotient(self.0, THOUSAND)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arithmetic_saturates_at_both_ends() {
        let now = Instant::from_millis(5);
        assert_eq!(now.since(Instant::from_millis(2)), Duration::from_micros(3_000));
        assert_eq!(now.since(Instant::from_millis(9)), Duration::ZERO);
        assert_eq!(Instant::NEVER.after(Duration::from_secs(1)), Instant::NEVER);
    }
}
