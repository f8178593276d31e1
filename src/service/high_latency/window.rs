//! The samples between two messages, summarised (L-21): the mean of values that vary, the extreme of values that must
//! not be missed.

use super::HighLatencySample;
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
        self.count += 1.0;
        self.mean += (value.max(min).min(max) - self.mean) / self.count;
    }

    /// Returns the mean; `last` if there was no sample.
    fn or(&self, last: f32) -> f32 {
        if self.count > 0.0 { self.mean } else { last }
    }
}

/// The highest speed that the message can hold (m/s).
const MAX_SPEED: f32 = 51.0;

/// All samples since `begun`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) begun: Instant,
    airspeed: Mean,
    airspeed_sp: Mean,
    groundspeed: Mean,
    windspeed: Mean,
    throttle: Mean,
    battery: Mean,
    temperature_air: Mean,
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
        Self {
            begun,
            airspeed: Mean::NONE,
            airspeed_sp: Mean::NONE,
            groundspeed: Mean::NONE,
            windspeed: Mean::NONE,
            throttle: Mean::NONE,
            battery: Mean::NONE,
            temperature_air: Mean::NONE,
            eph: f32::NAN,
            epv: f32::NAN,
            climb_rate: f32::NAN,
        }
    }

    pub(super) fn add(&mut self, sample: &HighLatencySample) {
        self.airspeed.add(sample.airspeed, 0.0, MAX_SPEED);
        self.airspeed_sp.add(sample.airspeed_sp, 0.0, MAX_SPEED);
        self.groundspeed.add(sample.groundspeed, 0.0, MAX_SPEED);
        self.windspeed.add(sample.windspeed, 0.0, MAX_SPEED);
        self.throttle.add(sample.throttle, 0.0, 100.0);
        self.battery.add(sample.battery, 0.0, 100.0);
        self.temperature_air.add(sample.temperature_air, -127.0, 127.0);
        // `max` ignores a NaN.
        self.eph = self.eph.max(sample.eph);
        self.epv = self.epv.max(sample.epv);
        if self.climb_rate.is_nan() || sample.climb_rate.abs() > self.climb_rate.abs() {
            self.climb_rate = sample.climb_rate;
        }
    }

    /// Returns `last`, the newest sample, with the window's means and extremes where it has any.
    pub(super) fn summary(&self, last: &HighLatencySample) -> HighLatencySample {
        HighLatencySample {
            airspeed: self.airspeed.or(last.airspeed),
            airspeed_sp: self.airspeed_sp.or(last.airspeed_sp),
            groundspeed: self.groundspeed.or(last.groundspeed),
            windspeed: self.windspeed.or(last.windspeed),
            throttle: self.throttle.or(last.throttle),
            battery: self.battery.or(last.battery),
            temperature_air: self.temperature_air.or(last.temperature_air),
            eph: self.eph.max(last.eph),
            epv: self.epv.max(last.epv),
            climb_rate: if self.climb_rate.is_nan() { last.climb_rate } else { self.climb_rate },
            ..*last
        }
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
        let told = summary(&[NAN, 2.0, NAN, -4.0, NAN]);
        assert_eq!((told.airspeed, told.temperature_air), (1.0, -1.0), "the speed below 0 is 0");
        assert_eq!((told.eph, told.epv, told.climb_rate), (2.0, 2.0, -4.0));
        let told = summary(&[NAN, NAN]);
        assert!([told.airspeed, told.battery, told.eph, told.epv, told.climb_rate].iter().all(|value| value.is_nan()));
    }

    #[test]
    fn an_empty_window_reports_the_last_sample() {
        let told = Window::new(Instant::ZERO).summary(&sample(3.0));
        assert_eq!((told.airspeed, told.throttle, told.eph, told.climb_rate), (3.0, 3.0, 3.0, 3.0));
    }

    #[test]
    fn one_insane_value_does_not_hide_the_others() {
        let mut values = [10.0; 100];
        values[50] = f32::INFINITY;
        let told = summary(&values);
        assert!((told.airspeed - 10.41).abs() < 1e-3, "{}", told.airspeed);
        assert!((told.throttle - 10.9).abs() < 1e-3, "{}", told.throttle);
        assert_eq!((told.eph, told.climb_rate), (f32::INFINITY, f32::INFINITY), "the extreme is reported unchanged");
    }

    proptest! {
        #[test]
        fn the_summary_matches_the_samples(values in prop::collection::vec(-40.0f32..40.0, 1..500)) {
            let told = summary(&values);
            let mean = |min: f64| values.iter().map(|v| f64::from(*v).max(min)).sum::<f64>() / values.len() as f64;
            prop_assert!((f64::from(told.airspeed) - mean(0.0)).abs() < 1e-3);
            prop_assert!((f64::from(told.temperature_air) - mean(-127.0)).abs() < 1e-3);
            prop_assert_eq!(told.eph, values.iter().copied().fold(f32::MIN, f32::max));
            let steepest = values.iter().map(|v| v.abs()).fold(0.0, f32::max);
            prop_assert_eq!(told.climb_rate.abs(), steepest);
            prop_assert!(values.contains(&told.climb_rate));
        }

        #[test]
        fn any_bits_leave_the_means_within_range(bits in prop::collection::vec(any::<u32>(), 1..50)) {
            let values: std::vec::Vec<f32> = bits.into_iter().map(f32::from_bits).collect();
            let told = summary(&values);
            if values.iter().any(|value| !value.is_nan()) {
                prop_assert!((0.0..=51.0).contains(&told.airspeed));
                prop_assert!((0.0..=100.0).contains(&told.throttle));
                prop_assert!((-127.0..=127.0).contains(&told.temperature_air));
                prop_assert!(!told.eph.is_nan() && !told.climb_rate.is_nan());
            }
        }
    }
}
