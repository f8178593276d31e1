//! Makes a complete new plan live, after storing it if storage is attached (M-39, M-44, M-52, M-83, SEC-11).
//!
//! [`Durability`] has a diagram of the variants.
//!
//! [`content`](Missions::content) returns the content to write. The result is reported to
//! [`on_saved`](Missions::on_saved) or [`on_save_failed`](Missions::on_save_failed). Until then no other upload may
//! begin, because the staging area holds the plan that is being written.

use core::num::Wrapping;

use super::check::{self, check_staged_plan};
use super::distance::first_too_far;
use super::engine::Missions;
use super::problem::{PlanFault, Problem};
use super::replies::{Client, FinalAnswer, Replies, ReplyContent};
use super::transfer::{Change, Commit, FinishedUpload, SecondAnswer, Transfer};
use super::vehicle::{PlanChange, Plans};
use crate::dialect::MavMissionResult;
use crate::message::{Digest, Item};
use crate::service::{Cx, increment};
use crate::time::{Duration, Instant};
use crate::types::{Durability, Firmware, Peer, PlanType, PlanView, PlansMut, Vehicle};

/// A change that is not durable after this time is abandoned.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Wait after a successful write before flash is erased ahead, so that the answer is sent first.
const GRACE: Duration = Duration::from_millis(200);

/// Time from the final answer of an upload to the second one, if that is configured: within QGroundControl's timeout of
/// 1.5 s (M-31).
const SECOND_ACK: Duration = Duration::from_millis(400);

/// Admission: the checks before a change.
impl Missions {
    /// Asks the vehicle for permission, and whether it permits the write that a durable change needs unless it
    /// [is stored already](Self::changes_nothing) (M-27, M-44).
    pub(super) fn permission<F: Firmware<Vehicle: Plans>>(
        &self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        from: Peer,
        is_stored: bool,
    ) -> Result<(), MavMissionResult> {
        let (vehicle, mut context) = cx.hook();
        if self.is_durable() && !is_stored && !vehicle.may_persist() {
            return Err(MavMissionResult::DENIED);
        }
        vehicle.may_change(&mut context, plan, from)
    }

    /// Asks for [permission](Self::permission), and reports a refusal (M-27, M-44).
    pub(super) fn ask_permission<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        from: Peer,
    ) -> Result<(), MavMissionResult> {
        let permission = self.permission(cx, plan, from, false);
        if let Err(result) = permission {
            if let Some(refused) = self.refused.count(cx.now) {
                event!("{} change by {}: {=u8} by the vehicle; {=u32} refused so far", plan, from, result.0, refused);
            }
            Problem::Refused(plan, result.into()).report(cx);
        }
        permission
    }

    /// Refuses a change to `count` items, and reports it, if the token bucket has too few tokens for the write (C-15).
    pub(super) fn limit_rate<F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        from: Peer,
        count: u16,
    ) -> Result<(), MavMissionResult> {
        if !self.is_attached() || self.schedule.bucket.has(cx.now, tokens(&cx.plans, count)) {
            return Ok(());
        }
        if let Some(refused) = self.refused.count(cx.now) {
            event!("{} change by {}: too many writes to storage; {=u32} refused so far", plan, from, refused);
        }
        Problem::RateLimited(plan).report(cx);
        Err(MavMissionResult::DENIED)
    }

    /// Counts a request that must be dropped, because it is for a durable change and there is no free slot for the
    /// result. Returns false if there is one.
    pub(super) fn drop_without_result_slot(&mut self, replies: &Replies) -> bool {
        let is_dropped = self.is_durable() && replies.has_result();
        if is_dropped {
            increment(&mut self.counters.no_answer_slot);
        }
        is_dropped
    }

    /// Whether a clear would change nothing, in RAM or in storage (M-52).
    pub(super) fn is_clear(&self, plans: &PlansMut<'_>, only: Option<PlanType>) -> bool {
        let is_empty = |plan| !Change::Clear(only).affects(plan) || plans.count(plan) == 0;
        PlanType::ALL.into_iter().all(is_empty) && self.is_saved()
    }

    /// Whether `change` would change nothing, in RAM or in storage.
    pub(super) fn changes_nothing(&self, plans: &PlansMut<'_>, change: &Change) -> bool {
        match *change {
            // M-39, SEC-11: even while the plan is being flown, and without wearing the flash.
            Change::Upload { plan, id, .. } => plans.is_live(plan, id) && self.is_saved(),
            Change::Clear(only) => self.is_clear(plans, only),
        }
    }
}

/// The change itself.
impl Missions {
    /// Makes `change` live and answers, or starts to write it first.
    pub(super) fn change<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        change: Change,
    ) {
        let commit = Commit { client: client.peer, change, since: cx.now };
        if !self.changes_nothing(&cx.plans, &change) {
            if self.is_attached() {
                let tokens = tokens(&cx.plans, cx.plans.staged());
                self.schedule.bucket.spend(cx.now, tokens);
            }
            if self.is_durable() {
                event!("plans: change by {}: writing", client.peer);
                self.schedule.restart();
                self.transfer = Transfer::Commit(commit);
                self.heard_at = cx.now;
                return;
            }
            self.make_live(cx, &change);
            self.request_save();
        }
        let content = self.end_change(cx, &commit, MavMissionResult::ACCEPTED);
        client.answer(content);
    }

    /// Makes `change` live in one step.
    fn make_live<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, change: &Change) {
        match *change {
            // Live already; only storage lacked it.
            Change::Upload { plan, id, .. } if cx.plans.is_live(plan, id) => {}
            Change::Upload { plan, id, first, .. } => self.replace(cx, plan, id, first),
            Change::Clear(_) => {
                cx.plans.clear_staging();
                for plan in PlanType::ALL {
                    if change.affects(plan) && cx.plans.count(plan) > 0 {
                        event!("{} cleared", plan);
                        self.replace(cx, plan, 0, 0);
                    }
                }
            }
        }
    }

    /// Replaces a live plan with the staged one.
    fn replace<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, plan: PlanType, id: u32, first: u16) {
        cx.plans.go_live(plan, id);
        self.sessions.invalidate(plan);
        if plan == PlanType::Mission {
            self.reached.clear();
            self.is_distance_unchecked = cx.vehicle.first_waypoint_limit().is_none();
        }
        let (vehicle, mut context) = cx.hook();
        let items = context.plan(plan).items();
        vehicle.plan_changed(&mut context, PlanChange { plan, items, first });
    }

    /// Ends a change with this result. Returns the answer to its client.
    fn end_change<F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        commit: &Commit,
        result: MavMissionResult,
    ) -> ReplyContent {
        let &Commit { client, change, .. } = commit;
        self.current.announce(cx.shared.normal);
        cx.plans.clear_staging();
        let id = match change {
            Change::Upload { plan, id, last_seq, last, .. } => {
                let mission_type = change.mission_type();
                let id = if result == MavMissionResult::ACCEPTED { id } else { 0 };
                if id != 0 {
                    self.sessions.renew(cx.now, client, plan);
                    if cx.shared.config.second_mission_ack {
                        self.second_answer = Some(SecondAnswer { at: cx.now + SECOND_ACK, client, mission_type, id });
                    }
                }
                let client = client.address;
                self.record_end(FinishedUpload { client, mission_type, last_seq, result, id, last, at: cx.now });
                id
            }
            Change::Clear(_) => 0,
        };
        ReplyContent::of_result(result, id)
    }

    /// The same for a change that was being written.
    fn end_commit<F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        commit: &Commit,
        result: MavMissionResult,
    ) -> FinalAnswer {
        let content = self.end_change(cx, commit, result);
        FinalAnswer::new(commit.client, commit.change.mission_type(), content)
    }

    /// Records how an upload ended.
    pub(super) fn record_end(&mut self, finished: FinishedUpload) {
        let FinishedUpload { client, mission_type, last_seq, result, at, .. } = finished;
        if result == MavMissionResult::ACCEPTED {
            event!("{} upload by {}: accepted, the last item is {=u16}", mission_type, client, last_seq);
            increment(&mut self.counters.accepted);
        } else {
            if let Some(refused) = self.refused.count(at) {
                event!(
                    "{} upload by {}: {=u8} at item {=u16}; {=u32} refused so far",
                    mission_type,
                    client,
                    result.0,
                    last_seq,
                    refused
                );
            }
            increment(&mut self.counters.refused);
        }
        self.finished = Some(finished);
    }

    /// Returns the second final answer when it is due (M-31).
    pub(super) fn poll_second_answer(&mut self, now: Instant) -> Option<FinalAnswer> {
        self.second_answer.take_if(|second| now >= second.at).map(|second| second.answer())
    }

    /// Checks the distance of the first waypoint once the position is known, if it was not when the mission went live
    /// (M-48).
    pub(super) fn poll_distance<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) {
        if self.is_distance_unchecked
            && let Some(limit) = cx.vehicle.first_waypoint_limit()
        {
            self.is_distance_unchecked = false;
            let items = cx.plans.live(PlanType::Mission).items();
            if let Some(seq) = first_too_far(items, F::Vehicle::MISSION_COMMANDS, limit) {
                Problem::TooFar { seq, limit: limit.distance }.report(cx);
            }
        }
    }
}

/// Plans from the firmware or from storage, which are checked like an upload.
impl Missions {
    /// Loads a plan from the firmware. `items` returns the items in order. The plan goes live at once.
    pub(crate) fn load_plan<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        mut items: impl Iterator<Item = Item>,
    ) -> Result<(), PlanFault> {
        if self.committing().is_some() || self.is_receiving() || self.is_loading() {
            return Err(MavMissionResult::DENIED.into());
        }
        cx.plans.clear_staging();
        let mut digest = Digest::new();
        let staged = items.try_for_each(|item| {
            digest.add(&item);
            Self::stage_item(cx, plan, item)
        });
        let loaded = staged.and_then(|()| self.make_loaded(cx, plan, None, digest));
        cx.plans.clear_staging();
        loaded
    }

    /// Checks the next item of a plan that is loaded, and adds it to the staging area.
    pub(crate) fn stage_item<F: Firmware<Vehicle: Plans>>(
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        item: Item,
    ) -> Result<(), PlanFault> {
        check::stage_item(cx, plan, item).map_err(Problem::fault)
    }

    /// Checks the staged plan as a whole, and makes it live. A plan from storage has an `expected` count and id. One
    /// from the firmware is stored.
    pub(crate) fn make_loaded<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        expected: Option<(u16, u32)>,
        digest: Digest,
    ) -> Result<(), PlanFault> {
        let count = cx.plans.staged();
        let id = if count > 0 { digest.id() } else { 0 };
        if count > 0 {
            check_staged_plan(cx, plan).map_err(Problem::fault)?;
        }
        if expected.is_some_and(|expected| expected != (count, id)) {
            return Err(MavMissionResult::INVALID.into());
        }
        let is_new = !cx.plans.is_live(plan, id);
        if is_new {
            self.replace(cx, plan, id, 0);
            self.current.announce(cx.shared.normal);
        }
        // Damaged content is replaced, even if the live plan is the same.
        if expected.is_none() && (is_new || self.schedule.stored_differs) {
            self.request_save();
        }
        Ok(())
    }

    /// Whether stored plans are being loaded, in the staging area.
    pub(super) const fn is_loading(&self) -> bool {
        cfg!(any(feature = "storage", test)) && self.is_loading
    }
}

/// The state of storage.
impl Missions {
    /// Returns the change that is being written. Without the feature `storage` the compiler knows that there is none.
    pub(super) fn committing(&self) -> Option<&Commit> {
        match &self.transfer {
            Transfer::Commit(commit) if cfg!(any(feature = "storage", test)) => Some(commit),
            _ => None,
        }
    }

    /// The same, mutably.
    pub(super) fn committing_mut(&mut self) -> Option<&mut Commit> {
        match &mut self.transfer {
            Transfer::Commit(commit) if cfg!(any(feature = "storage", test)) => Some(commit),
            _ => None,
        }
    }

    /// Ends the commit, and returns it.
    fn take_commit(&mut self) -> Option<Commit> {
        let commit = self.committing()?.clone();
        self.transfer = Transfer::Idle;
        Some(commit)
    }

    const fn is_attached(&self) -> bool {
        self.schedule.is_attached()
    }

    /// Whether changes are stored before they are accepted.
    fn is_durable(&self) -> bool {
        self.is_attached() && self.durability == Durability::Durable
    }

    /// Requests a write of the live plans, if storage is attached.
    const fn request_save(&mut self) {
        if self.is_attached() {
            self.schedule.request();
        }
    }

    /// Whether storage holds the live plans, or is not attached.
    const fn is_saved(&self) -> bool {
        !self.is_attached() || !(self.schedule.is_dirty() || self.schedule.stored_differs)
    }

    /// Abandons the change that is being written if it takes too long.
    pub(super) fn poll_commit<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        if cx.now < self.commit_deadline() { None } else { self.on_save_failed(cx) }
    }

    /// When [`poll_commit`](Self::poll_commit) is due.
    pub(super) fn commit_deadline(&self) -> Instant {
        self.committing().map_or(Instant::NEVER, |commit| commit.since + TIMEOUT)
    }
}

/// The interface to storage.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the engine's own"))]
impl Missions {
    /// Reports by a text that a plan was not restored from storage.
    pub(crate) fn report_refused<F: Firmware>(cx: &mut Cx<'_, F>, plan: PlanType, fault: PlanFault) {
        Problem::Refused(plan, fault).report(cx);
    }

    /// Attaches storage.
    pub(crate) const fn attach_storage(&mut self, durability: Durability) {
        self.durability = durability;
        self.schedule.attach();
    }

    /// Sets the time in which the bucket regains one token (C-15).
    pub(crate) const fn set_refill(&mut self, refill: Duration) {
        self.schedule.bucket.set_refill(refill);
    }

    /// Records whether storage differs from the live plans, because it could not be read or cannot be flown. That alone
    /// causes no write. But a change that changes nothing in RAM is not reported as durable before it is written.
    pub(crate) const fn set_stored_differs(&mut self, differs: bool) {
        self.schedule.stored_differs = differs;
    }

    /// Begins to load stored plans in the staging area, or ends it. Meanwhile no upload may begin.
    pub(crate) fn set_loading(&mut self, plans: &mut PlansMut<'_>, is_loading: bool) {
        if self.is_loading || is_loading {
            plans.clear_staging();
        }
        self.is_loading = is_loading;
    }

    /// Requests a write of the live plans, because storage has others.
    pub(crate) const fn save_again(&mut self) {
        self.request_save();
    }

    /// Whether an upload uses the staging area.
    pub(crate) fn is_receiving(&self) -> bool {
        matches!(&self.transfer, Transfer::Upload(upload) if upload.is_exclusive())
    }

    /// Whether a client waits for storage.
    pub(crate) fn is_committing(&self) -> bool {
        self.committing().is_some()
    }

    /// Returns the number of the version to write now, if any. The same number means the same content. Writing pauses
    /// after a write or a failure, but never while a client waits for an answer.
    pub(crate) fn pending_write(&self, now: Instant) -> Option<u16> {
        let is_due = self.is_committing() || self.schedule.is_dirty() && !self.schedule.is_resting(now);
        is_due.then_some(self.schedule.version())
    }

    /// Returns the content to write: the three plans.
    pub(crate) fn content<'a>(&self, plans: &'a PlansMut<'_>) -> [PlanView<'a>; 3] {
        PlanType::ALL.map(|plan| match self.committing() {
            Some(Commit { change, .. }) if change.affects(plan) => match change {
                Change::Upload { id, .. } => plans.staged_as(*id),
                Change::Clear(_) => PlanView::EMPTY,
            },
            _ => plans.live(plan),
        })
    }

    /// Returns the first plan of the commit that the vehicle no longer permits to change, and its refusal.
    fn find_refusal<F: Firmware<Vehicle: Plans>>(cx: &mut Cx<'_, F>, commit: &Commit) -> Option<Problem> {
        let Commit { client, change, .. } = commit;
        let (vehicle, mut context) = cx.hook();
        PlanType::ALL.into_iter().find_map(|plan| {
            let is_upload = matches!(change, Change::Upload { .. });
            if !change.affects(plan) || !is_upload && context.plans.count(plan) == 0 {
                return None;
            }
            let result = vehicle.may_change(&mut context, plan, *client).err()?;
            Some(Problem::Refused(plan, result.into()))
        })
    }

    /// Handles a completed write of [`content`](Self::content): the change goes live. Returns the answer.
    pub(crate) fn on_saved<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        self.schedule.on_saved(cx.now, GRACE);
        let commit = self.take_commit()?;
        let result = match Self::find_refusal(cx, &commit) {
            None => {
                self.make_live(cx, &commit.change);
                MavMissionResult::ACCEPTED
            }
            Some(problem) => {
                // The vehicle now refuses the change, for example because it armed. The old plan stays live and is
                // written again (M-45).
                problem.report(cx);
                self.request_save();
                problem.fault().result
            }
        };
        Some(self.end_commit(cx, &commit, result))
    }

    /// Ends the change that is being written if the vehicle no longer permits it (M-45). Called before each step of
    /// writing, so that the record is never completed, and the part that was written does not count. Returns the
    /// answer.
    pub(crate) fn refuse_commit<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        let problem = Self::find_refusal(cx, self.committing()?)?;
        let commit = self.take_commit()?;
        self.schedule.restart();
        problem.report(cx);
        Some(self.end_commit(cx, &commit, problem.fault().result))
    }

    /// Handles a failed write or erase. A durable change ends with ERROR; a write of live plans is retried later.
    /// Returns the answer.
    pub(crate) fn on_save_failed<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        increment(&mut self.counters.not_saved);
        let is_new = self.schedule.note_failure();
        let Some(commit) = self.take_commit() else {
            self.schedule.pause(cx.now);
            if is_new {
                Problem::StorageFailed.report(cx);
            }
            return None;
        };
        self.schedule.restart();
        event!("plans: change by {}: write failed", commit.client);
        let problem = match commit.change {
            Change::Upload { plan, .. } => Problem::NotStored(plan),
            Change::Clear(only) => Problem::NotCleared(only),
        };
        problem.report(cx);
        Some(self.end_commit(cx, &commit, MavMissionResult::ERROR))
    }
}

/// Returns the cost of a write of `count` items: a token for each quarter of plan memory, at least one (C-15).
fn tokens(plans: &PlansMut<'_>, count: u16) -> u8 {
    let capacities = PlanType::ALL.into_iter().map(|plan| u32::from(plans.capacity(plan)));
    let capacity = capacities.fold(0, u32::saturating_add);
    let is_more_than = |quarters| Wrapping(u32::from(count)) * Wrapping(4) > Wrapping(capacity) * Wrapping(quarters);
    match () {
        () if is_more_than(3) => 4,
        () if is_more_than(2) => 3,
        () if is_more_than(1) => 2,
        () => 1,
    }
}
