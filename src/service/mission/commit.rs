//! Makes a complete new plan live, after storing it if storage is attached (M-39, M-44, M-52, M-83, SEC-11).
//!
//! [`Durability`] has a diagram of the variants.
//!
//! [`content`](Missions::content) returns the content to write. The result is reported to
//! [`on_saved`](Missions::on_saved) or [`on_save_failed`](Missions::on_save_failed). Until then no other upload may begin, because the staging
//! area holds the plan that is being written.

use super::distance::first_too_far;
use super::number::Number;
use super::replies::Reply;
use super::upload::{Done, Upload};
use super::validate::{self, Problem};
use super::{Cx, Missions, PlanChange, PlanFault, Plans, Replies, increment};
use crate::dialect::{MavMissionResult, MavMissionType};
use crate::message::{Address, Digest, Item};
use crate::time::{Duration, Instant};
use crate::types::{Durability, Firmware, LinkId, Peer, PlanType, PlanView, PlansMut, Vehicle};

/// A change that is not durable after this time is abandoned.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Wait after a successful write before flash is erased ahead, so that the answer is sent first.
const GRACE: Duration = Duration::from_millis(200);

/// Time from the final answer of an upload to the second one, if that is configured: within QGroundControl's timeout of 1.5 s
/// (M-31).
const SECOND_ACK: Duration = Duration::from_millis(400);

/// A durable change that is being written.
#[derive(Clone, Debug)]
pub(super) struct Commit {
    /// The client that waits for the result, and its link.
    pub(super) client: Peer,
    change: Change,
    since: Instant,
}

/// A change of the live plans.
#[derive(Clone, Copy, Debug)]
pub(super) enum Change {
    /// The staging area becomes this plan.
    Upload {
        plan: PlanType,
        /// The last item.
        seq: u16,
        /// The item to start from.
        first: u16,
        id: u32,
        /// The sequence number of the last item's frame.
        last: Number,
    },
    /// This plan is cleared, or all plans are.
    Clear(Option<PlanType>),
}

impl Commit {
    /// All zero bits, also as `Some`; `None` is not.
    pub(super) const VACANT: Self = Self {
        client: Peer { address: Address::new(0, 0), link: LinkId(0) },
        change: Change::Upload { plan: PlanType::Mission, seq: 0, first: 0, id: 0, last: Number(LinkId(0), 0) },
        since: Instant::ZERO,
    };

    /// Whether `from` is the client that waits. If so, the result is sent on its current link, provided that the result slot
    /// there is free (M-11).
    pub(super) fn is_by(&mut self, from: Peer, replies: &Replies) -> bool {
        let is_by = self.client.address == from.address;
        if is_by && !replies.has_result() {
            self.client.link = from.link;
        }
        is_by
    }

    /// Whether a COUNT for `plan` with this sequence number was sent before the last item of the plan that is being written.
    pub(super) fn is_older(&self, plan: PlanType, number: u8) -> bool {
        matches!(self.change, Change::Upload { plan: own, last, .. } if own == plan && last.1.wrapping_sub(number) <= 127)
    }

    /// Whether it clears `only` this plan, or all.
    pub(super) fn clears(&self, only: Option<PlanType>) -> bool {
        matches!(self.change, Change::Clear(own) if own == only)
    }
}

impl Missions {
    /// Returns the change that is being written. Without the feature `storage` the compiler knows that there is none.
    pub(super) fn committing(&self) -> Option<&Commit> {
        if cfg!(any(feature = "storage", test)) { self.commit.as_ref() } else { None }
    }

    /// The same, mutably.
    pub(super) fn committing_mut(&mut self) -> Option<&mut Commit> {
        if cfg!(any(feature = "storage", test)) { self.commit.as_mut() } else { None }
    }

    const fn is_attached(&self) -> bool {
        self.schedule.is_attached()
    }

    /// Whether changes are stored before they are accepted.
    pub(super) fn is_durable(&self) -> bool {
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

    /// Whether the token bucket permits another change to `count` items (C-15).
    pub(super) fn has_tokens(&self, now: Instant, plans: &PlansMut<'_>, count: u16) -> bool {
        !self.is_attached() || self.schedule.bucket.has(now, tokens(plans, count))
    }

    /// Whether a clear would change nothing, in RAM or in storage (M-52).
    pub(super) fn is_clear(&self, plans: &PlansMut<'_>, only: Option<PlanType>) -> bool {
        let is_empty = |plan| only.is_some_and(|only| only != plan) || plans.count(plan) == 0;
        PlanType::ALL.into_iter().all(is_empty) && self.is_saved()
    }

    /// Whether `change` would change nothing, in RAM or in storage.
    pub(super) fn changes_nothing(&self, plans: &PlansMut<'_>, change: Change) -> bool {
        match change {
            // M-39, SEC-11: even while the plan is being flown, and without wearing the flash.
            Change::Upload { plan, id, .. } => plans.is_live(plan, id) && self.is_saved(),
            Change::Clear(only) => self.is_clear(plans, only),
        }
    }

    /// Checks whether the vehicle permits a change, and the write that a durable change needs unless it
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

    /// Makes `change` live, or starts to write it first. Returns the answer if it is known at once.
    pub(super) fn change<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        change: Change,
    ) -> Option<Reply> {
        let changes_nothing = self.changes_nothing(&cx.plans, change);
        let commit = Commit { client: from, change, since: cx.now };
        if self.is_attached() && !changes_nothing {
            let tokens = tokens(&cx.plans, cx.plans.staged());
            self.schedule.bucket.spend(cx.now, tokens);
        }
        if self.is_durable() && !changes_nothing {
            event!("plans: change by {}: writing", from);
            self.schedule.restart();
            self.commit = Some(commit);
            self.heard_at = cx.now;
            return None;
        }
        if !changes_nothing {
            self.make_live(cx, change);
            self.request_save();
        }
        Some(self.end_change(cx, &commit, MavMissionResult::ACCEPTED))
    }

    /// Makes `change` live in one step.
    fn make_live<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, change: Change) {
        match change {
            // Live already; only storage lacked it.
            Change::Upload { plan, id, .. } if cx.plans.is_live(plan, id) => {}
            Change::Upload { plan, id, first, .. } => self.replace(cx, plan, id, first),
            Change::Clear(only) => {
                cx.plans.clear_staging();
                for plan in PlanType::ALL {
                    if only.is_none_or(|only| only == plan) && cx.plans.count(plan) > 0 {
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
            self.is_unchecked = cx.vehicle.first_waypoint_limit().is_none();
        }
        let (vehicle, mut context) = cx.hook();
        let items = context.plan(plan).items();
        vehicle.plan_changed(&mut context, PlanChange { plan, items, first });
    }

    /// Checks the distance of the first waypoint once the position is known, if it was not when the mission went live (M-48).
    pub(super) fn poll_distance<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) {
        if self.is_unchecked
            && let Some((from, limit)) = cx.vehicle.first_waypoint_limit()
        {
            self.is_unchecked = false;
            let items = cx.plans.live(PlanType::Mission).items();
            if let Some(seq) = first_too_far(items, F::Vehicle::MISSION_COMMANDS, from, limit) {
                Problem::TooFar(seq, limit).report(cx);
            }
        }
    }

    /// Ends a change with this result. Returns the answer to its client.
    fn end_change<F: Firmware>(&mut self, cx: &mut Cx<'_, F>, commit: &Commit, result: MavMissionResult) -> Reply {
        let &Commit { client, change, .. } = commit;
        self.current.announce(cx.shared.normal);
        let (mission_type, id) = match change {
            Change::Upload { plan, seq, id, last, .. } => {
                let id = if result == MavMissionResult::ACCEPTED { id } else { 0 };
                if id != 0 {
                    self.sessions.renew(cx.now, client, plan);
                }
                self.record_end(Done { client: client.address, plan, seq, result, id, last, at: cx.now });
                (plan.mission_type(), id)
            }
            Change::Clear(only) => (only.map_or(MavMissionType::ALL, PlanType::mission_type), 0),
        };
        cx.plans.clear_staging();
        let reply = Reply::of_result(client.address, mission_type, result, id);
        if cx.shared.config.second_mission_ack && id != 0 {
            self.second_answer = Some((cx.now + SECOND_ACK, client.link, reply));
        }
        reply
    }

    /// Returns the second final answer when it is due (M-31).
    pub(super) fn poll_second_answer(&mut self, now: Instant) -> Option<(LinkId, Reply)> {
        self.second_answer.take_if(|(at, ..)| now >= *at).map(|(_, link, reply)| (link, reply))
    }

    /// Loads a plan from the firmware. `item` returns the items in order. The plan is checked like an upload, and goes live at once.
    pub(crate) fn load_plan<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        items: impl Iterator<Item = Item>,
    ) -> Result<(), PlanFault> {
        if self.committing().is_some() || self.is_receiving() || self.is_loading() {
            return Err(MavMissionResult::DENIED.into());
        }
        cx.plans.clear_staging();
        let mut digest = Digest::new();
        let mut items = items;
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
        let seq = cx.plans.staged();
        if seq >= cx.plans.capacity(plan) {
            return Err(MavMissionResult::NO_SPACE.into());
        }
        let (vehicle, mut context) = cx.hook();
        validate::check_item(plan, F::Vehicle::MISSION_COMMANDS, &item, F::Vehicle::HAS_TERRAIN_MODEL)
            .and_then(|()| vehicle.check_item(&mut context, plan, seq, &item))
            .map_err(|result| PlanFault { seq: Some(seq), result })?;
        cx.plans.stage(item);
        Ok(())
    }

    /// Checks the staged plan as a whole, and makes it live. A plan from storage has an `expected` count and id; one from the
    /// firmware is stored.
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
            check_plan(cx, plan).map_err(|problem| problem.fault())?;
        }
        if expected.is_some_and(|expected| expected != (count, id)) {
            return Err(MavMissionResult::INVALID.into());
        }
        let is_new = !cx.plans.is_live(plan, id);
        if is_new {
            self.replace(cx, plan, id, 0);
            self.current.announce(cx.shared.normal);
        }
        // Damaged content is replaced even by what is live.
        if expected.is_none() && (is_new || self.schedule.stored_differs) {
            self.request_save();
        }
        Ok(())
    }

    /// Abandons the change that is being written if it takes too long.
    pub(super) fn poll_commit<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<(LinkId, Reply)> {
        let commit = self.committing()?;
        if cx.now - commit.since < TIMEOUT { None } else { self.on_save_failed(cx) }
    }

    /// When [`poll_commit`](Self::poll_commit) is due.
    pub(super) fn commit_deadline(&self) -> Instant {
        self.committing().map_or(Instant::NEVER, |commit| commit.since + TIMEOUT)
    }
}

/// Returns the first plan of `commit` that the vehicle no longer permits to change, and its refusal.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the engine's own"))]
fn refusal<F: Firmware<Vehicle: Plans>>(cx: &mut Cx<'_, F>, commit: &Commit) -> Option<(PlanType, MavMissionResult)> {
    let (vehicle, mut context) = cx.hook();
    PlanType::ALL.into_iter().find_map(|plan| {
        let is_affected = match commit.change {
            Change::Upload { plan: only, .. } => only == plan,
            Change::Clear(only) => only.is_none_or(|only| only == plan) && context.plans.count(plan) > 0,
        };
        let result = if is_affected { vehicle.may_change(&mut context, plan, commit.client) } else { Ok(()) };
        result.err().map(|result| (plan, result))
    })
}

/// Checks the staged plan as a whole: first the rules for all vehicles, then the vehicle's own.
pub(super) fn check_plan<F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    plan: PlanType,
) -> Result<(), Problem<'static>> {
    check_rules(cx.plans.staged_items(), cx.vehicle, plan)?;
    ask_vehicle(cx, plan).map_err(|fault| Problem::Refused(plan, fault))
}

/// Checks the rules for all vehicles.
fn check_rules<V: Plans>(items: &[Item], vehicle: &V, plan: PlanType) -> Result<(), Problem<'static>> {
    validate::check_plan(plan, items).map_err(|fault| Problem::Refused(plan, fault))?;
    if plan == PlanType::Mission
        && let Some((from, limit)) = vehicle.first_waypoint_limit()
        && let Some(seq) = first_too_far(items, V::MISSION_COMMANDS, from, limit)
    {
        return Err(Problem::TooFar(seq, limit));
    }
    Ok(())
}

/// Checks the vehicle's own rules.
fn ask_vehicle<F: Firmware<Vehicle: Plans>>(cx: &mut Cx<'_, F>, plan: PlanType) -> Result<(), PlanFault> {
    let (vehicle, mut context) = cx.hook();
    let items = context.plans.staged_items();
    vehicle.check_plan(&mut context, plan, items)
}

/// Returns the cost of a write of `count` items: a token for each quarter of plan memory, at least one (C-15).
fn tokens(plans: &PlansMut<'_>, count: u16) -> u8 {
    let total = PlanType::ALL.into_iter().fold(0u32, |sum, plan| sum.wrapping_add(plans.capacity(plan).into()));
    let quarters = u32::from(count).wrapping_mul(4).saturating_sub(1).checked_div(total).unwrap_or(0);
    let [quarters, ..] = quarters.min(3).to_le_bytes();
    quarters.wrapping_add(1)
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

    /// Records whether storage differs from the live plans, because it could not be read or cannot be flown. That alone causes no
    /// write. But a change that changes nothing in RAM is not reported as durable before it is written.
    pub(crate) const fn set_stored_differs(&mut self, differs: bool) {
        self.schedule.stored_differs = differs;
    }

    /// Whether stored plans are being loaded, in the staging area.
    pub(super) const fn is_loading(&self) -> bool {
        cfg!(any(feature = "storage", test)) && self.is_loading
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
        self.upload.as_ref().is_some_and(Upload::is_exclusive)
    }

    /// Whether a client waits for storage.
    pub(crate) const fn is_committing(&self) -> bool {
        self.commit.is_some()
    }

    /// Returns the number of the version to write now, if any. The same number means the same content. Writing pauses after a
    /// write or a failure, but never while a client waits for an answer.
    pub(crate) fn pending_write(&self, now: Instant) -> Option<u16> {
        let is_due = self.is_committing() || self.schedule.is_dirty() && !self.schedule.is_resting(now);
        is_due.then_some(self.schedule.version())
    }

    /// Returns the content to write: the three plans.
    pub(crate) fn content<'a>(&self, plans: &'a PlansMut<'_>) -> [PlanView<'a>; 3] {
        let change = self.commit.as_ref().map(|commit| commit.change);
        let view = |plan| match change {
            Some(Change::Upload { plan: new, id, .. }) if new == plan => plans.staged_as(id),
            Some(Change::Clear(only)) if only.is_none_or(|only| only == plan) => PlanView::EMPTY,
            _ => plans.live(plan),
        };
        PlanType::ALL.map(view)
    }

    /// Handles a completed write of [`content`](Self::content): the change goes live. Returns the answer and its link.
    pub(crate) fn on_saved<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) -> Option<(LinkId, Reply)> {
        self.schedule.on_saved(cx.now, GRACE);
        let commit = self.commit.take()?;
        let result = match refusal(cx, &commit) {
            None => {
                self.make_live(cx, commit.change);
                MavMissionResult::ACCEPTED
            }
            Some((plan, result)) => {
                // The vehicle now refuses the change, for example because it armed. The old plan stays live and is written
                // again (M-45).
                Problem::Refused(plan, result.into()).report(cx);
                self.request_save();
                result
            }
        };
        Some((commit.client.link, self.end_change(cx, &commit, result)))
    }

    /// Ends the change that is being written if the vehicle no longer permits it (M-45). Called before each step of writing, so
    /// that the record is never completed, and the part that was written does not count. Returns the answer and its link.
    pub(crate) fn refuse_commit<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) -> Option<(LinkId, Reply)> {
        let (plan, result) = refusal(cx, self.commit.as_ref()?)?;
        let commit = self.commit.take()?;
        self.schedule.restart();
        Problem::Refused(plan, result.into()).report(cx);
        Some((commit.client.link, self.end_change(cx, &commit, result)))
    }

    /// Handles a failed write or erase. A durable change ends with ERROR; a write of live plans is retried later. Returns the
    /// answer and its link.
    pub(crate) fn on_save_failed<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<(LinkId, Reply)> {
        increment(&mut self.counters.not_saved);
        let is_new = self.schedule.has_newly_failed();
        let Some(commit) = self.commit.take() else {
            self.schedule.pause(cx.now);
            if is_new {
                Problem::NotSaved(None).report(cx);
            }
            return None;
        };
        self.schedule.restart();
        event!("plans: change by {}: write failed", commit.client);
        Problem::NotSaved(Some(&commit.change)).report(cx);
        Some((commit.client.link, self.end_change(cx, &commit, MavMissionResult::ERROR)))
    }
}
