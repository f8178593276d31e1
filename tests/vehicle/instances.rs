//! Messages with instances, such as two batteries: rules, O-6.

use crate::support::*;
use mavstack::config::StreamProfile;
use mavstack::dialect::*;
use mavstack::{
    Command, Commands, Context, Fill, LinkConfig, Message, Outcome, Stream, Telemetry, Vehicle, VehicleState,
};

/// A vehicle with three batteries. The second may be missing, and the third is not streamed.
#[derive(Default)]
struct Packs {
    is_second_missing: bool,
}

impl Vehicle for Packs {
    fn state(&self) -> Option<VehicleState> {
        TestVehicle::new().state
    }
}

impl Telemetry for Packs {
    const STREAMS: &'static [Stream] = &[
        Stream::of::<BatteryStatus>().every(millis(500)).in_group(MavDataStream::EXTRA3),
        Stream::of::<BatteryStatus>().instance(7).every(millis(1_000)).in_group(MavDataStream::EXTRA3),
        Stream::of::<Attitude>(),
    ];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        match (id, out.index()) {
            (BatteryStatus::ID, 7) if self.is_second_missing => false,
            (BatteryStatus::ID, index @ (0 | 7 | 8)) => {
                out.put(&BatteryStatus { id: index as u8, ..BatteryStatus::UNKNOWN })
            }
            _ => false,
        }
    }
}

impl Commands for Packs {
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        if command.id == MavCmd::USER_1 {
            cx.announce::<BatteryStatus, Self>();
            return MavResult::ACCEPTED.into();
        }
        MavResult::UNSUPPORTED.into()
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Packs, links: 1, streams)]
struct OfPacks;

fn world(streams: StreamProfile) -> World<1, OfPacks> {
    World::of(Setup { links: [LinkConfig::uart(115_200).with_streams(streams)], ..Setup::new() })
}

/// Returns how often each battery is reported in ten seconds.
fn packs(world: &mut World<1, OfPacks>) -> [usize; 3] {
    world.run_for(millis(100));
    world.gcs[0].forget();
    world.run_for(secs(10));
    [0, 7, 8].map(|id| world.gcs[0].all::<BatteryStatus>().into_iter().filter(|(_, status)| status.id == id).count())
}

fn command(world: &mut World<1, OfPacks>, command: MavCmd, params: [f32; 3]) -> MavResult {
    let [a, b, c] = params;
    world.gcs[0].command_long(command, [a, b, c, 0.0, 0.0, 0.0, 0.0]);
    world.expect::<CommandAck>(0, millis(100)).result
}

fn set_interval(world: &mut World<1, OfPacks>, micros: f32, instance: f32) -> MavResult {
    command(world, MavCmd::SET_MESSAGE_INTERVAL, [BatteryStatus::ID as f32, micros, instance])
}

/// each instance has an interval. SET_MESSAGE_INTERVAL sets that of one instance, or without an instance that of all.
#[test]
fn each_instance_has_its_interval() {
    let mut world = world(StreamProfile::Radio);
    assert_eq!(packs(&mut world), [20, 10, 0]);
    assert_eq!(set_interval(&mut world, 100_000.0, 7.0), MavResult::ACCEPTED);
    assert_eq!(packs(&mut world), [20, 100, 0]);
    assert_eq!(set_interval(&mut world, 250_000.0, 0.0), MavResult::ACCEPTED);
    assert_eq!(packs(&mut world), [40, 40, 0]);
    assert_eq!(set_interval(&mut world, -1.0, f32::NAN), MavResult::ACCEPTED);
    assert_eq!(packs(&mut world), [0, 0, 0]);
    for instance in [1.0, 8.0, 0.5, -1.0, 65_543.0, f32::INFINITY] {
        assert_eq!(set_interval(&mut world, 100_000.0, instance), MavResult::DENIED, "{instance}");
    }
    assert_eq!(packs(&mut world), [0, 0, 0]);
}

/// MESSAGE_INTERVAL has no field for the instance. It reports the shortest interval, and -1 only if all are off.
#[test]
fn message_interval_is_the_shortest_of_the_instances() {
    let mut world = world(StreamProfile::Radio);
    let mut interval = || {
        let params = [MessageInterval::ID as f32, BatteryStatus::ID as f32, 0.0];
        assert_eq!(command(&mut world, MavCmd::REQUEST_MESSAGE, params), MavResult::ACCEPTED);
        let interval = world.expect::<MessageInterval>(0, millis(100)).interval_us;
        let next = [100_000.0, -1.0].get(usize::from(interval == 100_000)).copied().unwrap_or(0.0);
        set_interval(&mut world, next, if interval == 500_000 { 7.0 } else { 0.0 });
        interval
    };
    assert_eq!([interval(), interval(), interval()], [500_000, 100_000, -1]);
}

/// a request without an index gets every instance that is available, one with an index only that one.
#[test]
fn a_request_gets_all_instances_or_one() {
    let mut world = world(StreamProfile::Off);
    let mut requested = |index: f32, is_second_missing: bool| {
        world.vehicle.is_second_missing = is_second_missing;
        world.gcs[0].forget();
        let result = command(&mut world, MavCmd::REQUEST_MESSAGE, [BatteryStatus::ID as f32, index, 0.0]);
        world.run_for(millis(200));
        (result, world.gcs[0].all::<BatteryStatus>().into_iter().map(|(_, status)| status.id).collect::<Vec<_>>())
    };
    let accepted = |ids: &[u8]| (MavResult::ACCEPTED, ids.to_vec());
    assert_eq!(requested(0.0, false), accepted(&[0, 7]));
    assert_eq!(requested(f32::NAN, true), accepted(&[0]));
    assert_eq!(requested(7.0, false), accepted(&[7]));
    assert_eq!(requested(8.0, false), accepted(&[8]), "on request only");
    for (index, is_second_missing) in [(7.0, true), (9.0, false), (-1.0, false)] {
        assert_eq!(requested(index, is_second_missing), (MavResult::DENIED, vec![]), "{index}");
    }
}

/// Q-7, O-6: a group contains the instances that are in it, and an announcement all of them.
#[test]
fn groups_and_announcements_contain_the_instances() {
    let mut world = world(StreamProfile::Off);
    world.gcs[0].send(&RequestDataStream {
        req_message_rate: 4,
        target_system: 1,
        target_component: 1,
        req_stream_id: MavDataStream::ALL,
        start_stop: 1,
    });
    assert_eq!(packs(&mut world), [40, 40, 0]);
    set_interval(&mut world, -1.0, 0.0);
    assert_eq!(packs(&mut world), [0, 0, 0]);
    assert_eq!(command(&mut world, MavCmd::USER_1, [0.0; 3]), MavResult::ACCEPTED);
    world.gcs[0].forget();
    world.run_for(millis(200));
    assert_eq!(world.gcs[0].count_of::<BatteryStatus>(), 2);
}
