//! Storage of the three plans: one [record](super::record), so that they are replaced together.
//!
//! `layout.md` in this folder documents the format: the structs below in the encoding of postcard, with integers of
//! fixed width. If you change a struct, increment the schema version, and keep reading the old one.

use embedded_storage::nor_flash::NorFlash;
use postcard::fixint::le;
use serde::{Deserialize, Serialize};

use super::record::{Format, Job, ROW, RestoreError};
use super::store::{Body, Found, Persistent, Texts, is_disarmed};
use crate::dialect::{MavCmd, MavFrame};
use crate::message::Item;
use crate::service::Cx;
use crate::service::command::Commands;
use crate::service::mission::{self, Missions, Plans};
use crate::time::Instant;
use crate::types::{Firmware, PlanMemory, PlanType, PlanView, Vehicle};

pub(super) const FORMAT: Format = Format { kind: 1, schema: 1 };

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
    pub(super) fn of(content: &[PlanView<'_>; 3]) -> Self {
        Self {
            counts: content.map(|plan| u16::try_from(plan.items().len()).unwrap_or(u16::MAX)),
            ids: content.map(|plan| plan.id()),
        }
    }

    /// Returns the length of the body in bytes.
    pub(super) fn len(&self) -> u32 {
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
pub(super) fn row(content: &[PlanView<'_>; 3], row: u32) -> Option<[u8; ROW]> {
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

/// Reads the head of the record that was found.
///
/// # Errors
///
/// There is no whole record of this version, and the storage is not empty; or it cannot be read.
#[inline(never)]
pub(super) fn open<N: NorFlash>(
    body: &mut Body<'_, N>,
    found: Found<N::Error>,
) -> Result<Option<Stored>, RestoreError<N::Error>> {
    let Some(len) = found? else { return Ok(None) };
    let mut row = [0; ROW];
    let is_read = body.row(0, &mut row)?;
    let stored = Stored::from_row(&row).filter(|stored| is_read && stored.len() == len);
    stored.ok_or(RestoreError::Damaged).map(Some)
}

/// Reads an item of the record that [`open`] has found.
pub(super) fn item<N: NorFlash>(
    body: &mut Body<'_, N>,
    stored: &Stored,
    plan: PlanType,
    seq: u16,
) -> Result<Option<Item>, N::Error> {
    let Some(row) = stored.row_of(plan, seq) else { return Ok(None) };
    let mut bytes = [0; ROW];
    Ok(if body.row(row, &mut bytes)? { item_from_row(&bytes) } else { None })
}

/// Plans survive a restart (M-44, SEC-11).
impl<F: Firmware<Vehicle: Vehicle + Plans + Commands>> Persistent<F> for Missions {
    const FORMAT: Format = FORMAT;
    #[allow(clippy::as_conversions, reason = "`from` is not const; the value is bounded")]
    const MAX_LEN: u32 = {
        let [mission, fence, rally] = F::Plans::CAPACITIES;
        (1 + mission as u32 + fence as u32 + rally as u32) * 32
    };
    const TEXTS: Texts = Texts {
        unreadable: "Stored plans cannot all be read",
        damaged: "Stored plans are damaged",
        readable: "Stored plans can be read again",
    };

    /// Late, it takes only the plans whose live plan is empty.
    #[inline(never)]
    fn load<N: NorFlash>(
        &mut self,
        cx: &mut Cx<'_, F>,
        body: &mut Body<'_, N>,
        found: Found<N::Error>,
        is_late: bool,
    ) -> Result<(), RestoreError<N::Error>> {
        self.attach_storage(cx.shared.config.durability);
        self.set_refill(cx.shared.config.storage_refill);
        let Some((mut cx, vehicle)) = mission::work(cx) else { return Ok(()) };
        self.set_stored_differs(true);
        let Some(stored) = open(body, found)? else {
            self.set_stored_differs(body.is_impaired());
            return Ok(());
        };
        let mut differs = body.is_impaired() || body.is_damaged();
        for ((&plan, &count), &id) in PlanType::ALL.iter().zip(&stored.counts).zip(&stored.ids) {
            // A plan that was uploaded in the meantime is newer.
            if is_late && cx.plans.count(plan) > 0 {
                continue;
            }
            let mut failure = Ok(());
            let item = |seq| {
                item(body, &stored, plan, seq).unwrap_or_else(|error| {
                    failure = Err(error);
                    None
                })
            };
            let loaded = self.load_plan(&mut cx, vehicle, plan, Some((count, id)), item);
            failure?;
            if let Err(fault) = loaded {
                differs = true;
                self.report_refused(&mut cx, plan, fault);
            }
        }
        self.set_stored_differs(differs);
        if body.is_damaged() { Err(RestoreError::Damaged) } else { Ok(()) }
    }

    /// A running upload uses the memory that reading needs. In flight, only the operator changes plans.
    fn may_load_late(&self, cx: &Cx<'_, F>) -> bool {
        is_disarmed(cx.vehicle) && !self.is_receiving()
    }

    fn is_paused(&self, now: Instant) -> bool {
        self.is_storage_paused(now)
    }

    #[inline(never)]
    fn cancel_if_refused<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) -> bool
    where
        Self::Link: 'l,
    {
        let Some((mut cx, vehicle)) = mission::work(cx) else { return false };
        let answer = self.refuse_commit(&mut cx, vehicle);
        let is_refused = answer.is_some();
        mission::queue_result(links, answer);
        is_refused
    }

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<Job> {
        let (id, content) = self.content(cx.plans.as_ref()?)?;
        Some(Job { id, len: Stored::of(&content).len() })
    }

    #[inline(never)]
    fn row(&self, cx: &mut Cx<'_, F>, index: u32) -> Option<[u8; ROW]> {
        let (_, content) = self.content(cx.plans.as_ref()?)?;
        row(&content, index)
    }

    #[inline(never)]
    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>, is_saved: bool)
    where
        Self::Link: 'l,
    {
        let Some((mut cx, vehicle)) = mission::work(cx) else { return };
        let answer = if is_saved { self.on_saved(&mut cx, vehicle) } else { self.on_save_failed(&mut cx) };
        mission::queue_result(links, answer);
    }

    /// Stored content comes first: a client that waits gets ERROR, and tries again.
    fn on_readable<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) -> bool
    where
        Self::Link: 'l,
    {
        if self.is_committing() {
            Persistent::<F>::on_written(self, cx, links, false);
        }
        true
    }
}
