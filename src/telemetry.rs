//! Telemetry messages from SI values, with MAVLink's units, rounding and values for "unknown".
//!
//! Implements the fields' descriptions in <https://mavlink.io/en/messages/common.html>.
//!
//! | fill | to get |
//! |---|---|
//! | [`Motion`] | [`attitude`](Motion::attitude), [`global_position_int`](Motion::global_position_int), [`vfr_hud`](Motion::vfr_hud) |
//! | [`GpsFix`] | [`gps_raw_int`](GpsFix::gps_raw_int) |
//! | [`Battery`] | [`battery_status`](Battery::battery_status), [`sys_status`](Battery::sys_status) |
//! | [`Geofence`] | its bits of SYS_STATUS: [`with_geofence`](SysStatus::with_geofence) |
//! | [`Home`] | [`home_position`](Home::home_position) |
//! | the landed state | [`extended_sys_state`] |
//!
//! - NaN, infinity and `None` mean "unknown". They are sent as the value that the definitions call `invalid`, which is also in
//!   the message's constant `UNKNOWN`. A float field is sent as NaN. An integer field without such a value is sent as 0.
//! - A known value is rounded to the nearest one that the field can hold. It never becomes the value for "unknown": SYS_STATUS
//!   reports 70 V as 65,534 mV, because 65,535 means "unknown".
//! - Angles are in radians. Any angle is accepted, and is wrapped to the field's range.
//!
//! Struct update adds the fields that are not measured, such as the type of a battery or the health of sensors:
//!
//! ```
//! use mavstack::dialect::{BatteryStatus, MavBatteryType};
//! use mavstack::telemetry::Battery;
//!
//! // Three cells; there is no thermometer.
//! let pack = Battery { cells: &[3.701, 3.699, 3.7], current: 12.34, remaining: 80.0, ..Battery::UNKNOWN };
//! let message = BatteryStatus { r#type: MavBatteryType::LIPO, ..pack.battery_status() };
//! assert_eq!(message.voltages[..4], [3_701, 3_699, 3_700, u16::MAX]);
//! assert_eq!((message.current_battery, message.battery_remaining, message.temperature), (1_234, 80, i16::MAX));
//!
//! // SYS_STATUS reports the same battery. The main loop is busy for 20 % of the time.
//! let status = pack.sys_status(20.0);
//! assert_eq!((status.load, status.voltage_battery, status.current_battery), (200, 11_100, 1_234));
//! ```
//!
//! This module stands alone: it needs no [`Stack`](struct@crate::Stack). Left out: messages whose fields are SI values
//! already, such as LOCAL_POSITION_NED.

use core::f32::consts::{PI, TAU};

use crate::dialect::{
    Attitude, BatteryStatus, ExtendedSysState, GlobalPositionInt, GpsFixType, GpsRawInt, HomePosition, MavLandedState,
    MavSysStatusSensor, SysStatus, VfrHud,
};
use crate::message::{Item, LatLon};
use crate::num;
use crate::time::Instant;

/// Hundredths of a degree in a radian.
const CENTIDEGREES: f32 = 18_000.0 / PI;

/// How the vehicle moves, as estimated: for ATTITUDE, GLOBAL_POSITION_INT and VFR_HUD.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Motion {
    /// The position.
    pub position: Option<LatLon>,
    /// Altitude above mean sea level (m).
    pub altitude: f32,
    /// Altitude above home (m).
    pub relative_altitude: f32,
    /// Velocity to the north, east and down (m/s).
    pub velocity: [f32; 3],
    /// Roll, pitch and yaw (rad). Yaw is the heading, clockwise from north.
    pub attitude: [f32; 3],
    /// Roll rate, pitch rate and yaw rate (rad/s).
    pub rates: [f32; 3],
    /// Airspeed (m/s).
    pub airspeed: f32,
    /// Ground speed (m/s): the length of the horizontal velocity.
    pub groundspeed: f32,
    /// Throttle (%): 0 to 100.
    pub throttle: f32,
}

impl Motion {
    /// Everything is unknown.
    pub const UNKNOWN: Self = Self {
        position: None,
        altitude: f32::NAN,
        relative_altitude: f32::NAN,
        velocity: [f32::NAN; 3],
        attitude: [f32::NAN; 3],
        rates: [f32::NAN; 3],
        airspeed: f32::NAN,
        groundspeed: f32::NAN,
        throttle: f32::NAN,
    };

    /// Returns ATTITUDE, with angles from −π to π.
    pub fn attitude(&self, now: Instant) -> Attitude {
        let [roll, pitch, yaw] = self.attitude.map(half_turn);
        let [rollspeed, pitchspeed, yawspeed] = self.rates.map(finite);
        Attitude { time_boot_ms: now.time_boot_ms(), roll, pitch, yaw, rollspeed, pitchspeed, yawspeed }
    }

    /// Returns GLOBAL_POSITION_INT. Returns `None` if the position is unknown, because the message has no value for
    /// that. An unknown altitude or velocity is sent as 0, and an unknown yaw as `hdg` 65,535.
    pub fn global_position_int(&self, now: Instant) -> Option<GlobalPositionInt> {
        let position = self.position?;
        let [vx, vy, vz] = self.velocity.map(centimetres);
        let [_, _, yaw] = self.attitude;
        Some(GlobalPositionInt {
            time_boot_ms: now.time_boot_ms(),
            lat: position.latitude,
            lon: position.longitude,
            alt: millimetres(self.altitude),
            relative_alt: millimetres(self.relative_altitude),
            vx,
            vy,
            vz,
            hdg: centidegrees(yaw),
        })
    }

    /// Returns VFR_HUD. An unknown heading or throttle is sent as 0.
    pub fn vfr_hud(&self) -> VfrHud {
        let ([_, _, yaw], [_, _, down]) = (self.attitude, self.velocity);
        let heading = field(yaw, CENTIDEGREES / 100.0, i32::MIN, i32::MAX, 0).rem_euclid(360);
        VfrHud {
            airspeed: finite(self.airspeed),
            groundspeed: finite(self.groundspeed),
            alt: finite(self.altitude),
            climb: finite(-down),
            heading: num::half(heading).cast_signed(),
            throttle: num::half(field(self.throttle, 1.0, 0, 100, 0)),
        }
    }
}

/// The solution of a GNSS receiver: for GPS_RAW_INT.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GpsFix {
    /// The quality of the fix.
    pub fix_type: GpsFixType,
    /// The position. Unknown is sent as 0, 0.
    pub position: Option<LatLon>,
    /// Altitude above mean sea level (m). Unknown is sent as 0.
    pub altitude: f32,
    /// Altitude above the ellipsoid (m). Unknown is sent as 0.
    pub alt_ellipsoid: f32,
    /// Horizontal dilution of precision, without a unit: up to 655.34.
    pub hdop: f32,
    /// Vertical dilution of precision, without a unit: up to 655.34.
    pub vdop: f32,
    /// Ground speed (m/s): up to 655.34.
    pub groundspeed: f32,
    /// Direction of movement over ground (rad), clockwise from north. It is unknown while the receiver does not move.
    pub course: f32,
    /// The number of satellites.
    pub satellites: Option<u8>,
    /// Error of the horizontal position (m). This error and the others are sent as 0 if they are unknown.
    pub h_acc: f32,
    /// Error of the altitude (m).
    pub v_acc: f32,
    /// Error of the speed (m/s).
    pub vel_acc: f32,
    /// Error of the heading (rad).
    pub hdg_acc: f32,
    /// Heading of the vehicle (rad), clockwise from north, from a receiver with two antennas.
    pub yaw: f32,
}

impl GpsFix {
    /// No receiver.
    pub const UNKNOWN: Self = Self {
        fix_type: GpsFixType::NO_GPS,
        position: None,
        altitude: f32::NAN,
        alt_ellipsoid: f32::NAN,
        hdop: f32::NAN,
        vdop: f32::NAN,
        groundspeed: f32::NAN,
        course: f32::NAN,
        satellites: None,
        h_acc: f32::NAN,
        v_acc: f32::NAN,
        vel_acc: f32::NAN,
        hdg_acc: f32::NAN,
        yaw: f32::NAN,
    };

    /// Returns GPS_RAW_INT.
    pub fn gps_raw_int(&self, now: Instant) -> GpsRawInt {
        let LatLon { latitude, longitude } = self.position.unwrap_or(LatLon { latitude: 0, longitude: 0 });
        GpsRawInt {
            time_usec: now.as_micros(),
            lat: latitude,
            lon: longitude,
            alt: millimetres(self.altitude),
            eph: unsigned(self.hdop, 1e2),
            epv: unsigned(self.vdop, 1e2),
            vel: unsigned(self.groundspeed, 1e2),
            cog: centidegrees(self.course),
            fix_type: self.fix_type,
            satellites_visible: self.satellites.map_or(u8::MAX, |satellites| satellites.min(254)),
            alt_ellipsoid: millimetres(self.alt_ellipsoid),
            h_acc: error(self.h_acc, 1e3),
            v_acc: error(self.v_acc, 1e3),
            vel_acc: error(self.vel_acc, 1e3),
            hdg_acc: error(self.hdg_acc, CENTIDEGREES * 1e3),
            yaw: match centidegrees(self.yaw) {
                // 0 means "unknown", so north is 360°.
                0 => 36_000,
                u16::MAX => 0,
                yaw => yaw,
            },
        }
    }
}

/// A battery: for BATTERY_STATUS and SYS_STATUS.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Battery<'a> {
    /// The voltages of the cells (V). Empty if they are not measured one by one. BATTERY_STATUS has room for 14 cells.
    pub cells: &'a [f32],
    /// The voltage of the battery (V). Unknown means the sum of the [`cells`](Self::cells).
    pub voltage: f32,
    /// The current that is drawn (A): −327.67 to 327.67, negative while the battery is being charged.
    pub current: f32,
    /// The charge that has been drawn (A·s); 1 mAh is 3.6 A·s. Less than 0 is sent as 0.
    pub charge_consumed: f32,
    /// The energy that has been drawn (J). Less than 0 is sent as 0.
    pub energy_consumed: f32,
    /// Temperature (°C): −327.68 to 327.66.
    pub temperature: f32,
    /// Remaining charge (%): 0 to 100.
    pub remaining: f32,
    /// The time until the battery is empty (s). Less than 1 is sent as 1, because 0 means "unknown".
    pub time_remaining: f32,
}

impl Battery<'_> {
    /// Nothing is measured.
    pub const UNKNOWN: Self = Self {
        cells: &[],
        voltage: f32::NAN,
        current: f32::NAN,
        charge_consumed: f32::NAN,
        energy_consumed: f32::NAN,
        temperature: f32::NAN,
        remaining: f32::NAN,
        time_remaining: f32::NAN,
    };

    /// Returns BATTERY_STATUS of battery 0. Its function, type and state of charge are unknown.
    ///
    /// Without [`cells`](Self::cells), the voltage of the battery is sent as that of the first cell. The part above
    /// 65.534 V is sent as the voltages of the next cells, as the definitions require.
    pub fn battery_status(&self) -> BatteryStatus {
        let BatteryStatus { mut voltages, mut voltages_ext, .. } = BatteryStatus::UNKNOWN;
        if self.cells.is_empty() {
            let mut remaining_voltage = self.voltage;
            for entry in &mut voltages {
                *entry = unsigned(remaining_voltage, 1e3);
                remaining_voltage -= 65.534;
                // Less than half a millivolt is sent as 0: no further cell is used.
                if remaining_voltage < 0.000_5 {
                    break;
                }
            }
        }
        for (entry, cell) in voltages.iter_mut().zip(self.cells) {
            *entry = unsigned(*cell, 1e3);
        }
        // The eleventh to the fourteenth cell: 0 means that there is no such cell.
        for (entry, cell) in voltages_ext.iter_mut().zip(self.cells.iter().skip(voltages.len())) {
            *entry = num::half(field(*cell, 1e3, 1, 65_534, 0));
        }
        BatteryStatus {
            current_consumed: field(self.charge_consumed, 1.0 / 3.6, 0, i32::MAX, -1),
            energy_consumed: field(self.energy_consumed, 1e-2, 0, i32::MAX, -1),
            temperature: num::half(field(self.temperature, 1e2, -32_768, 32_766, 32_767)).cast_signed(),
            voltages,
            current_battery: self.current(),
            battery_remaining: self.remaining(),
            time_remaining: field(self.time_remaining, 1.0, 1, i32::MAX, 0),
            voltages_ext,
            ..BatteryStatus::UNKNOWN
        }
    }

    /// Returns SYS_STATUS with this battery's voltage, current and remaining charge. `load` is the share of time for
    /// which the main loop is busy (%), 0 to 100; unknown is sent as 0. It has no sensors, no errors and no geofence.
    pub fn sys_status(&self, load: f32) -> SysStatus {
        SysStatus {
            load: num::half(field(load, 10.0, 0, 1_000, 0)),
            voltage_battery: unsigned(self.total_voltage(), 1e3),
            current_battery: self.current(),
            battery_remaining: self.remaining(),
            // As `Geofence::Absent`.
            onboard_control_sensors_health: MavSysStatusSensor::GEOFENCE,
            ..SysStatus::UNKNOWN
        }
    }

    /// Returns the voltage of the battery (V): the [measured](Self::voltage) one, otherwise the sum of the
    /// [`cells`](Self::cells). It is not finite if neither is known.
    pub fn total_voltage(&self) -> f32 {
        if self.voltage.is_finite() || self.cells.is_empty() { self.voltage } else { self.cells.iter().sum() }
    }

    /// Returns the current in hundredths of an ampere. −1 means "unknown", so a current that is nearest to it becomes
    /// 0.
    fn current(&self) -> i16 {
        match field(self.current, 1e2, -32_767, 32_767, i32::MIN) {
            i32::MIN => -1,
            -1 => 0,
            current => num::half(current).cast_signed(),
        }
    }

    /// Returns the remaining charge (%); −1 if it is unknown.
    fn remaining(&self) -> i8 {
        let [percent, ..] = field(self.remaining, 1.0, 0, 100, -1).to_le_bytes();
        percent.cast_signed()
    }
}

/// The state of the geofence: for SYS_STATUS.
///
/// Ground stations show it, and MAVProxy says "fence breach" if the geofence is not healthy, even if there is none. So a vehicle
/// without a fence reports a healthy one, as ArduPilot does:
///
/// | | present | enabled | healthy |
/// |---|---|---|---|
/// | `Absent` | | | yes |
/// | `Disabled` | yes | | yes |
/// | `Kept` | yes | yes | yes |
/// | `Breached` | yes | yes | |
///
/// ```
/// # use mavstack::dialect::{MavSysStatusSensor, SysStatus};
/// # use mavstack::message::Item;
/// use mavstack::telemetry::{Battery, Geofence};
///
/// // In the loop: `stack.fence().items()`.
/// # let items = [Item::default()];
/// let fence = Geofence::of(&items, false);
/// let status = Battery::UNKNOWN.sys_status(20.0).with_geofence(fence);
/// assert!(status.onboard_control_sensors_enabled.contains(MavSysStatusSensor::GEOFENCE));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Geofence {
    /// There is none.
    Absent,
    /// There is one, which the vehicle may leave.
    Disabled,
    /// The vehicle is inside.
    Kept,
    /// The vehicle is outside.
    Breached,
}

impl Geofence {
    /// Returns the state of an enabled geofence with these items. An empty one is absent, whatever `is_breached` says.
    pub const fn of(fence: &[Item], is_breached: bool) -> Self {
        match (fence, is_breached) {
            ([], _) => Self::Absent,
            (_, true) => Self::Breached,
            (_, false) => Self::Kept,
        }
    }
}

impl SysStatus {
    /// Returns the status with the bits of the geofence. Call it last: the sensors of a struct update replace these bits.
    #[must_use]
    pub fn with_geofence(mut self, fence: Geofence) -> Self {
        for (sensors, is_set) in [
            (&mut self.onboard_control_sensors_present, fence != Geofence::Absent),
            (&mut self.onboard_control_sensors_enabled, matches!(fence, Geofence::Kept | Geofence::Breached)),
            (&mut self.onboard_control_sensors_health, fence != Geofence::Breached),
        ] {
            let others = sensors.without(MavSysStatusSensor::GEOFENCE);
            *sensors = if is_set { others.with(MavSysStatusSensor::GEOFENCE) } else { others };
        }
        self
    }
}

/// The home position: for HOME_POSITION.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Home {
    /// The position.
    pub position: LatLon,
    /// Altitude above mean sea level (m). Unknown is sent as 0.
    pub altitude: f32,
    /// The position to the north, east and down of the origin of LOCAL_POSITION_NED (m).
    pub local: [f32; 3],
}

impl Home {
    /// Returns HOME_POSITION. The surface's orientation is unknown, and no approach is given.
    pub fn home_position(&self, now: Instant) -> HomePosition {
        let [x, y, z] = self.local.map(finite);
        HomePosition {
            latitude: self.position.latitude,
            longitude: self.position.longitude,
            altitude: millimetres(self.altitude),
            x,
            y,
            z,
            time_usec: now.as_micros(),
            ..HomePosition::UNKNOWN
        }
    }
}

/// Returns EXTENDED_SYS_STATE of a vehicle that is no VTOL. A VTOL adds its `vtol_state` by struct update.
pub const fn extended_sys_state(landed_state: MavLandedState) -> ExtendedSysState {
    ExtendedSysState { landed_state, ..ExtendedSysState::UNKNOWN }
}

/// Converts a value to the unit of a field, rounds it, and saturates it at `min` and `max`. Returns `unknown` for NaN
/// and infinities. This function and those below are not inlined, because they have many callers.
#[inline(never)]
fn field(value: f32, scale: f32, min: i32, max: i32, unknown: i32) -> i32 {
    num::nearest(finite(value) * scale, min, max, unknown)
}

/// Converts a value to a field whose largest number means "unknown".
#[inline(never)]
fn unsigned(value: f32, scale: f32) -> u16 {
    num::half(field(value, scale, 0, 65_534, 65_535))
}

/// Converts an error to a field that is 0 for "unknown".
#[inline(never)]
fn error(value: f32, scale: f32) -> u32 {
    field(value, scale, 0, i32::MAX, 0).unsigned_abs()
}

/// Converts a speed (m/s) to cm/s; 0 for "unknown".
#[inline(never)]
fn centimetres(speed: f32) -> i16 {
    num::half(field(speed, 1e2, -32_768, 32_767, 0)).cast_signed()
}

/// Converts metres; 0 for "unknown".
#[inline(never)]
fn millimetres(metres: f32) -> i32 {
    field(metres, 1e3, i32::MIN, i32::MAX, 0)
}

/// Converts any angle (rad) to hundredths of a degree, 0 to 35,999; the largest number for "unknown".
#[inline(never)]
fn centidegrees(angle: f32) -> u16 {
    match field(angle, CENTIDEGREES, -i32::MAX, i32::MAX, i32::MIN) {
        i32::MIN => u16::MAX,
        angle => num::half(angle.rem_euclid(36_000)),
    }
}

/// Wraps an angle (rad) to −π to π; NaN for "unknown".
#[inline(never)]
fn half_turn(angle: f32) -> f32 {
    finite(angle) - num::f32_from_i32(field(angle, 1.0 / TAU, i32::MIN, i32::MAX, 0)) * TAU
}

/// Returns a finite value unchanged, and NaN for an infinity, whose product with 0 is NaN.
fn finite(value: f32) -> f32 {
    value + 0.0 * value
}
