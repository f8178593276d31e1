//! The power goes at every byte and in every erase of a commit: a ground station uploads or clears plans over a line, and
//! the restarted vehicle has exactly the old plans or exactly the new (SEC-11). The record itself is cut twice, in
//! the unit tests of the store.

use crate::support::flash::{Fault, FlashError, RamFlash, Torn};
use crate::support::*;
use crate::{of_plans, setup};
use mavstack::dialect::{
    MavCmd, MavFrame, MavMissionResult, MavMissionType, MavSeverity, MissionAck, MissionItemInt, Statustext,
};
use mavstack::plan::Durability;
use mavstack::plan::PlanView;
use mavstack::storage::RestoreError;
use mavstack::{Duration, Item};

mavstack::stack! {
    struct Plans for TestVehicle { links: 1, plans: { mission: 250, fence: 64, rally: 16 }, commands: { slots: 1 } }
}

mavstack::stack! {
    struct Small for TestVehicle { links: 1, plans: { mission: 12, fence: 2, rally: 2 }, commands: { slots: 1 } }
}

type TestWorld = World<1, Plans>;
type Flash = RamFlash<8, 512>;
type Store<'a> = mavstack::storage::Store<&'a mut Flash>;

const MISSION: MavMissionType = MavMissionType::MISSION;
const FENCE: MavMissionType = MavMissionType::FENCE;
const RALLY: MavMissionType = MavMissionType::RALLY;
const ALL: MavMissionType = MavMissionType::ALL;
const ACCEPTED: MavMissionResult = MavMissionResult::ACCEPTED;

/// Shorter than for all plans, so that each is cut everywhere.
const REGION: u32 = mavstack::storage::Store::<Flash>::region_len::<Small>();

/// What a ground station does.
#[derive(Clone, Copy, Debug)]
enum Change {
    /// It uploads so many items; none is a clear by upload.
    Upload(MavMissionType, u16),
    Clear(MavMissionType),
}

/// Items of any type, no two alike.
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

/// All that a restart has to bring back.
type Live = [(Vec<Item>, u32); 3];

fn live(world: &TestWorld) -> Live {
    [world.stack.mission(), world.stack.fence(), world.stack.rally()]
        .map(|plan: PlanView| (plan.items().to_vec(), plan.id()))
}

/// A vehicle that starts with this flash.
fn start(store: &mut Store<'_>, durability: Durability) -> TestWorld {
    let mut world = World::of(setup(durability));
    of_plans(world.stack.restore(world.now(), store, &mut world.vehicle)).expect("flash that can be read");
    world
}

/// What a restart finds.
fn restarted(flash: &Flash) -> Live {
    let mut flash = flash.clone();
    flash.power_on();
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = World::of(Setup::new());
    let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
    if result == Err(RestoreError::Storage(FlashError::Fault)) {
        // A header that was cut off and cannot be read: after some looks, it does not count.
        for _ in 0..5 {
            settle(&mut world, &mut store);
            world.run_for(Duration::from_secs(1));
        }
    } else {
        assert_eq!(result, Ok(()));
    }
    live(&world)
}

/// Runs until all is written and erased ahead, or the power goes, with or without the ground station's answer.
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
    // What has reached the ground, looked at or not.
    let mut acks = world.gcs[0].received.iter().rev().filter_map(Received::decode::<MissionAck>);
    acks.find(|ack| ack.mission_type == plan).map(|ack| ack.r#type)
}

/// Until the room for the next plan is erased, which lets the answer go first.
fn settle(world: &mut TestWorld, store: &mut Store<'_>) {
    let mut quiet = 0;
    while quiet < 250 && !store.flash().is_off() {
        world.step();
        quiet = if world.stack.persist(world.now(), store, &mut world.vehicle) { 0 } else { quiet + 1 };
    }
}

/// Flash of a vehicle with three plans.
fn with_plans() -> Flash {
    let mut flash = Flash::new(REGION);
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = start(&mut store, Durability::Durable);
    for (plan, len) in [(MISSION, 9), (FENCE, 2), (RALLY, 2)] {
        let mut upload = Upload::new(&world.gcs[0], &items(plan, len, 3));
        while upload.result().is_none() {
            world.step();
            world.stack.persist(world.now(), &mut store, &mut world.vehicle);
            upload.poll(world.now(), &mut world.gcs[0]);
        }
        settle(&mut world, &mut store);
        assert!(upload.result().is_some_and(|result| result.is_ok()));
    }
    flash
}

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
    for fuel in 1..=uncut.cost() - before.cost() {
        let mut flash = before.clone();
        flash.fuel = Some(fuel);
        let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store, durability);
        let answer = change(&mut world, &mut store, commit);
        let found = restarted(&flash);
        assert!(found == old || found == new, "{commit:?}, cut after {fuel}: a mix");
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

/// M-39, M-44: ACCEPTED is only said of what survives.
#[test]
fn an_upload_is_cut() {
    every_cut(Durability::Durable, Torn::Prefix, Change::Upload(MISSION, 12));
    every_cut(Durability::Durable, Torn::Garbage, Change::Upload(FENCE, 1));
    every_cut(Durability::Durable, Torn::Unreadable, Change::Upload(RALLY, 2));
}

/// M-50, M-52
#[test]
fn a_clear_is_cut() {
    every_cut(Durability::Durable, Torn::Prefix, Change::Clear(MISSION));
    every_cut(Durability::Durable, Torn::Unreadable, Change::Clear(FENCE));
    every_cut(Durability::Durable, Torn::Garbage, Change::Clear(RALLY));
    every_cut(Durability::Durable, Torn::Prefix, Change::Clear(ALL));
}

/// M-44: what is written later is old or new too.
#[test]
fn a_deferred_commit_is_cut() {
    every_cut(Durability::Deferred, Torn::Garbage, Change::Upload(MISSION, 10));
    every_cut(Durability::Deferred, Torn::Prefix, Change::Clear(ALL));
}

/// Storage fails: the answer is ERROR, the old plan stays, here and after a restart, and one text says why.
#[test]
fn failing_storage_is_told_once() {
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
        assert_eq!(restarted(&flash), old, "{fault:?}");
    }
}

/// M-44: with 100 ms an erase, and 1 ms a write of 256 bytes, the answer comes within a second of the last item, also
/// when one large plan follows on another's heels, and when the vehicle has just started.
#[test]
fn the_answer_comes_within_a_second() {
    type SlowFlash = RamFlash<8, 4096>;
    const REGION: u32 = mavstack::storage::Store::<SlowFlash>::region_len::<Plans>();
    let mut flash = SlowFlash::new(REGION);
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = TestWorld::of(Setup::new());
    of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle)).expect("flash that can be read");
    for variant in 0..4 {
        let mut upload = Upload::new(&world.gcs[0], &items(MISSION, 250, variant));
        let mut last_item = None;
        while upload.result().is_none() {
            world.step();
            let before = (store.flash().erases, store.flash().writes);
            world.stack.persist(world.now(), &mut store, &mut world.vehicle);
            let erases = u64::from(store.flash().erases - before.0);
            let writes = u64::from(store.flash().writes - before.1);
            assert!(erases + writes <= 1, "one step");
            // The processor stands still.
            world.clock.set(world.now().after(millis(100 * erases + writes)));
            upload.poll(world.now(), &mut world.gcs[0]);
            if upload.items_sent() == 250 {
                last_item.get_or_insert(world.now());
            }
        }
        assert!(upload.result().is_some_and(|result| result.is_ok()), "{:?}", upload.result());
        let waited = world.now().since(last_item.expect("it was sent"));
        assert!(waited <= Duration::from_secs(1), "{} ms", waited.as_millis());
    }
    assert!(flash.erases >= 6, "something was erased");
}

/// D-5, SEC-12: while the vehicle says no, nothing is written and nothing erased; a change is refused at its beginning.
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

/// M-45: a vehicle that arms while an upload is being written refuses it before the next step, wherever that is: a plan that was
/// answered DENIED does not come back, whenever the power goes.
#[test]
fn a_plan_that_was_refused_while_it_was_written_is_never_restored() {
    let writes = {
        let mut flash = with_plans();
        flash.writes = 0;
        let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store, Durability::Durable);
        assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 12)), Some(ACCEPTED));
        flash.writes
    };
    assert!(writes >= 3, "{writes}");
    for after in 0..writes {
        let mut flash = with_plans();
        let old = restarted(&flash);
        flash.writes = 0;
        let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store, Durability::Durable);
        let mut upload = Upload::new(&world.gcs[0], &items(MISSION, 12, 7));
        while upload.result().is_none() {
            world.step();
            // It may arm in a pass in which nothing may be written, too.
            if upload.items_sent() == 12 && store.flash().writes >= after {
                world.vehicle.may_change = Err(MavMissionResult::DENIED);
                world.vehicle.may_persist = after % 2 == 0;
            }
            world.stack.persist(world.now(), &mut store, &mut world.vehicle);
            assert_eq!(restarted(store.flash()), old, "armed after {after} writes");
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

/// SEC-11: an upload that is byte for byte the live plan does not wear the flash, now or after a restart.
#[test]
fn what_is_there_is_not_written_again() {
    let mut flash = with_plans();
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    for _ in 0..3 {
        let mut world = start(&mut store, Durability::Durable);
        let same = items(MISSION, 9, 3);
        let mut upload = Upload::new(&world.gcs[0], &same);
        let used = (store.flash().writes, store.flash().erases);
        while upload.result().is_none() {
            world.step();
            world.stack.persist(world.now(), &mut store, &mut world.vehicle);
            upload.poll(world.now(), &mut world.gcs[0]);
        }
        assert_eq!(upload.result().map(|result| result.is_ok()), Some(true));
        assert_eq!((store.flash().writes, store.flash().erases), used);
    }
}

/// G-18: when flash cannot be read at all, the plans are empty and a text says so. When it can be read again, it is read before
/// anything is written: the old plans become live, and the upload that should replace them is repeated and kept.
#[test]
fn unreadable_flash_is_told() {
    let mut flash = with_plans();
    let old = restarted(&flash);
    flash.fault = Fault::Read(0..REGION);
    let mut store = mavstack::storage::Store::new(&mut flash, 0..REGION);
    let mut world = TestWorld::of(Setup::new());
    let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
    assert_eq!(result, Err(RestoreError::Storage(FlashError::Fault)));
    assert!(live(&world).iter().all(|(items, id)| items.is_empty() && *id == 0));
    assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 4)), Some(MavMissionResult::ERROR));
    assert!(world.gcs[0].count_of::<Statustext>() >= 1);
    store.flash_mut().fault = Fault::None;
    world.gcs[0].forget();
    assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 5)), Some(MavMissionResult::ERROR));
    assert_eq!(live(&world), old);
    world.gcs[0].forget();
    assert_eq!(change(&mut world, &mut store, Change::Upload(MISSION, 5)), Some(ACCEPTED));
    let new = live(&world);
    assert_eq!((new[0].0.len(), &new[1..]), (5, &old[1..]));
    assert_eq!(restarted(&flash), new);
}
