//! Telemetry: the messages that the vehicle fills, and their rates.

use libm::{atan2f, sqrtf};
use mavstack::dialect::{
    Attitude, AttitudeQuaternion, BatteryStatus, ComponentMetadata, ExtendedSysState, FlightInformation,
    GimbalDeviceSetAttitude, GlobalPositionInt, GpsFixType, GpsGlobalOrigin, GpsRawInt, HomePosition, LocalPositionNed,
    MavBatteryChargeState, MavBatteryFunction, MavBatteryType, MavDataStream, MavLandedState,
    MavSysStatusSensor as Sensor, RcChannels, ServoOutputRaw, SysStatus, SystemTime, VfrHud,
};
use mavstack::message::LatLon;
use mavstack::telemetry::{self, GpsFix, Motion, extended_sys_state};
use mavstack::{Duration, Fill, Instant, Message, Stream, Telemetry};

use crate::angle::{cos, sin};
use crate::battery::Charge;
use crate::body::Vector;
use crate::files;
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
    stream::<BatteryStatus>(10_000, 5_000).instance(AVIONICS).in_group(MavDataStream::EXTRA3),
    stream::<HomePosition>(5_000, 2_000),
    stream::<RcChannels>(2_000, 500).in_group(MavDataStream::RC_CHANNELS),
    Stream::of::<ServoOutputRaw>().in_group(MavDataStream::RC_CHANNELS),
    Stream::of::<FlightInformation>(),
    Stream::of::<GpsGlobalOrigin>(),
    Stream::of::<ComponentMetadata>(),
    stream::<ExtendedSysState>(1_000, 200).in_group(MavDataStream::EXTENDED_STATUS),
];

/// The number of the battery of the avionics. The battery of the motors is 0.
const AVIONICS: u16 = 1;

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
            GpsRawInt::ID => put(out, || self.gps_fix().gps_raw_int(now)),
            Attitude::ID => put(out, || self.motion().attitude(now)),
            AttitudeQuaternion::ID => put(out, || self.attitude_quaternion(now)),
            LocalPositionNed::ID => put(out, || self.local_position_ned(now)),
            GlobalPositionInt::ID => self.put_global_position(out),
            VfrHud::ID => put(out, || self.motion().vfr_hud()),
            BatteryStatus::ID if out.index() == 0 => put(out, || self.battery_status()),
            BatteryStatus::ID if out.index() == AVIONICS => put(out, avionics_status),
            GpsGlobalOrigin::ID if self.has_fix() => put(out, || self.origin(now)),
            HomePosition::ID if self.has_fix() => put(out, || self.home_position(now)),
            FlightInformation::ID => put(out, || self.flight_information(now)),
            GimbalDeviceSetAttitude::ID => self.put_gimbal_attitude(out),
            ComponentMetadata::ID => Self::put_metadata(out),
            ServoOutputRaw::ID => put(out, || self.servo_output(now)),
            RcChannels::ID => put(out, || self.rc_channels(now)),
            ExtendedSysState::ID => put(out, || extended_sys_state(self.landed_state())),
            _ => false,
        }
    }
}

/// Returns BATTERY_STATUS of the avionics' battery. It has two cells, and only their voltage is measured.
fn avionics_status() -> BatteryStatus {
    let battery = telemetry::Battery { cells: &[4.05, 4.06], ..telemetry::Battery::UNKNOWN };
    let mut status = battery.battery_status();
    (status.id, status.battery_function, status.r#type) = (1, MavBatteryFunction::AVIONICS, MavBatteryType::LION);
    status
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
            ..self.pack(&[]).sys_status(20.0)
        }
        .with_geofence(self.last().fence)
    }

    #[inline(never)]
    fn put_global_position(&self, out: &mut Fill<'_>) -> bool {
        let message = self.global_position_int(out.now());
        message.is_some_and(|message| out.put(&message))
    }

    /// Not inlined, because only this message needs a large stack frame.
    #[inline(never)]
    fn put_metadata(out: &mut Fill<'_>) -> bool {
        out.put(&ComponentMetadata { time_boot_ms: out.now().time_boot_ms(), ..files::METADATA })
    }

    fn gps_fix(&self) -> GpsFix {
        let Some(position) = self.global_position() else {
            return GpsFix { fix_type: GpsFixType::NO_FIX, satellites: Some(3), ..GpsFix::UNKNOWN };
        };
        let Vector { north, east, .. } = self.velocity();
        let speed = self.ground_speed();
        GpsFix {
            fix_type: GpsFixType::_3D_FIX,
            position: Some(position.into()),
            altitude: position.altitude,
            alt_ellipsoid: position.altitude + self.last().geoid_separation as f32,
            hdop: 0.8,
            vdop: 1.2,
            groundspeed: speed,
            // No course when the vehicle does not move.
            course: if speed > 0.1 { atan2f(east, north) } else { f32::NAN },
            satellites: Some(self.last().satellites),
            h_acc: GPS_ERROR.0,
            v_acc: GPS_ERROR.1,
            vel_acc: 0.1,
            ..GpsFix::UNKNOWN
        }
    }

    /// Returns the motion without the position, which only one message has.
    pub(crate) fn motion(&self) -> Motion {
        let Vector { north, east, down } = self.velocity();
        let height = -self.local_position().down;
        Motion {
            position: None,
            altitude: self.home().altitude + height,
            relative_altitude: self.home().spot.down + height,
            velocity: [north, east, down],
            attitude: self.attitude(),
            rates: self.attitude_rates(),
            // No wind is simulated.
            airspeed: self.ground_speed(),
            groundspeed: self.ground_speed(),
            throttle: match self.is_armed() {
                false => 0.0,
                true if self.is_landed() => 10.0,
                true => 50.0,
            },
        }
    }

    fn global_position_int(&self, now: Instant) -> Option<GlobalPositionInt> {
        // In place: it is large.
        let mut motion = self.motion();
        motion.position = self.global_position().map(LatLon::from);
        motion.global_position_int(now)
    }

    fn attitude_quaternion(&self, now: Instant) -> AttitudeQuaternion {
        let [rollspeed, pitchspeed, yawspeed] = self.attitude_rates();
        let [roll, pitch, yaw] = self.attitude().map(|angle| (cos(angle / 2.0), sin(angle / 2.0)));
        AttitudeQuaternion {
            time_boot_ms: now.time_boot_ms(),
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
            time_boot_ms: now.time_boot_ms(),
            x: position.north,
            y: position.east,
            z: position.down,
            vx: velocity.north,
            vy: velocity.east,
            vz: velocity.down,
        }
    }

    /// Returns the battery; `cells` are the voltages of its cells, if they are to be reported.
    fn pack<'a>(&self, cells: &'a [f32]) -> telemetry::Battery<'a> {
        let battery = self.battery();
        telemetry::Battery {
            cells,
            voltage: battery.voltage,
            current: battery.current,
            charge_consumed: (1.0 - battery.remaining) * battery.capacity,
            remaining: 100.0 * battery.remaining,
            // Without a current the division gives infinity or NaN: unknown.
            time_remaining: battery.remaining * battery.capacity / battery.current,
            ..telemetry::Battery::UNKNOWN
        }
    }

    fn battery_status(&self) -> BatteryStatus {
        let battery = self.battery();
        // At most as many as BAT_N_CELLS.
        let cells = [battery.voltage / f32::from(battery.cells); 10];
        let cells = cells.get(..usize::from(battery.cells)).unwrap_or(&cells);
        // Completed in place: the message is large.
        let mut status = self.pack(cells).battery_status();
        status.battery_function = MavBatteryFunction::ALL;
        status.r#type = MavBatteryType::LIPO;
        status.charge_state = match battery.charge {
            Charge::Critical => MavBatteryChargeState::CRITICAL,
            Charge::Low => MavBatteryChargeState::LOW,
            Charge::Good => MavBatteryChargeState::OK,
        };
        status
    }

    /// Returns the outputs: the motors have 1 to 4, which are 1,000 µs while they stand still; the servos 5 to 8.
    fn servo_output(&self, now: Instant) -> ServoOutputRaw {
        let motor = if self.is_armed() { 1_500 } else { 1_000 };
        let [servo5_raw, servo6_raw, servo7_raw, servo8_raw] = self.servos();
        let [servo1_raw, servo2_raw, servo3_raw, servo4_raw] = [motor; 4];
        ServoOutputRaw {
            time_usec: now.as_micros() as u32,
            servo1_raw,
            servo2_raw,
            servo3_raw,
            servo4_raw,
            servo5_raw,
            servo6_raw,
            servo7_raw,
            servo8_raw,
            ..ServoOutputRaw::UNKNOWN
        }
    }

    /// Returns the origin of LOCAL_POSITION_NED.
    fn origin(&self, now: Instant) -> GpsGlobalOrigin {
        let Home { latitude, longitude, altitude, .. } = self.home();
        let millimetres = 1e3 * altitude + 0.5_f32.copysign(altitude);
        GpsGlobalOrigin { latitude, longitude, altitude: millimetres as i32, time_usec: now.as_micros() }
    }

    fn home_position(&self, now: Instant) -> HomePosition {
        let home = self.home();
        let Vector { north, east, down } = home.spot;
        let (latitude, longitude) = home.to_global(north, east);
        let home = telemetry::Home {
            position: LatLon { latitude, longitude },
            altitude: home.altitude - down,
            local: [north, east, down],
        };
        // Level ground, heading north; the approach is vertical.
        HomePosition { q: [1.0, 0.0, 0.0, 0.0], approach_z: -1.0, ..home.home_position(now) }
    }

    /// The times count from boot, although two of the fields are named UTC.
    fn flight_information(&self, now: Instant) -> FlightInformation {
        let Times { armed, took_off, landed } = self.times();
        FlightInformation {
            time_boot_ms: now.time_boot_ms(),
            arming_time_utc: armed.as_micros(),
            takeoff_time_utc: took_off.as_micros(),
            landing_time: landed.time_boot_ms(),
            flight_uuid: self.last().flights as u64,
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
