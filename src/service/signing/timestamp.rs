//! Timestamps of signatures, and times that run with the stack's clock (G-3).

use core::num::NonZeroU32;

use crate::frame::MAX_TIMESTAMP;
use crate::num;
use crate::time::{Duration, Instant};

/// Unix time of timestamp 0 (s): the beginning of 2015.
pub(super) const EPOCH: u64 = 1_420_070_400;

/// A minute in units of 10 µs.
pub(super) const MINUTE: u64 = 6_000_000;

/// Microseconds in a unit of a timestamp.
const UNIT: NonZeroU32 = NonZeroU32::MIN.saturating_add(9);

/// A timestamp: units of 10 µs since the beginning of 2015. A signature holds 48 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Timestamp(pub(super) u64);

impl Timestamp {
    pub(super) const ZERO: Self = Self(0);

    /// The last one that a signature can hold, in 2104. It has no successor, so it is never accepted.
    pub(super) const LAST: Self = Self(MAX_TIMESTAMP);

    /// Returns the timestamp of a Unix time (µs); zero before 2015.
    pub(super) const fn from_unix(micros: u64) -> Self {
        Self(num::quotient(micros.saturating_sub(const { EPOCH * 1_000_000 }), UNIT))
    }

    /// Returns the time since `earlier`; zero if that is later.
    pub(super) const fn since(self, earlier: Self) -> Duration {
        Duration::from_micros(self.0.saturating_sub(earlier.0).wrapping_mul(10))
    }

    pub(super) const fn next(self) -> Self {
        Self(self.0.saturating_add(1))
    }

    #[cfg(feature = "storage")]
    pub(super) const fn minute_later(self) -> Self {
        Self(self.0.saturating_add(MINUTE))
    }

    pub(super) const fn minute_earlier(self) -> Self {
        Self(self.0.saturating_sub(MINUTE))
    }
}

/// A time that runs with the stack's clock. The later of two is later at any moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RunningTime {
    /// The timestamp at boot; negative if that was before 2015.
    at_boot: i64,
}

impl RunningTime {
    /// Starts at 2015 at boot.
    pub(super) const NEW: Self = Self { at_boot: 0 };

    /// Returns the time that is `timestamp` at `now`. All timestamps after the last one count as the same.
    pub(super) fn new(now: Instant, timestamp: Timestamp) -> Self {
        let timestamp = timestamp.min(Timestamp::LAST.next()).0.cast_signed();
        Self { at_boot: timestamp.saturating_sub(units(now).cast_signed()) }
    }

    /// Returns the timestamp at `now`.
    pub(super) const fn at(self, now: Instant) -> Timestamp {
        Timestamp(units(now).saturating_add_signed(self.at_boot))
    }
}

/// Returns the units since boot.
const fn units(now: Instant) -> u64 {
    num::quotient(now.as_micros(), UNIT)
}
