//! Failing storage, jobs that change or are aborted, and unnecessary erases and writes.

use super::flash::{Fault, FlashError, RamFlash};
use super::*;
use crate::time::Duration;

type Flash = RamFlash<8, 256>;

/// A store with `old`, and a blank spare slot.
fn holding(old: &Content) -> PlanStore<Flash> {
    let mut store = store(Flash::new(4096));
    assert_eq!(store.open(), Ok(None));
    assert_eq!(write(&mut store, 1, old), Step::Done);
    assert_eq!(settle(&mut store), Step::Idle);
    store
}

fn contents() -> (Content, Content) {
    (Content::new([9, 2, 1], 5), Content::new([10, 3, 4], 6))
}

/// Each of the writes fails: the old plans remain, and the next attempt succeeds.
#[test]
fn failing_writes_change_nothing() {
    let (old, new) = contents();
    let writes = 4;
    for after in 0..writes {
        for fault in [Fault::Write(after), Fault::HalfWrite(after), Fault::WrongWrite(after)] {
            let mut store = holding(&old);
            store.flash_mut().writes = 0;
            store.flash_mut().fault = fault.clone();
            assert_eq!(write(&mut store, 2, &new), Step::Failed, "{fault:?}");
            assert_eq!(restart(store.flash().clone()), Some(old.clone()), "{fault:?}");
            store.flash_mut().fault = Fault::None;
            assert_eq!(write(&mut store, 2, &new), Step::Done);
            assert_eq!(store.flash().writes, after + 1 + writes);
            assert_eq!(restart(store.into_inner()), Some(new.clone()));
        }
    }
}

/// A header that can be read back is valid, even if the driver reported an error.
#[test]
fn a_header_that_reads_back_is_durable() {
    let (old, new) = contents();
    let mut store = holding(&old);
    store.flash_mut().writes = 0;
    store.flash_mut().fault = Fault::LyingWrite(3);
    assert_eq!(write(&mut store, 2, &new), Step::Done);
    assert_eq!(restart(store.into_inner()), Some(new.clone()));

    let mut store = holding(&old);
    store.flash_mut().fault = Fault::LyingWrite(0);
    assert_eq!(write(&mut store, 2, &new), Step::Failed, "a failed write of the body fails the job");
    assert_eq!(restart(store.into_inner()), Some(old));
}

/// A header that cannot be read back may have been written. It is erased first, so that it does not become valid later.
#[test]
fn an_unconfirmed_header_is_erased_first() {
    let (old, new) = contents();
    let mut store = holding(&old);
    store.flash_mut().fault = Fault::Read(2048..2052);
    assert_eq!(write(&mut store, 2, &new), Step::Failed);
    store.flash_mut().fault = Fault::None;
    assert_eq!(restart(store.flash().clone()), Some(new.clone()), "it was written");
    let erases = store.flash().erases;
    assert_eq!(store.step(later(), None), Step::Busy);
    assert_eq!(store.flash().erases, erases + 1);
    assert_eq!(restart(store.into_inner()), Some(old));
}

/// Without a record, the first one is written to the slot that could not be read, because erasing may repair it. The
/// second one is written to the other slot.
#[test]
fn the_first_record_repairs_an_unreadable_slot() {
    let (old, new) = contents();
    let mut store = store(Flash::new(4096));
    store.flash_mut().fault = Fault::Read(2048..2052);
    assert!(store.open().is_err());
    while store.flash().erases == 0 {
        assert_eq!(store.step(later(), Some((1, old.views()))), Step::Busy);
    }
    store.flash_mut().fault = Fault::None;
    assert_eq!(write(&mut store, 1, &old), Step::Done);
    assert_eq!(layout::sequences(&store.flash().bytes, 2048), [None, Some(1)]);
    assert_eq!(write(&mut store, 2, &new), Step::Done);
    assert_eq!(layout::sequences(&store.flash().bytes, 2048), [Some(2), Some(1)]);
}

/// The stored content changes only when the new record is complete.
#[test]
fn an_incomplete_record_is_not_visible() {
    let (old, new) = contents();
    let mut store = holding(&old);
    let last = new.items[0].len() as u16 - 1;
    assert_eq!(store.step(later(), Some((2, new.views()))), Step::Busy);
    assert_eq!(store.item(PlanType::Mission, last).unwrap(), None);
    assert_eq!(write(&mut store, 2, &new), Step::Done);
    assert!(store.item(PlanType::Mission, last).unwrap().is_some());
}

/// G-18: a slot that cannot be read may have the newer record. The other record is not used until several attempts to
/// read it have failed.
#[test]
fn an_unreadable_slot_is_reported() {
    let (old, _) = contents();
    let mut store = holding(&old);
    assert!(store.open().unwrap().is_some() && !store.is_impaired());
    store.flash_mut().fault = Fault::Read(2048..2052);
    for _ in 0..3 {
        assert_eq!(store.open(), Err(RestoreError::Storage(FlashError::Fault)));
        assert_eq!(settle(&mut store), Step::Idle);
    }
    assert_eq!(settle(&mut store), Step::Unread);
    assert!(store.open().unwrap().is_some() && store.is_impaired() && !store.is_damaged());
}

/// G-18: a valid header with a permanently unreadable body is damage, because a power cut does not leave it.
#[test]
fn a_permanently_unreadable_body_is_damage() {
    let (old, new) = contents();
    let mut store = holding(&old);
    assert_eq!(write(&mut store, 2, &new), Step::Done);
    store.flash_mut().fault = Fault::Read(2048 + 256..2048 + 288);
    assert_eq!(store.open(), Err(RestoreError::Storage(FlashError::Fault)));
    retry_reading(&mut store);
    assert_eq!(read(&mut store), Some(old.clone()));
    assert!(store.is_damaged());
    // A slot that is older than the readable record does not matter.
    store.flash_mut().fault = Fault::Read(256..288);
    assert_eq!(read(&mut store), Some(new));
    assert!(!store.is_damaged());
}

/// Attempts to read are at least a second apart, and write nothing.
#[test]
fn read_attempts_are_spaced() {
    let (old, new) = contents();
    let mut store = holding(&old);
    store.flash_mut().fault = Fault::Read(0..4);
    assert!(store.open().is_err());
    let (reads, writes) = (store.flash().reads, store.flash().writes);
    let start = later();
    for millis in 0..100_000 {
        let now = start.after(Duration::from_millis(millis));
        let _ = store.step(now, (millis % 3 == 0).then(|| (9, new.views())));
        if store.flash().erases > 0 {
            assert!((3_000..4_000).contains(&millis), "given up after {millis} ms");
            break;
        }
        assert!(store.flash().reads - reads <= 2 * (1 + millis as u32 / 1000), "after {millis} ms");
    }
    assert_eq!(store.flash().writes, writes);
}

/// A failed erase is repeated only once for each new content.
#[test]
fn failing_erases_are_not_repeated() {
    let (old, new) = contents();
    let mut store = holding(&old);
    assert_eq!(write(&mut store, 2, &new), Step::Done);
    store.flash_mut().fault = Fault::Erase;
    assert_eq!(settle(&mut store), Step::Failed);
    assert_eq!(settle(&mut store), Step::Idle);
    assert_eq!(write(&mut store, 3, &old), Step::Failed);
    assert_eq!(settle(&mut store), Step::Idle);
    assert_eq!(restart(store.flash().clone()), Some(new));
    store.flash_mut().fault = Fault::None;
    assert_eq!(write(&mut store, 3, &old), Step::Done);
    assert_eq!(restart(store.into_inner()), Some(old));
}

/// M-44: between the last item and the answer, flash is only written and not erased. Each step is one call of the
/// driver.
#[test]
fn erases_in_advance_and_in_bounded_steps() {
    let (old, new) = contents();
    let mut store = holding(&old);
    for (job, content) in [(2, &new), (3, &old), (4, &new)] {
        let erases = store.flash().erases;
        loop {
            let (writes, bytes) = (store.flash().writes, store.flash().bytes_written);
            let step = store.step(later(), Some((job, content.views())));
            assert_eq!(store.flash().writes, writes + 1);
            assert!(store.flash().bytes_written - bytes <= 256);
            if step == Step::Done {
                break;
            }
            assert_eq!(step, Step::Busy);
        }
        assert_eq!(store.flash().erases, erases);
        loop {
            let erases = store.flash().erases;
            let step = store.step(later(), None);
            assert!(store.flash().erases - erases <= 1);
            if step == Step::Idle {
                break;
            }
            assert_eq!(step, Step::Busy);
        }
    }
}

/// Only units that were written are erased. Blank units are not, neither now nor after a restart.
#[test]
fn blank_units_are_not_erased() {
    let (old, new) = contents();
    let mut store = holding(&old);
    assert_eq!(store.flash().erases, 0);
    assert_eq!(write(&mut store, 2, &new), Step::Done);
    assert_eq!(settle(&mut store), Step::Idle);
    let used = 1 + (old.items.iter().map(Vec::len).sum::<usize>() * 32 + 32).div_ceil(256) as u32;
    assert_eq!(store.flash().erases, used);
    let mut flash = store.into_inner();
    for _ in 0..3 {
        let mut store = self::store(flash);
        assert_eq!(read(&mut store), Some(new.clone()));
        assert_eq!(settle(&mut store), Step::Idle);
        flash = store.into_inner();
    }
    assert_eq!((flash.erases, flash.writes), (used, 7));
}

/// A body that fills whole chunks takes one write for each, and the header takes one more. There are no empty writes.
#[test]
fn no_write_is_empty() {
    for (items, chunks) in [(7, 1), (15, 2), (23, 3)] {
        let mut store = store(Flash::new(4096));
        assert_eq!(store.open(), Ok(None));
        let content = Content::new([items, 0, 0], 5);
        assert_eq!(write(&mut store, 1, &content), Step::Done);
        assert_eq!(store.flash().writes, chunks + 1);
        assert_eq!(restart(store.into_inner()), Some(content));
    }
}

/// SEC-15: a buffer that may have held the key is overwritten.
#[cfg(feature = "signing")]
#[test]
fn buffers_are_overwritten() {
    let mut buffer = [7; 48];
    super::super::record::wipe(&mut buffer);
    assert_eq!(buffer, [0; 48]);
}

/// A job with fewer rows than its length is aborted. The old record remains, and the next job succeeds.
#[test]
fn an_aborted_job_keeps_the_old_record() {
    let mut flash = Flash::new(4096);
    let finish = |record: &mut Record, flash: &mut Flash, id, rows| {
        let job = Job { id, len: 20 * ROW as u32 };
        let row = |index: u32| (index < rows).then_some([id as u8; ROW]);
        (0..100).map(|_| step(record, flash, later(), Some(job), row)).find(|step| *step != Step::Busy)
    };
    for rows in [0, 7, 8, 19] {
        flash.bytes.fill(0xFF);
        let mut record = Record::new::<Flash>(0..4096, FORMAT);
        assert_eq!(finish(&mut record, &mut flash, 1, 20), Some(Step::Done));
        assert_eq!(finish(&mut record, &mut flash, 2, rows), Some(Step::Failed), "{rows} rows");
        let mut restarted = Record::new::<Flash>(0..4096, FORMAT);
        assert!(restarted.open(&mut flash).unwrap().is_some());
        let mut row = [0; ROW];
        assert_eq!((restarted.row(&mut flash, 19, &mut row), row), (Ok(true), [1; ROW]), "{rows} rows");
        assert_eq!(finish(&mut record, &mut flash, 3, 20), Some(Step::Done));
        assert_eq!((record.row(&mut flash, 19, &mut row), row), (Ok(true), [3; ROW]), "{rows} rows");
    }
}

#[test]
fn done_is_returned_once_for_each_job() {
    let (old, new) = contents();
    let mut store = holding(&old);
    assert_eq!(write(&mut store, 2, &new), Step::Done);
    let writes = store.flash().writes;
    assert_eq!(write(&mut store, 2, &new), Step::Idle, "erases the spare slot");
    assert_eq!(store.flash().writes, writes);
    assert_eq!(write(&mut store, 3, &new), Step::Done);
}

/// A job with another number starts again, and so does a job after steps without one.
#[test]
fn another_job_aborts_the_current_one() {
    let (old, new) = contents();
    for steps in 1..3 {
        let mut store = holding(&old);
        for _ in 0..steps {
            assert_eq!(store.step(later(), Some((2, new.views()))), Step::Busy);
        }
        let third = Content::new([1, 1, 1], 8);
        if steps == 1 {
            assert_eq!(settle(&mut store), Step::Idle);
        }
        assert_eq!(write(&mut store, 3, &third), Step::Done);
        assert_eq!(restart(store.into_inner()), Some(third));
    }
}

/// A job with the same number but another length starts again.
#[test]
fn content_of_another_length_starts_again() {
    let (old, new) = contents();
    let mut store = holding(&old);
    assert_eq!(store.step(later(), Some((2, new.views()))), Step::Busy);
    let third = Content::new([1, 0, 0], 6);
    assert_eq!(write(&mut store, 2, &third), Step::Done);
    assert_eq!(restart(store.into_inner()), Some(third));
}

/// Content that does not fit is refused before anything is erased.
#[test]
fn content_that_does_not_fit_is_refused() {
    let (old, _) = contents();
    let mut store = holding(&old);
    let fits = Content::new([50, 3, 2], 6);
    assert_eq!(PlanStore::<Flash>::region_len(50, 3, 2), 4096);
    let erases = store.flash().erases;
    assert_eq!(write(&mut store, 2, &Content::new([50, 3, 3], 6)), Step::Failed);
    assert_eq!((store.flash().erases, store.flash().writes), (erases, 3));
    assert_eq!(restart(store.flash().clone()), Some(old));
    assert_eq!(write(&mut store, 3, &fits), Step::Done);
    assert_eq!(restart(store.into_inner()), Some(fits));
}

/// Nothing outside of the region is changed. Of a region that is not aligned, only whole units are used.
#[test]
fn only_the_region_is_written() {
    let content = Content::new([1, 0, 0], 3);
    for (start, end, fits) in [
        (512, 1536, true),
        (257, 1536, true),
        (512, 1535, false),
        (512, 1024, false),
        (9, 9, false),
        (7, 1, false),
        (u32::MAX, u32::MAX, false),
    ] {
        let region = start..end;
        let mut store = PlanStore::new(Flash::new(2048), region.clone());
        assert_eq!(store.open(), Ok(None));
        for job in 0..3 {
            assert_eq!(write(&mut store, job, &content) == Step::Done, fits, "{region:?}");
            assert_eq!(settle(&mut store), Step::Idle);
        }
        for (at, byte) in store.into_inner().bytes.into_iter().enumerate() {
            assert!(byte == 0xFF || region.contains(&(at as u32)), "{region:?}: {at}");
        }
    }
    let mut outside = PlanStore::new(Flash::new(1024), 4096..8192);
    assert!(outside.open().is_err());
    assert_eq!(write(&mut outside, 1, &content), Step::Failed);
    assert_eq!(settle(&mut outside), Step::Idle);
}

/// A slot that cannot be read does not affect the record in the other one. If that has none, it is an error, and the
/// slot is not changed until there is something to write.
#[test]
fn unreadable_slots() {
    let (old, new) = contents();
    let mut store = holding(&old);
    store.flash_mut().fault = Fault::Read(2048..2080);
    retry_reading(&mut store);
    assert_eq!(read(&mut store), Some(old.clone()));

    // The only record is in the first slot, then in the second.
    let (mut now, mut next) = (old, new);
    for slot in [0, 2048] {
        store.flash_mut().fault = Fault::Read(slot..slot + 32);
        assert!(store.open().is_err());
        assert_eq!(settle(&mut store), Step::Idle);
        store.flash_mut().fault = Fault::None;
        assert_eq!(restart(store.flash().clone()), Some(now.clone()), "it is not erased");
        assert_eq!(write(&mut store, 9, &next), Step::Unread, "it must be read before it is replaced");
        assert_eq!(read(&mut store), Some(now.clone()));
        assert_eq!(write(&mut store, 9, &next), Step::Done);
        assert_eq!(restart(store.flash().clone()), Some(next.clone()), "no older record may be restored");
        // The slot that was read again kept its record: the new one was written to the other slot.
        assert_eq!(settle(&mut store), Step::Idle);
        std::mem::swap(&mut now, &mut next);
    }
}

/// G-18: when neither slot can be read, nothing is erased, however often a write is requested.
#[test]
fn unreadable_storage_is_not_erased() {
    let (old, new) = contents();
    let mut store = holding(&old);
    store.flash_mut().fault = Fault::Read(0..4096);
    assert!(store.open().is_err());
    for job in 2..10 {
        // Idle between two attempts to read.
        assert!(matches!(write(&mut store, job, &new), Step::Failed | Step::Idle));
        assert_eq!(settle(&mut store), Step::Idle);
    }
    store.flash_mut().fault = Fault::None;
    assert_eq!(store.flash().erases, 0);
    assert_eq!(restart(store.into_inner()), Some(old));
}

/// G-18: any one read or several consecutive reads fail at a start. A record that can be read later is read before it
/// is replaced, so no content is lost.
#[test]
fn failed_reads_lose_no_content() {
    let (old, new) = contents();
    for is_second in [false, true] {
        let mut whole = holding(&old);
        if is_second {
            assert_eq!(write(&mut whole, 2, &new), Step::Done);
        }
        let newest = if is_second { &new } else { &old };
        let mut counted = store(RamFlash { reads: 0, ..whole.flash().clone() });
        assert_eq!(read(&mut counted).as_ref(), Some(newest));
        let reads = counted.flash().reads;
        assert!(reads > 10, "{reads} reads");
        for (first, len) in (0..reads).flat_map(|first| [(first, 1), (first, 2), (first, 12)]) {
            let mut store = store(RamFlash { reads: 0, ..whole.flash().clone() });
            store.flash_mut().fault = Fault::Reads(first..first + len);
            let mut live = try_read(&mut store);
            let next = Content::new([1, 1, 1], 99);
            let steps = (0..200).map(|step| {
                let is_wanted = step > 50;
                let step = store.step(later(), is_wanted.then(|| (7, next.views())));
                if step == Step::Unread
                    && let Some(found) = try_read(&mut store)
                {
                    live = Some(found);
                }
                step
            });
            let is_done = steps.take_while(|step| *step != Step::Done).count() < 200;
            assert!(is_done, "{first}, {len}: never written");
            assert_eq!(live.as_ref(), Some(newest), "{first}, {len}: replaced before it was read");
            assert_eq!(restart(store.into_inner()), Some(next));
        }
    }
}

/// Reads the whole content of a store, or nothing.
fn try_read(store: &mut PlanStore<Flash>) -> Option<Content> {
    let Stored { counts, ids } = store.open().ok()??;
    let mut content = Content { items: Default::default(), ids };
    for (index, plan) in PlanType::ALL.into_iter().enumerate() {
        for seq in 0..counts[index] {
            content.items[index].push(store.item(plan, seq).ok()??);
        }
    }
    Some(content)
}

/// Writing does not require a call of `open` before.
#[test]
fn writing_without_open() {
    let (old, new) = contents();
    let mut store = store(holding(&old).into_inner());
    assert_eq!(write(&mut store, 1, &new), Step::Done);
    assert_eq!(restart(store.into_inner()), Some(new));
}
