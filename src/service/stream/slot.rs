//! One stream on one link: its interval and the time until it is due, in 16 bits each.

use core::num::{NonZeroU32, Saturating};

use super::table::Stream;
use crate::time::Instant;
use crate::types::StreamProfile;

/// An interval is stored as a code. Up to this code, it is the interval's whole rate (Hz). Larger codes are four digits and a power
/// of ten. So whole rates and up to four digits are exact. Others are rounded up by less than a thousandth.
const MAX_RATE: u16 = 1_000;
/// The first code with digits.
const FIRST: u32 = 1_001;
/// The smallest digits, and the number of codes of each power.
const DIGITS: u32 = 1_000;
const SPAN: u32 = 12_800;
const POWERS: [u32; 5] = [1, 10, 100, 1_000, 10_000];

/// The code of a stream that is off, and of one with its default interval.
const OFF: u16 = u16::MAX;
const DEFAULT: u16 = 0;

/// The unit in which a stream counts time, so that 16 bits hold an interval and the delay of a radio.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unit {
    /// 64 µs, for intervals of less than two seconds.
    Fine,
    /// 1,024 µs.
    Coarse,
}

impl Unit {
    /// Returns the unit of a stream with this interval (µs).
    pub(super) const fn of(interval: u32) -> Self {
        if interval < 2_000_000 { Self::Fine } else { Self::Coarse }
    }

    /// Returns a time (µs) in units, rounded down.
    pub(super) const fn count(self, micros: u64) -> u64 {
        match self {
            Self::Fine => micros >> 6,
            Self::Coarse => micros >> 10,
        }
    }

    /// Returns the units between two moments. Consecutive calls lose no unit.
    pub(super) fn between(self, from: Instant, to: Instant) -> u16 {
        let units = Saturating(self.count(to.as_micros())) - Saturating(self.count(from.as_micros()));
        u16::try_from(units.0).unwrap_or(u16::MAX)
    }

    /// Returns the moment this many units after another, which is rounded down to whole units.
    pub(super) fn later(self, from: Instant, units: u16) -> Instant {
        let units = (Saturating(self.count(from.as_micros())) + Saturating(u64::from(units))).0;
        Instant::from_micros(match self {
            Self::Fine => units << 6,
            Self::Coarse => units << 10,
        })
    }

    /// Returns this many 256ths of a unit (µs).
    pub(super) fn part(self, parts: u8) -> u32 {
        match self {
            Self::Fine => u32::from(parts) >> 2,
            Self::Coarse => u32::from(parts) << 2,
        }
    }
}

/// One stream on one link.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    /// The code of the interval.
    interval: u16,
    /// The time until it is due, in its [`Unit`], counted down with each sweep. So a pause of any length does no harm.
    left: Saturating<u16>,
}

impl Slot {
    /// The default interval, due at once. All zero bits.
    pub(super) const NEW: Self = Self { interval: DEFAULT, left: Saturating(0) };

    /// The time left when a stream is due. A stream that is late by less than this (100 ms) catches up, one message per poll.
    /// More is dropped; otherwise a burst would follow a stall.
    const DUE: Saturating<u16> = Saturating(1_563);

    /// The time left of a stream that becomes due with the next sweep.
    const FRESH: Saturating<u16> = Saturating(u16::MAX);

    /// Sets the interval of the stream (µs); 0 is its default, `None` stops it. A refresh must follow.
    pub(super) fn set_interval(&mut self, interval: Option<u32>) {
        self.interval = match interval {
            None => OFF,
            Some(0) => DEFAULT,
            Some(interval) => code_of(interval),
        };
        self.left = Self::FRESH;
    }

    /// Returns the interval (µs) of `stream`, to which this slot belongs; `None` if it is off.
    pub(super) fn interval(&self, stream: &Stream, profile: StreamProfile) -> Option<u32> {
        match self.interval {
            DEFAULT => Some(stream.default_interval(profile)).filter(|interval| *interval != 0),
            OFF => None,
            code => Some(interval_of(code)),
        }
    }

    /// Whether it is due in this sweep.
    pub(super) fn is_due(&self) -> bool {
        self.left <= Self::DUE
    }

    /// Returns the units from the last sweep until it is due.
    pub(super) fn ahead(&self) -> u16 {
        if self.left == Self::FRESH { 0 } else { (self.left - Self::DUE).0 }
    }

    /// Counts down at the beginning of a sweep. In the `first` one, every stream is due.
    pub(super) fn count_down(&mut self, elapsed: u16, is_first: bool) {
        self.left = if is_first || self.left == Self::FRESH { Self::DUE } else { self.left - Saturating(elapsed) };
    }

    /// Schedules the next message this many units after this one was due.
    pub(super) fn postpone(&mut self, units: u16) {
        self.left += units;
    }
}

/// Encodes an interval (µs) that is within the bounds.
fn code_of(interval: u32) -> u16 {
    if let Some(rate) = rate_of(interval) {
        return u16::try_from(rate).unwrap_or(MAX_RATE);
    }
    let (mut digits, mut first) = (interval, Saturating(FIRST));
    while digits >= const { DIGITS + SPAN } {
        digits = digits.div_ceil(10);
        first += SPAN;
    }
    u16::try_from((first + Saturating(digits) - Saturating(DIGITS)).0).unwrap_or(OFF)
}

/// Returns the rate (Hz) whose interval is this (µs), if it is whole.
fn rate_of(interval: u32) -> Option<u32> {
    let rate = NonZeroU32::new(1_000_000 / NonZeroU32::new(interval)?)?;
    (1_000_000 / rate == interval).then_some(rate.get())
}

/// Decodes an interval (µs).
fn interval_of(code: u16) -> u32 {
    let code = u32::from(code);
    let Some(code) = code.checked_sub(FIRST) else {
        return NonZeroU32::new(code).map_or(0, |rate| 1_000_000 / rate);
    };
    let power = usize::try_from(code / SPAN).ok().and_then(|power| POWERS.get(power)).copied().unwrap_or(0);
    ((Saturating(code % SPAN) + Saturating(DIGITS)) * Saturating(power)).0
}
