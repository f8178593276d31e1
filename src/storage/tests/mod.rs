//! The store over flash with power cuts at any byte, with faults, and with garbage (SEC-11, G-18).
//!
//! A restart is a new store over the same flash: nothing else survives.

mod cuts;
mod faults;
mod garbage;
mod layout;
mod params;

#[path = "../../../tests/support/flash.rs"]
mod flash;

use core::ops::Range;
use core::sync::atomic::{AtomicU64, Ordering};
use std::vec::Vec;

use embedded_storage::nor_flash::NorFlash;

use super::plans::{self, FORMAT, Stored};
use super::record::{CHUNK, Format, Job, ROW, Record, RestoreError, Step};
use super::store::Body;
use crate::dialect::{MavCmd, MavFrame};
use crate::message::Item;
use crate::time::Instant;
use crate::types::{PlanType, PlanView};

/// Three plans with their ids.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Content {
    items: [Vec<Item>; 3],
    ids: [u32; 3],
}

impl Content {
    /// Plans with these numbers of items; `salt` determines their content and ids.
    fn new(counts: [u16; 3], salt: u32) -> Self {
        let items = |plan: u32, count: u16| {
            (0..count).map(|seq| item(salt.wrapping_mul(31).wrapping_add(plan * 7919 + u32::from(seq)))).collect()
        };
        let [mission, fence, rally] = counts;
        let id = |plan: u32, count: u16| if count == 0 { 0 } else { salt.wrapping_mul(0x9E37_79B9) ^ plan | 1 };
        Self {
            items: [items(0, mission), items(1, fence), items(2, rally)],
            ids: [id(0, mission), id(1, fence), id(2, rally)],
        }
    }

    /// The same, with one plan of `other`.
    fn with(&self, plan: usize, other: &Self) -> Self {
        let mut content = self.clone();
        content.items[plan] = other.items[plan].clone();
        content.ids[plan] = other.ids[plan];
        content
    }

    fn views(&self) -> [PlanView<'_>; 3] {
        let [mission, fence, rally] = &self.items;
        let [mission_id, fence_id, rally_id] = self.ids;
        [PlanView::of(mission, mission_id), PlanView::of(fence, fence_id), PlanView::of(rally, rally_id)]
    }
}

/// An item with arbitrary bits, including signalling and quiet NaNs.
fn item(n: u32) -> Item {
    let mix = |k: u32| (n ^ k).wrapping_mul(0x85EB_CA6B).rotate_left(k % 31) ^ 0xC2B2_AE35;
    let [frame, autocontinue, ..] = mix(1).to_le_bytes();
    Item {
        frame: MavFrame(frame),
        command: MavCmd(n as u16),
        autocontinue,
        params: [f32::from_bits(0x7F80_0001), f32::from_bits(mix(2)), f32::NAN, f32::from_bits(mix(3))],
        x: mix(4) as i32,
        y: mix(5) as i32,
        z: f32::from_bits(mix(6)),
    }
}

/// Does a step towards a record, and writes its content if that is next.
fn step<F: NorFlash>(
    record: &mut Record,
    flash: &mut F,
    now: Instant,
    job: Option<Job>,
    mut row: impl FnMut(u32) -> Option<[u8; ROW]>,
) -> Step {
    match record.step(flash, now, job) {
        Step::Write(first) => {
            let mut chunk = [0xFF; CHUNK];
            let mut is_whole = true;
            let rows = first..job.expect("a job").len / 32;
            for (index, place) in rows.zip(chunk.as_chunks_mut::<ROW>().0) {
                match row(index) {
                    Some(row) => *place = row,
                    None => is_whole = false,
                }
            }
            record.write(flash, is_whole.then_some(&chunk))
        }
        step => step,
    }
}

/// A record of plans in a region of a flash.
struct PlanStore<F> {
    flash: F,
    record: Record,
    stored: Stored,
}

impl<F: NorFlash> PlanStore<F> {
    fn new(flash: F, region: Range<u32>) -> Self {
        Self { flash, record: Record::new::<F>(region, FORMAT), stored: Stored::default() }
    }

    fn region_len(mission: usize, fence: usize, rally: usize) -> u32 {
        Record::region_len::<F>(32 * (1 + mission + fence + rally) as u32)
    }

    fn open(&mut self) -> Result<Option<Stored>, RestoreError<F::Error>> {
        self.stored = Stored::default();
        let mut body = Body::new(&mut self.record, &mut self.flash);
        let found = body.open();
        let stored = plans::open(&mut body, found)?;
        self.stored = stored.unwrap_or_default();
        Ok(stored)
    }

    fn item(&mut self, plan: PlanType, seq: u16) -> Result<Option<Item>, F::Error> {
        plans::item(&mut Body::new(&mut self.record, &mut self.flash), &self.stored, plan, seq)
    }

    fn step(&mut self, now: Instant, content: Option<(u32, [PlanView<'_>; 3])>) -> Step {
        let Some((id, content)) = content else { return step(&mut self.record, &mut self.flash, now, None, |_| None) };
        let stored = Stored::of(&content);
        let job = Job { id, len: stored.len() };
        let step = step(&mut self.record, &mut self.flash, now, Some(job), |index| plans::row(&content, index));
        if step == Step::Done {
            self.stored = stored;
        }
        step
    }

    fn is_damaged(&self) -> bool {
        self.record.is_damaged()
    }

    fn is_impaired(&self) -> bool {
        self.record.is_impaired()
    }

    fn flash(&self) -> &F {
        &self.flash
    }

    fn flash_mut(&mut self) -> &mut F {
        &mut self.flash
    }

    fn into_inner(self) -> F {
        self.flash
    }
}

/// A store whose region is the whole flash.
fn store<F: NorFlash>(flash: F) -> PlanStore<F> {
    let len = flash.capacity() as u32;
    PlanStore::new(flash, 0..len)
}

/// A time ten seconds after that of the call before, so that no retry is delayed.
fn later() -> Instant {
    static SECONDS: AtomicU64 = AtomicU64::new(0);
    Instant::from_millis(SECONDS.fetch_add(10, Ordering::Relaxed) * 1000)
}

/// The content after a restart, without damage, once reading has succeeded or was given up.
fn restart<F: NorFlash>(flash: F) -> Option<Content> {
    let mut store = store(flash);
    retry_reading(&mut store);
    read(&mut store)
}

/// Repeats failed reads until they succeed or are given up.
fn retry_reading<F: NorFlash>(store: &mut PlanStore<F>) {
    for _ in 0..4 {
        if !matches!(store.open(), Err(RestoreError::Storage(_))) {
            break;
        }
        settle(store);
    }
}

/// The content after a restart, or the error of the first read.
fn found<F: NorFlash>(flash: F) -> Result<Option<Content>, RestoreError<F::Error>> {
    let mut store = store(flash);
    match store.open()? {
        Some(stored) => Ok(Some(items(&mut store, stored))),
        None => Ok(None),
    }
}

fn read<F: NorFlash>(store: &mut PlanStore<F>) -> Option<Content> {
    let stored = store.open().expect("a whole record, or empty storage")?;
    Some(items(store, stored))
}

fn items<F: NorFlash>(store: &mut PlanStore<F>, Stored { counts, ids }: Stored) -> Content {
    let mut content = Content { items: Default::default(), ids };
    for (index, plan) in PlanType::ALL.into_iter().enumerate() {
        content.items[index] = (0..counts[index]).map(|seq| store.item(plan, seq).unwrap().unwrap()).collect();
        assert_eq!(store.item(plan, counts[index]).unwrap(), None);
    }
    content
}

/// Steps until the job succeeds or fails.
fn write<F: NorFlash>(store: &mut PlanStore<F>, job: u32, content: &Content) -> Step {
    run(store, Some((job, content)))
}

/// Erases the spare slot.
fn settle<F: NorFlash>(store: &mut PlanStore<F>) -> Step {
    run(store, None)
}

fn run<F: NorFlash>(store: &mut PlanStore<F>, content: Option<(u32, &Content)>) -> Step {
    for _ in 0..10_000 {
        match store.step(later(), content.map(|(job, content)| (job, content.views()))) {
            Step::Busy => {}
            step => return step,
        }
    }
    panic!("endless steps");
}
