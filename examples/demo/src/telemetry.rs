//! Telemetry: the messages that the vehicle fills, and their rates.

use libm::{atan2f, roundf, sqrtf};
use mavstack::dialect::{
    Attitude, AttitudeQuaternion, BatteryStatus, ComponentMetadata, ExtendedSysState, FlightInformation,
    GimbalDeviceSetAttitude, GlobalPositionInt, GpsFixType, GpsGlobalOrigin, GpsRawInt, HomePosition, LocalPositionNed,
    MavBatteryChargeState, MavBatteryFunction, MavBatteryType, MavDataStream, MavLandedState,
    MavSysStatusSensor as Sensor, RcChannels, SysStatus, SystemTime, VfrHud,
};
use mavstack::{Duration, Fill, Instant, Message, Stream, Telemetry};

use crate::angle::{cos, sin};
use crate::battery::{Battery, Charge};
use crate::body::Vector;
use crate::geo::Home;
use crate::vehicle::{GPS_ERROR, Quadrotor, Times};

/// The telemetry streams. On the radio link they need less than 800 bytes/s, heartbeats included: a seventh of 57,600 bit/s.
const STREAMS: &[Stream] = &[
    stream::<SysStatus>(1_000, 500).in_group(MavDataStream::EXTENDED_STATUS),
    stream::<SystemTime>(1_000, 1_000).in_group(MavDataStream::EXTRA3),
    stream::<GpsRawInt>(1_000, 200).in_group(MavDataStream::EXTENDED_STATUS),
    stream::<Attitude>(250, 20).in_group(MavDataStream::EXTRA1),
    // On request only on the radio, which carries ATTITUDE already.
    Stream::of::<AttitudeQuaternion>().onboard(millis(20)).in_group(MavDataStream::EXTRA1),
    stream::<LocalPositionNed>(500, 33).in_group(MavDataStream::POSITION),
    stream::<GlobalPositionInt>(250, 33).in_group(MavDataStream::POSITION),
    stream::<VfrHud>(250, 100).in_group(MavDataStream::EXTRA2),
    stream::<BatteryStatus>(2_000, 1_000).in_group(MavDataStream::EXTRA3),
    stream::<HomePosition>(5_000, 2_000),
    stream::<RcChannels>(2_000, 500).in_group(MavDataStream::RC_CHANNELS),
    Stream::of::<FlightInformation>(),
    Stream::of::<GpsGlobalOrigin>(),
    Stream::of::<ComponentMetadata>(),
    stream::<ExtendedSysState>(1_000, 200).in_group(MavDataStream::EXTENDED_STATUS),
];

const fn stream<M: Message>(radio: u64, onboard: u64) -> Stream {
    Stream::of::<M>().every(millis(radio)).onboard(millis(onboard))
}

const fn millis(n: u64) -> Duration {
    Duration::from_millis(n)
}

impl Telemetry for Quadrotor {
    const STREAMS: &'static [Stream] = STREAMS;

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let now = out.now();
        match id {
            SysStatus::ID => put(out, || self.sys_status()),
            SystemTime::ID => put(out, || self.system_time(now)),
            GpsRawInt::ID => put(out, || self.gps_raw(now)),
            Attitude::ID => put(out, || self.attitude_angles(now)),
            AttitudeQuaternion::ID => put(out, || self.attitude_quaternion(now)),
            LocalPositionNed::ID => put(out, || self.local_position_ned(now)),
            GlobalPositionInt::ID => match self.global_position_int(now) {
                Some(message) => out.put(&message),
                None => false,
            },
            VfrHud::ID => put(out, || self.vfr_hud()),
            // The vehicle has one battery.
            BatteryStatus::ID if out.index() == 0 => put(out, || self.battery_status()),
            GpsGlobalOrigin::ID if self.has_fix() => put(out, || self.origin(now)),
            HomePosition::ID if self.has_fix() => put(out, || self.home_position(now)),
            FlightInformation::ID => put(out, || self.flight_information(now)),
            GimbalDeviceSetAttitude::ID => self.put_gimbal_attitude(out),
            ComponentMetadata::ID => self.put_metadata(out),
            RcChannels::ID => put(out, || self.rc_channels(now)),
            ExtendedSysState::ID => {
                out.put(&ExtendedSysState { landed_state: self.landed_state(), ..ExtendedSysState::UNKNOWN })
            }
            _ => false,
        }
    }
}

/// Puts a message. Not inlined, so that only the message that is sent takes stack.
#[inline(never)]
fn put<M: Message>(out: &mut Fill<'_>, message: impl FnOnce() -> M) -> bool {
    out.put(&message())
}

impl Quadrotor {
    pub(crate) fn sys_status(&self) -> SysStatus {
        let battery = self.battery();
        let present = Sensor::SENSOR_3D_GYRO
            | Sensor::SENSOR_3D_ACCEL
            | Sensor::SENSOR_3D_MAG
            | Sensor::SENSOR_ABSOLUTE_PRESSURE
            | Sensor::SENSOR_GPS
            | Sensor::SENSOR_ANGULAR_RATE_CONTROL
            | Sensor::SENSOR_ATTITUDE_STABILIZATION
            | Sensor::SENSOR_YAW_POSITION
            | Sensor::SENSOR_Z_ALTITUDE_CONTROL
            | Sensor::SENSOR_XY_POSITION_CONTROL
            | Sensor::SENSOR_MOTOR_OUTPUTS
            | Sensor::GEOFENCE
            | Sensor::AHRS
            | Sensor::SENSOR_BATTERY
            | Sensor::PREARM_CHECK;
        let enabled = if self.is_armed() { present } else { present.without(Sensor::SENSOR_MOTOR_OUTPUTS) };
        let needs_fix = Sensor::SENSOR_GPS | Sensor::SENSOR_XY_POSITION_CONTROL;
        let mut health = if self.has_fix() { present } else { present.without(needs_fix) };
        if !self.is_armed() && !self.last().is_ready {
            health = health.without(Sensor::PREARM_CHECK);
        }
        if battery.is_low() {
            health = health.without(Sensor::SENSOR_BATTERY);
        }
        SysStatus {
            onboard_control_sensors_present: present,
            onboard_control_sensors_enabled: enabled,
            onboard_control_sensors_health: health,
            // 20 %: 2 ms in every 10 ms.
            load: 200,
            voltage_battery: scaled(battery.voltage, 1e3) as u16,
            current_battery: scaled(battery.current, 1e2) as i16,
            battery_remaining: percent(battery),
            ..SysStatus::UNKNOWN
        }
    }

    /// Not inlined, because only this message needs a large stack frame.
    #[inline(never)]
    fn put_metadata(&self, out: &mut Fill<'_>) -> bool {
        let Some(&metadata) = self.metadata() else { return false };
        out.put(&ComponentMetadata { time_boot_ms: boot_ms(out.now()), ..metadata })
    }

    fn gps_raw(&self, now: Instant) -> GpsRawInt {
        let Some(position) = self.global_position() else {
            return GpsRawInt {
                time_usec: now.as_micros(),
                fix_type: GpsFixType::NO_FIX,
                satellites_visible: 3,
                ..GpsRawInt::UNKNOWN
            };
        };
        let Vector { north, east, .. } = self.velocity();
        let speed = self.ground_speed();
        GpsRawInt {
            time_usec: now.as_micros(),
            lat: position.latitude,
            lon: position.longitude,
            alt: scaled(position.altitude, 1e3),
            eph: 80,
            epv: 120,
            vel: scaled(speed, 1e2) as u16,
            // No course when the vehicle does not move.
            cog: if speed > 0.1 { compass(atan2f(east, north)) } else { GpsRawInt::UNKNOWN.cog },
            fix_type: GpsFixType::_3D_FIX,
            satellites_visible: self.last().satellites,
            alt_ellipsoid: scaled(position.altitude + f32::from(self.last().geoid_separation), 1e3),
            h_acc: scaled(GPS_ERROR.0, 1e3) as u32,
            v_acc: scaled(GPS_ERROR.1, 1e3) as u32,
            vel_acc: 100,
            ..GpsRawInt::UNKNOWN
        }
    }

    fn attitude_angles(&self, now: Instant) -> Attitude {
        let [roll, pitch, yaw] = self.attitude();
        let [rollspeed, pitchspeed, yawspeed] = self.attitude_rates();
        Attitude { time_boot_ms: boot_ms(now), roll, pitch, yaw, rollspeed, pitchspeed, yawspeed }
    }

    fn attitude_quaternion(&self, now: Instant) -> AttitudeQuaternion {
        let [rollspeed, pitchspeed, yawspeed] = self.attitude_rates();
        let [roll, pitch, yaw] = self.attitude().map(|angle| (cos(angle / 2.0), sin(angle / 2.0)));
        AttitudeQuaternion {
            time_boot_ms: boot_ms(now),
            q1: roll.0 * pitch.0 * yaw.0 + roll.1 * pitch.1 * yaw.1,
            q2: roll.1 * pitch.0 * yaw.0 - roll.0 * pitch.1 * yaw.1,
            q3: roll.0 * pitch.1 * yaw.0 + roll.1 * pitch.0 * yaw.1,
            q4: roll.0 * pitch.0 * yaw.1 - roll.1 * pitch.1 * yaw.0,
            rollspeed,
            pitchspeed,
            yawspeed,
            ..AttitudeQuaternion::UNKNOWN
        }
    }

    fn local_position_ned(&self, now: Instant) -> LocalPositionNed {
        let (position, velocity) = (self.local_position(), self.velocity());
        LocalPositionNed {
            time_boot_ms: boot_ms(now),
            x: position.north,
            y: position.east,
            z: position.down,
            vx: velocity.north,
            vy: velocity.east,
            vz: velocity.down,
        }
    }

    fn global_position_int(&self, now: Instant) -> Option<GlobalPositionInt> {
        let position = self.global_position()?;
        let velocity = self.velocity();
        let [_, _, yaw] = self.attitude();
        Some(GlobalPositionInt {
            time_boot_ms: boot_ms(now),
            lat: position.latitude,
            lon: position.longitude,
            alt: scaled(position.altitude, 1e3),
            relative_alt: scaled(self.home().spot.down - self.local_position().down, 1e3),
            vx: scaled(velocity.north, 1e2) as i16,
            vy: scaled(velocity.east, 1e2) as i16,
            vz: scaled(velocity.down, 1e2) as i16,
            hdg: compass(yaw),
        })
    }

    pub(crate) fn vfr_hud(&self) -> VfrHud {
        let [_, _, yaw] = self.attitude();
        VfrHud {
            // No wind is simulated.
            airspeed: self.ground_speed(),
            groundspeed: self.ground_speed(),
            alt: self.home().altitude - self.local_position().down,
            climb: -self.velocity().down,
            heading: (compass(yaw) / 100) as i16,
            throttle: match self.is_armed() {
                false => 0,
                true if self.is_landed() => 10,
                true => 50,
            },
        }
    }

    fn battery_status(&self) -> BatteryStatus {
        let battery = self.battery();
        let mut voltages = BatteryStatus::UNKNOWN.voltages;
        for cell in voltages.iter_mut().take(usize::from(battery.cells)) {
            *cell = scaled(battery.voltage / f32::from(battery.cells), 1e3) as u16;
        }
        let seconds = if battery.current > 0.0 { battery.remaining * battery.capacity / battery.current } else { 0.0 };
        BatteryStatus {
            // 1 mAh is 3.6 A·s.
            current_consumed: scaled((1.0 - battery.remaining) * battery.capacity, 1.0 / 3.6),
            voltages,
            current_battery: scaled(battery.current, 1e2) as i16,
            battery_function: MavBatteryFunction::ALL,
            r#type: MavBatteryType::LIPO,
            battery_remaining: percent(battery),
            time_remaining: seconds as i32,
            charge_state: match battery.charge {
                Charge::Critical => MavBatteryChargeState::CRITICAL,
                Charge::Low => MavBatteryChargeState::LOW,
                Charge::Good => MavBatteryChargeState::OK,
            },
            ..BatteryStatus::UNKNOWN
        }
    }

    /// Returns the origin of LOCAL_POSITION_NED.
    fn origin(&self, now: Instant) -> GpsGlobalOrigin {
        let Home { latitude, longitude, altitude, .. } = self.home();
        GpsGlobalOrigin { latitude, longitude, altitude: scaled(altitude, 1e3), time_usec: now.as_micros() }
    }

    fn home_position(&self, now: Instant) -> HomePosition {
        let home = self.home();
        let Vector { north, east, down } = home.spot;
        let (latitude, longitude) = home.to_global(north, east);
        HomePosition {
            latitude,
            longitude,
            altitude: scaled(home.altitude - down, 1e3),
            x: north,
            y: east,
            z: down,
            // Level ground, heading north; the approach is vertical.
            q: [1.0, 0.0, 0.0, 0.0],
            approach_z: -1.0,
            time_usec: now.as_micros(),
            ..HomePosition::UNKNOWN
        }
    }

    /// The times count from boot, although two of the fields are named UTC.
    fn flight_information(&self, now: Instant) -> FlightInformation {
        let Times { armed, took_off, landed } = self.times();
        FlightInformation {
            time_boot_ms: boot_ms(now),
            arming_time_utc: armed.as_micros(),
            takeoff_time_utc: took_off.as_micros(),
            landing_time: boot_ms(landed),
            flight_uuid: self.last().flights.into(),
        }
    }

    fn landed_state(&self) -> MavLandedState {
        if self.is_landed() {
            MavLandedState::ON_GROUND
        } else if self.is_taking_off() {
            MavLandedState::TAKEOFF
        } else if self.is_landing() {
            MavLandedState::LANDING
        } else {
            MavLandedState::IN_AIR
        }
    }

    /// Returns the horizontal speed (m/s).
    fn ground_speed(&self) -> f32 {
        let Vector { north, east, .. } = self.velocity();
        sqrtf(north * north + east * east)
    }
}

/// Returns `time_boot_ms`, which wraps after 49 days (D-1).
fn boot_ms(now: Instant) -> u32 {
    now.as_millis() as u32
}

/// Converts a value to the unit of a field, rounded.
fn scaled(value: f32, scale: f32) -> i32 {
    roundf(value * scale) as i32
}

fn percent(battery: Battery) -> i8 {
    scaled(battery.remaining, 100.0) as i8
}

/// Converts a heading (rad) to hundredths of degrees, 0 to 35,999.
fn compass(angle: f32) -> u16 {
    scaled(angle.to_degrees(), 100.0).rem_euclid(36_000) as u16
}
