//! Power cuts at every byte written and in every erase, and second cuts after them (SEC-11).

use super::flash::{RamFlash, Torn};
use super::*;

/// Flash with `old`, and an erased spare slot.
fn holding<const W: usize, const E: usize>(old: &Content, len: u32) -> RamFlash<W, E> {
    let mut store = store(RamFlash::<W, E>::new(len));
    assert_eq!(store.open(), Ok(None));
    assert_eq!(write(&mut store, 1, old), Step::Done);
    assert_eq!(settle(&mut store), Step::Idle);
    store.into_inner()
}

/// Stores `new` and then erases the spare slot, with a power cut after `fuel`. Returns the flash, and whether storing
/// was done.
fn commit<const W: usize, const E: usize>(
    mut flash: RamFlash<W, E>,
    new: &Content,
    fuel: Option<u64>,
) -> (RamFlash<W, E>, bool) {
    flash.fuel = fuel;
    let mut store = store(flash);
    retry_reading(&mut store);
    let is_done = write(&mut store, 7, new) == Step::Done;
    settle(&mut store);
    let mut flash = store.into_inner();
    flash.power_on();
    (flash, is_done)
}

/// The fuel of a whole [`commit`].
fn cost<const W: usize, const E: usize>(flash: &RamFlash<W, E>, new: &Content) -> u64 {
    let (after, is_done) = commit(flash.clone(), new, None);
    assert!(is_done);
    after.cost() - flash.cost()
}

/// Calls `each` for every power cut while `new` replaces `old`.
fn each_cut<const W: usize, const E: usize>(
    old: &Content,
    new: &Content,
    torn: Torn,
    mut each: impl FnMut(RamFlash<W, E>),
) {
    let rows = |content: &Content| content.items.iter().map(Vec::len).sum::<usize>() + 2;
    let len = PlanStore::<RamFlash<W, E>>::region_len(rows(old).max(rows(new)), 0, 0);
    let mut flash = holding::<W, E>(old, len);
    flash.torn = torn;
    let (mut was_old, mut was_new) = (0, 0);
    for fuel in 0..cost(&flash, new) {
        let (cut, is_done) = commit(flash.clone(), new, Some(fuel));
        let found = restart(cut.clone()).expect("a record");
        assert!(found == *old || found == *new, "cut after {fuel}: neither old nor new");
        assert!(!is_done || found == *new, "cut after {fuel}: done but lost");
        if found == *new {
            was_new += 1
        } else {
            was_old += 1
        }
        each(cut);
    }
    assert!(was_old > 0 && was_new > 0, "both outcomes must occur");
}

fn every_cut<const W: usize, const E: usize>(torn: Torn) {
    let (old, new) = (Content::new([9, 2, 1], 5), Content::new([10, 0, 4], 6));
    for plan in 0..3 {
        each_cut::<W, E>(&old, &old.with(plan, &new), torn, |_| {});
    }
    // All three at once, as by MISSION_CLEAR_ALL of ALL.
    each_cut::<W, E>(&old, &Content::default(), torn, |_| {});
}

/// SEC-11: with flash of different write and erase units.
#[test]
fn a_cut_anywhere_leaves_the_old_plans_or_the_new() {
    every_cut::<1, 64>(Torn::Prefix);
    every_cut::<4, 128>(Torn::Prefix);
    every_cut::<4, 4096>(Torn::Garbage);
    every_cut::<8, 2048>(Torn::Garbage);
    every_cut::<32, 256>(Torn::Prefix);
    every_cut::<32, 1024>(Torn::Unreadable);
    every_cut::<256, 256>(Torn::Garbage);
    every_cut::<256, 4096>(Torn::Unreadable);
}

/// A second power cut, at every byte of the recovery from the first cut and of the next commit (SEC-11).
fn two_cuts<const W: usize, const E: usize>(torn: Torn) {
    let old = Content::new([1, 1, 0], 5);
    let (new, next) = (Content::new([2, 0, 1], 6), Content::new([1, 2, 0], 7));
    for plan in 0..3 {
        each_cut::<W, E>(&old, &old.with(plan, &new), torn, |cut| {
            let before = restart(cut.clone()).unwrap();
            // `commit` recovers from the first cut and stores `next`.
            for fuel in 0..cost(&cut, &next) {
                let (cut, is_done) = commit(cut.clone(), &next, Some(fuel));
                let found = restart(cut).expect("a record");
                assert!(found == before || found == next, "second cut after {fuel}: neither old nor new");
                assert!(!is_done || found == next, "second cut after {fuel}: done but lost");
            }
        });
    }
}

#[test]
fn second_cut_with_small_units() {
    two_cuts::<1, 64>(Torn::Prefix);
}

#[test]
fn second_cut_with_large_units() {
    two_cuts::<8, 512>(Torn::Garbage);
    two_cuts::<32, 256>(Torn::Unreadable);
}

/// G-18: after a cut in the very first commit, storage is empty or has the new record. Damage is reported only if the
/// cut leaves garbage in the header, or a part of its last word.
#[test]
fn cut_in_the_first_commit() {
    let new = Content::new([3, 1, 1], 9);
    for torn in [Torn::Prefix, Torn::Garbage, Torn::Unreadable] {
        let mut flash = RamFlash::<8, 256>::new(1024);
        flash.torn = torn;
        let mut damaged = 0;
        for fuel in 0..cost(&flash, &new) {
            let (cut, is_done) = commit(flash.clone(), &new, Some(fuel));
            let found = store(cut.clone()).open().map(|found| found.is_some());
            assert!(!is_done || found == Ok(true));
            damaged += u32::from(found == Err(RestoreError::Damaged));
            // The next commit succeeds even if the cut left unreadable memory.
            let (healed, is_done) = commit(cut, &new, None);
            assert!(is_done);
            assert_eq!(restart(healed), Some(new.clone()));
        }
        assert!(damaged <= if torn == Torn::Garbage { 28 } else { 3 }, "{torn:?}: {damaged}");
    }
}

/// A thousand commits with a cut in each, while the sequence number wraps.
#[test]
fn a_thousand_cuts() {
    let mut flash = holding::<4, 256>(&Content::new([1, 1, 1], 1), 2048);
    layout::set_sequence(&mut flash.bytes, 0, 1024, u32::MAX - 300);
    let mut before = restart(flash.clone()).unwrap();
    for salt in 2..1000 {
        let new = Content::new([(salt % 5) as u16, (salt % 3) as u16, 1], salt);
        let fuel = u64::from(salt.wrapping_mul(0x9E37_79B9) >> 16) % (cost(&flash, &new) * 2);
        let (cut, is_done) = commit(flash, &new, Some(fuel));
        let found = restart(cut.clone()).unwrap();
        assert!(found == before || found == new);
        assert!(!is_done || found == new);
        (before, flash) = (found, cut);
    }
    assert!(
        layout::sequences(&flash.bytes, 1024).into_iter().flatten().all(|sequence| sequence < 1000),
        "the sequence number has wrapped"
    );
}
