//! The telemetry of the test vehicle.

use super::TestVehicle;
use mavstack::dialect::{
    Attitude, BatteryStatus, GlobalPositionInt, HomePosition, MavDataStream, OpenDroneIdLocation, SysStatus, SystemTime,
};
use mavstack::{Duration, Fill, Message, Stream, Telemetry};

/// By default the streams are sent only on links with [`StreamProfile::Onboard`](mavstack::config::StreamProfile::Onboard).
impl Telemetry for TestVehicle {
    const STREAMS: &'static [Stream] = &[
        Stream::of::<Attitude>().onboard(Duration::from_millis(20)).in_group(MavDataStream::EXTRA1),
        Stream::of::<GlobalPositionInt>().onboard(Duration::from_millis(100)).in_group(MavDataStream::POSITION),
        Stream::of::<SysStatus>().onboard(Duration::from_millis(500)).in_group(MavDataStream::EXTENDED_STATUS),
        Stream::of::<BatteryStatus>(),
        Stream::of::<HomePosition>(),
        Stream::of::<OpenDroneIdLocation>(),
        Stream::of::<SystemTime>(),
    ];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let now = out.now();
        let time_boot_ms = now.as_millis() as u32;
        match id {
            Attitude::ID => out.put(&Attitude { time_boot_ms, yaw: 1.0, yawspeed: 0.5, ..Attitude::default() }),
            GlobalPositionInt::ID => {
                out.put(&GlobalPositionInt { time_boot_ms, hdg: u16::MAX, ..GlobalPositionInt::default() })
            }
            SysStatus::ID => out.put(&SysStatus { battery_remaining: -1, ..SysStatus::default() }),
            // Two batteries.
            BatteryStatus::ID if out.index() < 2 => {
                let id = out.index() as u8;
                out.put(&BatteryStatus { id, battery_remaining: 50, ..BatteryStatus::default() })
            }
            HomePosition::ID if self.has_home => out.put(&HomePosition { z: 3.0, ..HomePosition::default() }),
            SystemTime::ID => out.put(&self.clock.message(now)),
            OpenDroneIdLocation::ID => out.put(&OpenDroneIdLocation::default()),
            _ => false,
        }
    }
}
