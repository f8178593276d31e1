//! Storage of the three plans: one record, so that they are replaced together (M-5, SEC-11).
//!
//! `format.md` in this folder documents the format: a head, and a row for each item. If you change it, increment the schema version, and keep reading the old one.

use super::content::{Part, Persistent, RestoreError, Texts, Write, is_disarmed};
use super::page::PAYLOAD;
use crate::dialect::{MavCmd, MavFrame, MavMissionResult};
use crate::message::{Digest, Item};
use crate::service::Cx;
use crate::service::command::Commands;
use crate::service::mission::{Missions, PlanFault, Plans};
use crate::types::{Firmware, PlanMemory, PlanType, PlanView, Vehicle};

/// Number of rows in a page.
const ROWS: u32 = 7;
#[allow(clippy::as_conversions, reason = "`from` is not const")]
const _: () = assert!(ROWS as usize * size_of::<Row>() == PAYLOAD);

/// Stands for no fault of a plan.
const NO_FAULT: PlanFault = PlanFault { seq: None, result: MavMissionResult::ACCEPTED };

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

/// The stored plans while they are loaded.
#[derive(Clone, Copy, Debug)]
pub struct Loading {
    counts: [u32; 3],
    ids: [u32; 3],
    /// The index of the plan whose items are next, and the number of its items so far.
    plan: u8,
    items: u16,
    digest: Digest,
    /// Why the plan is not used. ACCEPTED if it is: all zeros, unlike an `Option`.
    fault: PlanFault,
    /// Whether a plan was not used.
    differs: bool,
}

impl Loading {
    pub(crate) const NEW: Self = Self {
        counts: [0; 3],
        ids: [0; 3],
        plan: 0,
        items: 0,
        digest: Digest::VACANT,
        fault: NO_FAULT,
        differs: false,
    };
}

/// Writes a row of the content; `None` if it has fewer rows.
#[inline(never)]
fn write_row(content: &[PlanView<'_>; 3], index: u32, row: &mut Row) -> Option<()> {
    let Some(index) = index.checked_sub(1) else {
        let [mission, fence, rally] = content;
        let count = |plan: &PlanView<'_>| u32::try_from(plan.items().len()).unwrap_or(u32::MAX).to_le_bytes();
        let id = |plan: &PlanView<'_>| plan.id().to_le_bytes();
        *row = [count(mission), count(fence), count(rally), id(mission), id(fence), id(rally), [0; 4], [0; 4]];
        return Some(());
    };
    let mut index = usize::try_from(index).ok()?;
    for plan in content {
        match index.checked_sub(plan.items().len()) {
            Some(rest) => index = rest,
            None => {
                *row = row_of(plan.items().get(index)?);
                return Some(());
            }
        }
    }
    None
}

/// Fills a page with rows. Returns the number of bytes, and whether it is the last page.
pub(super) fn fill(content: &[PlanView<'_>; 3], page: u16, bytes: &mut [u8]) -> Option<(u8, bool)> {
    let rows = content.iter().fold(1usize, |rows, plan| rows.saturating_add(plan.items().len()));
    let rows = u32::try_from(rows).unwrap_or(u32::MAX);
    let first = u32::from(page).saturating_mul(ROWS);
    let mut len = 0u8;
    for (index, row) in (first..rows).zip(bytes.as_chunks_mut().0.as_chunks_mut().0) {
        write_row(content, index, row)?;
        len = len.saturating_add(32);
    }
    (len > 0).then_some((len, first.saturating_add(ROWS) >= rows))
}

impl Loading {
    /// Takes the first row.
    fn begin(&mut self, row: &Row) {
        let [a, b, c, d, e, f, ..] = row.map(u32::from_le_bytes);
        *self = Self { counts: [a, b, c], ids: [d, e, f], digest: Digest::new(), ..Self::NEW };
    }

    fn plan(&self) -> Option<(PlanType, u32, u32)> {
        let index = usize::from(self.plan);
        Some((*PlanType::ALL.get(index)?, *self.counts.get(index)?, *self.ids.get(index)?))
    }

    /// Makes each plan live whose items are complete.
    fn finish<F: Firmware<Vehicle: Plans>>(&mut self, missions: &mut Missions, cx: &mut Cx<'_, F>, is_late: bool) {
        while let Some((plan, _, id)) = self.plan().filter(|(_, count, _)| *count == u32::from(self.items)) {
            // A plan that was uploaded in the meantime is newer.
            if !(is_late && cx.plans.count(plan) > 0) {
                let result = if self.fault == NO_FAULT {
                    missions.make_loaded(cx, plan, Some((self.items, id)), self.digest)
                } else {
                    Err(self.fault)
                };
                if let Err(fault) = result {
                    self.differs = true;
                    Missions::report_refused(cx, plan, fault);
                }
            }
            cx.plans.clear_staging();
            (self.plan, self.items) = (self.plan.saturating_add(1), 0);
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
        self.items = self.items.saturating_add(1);
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
    const TEXTS: Texts = Texts {
        unreadable: "Stored plans cannot be read",
        damaged: "Stored plans are damaged",
        readable: "Stored plans can be read again",
    };

    fn attach(&mut self, cx: &mut Cx<'_, F>) {
        self.attach_storage(cx.shared.config.durability);
        self.set_refill(cx.shared.config.storage_refill);
        // Until they are loaded, nobody knows what is stored, and clients are not answered.
        self.set_stored_differs(true);
        self.set_loading(&mut cx.plans, true);
    }

    #[inline(never)]
    fn load(&mut self, cx: &mut Cx<'_, F>, part: &Part<'_>, loading: &mut Loading) -> bool {
        let mut is_head = part.is_first;
        for row in rows(part.bytes) {
            if core::mem::replace(&mut is_head, false) {
                loading.begin(row);
                self.set_loading(&mut cx.plans, true);
            } else if !loading.item(cx, row) {
                return false;
            }
            loading.finish(self, cx, part.is_late);
        }
        if part.is_last {
            self.set_stored_differs(loading.differs);
        }
        !is_head && (!part.is_last || loading.plan().is_none())
    }

    fn loaded(&mut self, cx: &mut Cx<'_, F>, result: Result<bool, RestoreError>, _: bool) {
        self.set_loading(&mut cx.plans, false);
        match result {
            Ok(false) => self.set_stored_differs(false),
            Ok(true) => {}
            Err(_) => self.set_stored_differs(true),
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

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<Write> {
        let version = Missions::pending_write(self, cx.now)?;
        Some(Write { record: 0, version, is_secret: false })
    }

    #[inline(never)]
    fn fill(&mut self, cx: &mut Cx<'_, F>, _: u8, page: u16, bytes: &mut [u8]) -> Option<(u8, bool)> {
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

    fn on_readable<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) -> bool
    where
        Self::Link: 'l,
    {
        Persistent::<F>::on_blocked(self, cx, links);
        true
    }
}
