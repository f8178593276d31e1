//! Estimates a peer's clock from TIMESYNC.
//!
//! A filter for <https://mavlink.io/en/services/timesync.html>, rule T-3. The error of a single [`TimeSample`] is up to
//! half of its round trip, and a radio's round trip is long. So the filter drops samples whose round trip was too long,
//! and fits a line to the others: offset and drift. When the clock jumps, for example because the peer restarts, the
//! filter follows at once. The stack itself does not use it: a vehicle that needs a peer's time keeps a filter for that
//! peer. It uses integers only.

use core::num::{Saturating, Wrapping};

use super::TimeSample;
use crate::time::{Duration, Instant};

/// The number of samples that the line is fitted to: all at first, later the most recent ones, older ones with less
/// weight.
const MEMORY: u8 = 64;

/// The number of samples after which the drift is known.
const SETTLED: u8 = 8;

/// The number of consecutive outliers that are taken for a jump of the clock.
const JUMP: u8 = 3;

/// The maximum drift between two clocks (ns/s): that of two quartz crystals, and a margin.
const MAX_DRIFT: i64 = 500_000;

/// The minimum gap between samples, as the filter counts it (µs). Otherwise noise would look like drift.
const MIN_GAP: u64 = 50_000;

/// The longest usable round trip (ns).
const MAX_ROUND_TRIP: u64 = 60_000_000_000;

/// Estimates one peer's clock from the [`TimeSample`]s that it is given (T-3).
///
/// ```
/// use mavstack::clock::ClockFilter;
/// use mavstack::{Address, Duration, Instant, LinkId, Peer, StackOf};
/// # use mavstack::{Command, Commands, Config, Context, LinkConfig, Outcome, Pulse, Vehicle, VehicleState};
///
/// #[derive(mavstack::Stack)]
/// #[stack(vehicle: Rover, links: 1)]
/// struct Mavlink {
///     time: mavstack::clock::Time,
/// }
///
/// const CAMERA: Peer = Peer { address: Address::new(1, 100), link: LinkId(0) };
///
/// struct Rover { camera: ClockFilter }
///
/// impl Rover {
///     /// The camera is on a wire, so an answer that takes longer than 10 ms is left out.
///     const fn new() -> Self {
///         Self { camera: ClockFilter::new(Duration::from_millis(10)) }
///     }
///
///     /// Called once a second by the loop.
///     fn compare_clocks(&mut self, stack: &mut StackOf<Mavlink>) {
///         if let Some(sample) = stack.time.take_sample().filter(|sample| sample.from == CAMERA) {
///             self.camera.add(&sample);
///         }
///         stack.time.ask(CAMERA.link);
///     }
///
///     /// Converts the time of a picture to our clock.
///     fn on_picture(&self, time_usec: u64) -> Option<Instant> {
///         self.camera.to_ours(time_usec)
///     }
/// }
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
/// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
/// #     }
/// # }
/// # static PULSE: Pulse = Pulse::new();
/// # let mut rover = Rover::new();
/// # rover.compare_clocks(&mut StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600)]));
/// # assert_eq!(rover.on_picture(5), None);
/// ```
#[derive(Clone, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ClockFilter {
    /// The longest round trip of a usable sample (ns).
    max_round_trip: u64,
    /// The number of samples that the line is fitted to, at most [`MEMORY`].
    count: u8,
    /// Consecutive samples that were too far from the line.
    outliers: u8,
    /// The moment at which the line begins.
    at: Instant,
    /// How far the peer's clock is ahead of ours at that moment (ns).
    offset: i64,
    /// How much this grows in a second (ns).
    drift: i64,
}

impl ClockFilter {
    /// Returns a filter without samples. It drops samples whose round trip is longer than this, or longer than a
    /// minute. A shorter limit gives a better estimate, as long as most samples keep to it: 10 ms for a companion
    /// computer on a wire, a few hundred for a radio.
    pub const fn new(max_round_trip: Duration) -> Self {
        let nanos = max_round_trip.as_micros().saturating_mul(1_000);
        let max_round_trip = if nanos < MAX_ROUND_TRIP { nanos } else { MAX_ROUND_TRIP };
        Self { max_round_trip, count: 0, outliers: 0, at: Instant::ZERO, offset: 0, drift: 0 }
    }

    /// Adds a sample of the filter's peer, newer than those before. Returns false if it is dropped: its round trip was
    /// too long, or it differs from the line by more than any delay explains. The third such outlier in a row restarts
    /// the filter.
    pub fn add(&mut self, sample: &TimeSample) -> bool {
        if u64::try_from(sample.round_trip_ns).map_or(true, |nanos| nanos > self.max_round_trip) {
            return false;
        }
        let Some(expected) = self.offset_ns(sample.at) else {
            self.begin(sample);
            return true;
        };
        let gap = (sample.at - self.at).as_micros();
        let error = Saturating((Wrapping(sample.offset_ns) - Wrapping(expected)).0);
        // Half of both round trips, and the drift of two clocks.
        if error.0.unsigned_abs() > self.max_round_trip.saturating_add(gap) {
            self.outliers = self.outliers.saturating_add(1);
            if self.outliers < JUMP {
                return false;
            }
            self.begin(sample);
            return true;
        }
        self.outliers = 0;
        self.count = self.count.saturating_add(1).min(MEMORY);
        // The gains of a least-squares line through this many samples.
        let count = Saturating(i64::from(self.count));
        let weight = count * (count + Saturating(1));
        let gap = Saturating(i64::try_from(gap.max(MIN_GAP)).unwrap_or(i64::MAX));
        let step = quotient(error * (count * Saturating(4) - Saturating(2)), weight);
        let turn = quotient(error * Saturating(6_000_000), weight * gap);
        self.at = sample.at;
        self.offset = (Wrapping(expected) + Wrapping(step.0)).0;
        self.drift = (Saturating(self.drift) + turn).0.clamp(-MAX_DRIFT, MAX_DRIFT);
        true
    }

    fn begin(&mut self, sample: &TimeSample) {
        self.count = 1;
        self.outliers = 0;
        self.at = sample.at;
        self.offset = sample.offset_ns;
        self.drift = 0;
    }

    /// Returns how far the peer's clock is ahead of ours at `now` (ns), negative if it is behind; `None` before the
    /// first sample.
    pub fn offset_ns(&self, now: Instant) -> Option<i64> {
        if self.count == 0 {
            return None;
        }
        // `now` may be before or after the last sample.
        let micros = |span: Duration| Saturating(i64::try_from(span.as_micros()).unwrap_or(i64::MAX));
        let span = micros(now - self.at) - micros(self.at - now);
        let change = (Saturating(self.drift) * span).0 / 1_000_000;
        Some((Wrapping(self.offset) + Wrapping(change)).0)
    }

    /// Converts a time of the peer's clock (µs), such as the `time_usec` of many messages, to ours. Returns `None`
    /// before the first sample, and for a time before our boot.
    pub fn to_ours(&self, their_micros: u64) -> Option<Instant> {
        let by =
            |offset: i64| their_micros.checked_add_signed((offset / 1_000).checked_neg()?).map(Instant::from_micros);
        // First an estimate, then the offset at that moment.
        by(self.offset_ns(by(self.offset_ns(self.at)?)?)?)
    }

    /// Whether enough samples were added, since the start or the last jump, for the drift to be known.
    pub const fn is_settled(&self) -> bool {
        self.count >= SETTLED
    }
}

/// Returns a quotient; zero if the divisor is zero.
fn quotient(dividend: Saturating<i64>, divisor: Saturating<i64>) -> Saturating<i64> {
    Saturating(dividend.0.checked_div(divisor.0).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Address;
    use crate::types::{LinkId, Peer};
    use proptest::prelude::*;

    const LIMIT: Duration = Duration::from_millis(20);

    fn sample(at: u64, offset_ns: i64, round_trip_ns: i64) -> TimeSample {
        let from = Peer { address: Address::new(1, 100), link: LinkId(0) };
        TimeSample { from, at: Instant::from_micros(at), offset_ns, round_trip_ns }
    }

    /// T-3
    #[test]
    fn long_round_trips_are_dropped() {
        let mut filter = ClockFilter::new(LIMIT);
        for round_trip in [20_000_001, i64::MAX, -1, i64::MIN] {
            assert!(!filter.add(&sample(0, 5, round_trip)));
        }
        assert_eq!((filter.offset_ns(Instant::ZERO), filter.to_ours(7)), (None, None));
        assert!(filter.add(&sample(0, 5, 20_000_000)));
        assert_eq!(filter.offset_ns(Instant::from_millis(99_000)), Some(5));
        assert!(!filter.is_settled());
    }

    /// T-3: whatever the limit, a round trip of more than a minute is dropped.
    #[test]
    fn a_round_trip_of_more_than_a_minute_is_dropped() {
        for limit in [Duration::from_secs(60), Duration::from_secs(61), Duration::MAX] {
            let mut filter = ClockFilter::new(limit);
            assert!(!filter.add(&sample(0, 5, 60_000_000_001)));
            assert!(filter.add(&sample(0, 5, 60_000_000_000)));
        }
    }

    /// T-3: two outliers are dropped; three are a jump of the clock.
    #[test]
    fn a_jump_is_followed_and_an_outlier_is_not() {
        let mut filter = ClockFilter::new(LIMIT);
        for second in 0..20 {
            assert!(filter.add(&sample(second * 1_000_000, 1_000_000, 1_000)));
        }
        assert!(filter.is_settled());
        for far in [i64::MIN, -3_000_000_000, i64::MAX] {
            assert!(!filter.add(&sample(20_000_000, far, 1_000)));
            assert!(!filter.add(&sample(20_100_000, far, 1_000)));
            assert!(filter.add(&sample(20_200_000, 1_000_000, 1_000)), "back on the line");
            assert_eq!(filter.offset_ns(Instant::from_micros(20_200_000)), Some(1_000_000));
            // A long round trip in between does not count either way.
            assert!(!filter.add(&sample(21_000_000, far, 1_000)));
            assert!(!filter.add(&sample(21_500_000, 1_000_000, i64::MAX)));
            assert!(!filter.add(&sample(22_000_000, far, 1_000)));
            assert!(filter.add(&sample(23_000_000, far, 1_000)));
            assert_eq!(filter.offset_ns(Instant::from_millis(23_000)), Some(far));
            assert!(!filter.is_settled());
            filter = ClockFilter::new(LIMIT);
            filter.add(&sample(0, 1_000_000, 1_000));
        }
    }

    #[test]
    fn the_peers_time_is_converted_to_ours() {
        let mut filter = ClockFilter::new(LIMIT);
        // Three seconds behind, and slower by 100 ppm.
        let offset = |micros: u64| -3_000_000_000 - micros as i64 / 10;
        for second in 10..100 {
            filter.add(&sample(second * 1_000_000, offset(second * 1_000_000), 1_000));
        }
        for ours in [5_000_000u64, 50_000_000, 99_000_000, 140_000_000] {
            let theirs = ours.checked_add_signed(offset(ours) / 1_000).unwrap();
            assert!(filter.to_ours(theirs).unwrap().as_micros().abs_diff(ours) <= 2, "{ours}");
        }
        assert_eq!(filter.to_ours(u64::MAX), None);
        let mut ahead = ClockFilter::new(LIMIT);
        ahead.add(&sample(0, 3_000_000_000, 1_000));
        assert_eq!(ahead.to_ours(2_999_999), None, "before our boot");
        assert_eq!(ahead.to_ours(3_000_001), Some(Instant::from_micros(1)));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        /// T-3: a drifting clock that jumps once, over a line with any delays, some far too long. Once the filter has
        /// settled, the error is at most a third of the worst accepted sample's, and much less on average. Three
        /// samples after the jump it follows again.
        #[test]
        fn a_drifting_clock_is_followed(
            seed: u64,
            start in 0u64..1 << 45,
            offset in any::<i32>(),
            ppm in -150i64..150,
            jitter_us in 1u64..8_000,
            period_us in 200_000u64..3_000_000,
            jump_ms in prop_oneof![-100_000i64..-100, 100i64..100_000],
        ) {
            let mut state = seed;
            let mut random = |below: u64| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) % below
            };
            let mut filter = ClockFilter::new(LIMIT);
            let mut jump = 0;
            let truth = |at: u64, jump: i64| i64::from(offset) * 1_000_000 + (at - start) as i64 * ppm / 1_000 + jump;
            let (mut at, mut taken, mut errors) = (start, start, std::vec::Vec::new());
            for round in 0..400 {
                at += period_us / 2 + random(period_us);
                if round == 200 {
                    jump = jump_ms * 1_000_000;
                }
                // 500 µs each way, plus jitter, plus an occasional long delay.
                let late = if random(10) == 0 { 30_000 + random(1 << 20) } else { 0 };
                let (up, down) = (500 + random(jitter_us) + late, 500 + random(jitter_us));
                let measured = truth(at, jump) + (up as i64 - down as i64) * 500;
                let is_taken = filter.add(&sample(at, measured, (up + down) as i64 * 1_000));
                prop_assert!(late == 0 || !is_taken);
                let gap = at - taken;
                if is_taken {
                    taken = at;
                }
                if let Some(estimate) = filter.offset_ns(Instant::from_micros(at)) {
                    let error = (estimate - truth(at, jump)).unsigned_abs();
                    let is_jump = (200..210).contains(&round);
                    // Plus the drift since the last accepted sample, or an apparent drift before the filter has
                    // settled.
                    let unknown = if filter.is_settled() { 2_000_000 } else { gap * 650 + jitter_us * 1_000 };
                    prop_assert!(is_jump || error <= jitter_us * 1_000 + unknown, "round {round}: {error} ns");
                    if (100..200).contains(&round) || round >= 300 {
                        prop_assert!(filter.is_settled());
                        prop_assert!(error <= jitter_us * 333 + 20_000, "round {round}: {error} ns");
                        errors.push(error);
                    }
                }
            }
            // The samples' own mean error is a sixth of the jitter.
            let mean = errors.iter().sum::<u64>() / errors.len() as u64;
            prop_assert!(mean <= jitter_us * 120 + 5_000, "{mean} ns, jitter {jitter_us} µs");
        }
    }
}
