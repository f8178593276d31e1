//! The vehicle's state in SI units, and its conversion to HIGH_LATENCY2. Every conversion accepts every `f32` (L-22).

use crate::dialect::{HighLatency2, HlFailureFlag, MavSysStatusSensor};
use crate::message::LatLon;
use crate::num;

/// A sample of the vehicle's state, for HIGH_LATENCY2. NaN means "unknown". A value that the message cannot hold, such
/// as infinity, becomes the nearest one that it can.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HighLatencySample {
    /// The position; `None` without a fix. Then 0, 0 is sent, which ground stations recognise.
    pub position: Option<LatLon>,
    /// Altitude above mean sea level (m): −32768 to 32767. Unknown is sent as 0.
    pub altitude: f32,
    /// Target altitude above mean sea level (m). Unknown is sent as the altitude itself.
    pub target_altitude: f32,
    /// Heading, clockwise from north (deg): any angle, sent in steps of 2°. Unknown is sent as 0.
    pub heading: f32,
    /// Direction of the target, clockwise from north (deg), sent in the same way.
    pub target_heading: f32,
    /// Distance to the target (m): up to 655,350, in steps of 10 m. Unknown is sent as 0.
    pub target_distance: f32,
    /// Throttle (%): 0 to 100, mean. Reverse thrust and unknown are sent as 0.
    pub throttle: f32,
    /// Airspeed (m/s): 0 to 51, in steps of 0.2, mean. Unknown is sent as 0.
    pub airspeed: f32,
    /// Airspeed setpoint (m/s), sent in the same way.
    pub airspeed_sp: f32,
    /// Ground speed (m/s), sent in the same way.
    pub groundspeed: f32,
    /// Wind speed (m/s), sent in the same way.
    pub windspeed: f32,
    /// The direction that the wind comes *from*, clockwise from north (deg), as in weather reports and in ArduPilot.
    /// Sent in steps of 2°; unknown is sent as 0. The message does not define the direction, and ground stations show
    /// the number as it is. PX4 sends where the wind blows *to* (L-20): add 180° for that.
    pub wind_from_deg: f32,
    /// Error of the horizontal position (m): the largest, up to 25.5, which also means "unknown".
    pub eph: f32,
    /// Error of the altitude (m), sent in the same way.
    pub epv: f32,
    /// Air temperature (°C): −127 to 127, mean. Unknown is sent as −128.
    pub temperature_air: f32,
    /// Climb rate (m/s): −12.7 to 12.7, the one of the largest magnitude. Unknown is sent as 0.
    pub climb_rate: f32,
    /// Remaining charge (%): 0 to 100, mean. Unknown is sent as −1.
    pub battery: f32,
    /// The current mission item; `None` if there is none, which is sent as 65535.
    pub wp_num: Option<u16>,
    /// The failures of the vehicle's equipment; [`failures`](Self::failures) converts them from SYS_STATUS.
    pub failure_flags: HlFailureFlag,
    /// `custom0` to `custom2`: the vehicle defines them. While they are 0 the message is three bytes shorter.
    /// ArduPilot's first one is the `base_mode`, which ground stations read only for the autopilot ArduPilot.
    pub custom: [i8; 3],
}

impl HighLatencySample {
    /// A sample in which everything is unknown.
    pub const UNKNOWN: Self = Self::with(f32::NAN);

    /// All zero bits.
    pub(crate) const VACANT: Self = Self::with(0.0);

    const fn with(value: f32) -> Self {
        Self {
            position: None,
            altitude: value,
            target_altitude: value,
            heading: value,
            target_heading: value,
            target_distance: value,
            throttle: value,
            airspeed: value,
            airspeed_sp: value,
            groundspeed: value,
            windspeed: value,
            wind_from_deg: value,
            eph: value,
            epv: value,
            temperature_air: value,
            climb_rate: value,
            battery: value,
            wp_num: None,
            failure_flags: HlFailureFlag::EMPTY,
            custom: [0; 3],
        }
    }

    /// Returns the failures that SYS_STATUS reports with these three fields: sensors that are present, enabled and not
    /// healthy. A sensor that the vehicle does not have has not failed.
    ///
    /// ```
    /// use mavstack::high_latency::HighLatencySample;
    /// use mavstack::dialect::{HlFailureFlag, MavSysStatusSensor};
    ///
    /// let present = MavSysStatusSensor::SENSOR_GPS | MavSysStatusSensor::SENSOR_3D_MAG;
    /// let failures = HighLatencySample::failures(present, present, MavSysStatusSensor::SENSOR_3D_MAG);
    /// assert_eq!(failures, HlFailureFlag::GPS);
    /// ```
    pub fn failures(
        present: MavSysStatusSensor,
        enabled: MavSysStatusSensor,
        health: MavSysStatusSensor,
    ) -> HlFailureFlag {
        let failed = MavSysStatusSensor(present.0 & enabled.0).without(health);
        let mut flags = HlFailureFlag::EMPTY;
        for (sensor, flag) in SENSORS {
            if failed.contains(*sensor) {
                flags |= *flag;
            }
        }
        flags
    }

    /// Returns the values that a message averages, in the order of [`AVERAGED`].
    pub(super) const fn averaged(&self) -> [f32; AVERAGED.len()] {
        let Self { airspeed, airspeed_sp, groundspeed, windspeed, throttle, battery, temperature_air, .. } = *self;
        [airspeed, airspeed_sp, groundspeed, windspeed, throttle, battery, temperature_air]
    }

    /// Sets these values.
    pub(super) const fn set_averaged(&mut self, values: [f32; AVERAGED.len()]) {
        [
            self.airspeed,
            self.airspeed_sp,
            self.groundspeed,
            self.windspeed,
            self.throttle,
            self.battery,
            self.temperature_air,
        ] = values;
    }

    /// Writes the sample to the fields of `message`.
    pub(super) fn write_to(&self, message: &mut HighLatency2) {
        let position = self.position.unwrap_or(LatLon { latitude: 0, longitude: 0 });
        message.latitude = position.latitude;
        message.longitude = position.longitude;
        let target_altitude = if self.target_altitude.is_nan() { self.altitude } else { self.target_altitude };
        message.altitude = metres(self.altitude);
        message.target_altitude = metres(target_altitude);
        message.heading = half_degrees(self.heading);
        message.target_heading = half_degrees(self.target_heading);
        message.target_distance = decametres(self.target_distance);
        message.throttle = num::byte(num::nearest(self.throttle, 0, 100, 0));
        message.airspeed = speed(self.airspeed);
        message.airspeed_sp = speed(self.airspeed_sp);
        message.groundspeed = speed(self.groundspeed);
        message.windspeed = speed(self.windspeed);
        message.wind_heading = half_degrees(self.wind_from_deg);
        message.eph = error(self.eph);
        message.epv = error(self.epv);
        message.temperature_air = num::byte(num::nearest(self.temperature_air, -127, 127, -128)).cast_signed();
        message.climb_rate = num::byte(num::nearest(self.climb_rate * 10.0, -127, 127, 0)).cast_signed();
        message.battery = num::byte(num::nearest(self.battery, 0, 100, -1)).cast_signed();
        message.wp_num = self.wp_num.unwrap_or(u16::MAX);
        message.failure_flags = self.failure_flags;
        let [custom0, custom1, custom2] = self.custom;
        message.custom0 = custom0;
        message.custom1 = custom1;
        message.custom2 = custom2;
    }
}

/// [`UNKNOWN`](HighLatencySample::UNKNOWN).
impl Default for HighLatencySample {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

/// The highest speed that the message can hold (m/s).
const MAX_SPEED: f32 = 51.0;

/// The ranges in the message of the [averaged](HighLatencySample::averaged) values.
pub(super) const AVERAGED: [(f32, f32); 7] = [
    (0.0, MAX_SPEED),
    (0.0, MAX_SPEED),
    (0.0, MAX_SPEED),
    (0.0, MAX_SPEED),
    (0.0, 100.0),
    (0.0, 100.0),
    (-127.0, 127.0),
];

/// The failures that SYS_STATUS reports too.
const SENSORS: &[(MavSysStatusSensor, HlFailureFlag)] = &[
    (MavSysStatusSensor::SENSOR_GPS, HlFailureFlag::GPS),
    (MavSysStatusSensor::SENSOR_DIFFERENTIAL_PRESSURE, HlFailureFlag::DIFFERENTIAL_PRESSURE),
    (MavSysStatusSensor::SENSOR_ABSOLUTE_PRESSURE, HlFailureFlag::ABSOLUTE_PRESSURE),
    (MavSysStatusSensor::SENSOR_3D_ACCEL, HlFailureFlag::_3D_ACCEL),
    (MavSysStatusSensor::SENSOR_3D_GYRO, HlFailureFlag::_3D_GYRO),
    (MavSysStatusSensor::SENSOR_3D_MAG, HlFailureFlag::_3D_MAG),
    (MavSysStatusSensor::TERRAIN, HlFailureFlag::TERRAIN),
    (MavSysStatusSensor::SENSOR_BATTERY, HlFailureFlag::BATTERY),
    (MavSysStatusSensor::SENSOR_RC_RECEIVER, HlFailureFlag::RC_RECEIVER),
    (MavSysStatusSensor::SENSOR_PROPULSION, HlFailureFlag::ENGINE),
    (MavSysStatusSensor::GEOFENCE, HlFailureFlag::GEOFENCE),
    (MavSysStatusSensor::AHRS, HlFailureFlag::ESTIMATOR),
];

fn metres(value: f32) -> i16 {
    num::half(num::nearest(value, i32::from(i16::MIN), i32::from(i16::MAX), 0)).cast_signed()
}

fn decametres(value: f32) -> u16 {
    num::half(num::nearest(value / 10.0, 0, i32::from(u16::MAX), 0))
}

/// Converts m/s to steps of 0.2.
fn speed(value: f32) -> u8 {
    num::byte(num::nearest(value * 5.0, 0, 255, 0))
}

/// Converts m to steps of 0.1.
fn error(value: f32) -> u8 {
    num::byte(num::nearest(value * 10.0, 0, 255, 255))
}

/// Converts any angle in degrees to 0 to 179. A very large number becomes some angle, and infinity becomes 0.
fn half_degrees(value: f32) -> u8 {
    let halves = if value.is_finite() { num::nearest(value / 2.0, i32::MIN, i32::MAX, 0) } else { 0 };
    num::byte(halves.checked_rem_euclid(180).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn message_of(sample: &HighLatencySample) -> HighLatency2 {
        let mut message = HighLatency2::default();
        sample.write_to(&mut message);
        message
    }

    #[test]
    fn unknown_is_sent_as_unknown() {
        // L-22
        let message = message_of(&HighLatencySample::default());
        let expected = HighLatency2 {
            eph: 255,
            epv: 255,
            temperature_air: -128,
            battery: -1,
            wp_num: 65_535,
            ..Default::default()
        };
        assert_eq!(message, expected);
    }

    #[test]
    fn every_field_is_in_its_own_unit() {
        let message = message_of(&HighLatencySample {
            position: Some(LatLon { latitude: 473_977_418, longitude: -85_455_939 }),
            altitude: 488.6,
            target_altitude: -3.5,
            heading: 359.4,
            target_heading: -90.0,
            target_distance: 1_234.0,
            throttle: 49.5,
            airspeed: 15.1,
            airspeed_sp: 16.0,
            groundspeed: 12.34,
            windspeed: 3.1,
            wind_from_deg: 271.0,
            eph: 0.84,
            epv: 1.26,
            temperature_air: -11.5,
            climb_rate: -2.04,
            battery: 83.4,
            wp_num: Some(7),
            failure_flags: HlFailureFlag::GPS | HlFailureFlag::MISSION,
            custom: [-1, 2, 3],
        });
        let expected = HighLatency2 {
            latitude: 473_977_418,
            longitude: -85_455_939,
            altitude: 489,
            target_altitude: -4,
            // 359.4° is nearer to 360° than to 358°.
            heading: 0,
            target_heading: 135,
            target_distance: 123,
            throttle: 50,
            airspeed: 76,
            airspeed_sp: 80,
            groundspeed: 62,
            windspeed: 16,
            wind_heading: 136,
            eph: 8,
            epv: 13,
            temperature_air: -12,
            climb_rate: -20,
            battery: 83,
            wp_num: 7,
            failure_flags: HlFailureFlag(0x2001),
            custom0: -1,
            custom1: 2,
            custom2: 3,
            ..Default::default()
        };
        assert_eq!(message, expected);
        let at_rest = message_of(&HighLatencySample { altitude: 12.0, ..HighLatencySample::UNKNOWN });
        assert_eq!(at_rest.target_altitude, 12, "without a target, the altitude itself");
    }

    #[test]
    fn only_present_and_enabled_sensors_can_fail() {
        let all = MavSysStatusSensor(u32::MAX);
        let none = MavSysStatusSensor::EMPTY;
        assert_eq!(HighLatencySample::failures(all, all, none), HlFailureFlag(0x3FFF & !0x2200));
        assert_eq!(HighLatencySample::failures(all, all, all), HlFailureFlag::EMPTY);
        assert_eq!(HighLatencySample::failures(none, all, none), HlFailureFlag::EMPTY);
        assert_eq!(HighLatencySample::failures(all, none, none), HlFailureFlag::EMPTY);
    }

    /// Returns the nearest whole number of steps within the bounds; `unknown` for NaN.
    fn expected(value: f32, steps: f32, min: f32, max: f32, unknown: f32) -> f32 {
        if value.is_nan() { unknown } else { (value * steps).round().clamp(min, max) }
    }

    /// Any bits; special values more often; and the range of the message, with its limits.
    fn any_float() -> impl Strategy<Value = f32> {
        const ODD: [f32; 8] =
            [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, f32::MIN_POSITIVE, -0.0, 0.0];
        prop_oneof![
            8 => any::<u32>().prop_map(f32::from_bits),
            2 => -400.0f32..400.0,
            1 => prop::sample::select(ODD.to_vec()),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(50_000))]

        /// L-22: any of all 2^32 floats, including NaN and infinities, in every field.
        #[test]
        fn every_float_is_sent_as_the_nearest_value(v in any_float()) {
            let message = message_of(&HighLatencySample {
                altitude: v,
                target_altitude: v,
                heading: v,
                target_heading: v,
                target_distance: v,
                throttle: v,
                airspeed: v,
                airspeed_sp: v,
                groundspeed: v,
                windspeed: v,
                wind_from_deg: v,
                eph: v,
                epv: v,
                temperature_air: v,
                climb_rate: v,
                battery: v,
                ..HighLatencySample::UNKNOWN
            });
            prop_assert_eq!(f32::from(message.altitude), expected(v, 1.0, -32_768.0, 32_767.0, 0.0));
            prop_assert_eq!(message.target_altitude, message.altitude);
            prop_assert_eq!(f32::from(message.throttle), expected(v, 1.0, 0.0, 100.0, 0.0));
            prop_assert_eq!(f32::from(message.airspeed), expected(v, 5.0, 0.0, 255.0, 0.0));
            prop_assert_eq!(f32::from(message.airspeed_sp), expected(v, 5.0, 0.0, 255.0, 0.0));
            prop_assert_eq!(f32::from(message.groundspeed), expected(v, 5.0, 0.0, 255.0, 0.0));
            prop_assert_eq!(f32::from(message.windspeed), expected(v, 5.0, 0.0, 255.0, 0.0));
            prop_assert_eq!(f32::from(message.eph), expected(v, 10.0, 0.0, 255.0, 255.0));
            prop_assert_eq!(f32::from(message.epv), expected(v, 10.0, 0.0, 255.0, 255.0));
            prop_assert_eq!(f32::from(message.temperature_air), expected(v, 1.0, -127.0, 127.0, -128.0));
            prop_assert_eq!(f32::from(message.climb_rate), expected(v, 10.0, -127.0, 127.0, 0.0));
            prop_assert_eq!(f32::from(message.battery), expected(v, 1.0, 0.0, 100.0, -1.0));
            prop_assert_eq!(f32::from(message.target_distance), expected(v / 10.0, 1.0, 0.0, 65_535.0, 0.0));
            for angle in [message.heading, message.target_heading, message.wind_heading] {
                prop_assert!(angle < 180);
            }
            if !v.is_finite() {
                prop_assert_eq!([message.heading, message.target_heading, message.wind_heading], [0; 3]);
            }
        }

        /// For sane values, the error is at most half a step.
        #[test]
        fn the_error_is_at_most_half_a_step(v in -2_000.0f32..2_000.0) {
            let off = |sent: f32, step: f32, min: f32, max: f32| (sent * step - v.clamp(min, max)).abs() <= step * 0.5001;
            prop_assert!(off(f32::from(metres(v)), 1.0, -32_768.0, 32_767.0));
            prop_assert!(off(f32::from(decametres(v)), 10.0, 0.0, 655_350.0));
            prop_assert!(off(f32::from(speed(v)), 0.2, 0.0, 51.0));
            prop_assert!(off(f32::from(error(v)), 0.1, 0.0, 25.5));
            let turned = (f64::from(half_degrees(v)) * 2.0 - f64::from(v)).rem_euclid(360.0);
            prop_assert!(turned <= 1.001 || turned >= 358.999, "{} is sent as {}", v, half_degrees(v));
        }
    }
}
