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
use crate::types::{Durability, Firmware, Peer, PlanType, PlanView, PlansMut, Sender, Vehicle};

/// A change that is not durable after this time is abandoned.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Wait after a successful write before flash is erased ahead, so that the answer is sent first.
const GRACE: Duration = Duration::from_millis(200);

/// Time from the final answer of an upload to the second one, if that is configured: within QGroundControl's timeout of
/// 1.5 s (M-31).
const SECOND_ACK: Duration = Duration::from_millis(400);

/// Whether a durable change must be written.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum StorageWrite {
    Needed,
    /// Storage has the content already.
    NotNeeded,
}

/// Admission: the checks before a change.
impl Missions {
    /// Asks the vehicle for permission to change a plan. A durable change also needs permission to write, unless it
    /// [is stored already](Self::changes_nothing) (M-44).
    ///
    /// # Errors
    ///
    /// The result with which the vehicle refuses the change, or DENIED if it does not permit the write.
    pub(super) fn permission<F: Firmware<Vehicle: Plans>>(
        &self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        from: Peer,
        write: StorageWrite,
    ) -> Result<(), MavMissionResult> {
        // Another system may have taken control.
        if !cx.shared.may_change::<F>(from.address.system) {
            return Err(MavMissionResult::DENIED);
        }
        let (vehicle, mut context) = cx.hook();
        if self.is_durable() && write == StorageWrite::Needed && !vehicle.may_persist() {
            return Err(MavMissionResult::DENIED);
        }
        vehicle.may_change(&mut context, plan, from)
    }

    /// Asks for [permission](Self::permission) for a change that must be written, and reports a refusal (M-27).
    pub(super) fn ask_permission<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        from: Peer,
    ) -> Result<(), MavMissionResult> {
        let permission = self.permission(cx, plan, from, StorageWrite::Needed);
        if let Err(result) = permission {
            if let Some(refused) = self.refused.count(cx.now) {
                event!("{} change by {}: {=u8} by the vehicle; {=u32} refused so far", plan, from, result.0, refused);
            }
            Problem::Refused(plan, result.into()).report(cx);
        }
        permission
    }

    /// Checks whether the token bucket has enough tokens to write a plan of `count` items. It is not spent yet.
    ///
    /// # Errors
    ///
    /// DENIED if peers have caused too many writes (C-15). The refusal is reported.
    pub(super) fn check_write_rate<F: Firmware>(
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

    /// Whether the link with these `replies` has a slot for the result of a change. Only the result of a durable change
    /// needs one: other changes are answered at once.
    pub(super) fn has_result_slot(&self, replies: &Replies) -> bool {
        !self.is_durable() || !replies.has_result()
    }

    /// Whether `plan` is clear, in RAM and in storage, or all plans are if it is `None`.
    pub(super) fn is_already_clear(&self, plans: &PlansMut<'_>, plan: Option<PlanType>) -> bool {
        let clear = Change::Clear(plan);
        let has_items = PlanType::ALL.into_iter().any(|plan| clear.affects(plan) && plans.count(plan) > 0);
        !has_items && self.is_saved()
    }

    /// Whether `change` would change nothing, in RAM or in storage. Such a change does not wear the flash (SEC-11).
    pub(super) fn changes_nothing(&self, plans: &PlansMut<'_>, change: &Change) -> bool {
        match *change {
            // An equal plan is accepted even while it is being flown (M-39).
            Change::Upload { plan, id, .. } => plans.is_live(plan, id) && self.is_saved(),
            Change::Clear(plan) => self.is_already_clear(plans, plan),
        }
    }
}

/// The change itself.
impl Missions {
    /// Starts an admitted change. A durable change is written first, and answered when the write ends. Any other change
    /// goes live and is answered at once.
    pub(super) fn start_change<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        change: Change,
    ) {
        let commit = Commit { client: client.peer, trust: client.trust, change, since: cx.now };
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
            // The plan is live already; only storage lacked it.
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
        let &Commit { client, trust, change, .. } = commit;
        self.current.announce(cx.shared.normal);
        cx.plans.clear_staging();
        let id = match change {
            Change::Upload { plan, id, last_seq, last, .. } => {
                let mission_type = change.mission_type();
                let id = if result == MavMissionResult::ACCEPTED { id } else { 0 };
                if id != 0 {
                    self.sessions.renew(cx.now, Sender { peer: client, trust }, plan);
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

    /// Ends a change that was being written, like [`end_change`](Self::end_change). Returns the answer and its link.
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

    /// Takes the second final answer if it is due (M-31).
    pub(super) fn poll_second_answer(&mut self, now: Instant) -> Option<FinalAnswer> {
        let second = self.second_answer.as_ref().filter(|second| now >= second.at)?;
        let answer = second.answer();
        self.second_answer = None;
        Some(answer)
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
    ///
    /// # Errors
    ///
    /// The faulty item and the result for it; DENIED while another transfer uses the staging area.
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

    /// Checks the staged plan as a whole, and makes it live. `expected` is the count and the id of a plan from storage.
    /// A plan from the firmware has none, and is stored.
    ///
    /// # Errors
    ///
    /// The fault of the plan; INVALID if it is not the expected one.
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
        let is_from_firmware = expected.is_none();
        // Damaged content in storage is replaced, even if the live plan is the same.
        if is_from_firmware && (is_new || self.schedule.stored_differs) {
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
        let is_outdated = self.schedule.is_dirty() || self.schedule.stored_differs;
        !self.is_attached() || !is_outdated
    }

    /// Abandons the change that is being written if it takes too long. Returns the answer to its client; `None` if
    /// there is no such change, or it still has time.
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

    /// Records whether storage differs from the live plans, because it could not be read or its plans cannot be flown.
    /// The difference alone causes no write. But a change that changes nothing in RAM is then written before it is
    /// accepted.
    pub(crate) const fn set_stored_differs(&mut self, differs: bool) {
        self.schedule.stored_differs = differs;
    }

    /// Reserves the staging area for stored plans. Until [`end_loading`](Self::end_loading) no upload may begin.
    pub(crate) fn begin_loading(&mut self, plans: &mut PlansMut<'_>) {
        plans.clear_staging();
        self.is_loading = true;
    }

    /// Frees the staging area after stored plans were loaded in it.
    pub(crate) fn end_loading(&mut self, plans: &mut PlansMut<'_>) {
        if self.is_loading {
            plans.clear_staging();
        }
        self.is_loading = false;
    }

    /// Requests a write of the live plans, because storage has others.
    pub(crate) const fn save_again(&mut self) {
        self.request_save();
    }

    /// Whether a confirmed upload uses the staging area.
    pub(crate) fn is_receiving(&self) -> bool {
        matches!(&self.transfer, Transfer::Upload(upload) if upload.is_confirmed)
    }

    /// Whether a client waits for storage.
    pub(crate) fn is_committing(&self) -> bool {
        self.committing().is_some()
    }

    /// Returns the version to write now; `None` if no write is due. The same version means the same content.
    pub(crate) fn pending_write(&self, now: Instant) -> Option<u16> {
        // Writing pauses after a write or a failure, but never while a client waits for an answer.
        let is_live_plan_due = self.schedule.is_dirty() && !self.schedule.is_resting(now);
        let is_due = self.is_committing() || is_live_plan_due;
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

    /// Asks the vehicle again whether each plan of the commit may change. Returns the first refusal; `None` if all are
    /// permitted.
    fn find_refusal<F: Firmware<Vehicle: Plans>>(cx: &mut Cx<'_, F>, commit: &Commit) -> Option<Problem> {
        let Commit { client, change, .. } = commit;
        // Another system may have taken control.
        let is_in_control = cx.shared.may_change::<F>(client.address.system);
        let (vehicle, mut context) = cx.hook();
        PlanType::ALL.into_iter().find_map(|plan| {
            // A clear changes only the plans that have items.
            let is_clear = matches!(change, Change::Clear(_));
            let is_unchanged = is_clear && context.plans.count(plan) == 0;
            if !change.affects(plan) || is_unchanged {
                return None;
            }
            let permission = match is_in_control {
                true => vehicle.may_change(&mut context, plan, *client),
                false => Err(MavMissionResult::DENIED),
            };
            let result = permission.err()?;
            Some(Problem::Refused(plan, result.into()))
        })
    }

    /// Handles a completed write of [`content`](Self::content). The change goes live, unless the vehicle now refuses
    /// it. Returns the answer to the change's client; `None` if the live plans were written.
    pub(crate) fn on_saved<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        self.schedule.on_saved(cx.now, GRACE);
        let commit = self.take_commit()?;
        let result = match Self::find_refusal(cx, &commit) {
            None => {
                self.make_live(cx, &commit.change);
                MavMissionResult::ACCEPTED
            }
            Some(problem) => {
                // The vehicle may have armed. The old plan stays live and is written again.
                problem.report(cx);
                self.request_save();
                problem.fault().result
            }
        };
        Some(self.end_commit(cx, &commit, result))
    }

    /// Ends the change that is being written if the vehicle no longer permits it (M-45). Called before each step of
    /// writing, so that the record is never completed, and the part that was written does not count. Returns the answer
    /// to the change's client; `None` if the write continues, or if there is none.
    pub(crate) fn refuse_commit<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        let problem = Self::find_refusal(cx, self.committing()?)?;
        let commit = self.take_commit()?;
        self.schedule.restart();
        problem.report(cx);
        Some(self.end_commit(cx, &commit, problem.fault().result))
    }

    /// Handles a failed write or erase. A durable change ends with ERROR. Returns the answer to its client; `None` for
    /// a write of the live plans, which is retried later.
    pub(crate) fn on_save_failed<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        increment(&mut self.counters.not_saved);
        let is_first_failure = self.schedule.note_failure();
        let Some(commit) = self.take_commit() else {
            self.schedule.pause(cx.now);
            if is_first_failure {
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
    let capacity = Wrapping(capacities.fold(0, u32::saturating_add));
    let quadruple = Wrapping(u32::from(count)) * Wrapping(4);
    if quadruple > capacity * Wrapping(3) {
        4
    } else if quadruple > capacity * Wrapping(2) {
        3
    } else if quadruple > capacity {
        2
    } else {
        1
    }
}
