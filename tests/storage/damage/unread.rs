//! The newest content cannot be read, or only later: older content does not replace it. And states that are no damage.

use super::*;
use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};
use mavstack::storage::{Job, Page, Region};

/// Runs the rig while storage runs, for this time.
fn run_key(rig: &mut Rig<3>, store: &mut Keys<'_>, seconds: u64) {
    for _ in 0..seconds * 10 {
        settle(rig, store);
        rig.run_for(millis(100));
    }
}

/// G-18: a key was replaced or removed, and the power was cut before the old one was erased. Whichever read fails at the next
/// start, the old key is never used, and the newest state stays stored.
#[test]
fn a_replaced_key_is_never_used() {
    for is_off in [false, true] {
        let mut flash = with_key();
        let (mut store, mut rig, result) = start_rig(&mut flash);
        assert_eq!(result, Ok(()));
        if is_off {
            rig.signing().clear_key();
        } else {
            rig.set_key(OTHER_KEY);
        }
        while pages::pages(&store.flash().bytes).len() < 2 {
            assert!(rig.stack.persist(rig.now, &mut store, &mut rig.vehicle));
        }
        for (read, len) in (0..10).flat_map(|read| [(read, 1), (read, 3)]) {
            let mut flash = flash.clone();
            (flash.reads, flash.fault) = (0, Fault::Reads(read..read + len));
            let (mut store, mut rig, result) = start_rig(&mut flash);
            if result.is_err() {
                assert_eq!(armed_by(&mut rig), [false, false, true], "read {read}");
            }
            rig.receive(0, &Signer::new(KEY).frame(&arm()));
            assert_eq!(rig.counters().verified, 0, "read {read}: the old key is in use");
            run_key(&mut rig, &mut store, 8);
            assert_eq!(rig.signing().is_active(), !is_off, "read {read}");
            let sent = rig.transmit(1);
            assert_eq!(sent.iter().any(|frame| frame.is_signed_with(OTHER_KEY)), !is_off, "read {read}");
            assert!(!sent.iter().any(|frame| frame.is_signed_with(KEY)), "read {read}");
            rig.run_for(secs(120));
            run_key(&mut rig, &mut store, 2);
            store.flash_mut().fault = Fault::None;
            let mut rig = signing_rig();
            assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
            assert_eq!(rig.signing().is_active(), !is_off, "read {read}, after a restart");
        }
    }
}

/// G-18: storage cannot be read for a minute, and the vehicle permits no writes. The key is restored within ten seconds of the end
/// of the outage.
#[test]
fn a_key_is_restored_after_an_outage() {
    let mut flash = with_key();
    flash.fault = Fault::Read(0..KEYS);
    let (mut store, mut rig, result) = start_rig(&mut flash);
    assert!(result.is_err());
    rig.vehicle.may_persist = false;
    let (reads, used) = (store.flash().reads, (store.flash().writes, store.flash().erases));
    for _ in 0..60_000 {
        rig.run_for(millis(1));
        rig.stack.persist(rig.now, &mut store, &mut rig.vehicle);
    }
    assert_eq!(armed_by(&mut rig), [false, false, true]);
    // Four attempts, a second apart, and then one every ten seconds: the end of each page.
    assert!(store.flash().reads - reads <= KEYS / 256 * (4 + 6), "{} reads", store.flash().reads - reads);
    store.flash_mut().fault = Fault::None;
    run_key(&mut rig, &mut store, 11);
    assert!(rig.transmit(1).iter().any(|frame| frame.is_signed_with(KEY)));
    assert_eq!((store.flash().writes, store.flash().erases), used, "nothing was written");
}

/// G-18: the region has other data: code, or noise. That is reported, nothing counts as stored, and everything works as with erased
/// storage.
#[test]
fn a_region_with_other_data_is_empty() {
    let mut rng = Rng::new(18);
    for _ in 0..50 {
        let mut flash = Flash::of((0..KEYS).map(|_| rng.byte()).collect());
        flash.bytes[..4].copy_from_slice(b"\x7FELF");
        let (mut store, mut rig, result) = start_rig(&mut flash);
        assert_eq!(result, Ok(()));
        assert_eq!(rig.stack.restore_errors().region, Some(RestoreError::OtherData));
        assert_eq!(armed_by(&mut rig), [true; 3]);
        rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(KEY)));
        settle(&mut rig, &mut store);
        let mut rig = signing_rig();
        assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
        assert!(rig.transmit(0)[0].is_signed_with(KEY));
    }
}

/// G-18: the power is cut at any byte of the very first page. There is a key or none, and neither damage nor other data.
#[test]
fn a_first_page_that_is_cut_off_is_no_damage() {
    let whole = with_key();
    let (at, _) = pages::newest(&whole.bytes, KIND_OF_KEY);
    for len in 0..PAGE {
        let mut flash = whole.clone();
        flash.bytes[at + len..at + PAGE].fill(0xFF);
        let is_whole = flash.bytes == whole.bytes;
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        assert_eq!(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle), Ok(()), "{len} bytes");
        assert_eq!(rig.signing().is_active(), is_whole, "{len} bytes");
    }
}

/// G-11, G-18: while the key is lost, a text reports it every 10 s on the link where it can be set, to stations that connect later.
#[test]
fn a_lost_key_is_reported_where_it_can_be_set() {
    let whole = with_key();
    let bit = bits(&whole).last().expect("there is a record");
    let mut flash = flipped(&whole, bit);
    let (_, mut rig, result) = start_rig(&mut flash);
    assert_eq!(result, Err(RestoreError::Damaged));
    rig.run_for(secs(60));
    for link in 0..3 {
        rig.transmit(link);
    }
    let mut texts = [0; 3];
    for _ in 0..21 {
        for (link, count) in texts.iter_mut().enumerate() {
            rig.receive(link, &Signer::new(KEY).unsigned(Version::V2, &Gcs::heartbeat()));
            let sent = rig.transmit(link);
            let texts = sent.iter().filter_map(Sent::decode::<Statustext>);
            *count +=
                texts.filter(|text| text.text.as_str() == Some("Signing key lost: set it again on this link")).count();
            assert!(sent.iter().all(|frame| !frame.is_signed()));
        }
        rig.run_for(secs(1));
    }
    assert_eq!(texts, [0, 3, 0]);
}

/// G-18, P-17: parameters were written twice. Whichever read fails at the next start, older values never replace newer ones.
#[test]
fn older_parameters_do_not_replace_newer_ones() {
    let mut flash = with_params();
    let (mut store, mut world, result) = start(&mut flash);
    assert_eq!(result, Ok(()));
    world.gcs[0].send(&set("RTL_ALT", 55.0));
    while pages::pages(&store.flash().bytes).len() < 2 {
        world.step();
        world.stack.persist(world.now(), &mut store, &mut world.vehicle);
    }
    for (read, len) in (0..10).flat_map(|read| [(read, 1), (read, 3)]) {
        let mut flash = flash.clone();
        (flash.reads, flash.fault) = (0, Fault::Reads(read..read + len));
        let mut store = Params::new(&mut flash, 0..PARAMS);
        let mut world = World::new(Setup { step: millis(20), ..Setup::<1>::new() });
        let result = of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
        assert!(result.is_err() || cruise_and_altitude(&world) == (7.0, 55.0), "read {read}");
        world.gcs[0].send(&set("CRUISE", 8.0));
        run(&mut world, &mut store, secs(25));
        let texts: Vec<_> = core::iter::from_fn(|| world.gcs[0].take::<Statustext>()).map(|(_, text)| text).collect();
        let expected = ["Stored parameters cannot be read", "Stored parameters can be read again"];
        let texts: Vec<_> = texts.iter().filter_map(|text| text.text.as_str()).collect();
        assert_eq!(texts, if result.is_err() { &expected[..] } else { &[] }, "read {read}");
        let mut world = World::new(Setup::<1>::new());
        assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
        assert_eq!(cruise_and_altitude(&world), (8.0, 55.0), "read {read}");
    }
}

/// Requests the stored values.
fn reload() -> CommandLong {
    CommandLong { command: MavCmd::PREFLIGHT_STORAGE, target_system: 1, target_component: 1, ..Default::default() }
}

/// C-15: after a late restore, a request for the stored values takes back nothing that was set since, like at any other time.
#[test]
fn a_reload_after_an_outage_takes_nothing_back() {
    let mut flash = with_params();
    (flash.reads, flash.fault) = (0, Fault::Reads(0..1));
    let (mut store, mut world, result) = start(&mut flash);
    assert_eq!(result, Err(RestoreError::Unreadable));
    run(&mut world, &mut store, secs(3));
    assert_eq!((cruise_and_altitude(&world), world.stack.restore_errors().parameters), ((7.0, 99.0), None));
    world.gcs[0].send(&set("CRUISE", 8.0));
    run(&mut world, &mut store, millis(500));
    world.gcs[0].send(&reload());
    run(&mut world, &mut store, millis(500));
    assert_eq!(cruise_and_altitude(&world), (8.0, 99.0));
    world.gcs[0].send(&reload());
    run(&mut world, &mut store, millis(500));
    assert_eq!(cruise_and_altitude(&world), (8.0, 99.0));
    // Reading has ended: nothing is read again and again.
    let reads = store.flash().reads;
    run(&mut world, &mut store, secs(20));
    assert_eq!(store.flash().reads, reads);
}

/// P-17: the operator requests the stored values, and there are none. What was set is still written.
#[test]
fn a_reload_of_nothing_loses_nothing() {
    let mut flash = Flash::new(PARAMS);
    let (mut store, mut world, result) = start(&mut flash);
    assert_eq!(result, Ok(()));
    world.gcs[0].send(&set("CRUISE", 8.0));
    run(&mut world, &mut store, millis(500));
    world.gcs[0].send(&reload());
    run(&mut world, &mut store, secs(3));
    let mut world = World::new(Setup::<1>::new());
    assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    assert_eq!(cruise_and_altitude(&world), (8.0, 30.0));
}

/// P-17: a parameter is set while storage cannot be read. A sleeping loop is not woken for it, and it is stored after the outage.
#[test]
fn an_outage_does_not_keep_a_sleeping_loop_awake() {
    let mut flash = with_params();
    flash.fault = Fault::Read(0..PARAMS);
    let mut store = Params::new(&mut flash, 0..PARAMS);
    let mut world = World::new(Setup::<1>::new());
    assert!(world.stack.restore(world.now(), &mut store, &mut world.vehicle).is_err());
    world.gcs[0].send(&set("CRUISE", 8.0));
    run(&mut world, &mut store, secs(6));
    assert!(passes(&mut world, &mut store) < 1_000);
    store.flash_mut().fault = Fault::None;
    run(&mut world, &mut store, secs(25));
    assert_eq!(cruise_and_altitude(&world), (8.0, 99.0));
    let mut world = World::new(Setup::<1>::new());
    assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    assert_eq!(cruise_and_altitude(&world), (8.0, 99.0));
}

/// P-17, C-15: the operator requests the stored values, and they cannot be read. What is set then stays, and is written.
#[test]
fn a_failed_reload_loses_nothing() {
    let mut flash = with_params();
    let (mut store, mut world, result) = start(&mut flash);
    assert_eq!(result, Ok(()));
    world.gcs[0].send(&set("CRUISE", 8.0));
    run(&mut world, &mut store, secs(15));
    let first = store.flash().reads;
    store.flash_mut().fault = Fault::Reads(first..first + 2);
    world.gcs[0].send(&reload());
    run(&mut world, &mut store, secs(25));
    assert!(store.flash().reads > first);
    // The outage is over: the next request is granted.
    assert_eq!(world.stack.restore_errors().parameters, None);
    world.gcs[0].send(&set("CRUISE", 9.0));
    run(&mut world, &mut store, millis(500));
    for _ in 0..2 {
        world.gcs[0].send(&reload());
        run(&mut world, &mut store, millis(500));
        assert_eq!(cruise_and_altitude(&world), (9.0, 99.0));
    }
    let mut world = World::new(Setup::<1>::new());
    assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    assert_eq!(cruise_and_altitude(&world), (9.0, 99.0));
}

/// G-18, M-44: a fence was replaced, and the old one is still stored. Whichever read fails at the next start, the old fence is never
/// live, and what is answered ACCEPTED is stored. Texts report that plans cannot be read, and that they can be read again.
#[test]
fn an_older_fence_does_not_stand_in() {
    let mut flash = with_fence();
    let (mut store, mut world, result) = start_plans(&mut flash);
    assert_eq!(result, Ok(()));
    assert_eq!(upload(&mut world, &mut store, &fence()[..1]), MavMissionResult::ACCEPTED);
    assert_eq!(pages::pages(&store.flash().bytes).len(), 2);
    for (read, len) in (0..15).flat_map(|read| [(read, 1), (read, 3)]) {
        let flash = RamFlash { reads: 0, fault: Fault::Reads(read..read + len), ..flash.clone() };
        let live = |world: &PlanWorld| world.stack.fence().items().len();
        // The vehicle is armed at first.
        let mut late = flash.clone();
        let (mut store, mut world, result) = start_plans(&mut late);
        assert_eq!(live(&world), usize::from(result.is_ok()), "read {read}");
        let state = world.vehicle.state;
        if let Some(state) = &mut world.vehicle.state {
            state.base_mode |= MavModeFlag::SAFETY_ARMED;
        }
        run_plans(&mut world, &mut store, secs(6));
        assert_eq!(live(&world), usize::from(result.is_ok()), "read {read}: no plan changes in flight");
        world.vehicle.state = state;
        run_plans(&mut world, &mut store, secs(6));
        assert_eq!(live(&world), 1, "read {read}");
        let texts: Vec<_> = core::iter::from_fn(|| world.gcs[0].take::<Statustext>()).map(|(_, text)| text).collect();
        let texts: Vec<_> = texts.iter().filter_map(|text| text.text.as_str()).collect();
        let expected = ["Stored plans cannot be read", "Stored plans can be read again"];
        assert_eq!(texts, if result.is_err() { &expected[..] } else { &[] }, "read {read}");

        // The old fence is uploaded again at once.
        let mut flash = flash.clone();
        let mut store = Plans::new(&mut flash, 0..PLANS);
        let mut world = PlanWorld::of(Setup::new());
        let _ = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
        let is_accepted = upload(&mut world, &mut store, &fence()) == MavMissionResult::ACCEPTED;
        let expected = if is_accepted { 2 } else { 1 };
        run_plans(&mut world, &mut store, secs(6));
        assert_eq!(live(&world), expected, "read {read}");
        let mut world = PlanWorld::of(Setup::new());
        assert_eq!(of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
        assert_eq!(live(&world), expected, "read {read}, after a restart");
    }
}

/// G-18, M-44: plans of two pages are restored late, and the vehicle arms after the first one. The fence does not change in flight,
/// and is restored after the flight. Uploads are answered meanwhile.
#[test]
fn a_late_restore_ends_when_the_vehicle_arms() {
    let mut whole = with_fence();
    let (mut store, mut world, result) = start_plans(&mut whole);
    assert_eq!(result, Ok(()));
    assert_eq!(upload(&mut world, &mut store, &plan(6, 1)), MavMissionResult::ACCEPTED);

    (whole.reads, whole.fault) = (0, Fault::Reads(0..1));
    let flash = &mut whole;
    let mut page = Page::new();
    let mut world = PlanWorld::of(Setup::new());
    world.stack.attach_storage(world.now(), Region::new(0..PLANS, 8, 512), &mut world.vehicle);
    let mut run = |world: &mut PlanWorld, arms: bool| {
        for _ in 0..3_000 {
            world.step();
            let Some(job) = world.stack.storage_job(world.now(), &mut page, &mut world.vehicle) else { continue };
            let is_done = match &job {
                Job::Read { offset, range } => flash.read(*offset, &mut page.bytes_mut()[range.clone()]).is_ok(),
                Job::Write { offset, range } => flash.write(*offset, &page.bytes()[range.clone()]).is_ok(),
                Job::Erase { offset, len } => flash.erase(*offset, offset + len).is_ok(),
            };
            let was_restored = world.vehicle.plan_changes().len();
            world.stack.storage_done(world.now(), is_done, &mut page, &mut world.vehicle);
            // The mission is in the first page, and the fence in the second one.
            let is_first_page = was_restored == 0 && world.vehicle.plan_changes().len() == 1;
            if let Some(state) = world.vehicle.state.as_mut().filter(|_| arms && is_first_page) {
                state.base_mode |= MavModeFlag::SAFETY_ARMED;
            }
        }
    };
    let state = world.vehicle.state;
    run(&mut world, true);
    assert_eq!(world.stack.restore_errors().plans, Some(RestoreError::Unreadable));
    assert_eq!((world.stack.mission().items().len(), world.stack.fence().items().len()), (6, 0));
    // A client is answered.
    let mut upload = Upload::new(&world.gcs[0], &plan(3, 2));
    for _ in 0..100 {
        world.step();
        upload.poll(world.now(), &mut world.gcs[0]);
    }
    run(&mut world, true);
    upload.poll(world.now(), &mut world.gcs[0]);
    assert_eq!(upload.result(), Some(Err(TransferError::Refused(MavMissionResult::ERROR))));
    world.vehicle.state = state;
    run(&mut world, false);
    assert_eq!(world.stack.restore_errors().plans, None);
    assert_eq!((world.stack.mission().items().len(), world.stack.fence().items().len()), (6, 2));
}

/// M-44, G-18: a plan is uploaded at any time during a late restore, also while the storage's task holds a page of the stored plans.
/// What is answered ACCEPTED is live and stored, and what was not uploaded is restored.
#[test]
fn a_plan_that_is_uploaded_during_a_late_restore_stays() {
    let whole = with_fence();
    for durability in [Durability::Durable, Durability::Deferred] {
        let mut accepted = 0;
        for calls in 0.. {
            let mut flash = RamFlash { reads: 0, fault: Fault::Reads(0..1), ..whole.clone() };
            let mut store = Plans::new(&mut flash, 0..PLANS);
            let mut world = PlanWorld::of(crate::setup(durability));
            assert!(world.stack.restore(world.now(), &mut store, &mut world.vehicle).is_err());
            world.run_for(millis(1_100));
            let mut is_over = false;
            for _ in 0..calls {
                is_over = !world.stack.exchange_job(world.now(), store.slot(), &mut world.vehicle);
                store.run();
            }
            let mut upload = Upload::new(&world.gcs[0], &plan(3, 1));
            for step in 0..8_000 {
                world.step();
                upload.poll(world.now(), &mut world.gcs[0]);
                if step >= 100 {
                    world.stack.exchange_job(world.now(), store.slot(), &mut world.vehicle);
                    store.run();
                }
            }
            let is_accepted = upload.result().is_some() && upload.answer() == MavMissionResult::ACCEPTED;
            accepted += u32::from(is_accepted);
            let items = |world: &PlanWorld| (world.stack.mission().items().len(), world.stack.fence().items().len());
            let expected = (if is_accepted { 3 } else { 0 }, 2);
            assert_eq!(items(&world), expected, "{durability:?}, after {calls} calls");
            let (_, world, result) = start_plans(&mut flash);
            assert_eq!(result, Ok(()));
            assert_eq!(items(&world), expected, "{durability:?}, after {calls} calls and a restart");
            if is_over {
                break;
            }
        }
        assert!(accepted > 0, "{durability:?}");
    }
}
