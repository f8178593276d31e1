//! Drivers that fail, lie, and cannot read (G-18, SEC-11).

use super::flash::Fault;
use super::*;

const W: usize = 8;
const E: usize = 1024;

/// A journal with records of three kinds, whose next save of kind 1 begins a segment if `is_full`.
fn filled(is_full: bool) -> (Rig<W, E>, Model) {
    let mut rig = Rig::<W, E>::blank(8 * E as u32);
    let mut model = Model::new();
    for salt in 0..if is_full { 9 } else { 4 } {
        let kind = (salt % 3 + 1) as u8;
        let new = content(if kind == 1 { 3 * PAYLOAD } else { 40 }, salt);
        assert_eq!(rig.save(kind, &new), Saved::Yes);
        model.insert(kind, new);
    }
    (rig, model)
}

/// Each of the writes fails, writes half, or writes a wrong bit: the save fails, the old content remains, and the next
/// save succeeds.
#[test]
fn failing_writes_change_nothing() {
    for is_full in [false, true] {
        for write in 0..12 {
            for fault in [Fault::Write(write), Fault::HalfWrite(write), Fault::WrongWrite(write)] {
                let (mut rig, mut model) = filled(is_full);
                let new = content(3 * PAYLOAD, 99);
                rig.flash.writes = 0;
                rig.flash.fault = fault.clone();
                let saved = rig.save(1, &new);
                if saved == Saved::Yes {
                    assert!(write >= 4, "{fault:?}");
                    model.insert(1, new.clone());
                }
                rig.flash.fault = Fault::None;
                let mut again = Rig::start(rig.flash.clone());
                assert_eq!(again.all(), model, "{fault:?}, {is_full}");
                assert!(
                    again.damaged().iter().all(|kind| *kind == 1 && matches!(fault, Fault::WrongWrite(_))),
                    "{fault:?}"
                );
                assert_eq!(rig.save(1, &content(30, 5)), Saved::Yes);
                model.insert(1, content(30, 5));
                assert_eq!(rig.all(), model);
                assert_eq!(Rig::restarted(&rig.flash), model, "{fault:?}");
            }
        }
    }
}

/// A record that can be read back is stored, even if the driver reported an error for the last write.
#[test]
fn a_last_write_that_reads_back_counts() {
    let (mut rig, mut model) = filled(false);
    let new = content(40, 50);
    let mut writes = 0;
    let saved = rig.save_with(2, &new, false, |rig, job| {
        if matches!(job, Job::Write { .. }) {
            writes += 1;
            if writes == 2 {
                rig.flash.fault = Fault::LyingWrite(rig.flash.writes);
            }
        }
    });
    rig.flash.fault = Fault::None;
    assert_eq!(saved, Saved::Yes);
    model.insert(2, new);
    assert_eq!(rig.all(), model);
    assert_eq!(Rig::restarted(&rig.flash), model);
}

/// While it is not known whether the last page is whole, nothing else is done. If the page can be read in time, it
/// counts. Otherwise the save fails, and the page does not count after a restart either, if it would have opened a segment.
#[test]
fn a_last_page_that_cannot_be_read_back() {
    for (is_full, recovers) in [(false, true), (true, true), (false, false), (true, false)] {
        let (mut rig, mut model) = filled(is_full);
        let new = content(3 * PAYLOAD, 50);
        let (mut is_last, mut began, mut erases) = (false, rig.now, 0);
        let saved = rig.save_with(1, &new, false, |rig, job| {
            if is_last {
                assert!(matches!(job, Job::Read { .. }) || is_full && !recovers, "{job:?}");
                erases += u32::from(matches!(job, Job::Erase { .. }));
                if recovers && rig.now - began > Duration::from_secs(2) {
                    rig.flash.fault = Fault::None;
                }
            }
            let writes_footer = matches!(job, Job::Write { range, .. } if range.start > 0);
            let page = rig.page.bytes();
            if writes_footer && page[3] == 1 && page[239] & 2 == 0 {
                (is_last, began) = (true, rig.now);
                rig.flash.fault = Fault::Read(0..u32::MAX);
            }
        });
        rig.flash.fault = Fault::None;
        let before = model.insert(1, new.clone());
        if recovers {
            assert_eq!(saved, Saved::Yes);
        } else {
            assert_eq!((saved, erases), (Saved::No, u32::from(is_full)));
            assert_eq!(rig.load(1), before);
            if is_full {
                model.insert(1, before.unwrap());
            }
        }
        assert_eq!(Rig::restarted(&rig.flash), model, "{is_full} {recovers}");
        assert_eq!(rig.save(1, &content(20, 3)), Saved::Yes);
        model.insert(1, content(20, 3));
        assert_eq!(Rig::restarted(&rig.flash), model);
    }
}

/// Erases fail: the save fails, the old content remains, and a later save succeeds.
#[test]
fn failing_erases_change_nothing() {
    let (mut rig, mut model) = filled(true);
    rig.flash.fault = Fault::Erase;
    for _ in 0..5 {
        assert_eq!(rig.save(1, &content(3 * PAYLOAD, 99)), Saved::No);
        assert_eq!(rig.all(), model);
        assert_eq!(Rig::restarted(&rig.flash), model);
    }
    rig.flash.fault = Fault::None;
    assert_eq!(rig.save(1, &content(3 * PAYLOAD, 98)), Saved::Yes);
    model.insert(1, content(3 * PAYLOAD, 98));
    assert_eq!(Rig::restarted(&rig.flash), model);
}

/// G-18: any one read, or several in a row, fail at a start: reading is repeated, nothing is written before, and nothing
/// is lost.
#[test]
fn failed_reads_lose_nothing() {
    let (rig, model) = filled(true);
    let reads = {
        let mut flash = rig.flash.clone();
        flash.reads = 0;
        Rig::start(flash).flash.reads
    };
    for first in 0..reads {
        for count in [1, 5, 2 * reads] {
            let mut flash = rig.flash.clone();
            let before = flash.bytes.clone();
            flash.reads = 0;
            flash.fault = Fault::Reads(first..first + count);
            let mut rig = Rig::start(flash);
            assert!(rig.now >= Instant::from_millis(2_000), "it was read again");
            assert_eq!(rig.flash.bytes, before);
            rig.flash.fault = Fault::None;
            assert_eq!((rig.all(), rig.damaged()), (model.clone(), Vec::new()), "reads {first} to {}", first + count);
        }
    }
}

/// G-18: a page that stays unreadable counts as lost after four attempts, a second apart. Its content is reported.
#[test]
fn a_page_that_stays_unreadable_is_lost() {
    let (rig, model) = filled(true);
    for page in 0..rig.flash.bytes.len() as u32 / 256 {
        let mut flash = rig.flash.clone();
        flash.fault = Fault::Read(page * 256..page * 256 + 256);
        let mut rig = Rig::start(flash);
        assert_eq!(rig.now, Instant::from_millis(4_000), "three pauses");
        let lost = rig.damaged();
        for (kind, content) in &model {
            let found = rig.load(*kind);
            assert!(found.as_ref() == Some(content) || lost.contains(kind) || page == 14, "page {page} kind {kind}");
        }
        // A save that needs just this page fails, and a later one succeeds.
        let is_saved = (0..3).any(|salt| rig.save(7, &content(40, salt)) == Saved::Yes);
        assert!(is_saved || (16..24).contains(&page), "page {page}: the next segment needs it");
    }
}

/// G-18: while no page can be read, nothing is written, and reading is repeated for ever.
#[test]
fn unreadable_storage_is_not_written() {
    let (rig, model) = filled(true);
    let mut flash = rig.flash;
    let before = (flash.erases, flash.writes);
    flash.fault = Fault::Read(0..u32::MAX);
    let mut rig = Rig::new(flash);
    for _ in 0..20_000 {
        match rig.journal.next(rig.now, true, &mut rig.page) {
            Next::Job(job) => {
                assert!(matches!(job, Job::Read { .. }));
                rig.run(&job);
            }
            _ => rig.now += Duration::from_secs(1),
        }
        assert!(!rig.journal.is_idle());
    }
    assert_eq!((rig.flash.erases, rig.flash.writes), before);
    rig.flash.fault = Fault::None;
    rig.settle();
    assert_eq!(rig.all(), model);
}

/// A record that becomes unreadable is lost when the next segment is begun. The others are copied, and a restart reports
/// it.
#[test]
fn a_record_that_is_lost_later_is_reported() {
    let (mut rig, mut model) = filled(true);
    let lost = rig.flash.bytes.chunks(256).rposition(|page| page.starts_with(b"ML\x01\x03")).unwrap() as u32;
    rig.flash.fault = Fault::Read(lost * 256..lost * 256 + 256);
    let mut told = Vec::new();
    assert!(rig.journal.begin(1, 1, 3, false));
    model.insert(1, content(3 * PAYLOAD, 8));
    loop {
        match rig.journal.next(rig.now, true, &mut rig.page) {
            Next::Job(job) => match rig.run(&job) {
                Event::Written => break,
                Event::Nothing => {}
                event => told.push(event),
            },
            Next::Content(index) => {
                let at = usize::from(index) * PAYLOAD;
                rig.page.payload_mut().copy_from_slice(&model[&1][at..at + PAYLOAD]);
                rig.journal.put(&mut rig.page, PAYLOAD as u8, index == 2);
            }
            Next::Idle => rig.now += Duration::from_secs(1),
        }
    }
    assert_eq!(told, [Event::Lost(3)]);
    rig.flash.fault = Fault::None;
    let mut rig = Rig::start(rig.flash);
    model.remove(&3);
    assert_eq!((rig.all(), rig.damaged()), (model, std::vec![3]));
}

/// SEC-15: after a secret record is replaced, no unit has the old one.
#[test]
fn an_old_secret_is_erased() {
    for is_full in [false, true] {
        let (mut rig, mut model) = filled(is_full);
        let (old, new) = (content(41, 1_000), content(41, 1_001));
        assert_eq!(rig.save(3, &old), Saved::Yes);
        assert!(rig.flash.bytes.windows(41).any(|bytes| bytes == old));
        assert_eq!(rig.save_with(3, &new, true, |_, _| {}), Saved::Yes);
        rig.settle();
        assert!(!rig.flash.bytes.windows(41).any(|bytes| bytes == old));
        model.insert(3, new);
        assert_eq!(Rig::restarted(&rig.flash), model);
    }
}

/// A save that is given up at any point changes nothing, and the next one succeeds.
#[test]
fn an_abandoned_save_changes_nothing() {
    for is_full in [false, true] {
        for at in 0..40 {
            let (mut rig, mut model) = filled(is_full);
            assert!(rig.journal.begin(1, 1, 3, false));
            let new = content(3 * PAYLOAD, 77);
            let mut is_written = false;
            for _ in 0..at {
                match rig.journal.next(rig.now, true, &mut rig.page) {
                    Next::Job(job) => is_written |= rig.run(&job) == Event::Written,
                    Next::Content(index) => {
                        let at = usize::from(index) * PAYLOAD;
                        rig.page.payload_mut().copy_from_slice(&new[at..at + PAYLOAD]);
                        rig.journal.put(&mut rig.page, PAYLOAD as u8, index == 2);
                    }
                    Next::Idle => break,
                }
            }
            rig.journal.abandon();
            if rig.journal.is_writing() {
                // A page is written, and only its check is left.
                let Next::Job(job) = rig.journal.next(rig.now, true, &mut rig.page) else { panic!("a check") };
                assert!(matches!(job, Job::Read { .. }));
                is_written = rig.run(&job) == Event::Written;
                rig.journal.abandon();
            }
            if is_written {
                model.insert(1, new);
            }
            assert_eq!(rig.all(), model, "after {at} steps");
            assert_eq!(Rig::restarted(&rig.flash), model, "after {at} steps");
            assert_eq!(rig.save(2, &content(60, 9)), Saved::Yes);
            model.insert(2, content(60, 9));
            assert_eq!(Rig::restarted(&rig.flash), model, "after {at} steps");
        }
    }
}
