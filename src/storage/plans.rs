//! Storage of the three plans: one [record](super::record), so that they are replaced together.
//!
//! `layout.md` in this folder documents the format: the structs below in the encoding of postcard, with integers of
//! fixed width. If you change a struct, increment the schema version, and keep reading the old one.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;
use postcard::fixint::le;
use serde::{Deserialize, Serialize};

use super::record::{Job, ROW, Record, RestoreError, Step};
use crate::dialect::{MavCmd, MavFrame};
use crate::message::Item;
use crate::time::Instant;
use crate::types::{PlanType, PlanView};

const KIND: u8 = 1;
const SCHEMA: u16 = 1;

/// The first row of the body.
#[derive(Serialize, Deserialize)]
struct HeadRow {
    #[serde(with = "le")]
    mission_count: u16,
    #[serde(with = "le")]
    fence_count: u16,
    #[serde(with = "le")]
    rally_count: u16,
    #[serde(with = "le")]
    mission_id: u32,
    #[serde(with = "le")]
    fence_id: u32,
    #[serde(with = "le")]
    rally_id: u32,
}

/// The row of an item. Floats are stored as their bits, so that no NaN is changed.
#[derive(Serialize, Deserialize)]
struct ItemRow {
    frame: u8,
    #[serde(with = "le")]
    command: u16,
    autocontinue: u8,
    #[serde(with = "le")]
    param1: u32,
    #[serde(with = "le")]
    param2: u32,
    #[serde(with = "le")]
    param3: u32,
    #[serde(with = "le")]
    param4: u32,
    #[serde(with = "le")]
    x: i32,
    #[serde(with = "le")]
    y: i32,
    #[serde(with = "le")]
    z: u32,
}

/// The number of items and the id of each stored plan, in the order of [`PlanType::ALL`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Stored {
    pub(crate) counts: [u16; 3],
    pub(crate) ids: [u32; 3],
}

impl Stored {
    fn of(content: &[PlanView<'_>; 3]) -> Self {
        Self {
            counts: content.map(|plan| u16::try_from(plan.items().len()).unwrap_or(u16::MAX)),
            ids: content.map(|plan| plan.id()),
        }
    }

    /// Returns the length of the body in bytes.
    fn len(&self) -> u32 {
        self.counts.iter().fold(1u32, |rows, count| rows.saturating_add(u32::from(*count))).saturating_mul(32)
    }

    fn to_row(self) -> Option<[u8; ROW]> {
        let [mission_count, fence_count, rally_count] = self.counts;
        let [mission_id, fence_id, rally_id] = self.ids;
        to_row(&HeadRow { mission_count, fence_count, rally_count, mission_id, fence_id, rally_id })
    }

    fn from_row(row: &[u8; ROW]) -> Option<Self> {
        let row: HeadRow = postcard::from_bytes(row).ok()?;
        Some(Self {
            counts: [row.mission_count, row.fence_count, row.rally_count],
            ids: [row.mission_id, row.fence_id, row.rally_id],
        })
    }

    /// Returns the row of an item; `None` if the plan has no such item.
    fn row_of(&self, plan: PlanType, seq: u16) -> Option<u32> {
        let [mission, fence, rally] = self.counts.map(u32::from);
        let (before, count) = match plan {
            PlanType::Mission => (0, mission),
            PlanType::Fence => (mission, fence),
            PlanType::Rally => (mission.saturating_add(fence), rally),
        };
        let seq = u32::from(seq);
        (seq < count).then(|| before.saturating_add(seq).saturating_add(1))
    }
}

fn to_row<T: Serialize>(value: &T) -> Option<[u8; ROW]> {
    let mut row = [0; ROW];
    postcard::to_slice(value, &mut row).ok()?;
    Some(row)
}

fn item_to_row(item: &Item) -> Option<[u8; ROW]> {
    let [param1, param2, param3, param4] = item.params.map(f32::to_bits);
    to_row(&ItemRow {
        frame: item.frame.0,
        command: item.command.0,
        autocontinue: item.autocontinue,
        param1,
        param2,
        param3,
        param4,
        x: item.x,
        y: item.y,
        z: item.z.to_bits(),
    })
}

fn item_from_row(row: &[u8; ROW]) -> Option<Item> {
    let row: ItemRow = postcard::from_bytes(row).ok()?;
    Some(Item {
        frame: MavFrame(row.frame),
        command: MavCmd(row.command),
        autocontinue: row.autocontinue,
        params: [row.param1, row.param2, row.param3, row.param4].map(f32::from_bits),
        x: row.x,
        y: row.y,
        z: f32::from_bits(row.z),
    })
}

/// Returns a row of the body; `None` if the content has fewer rows.
fn row(content: &[PlanView<'_>; 3], row: u32) -> Option<[u8; ROW]> {
    let Some(index) = row.checked_sub(1) else { return Stored::of(content).to_row() };
    let mut index = usize::try_from(index).ok()?;
    for plan in content {
        match index.checked_sub(plan.items().len()) {
            Some(rest) => index = rest,
            None => return item_to_row(plan.items().get(index)?),
        }
    }
    None
}

/// Stores the three plans in two slots, of which one always has a complete record.
///
/// The storage is a [`NorFlash`] with a `WRITE_SIZE` that divides 256 and a `READ_SIZE` that divides 32.
/// [`Stack::persist_plans`](crate::Stack::persist_plans) writes in steps of at most one erase unit or 256 bytes. If
/// power fails at any step, either the old or the new plans are complete:
///
/// ```text
///                 older record, or torn ── erased in advance, header first ──▶ erased
///   spare slot:      ▲                                                           │ there are plans to store
///                    │                                                           ▼
///                 the new record is valid, ◀── header ── read back ◀── body, 256 bytes per step
///                 and the other slot is the spare
/// ```
///
/// [`Durability`](crate::plan::Durability) determines when an upload is acknowledged and goes live.
///
/// ```
/// # use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
/// # struct Flash;
/// # impl ErrorType for Flash { type Error = NorFlashErrorKind; }
/// # impl ReadNorFlash for Flash {
/// #     const READ_SIZE: usize = 1;
/// #     fn read(&mut self, _: u32, _: &mut [u8]) -> Result<(), NorFlashErrorKind> { Ok(()) }
/// #     fn capacity(&self) -> usize { 65_536 }
/// # }
/// # impl NorFlash for Flash {
/// #     const WRITE_SIZE: usize = 8;
/// #     const ERASE_SIZE: usize = 2_048;
/// #     fn erase(&mut self, _: u32, _: u32) -> Result<(), NorFlashErrorKind> { Ok(()) }
/// #     fn write(&mut self, _: u32, _: &[u8]) -> Result<(), NorFlashErrorKind> { Ok(()) }
/// # }
/// use mavstack::storage::PlanStore;
///
/// type Store = PlanStore<Flash>;
/// const START: u32 = 0x8000;
/// const LEN: u32 = Store::region_len(250, 64, 16);
/// const _: () = assert!(LEN == 24_576);
/// let store = Store::new(Flash, START..START + LEN);
/// ```
///
#[doc = include_str!("layout.md")]
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlanStore<F> {
    record: Record<F>,
    stored: Stored,
}

impl<F: NorFlash> PlanStore<F> {
    /// Returns a store in this region of the storage. It uses two halves of whole erase units. Reads nothing yet.
    pub const fn new(flash: F, region: Range<u32>) -> Self {
        Self { record: Record::new(flash, region, KIND), stored: Stored { counts: [0; 3], ids: [0; 3] } }
    }

    /// Returns the length of the region for plans with these numbers of items, in bytes: a multiple of two erase units.
    /// The region must begin at an erase unit.
    #[allow(clippy::as_conversions, reason = "`try_from` is not const; the value is bounded")]
    pub const fn region_len(mission: usize, fence: usize, rally: usize) -> u32 {
        let items = mission.saturating_add(fence).saturating_add(rally);
        let rows = if items < 0x0400_0000 { items as u32 } else { 0x0400_0000 };
        Record::<F>::slot_len(rows.saturating_add(1).saturating_mul(32)).saturating_mul(2)
    }

    /// Returns the storage.
    pub const fn flash(&self) -> &F {
        &self.record.flash
    }

    /// Returns the storage. Do not write to the store's region: that may damage the plans.
    pub const fn flash_mut(&mut self) -> &mut F {
        &mut self.record.flash
    }

    /// Returns the storage and drops the store.
    pub fn into_inner(self) -> F {
        self.record.flash
    }

    /// Finds the newest record. Reads all of it.
    ///
    /// # Errors
    ///
    /// Neither slot has a whole record of this version, and the storage is not empty; or it cannot be read.
    pub(crate) fn open(&mut self) -> Result<Option<Stored>, RestoreError<F::Error>> {
        self.stored = Stored::default();
        let Some(header) = self.record.open()? else { return Ok(None) };
        if header.schema != SCHEMA {
            return Err(RestoreError::Foreign);
        }
        let row = self.record.row(0)?;
        let stored = row.and_then(|row| Stored::from_row(&row)).filter(|stored| stored.len() == header.len);
        self.stored = stored.ok_or(RestoreError::Damaged)?;
        Ok(stored)
    }

    /// Returns whether a slot is damaged, besides the record that was found.
    pub(crate) const fn is_damaged(&self) -> bool {
        self.record.is_damaged()
    }

    /// Returns whether the next [`step`](Self::step) only repeats a failed read.
    pub(crate) const fn is_unread(&self) -> bool {
        self.record.is_unread()
    }

    /// Returns whether a slot could not be read.
    pub(crate) const fn is_impaired(&self) -> bool {
        self.record.is_impaired()
    }

    /// Reads an item of the record that [`open`](Self::open) has found, or that was written since.
    pub(crate) fn item(&mut self, plan: PlanType, seq: u16) -> Result<Option<Item>, F::Error> {
        let Some(row) = self.stored.row_of(plan, seq) else { return Ok(None) };
        let row = self.record.row(row)?;
        Ok(row.and_then(|row| item_from_row(&row)))
    }

    /// Erases at most one unit or writes at most 256 bytes.
    ///
    /// With `content`, it is a step towards storing it. The content has a number; another number starts again. Without
    /// content, it is a step towards an erased spare slot.
    pub(crate) fn step(&mut self, now: Instant, content: Option<(u32, [PlanView<'_>; 3])>) -> Step {
        let Some((id, content)) = content else { return self.record.step(now, None, |_| None) };
        let stored = Stored::of(&content);
        let step =
            self.record.step(now, Some(Job { id, schema: SCHEMA, len: stored.len() }), |index| row(&content, index));
        if step == Step::Done {
            self.stored = stored;
        }
        step
    }
}
