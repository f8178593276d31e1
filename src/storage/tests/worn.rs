//! Worn units: each is left out wherever it stands, and every save succeeds while enough others remain.

use std::{format, vec};

use super::flash::{Fault, Torn, Worn};
use super::*;

const W: usize = 8;
const E: usize = 1024;

/// A journal in new flash with these worn units.
fn worn(units: u32, worn: &[(usize, Worn)]) -> Rig<W, E> {
    let mut flash = RamFlash::new(units * E as u32);
    flash.worn = worn.to_vec();
    Rig::start(flash)
}

/// Saves three kinds in turns, through several segments; the first one has this many pages. After each save there is time to erase
/// ahead. Starts again now and then.
fn check(rig: Rig<W, E>, saves: u32, pages: usize, what: &str) -> Rig<W, E> {
    check_with(rig, saves, pages, 0, what)
}

/// As [`check`], but a save may fail so many times.
fn check_with(rig: Rig<W, E>, saves: u32, pages: usize, retries: usize, what: &str) -> Rig<W, E> {
    let (mut rig, mut model) = (rig, Model::new());
    for salt in 0..saves {
        let kind = (salt % 3 + 1) as u8;
        let new = content(if kind == 1 { pages * PAYLOAD } else { 40 }, salt);
        let tries = (0..=retries).take_while(|_| rig.save(kind, &new) != Saved::Yes).count();
        assert!(tries <= retries, "{what}: save {salt}");
        model.insert(kind, new);
        rig.now += Duration::from_secs(1);
        rig.settle();
        assert_eq!(rig.all(), model, "{what}: save {salt}");
        if salt % 5 == 0 {
            assert_eq!(Rig::restarted(&rig.flash), model, "{what}: save {salt}");
        }
        if salt % 11 == 0 {
            rig = Rig::start(rig.flash);
        }
    }
    rig
}

/// Every unit in turn is worn, in one of three ways: it cannot be erased, cannot be written, or does not keep written
/// data. Among them the first of a segment, which once ended storage for good.
#[test]
fn every_save_succeeds_beside_a_worn_unit() {
    let all: Vec<_> = (0..12).collect();
    for (units, saves, of) in [(12, 50, &*all), (13, 60, &[0, 6, 7, 12]), (48, 130, &[0, 1, 23, 24, 47])] {
        for &unit in of {
            for how in [Worn::Erase, Worn::Write, Worn::Keep] {
                let what = format!("unit {unit} of {units}: {how:?}");
                check(worn(units, &[(unit, how)]), saves, 3, &what);
            }
        }
    }
}

/// Any two of the units cannot be erased; or do not keep written data, and then a save may fail once if both are met.
#[test]
fn every_save_succeeds_beside_two_worn_units() {
    for first in 0..12 {
        for second in 0..first {
            for (how, retries) in [(Worn::Erase, 0), (Worn::Keep, 1)] {
                let what = format!("{first} and {second}: {how:?}");
                check_with(worn(12, &[(first, how), (second, how)]), 30, 3, retries, &what);
            }
        }
    }
}

/// Two units of one segment do not keep written data, and the new record meets each of them: the copies before it stay.
/// The segments rotate, because the region has an odd number of units; each second record is a key, which begins a
/// segment.
#[test]
fn copies_stay_when_only_the_new_record_meets_worn_units() {
    for first in 0..11 {
        for second in 0..first {
            let (mut rig, mut model) = (worn(11, &[(first, Worn::Keep), (second, Worn::Keep)]), Model::new());
            for salt in 0..60 {
                let kind = (salt % 7 % 3 + 1) as u8;
                let new = content(if kind == 1 { 3 * PAYLOAD } else { 40 }, salt);
                let tries =
                    (0..2).take_while(|_| rig.save_with(kind, &new, salt % 2 == 0, |_, _| {}) != Saved::Yes).count();
                assert!(tries <= 1, "{first} and {second}: save {salt}");
                model.insert(kind, new);
                assert_eq!(rig.all(), model, "{first} and {second}: save {salt}");
                assert_eq!(Rig::start(rig.flash.clone()).all(), model, "{first} and {second}: save {salt}");
            }
        }
    }
}

/// A long record is copied around a worn unit anywhere in a segment, also if it begins before it.
#[test]
fn copies_are_made_around_a_worn_unit() {
    for unit in 0..12 {
        check(worn(12, &[(unit, Worn::Erase)]), 40, 8, &format!("unit {unit}"));
    }
}

/// A unit wears out while the journal is in use, in each save of a run in turn.
#[test]
fn a_unit_wears_out_at_any_time() {
    for unit in [0, 3, 6, 9] {
        for at in (0..30).step_by(4) {
            let mut rig = check(worn(12, &[]), at + 1, 3, "sound");
            rig.flash.worn.push((unit, Worn::Erase));
            let model = rig.all();
            assert_eq!(Rig::restarted(&rig.flash), model);
            for salt in 0..30 {
                assert_eq!(rig.save(2, &content(40, 900 + salt)), Saved::Yes, "unit {unit} after {at}, save {salt}");
            }
            let found = Rig::restarted(&rig.flash);
            assert_eq!(found[&2], content(40, 929));
            assert!([1, 3].iter().all(|kind| found.get(kind) == model.get(kind)));
        }
    }
}

/// If too few units remain, saves fail, nothing that was stored is lost, and each attempt ends. A unit that works again is used.
#[test]
fn too_few_sound_units_lose_nothing() {
    let mut rig = check(worn(12, &[]), 9, 8, "sound");
    let model = rig.all();
    rig.flash.worn = (0..12).map(|unit| (unit, Worn::Erase)).collect();
    let mut failed = 0;
    for salt in 0..30 {
        let before = rig.all();
        if rig.save(2, &content(40, salt)) == Saved::No {
            failed += 1;
            assert_eq!(rig.all(), before);
            assert_eq!(Rig::restarted(&rig.flash), before);
        }
    }
    assert!(failed > 20, "{failed}");
    rig.flash.worn.clear();
    assert_eq!(rig.save(2, &content(40, 99)), Saved::Yes);
    let found = Rig::restarted(&rig.flash);
    assert_eq!((&found[&1], &found[&2]), (&model[&1], &content(40, 99)));
}

/// A storage that takes nothing at all is not erased over and over: a save erases a few units, then fails.
#[test]
fn storage_that_takes_nothing_is_hardly_worn() {
    for fault in [Fault::Write(0), Fault::WrongWrite(0)] {
        let mut rig = check(worn(48, &[]), 9, 3, "sound");
        let model = rig.all();
        rig.flash.writes = 0;
        rig.flash.fault = fault.clone();
        let erases = rig.flash.erases;
        for salt in 0..10 {
            assert_eq!(rig.save(2, &content(40, salt)), Saved::No, "{fault:?}");
        }
        assert!(rig.flash.erases - erases <= 25, "{fault:?}: {}", rig.flash.erases - erases);
        rig.flash.fault = Fault::None;
        assert_eq!(rig.save(2, &content(40, 99)), Saved::Yes);
        let found = Rig::restarted(&rig.flash);
        assert_eq!((&found[&1], &found[&3]), (&model[&1], &model[&3]), "{fault:?}");
    }
}

/// SEC-15: an old key is erased from all units but a worn one, which is given up after some attempts.
#[test]
fn an_old_key_is_erased_beside_a_worn_unit() {
    for unit in 0..12 {
        let mut rig = check(worn(12, &[]), 40, 3, "sound");
        rig.flash.worn.push((unit, Worn::Erase));
        assert_eq!(rig.save_with(3, &content(41, 7_000), true, |_, _| {}), Saved::Yes, "{unit}");
        let model = rig.all();
        let mut erases = 0;
        for _ in 0..200 {
            rig.now += Duration::from_secs(1);
            while let Next::Job(job) = rig.journal.next(rig.now, true, &mut rig.page) {
                erases += u32::from(matches!(job, Job::Erase { .. }));
                rig.run(&job);
            }
        }
        assert!(erases < 20, "{unit}: {erases}");
        let old: Vec<_> = (0..37).filter(|salt| salt % 3 == 2).map(|salt| content(40, salt)).collect();
        let units = rig.flash.bytes.chunks(E).enumerate().filter(|(at, _)| *at != unit);
        for (at, bytes) in units {
            let page = |page: &[u8]| page[3] == 3 && old.iter().any(|old| page[4..].starts_with(old));
            assert!(!bytes.chunks(256).any(page), "{unit}: an old key in unit {at}");
        }
        assert_eq!(rig.all(), model);
        assert_eq!(Rig::restarted(&rig.flash), model);
    }
}

/// SEC-11: a power cut at any byte of a save that leaves a unit out, in the open segment and in a new one.
#[test]
fn power_cuts_beside_a_worn_unit() {
    for unit in [0, 1, 4] {
        for how in [Worn::Erase, Worn::Write, Worn::Keep] {
            for appends in [0, 3, 5, 7] {
                let mut rig = check(worn(8, &[(unit, how)]), 3 + appends, 3, "before");
                rig.flash.torn = Torn::Garbage;
                let (flash, model) = (rig.flash.clone(), rig.all());
                let mut changed = model.clone();
                changed.insert(1, content(3 * PAYLOAD, 77));
                for fuel in (0..).step_by(41) {
                    let mut rig = Rig::start(flash.clone());
                    rig.flash.fuel = Some(fuel);
                    let saved = rig.save(1, &changed[&1]);
                    let is_cut = rig.flash.is_off();
                    rig.flash.power_on();
                    let mut again = Rig::start(rig.flash.clone());
                    let found = again.all();
                    assert!(found == model || found == changed, "{unit} {how:?} {appends}: cut after {fuel}");
                    assert!(saved != Saved::Yes || found == changed, "{unit} {how:?} {appends}: cut after {fuel}");
                    assert_eq!(
                        again.save(2, &content(40, 78)),
                        Saved::Yes,
                        "{unit} {how:?} {appends}: cut after {fuel}"
                    );
                    if !is_cut {
                        break;
                    }
                }
            }
        }
    }
}

/// Returns the flash with another segment number in all pages, or in those of one kind.
fn renumbered(flash: &RamFlash<W, E>, number: u32, kind: Option<u8>) -> RamFlash<W, E> {
    let mut flash = flash.clone();
    for page in flash.bytes.chunks_mut(256).filter(|page| page.starts_with(b"ML\x01")) {
        if kind.is_some_and(|kind| page[3] != kind) {
            continue;
        }
        page[228..232].copy_from_slice(&number.to_le_bytes());
        for (covered, place) in [(0..248, 248..252), (228..252, 252..256)] {
            let mut crc = crc_any::CRCu32::crc32();
            crc.digest(&page[covered]);
            page[place].copy_from_slice(&crc.get_crc().to_le_bytes());
        }
    }
    flash
}

/// G-18: a segment number that no segment has is damage, not an empty journal. The next save ends it.
#[test]
fn impossible_segment_numbers_are_damage() {
    let mut rig = check(worn(8, &[]), 3, 1, "sound");
    let model = rig.all();
    for number in [1, 2, 1 << 30, i32::MAX as u32] {
        assert_eq!(Rig::restarted(&renumbered(&rig.flash, number, None)), model, "{number:#x}");
    }
    for number in [0, 1 << 31, (1 << 31) + 1, u32::MAX] {
        let mut rig = Rig::start(renumbered(&rig.flash, number, None));
        assert_eq!((rig.damaged(), rig.all()), ((1..10).collect(), Model::new()), "{number:#x}");
        assert!(!rig.journal.has_other_data());
        for kind in 1..4 {
            assert_eq!(rig.save(kind, &model[&kind]), Saved::Yes);
        }
        let mut rig = Rig::start(rig.flash);
        assert_eq!((rig.all(), rig.damaged()), (model.clone(), vec![4, 5, 6, 7, 8, 9]), "{number:#x}");
    }
    // Beside whole records, such a page is a page that is not whole.
    assert_eq!(rig.save(4, &content(40, 4)), Saved::Yes);
    let mut rig = Rig::start(renumbered(&rig.flash, 1 << 31, Some(4)));
    assert_eq!((rig.all(), rig.damaged()), (model, vec![]));
}
