//! Plans that are uploaded as files, and stored: rules F-23, F-24, M-44, M-45, M-48.

use crate::setup;
use crate::support::flash::RamFlash;
use crate::support::plan_file::{file, path};
use crate::support::*;
use mavstack::dialect::{
    CommandAck, MavCmd, MavFtpErr, MavMissionResult, MavResult, MissionAck, MissionCount, MissionItemInt, Statustext,
};
use mavstack::message::LatLon;
use mavstack::plan::Durability;
use mavstack::plan::FirstWaypointLimit;
use mavstack::storage::Store;
use mavstack::{Config, Duration, PlanType};
use mavstack_station::files::Upload;
use mavstack_station::{Client, Failure};

type Flash = RamFlash<8, 1024>;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 12, fence: 4, rally: 2 },
    commands: { slots: 1 },
    files: { sessions: 1, upload: 276 },
    storage,
)]
struct Filed;

type Shelf = World<1, Filed>;

const LEN: u32 = Store::<Flash>::region_len::<Filed>();

/// Returns a world whose plans are restored from this flash.
fn shelf(flash: Flash, config: impl FnOnce(&mut Config)) -> (Shelf, Store<Flash>) {
    let mut setup = setup(Durability::Durable);
    config(&mut setup.config);
    let (mut world, mut store) = (Shelf::of(setup), Store::new(flash, 0..LEN));
    assert_eq!(world.stack.restore(world.now(), &mut store, &mut world.vehicle), Ok(()));
    (world, store)
}

/// Runs an upload for this time; storage is written only with a `store`. Returns the result.
fn run(
    world: &mut Shelf,
    upload: &mut Talk<Upload>,
    time: Duration,
    mut store: Option<&mut Store<Flash>>,
) -> Option<Result<(), MavFtpErr>> {
    let end = world.now() + time;
    let mut result = None;
    while world.now() < end && result.is_none() {
        world.step();
        if let Some(store) = &mut store {
            world.stack.persist(world.now(), *store, &mut world.vehicle);
        }
        result = upload.poll(world.now(), &mut world.gcs[0]).map(|result| match result {
            Ok(()) => Ok(()),
            Err(Failure::File { error, .. }) => Err(*error),
            Err(failure) => panic!("{failure}"),
        });
    }
    result
}

/// An upload of a client that waits as long as it takes.
fn upload(items: &[MissionItemInt]) -> Talk<Upload> {
    let upload = Upload::new(path(PlanType::Mission), file(PlanType::Mission, items));
    Talk::new(Client::Pymavlink, STATION, upload)
}

/// M-48: a mission that was uploaded as a file before the position was known, or that was stored at another site, does not start.
#[test]
fn restored_mission_is_checked_before_it_starts() {
    let (mut world, mut store) = shelf(Flash::new(LEN), |_| ());
    world.vehicle.limits_first_waypoint = true;
    let items = plan(3, 1);
    let mut upload = upload(&items);
    assert_eq!(run(&mut world, &mut upload, secs(2), Some(&mut store)), Some(Ok(())));
    let (mut restarted, _) = shelf(store.flash().clone(), |_| ());
    restarted.vehicle.limits_first_waypoint = true;
    for world in [&mut world, &mut restarted] {
        assert_eq!(world.stack.mission().items().len(), 3);
        let start = |world: &mut Shelf| {
            world.gcs[0].forget();
            let command = world.gcs[0].long(MavCmd::MISSION_START, [0.0; 7]);
            world.gcs[0].send(&command);
            world.expect::<CommandAck>(0, secs(1)).result
        };
        assert_eq!(start(world), MavResult::TEMPORARILY_REJECTED);
        world.run_for(millis(100));
        world.gcs[0].forget();
        let far = LatLon { latitude: items[0].x + 1_000_000, longitude: items[0].y };
        world.vehicle.first_waypoint_limit = Some(FirstWaypointLimit { from: far, distance: 11_000 });
        let text: Statustext = world.expect(0, secs(1));
        assert_eq!(text.text.as_str(), Some("Mission item 0: more than 11000 m away"));
        assert_eq!(start(world), MavResult::DENIED);
        assert!(!world.vehicle.calls.iter().any(|call| matches!(call, Call::StartMission(..))));
    }
}

/// F-23, M-44: the last part is answered when the plan is stored. It is live after a restart.
#[test]
fn uploaded_file_is_stored_before_the_answer() {
    let (mut world, mut store) = shelf(Flash::new(LEN), |config| config.second_mission_ack = true);
    for items in [plan(12, 1), plan(3, 2), vec![]] {
        let old = world.stack.mission().id();
        let mut upload = upload(&items);
        assert_eq!(run(&mut world, &mut upload, secs(2), None), None, "it is not stored");
        let passes = world.sleep_for(secs(1));
        assert!(passes < 220, "D-4: {passes} passes while it waits");
        assert_eq!(world.stack.mission().id(), old);
        assert_eq!(run(&mut world, &mut upload, secs(2), Some(&mut store)), Some(Ok(())));
        assert_eq!(world.stack.mission().items().len(), items.len());
        world.run_for(secs(1));
        assert_eq!(world.gcs[0].count_of::<MissionAck>(), 0, "nobody waits for one");
        let (restarted, _) = shelf(store.flash().clone(), |_| ());
        assert_eq!(restarted.stack.mission().items(), world.stack.mission().items());
    }
    // The same plan once more is not written.
    let mut again = upload(&[]);
    assert_eq!(run(&mut world, &mut again, secs(2), None), Some(Ok(())), "M-39");
}

/// F-23, F-24, M-45: while a plan is being stored, uploads by messages are denied to others, and the vehicle may still refuse it; or
/// storage fails. Then the file is refused, and the old plan stays.
#[test]
fn file_that_cannot_be_stored_is_refused() {
    let (mut world, mut store) = shelf(Flash::new(LEN), |_| ());
    let old = plan(4, 1);
    assert_eq!(run(&mut world, &mut upload(&old), secs(2), Some(&mut store)), Some(Ok(())));
    let id = world.stack.mission().id();
    let mut slow = upload(&plan(5, 2));
    assert_eq!(run(&mut world, &mut slow, secs(1), None), None);
    let count = MissionCount { target_system: 1, target_component: 1, count: 2, ..MissionCount::default() };
    world.gcs[0].send_from(OTHER_STATION, &count);
    let ack: MissionAck = world.expect(0, millis(100));
    assert_eq!((ack.target_system, ack.r#type), (OTHER_STATION.system.wire(), MavMissionResult::DENIED));
    assert_eq!(run(&mut world, &mut slow, secs(6), None), Some(Err(MavFtpErr::FAIL)), "nothing stores it for 5 s");
    assert_eq!(world.stack.mission().id(), id);

    let mut refused = upload(&plan(5, 3));
    assert_eq!(run(&mut world, &mut refused, secs(1), None), None);
    world.vehicle.may_change = Err(MavMissionResult::DENIED);
    assert_eq!(run(&mut world, &mut refused, secs(1), Some(&mut store)), Some(Err(MavFtpErr::FAIL)));
    assert_eq!(world.stack.mission().id(), id);
    world.vehicle.may_change = Ok(());

    world.vehicle.may_persist = false;
    let mut forbidden = upload(&plan(5, 3));
    assert_eq!(run(&mut world, &mut forbidden, secs(1), Some(&mut store)), Some(Err(MavFtpErr::FAIL)), "M-44");
    world.vehicle.may_persist = true;
    let (restarted, _) = shelf(store.flash().clone(), |_| ());
    assert_eq!(restarted.stack.mission().id(), id);
    assert_eq!(world.gcs[0].count_of::<MissionAck>(), 1);
}

/// F-23, C-15: a client that uploads again and again does not wear the flash.
#[test]
fn files_are_stored_no_more_often_than_the_flash_endures() {
    let (mut world, mut store) = shelf(Flash::new(LEN), |_| ());
    let mut stored = 0;
    for round in 0..100 {
        match run(&mut world, &mut upload(&plan(12, round)), secs(9), Some(&mut store)) {
            Some(Ok(())) => stored += 1,
            result => {
                assert_eq!(result, Some(Err(MavFtpErr::FAIL)));
                break;
            }
        }
    }
    assert!((2..60).contains(&stored), "{stored}");
}
