//! Telemetry during a flight: the messages agree with the vehicle and with each other.

use std::collections::BTreeMap;

use crate::support::command;
use crate::support::wire::Wire;
use mavstack::command::CommandPosition;
use mavstack::dialect::*;
use mavstack::{Command, Commands, Instant, LinkId, Message};
use mavstack_demo::{COMPANION, LINKS, TELEMETRY, Tuning};

/// The vehicle, and for each link the last message of each type and its count.
struct Flight {
    wire: Wire,
    last: [BTreeMap<u32, Vec<u8>>; LINKS],
    counts: [BTreeMap<u32, u32>; LINKS],
}

impl Flight {
    fn new() -> Self {
        Self { wire: Wire::new(), last: Default::default(), counts: Default::default() }
    }

    /// Runs the flight loop once per millisecond, and calls `check` after each pass.
    fn run(&mut self, millis: u64, mut check: impl FnMut(&Self)) {
        for _ in 0..millis {
            self.wire.run(1);
            for frame in self.wire.received.drain(..) {
                let link = usize::from(frame.link.0);
                *self.counts[link].entry(frame.id).or_default() += 1;
                // Of the two batteries, the first.
                if frame.id != BatteryStatus::ID || BatteryStatus::decode(&frame.payload).id == 0 {
                    self.last[link].insert(frame.id, frame.payload);
                }
            }
            check(self);
        }
    }

    fn command(&mut self, id: MavCmd, first: f32, z: f32) {
        self.send(&Command { z, ..command(id, [first, 0.0, 0.0, 0.0]) });
    }

    fn reposition(&mut self, param5: f32, param6: f32) {
        let position = CommandPosition::Long { param5, param6 };
        let params = [f32::NAN, 1.0, f32::NAN, f32::NAN];
        self.send(&Command { position, z: f32::NAN, ..command(MavCmd::DO_REPOSITION, params) });
    }

    fn send(&mut self, command: &Command) {
        let (stack, vehicle) = self.wire.app.parts();
        let now = Instant::from_millis(self.wire.millis);
        let outcome = stack.with_context(now, |cx| vehicle.command(cx, command));
        assert_eq!(outcome.result, MavResult::ACCEPTED, "{:?}", command.id);
    }

    /// Announces FLIGHT_INFORMATION, which otherwise is sent on request only.
    fn announce_flight_information(&mut self) {
        self.wire.app.parts().0.announce::<FlightInformation>();
        self.run(10, |_| {});
    }

    /// Returns the last `M` received on a link.
    fn get<M: Message>(&self, link: LinkId) -> M {
        let payload = self.last[usize::from(link.0)].get(&M::ID);
        M::decode(payload.unwrap_or_else(|| panic!("no {} on link {}", M::NAME, link.0)))
    }

    fn has<M: Message>(&self, link: LinkId) -> bool {
        self.last[usize::from(link.0)].contains_key(&M::ID)
    }
}

/// Before the first GPS fix no position and no home are sent, and the GPS is not healthy.
#[test]
fn no_position_before_the_first_fix() {
    let mut flight = Flight::new();
    flight.run(1_500, |_| {});
    assert!(!flight.has::<GlobalPositionInt>(TELEMETRY) && !flight.has::<HomePosition>(COMPANION));
    let gps: GpsRawInt = flight.get(TELEMETRY);
    assert_eq!((gps.fix_type, gps.lat, gps.eph), (GpsFixType::NO_FIX, 0, u16::MAX));
    // Zero would mean a measured value.
    assert_eq!((gps.epv, gps.vel, gps.cog, gps.yaw), (u16::MAX, u16::MAX, u16::MAX, 0));
    let has_gps = |status: SysStatus| {
        let sensor = MavSysStatusSensor::SENSOR_GPS;
        (
            status.onboard_control_sensors_present.contains(sensor),
            status.onboard_control_sensors_health.contains(sensor),
        )
    };
    assert_eq!(has_gps(flight.get(TELEMETRY)), (true, false));
    flight.run(6_000, |_| {});
    assert_eq!(has_gps(flight.get(TELEMETRY)), (true, true));
    let (home, gps): (HomePosition, GpsRawInt) = (flight.get(TELEMETRY), flight.get(TELEMETRY));
    assert_eq!((home.latitude, home.longitude, home.altitude), (473_977_420, 85_455_940, 488_000));
    assert_eq!(
        (gps.lat, gps.lon, gps.alt, gps.fix_type),
        (home.latitude, home.longitude, 488_000, GpsFixType::_3D_FIX)
    );
    assert_eq!(gps.cog, u16::MAX, "no course when it does not move");
}

/// The messages describe a takeoff, a flight and a landing consistently.
#[test]
fn messages_describe_the_flight() {
    let mut flight = Flight::new();
    flight.run(3_000, |_| {});
    assert_eq!(flight.get::<ExtendedSysState>(COMPANION).landed_state, MavLandedState::ON_GROUND);
    flight.command(MavCmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    flight.command(MavCmd::NAV_TAKEOFF, 0.0, 20.0);
    flight.run(3_000, |_| {});
    assert_eq!(flight.get::<ExtendedSysState>(COMPANION).landed_state, MavLandedState::TAKEOFF);
    let hud: VfrHud = flight.get(TELEMETRY);
    assert!(hud.climb > 1.0 && hud.throttle > 0 && hud.alt > 489.0, "{hud:?}");
    let mut apart = 0;
    flight.run(10_000, |flight| {
        // The tolerance is the movement between two messages.
        let position = flight.get::<GlobalPositionInt>(COMPANION);
        let local: LocalPositionNed = flight.get(COMPANION);
        assert!((position.relative_alt as f32 / 1e3 + local.z).abs() < 0.4, "{position:?} {local:?}");
        // Both fields are rounded.
        assert!((position.alt - position.relative_alt - 488_000).abs() <= 1, "{position:?}");
        let (angles, q): (Attitude, AttitudeQuaternion) = (flight.get(COMPANION), flight.get(COMPANION));
        let length = [q.q1, q.q2, q.q3, q.q4].iter().map(|part| part * part).sum::<f32>();
        assert!((length - 1.0).abs() < 1e-4);
        // They are sent together, except for short delays under load.
        if angles.time_boot_ms != q.time_boot_ms {
            apart += 1;
            return;
        }
        let yaw = (2.0 * (q.q1 * q.q4 + q.q2 * q.q3)).atan2(1.0 - 2.0 * (q.q3 * q.q3 + q.q4 * q.q4));
        assert!((yaw - angles.yaw).abs() < 1e-3, "{angles:?} {q:?}");
    });
    assert!(apart < 100, "{apart} ms");
    assert_eq!(flight.get::<ExtendedSysState>(COMPANION).landed_state, MavLandedState::IN_AIR);
    let local: LocalPositionNed = flight.get(COMPANION);
    assert!((local.z + 20.0).abs() < 0.5, "{local:?}");
    let (status, battery): (SysStatus, BatteryStatus) = (flight.get(COMPANION), flight.get(COMPANION));
    assert!((10_500..12_600).contains(&status.voltage_battery), "{status:?}");
    assert_eq!(status.current_battery, 1_800);
    assert_eq!(battery.voltages[3], u16::MAX, "three cells");
    assert_eq!((battery.temperature, battery.energy_consumed), (i16::MAX, -1), "not measured");
    let cells: u16 = battery.voltages[..3].iter().sum();
    assert!(cells.abs_diff(status.voltage_battery) <= 3 && battery.current_consumed > 0, "{battery:?}");
    assert_eq!(battery.battery_remaining, status.battery_remaining);
    flight.command(MavCmd::NAV_LAND, 0.0, 0.0);
    flight.run(1_000, |_| {});
    assert_eq!(flight.get::<ExtendedSysState>(COMPANION).landed_state, MavLandedState::LANDING);
    flight.run(20_000, |_| {});
    assert_eq!(flight.get::<ExtendedSysState>(COMPANION).landed_state, MavLandedState::ON_GROUND);
    assert_eq!(flight.get::<VfrHud>(COMPANION).throttle, 0);
}

/// The landed state is LANDING in the final descent, in any mode.
#[test]
fn a_return_reports_landing() {
    let landed_state = |flight: &Flight| flight.get::<ExtendedSysState>(COMPANION).landed_state;
    let mut flight = Flight::new();
    flight.run(3_000, |_| {});
    flight.command(MavCmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    flight.command(MavCmd::NAV_TAKEOFF, 0.0, 20.0);
    flight.run(10_000, |_| {});
    flight.reposition(47.398_1, 8.545_594);
    flight.run(12_000, |_| {});
    flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, 0.0, 0.0);
    flight.run(3_000, |_| {});
    assert_eq!(landed_state(&flight), MavLandedState::IN_AIR, "on the way");
    flight.run(12_000, |_| {});
    assert_eq!(landed_state(&flight), MavLandedState::LANDING);
    flight.run(30_000, |_| {});
    assert_eq!(landed_state(&flight), MavLandedState::ON_GROUND);
}

/// All messages agree on whether the battery is good, low or critical.
#[test]
fn the_battery_state_is_consistent() {
    let mut flight = Flight::new();
    let set = |flight: &mut Flight, param, value| {
        let (stack, _) = flight.wire.app.parts();
        assert!(stack.parameters_mut().set(param, value));
    };
    flight.wire.app.parts().0.parameters_mut().set(Tuning::SIM_BAT_START, 30);
    for (low, critical, state) in [
        (0.2, 0.1, MavBatteryChargeState::OK),
        (0.5, 0.1, MavBatteryChargeState::LOW),
        (0.5, 0.4, MavBatteryChargeState::CRITICAL),
    ] {
        set(&mut flight, Tuning::BAT_LOW_THR, low);
        set(&mut flight, Tuning::BAT_CRIT_THR, critical);
        flight.run(2_500, |_| {});
        let (status, battery): (SysStatus, BatteryStatus) = (flight.get(COMPANION), flight.get(COMPANION));
        assert_eq!((battery.charge_state, battery.battery_remaining, status.battery_remaining), (state, 30, 30));
        let is_healthy = status.onboard_control_sensors_health.contains(MavSysStatusSensor::SENSOR_BATTERY);
        assert_eq!(is_healthy, state == MavBatteryChargeState::OK);
    }
}

/// The rates of roll and pitch match the changes of the angles, and stay within realistic limits.
#[test]
fn rates_match_the_angles() {
    let mut flight = Flight::new();
    flight.run(3_000, |_| {});
    flight.command(MavCmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    flight.command(MavCmd::NAV_TAKEOFF, 0.0, 10.0);
    flight.run(8_000, |_| {});
    flight.reposition(47.398_1, 8.546);
    let mut angles: Vec<Attitude> = Vec::new();
    for _ in 0..400 {
        flight.run(20, |_| {});
        angles.push(flight.get(COMPANION));
    }
    let greatest = |angle: fn(&Attitude) -> f32| angles.iter().map(|at| angle(at).abs()).fold(0.0, f32::max);
    let tilt = greatest(|at| at.pitch).max(greatest(|at| at.roll));
    let rate = greatest(|at| at.pitchspeed).max(greatest(|at| at.rollspeed));
    assert!((0.2..0.31).contains(&tilt) && (1.0..3.0).contains(&rate), "{tilt} rad, {rate} rad/s");
    for pair in angles.windows(2).filter(|pair| pair[1].time_boot_ms > pair[0].time_boot_ms) {
        let dt = (pair[1].time_boot_ms - pair[0].time_boot_ms) as f32 / 1_000.0;
        let changes = [
            (pair[1].roll - pair[0].roll, pair[1].rollspeed, pair[0].rollspeed),
            (pair[1].pitch - pair[0].pitch, pair[1].pitchspeed, pair[0].pitchspeed),
        ];
        for (change, now, before) in changes {
            // The change between two messages lies between their rates.
            let (least, most) = (now.min(before).min(0.0) * dt, now.max(before).max(0.0) * dt);
            assert!(least - 0.03 < change && change < most + 0.03, "{pair:?}");
        }
    }
}

/// MAVSDK's info.flight_information: the times of arming, takeoff and landing.
#[test]
fn flight_information_has_the_event_times() {
    let mut flight = Flight::new();
    flight.run(3_000, |_| {});
    assert_eq!(flight.wire.app.stack().parameters().get(mavstack_demo::Tuning::STAT_FLIGHTS), 0);
    flight.command(MavCmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    flight.run(2_000, |_| {});
    flight.command(MavCmd::NAV_TAKEOFF, 0.0, 10.0);
    flight.run(5_000, |_| {});
    flight.command(MavCmd::NAV_LAND, 0.0, 0.0);
    flight.run(100, |_| {});
    flight.announce_flight_information();
    let info: FlightInformation = flight.get(TELEMETRY);
    assert!(info.arming_time_utc.abs_diff(3_000_000) <= 20_000, "{info:?}");
    assert!(info.takeoff_time_utc.abs_diff(5_000_000) <= 50_000, "{info:?}");
    assert_eq!((info.flight_uuid, info.landing_time), (1, 0));
    flight.run(30_000, |_| {});
    flight.announce_flight_information();
    let info: FlightInformation = flight.get(TELEMETRY);
    assert!((10_500..25_000).contains(&info.landing_time), "{info:?}");
}

/// By default every stream is sent on both normal links, except ATTITUDE_QUATERNION on the radio. Nothing is sent by satellite.
/// BATTERY_STATUS is sent for two batteries, each at its own rate.
#[test]
fn telemetry_flows_by_default() {
    let mut flight = Flight::new();
    flight.run(10_000, |_| {});
    let before = flight.counts.clone();
    let bytes = flight.wire.bytes;
    flight.run(60_000, |_| {});
    let rate = |link: LinkId, id| {
        let index = usize::from(link.0);
        let count = |counts: &[BTreeMap<u32, u32>; LINKS]| counts[index].get(&id).copied().unwrap_or(0);
        count(&flight.counts) - count(&before)
    };
    let ids =
        [SysStatus::ID, SystemTime::ID, GpsRawInt::ID, Attitude::ID, AttitudeQuaternion::ID, LocalPositionNed::ID];
    let more =
        [GlobalPositionInt::ID, VfrHud::ID, BatteryStatus::ID, HomePosition::ID, ExtendedSysState::ID, RcChannels::ID];
    let rates = |link| ids.into_iter().chain(more).map(|id| rate(link, id)).collect::<Vec<_>>();
    assert_eq!(rates(TELEMETRY), [60, 60, 60, 240, 0, 120, 240, 240, 36, 12, 60, 30]);
    // An interval of 33 ms gives 1,818 messages per minute.
    let companion = [120, 60, 300, 3_000, 3_000, 1_818, 1_818, 600, 72, 30, 300, 120];
    for (rate, wanted) in rates(COMPANION).into_iter().zip(companion) {
        assert!(rate.abs_diff(wanted) <= 1, "{:?}", rates(COMPANION));
    }
    let per_second = (flight.wire.bytes[0] - bytes[0]) / 60;
    assert!(per_second < 5_760 / 7, "{per_second} bytes/s: more than a seventh of 57,600 bit/s");
    assert_eq!(flight.wire.bytes[2], 0);
}

/// The bits of the geofence, from which MAVProxy says "fence present", "fence enabled" and "fence breach". Without a fence it is healthy:
/// otherwise MAVProxy says "fence breach" when it connects.
#[test]
fn geofence_is_present_enabled_and_breached() {
    let mut flight = Flight::new();
    let fence = |flight: &mut Flight| {
        flight.run(1_100, |_| {});
        let SysStatus {
            onboard_control_sensors_present: present,
            onboard_control_sensors_enabled: enabled,
            onboard_control_sensors_health: health,
            ..
        } = flight.get(TELEMETRY);
        [present, enabled, health].map(|sensors| sensors.contains(MavSysStatusSensor::GEOFENCE))
    };
    flight.run(6_000, |_| {});
    assert_eq!(fence(&mut flight), [false, false, true]);
    flight.wire.app.parts().0.parameters_mut().set(Tuning::GF_ACTION, 0);
    flight.wire.app.parts().0.parameters_mut().set(Tuning::GF_MAX_HOR_DIST, 20.0);
    assert_eq!(fence(&mut flight), [true, false, true]);
    flight.wire.app.parts().0.parameters_mut().set(Tuning::GF_ACTION, 1);
    assert_eq!(fence(&mut flight), [true, true, true]);
    flight.command(MavCmd::COMPONENT_ARM_DISARM, 1.0, 0.0);
    flight.command(MavCmd::NAV_TAKEOFF, 0.0, f32::NAN);
    flight.run(8_000, |_| {});
    assert_eq!(fence(&mut flight), [true, true, true]);
    // 50 m to the north.
    flight.reposition(47.398_2, 8.545_594);
    flight.run(15_000, |_| {});
    assert_eq!(fence(&mut flight), [true, true, false]);
    flight.command(MavCmd::NAV_RETURN_TO_LAUNCH, 0.0, 0.0);
    flight.run(10_000, |_| {});
    assert_eq!(fence(&mut flight), [true, true, true]);
}
