//! Rare states that once lost a record, reported none, or let nothing be saved any more (G-18, SEC-11, SEC-15).

use super::flash::{Fault, Torn};
use super::*;

const W: usize = 8;
const E: usize = 1024;

/// A journal of 8 units with three kinds, after this many saves of the second.
fn filled(saves: u32) -> (Rig<W, E>, Model) {
    let mut rig = Rig::<W, E>::blank(8 * E as u32);
    let mut model = Model::from([(1, content(3 * PAYLOAD, 1)), (2, content(40, 2)), (3, content(41, 3))]);
    for (kind, content) in &model {
        assert_eq!(rig.save(*kind, content), Saved::Yes);
    }
    for salt in 0..saves {
        model.insert(2, content(40, 100 + salt));
        assert_eq!(rig.save(2, &model[&2]), Saved::Yes);
    }
    (rig, model)
}

/// Returns the newest page of a kind that is no copy.
fn opener<const W: usize, const E: usize>(flash: &RamFlash<W, E>, kind: u8) -> usize {
    let pages = flash.bytes.chunks(256).enumerate();
    let own = pages.filter(|(_, page)| page.starts_with(&[b'M', b'L', 1, kind]) && page[239] & 2 == 0);
    own.max_by_key(|(_, page)| (page[228..232].to_vec(), page[232..234].to_vec())).unwrap().0
}

/// The only record that is no copy is damaged, and the segment before is erased: the copies are all there is. They are
/// found, and lost content is reported, whatever is left of the page.
#[test]
fn copies_survive_the_record_that_opened_the_segment() {
    let (mut rig, mut model) = filled(0);
    assert_eq!(rig.save_with(3, &content(41, 9), true, |_, _| {}), Saved::Yes);
    rig.settle();
    let page = opener(&rig.flash, 3) * 256;
    model.remove(&3);
    for damage in [&[4][..], &[204], &[230], &[230, 231], &[0, 1, 2, 3]] {
        let mut flash = rig.flash.clone();
        damage.iter().for_each(|at| flash.bytes[page + at] ^= 1);
        let mut damaged = Rig::start(flash);
        assert_eq!(damaged.all(), model, "{damage:?}");
        assert!(damaged.damaged().contains(&3), "{damage:?}");
    }
}

/// The record that opened a segment cannot be read, or reads wrongly, at one start. A record that is saved then is the
/// newest also when that record can be read again.
#[test]
fn a_save_beside_an_unread_segment_stays_the_newest() {
    let (mut rig, _) = filled(9);
    assert_eq!(rig.save(1, &content(3 * PAYLOAD, 50)), Saved::Yes);
    let page = opener(&rig.flash, 1);
    let at = page as u32 * 256;
    for reads_wrongly in [false, true] {
        let mut flash = rig.flash.clone();
        if reads_wrongly {
            flash.bytes[page * 256 + 10] ^= 1;
        } else {
            flash.fault = Fault::Read(at..at + 256);
        }
        let mut start = Rig::start(flash);
        start.flash.fault = Fault::None;
        assert_eq!(start.save(2, &content(60, 777)), Saved::Yes);
        if reads_wrongly && start.flash.bytes[page * 256..].starts_with(b"ML") {
            start.flash.bytes[page * 256 + 10] ^= 1;
        }
        let mut again = Rig::start(start.flash);
        assert_eq!(again.load(2), Some(content(60, 777)), "{reads_wrongly}");
        assert!(again.load(1).is_some());
    }
}

/// A page that reads wrongly once is read again, and counts.
#[test]
fn a_wrong_bit_of_the_bus_is_read_again() {
    let (rig, model) = filled(5);
    for read in 0..rig.flash.bytes.len() as u32 / 100 {
        let mut flash = rig.flash.clone();
        flash.reads = 0;
        flash.fault = Fault::WrongRead(read);
        let mut start = Rig::start(flash);
        start.flash.fault = Fault::None;
        assert_eq!((start.all(), start.damaged()), (model.clone(), Vec::new()), "read {read}");
    }
}

/// Flash with error correction: a write is cut off at each start. The torn pages do not add up, and everything can be
/// saved and read for ever.
#[test]
fn torn_pages_do_not_add_up() {
    let mut rig = Rig::<8, 2048>::blank(8 * 2048);
    rig.flash.torn = Torn::Unreadable;
    let mut model = Model::from([(1, content(3 * PAYLOAD, 1)), (2, content(40, 2)), (3, content(41, 3))]);
    for (kind, content) in &model {
        assert_eq!(rig.save(*kind, content), Saved::Yes);
    }
    for cut in 0..40 {
        rig = Rig::start(rig.flash);
        assert!(rig.now <= Instant::from_millis(4_000) && rig.flash.bad.len() <= 2, "{:?}", rig.flash.bad);
        assert_eq!(rig.all(), model, "cut {cut}");
        model.insert(2, content(40, 100 + cut));
        assert_eq!(rig.save(2, &model[&2]), Saved::Yes);
        let mut cuts = 0;
        rig.save_with(3, &content(41, cut), false, |rig, job| {
            let writes_footer = matches!(job, Job::Write { range, .. } if range.start == 224);
            if writes_footer && rig.page.bytes()[239] & 2 == 0 {
                cuts += 1;
                rig.flash.fuel = Some(28);
            }
        });
        assert_eq!(cuts, 1);
        rig.flash.power_on();
    }
}

/// Records of unknown kinds were lost in a region without spare room. Each kind can be saved again.
#[test]
fn losses_do_not_fill_the_region() {
    let mut rig = Rig::<1, 256>::blank(12 * 256);
    for (kind, len) in [(1, 3 * PAYLOAD), (2, 40), (3, 41)] {
        assert_eq!(rig.save(kind, &content(len, kind.into())), Saved::Yes);
    }
    rig.flash.bytes[..4 * 256].fill(0xFF);
    let mut rig = Rig::start(rig.flash);
    assert!([1, 2].iter().all(|kind| rig.damaged().contains(kind)));
    let mut model = Model::new();
    for round in 0..3 {
        for (kind, len) in [(1, 3 * PAYLOAD), (2, 40), (3, 41)] {
            model.insert(kind, content(len, 50 + round));
            assert_eq!(rig.save(kind, &model[&kind]), Saved::Yes, "{kind}");
        }
    }
    assert_eq!(Rig::start(rig.flash).all(), model);
}

/// SEC-15: an old key is erased also if erasing fails at first.
#[test]
fn an_old_secret_is_erased_though_erasing_fails_once() {
    let (mut rig, _) = filled(0);
    assert_eq!(rig.save_with(3, &content(41, 9), true, |_, _| {}), Saved::Yes);
    let has_old = |rig: &Rig<W, E>| rig.flash.bytes.windows(41).any(|bytes| bytes == content(41, 3));
    rig.flash.fault = Fault::Erase;
    for _ in 0..20 {
        if let Next::Job(job) = rig.journal.next(rig.now, true, &mut rig.page) {
            rig.run(&job);
        }
    }
    assert!(has_old(&rig));
    rig.flash.fault = Fault::None;
    rig.now += Duration::from_secs(20);
    rig.settle();
    assert!(!has_old(&rig));
}

/// SEC-12: a start erases at most one unit ahead, and seldom, so that many starts hardly wear one unit more than another.
#[test]
fn many_starts_wear_evenly() {
    let start = |flash| {
        let mut rig = Rig::<4, 4096>::new(flash);
        rig.journal.attach(Region::new(0..65_536, 4, 4096), 48);
        rig.settle();
        rig
    };
    let mut rig = start(RamFlash::new(65_536));
    assert_eq!(rig.save(1, &content(48 * PAYLOAD, 1)), Saved::Yes);
    for salt in 0..600 {
        rig = start(rig.flash);
        assert_eq!(rig.save(3, &content(41, salt)), Saved::Yes);
        rig.now += Duration::from_secs(1);
        rig.settle();
    }
    let erases = &rig.flash.erases_of;
    assert!(erases.iter().max().unwrap() <= &(4 * erases.iter().min().unwrap()), "{erases:?}");
}
