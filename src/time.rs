//! Instants and durations. The stack has no clock: its caller passes the time as an argument.
//!
//! Both count microseconds in a `u64`, which lasts 584,000 years. Only fields on the wire wrap (D-1). Their operators saturate:
//! an instant never lies before boot, and a time that would be negative is zero.
//!
//! | from | to | feature |
//! |---|---|---|
//! | `core::time::Duration` | [`Duration`], and back | |
//! | `fugit`'s instants and durations, of any rate | [`Instant`], [`Duration`] | `fugit` |
//! | `embassy_time`'s `Instant` and `Duration` | [`Instant`], [`Duration`], and back | `embassy-time` |
//!
//! ```
//! use mavstack::{Duration, Instant};
//!
//! let boot = Instant::ZERO;
//! let now = boot + Duration::from_millis(1_500);
//! assert_eq!(now - boot, Duration::from_millis(1_500));
//! assert_eq!(boot - now, Duration::ZERO);
//! assert_eq!(Duration::from(std::time::Duration::from_millis(3)) * 2, Duration::from_millis(6));
//! ```

use core::num::NonZeroU32;
use core::ops::{Add, AddAssign, Mul, Sub};

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

    /// [`self + duration`](Add) in a constant.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) const fn saturating_add(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(duration.0))
    }

    /// [`self - earlier`](Sub) in a constant.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) const fn saturating_since(self, earlier: Self) -> Duration {
        Duration(self.0.saturating_sub(earlier.0))
    }
}

/// The instant `duration` later, at most [`NEVER`](Instant::NEVER).
impl Add<Duration> for Instant {
    type Output = Self;

    #[inline]
    fn add(self, duration: Duration) -> Self {
        self.saturating_add(duration)
    }
}

/// The instant `duration` earlier, at least [`ZERO`](Instant::ZERO).
impl Sub<Duration> for Instant {
    type Output = Self;

    #[inline]
    fn sub(self, duration: Duration) -> Self {
        Self(self.0.saturating_sub(duration.0))
    }
}

/// The time from `earlier` to `self`; zero if `earlier` is later.
impl Sub for Instant {
    type Output = Duration;

    #[inline]
    fn sub(self, earlier: Self) -> Duration {
        self.saturating_since(earlier)
    }
}

impl AddAssign<Duration> for Instant {
    #[inline]
    fn add_assign(&mut self, duration: Duration) {
        *self = *self + duration;
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

/// The sum, at most [`MAX`](Duration::MAX).
impl Add for Duration {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

/// The difference, at least [`ZERO`](Duration::ZERO).
impl Sub for Duration {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

/// The product, at most [`MAX`](Duration::MAX).
impl Mul<u32> for Duration {
    type Output = Self;

    #[inline]
    fn mul(self, factor: u32) -> Self {
        Self(self.0.saturating_mul(u64::from(factor)))
    }
}

impl AddAssign for Duration {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

/// Rounded down to microseconds, at most [`MAX`](Duration::MAX).
impl From<core::time::Duration> for Duration {
    #[inline]
    fn from(duration: core::time::Duration) -> Self {
        Self::from_secs(duration.as_secs()) + Self::from_micros(u64::from(duration.subsec_micros()))
    }
}

impl From<Duration> for core::time::Duration {
    #[inline]
    fn from(duration: Duration) -> Self {
        Self::from_micros(duration.0)
    }
}

/// The time since boot, in microseconds, rounded down. A timer of 32 bits wraps within hours: extend it to 64 bits first.
#[cfg(feature = "fugit")]
impl<const NOM: u32, const DENOM: u32> From<fugit::Instant<u64, NOM, DENOM>> for Instant {
    #[inline]
    fn from(instant: fugit::Instant<u64, NOM, DENOM>) -> Self {
        Self::ZERO + Duration::from(instant.duration_since_epoch())
    }
}

/// Rounded down to microseconds; [`MAX`](Duration::MAX) if they do not fit.
#[cfg(feature = "fugit")]
impl<const NOM: u32, const DENOM: u32> From<fugit::Duration<u64, NOM, DENOM>> for Duration {
    #[inline]
    fn from(duration: fugit::Duration<u64, NOM, DENOM>) -> Self {
        duration.const_try_into::<1, 1_000_000>().map_or(Self::MAX, |micros| Self::from_micros(micros.ticks()))
    }
}

/// Rounded down to microseconds.
#[cfg(feature = "fugit")]
impl<const NOM: u32, const DENOM: u32> From<fugit::Duration<u32, NOM, DENOM>> for Duration {
    #[inline]
    fn from(duration: fugit::Duration<u32, NOM, DENOM>) -> Self {
        fugit::Duration::<u64, NOM, DENOM>::from(duration).into()
    }
}

/// The most microseconds that are converted for Embassy, whose conversions add before they divide.
#[cfg(feature = "embassy-time")]
const MAX_EMBASSY: u64 = u64::MAX >> 1;

#[cfg(feature = "embassy-time")]
impl From<embassy_time::Instant> for Instant {
    #[inline]
    fn from(instant: embassy_time::Instant) -> Self {
        Self::from_micros(instant.as_micros())
    }
}

/// At most `embassy_time::Instant::MAX`, so a timer until [`NEVER`](Instant::NEVER) does not end.
#[cfg(feature = "embassy-time")]
impl From<Instant> for embassy_time::Instant {
    #[inline]
    fn from(instant: Instant) -> Self {
        Some(instant.as_micros())
            .filter(|micros| *micros <= MAX_EMBASSY)
            .and_then(Self::try_from_micros)
            .unwrap_or(Self::MAX)
    }
}

#[cfg(feature = "embassy-time")]
impl From<embassy_time::Duration> for Duration {
    #[inline]
    fn from(duration: embassy_time::Duration) -> Self {
        Self::from_micros(duration.as_micros())
    }
}

/// At most `embassy_time::Duration::MAX`.
#[cfg(feature = "embassy-time")]
impl From<Duration> for embassy_time::Duration {
    #[inline]
    fn from(duration: Duration) -> Self {
        Some(duration.as_micros())
            .filter(|micros| *micros <= MAX_EMBASSY)
            .and_then(Self::try_from_micros)
            .unwrap_or(Self::MAX)
    }
}

/// A clock that never goes back, made of one that may (X-7). If that is set back by a second or more, this one continues from
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
        let time = now.saturating_add(self.lead);
        if time.0 > self.last.0 { time } else { self.last }
    }

    /// Advances to the time when the other clock shows `now`. Returns false if that was set back.
    #[inline(always)]
    pub(crate) const fn advance(&mut self, now: Instant) -> bool {
        let time = now.saturating_add(self.lead);
        let is_later = time.0 >= self.last.0;
        if is_later {
            self.last = time;
        }
        is_later
    }

    /// Re-anchors the clock if the other one was set back to `now` by a second or more. Returns whether it was.
    pub(crate) const fn anchor(&mut self, now: Instant) -> bool {
        let lead = self.last.saturating_since(now);
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

    /// Returns the time of the other clock at `time`.
    pub(crate) const fn shown(&self, time: Instant) -> Instant {
        if time.0 == Instant::NEVER.0 { time } else { Instant(time.0.saturating_sub(self.lead.0)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// X-7: a step back of a second or more re-anchors the clock, once; less is clamped.
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
        assert_eq!(now - Instant::from_millis(2), Duration::from_micros(3_000));
        assert_eq!(now - Instant::from_millis(9), Duration::ZERO);
        assert_eq!(now - Duration::from_millis(2), Instant::from_millis(3));
        assert_eq!(now - Duration::from_millis(9), Instant::ZERO);
        assert_eq!(Instant::NEVER + Duration::from_secs(1), Instant::NEVER);
        assert_eq!(Duration::MAX + Duration::from_secs(1), Duration::MAX);
        assert_eq!(Duration::from_secs(1) - Duration::MAX, Duration::ZERO);
        assert_eq!(Duration::MAX * 2, Duration::MAX);
        let mut later = now;
        later += Duration::from_millis(1);
        assert_eq!(later, Instant::from_millis(6));
    }

    #[test]
    fn durations_convert_from_and_to_core() {
        let core = core::time::Duration::new(2, 500_999);
        assert_eq!(Duration::from(core), Duration::from_micros(2_000_500));
        assert_eq!(core::time::Duration::from(Duration::from_micros(2_000_500)), core::time::Duration::new(2, 500_000));
        assert_eq!(Duration::from(core::time::Duration::MAX), Duration::MAX);
        assert_eq!(Duration::from(core::time::Duration::from(Duration::MAX)), Duration::MAX);
    }

    #[test]
    #[cfg(feature = "fugit")]
    fn times_convert_from_fugit() {
        // A timer at 32,768 Hz, and one at 84 MHz.
        let slow = fugit::Instant::<u64, 1, 32_768>::from_ticks(32_768 * 86_400 + 1);
        assert_eq!(Instant::from(slow), Instant::from_micros(86_400_000_030));
        let fast = fugit::Duration::<u32, 1, 84_000_000>::from_ticks(u32::MAX);
        assert_eq!(Duration::from(fast), Duration::from_micros(51_130_563));
        assert_eq!(Duration::from(fugit::Duration::<u64, 60, 1>::from_ticks(u64::MAX)), Duration::MAX);
    }

    #[test]
    #[cfg(feature = "embassy-time")]
    fn times_convert_from_and_to_embassy() {
        let at = Instant::from_micros(1_234_567);
        assert_eq!(Instant::from(embassy_time::Instant::from(at)), at);
        let pause = Duration::from_millis(250);
        assert_eq!(Duration::from(embassy_time::Duration::from(pause)), pause);
        assert_eq!(embassy_time::Instant::from(Instant::NEVER), embassy_time::Instant::MAX);
        assert_eq!(embassy_time::Duration::from(Duration::MAX), embassy_time::Duration::MAX);
    }
}
