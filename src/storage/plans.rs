//! The three plans on storage: one [record](super::record), so that they are replaced together.
//!
//! The bytes are described in `layout.md` beside this file. They are what postcard makes of the structures below, all
//! numbers with fixed width. Whoever changes one of them counts the schema version up, and goes on reading what was stored
//! before.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;
use postcard::fixint::le;
use serde::{Deserialize, Serialize};

use super::record::{Job, ROW, Record, RestoreError, Step};
use crate::dialect::{MavCmd, MavFrame};
use crate::service::mission::{Item, PlanType, PlanView};
use crate::time::Instant;

const KIND: u8 = 1;
const SCHEMA: u16 = 1;

/// The first row.
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

/// An item. Floats as their bits, so that nothing on the way can change a NaN.
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

/// Which plans are stored. In the order of [`PlanType::ALL`].
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

    /// Length of the body, in bytes.
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

    /// The row of an item, if there is one.
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

/// A row of the body; `None` when the content has not so many.
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

/// Keeps the three plans on storage: two slots, of which one always has what was complete before.
///
/// The storage is anything that is [`NorFlash`] with a `WRITE_SIZE` that divides 256 and a `READ_SIZE` that divides 32.
/// Writing is done by [`Stack::persist_plans`](crate::Stack::persist_plans), in steps of at most one erase unit or 256 bytes.
/// Wherever the power goes, one slot has what was whole before, or the other one has the new plans:
///
/// ```text
///                 older record, or torn ── erased ahead, header first ──▶ erased
///   spare slot:      ▲                                                      │ there is something to store
///                    │                                                      ▼
///                 the newer record counts ◀── header ── read back ◀── body, 256 bytes a step
///                 and the other slot is spare
/// ```
///
/// When an upload is answered and goes live, [`Durability`](crate::Durability) says.
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
/// use mavstack::PlanStore;
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
    /// A store in this region of the storage, of which it uses two halves of whole erase units. Nothing is read yet.
    pub const fn new(flash: F, region: Range<u32>) -> Self {
        Self { record: Record::new(flash, region, KIND), stored: Stored { counts: [0; 3], ids: [0; 3] } }
    }

    /// How long the region has to be for plans of so many items, in bytes: a multiple of two erase units. It has to begin
    /// where an erase unit does.
    #[allow(clippy::as_conversions, reason = "`try_from` is not const; saturated before")]
    pub const fn region_len(mission: usize, fence: usize, rally: usize) -> u32 {
        let items = mission.saturating_add(fence).saturating_add(rally);
        let rows = if items < 0x0400_0000 { items as u32 } else { 0x0400_0000 };
        Record::<F>::slot_len(rows.saturating_add(1).saturating_mul(32)).saturating_mul(2)
    }

    /// The storage.
    pub const fn flash(&self) -> &F {
        &self.record.flash
    }

    /// The storage. What is written to the store's region here is lost, or damages the plans.
    pub const fn flash_mut(&mut self) -> &mut F {
        &mut self.record.flash
    }

    /// Gives the storage back.
    pub fn into_inner(self) -> F {
        self.record.flash
    }

    /// Finds the newest record. Reads the whole of it.
    ///
    /// # Errors
    ///
    /// Neither slot has a whole record of this version, and the storage is not empty.
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

    /// Whether there is damage besides the record that was found.
    pub(crate) const fn is_damaged(&self) -> bool {
        self.record.is_damaged()
    }

    /// Whether a [`step`](Self::step) only reads again what could not be read.
    pub(crate) const fn is_unread(&self) -> bool {
        self.record.is_unread()
    }

    /// Whether a slot could not be read.
    pub(crate) const fn is_impaired(&self) -> bool {
        self.record.is_impaired()
    }

    /// An item that [`open`](Self::open) has found, or that was written since.
    pub(crate) fn item(&mut self, plan: PlanType, seq: u16) -> Result<Option<Item>, F::Error> {
        let Some(row) = self.stored.row_of(plan, seq) else { return Ok(None) };
        let row = self.record.row(row)?;
        Ok(row.and_then(|row| item_from_row(&row)))
    }

    /// At most one erase unit or one write of at most 256 bytes, towards `content` being durable, with a number that
    /// stands for it: another number begins anew. Without content, towards the next content having an erased slot.
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
