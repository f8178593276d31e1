//! Power cuts at every byte and in every erase while plans are uploaded or cleared over a line. The restarted vehicle has exactly
//! the old plans or exactly the new ones (SEC-11). Second cuts have their tests in the unit tests of the journal.

use crate::support::flash::{Fault, RamFlash, Torn};
use crate::support::*;
use crate::{of_plans, setup, upload};
use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};
use mavstack::dialect::{
    MavCmd, MavFrame, MavMissionResult, MavMissionType, MavSeverity, MissionAck, MissionItemInt, Statustext,
};
use mavstack::plan::Durability;
use mavstack::plan::PlanView;
use mavstack::storage::{Job, Page, Region, RestoreError};
use mavstack::{Duration, Item};

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 250, fence: 64, rally: 16 },
    commands: { slots: 1 },
    storage,
)]
struct Large;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 12, fence: 2, rally: 2 },
    commands: { slots: 1 },
    storage,
)]
struct Small;

type TestWorld = World<1, Small>;
type Flash = RamFlash<8, 512>;
type Store<'a> = mavstack::storage::Store<&'a mut Flash>;

const MISSION: MavMissionType = MavMissionType::MISSION;
const FENCE: MavMissionType = MavMissionType::FENCE;
const RALLY: MavMissionType = MavMissionType::RALLY;
const ALL: MavMissionType = MavMissionType::ALL;
const ACCEPTED: MavMissionResult = MavMissionResult::ACCEPTED;

const REGION: u32 = mavstack::storage::Store::<Flash>::region_len::<Small>();

/// What a ground station does with a plan.
#[derive(Clone, Copy, Debug)]
enum Change {
    /// Uploads this many items. An upload of none is a clear.
    Upload(MavMissionType, u16),
    Clear(MavMissionType),
}

/// Returns different items for a plan.
fn items(plan: MavMissionType, len: u16, variant: u16) -> Vec<MissionItemInt> {
    let mut items = crate::support::plan(len, variant);
    for item in &mut items {
        item.mission_type = plan;
        match plan {
            FENCE => {
                (item.frame, item.command) = (MavFrame::GLOBAL, MavCmd::NAV_FENCE_CIRCLE_INCLUSION);
                (item.param1, item.param2) = (100.0 + f32::from(variant), 0.0);
            }
            RALLY => item.command = MavCmd::NAV_RALLY_POINT,
            _ => {}
        }
    }
    items
}

/// What a restart must restore: the items and the id of each plan.
type Live = [(Vec<Item>, u32); 3];

fn live(world: &TestWorld) -> Live {
    [world.stack.mission(), world.stack.fence(), world.stack.rally()]
        .map(|plan: PlanView| (plan.items().to_vec(), plan.id()))
}

/// Starts a vehicle with this flash.
fn start(store: &mut Store<'_>, durability: Durability) -> TestWorld {
    let mut world = TestWorld::of(setup(durability));
    of_plans(world.stack.restore(world.now(), store, &mut world.vehicle)).expect("flash that can be read");
    world
}

/// Returns the plans of a restarted vehicle, which finds no damage.
fn restarted(flash: &Flash) -> Live {
    restarted_from(flash, false)
}

/// The same, of flash that may be damaged if it `is_wrong`.
fn restarted_from(flash: &Flash, is_wrong: bool) -> Live {
    let mut flash = flash.clone();
    flash.power_on();
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = TestWorld::of(Setup::new());
    let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
    if result == Err(RestoreError::Unreadable) {
        // The write of a page was cut off, and its ECC is wrong: after four attempts it does not count.
        for _ in 0..5 {
            settle(&mut world, &mut store);
            world.run_for(Duration::from_secs(1));
        }
    } else if !is_wrong {
        assert_eq!(result, Ok(()));
    }
    live(&world)
}

/// Makes a change and runs until everything is written and erased ahead, or the power is cut. Returns the answer that the ground
/// station has received by then.
fn change(world: &mut TestWorld, store: &mut Store<'_>, change: Change) -> Option<MavMissionResult> {
    let plan = match change {
        Change::Upload(plan, _) | Change::Clear(plan) => plan,
    };
    let variant = if matches!(change, Change::Upload(..)) { 7 } else { 0 };
    let mut upload = match change {
        Change::Upload(_, len) => Some(Upload::new(&world.gcs[0], &items(plan, len, variant))),
        Change::Clear(_) => None,
    };
    let mut clear = Clear::new(&world.gcs[0], plan);
    let mut is_answered = false;
    for _ in 0..10_000 {
        world.step();
        let now = world.now();
        let is_busy = world.stack.persist(now, store, &mut world.vehicle);
        if store.flash().is_off() {
            break;
        }
        let gcs = &mut world.gcs[0];
        is_answered = match &mut upload {
            Some(upload) => upload.poll(now, gcs).is_some(),
            None => clear.poll(now, gcs).is_some(),
        };
        if is_answered && !is_busy {
            settle(world, store);
            break;
        }
    }
    assert!(is_answered || store.flash().is_off(), "no answer");
    // The answer may have arrived after the last poll of the ground station's state machine.
    let mut acks = world.gcs[0].received.iter().rev().filter_map(Received::decode::<MissionAck>);
    acks.find(|ack| ack.mission_type == plan).map(|ack| ack.r#type)
}

/// Runs until units are erased ahead, which begins after the answer is sent.
fn settle(world: &mut TestWorld, store: &mut Store<'_>) {
    let mut quiet = 0;
    while quiet < 250 && !store.flash().is_off() {
        world.step();
        quiet = if world.stack.persist(world.now(), store, &mut world.vehicle) { 0 } else { quiet + 1 };
    }
}

/// Returns the flash of a vehicle with three plans.
fn with_plans() -> Flash {
    let mut flash = Flash::new(REGION);
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = start(&mut store, Durability::Durable);
    for (plan, len) in [(MISSION, 9), (FENCE, 2), (RALLY, 2)] {
        assert_eq!(upload(&mut world, &mut store, &items(plan, len, 3)), ACCEPTED);
        settle(&mut world, &mut store);
    }
    flash
}

/// Cuts the power at every byte and in every erase of a change.
fn every_cut(durability: Durability, torn: Torn, commit: Change) {
    let mut before = with_plans();
    before.torn = torn;
    let old = restarted(&before);
    let mut uncut = before.clone();
    let mut store = mavstack::storage::Store::new(&mut uncut, 0..REGION);
    let mut world = start(&mut store, durability);
    assert_eq!(change(&mut world, &mut store, commit), Some(ACCEPTED), "{commit:?}");
    let new = live(&world);
    assert_ne!(old, new);
    assert_eq!(restarted(&uncut), new);

    let (mut was_old, mut was_new, mut was_accepted) = (0, 0, 0);
    // At last, the power is cut after everything is written.
    for fuel in 1..=uncut.cost() - before.cost() + 1 {
        let mut flash = before.clone();
        flash.fuel = Some(fuel);
        let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store, durability);
        let answer = change(&mut world, &mut store, commit);
        let found = restarted(&flash);
        assert!(found == old || found == new, "{commit:?}, cut after {fuel}: neither old nor new");
        was_old += u32::from(found == old);
        was_new += u32::from(found == new);
        if answer == Some(ACCEPTED) {
            was_accepted += 1;
            assert!(
                found == new || durability == Durability::Deferred,
                "{commit:?}, cut after {fuel}: accepted and lost"
            );
        } else {
            assert_eq!(answer, None, "{commit:?}, cut after {fuel}");
        }
    }
    assert!(was_old > 0 && was_new > 0 && was_accepted > 0, "{commit:?}: {was_old} old, {was_new} new");
}

/// M-39, M-44: a durable upload that was answered ACCEPTED survives.
#[test]
fn an_upload_is_cut() {
    every_cut(Durability::Durable, Torn::Prefix, Change::Upload(MISSION, 12));
    every_cut(Durability::Durable, Torn::Garbage, Change::Upload(FENCE, 1));
    every_cut(Durability::Durable, Torn::Unreadable, Change::Upload(RALLY, 2));
}

/// M-50, M-52: a durable clear that was answered ACCEPTED survives.
#[test]
fn a_clear_is_cut() {
    every_cut(Durability::Durable, Torn::Prefix, Change::Clear(MISSION));
    every_cut(Durability::Durable, Torn::Unreadable, Change::Clear(FENCE));
    every_cut(Durability::Durable, Torn::Garbage, Change::Clear(RALLY));
    every_cut(Durability::Durable, Torn::Prefix, Change::Clear(ALL));
}

/// M-44: a change that is written after its answer is old or new, too.
#[test]
fn a_deferred_commit_is_cut() {
    every_cut(Durability::Deferred, Torn::Garbage, Change::Upload(MISSION, 10));
    every_cut(Durability::Deferred, Torn::Prefix, Change::Clear(ALL));
}

/// M-44: storage fails. The answer is ERROR, the old plan stays, also after a restart, and one text reports it.
#[test]
fn failing_storage_is_reported_once() {
    let faults = (0..3).flat_map(|after| [Fault::Write(after), Fault::HalfWrite(after), Fault::WrongWrite(after)]);
    for fault in faults {
        let mut flash = with_plans();
        let old = restarted(&flash);
        flash.writes = 0;
        flash.fault = fault.clone();
        let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store, Durability::Durable);
        let answer = change(&mut world, &mut store, Change::Upload(MISSION, 4));
        assert_eq!(answer, Some(MavMissionResult::ERROR), "{fault:?}");
        assert_eq!(live(&world), old, "{fault:?}");
        for _ in 0..30_000 {
            world.step();
            world.stack.persist(world.now(), &mut store, &mut world.vehicle);
        }
        let texts = world.gcs[0].received.iter().filter_map(Received::decode::<Statustext>);
        let texts: Vec<_> = texts.filter(|text| text.severity.0 <= MavSeverity::WARNING.0).collect();
        assert_eq!(texts.len(), 1, "{fault:?}: {texts:?}");
        // Flash that writes wrong bits may have left damage, which is reported.
        let is_wrong = matches!(fault, Fault::WrongWrite(_));
        assert_eq!(restarted_from(&flash, is_wrong), old, "{fault:?}");
    }
}

/// M-44: the driver reports an error for the last write though the bytes are in flash. A restart would find the record, so the
/// answer is ACCEPTED. After an error before the last write, it is ERROR.
#[test]
fn the_flash_decides_whether_a_plan_is_stored() {
    for (after, answer) in [(2, ACCEPTED), (1, MavMissionResult::ERROR), (0, MavMissionResult::ERROR)] {
        let mut flash = with_plans();
        (flash.writes, flash.fault) = (0, Fault::LyingWrite(after));
        let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store, Durability::Durable);
        assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 4)), Some(answer), "after {after} writes");
        assert_eq!(restarted(store.flash()), live(&world), "after {after} writes");
    }
}

/// M-44: an erase takes 100 ms, and a write of a page 1 ms. The answer is sent within a second of the last item, even if large
/// plans are uploaded one after the other, and directly after a start. Each step is one erase, or one page.
#[test]
fn the_answer_is_sent_within_a_second() {
    type SlowFlash = RamFlash<8, 4096>;
    const REGION: u32 = mavstack::storage::Store::<SlowFlash>::region_len::<Large>();
    let mut flash = SlowFlash::new(REGION);
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = World::<1, Large>::of(Setup::new());
    of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle)).expect("flash that can be read");
    for variant in 0..4 {
        let mut upload = Upload::new(&world.gcs[0], &items(MISSION, 250, variant));
        let mut last_item = None;
        while upload.result().is_none() {
            world.step();
            let before = (store.flash().erases, store.flash().bytes_written);
            world.stack.persist(world.now(), &mut store, &mut world.vehicle);
            let erases = u64::from(store.flash().erases - before.0);
            let bytes = store.flash().bytes_written - before.1;
            assert!(erases + bytes.div_ceil(256) <= 1, "one step: {erases} erases, {bytes} bytes");
            // The processor stops.
            world.clock.set(world.now() + (millis(100 * erases + bytes.div_ceil(256))));
            upload.poll(world.now(), &mut world.gcs[0]);
            if upload.items_sent() == 250 {
                last_item.get_or_insert(world.now());
            }
        }
        assert!(upload.result().is_some_and(|result| result.is_ok()), "{:?}", upload.result());
        let waited = world.now() - last_item.expect("it was sent");
        assert!(waited <= Duration::from_secs(1), "{} ms", waited.as_millis());
    }
    assert!(flash.erases >= 6, "{} erases", flash.erases);
}

/// D-5, SEC-12: while the vehicle does not permit it, nothing is written or erased, and a change is refused before its first item.
#[test]
fn nothing_is_written_without_permission() {
    let mut flash = with_plans();
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = start(&mut store, Durability::Durable);
    world.vehicle.may_persist = false;
    let bytes = store.flash().bytes.clone();
    assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 4)), Some(MavMissionResult::DENIED));
    assert_eq!(change(&mut world, &mut store, Change::Clear(ALL)), Some(MavMissionResult::DENIED));
    assert_eq!(store.flash().bytes, bytes);
    world.vehicle.may_persist = true;
    world.gcs[0].forget();
    assert_eq!(change(&mut world, &mut store, Change::Clear(ALL)), Some(ACCEPTED));
}

/// M-45: a vehicle that arms while an upload is being written refuses it before the next step, whichever that is. A plan that was
/// answered DENIED is not restored, whenever the power is cut.
#[test]
fn a_plan_that_is_refused_while_it_is_written_is_never_restored() {
    let pages = {
        let mut flash = with_plans();
        let before = flash.bytes_written;
        let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store, Durability::Durable);
        assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 12)), Some(ACCEPTED));
        (flash.bytes_written - before) / 256
    };
    assert_eq!(pages, 3);
    for after in 0..pages {
        let mut flash = with_plans();
        let old = restarted(&flash);
        flash.bytes_written = 0;
        let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store, Durability::Durable);
        let mut upload = Upload::new(&world.gcs[0], &items(MISSION, 12, 7));
        while upload.result().is_none() {
            world.step();
            // It may arm in a pass in which nothing may be written, too.
            if upload.items_sent() == 12 && store.flash().bytes_written >= 256 * after {
                world.vehicle.may_change = Err(MavMissionResult::DENIED);
                world.vehicle.may_persist = after % 2 == 0;
            }
            world.stack.persist(world.now(), &mut store, &mut world.vehicle);
            assert_eq!(restarted(store.flash()), old, "armed after {after} pages");
            upload.poll(world.now(), &mut world.gcs[0]);
        }
        assert_eq!(upload.result(), Some(Err(TransferError::Refused(MavMissionResult::DENIED))));
        world.vehicle.may_persist = true;
        settle(&mut world, &mut store);
        assert_eq!((live(&world), restarted(store.flash())), (old.clone(), old));
        world.vehicle.may_change = Ok(());
        world.gcs[0].forget();
        assert_eq!(
            change(&mut world, &mut store, Change::Upload(MISSION, 12)),
            Some(ACCEPTED),
            "the next one is stored"
        );
    }
}

/// Carries out a job as a driver in another task does. Returns whether it succeeded.
fn run_job(flash: &mut Flash, page: &mut Page, job: &Job) -> bool {
    match job {
        Job::Read { offset, range } => flash.read(*offset, &mut page.bytes_mut()[range.clone()]).is_ok(),
        Job::Write { offset, range } => flash.write(*offset, &page.bytes()[range.clone()]).is_ok(),
        Job::Erase { offset, len } => flash.erase(*offset, offset + len).is_ok(),
    }
}

/// M-45: jobs run in another task, and the vehicle arms before or after each of them. It refuses the upload, and the old plan stays
/// live. If the record was complete by then, the old plan is stored again once the vehicle permits it. The upload is answered
/// once.
#[test]
fn a_vehicle_arms_between_two_jobs() {
    let (mut denied, mut accepted) = (0, 0);
    // Two erases; two jobs for each page of the record, and three for its last one.
    for (arms_at, is_during) in (0..10).flat_map(|job| [(job, false), (job, true)]) {
        let mut flash = with_plans();
        let old = restarted(&flash);
        let mut page = Page::new();
        let mut world = TestWorld::of(setup(Durability::Durable));
        world.stack.attach_storage(world.now(), Region::new(0..REGION, 8, 512), &mut world.vehicle);
        let mut upload = Upload::new(&world.gcs[0], &items(MISSION, 12, 7));
        let (mut jobs, mut settled) = (0, 0);
        while settled < 1_000 {
            world.step();
            upload.poll(world.now(), &mut world.gcs[0]);
            let has_armed = world.vehicle.may_change.is_err();
            settled += u32::from(upload.result().is_some());
            // An upload that begins while the plans are restored is answered afterwards.
            assert!(!world.stack.is_restoring() || upload.items_sent() == 0, "an upload replaces what is stored");
            if settled == 500 {
                assert_eq!(live(&world)[1..], old[1..]);
                world.vehicle.may_persist = true;
            }
            let arm = |world: &mut TestWorld| {
                world.vehicle.may_change = Err(MavMissionResult::DENIED);
                world.vehicle.may_persist = false;
            };
            let is_writing = upload.items_sent() == 12;
            if is_writing && jobs == arms_at && !is_during && !has_armed {
                arm(&mut world);
            }
            let Some(job) = world.stack.storage_job(world.now(), &mut page, &mut world.vehicle) else { continue };
            if has_armed && settled < 500 {
                assert!(matches!(job, Job::Read { .. }), "armed, and {job:?}");
            }
            if is_writing && jobs == arms_at && is_during && !has_armed {
                arm(&mut world);
            }
            // The job takes a while, and the stack is polled meanwhile.
            let is_done = run_job(&mut flash, &mut page, &job);
            for _ in 0..5 {
                world.step();
                upload.poll(world.now(), &mut world.gcs[0]);
            }
            world.stack.storage_done(world.now(), is_done, &mut page, &mut world.vehicle);
            jobs += u32::from(is_writing);
        }
        let answers = world.gcs[0].all::<MissionAck>().len();
        assert!(answers <= 1, "job {arms_at}: {answers} answers");
        if upload.result().is_some_and(|result| result.is_ok()) {
            accepted += 1;
            assert_eq!(restarted(&flash), live(&world), "job {arms_at}, {is_during}");
        } else {
            denied += 1;
            let refused = Some(Err(TransferError::Refused(MavMissionResult::DENIED)));
            assert_eq!(upload.result(), refused, "job {arms_at}, {is_during}");
            assert_eq!((live(&world), restarted(&flash)), (old.clone(), old), "job {arms_at}, {is_during}");
        }
    }
    assert_eq!((denied, accepted), (18, 2));
}

/// SEC-11: an upload of the plan that is live already does not wear the flash, also after a restart.
#[test]
fn a_live_plan_is_not_written_again() {
    let mut flash = with_plans();
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    for _ in 0..3 {
        let mut world = start(&mut store, Durability::Durable);
        let used = (store.flash().writes, store.flash().erases);
        assert_eq!(upload(&mut world, &mut store, &items(MISSION, 9, 3)), ACCEPTED);
        assert_eq!((store.flash().writes, store.flash().erases), used);
    }
}

/// G-18: while the flash cannot be read, the plans are empty, a text reports it, and uploads are answered ERROR at once. When it
/// can be read again, it is read before anything is written: the old plans become live within ten seconds, and then an upload is
/// stored.
#[test]
fn unreadable_flash_is_reported() {
    let mut flash = with_plans();
    let old = restarted(&flash);
    flash.fault = Fault::Read(0..REGION);
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = TestWorld::of(Setup::new());
    let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
    assert_eq!(result, Err(RestoreError::Unreadable));
    assert!(live(&world).iter().all(|(items, id)| items.is_empty() && *id == 0));
    for is_readable in [false, true] {
        let began = world.now();
        assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 4)), Some(MavMissionResult::ERROR));
        assert!(world.now() - began <= Duration::from_secs(1), "the client does not wait");
        if !is_readable {
            assert!(world.gcs[0].count_of::<Statustext>() >= 1);
            for _ in 0..20_000 {
                world.step();
                world.stack.persist(world.now(), &mut store, &mut world.vehicle);
            }
            assert!(live(&world).iter().all(|(items, _)| items.is_empty()));
            store.flash_mut().fault = Fault::None;
        }
        world.gcs[0].forget();
    }
    let used = (store.flash().writes, store.flash().erases);
    for _ in 0..10_000 {
        world.step();
        world.stack.persist(world.now(), &mut store, &mut world.vehicle);
    }
    assert_eq!(live(&world), old);
    assert_eq!((store.flash().writes, store.flash().erases), used, "nothing is written before");
    assert_eq!(world.stack.restore_errors().plans, None);
    world.gcs[0].forget();
    assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 5)), Some(ACCEPTED));
    let new = live(&world);
    assert_eq!((new[0].0.len(), &new[1..]), (5, &old[1..]));
    assert_eq!(restarted(&flash), new);
}
