//! Telemetry messages from SI values (`mavstack::telemetry`): units, rounding, limits, and values for "unknown".

use std::f32::consts::PI;
use std::f64::consts::FRAC_PI_2;
use std::process::Command;

use crate::support::pymavlink;
use mavstack::dialect::*;
use mavstack::frame::{Version, encode};
use mavstack::message::LatLon;
use mavstack::telemetry::{Battery, Geofence, GpsFix, Home, Motion, extended_sys_state};
use mavstack::{Address, Instant, Message};
use proptest::prelude::*;

const ZURICH: LatLon = LatLon { latitude: 473_977_420, longitude: 85_455_940 };
/// 49 days, 17 hours, 2 minutes, 47 seconds and 300 ms: `time_boot_ms` has wrapped to 4 ms.
const LATE: Instant = Instant::from_millis((1 << 32) + 4);

fn motion() -> Motion {
    Motion {
        position: Some(ZURICH),
        altitude: 488.1234,
        relative_altitude: -0.9876,
        velocity: [3.456, -0.015, -1.25],
        attitude: [0.1, -0.2, -PI / 2.0],
        rates: [0.01, 0.02, -0.03],
        airspeed: 4.5,
        groundspeed: 3.456,
        throttle: 49.6,
    }
}

fn gps_fix() -> GpsFix {
    GpsFix {
        fix_type: GpsFixType::RTK_FIXED,
        position: Some(ZURICH),
        altitude: 488.1234,
        alt_ellipsoid: 535.9999,
        hdop: 0.804,
        vdop: 1.2,
        groundspeed: 12.345,
        course: PI,
        satellites: Some(17),
        h_acc: 0.0142,
        v_acc: 0.0218,
        vel_acc: 0.05,
        hdg_acc: 0.01,
        yaw: 0.5,
    }
}

fn battery(cells: &[f32]) -> Battery<'_> {
    Battery {
        cells,
        voltage: 11.1,
        current: 12.344,
        charge_consumed: 3_600.0,
        energy_consumed: 39_960.0,
        temperature: -3.756,
        remaining: 79.5,
        time_remaining: 754.4,
    }
}

#[test]
fn motion_is_sent_in_the_units_of_each_message() {
    let angles = motion().attitude(LATE);
    assert_eq!((angles.time_boot_ms, angles.roll, angles.pitch, angles.yaw), (4, 0.1, -0.2, -PI / 2.0));
    assert_eq!((angles.rollspeed, angles.pitchspeed, angles.yawspeed), (0.01, 0.02, -0.03));
    let expected = GlobalPositionInt {
        time_boot_ms: 4,
        lat: 473_977_420,
        lon: 85_455_940,
        alt: 488_123,
        relative_alt: -988,
        vx: 346,
        vy: -2,
        vz: -125,
        hdg: 27_000,
    };
    assert_eq!(motion().global_position_int(LATE), Some(expected));
    let expected = VfrHud { airspeed: 4.5, groundspeed: 3.456, alt: 488.1234, climb: 1.25, heading: 270, throttle: 50 };
    assert_eq!(motion().vfr_hud(), expected);
}

/// Without a position there is no GLOBAL_POSITION_INT, and the other messages say what is unknown as far as they can.
#[test]
fn unknown_motion_is_sent_as_unknown() {
    let unknown = Motion::UNKNOWN;
    assert_eq!(unknown.global_position_int(LATE), None);
    let only_position = Motion { position: Some(ZURICH), ..unknown };
    let LatLon { latitude: lat, longitude: lon } = ZURICH;
    let expected = GlobalPositionInt { time_boot_ms: 4, lat, lon, ..GlobalPositionInt::UNKNOWN };
    assert_eq!(only_position.global_position_int(LATE), Some(expected));
    let angles = unknown.attitude(LATE);
    let floats = [angles.roll, angles.pitch, angles.yaw, angles.rollspeed, angles.pitchspeed, angles.yawspeed];
    assert!(floats.iter().all(|angle| angle.is_nan()), "{angles:?}");
    let hud = unknown.vfr_hud();
    assert!([hud.airspeed, hud.groundspeed, hud.alt, hud.climb].iter().all(|value| value.is_nan()), "{hud:?}");
    assert_eq!((hud.heading, hud.throttle), (0, 0));
}

/// A heading of 360° is 0°, in each field that has one.
#[test]
fn heading_ends_before_a_full_turn() {
    for (degrees, hdg, heading) in [
        (-0.004_f32, 0, 0),
        (-0.02, 35_998, 0),
        (359.4, 35_940, 359),
        (359.6, 35_960, 0),
        (360.0, 0, 0),
        (450.0, 9_000, 90),
        (-450.0, 27_000, 270),
    ] {
        let yaw = degrees.to_radians();
        let motion = Motion { attitude: [0.0, 0.0, yaw], ..motion() };
        assert_eq!(motion.global_position_int(LATE).expect("a position").hdg, hdg, "{degrees}");
        assert_eq!(motion.vfr_hud().heading, heading, "{degrees}");
        let gps = GpsFix { course: yaw, yaw, ..GpsFix::UNKNOWN }.gps_raw_int(LATE);
        // The field yaw is 0 if the receiver has none, so it is 36,000 for north.
        assert_eq!((gps.cog, gps.yaw), (hdg, if hdg == 0 { 36_000 } else { hdg }), "{degrees}");
    }
}

#[test]
fn gps_fix_is_sent_in_the_units_of_gps_raw_int() {
    let expected = GpsRawInt {
        time_usec: 4_294_967_300_000,
        lat: 473_977_420,
        lon: 85_455_940,
        alt: 488_123,
        eph: 80,
        epv: 120,
        vel: 1_235,
        cog: 18_000,
        fix_type: GpsFixType::RTK_FIXED,
        satellites_visible: 17,
        alt_ellipsoid: 536_000,
        h_acc: 14,
        v_acc: 22,
        vel_acc: 50,
        // 0.57296 degrees.
        hdg_acc: 57_296,
        yaw: 2_865,
    };
    assert_eq!(gps_fix().gps_raw_int(LATE), expected);
    // The field has no number but 255 for "unknown".
    let crowded = GpsFix { satellites: Some(255), ..gps_fix() };
    assert_eq!(crowded.gps_raw_int(LATE).satellites_visible, 254);
    let nothing = GpsFix::UNKNOWN.gps_raw_int(LATE);
    assert_eq!(nothing, GpsRawInt { time_usec: LATE.as_micros(), ..GpsRawInt::UNKNOWN });
}

#[test]
fn battery_is_the_same_in_both_messages() {
    let cells = [3.7004, 3.6996, f32::NAN];
    let expected = BatteryStatus {
        current_consumed: 1_000,
        energy_consumed: 400,
        temperature: -376,
        // The third cell is not measured.
        voltages: [3_700, 3_700, 65_535, 65_535, 65_535, 65_535, 65_535, 65_535, 65_535, 65_535],
        current_battery: 1_234,
        battery_remaining: 80,
        time_remaining: 754,
        ..BatteryStatus::UNKNOWN
    };
    assert_eq!(battery(&cells).battery_status(), expected);
    let expected = SysStatus {
        load: 333,
        voltage_battery: 11_100,
        current_battery: 1_234,
        battery_remaining: 80,
        onboard_control_sensors_health: MavSysStatusSensor::GEOFENCE,
        ..SysStatus::UNKNOWN
    };
    assert_eq!(battery(&cells).sys_status(33.34), expected);
    assert_eq!(Battery::UNKNOWN.battery_status(), BatteryStatus::UNKNOWN);
    assert_eq!(Battery::UNKNOWN.sys_status(f32::NAN), SysStatus::UNKNOWN.with_geofence(Geofence::Absent));
}

/// Cells 11 to 14 have a field of their own, where 0 means that there is no such cell, so a dead cell has 1 mV there.
#[test]
fn fourteen_cells_are_sent() {
    let mut cells = [4.0; 16];
    cells[0] = 0.0;
    cells[11] = 0.0;
    let of = |count: usize| {
        let BatteryStatus { voltages, voltages_ext, .. } = battery(&cells[..count]).battery_status();
        (voltages, voltages_ext)
    };
    let ten = [0, 4_000, 4_000, 4_000, 4_000, 4_000, 4_000, 4_000, 4_000, 4_000];
    assert_eq!(of(10), (ten, [0; 4]));
    assert_eq!(of(12), (ten, [4_000, 1, 0, 0]));
    assert_eq!(of(16), (ten, [4_000, 1, 4_000, 4_000]));
}

/// A battery without voltages of cells sends its own in the first entry, and what exceeds 65.534 V in the next ones. SYS_STATUS
/// takes the sum of the cells if the battery's voltage is unknown.
#[test]
fn voltage_of_the_battery_and_of_its_cells_stand_in_for_each_other() {
    let of = |voltage| Battery { voltage, ..Battery::UNKNOWN };
    for (voltage, expected) in [
        (0.0, &[0][..]),
        (-1.0, &[0]),
        (12.6, &[12_600]),
        (65.534, &[65_534]),
        (70.0, &[65_534, 4_466]),
        (400.0, &[65_534, 65_534, 65_534, 65_534, 65_534, 65_534, 6_796]),
        (900.0, &[65_534; 10]),
        (f32::NAN, &[]),
        (f32::INFINITY, &[]),
    ] {
        let mut voltages = [u16::MAX; 10];
        voltages[..expected.len()].copy_from_slice(expected);
        assert_eq!(of(voltage).battery_status().voltages, voltages, "{voltage}");
        let single = if voltage.is_finite() { expected[0] } else { u16::MAX };
        assert_eq!(of(voltage).sys_status(0.0).voltage_battery, single, "{voltage}");
    }
    let cells = |cells| Battery { cells, ..Battery::UNKNOWN }.sys_status(0.0).voltage_battery;
    assert_eq!(cells(&[3.5, 3.6, 3.7]), 10_800);
    assert_eq!(cells(&[3.5, f32::NAN]), u16::MAX, "the sum is unknown");
}

/// A current of about -0.01 A is sent as 0, because -1 means "unknown".
#[test]
fn charging_current_is_not_unknown() {
    for (current, sent) in [
        (-0.004, 0),
        (-0.006, 0),
        (-0.0149, 0),
        (-0.016, -2),
        (-20.0, -2_000),
        (-1e6, -32_767),
        (1e6, 32_767),
        (f32::NAN, -1),
        (f32::INFINITY, -1),
        (f32::NEG_INFINITY, -1),
    ] {
        let battery = Battery { current, ..Battery::UNKNOWN };
        assert_eq!(battery.battery_status().current_battery, sent, "{current}");
        assert_eq!(battery.sys_status(0.0).current_battery, sent, "{current}");
    }
}

#[test]
fn home_is_sent_with_both_of_its_positions() {
    let home = Home { position: ZURICH, altitude: 488.0004, local: [1.5, -2.5, f32::INFINITY] };
    let message = home.home_position(LATE);
    assert_eq!((message.latitude, message.longitude, message.altitude), (473_977_420, 85_455_940, 488_000));
    assert_eq!((message.x, message.y, message.time_usec), (1.5, -2.5, 4_294_967_300_000));
    assert!(message.z.is_nan() && message.q.iter().all(|part| part.is_nan()), "{message:?}");
    assert_eq!((message.approach_x, message.approach_y, message.approach_z), (0.0, 0.0, 0.0));
}

#[test]
fn landed_state_is_sent_without_a_vtol_state() {
    let expected = ExtendedSysState { vtol_state: MavVtolState::UNDEFINED, landed_state: MavLandedState::IN_AIR };
    assert_eq!(extended_sys_state(MavLandedState::IN_AIR), expected);
}

/// A field: its name, the number in the message, the value of one unit of the input, the smallest and the largest number, and the
/// number that is sent for "unknown", which is reserved if it is outside of the two.
type FieldOf = (&'static str, i64, f64, i64, i64, i64);

/// Checks that the number is the nearest one that the field can hold.
fn check(value: f32, (name, sent, scale, min, max, unknown): FieldOf) -> Result<(), TestCaseError> {
    if !value.is_finite() {
        prop_assert_eq!(sent, unknown, "{} for {}", name, value);
        return Ok(());
    }
    let exact = (f64::from(value) * scale).clamp(min as f64, max as f64);
    // The product is rounded to an `f32` once, or twice with the conversion of the scale.
    let error = (sent as f64 - exact).abs();
    prop_assert!(error <= 0.5 + exact.abs() * 3e-7, "{name} for {value}: {sent}, exactly {exact}");
    prop_assert!((min..=max).contains(&sent), "{} for {}: {}", name, value, sent);
    Ok(())
}

/// Any float, and more often one of a plausible size.
fn floats() -> impl Strategy<Value = f32> {
    prop_oneof![any::<u32>().prop_map(f32::from_bits), -400f32..400.0, -1f32..1.0, 60_000f32..70_000.0]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(5_000))]

    /// Each field of GPS_RAW_INT but the angles has the nearest number, and the one for "unknown" exactly if it is unknown.
    #[test]
    fn gps_fields_are_the_nearest_numbers(value in floats()) {
        let fix = GpsFix {
            altitude: value, alt_ellipsoid: value, hdop: value, vdop: value, groundspeed: value, course: value, h_acc: value,
            v_acc: value, vel_acc: value, hdg_acc: value, ..GpsFix::UNKNOWN
        };
        let message = fix.gps_raw_int(LATE);
        let (largest, degrees) = (i64::from(i32::MAX), 180e5 / std::f64::consts::PI);
        for field in [
            ("alt", message.alt.into(), 1e3, i32::MIN.into(), largest, 0),
            ("alt_ellipsoid", message.alt_ellipsoid.into(), 1e3, i32::MIN.into(), largest, 0),
            ("eph", message.eph.into(), 1e2, 0, 65_534, 65_535),
            ("epv", message.epv.into(), 1e2, 0, 65_534, 65_535),
            ("vel", message.vel.into(), 1e2, 0, 65_534, 65_535),
            ("h_acc", message.h_acc.into(), 1e3, 0, largest, 0),
            ("v_acc", message.v_acc.into(), 1e3, 0, largest, 0),
            ("vel_acc", message.vel_acc.into(), 1e3, 0, largest, 0),
            ("hdg_acc", message.hdg_acc.into(), degrees, 0, largest, 0),
        ] {
            check(value, field)?;
        }
    }

    /// Each field of a battery has the nearest number, except a current of about -0.01 A.
    #[test]
    fn battery_fields_are_the_nearest_numbers(value in floats()) {
        let cells = [value; 14];
        let battery = Battery {
            cells: &cells, voltage: value, current: value, charge_consumed: value, energy_consumed: value,
            temperature: value, remaining: value, time_remaining: value,
        };
        let (message, status) = (battery.battery_status(), battery.sys_status(value));
        let largest = i64::from(i32::MAX);
        let voltages = message.voltages.map(|cell| ("voltages", cell.into(), 1e3, 0, 65_534, 65_535));
        let voltages_ext = message.voltages_ext.map(|cell| ("voltages_ext", cell.into(), 1e3, 1, 65_534, 0));
        let rest = [
            ("current_consumed", message.current_consumed.into(), 1.0 / 3.6, 0, largest, -1),
            ("energy_consumed", message.energy_consumed.into(), 1e-2, 0, largest, -1),
            ("temperature", message.temperature.into(), 1e2, -32_768, 32_766, 32_767),
            ("battery_remaining", message.battery_remaining.into(), 1.0, 0, 100, -1),
            ("time_remaining", message.time_remaining.into(), 1.0, 1, largest, 0),
            ("load", status.load.into(), 10.0, 0, 1_000, 0),
            ("voltage_battery", status.voltage_battery.into(), 1e3, 0, 65_534, 65_535),
            ("battery_remaining", status.battery_remaining.into(), 1.0, 0, 100, -1),
        ];
        for field in voltages.into_iter().chain(voltages_ext).chain(rest) {
            check(value, field)?;
        }
        prop_assert_eq!(message.current_battery, status.current_battery);
        if value.is_finite() {
            prop_assert!(message.current_battery != -1);
        }
        if !(-0.02..0.0).contains(&value) {
            check(value, ("current_battery", message.current_battery.into(), 1e2, -32_767, 32_767, -1))?;
        }
    }

    /// Each field of GLOBAL_POSITION_INT, VFR_HUD and HOME_POSITION has the nearest number; a float has the value itself.
    #[test]
    fn motion_fields_are_the_nearest_numbers(value in floats()) {
        let motion = Motion {
            position: Some(ZURICH), altitude: value, relative_altitude: value, velocity: [value; 3], attitude: [value; 3],
            rates: [value; 3], airspeed: value, groundspeed: value, throttle: value,
        };
        let message = motion.global_position_int(LATE).expect("a position");
        let hud = motion.vfr_hud();
        let home = Home { position: ZURICH, altitude: value, local: [value; 3] }.home_position(LATE);
        let largest = i64::from(i32::MAX);
        for field in [
            ("alt", message.alt.into(), 1e3, i32::MIN.into(), largest, 0),
            ("relative_alt", message.relative_alt.into(), 1e3, i32::MIN.into(), largest, 0),
            ("vx", message.vx.into(), 1e2, -32_768, 32_767, 0),
            ("vy", message.vy.into(), 1e2, -32_768, 32_767, 0),
            ("vz", message.vz.into(), 1e2, -32_768, 32_767, 0),
            ("throttle", hud.throttle.into(), 1.0, 0, 100, 0),
            ("altitude", home.altitude.into(), 1e3, i32::MIN.into(), largest, 0),
        ] {
            check(value, field)?;
        }
        let attitude = motion.attitude(LATE);
        let sent = [
            hud.airspeed, hud.groundspeed, hud.alt, -hud.climb, home.x, home.y, home.z, attitude.rollspeed,
            attitude.pitchspeed, attitude.yawspeed,
        ];
        for sent in sent {
            prop_assert!(sent == value || (sent.is_nan() && !value.is_finite()), "{sent} for {value}");
        }
    }

    /// Angles are the same direction as the input, in the range of their field; an unknown angle is sent as unknown.
    #[test]
    fn angles_are_wrapped(angle in prop_oneof![-20f32..20.0, any::<u32>().prop_map(f32::from_bits)]) {
        let motion = Motion { position: Some(ZURICH), attitude: [angle; 3], ..Motion::UNKNOWN };
        let gps = GpsFix { course: angle, yaw: angle, ..GpsFix::UNKNOWN }.gps_raw_int(LATE);
        let position = motion.global_position_int(LATE).expect("a position");
        let (attitude, heading) = (motion.attitude(LATE), motion.vfr_hud().heading);
        prop_assert_eq!(position.hdg, gps.cog);
        if !angle.is_finite() {
            prop_assert_eq!((gps.cog, gps.yaw, heading), (u16::MAX, 0, 0));
            prop_assert!(attitude.roll.is_nan() && attitude.pitch.is_nan() && attitude.yaw.is_nan());
            return Ok(());
        }
        prop_assert!(gps.cog < 36_000 && (1..=36_000).contains(&gps.yaw) && (0..360).contains(&heading));
        prop_assert_eq!(gps.yaw % 36_000, gps.cog);
        // A float has a fraction of a degree only if it is small.
        if angle.abs() < 20.0 {
            let degrees = f64::from(angle).to_degrees();
            let apart = |sent: f64| ((sent - degrees + 180.0).rem_euclid(360.0) - 180.0).abs();
            prop_assert!(apart(f64::from(gps.cog) / 100.0) <= 0.005_2, "{} for {degrees}", gps.cog);
            prop_assert!(apart(heading.into()) <= 0.500_2, "{heading} for {degrees}");
            for sent in [attitude.roll, attitude.pitch, attitude.yaw] {
                prop_assert!(sent.abs() <= PI + 1e-5 && apart(f64::from(sent).to_degrees()) <= 1e-3, "{sent}");
                prop_assert!(sent == angle || angle.abs() >= PI);
            }
        }
    }
}

/// Prints each field of the frames in its arguments in SI units, by pymavlink's own table of units.
const DECODE: &str = "
import sys
from pymavlink.dialects.v20 import common
SI = {'degE7': 1e-7, 'mm': 1e-3, 'cm/s': 1e-2, 'mm/s': 1e-3, 'mV': 1e-3, 'cA': 1e-2, 'd%': 0.1, 'cdegC': 1e-2, 'mAh': 3.6,
      'hJ': 100, 'us': 1e-6, 'ms': 1e-3, 'cdeg': 3.141592653589793 / 18000, 'degE5': 3.141592653589793 / 18000000,
      'deg': 3.141592653589793 / 180, 'rad': 1, 'rad/s': 1, 'm': 1, 'm/s': 1, 's': 1, '%': 1}
for frame in sys.argv[1:]:
    message = common.MAVLink(None).decode(bytearray.fromhex(frame))
    for field in message.get_fieldnames():
        unit = message.fieldunits_by_name.get(field)
        value = getattr(message, field)
        for value in value if isinstance(value, list) else [value]:
            if unit in SI:
                print(message.get_type(), field, value * SI[unit])
";

/// pymavlink decodes the values that were given.
#[test]
fn pymavlink_decodes_the_same_values() {
    fn frame<M: Message>(message: &M) -> String {
        let mut bytes = [0; 300];
        let len = encode(message, Version::V2, Address::new(1, 1), 0, &mut bytes).expect("it has room");
        bytes[..len].iter().map(|byte| format!("{byte:02x}")).collect()
    }
    let Some(python) = pymavlink::python() else { return };
    let now = Instant::from_millis(1_500);
    let home = Home { position: ZURICH, altitude: 488.0, local: [1.5, -2.5, 0.25] };
    let battery = battery(&[3.7, 3.6]);
    let frames = [
        frame(&motion().attitude(now)),
        frame(&motion().global_position_int(now).expect("a position")),
        frame(&motion().vfr_hud()),
        frame(&gps_fix().gps_raw_int(now)),
        frame(&battery.battery_status()),
        frame(&battery.sys_status(20.0)),
        frame(&home.home_position(now)),
    ];
    let output = Command::new(python).args(["-c", DECODE]).args(frames).output().expect("python runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let printed = String::from_utf8(output.stdout).expect("text");
    let wanted: &[(&str, f64, f64)] = &[
        ("ATTITUDE time_boot_ms", 1.5, 0.0),
        ("ATTITUDE roll", 0.1, 1e-6),
        ("ATTITUDE yaw", -FRAC_PI_2, 1e-6),
        ("ATTITUDE yawspeed", -0.03, 1e-6),
        ("GLOBAL_POSITION_INT lat", 47.397_742, 1e-9),
        ("GLOBAL_POSITION_INT lon", 8.545_594, 1e-9),
        ("GLOBAL_POSITION_INT alt", 488.123_4, 5e-4),
        ("GLOBAL_POSITION_INT relative_alt", -0.987_6, 5e-4),
        ("GLOBAL_POSITION_INT vx", 3.456, 5e-3),
        ("GLOBAL_POSITION_INT vz", -1.25, 5e-3),
        ("GLOBAL_POSITION_INT hdg", 3.0 * FRAC_PI_2, 1e-4),
        ("VFR_HUD airspeed", 4.5, 1e-6),
        ("VFR_HUD climb", 1.25, 1e-6),
        ("VFR_HUD heading", 3.0 * FRAC_PI_2, 1e-2),
        ("VFR_HUD throttle", 49.6, 0.5),
        ("GPS_RAW_INT time_usec", 1.5, 1e-9),
        ("GPS_RAW_INT alt", 488.123_4, 5e-4),
        ("GPS_RAW_INT vel", 12.345, 5.1e-3),
        ("GPS_RAW_INT cog", 2.0 * FRAC_PI_2, 1e-4),
        ("GPS_RAW_INT alt_ellipsoid", 535.999_9, 5e-4),
        ("GPS_RAW_INT h_acc", 0.014_2, 5e-4),
        ("GPS_RAW_INT v_acc", 0.021_8, 5e-4),
        ("GPS_RAW_INT vel_acc", 0.05, 5e-4),
        ("GPS_RAW_INT hdg_acc", 0.01, 1e-6),
        ("GPS_RAW_INT yaw", 0.5, 1e-4),
        ("BATTERY_STATUS temperature", -3.756, 5e-3),
        ("BATTERY_STATUS voltages", 3.7, 5e-4),
        ("BATTERY_STATUS current_battery", 12.344, 5e-3),
        ("BATTERY_STATUS current_consumed", 3_600.0, 1.8),
        ("BATTERY_STATUS energy_consumed", 39_960.0, 50.0),
        ("BATTERY_STATUS battery_remaining", 79.5, 0.5),
        ("BATTERY_STATUS time_remaining", 754.4, 0.5),
        ("SYS_STATUS load", 20.0, 0.05),
        ("SYS_STATUS voltage_battery", 11.1, 5e-4),
        ("SYS_STATUS current_battery", 12.344, 5e-3),
        ("SYS_STATUS battery_remaining", 79.5, 0.5),
        ("HOME_POSITION latitude", 47.397_742, 1e-9),
        ("HOME_POSITION altitude", 488.0, 5e-4),
        ("HOME_POSITION y", -2.5, 1e-6),
    ];
    for (field, value, tolerance) in wanted {
        let found = printed.lines().find_map(|line| line.strip_prefix(&format!("{field} ")));
        let found: f64 = found.unwrap_or_else(|| panic!("no {field} in:\n{printed}")).parse().expect("a number");
        assert!((found - value).abs() <= *tolerance, "{field}: {found}, given {value}");
    }
}

/// The bits of SYS_STATUS by which ground stations know the geofence. Those of other sensors stay.
#[test]
fn geofence_has_its_bits() {
    let fence = MavSysStatusSensor::GEOFENCE;
    let gps = MavSysStatusSensor::SENSOR_GPS;
    let other = SysStatus {
        onboard_control_sensors_present: gps,
        onboard_control_sensors_enabled: gps | fence,
        onboard_control_sensors_health: gps,
        ..SysStatus::UNKNOWN
    };
    let item = [mavstack::Item::default()];
    for (state, bits) in [
        (Geofence::of(&[], true), [gps, gps, gps | fence]),
        (Geofence::Disabled, [gps | fence, gps, gps | fence]),
        (Geofence::of(&item, false), [gps | fence; 3]),
        (Geofence::of(&item, true), [gps | fence, gps | fence, gps]),
    ] {
        let status = other.with_geofence(state);
        let sensors = [
            status.onboard_control_sensors_present,
            status.onboard_control_sensors_enabled,
            status.onboard_control_sensors_health,
        ];
        assert_eq!(sensors, bits, "{state:?}");
    }
}
