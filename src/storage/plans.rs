//! Storage of the three plans: one record, so that they are replaced together (M-5, SEC-11).
//!
//! `format.md` in this folder documents the format: a head, and a row for each item. If you change it, increment the
//! schema version, and keep reading the old one.

use core::num::Saturating;

use super::page::PAYLOAD;
use super::persistent::{
    DamagedContent, FilledPage, LoadProgress, LoadResult, LoadedPage, NO_FAULT, PendingWrite, Persistent, RestoreTexts,
    is_disarmed,
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

/// Returns the rows in a page, without an incomplete one at its end.
fn rows(bytes: &[u8]) -> &[Row] {
    bytes.as_chunks().0.as_chunks().0
}

/// Returns a row of the content: the head has index 0, and the items follow. Returns `None` after the last item.
fn row_at(content: &[PlanView<'_>; 3], index: usize) -> Option<Row> {
    if let Some(item_index) = index.checked_sub(1) {
        return content.iter().flat_map(PlanView::items).nth(item_index).map(row_of);
    }
    let [mission, fence, rally] = content;
    let count = |plan: &PlanView<'_>| u32::try_from(plan.items().len()).unwrap_or(u32::MAX).to_le_bytes();
    let id = |plan: &PlanView<'_>| plan.id().to_le_bytes();
    Some([count(mission), count(fence), count(rally), id(mission), id(fence), id(rally), [0; 4], [0; 4]])
}

/// Fills a page with rows. Returns `None` if no row is left for it.
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

/// A plan of the record, as the head describes it.
struct StoredPlan {
    plan: PlanType,
    count: u32,
    id: u32,
}

impl LoadProgress {
    /// Begins a record with its head.
    fn begin(&mut self, head: &Row) {
        let [mission, fence, rally, mission_id, fence_id, rally_id, ..] = head.map(u32::from_le_bytes);
        let (counts, ids) = ([mission, fence, rally], [mission_id, fence_id, rally_id]);
        *self = Self { counts, ids, digest: Digest::new(), ..Self::NEW };
    }

    /// Returns the plan whose items are next; `None` after the last plan.
    fn current_plan(&self) -> Option<StoredPlan> {
        let index = usize::from(self.plan.0);
        let plan = *PlanType::ALL.get(index)?;
        Some(StoredPlan { plan, count: *self.counts.get(index)?, id: *self.ids.get(index)? })
    }

    /// Stages the item in a row. An item that cannot be flown makes its plan unusable.
    ///
    /// # Errors
    ///
    /// `DamagedContent` if all plans of the head are complete.
    fn stage_item<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, row: &Row) -> Result<(), DamagedContent> {
        let StoredPlan { plan, .. } = self.current_plan().ok_or(DamagedContent)?;
        if self.fault == NO_FAULT {
            let item = item_of(row);
            self.digest.add(&item);
            if let Err(fault) = Missions::stage_item(cx, plan, item) {
                self.fault = fault;
            }
        }
        self.items += 1;
        Ok(())
    }

    /// Makes the current plan live if all its items are staged, and the empty plans after it. Reports a plan that is
    /// refused.
    fn end_complete_plans<F: Firmware<Vehicle: Plans>>(
        &mut self,
        missions: &mut Missions,
        cx: &mut Cx<'_, F>,
        is_retry: bool,
    ) {
        while let Some(StoredPlan { plan, count, id }) = self.current_plan()
            && count == u32::from(self.items.0)
        {
            // Since the first attempt failed, a client may have uploaded a plan, which is newer.
            let is_outdated = is_retry && cx.plans.count(plan) > 0;
            if !is_outdated {
                let result = if self.fault == NO_FAULT {
                    missions.make_loaded(cx, plan, Some((self.items.0, id)), self.digest)
                } else {
                    Err(self.fault)
                };
                if let Err(fault) = result {
                    self.has_refused_plan = true;
                    Missions::report_refused(cx, plan, fault);
                }
            }
            cx.plans.clear_staging();
            self.plan += 1;
            self.items.0 = 0;
            (self.digest, self.fault) = (Digest::new(), NO_FAULT);
        }
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
        // Until the stored plans are loaded, they may differ from the live ones, and no client can upload a plan.
        self.set_stored_differs(true);
        self.begin_loading(&mut cx.plans);
    }

    /// Loads the rows of a page: the head, which is the first row of the record, and the items of the plans in order. A
    /// plan goes live with its last item.
    ///
    /// # Errors
    ///
    /// `DamagedContent` if the head is missing, or if there are more or fewer items than it says.
    // Out of line: its locals stay off the call stack of the other contents.
    #[inline(never)]
    fn load(&mut self, cx: &mut Cx<'_, F>, page: LoadedPage<'_>) -> Result<(), DamagedContent> {
        let LoadedPage { bytes, is_first, is_last, is_retry, progress, .. } = page;
        let mut items = rows(bytes).iter();
        if is_first {
            let head = items.next().ok_or(DamagedContent)?;
            progress.begin(head);
            self.begin_loading(&mut cx.plans);
            progress.end_complete_plans(self, cx, is_retry);
        }
        for item in items {
            progress.stage_item(cx, item)?;
            progress.end_complete_plans(self, cx, is_retry);
        }
        if is_last {
            self.set_stored_differs(progress.has_refused_plan);
            if progress.current_plan().is_some() {
                return Err(DamagedContent);
            }
        }
        Ok(())
    }

    fn loaded(&mut self, cx: &mut Cx<'_, F>, result: LoadResult, _: bool) {
        self.end_loading(&mut cx.plans);
        match result {
            LoadResult::Empty => self.set_stored_differs(false),
            // `load` has recorded whether a plan was refused.
            LoadResult::Loaded => {}
            LoadResult::Failed(_) => self.set_stored_differs(true),
        }
    }

    /// Not during an upload, which uses the staging area. A second attempt also waits until the vehicle is disarmed: in
    /// flight, only the operator changes plans.
    fn may_load(&self, cx: &Cx<'_, F>, is_retry: bool) -> bool {
        let is_permitted_by_vehicle = !is_retry || is_disarmed(cx.vehicle);
        is_permitted_by_vehicle && !self.is_receiving()
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

    // Out of line: its locals stay off the call stack of the other contents.
    #[inline(never)]
    fn fill(&mut self, cx: &mut Cx<'_, F>, _: u8, page: u16, bytes: &mut [u8]) -> Option<FilledPage> {
        fill(&self.content(&cx.plans), page, bytes)
    }

    // Out of line: its locals stay off the call stack of the other contents.
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

    /// Stored content is loaded before anything is written. So a client that waits for a write gets ERROR, and tries
    /// again.
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
