//! The samples between two messages, summarised (L-21): the mean of values that vary, the extreme of values that must
//! not be missed.

use super::HighLatencySample;
use super::sample::AVERAGED;
use crate::time::Instant;

/// The mean of the known values of any number of samples.
#[derive(Clone, Copy, Debug)]
struct Mean {
    mean: f32,
    /// It stops at 2^24; older samples then fade.
    count: f32,
}

impl Mean {
    const NONE: Self = Self { mean: 0.0, count: 0.0 };

    /// Adds a value, clamped to the range of the message: one insane value must not hide all others.
    fn add(&mut self, value: f32, min: f32, max: f32) {
        if value.is_nan() {
            return;
        }
        let clamped = if value > max { max } else { value.max(min) };
        self.count += 1.0;
        self.mean += (clamped - self.mean) / self.count;
    }
}

/// All samples since `begun`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) begun: Instant,
    /// The means of the [averaged](HighLatencySample::averaged) values.
    means: [Mean; AVERAGED.len()],
    /// The largest; NaN if there was none.
    eph: f32,
    epv: f32,
    /// The value of the largest magnitude.
    climb_rate: f32,
}

impl Window {
    /// All zero bits.
    pub(super) const VACANT: Self = Self { eph: 0.0, epv: 0.0, climb_rate: 0.0, ..Self::new(Instant::ZERO) };

    pub(super) const fn new(begun: Instant) -> Self {
        let means = [Mean::NONE; AVERAGED.len()];
        Self { begun, means, eph: f32::NAN, epv: f32::NAN, climb_rate: f32::NAN }
    }

    pub(super) fn add(&mut self, sample: &HighLatencySample) {
        // `max` ignores a NaN.
        self.eph = self.eph.max(sample.eph);
        self.epv = self.epv.max(sample.epv);
        if self.climb_rate.is_nan() || sample.climb_rate.abs() > self.climb_rate.abs() {
            self.climb_rate = sample.climb_rate;
        }
        for ((mean, value), (min, max)) in self.means.iter_mut().zip(&sample.averaged()).zip(&AVERAGED) {
            mean.add(*value, *min, *max);
        }
    }

    /// Returns `last`, the newest sample, with the window's means and extremes where it has any.
    pub(super) fn summary(&self, last: &HighLatencySample) -> HighLatencySample {
        let mut summary = *last;
        summary.eph = self.eph.max(last.eph);
        summary.epv = self.epv.max(last.epv);
        if !self.climb_rate.is_nan() {
            summary.climb_rate = self.climb_rate;
        }
        let mut averaged = last.averaged();
        for (value, mean) in averaged.iter_mut().zip(&self.means) {
            if mean.count > 0.0 {
                *value = mean.mean;
            }
        }
        summary.set_averaged(averaged);
        summary
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NAN: f32 = f32::NAN;

    fn sample(value: f32) -> HighLatencySample {
        HighLatencySample {
            airspeed: value,
            throttle: value,
            battery: value,
            temperature_air: value,
            eph: value,
            epv: value,
            climb_rate: value,
            ..HighLatencySample::UNKNOWN
        }
    }

    fn summary(values: &[f32]) -> HighLatencySample {
        let mut window = Window::new(Instant::ZERO);
        values.iter().for_each(|value| window.add(&sample(*value)));
        window.summary(&values.last().map_or(HighLatencySample::UNKNOWN, |last| sample(*last)))
    }

    #[test]
    fn unknown_values_are_ignored() {
        // L-21, L-22
        let result = summary(&[NAN, 2.0, NAN, -4.0, NAN]);
        assert_eq!((result.airspeed, result.temperature_air), (1.0, -1.0), "the speed below 0 is 0");
        assert_eq!((result.eph, result.epv, result.climb_rate), (2.0, 2.0, -4.0));
        let result = summary(&[NAN, NAN]);
        assert!(
            [result.airspeed, result.battery, result.eph, result.epv, result.climb_rate]
                .iter()
                .all(|value| value.is_nan())
        );
    }

    #[test]
    fn an_empty_window_reports_the_last_sample() {
        let result = Window::new(Instant::ZERO).summary(&sample(3.0));
        assert_eq!((result.airspeed, result.throttle, result.eph, result.climb_rate), (3.0, 3.0, 3.0, 3.0));
    }

    #[test]
    fn one_insane_value_does_not_hide_the_others() {
        let mut values = [10.0; 100];
        values[50] = f32::INFINITY;
        let result = summary(&values);
        assert!((result.airspeed - 10.41).abs() < 1e-3, "{}", result.airspeed);
        assert!((result.throttle - 10.9).abs() < 1e-3, "{}", result.throttle);
        assert_eq!(
            (result.eph, result.climb_rate),
            (f32::INFINITY, f32::INFINITY),
            "the extreme is reported unchanged"
        );
    }

    proptest! {
        #[test]
        fn the_summary_matches_the_samples(values in prop::collection::vec(-40.0f32..40.0, 1..500)) {
            let result = summary(&values);
            let mean = |min: f64| values.iter().map(|v| f64::from(*v).max(min)).sum::<f64>() / values.len() as f64;
            prop_assert!((f64::from(result.airspeed) - mean(0.0)).abs() < 1e-3);
            prop_assert!((f64::from(result.temperature_air) - mean(-127.0)).abs() < 1e-3);
            prop_assert_eq!(result.eph, values.iter().copied().fold(f32::MIN, f32::max));
            let steepest = values.iter().map(|v| v.abs()).fold(0.0, f32::max);
            prop_assert_eq!(result.climb_rate.abs(), steepest);
            prop_assert!(values.contains(&result.climb_rate));
        }

        #[test]
        fn any_bits_leave_the_means_within_range(bits in prop::collection::vec(any::<u32>(), 1..50)) {
            let values: std::vec::Vec<f32> = bits.into_iter().map(f32::from_bits).collect();
            let result = summary(&values);
            if values.iter().any(|value| !value.is_nan()) {
                prop_assert!((0.0..=51.0).contains(&result.airspeed));
                prop_assert!((0.0..=100.0).contains(&result.throttle));
                prop_assert!((-127.0..=127.0).contains(&result.temperature_air));
                prop_assert!(!result.eph.is_nan() && !result.climb_rate.is_nan());
            }
        }
    }
}
