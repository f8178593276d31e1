//! Instants and durations. The stack has no clock: its caller passes the time as an argument.
//!
//! Both count microseconds in a `u64`, which lasts 584,000 years. Only fields on the wire wrap (D-1).

use core::num::NonZeroU32;

use crate::num;

/// Microseconds per millisecond.
const THOUSAND: NonZeroU32 = NonZeroU32::MIN.saturating_add(999);

/// A point in time: microseconds since boot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Instant(u64);

impl Instant {
    /// The time of boot.
    pub const ZERO: Self = Self(0);
    /// The latest instant: a deadline that is never reached.
    pub const NEVER: Self = Self(u64::MAX);

    /// Returns the instant `micros` µs after boot.
    #[inline]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// Returns the instant `millis` ms after boot.
    #[inline]
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

    /// Returns the microseconds since boot.
    #[inline]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Returns the milliseconds since boot, rounded down.
    #[inline]
    pub const fn as_millis(self) -> u64 {
        num::quotient(self.0, THOUSAND)
    }

    /// Returns the milliseconds since boot as messages carry them, in fields such as `time_boot_ms`: they wrap after 49
    /// days (D-1).
    #[inline]
    pub const fn time_boot_ms(self) -> u32 {
        let [a, b, c, d, ..] = self.as_millis().to_le_bytes();
        u32::from_le_bytes([a, b, c, d])
    }

    /// Returns the time in units of 1,024 µs. It wraps after 50 days: compare by wrapping difference. It saves memory
    /// where a comparison may be wrong once in 50 days.
    #[inline]
    pub(crate) const fn coarse(self) -> u32 {
        let [.., b3, b2, b1, b0] = (self.0 >> 10).to_be_bytes();
        u32::from_be_bytes([b3, b2, b1, b0])
    }

    /// Returns the time from `earlier` to `self`; zero if `earlier` is later.
    #[inline(never)]
    pub const fn since(self, earlier: Self) -> Duration {
        Duration(self.0.saturating_sub(earlier.0))
    }

    /// Returns the instant `duration` after `self`, saturating at [`NEVER`](Self::NEVER).
    #[inline(never)]
    #[must_use]
    pub const fn after(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(duration.0))
    }
}

impl Instant {
    /// Returns the instant `duration` before `self`, at least [`ZERO`](Self::ZERO).
    pub(crate) const fn before(self, duration: Duration) -> Self {
        Self(self.0.saturating_sub(duration.0))
    }
}

/// A span of time in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Duration(u64);

impl Duration {
    /// The duration of length zero.
    pub const ZERO: Self = Self(0);
    /// The longest duration.
    pub const MAX: Self = Self(u64::MAX);

    /// Returns a duration of `micros` µs.
    #[inline]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// Returns a duration of `millis` ms.
    #[inline]
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

    /// Returns a duration of `secs` s.
    #[inline]
    pub const fn from_secs(secs: u64) -> Self {
        Self(secs.saturating_mul(1_000_000))
    }

    /// Returns the duration in microseconds.
    #[inline]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Returns the duration in milliseconds, rounded down.
    #[inline]
    pub const fn as_millis(self) -> u64 {
        num::quotient(self.0, THOUSAND)
    }
}

/// A clock that never goes back, made of one that may. If that is set back by a second or more, this one continues from
/// where it was: it is re-anchored. Less is clamped: this one stands still until the other has caught up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Clock {
    /// The latest time.
    last: Instant,
    /// How far it is ahead of the other clock.
    lead: Duration,
}

impl Clock {
    /// A clock that shows the same as the other one, from 0 on.
    pub(crate) const NEW: Self = Self { last: Instant::ZERO, lead: Duration::ZERO };

    /// The least step back that re-anchors the clock.
    const STEP: Duration = Duration::from_secs(1);

    /// Returns the time when the other clock shows `now`.
    pub(crate) const fn peek(&self, now: Instant) -> Instant {
        let time = now.after(self.lead);
        if time.0 > self.last.0 { time } else { self.last }
    }

    /// Advances to the time when the other clock shows `now`. Returns false if that was set back.
    #[inline(always)]
    pub(crate) const fn advance(&mut self, now: Instant) -> bool {
        let time = now.after(self.lead);
        let is_later = time.0 >= self.last.0;
        if is_later {
            self.last = time;
        }
        is_later
    }

    /// Re-anchors the clock if the other one was set back to `now` by a second or more. Returns whether it was.
    pub(crate) const fn anchor(&mut self, now: Instant) -> bool {
        let lead = self.last.since(now);
        let is_step = lead.0.wrapping_sub(self.lead.0) >= Self::STEP.0;
        if is_step {
            self.lead = lead;
        }
        is_step
    }

    /// Advances, and re-anchors the clock if that is needed.
    pub(crate) const fn follow(&mut self, now: Instant) {
        if !self.advance(now) {
            self.anchor(now);
        }
    }

    /// Returns the latest time.
    pub(crate) const fn now(&self) -> Instant {
        self.last
    }

    /// Returns how far it is ahead of the other clock.
    pub(crate) const fn lead(&self) -> Duration {
        self.lead
    }

    /// Returns what the other clock shows at `time`.
    pub(crate) const fn shown(&self, time: Instant) -> Instant {
        if time.0 == Instant::NEVER.0 { time } else { time.before(self.lead) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// a step back of a second or more re-anchors the clock, once; less is clamped.
    #[test]
    fn clock_never_goes_back() {
        let at = Instant::from_millis;
        let mut clock = Clock::NEW;
        for (other, time, is_step) in [
            (5_000, 5_000, false),
            (4_001, 5_000, false),
            (5_001, 5_001, false),
            (4_001, 5_001, true),
            (4_002, 5_002, false),
            (3_003, 5_002, false),
            (0, 5_002, true),
            (10, 5_012, false),
        ] {
            let peeked = clock.peek(at(other));
            let is_anchored = !clock.advance(at(other)) && clock.anchor(at(other));
            assert_eq!((is_anchored, clock.now()), (is_step, at(time)), "{other} ms");
            assert!(peeked == at(time));
        }
        assert_eq!((clock.shown(at(5_013)), clock.lead()), (at(11), Duration::from_millis(5_002)));
    }

    #[test]
    fn arithmetic_saturates_at_both_ends() {
        let now = Instant::from_millis(5);
        assert_eq!(now.since(Instant::from_millis(2)), Duration::from_micros(3_000));
        assert_eq!(now.since(Instant::from_millis(9)), Duration::ZERO);
        assert_eq!(Instant::NEVER.after(Duration::from_secs(1)), Instant::NEVER);
    }
}
