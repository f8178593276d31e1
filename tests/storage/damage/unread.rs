//! What is newest cannot be read, or not at once: what is older does not stand in for it. And what is no damage at all.

use super::*;

/// Whether the older record is not erased yet.
fn both_slots(flash: &Flash) -> bool {
    flash.bytes.starts_with(b"MVSR") && flash.bytes[flash.bytes.len() / 2..].starts_with(b"MVSR")
}

/// Runs with storage for the key until so much time went by.
fn run_key(rig: &mut Rig<3>, store: &mut Keys<'_>, seconds: u64) {
    for _ in 0..seconds * 10 {
        settle(rig, store);
        rig.run_for(millis(100));
    }
}

/// G-18: a key was replaced, or taken away, and the power went before the old one was erased. Whichever read fails at the next
/// start, the old one is never in use, and what is newest stays stored.
#[test]
fn a_replaced_key_does_not_come_back() {
    for is_off in [false, true] {
        let mut flash = with_key();
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
        if is_off {
            rig.signing().clear_key();
        } else {
            rig.set_key(OTHER_KEY);
        }
        while !both_slots(store.flash()) {
            assert!(rig.stack.persist(rig.now, &mut store, &mut rig.vehicle));
        }
        for (read, len) in (0..8).flat_map(|read| [(read, 1), (read, 3)]) {
            let mut flash = flash.clone();
            (flash.reads, flash.fault) = (0, Fault::Reads(read..read + len));
            let mut store = Keys::new(&mut flash, 0..KEYS);
            let mut rig = signing_rig();
            let result = of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle));
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

/// G-18: storage cannot be read for a minute, while the vehicle is armed too: the key comes back as soon as it can be read.
#[test]
fn a_key_comes_back_after_an_outage() {
    let mut flash = with_key();
    flash.fault = Fault::Read(0..KEYS);
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    assert!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)).is_err());
    rig.vehicle.may_persist = false;
    let reads = store.flash().reads;
    for _ in 0..60_000 {
        rig.run_for(millis(1));
        rig.stack.persist(rig.now, &mut store, &mut rig.vehicle);
    }
    assert_eq!(armed_by(&mut rig), [false, false, true]);
    assert!(store.flash().reads - reads <= 20, "{} reads", store.flash().reads - reads);
    store.flash_mut().fault = Fault::None;
    run_key(&mut rig, &mut store, 11);
    assert!(rig.transmit(1).iter().any(|frame| frame.is_signed_with(KEY)));
    assert_eq!((store.flash().writes, store.flash().erases), (2, 0), "nothing was written");
}

/// G-18: the region never was ours: old code or data, or noise. That is nothing stored, and all works as with erased storage.
#[test]
fn a_region_that_never_was_ours_is_empty() {
    let mut rng = Rng::new(18);
    for _ in 0..50 {
        let mut flash = Flash::of((0..KEYS).map(|_| rng.byte()).collect());
        flash.bytes[..4].copy_from_slice(b"\x7FELF");
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
        assert_eq!(armed_by(&mut rig), [true; 3]);
        rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(KEY)));
        settle(&mut rig, &mut store);
        let mut rig = signing_rig();
        assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
        assert!(rig.transmit(0)[0].is_signed_with(KEY));
    }
}

/// G-18: the power goes while the last bytes of the very first header are written: there is a key or none, and no damage.
#[test]
fn a_first_header_that_is_cut_off_is_no_damage() {
    for len in 1..32 {
        let mut flash = with_key();
        let slot = if flash.bytes.starts_with(b"MVSR") { 0 } else { KEYS as usize / 2 };
        flash.bytes[slot + len..slot + 32].fill(0xFF);
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()), "{len} bytes");
        assert_eq!(rig.signing().is_active(), len > 28, "{len} bytes");
    }
}

/// G-11, G-18: a station that comes later, to a vehicle whose key is lost, is told on the link where it can set the key: every 10 s.
#[test]
fn a_lost_key_is_told_where_it_can_be_set() {
    let whole = with_key();
    let bit = bits(&whole, 64).last().expect("there is a record");
    let mut flash = flipped(&whole, bit);
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Err(RestoreError::Damaged));
    rig.run_for(secs(60));
    for link in 0..3 {
        rig.transmit(link);
    }
    let mut texts = [0; 3];
    for _ in 0..21 {
        for (link, count) in texts.iter_mut().enumerate() {
            rig.receive(link, &Signer::new(KEY).unsigned(Version::V2, &Gcs::heartbeat()));
            let sent = rig.transmit(link);
            let told = sent.iter().filter_map(Sent::decode::<Statustext>);
            *count +=
                told.filter(|text| text.text.as_str() == Some("Signing key lost: set it again on this link")).count();
            assert!(sent.iter().all(|frame| !frame.is_signed()));
        }
        rig.run_for(secs(1));
    }
    assert_eq!(texts, [0, 3, 0]);
}

/// G-18, P-17: parameters were written again, and whichever read fails at the next start, older values never replace newer ones.
#[test]
fn older_parameters_do_not_replace_newer_ones() {
    let mut flash = with_params();
    let mut store = Params::new(&mut flash, 0..PARAMS);
    let mut world = World::new(Setup::<1>::new());
    assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    world.gcs[0].send(&set("RTL_ALT", 55.0));
    while !both_slots(store.flash()) {
        world.step();
        world.stack.persist(world.now(), &mut store, &mut world.vehicle);
    }
    for (read, len) in (0..16).flat_map(|read| [(read, 1), (read, 3)]) {
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

/// P-17: the stored values are wanted back, and cannot be read: what was set and not written yet still is.
#[test]
fn a_reload_that_fails_loses_nothing() {
    let mut flash = with_params();
    let mut store = Params::new(&mut flash, 0..PARAMS);
    let mut world = World::new(Setup::<1>::new());
    assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    world.gcs[0].send(&set("CRUISE", 8.0));
    run(&mut world, &mut store, millis(500));
    let (first, read_all) = (
        store.flash().reads,
        CommandLong { command: MavCmd::PREFLIGHT_STORAGE, target_system: 1, target_component: 1, ..Default::default() },
    );
    store.flash_mut().fault = Fault::Reads(first..first + 2);
    world.gcs[0].send(&read_all);
    run(&mut world, &mut store, secs(25));
    let mut world = World::new(Setup::<1>::new());
    assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    assert_eq!(cruise_and_altitude(&world), (8.0, 99.0));
}

/// G-18, M-44: a fence was replaced, and the power went before the old one was erased. Whichever read fails at the next start, the
/// old fence is never live, and what is ACCEPTED is stored. The operators are told when plans come back, and of no failure.
#[test]
fn an_older_fence_does_not_stand_in() {
    let mut flash = with_fence();
    let mut store = Plans::new(&mut flash, 0..PLANS);
    let mut world = PlanWorld::of(Setup::new());
    assert_eq!(of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    assert_eq!(upload(&mut world, &mut store, &fence()[..1]), MavMissionResult::ACCEPTED);
    assert!(both_slots(store.flash()));
    for (read, len) in (0..10).flat_map(|read| [(read, 1), (read, 3)]) {
        let flash = RamFlash { reads: 0, fault: Fault::Reads(read..read + len), ..flash.clone() };
        let live = |world: &PlanWorld| world.stack.fence().items().len();
        // The vehicle is armed at first.
        let mut late = flash.clone();
        let mut store = Plans::new(&mut late, 0..PLANS);
        let mut world = PlanWorld::of(Setup::new());
        let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
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
        let expected = ["Stored plans cannot all be read", "Stored plans can be read again"];
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
