//! Storage of the three plans: one record, so that they are replaced together (M-5, SEC-11).
//!
//! `format.md` in this folder documents the format: a head, and a row for each item. If you change it, increment the schema version, and keep reading the old one.

use core::num::Saturating;

use super::page::PAYLOAD;
use super::persistent::{
    FilledPage, LoadProgress, LoadResult, LoadedPage, NO_FAULT, PendingWrite, Persistent, RestoreTexts, is_disarmed,
};
use crate::dialect::{MavCmd, MavFrame};
use crate::message::{Digest, Item};
use crate::service::Cx;
use crate::service::command::Commands;
use crate::service::mission::{Missions, Plans};
use crate::types::{Firmware, PlanMemory, PlanType, PlanView, Vehicle};

/// Number of rows in a page.
const ROWS: usize = PAYLOAD / size_of::<Row>();

/// A row: eight words, in little-endian order.
type Row = [[u8; 4]; 8];

/// Floats are stored as their bits, so that no NaN is changed.
fn row_of(item: &Item) -> Row {
    let [command0, command1] = item.command.0.to_le_bytes();
    let [a, b, c, d] = item.params.map(|param| param.to_bits().to_le_bytes());
    let head = [item.frame.0, command0, command1, item.autocontinue];
    [head, a, b, c, d, item.x.to_le_bytes(), item.y.to_le_bytes(), item.z.to_bits().to_le_bytes()]
}

fn item_of(row: &Row) -> Item {
    let [[frame, command0, command1, autocontinue], a, b, c, d, x, y, z] = *row;
    let float = |bytes| f32::from_bits(u32::from_le_bytes(bytes));
    Item {
        frame: MavFrame(frame),
        command: MavCmd(u16::from_le_bytes([command0, command1])),
        autocontinue,
        params: [a, b, c, d].map(float),
        x: i32::from_le_bytes(x),
        y: i32::from_le_bytes(y),
        z: float(z),
    }
}

/// Returns the rows in a page.
fn rows(bytes: &[u8]) -> &[Row] {
    bytes.as_chunks().0.as_chunks().0
}

/// Returns a row of the content; `None` if it has fewer rows.
fn row_at(content: &[PlanView<'_>; 3], index: usize) -> Option<Row> {
    if let Some(item) = index.checked_sub(1) {
        return content.iter().flat_map(PlanView::items).nth(item).map(row_of);
    }
    let [mission, fence, rally] = content;
    let count = |plan: &PlanView<'_>| u32::try_from(plan.items().len()).unwrap_or(u32::MAX).to_le_bytes();
    let id = |plan: &PlanView<'_>| plan.id().to_le_bytes();
    Some([count(mission), count(fence), count(rally), id(mission), id(fence), id(rally), [0; 4], [0; 4]])
}

/// Fills a page with rows.
pub(super) fn fill(content: &[PlanView<'_>; 3], page: u16, bytes: &mut [u8]) -> Option<FilledPage> {
    let first = Saturating(usize::from(page)) * Saturating(ROWS);
    let mut len = Saturating(0u8);
    for (index, place) in (first.0..).zip(bytes.as_chunks_mut().0.as_chunks_mut().0) {
        let Some(row) = row_at(content, index) else { break };
        *place = row;
        len += 32;
    }
    let is_last = row_at(content, (first + Saturating(ROWS)).0).is_none();
    (len.0 > 0).then_some(FilledPage { len: len.0, is_last })
}

impl LoadProgress {
    /// Takes the first row.
    fn begin(&mut self, row: &Row) {
        let [a, b, c, d, e, f, ..] = row.map(u32::from_le_bytes);
        *self = Self { counts: [a, b, c], ids: [d, e, f], digest: Digest::new(), ..Self::NEW };
    }

    fn plan(&self) -> Option<(PlanType, u32, u32)> {
        let index = usize::from(self.plan.0);
        Some((*PlanType::ALL.get(index)?, *self.counts.get(index)?, *self.ids.get(index)?))
    }

    /// Makes each plan live whose items are complete.
    fn finish<F: Firmware<Vehicle: Plans>>(&mut self, missions: &mut Missions, cx: &mut Cx<'_, F>, is_late: bool) {
        while let Some((plan, _, id)) = self.plan().filter(|(_, count, _)| *count == u32::from(self.items.0)) {
            // A plan that was uploaded in the meantime is newer.
            if !(is_late && cx.plans.count(plan) > 0) {
                let result = if self.fault == NO_FAULT {
                    missions.make_loaded(cx, plan, Some((self.items.0, id)), self.digest)
                } else {
                    Err(self.fault)
                };
                if let Err(fault) = result {
                    self.differs = true;
                    Missions::report_refused(cx, plan, fault);
                }
            }
            cx.plans.clear_staging();
            self.plan += 1;
            self.items.0 = 0;
            (self.digest, self.fault) = (Digest::new(), NO_FAULT);
        }
    }

    /// Takes the row of an item. Returns false if there is no plan for it.
    fn item<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, row: &Row) -> bool {
        let Some((plan, ..)) = self.plan() else { return false };
        if self.fault == NO_FAULT {
            let item = item_of(row);
            self.digest.add(&item);
            if let Err(fault) = Missions::stage_item(cx, plan, item) {
                self.fault = fault;
            }
        }
        self.items += 1;
        true
    }
}

/// Plans survive a restart (M-44).
impl<F> Persistent<F> for Missions
where
    F: Firmware<Vehicle: Vehicle + Plans + Commands>,
{
    const KIND: u8 = 1;
    const RECORDS: u8 = 1;
    const SCHEMA: u16 = 1;
    #[allow(clippy::as_conversions, clippy::arithmetic_side_effects, reason = "const-evaluated: each is below 65,536")]
    const MAX_LEN: u32 = {
        let [mission, fence, rally] = F::Plans::CAPACITIES;
        (1 + mission as u32 + fence as u32 + rally as u32) * 32
    };
    const TEXTS: RestoreTexts = RestoreTexts {
        unreadable: "Stored plans cannot be read",
        damaged: "Stored plans are damaged",
        readable: "Stored plans can be read again",
    };

    fn attach(&mut self, cx: &mut Cx<'_, F>) {
        self.attach_storage(cx.shared.config.durability);
        self.set_refill(cx.shared.config.storage_refill);
        // Until they are loaded, the stored plans are unknown, and clients are not answered.
        self.set_stored_differs(true);
        self.set_loading(&mut cx.plans, true);
    }

    #[inline(never)]
    fn load(&mut self, cx: &mut Cx<'_, F>, page: LoadedPage<'_>) -> bool {
        let LoadedPage { bytes, is_first, is_last, is_late, progress, .. } = page;
        let mut is_head = is_first;
        for row in rows(bytes) {
            if core::mem::replace(&mut is_head, false) {
                progress.begin(row);
                self.set_loading(&mut cx.plans, true);
            } else if !progress.item(cx, row) {
                return false;
            }
            progress.finish(self, cx, is_late);
        }
        if is_last {
            self.set_stored_differs(progress.differs);
        }
        !is_head && (!is_last || progress.plan().is_none())
    }

    fn loaded(&mut self, cx: &mut Cx<'_, F>, result: LoadResult, _: bool) {
        self.set_loading(&mut cx.plans, false);
        match result {
            LoadResult::Empty => self.set_stored_differs(false),
            LoadResult::Loaded => {}
            LoadResult::Failed(_) => self.set_stored_differs(true),
        }
    }

    /// A running upload uses the memory that loading needs. In flight, only the operator changes plans.
    fn may_load(&self, cx: &Cx<'_, F>, is_late: bool) -> bool {
        (!is_late || is_disarmed(cx.vehicle)) && !self.is_receiving()
    }

    fn cancel_if_refused<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>)
    where
        Self::Link: 'l,
    {
        let answer = self.refuse_commit(cx);
        self.queue_result(cx, links, answer);
    }

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<PendingWrite> {
        let version = Missions::pending_write(self, cx.now)?;
        Some(PendingWrite { record: 0, version, is_secret: false })
    }

    #[inline(never)]
    fn fill(&mut self, cx: &mut Cx<'_, F>, _: u8, page: u16, bytes: &mut [u8]) -> Option<FilledPage> {
        fill(&self.content(&cx.plans), page, bytes)
    }

    #[inline(never)]
    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>, is_saved: bool)
    where
        Self::Link: 'l,
    {
        let answer = if is_saved { self.on_saved(cx) } else { self.on_save_failed(cx) };
        self.queue_result(cx, links, answer);
    }

    fn save_again(&mut self, _: &mut Cx<'_, F>) {
        Missions::save_again(self);
    }

    /// Stored content comes first: a client that waits gets ERROR, and tries again.
    fn on_blocked<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>)
    where
        Self::Link: 'l,
    {
        if self.is_committing() {
            Persistent::<F>::on_written(self, cx, links, false);
        }
    }

    fn prepare_load<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) -> bool
    where
        Self::Link: 'l,
    {
        Persistent::<F>::on_blocked(self, cx, links);
        true
    }
}
