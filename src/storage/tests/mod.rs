//! The journal over flash with power cuts at any byte, with faults, with damage, and with garbage (SEC-11, G-18).
//!
//! A restart is a new journal over the same flash: nothing else survives.

mod cuts;
mod damage;
mod faults;
mod unlikely;
mod worn;

#[path = "../../../tests/support/flash.rs"]
mod flash;

use std::collections::BTreeMap;
use std::vec::Vec;

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};

use self::flash::RamFlash;
use super::job::Job;
use super::journal::{Event, Journal, Next};
use super::page::{PAYLOAD, Page};
use super::region::Region;
use crate::time::{Duration, Instant};

/// The content of each kind.
type Model = BTreeMap<u8, Vec<u8>>;

/// Content of this length that no other `salt` has.
fn content(len: usize, salt: u32) -> Vec<u8> {
    (0..len as u32).map(|at| (at.wrapping_mul(0x9E37_79B9) ^ salt.wrapping_mul(0x85EB_CA6B)).to_le_bytes()[2]).collect()
}

/// A journal and its flash, driven as the stack and a blocking driver do.
struct Rig<const W: usize, const E: usize> {
    journal: Journal,
    flash: RamFlash<W, E>,
    page: Page,
    now: Instant,
}

/// The result of an append.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Saved {
    Yes,
    No,
    /// There is no room.
    NoRoom,
}

impl<const W: usize, const E: usize> Rig<W, E> {
    /// A start with this flash, not read yet.
    fn new(flash: RamFlash<W, E>) -> Self {
        let region = Region::new(0..flash.capacity() as u32, W as u32, E as u32);
        let mut journal = Journal::NEW;
        journal.attach(region, 4);
        Self { journal, flash, page: Page::new(), now: Instant::from_millis(1_000) }
    }

    /// A start with this flash, after everything is read.
    fn start(flash: RamFlash<W, E>) -> Self {
        let mut rig = Self::new(flash);
        rig.settle();
        rig
    }

    fn blank(len: u32) -> Self {
        Self::start(RamFlash::new(len))
    }

    /// Carries out a job and passes on its result. Drivers that need words or DMA get aligned bytes.
    fn run(&mut self, job: &Job) -> Event {
        if let Job::Read { range, .. } | Job::Write { range, .. } = job {
            assert_eq!((align_of::<Page>() % 4, range.start % 4), (0, 0), "{job:?}");
        }
        let is_done = match job {
            Job::Read { offset, range } => {
                assert!(matches!(range.len(), 32 | 256));
                self.flash.read(*offset, &mut self.page.bytes_mut()[range.clone()]).is_ok()
            }
            Job::Write { offset, range } => self.flash.write(*offset, &self.page.bytes()[range.clone()]).is_ok(),
            Job::Erase { offset, len } => self.flash.erase(*offset, *offset + *len).is_ok(),
        };
        self.journal.done(self.now, is_done, &mut self.page)
    }

    /// Runs until there is nothing to do, not even after some time, or the power is off.
    fn settle(&mut self) {
        for _ in 0..100_000 {
            match self.journal.next(self.now, true, &mut self.page) {
                Next::Job(job) => drop(self.run(&job)),
                Next::Content(_) => panic!("nothing is written"),
                Next::Idle if self.journal.is_idle() || self.journal.is_foreign() || self.flash.is_off() => return,
                Next::Idle => self.now += Duration::from_secs(1),
            }
        }
        panic!("it never ends");
    }

    /// Appends a record. `each` is called before each job.
    fn save_with(&mut self, kind: u8, content: &[u8], is_secret: bool, mut each: impl FnMut(&mut Self, &Job)) -> Saved {
        let pages = content.len().div_ceil(PAYLOAD).max(1);
        if !self.journal.begin(kind, 1, pages as u16, is_secret) {
            return Saved::NoRoom;
        }
        for _ in 0..100_000 {
            match self.journal.next(self.now, true, &mut self.page) {
                Next::Job(job) => {
                    each(self, &job);
                    match self.run(&job) {
                        Event::Written => return Saved::Yes,
                        Event::Failed { .. } => return Saved::No,
                        event => assert!(matches!(event, Event::Nothing | Event::Lost(_)), "{event:?}"),
                    }
                }
                Next::Content(index) => {
                    let rest = &content[usize::from(index) * PAYLOAD..];
                    let len = rest.len().min(PAYLOAD);
                    self.page.payload_mut()[..len].copy_from_slice(&rest[..len]);
                    self.journal.put(&mut self.page, len as u8, len == rest.len());
                }
                Next::Idle if self.flash.is_off() => return Saved::No,
                Next::Idle => self.now += Duration::from_secs(1),
            }
        }
        panic!("it never ends");
    }

    fn save(&mut self, kind: u8, content: &[u8]) -> Saved {
        self.save_with(kind, content, false, |_, _| {})
    }

    /// Reads a record.
    fn load(&mut self, kind: u8) -> Option<Vec<u8>> {
        if self.journal.find(kind).pages.0 == 0 {
            return None;
        }
        self.journal.load(kind);
        let mut content = Vec::new();
        for _ in 0..1_000 {
            let Next::Job(job) = self.journal.next(self.now, false, &mut self.page) else { panic!("a job") };
            match self.run(&job) {
                Event::Loaded { len, is_first, is_last } => {
                    assert_eq!(is_first, content.is_empty());
                    content.extend_from_slice(self.page.payload(len));
                    if is_last {
                        self.journal.end_load();
                        return Some(content);
                    }
                }
                event => panic!("{event:?}"),
            }
        }
        panic!("it never ends");
    }

    /// Reads all records of the kinds 1 to 9.
    fn all(&mut self) -> Model {
        (1..10).filter_map(|kind| Some((kind, self.load(kind)?))).collect()
    }

    /// The kinds that are damaged.
    fn damaged(&self) -> Vec<u8> {
        (1..10).filter(|kind| self.journal.find(*kind).is_damaged).collect()
    }

    /// The content that a restart finds, without damage.
    fn restarted(flash: &RamFlash<W, E>) -> Model {
        let mut flash = flash.clone();
        flash.power_on();
        let mut rig = Self::start(flash);
        assert_eq!(rig.damaged(), [0u8; 0], "a power cut leaves no damage");
        rig.all()
    }
}

/// Records of all sizes survive a restart, through many segments; each unit wears the same (SEC-12).
#[test]
fn records_come_back_and_wear_is_even() {
    fn check<const W: usize, const E: usize>(units: u32) {
        let mut rig = Rig::<W, E>::blank(units * E as u32);
        let half = (units / 2) as usize * E / 256;
        let mut model = Model::new();
        for round in 0..200u32 {
            let kind = (round % 3 + 1) as u8;
            let pages = if kind == 1 { half / 2 } else { 1 };
            let len = (pages * PAYLOAD).saturating_sub((round % 7) as usize);
            let new = content(len, round);
            assert_eq!(rig.save(kind, &new), Saved::Yes, "round {round}");
            model.insert(kind, new);
            if round % 5 == 0 {
                rig = Rig::start(rig.flash);
            }
            assert_eq!(rig.all(), model, "round {round}");
        }
        // The last half of a journal unit is not used.
        let used = units as usize * E / E.max(256) * E.max(256) / E;
        let erases = &rig.flash.erases_of[..used];
        let (most, least) = (erases.iter().max().unwrap(), erases.iter().min().unwrap());
        assert!(most - least <= 2, "{W} {E} {units}: {erases:?}");
    }
    check::<4, 4096>(4);
    check::<8, 2048>(5);
    check::<32, 8192>(2);
    check::<256, 4096>(3);
    check::<1, 256>(16);
    check::<4, 128>(33);
}

/// The RAM that the documentation states: storage takes at most 400 bytes of a stack, and one page of the code that
/// runs the jobs.
#[test]
fn state_is_small() {
    assert!(size_of::<super::Storage>() <= 400, "{}", size_of::<super::Storage>());
    assert_eq!(size_of::<Page>(), 256);
}

/// A record that does not fit beside the others is refused before anything is written.
#[test]
fn content_that_does_not_fit_is_refused() {
    let mut rig = Rig::<4, 1024>::blank(4096);
    assert_eq!(rig.save(1, &content(5 * PAYLOAD, 1)), Saved::Yes);
    let before = rig.flash.bytes.clone();
    assert_eq!(rig.save(2, &content(4 * PAYLOAD, 2)), Saved::NoRoom);
    assert_eq!(rig.save(1, &content(9 * PAYLOAD, 2)), Saved::NoRoom);
    assert_eq!(rig.flash.bytes, before);
    assert_eq!(rig.save(2, &content(3 * PAYLOAD, 2)), Saved::Yes);
    assert_eq!(rig.save(1, &content(5 * PAYLOAD, 3)), Saved::Yes);
    assert_eq!(rig.all(), Model::from([(1, content(5 * PAYLOAD, 3)), (2, content(3 * PAYLOAD, 2))]));
}

/// SEC-12: 100,000 saves of 50 parameters, two pages each, in 64 KiB of 4 KiB units, beside a key and plans of 100 items. No
/// unit is erased more than 1,500 times, and all about as often.
#[test]
fn wear_of_many_saves() {
    // Flash that counts and keeps nothing would do, but this one also checks every rule of the driver.
    let mut rig = Rig::<4, 4096>::blank(65_536);
    assert_eq!(rig.save(1, &content(101 * 32, 1)), Saved::Yes);
    assert_eq!(rig.save(3, &content(41, 1)), Saved::Yes);
    let saves = if cfg!(debug_assertions) { 5_000 } else { 100_000 };
    for salt in 0..saves {
        assert_eq!(rig.save(2, &content(50 * 8, salt)), Saved::Yes);
    }
    let erases = &rig.flash.erases_of;
    let (most, least) = (*erases.iter().max().unwrap(), *erases.iter().min().unwrap());
    std::println!("{saves} saves: {least} to {most} erases of a unit");
    assert!(u64::from(most) * 100_000 <= 1_500 * u64::from(saves), "{erases:?}");
    assert!((most - least) * 10 <= most, "{erases:?}");
}
