//! From a whole new plan to the live one, through storage where there is one (M-39, M-44, M-52, SEC-11).
//!
//! The ways there are drawn at [`Durability`].
//!
//! What is to be written is asked for by [`unsaved`](Missions::unsaved), what became of it is told to
//! [`saved`](Missions::saved) and [`not_saved`](Missions::not_saved); between them nobody else's upload may begin, because
//! the staging area holds what is being written.

use super::distance::first_too_far;
use super::item::{Digest, Item};
use super::memory::{PlanType, PlanView, PlansMut};
use super::number::Number;
use super::replies::{Reply, What};
use super::upload::{Done, Upload};
use super::validate::{self, Trouble};
use super::{Caller, Context, Missions};
use crate::dialect::{MavMissionResult, MavMissionType};
use crate::link::{LinkId, Peer};
use crate::service::wear::Wear;
use crate::time::{Duration, Instant};
use crate::vehicle::{PlanChange, PlanFault, Plans};

/// When an upload or a clear that the vehicle has accepted is answered, where there is storage (M-44).
///
/// ```text
///                        ┌─ Durable:  committing ── written and read back ──▶ live, ACK ACCEPTED
///   last item, or clear ─┤                 └─────── not written, refused ───▶ old plan stays, ACK ERROR, DENIED
///                        ├─ Deferred: live, ACK ACCEPTED; written when the vehicle permits
///                        └─ no storage: live, ACK ACCEPTED
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Durability {
    /// ACCEPTED means that it survives a power cut: the plan is written first, and goes live then. While
    /// [`may_persist`](Plans::may_persist) says no, as by default while armed, changes are DENIED at their beginning, and uploads at
    /// their last item too.
    Durable,
    /// It goes live and is answered at once, and is written when the vehicle permits. When that fails a text says so.
    Deferred,
}

/// A plan that could not be made durable for so long is given up.
const PATIENCE: Duration = Duration::from_secs(5);

/// So long after a failure it is tried again to write what is live already.
const RETRY: Duration = Duration::from_secs(10);

/// So long after a change is stored nothing is erased ahead: its answer goes out first.
const GRACE: Duration = Duration::from_millis(200);

/// So long after the final answer of an upload it is sent once more, where that is wanted: within QGroundControl's
/// patience of 1.5 s (M-31).
const SECOND_ACK: Duration = Duration::from_millis(400);

/// A change that is to be durable before it is live.
#[derive(Clone, Debug)]
pub(super) struct Commit {
    /// Who is told.
    pub(super) to: Peer,
    /// As the request named it: may be ALL.
    mission_type: MavMissionType,
    change: Change,
    since: Instant,
}

/// What is to become live.
#[derive(Clone, Copy, Debug)]
pub(super) enum Change {
    /// The staging area becomes this plan.
    Upload {
        plan: PlanType,
        /// The last item.
        seq: u16,
        first: u16,
        id: u32,
        last: Number,
    },
    /// This plan becomes empty, or all do.
    Clear(Option<PlanType>),
}

impl Commit {
    /// Whether `caller` is who waits. Where he was heard last he will be answered, if that link can owe it (M-11).
    pub(super) fn is_by(&mut self, caller: &Caller<'_>) -> bool {
        let is_by = self.to.address == caller.from.address;
        if is_by && !caller.replies.owes_result() {
            self.to.link = caller.from.link;
        }
        is_by
    }

    /// Whether a COUNT for `plan` with this sequence number was sent before the last item of the plan that is being
    /// written.
    pub(super) fn is_older(&self, plan: PlanType, number: u8) -> bool {
        matches!(self.change, Change::Upload { plan: own, last, .. } if own == plan && last.1.wrapping_sub(number) <= 127)
    }

    /// Whether it clears what a MISSION_CLEAR_ALL with this type does.
    pub(super) fn clears(&self, mission_type: MavMissionType) -> bool {
        matches!(self.change, Change::Clear(_)) && self.mission_type == mission_type
    }
}

/// What is on the storage, compared with what is live.
#[derive(Clone, Debug)]
pub(super) struct Saving {
    policy: Option<Durability>,
    /// Counts what is to be written: another number is another content.
    job: u32,
    /// What is live is to be written, though nobody waits for it.
    owed: bool,
    /// Something else than what is live may be stored: it could not be read, or cannot be flown. It stays there until there
    /// is something to be written; but nobody is told that his change, which changes nothing here, is durable.
    differs: bool,
    /// Not before: the last attempt failed, or an answer is on its way that an erase would hold up.
    rests_until: Instant,
    /// Whether it was said that the last attempt failed.
    told: bool,
    wear: Wear,
}

impl Saving {
    pub(super) const fn new() -> Self {
        Self {
            policy: None,
            job: 0,
            owed: false,
            differs: false,
            rests_until: Instant::ZERO,
            told: false,
            wear: Wear::NONE,
        }
    }

    /// Something else is to be written from now on.
    fn next_job(&mut self) {
        self.job = self.job.wrapping_add(1);
    }
}

impl Missions {
    /// What waits for storage. Without the feature nothing can, and the compiler knows.
    pub(super) fn committing(&self) -> Option<&Commit> {
        if cfg!(any(feature = "storage", test)) { self.commit.as_ref() } else { None }
    }

    /// The same, for whoever talks about it.
    pub(super) fn committing_mut(&mut self) -> Option<&mut Commit> {
        if cfg!(any(feature = "storage", test)) { self.commit.as_mut() } else { None }
    }

    /// What is asked of the storage, when there is one.
    fn policy(&self) -> Option<Durability> {
        if cfg!(any(feature = "storage", test)) { self.saving.policy } else { None }
    }

    /// Whether ACCEPTED waits for storage.
    pub(super) fn is_durable(&self) -> bool {
        self.policy() == Some(Durability::Durable)
    }

    /// Something live is to be written, sooner or later.
    fn want_saved(&mut self) {
        if self.policy().is_some() {
            self.saving.owed = true;
            self.saving.next_job();
        }
    }

    /// Whether all that is live is stored too, or there is no storage.
    fn is_saved(&self) -> bool {
        self.policy().is_none() || !(self.saving.owed || self.saving.differs)
    }

    /// Whether the token bucket permits another change to `count` items (C-15).
    pub(super) fn bears(&self, cx: &Context<'_, '_>, count: u16) -> bool {
        self.policy().is_none() || self.saving.wear.has(cx.now, tokens(cx, count))
    }

    /// Whether a clear would clear nothing, here or on the storage (M-52).
    pub(super) fn is_clear(&self, cx: &Context<'_, '_>, only: Option<PlanType>) -> bool {
        let is_empty = |plan| only.is_some_and(|only| only != plan) || cx.plans.count(plan) == 0;
        PlanType::ALL.into_iter().all(is_empty) && self.is_saved()
    }

    /// Whether all that `change` would do is done, here and on the storage.
    pub(super) fn changes_nothing(&self, cx: &Context<'_, '_>, change: Change) -> bool {
        match change {
            // M-39, SEC-11: also when it is being flown, and the storage is not worn by it.
            Change::Upload { plan, id, .. } => cx.plans.is_live(plan, id) && self.is_saved(),
            Change::Clear(only) => self.is_clear(cx, only),
        }
    }

    /// Whether storage may be written, where that must be and is not [done](Self::changes_nothing), and the vehicle agrees (M-27,
    /// M-44).
    pub(super) fn permission<V: Plans>(
        &self,
        vehicle: &mut V,
        plan: PlanType,
        from: Peer,
        is_stored: bool,
    ) -> Result<(), MavMissionResult> {
        if self.is_durable() && !is_stored && !vehicle.may_persist() {
            return Err(MavMissionResult::DENIED);
        }
        vehicle.may_change(plan, from)
    }

    /// Makes `change` live, or has it written first. The answer, when it is known at once.
    pub(super) fn change<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        from: Peer,
        mission_type: MavMissionType,
        change: Change,
    ) -> Option<Reply> {
        let changes_nothing = self.changes_nothing(cx, change);
        let commit = Commit { to: from, mission_type, change, since: cx.now };
        if self.policy().is_some() && !changes_nothing {
            let tokens = tokens(cx, cx.plans.staged());
            self.saving.wear.spend(cx.now, tokens);
        }
        if self.is_durable() && !changes_nothing {
            event!("plans: change by {}: to be written", from);
            self.saving.next_job();
            self.commit = Some(commit);
            self.heard = cx.now;
            return None;
        }
        if !changes_nothing {
            self.make_live(cx, vehicle, change);
            self.want_saved();
        }
        Some(self.ended(cx, &commit, MavMissionResult::ACCEPTED))
    }

    /// In one step.
    fn make_live<V: Plans>(&mut self, cx: &mut Context<'_, '_>, vehicle: &mut V, change: Change) {
        match change {
            // It is, where only the storage lacked it.
            Change::Upload { plan, id, .. } if cx.plans.is_live(plan, id) => {}
            Change::Upload { plan, id, first, .. } => self.replace(cx, vehicle, plan, id, first),
            Change::Clear(only) => {
                cx.plans.staging.clear();
                for plan in PlanType::ALL {
                    if only.is_none_or(|only| only == plan) && cx.plans.count(plan) > 0 {
                        event!("{} cleared", plan);
                        self.replace(cx, vehicle, plan, 0, 0);
                    }
                }
            }
        }
    }

    /// The staged plan is the live one.
    fn replace<V: Plans>(&mut self, cx: &mut Context<'_, '_>, vehicle: &mut V, plan: PlanType, id: u32, first: u16) {
        cx.plans.commit(plan, id);
        self.sessions.invalidate(plan);
        if plan == PlanType::Mission {
            self.reached.clear();
        }
        vehicle.plan_changed(PlanChange { plan, items: cx.plans.live(plan).items(), first });
    }

    /// A change is over, one way or the other; the answer to who asked for it.
    fn ended(&mut self, cx: &mut Context<'_, '_>, commit: &Commit, result: MavMissionResult) -> Reply {
        let &Commit { to, mission_type, change, .. } = commit;
        self.current.announce(cx.normal);
        let id = match change {
            Change::Upload { plan, seq, id, last, .. } => {
                let id = if result == MavMissionResult::ACCEPTED { id } else { 0 };
                self.finished(cx, Done { partner: to.address, plan, seq, result, id, last, at: cx.now });
                id
            }
            Change::Clear(_) => 0,
        };
        cx.plans.staging.clear();
        let reply = Reply::new(to.address, mission_type, What::ack(result, id));
        if cx.second_ack && id != 0 {
            self.again = Some((cx.now.after(SECOND_ACK), to.link, reply));
        }
        reply
    }

    /// The final answer once more, when it is due (M-31).
    pub(super) fn poll_again(&mut self, now: Instant) -> Option<(LinkId, Reply)> {
        self.again.take_if(|(at, ..)| now >= *at).map(|(_, link, reply)| (link, reply))
    }

    /// A plan that comes from the vehicle's side: from storage, with the `count` and `id` that it must have, or from the
    /// firmware. `item` gives the items in their order. It is checked as an upload is, and goes live at once.
    #[inline(never)]
    pub(crate) fn load<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        plan: PlanType,
        expected: Option<(u16, u32)>,
        mut item: impl FnMut(u16) -> Option<Item>,
    ) -> Result<(), PlanFault> {
        if self.committing().is_some() || self.is_receiving() {
            return Err(MavMissionResult::DENIED.into());
        }
        let loaded = Self::stage(cx, vehicle, plan, &mut item).and_then(|id| {
            if cx.plans.staged() > 0 {
                check_plan(cx, vehicle, plan).map_err(|trouble| trouble.fault())?;
            }
            let is_as_expected = expected.is_none_or(|expected| expected == (cx.plans.staged(), id));
            if is_as_expected { Ok(id) } else { Err(MavMissionResult::INVALID.into()) }
        });
        if let Ok(id) = loaded
            && !cx.plans.is_live(plan, id)
        {
            self.replace(cx, vehicle, plan, id, 0);
            self.current.announce(cx.normal);
            if expected.is_none() {
                self.want_saved();
            }
        }
        cx.plans.staging.clear();
        loaded.map(|_| ())
    }

    /// Fills the staging area with good items; the plan's id. Not inlined: its stack is free again when the plan is checked.
    #[inline(never)]
    fn stage<V: Plans>(
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        plan: PlanType,
        item: &mut impl FnMut(u16) -> Option<Item>,
    ) -> Result<u32, PlanFault> {
        cx.plans.staging.clear();
        let mut digest = Digest::new();
        while let Some(item) = item(cx.plans.staged()) {
            let seq = cx.plans.staged();
            if seq >= cx.plans.capacity(plan) {
                return Err(MavMissionResult::NO_SPACE.into());
            }
            let checked = validate::check_item(plan, V::MISSION_COMMANDS, &item)
                .and_then(|()| vehicle.check_item(plan, seq, &item));
            checked.map_err(|result| PlanFault { seq: Some(seq), result })?;
            digest.add(&item);
            let _ = cx.plans.staging.push(item);
        }
        Ok(if cx.plans.staged() > 0 { digest.id() } else { 0 })
    }

    /// The wait for storage is over: gives up what was not written in time.
    pub(super) fn poll_commit(&mut self, cx: &mut Context<'_, '_>) -> Option<(LinkId, Reply)> {
        let commit = self.committing()?;
        if cx.now.since(commit.since) < PATIENCE { None } else { self.not_saved(cx) }
    }

    /// When [`poll_commit`](Self::poll_commit) has something to do.
    pub(super) fn commit_deadline(&self) -> Instant {
        self.committing().map_or(Instant::NEVER, |commit| commit.since.after(PATIENCE))
    }
}

/// Returns the first plan of `commit` that the vehicle no longer permits to be changed, and the refusal.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the engine's own"))]
fn refusal<V: Plans>(cx: &Context<'_, '_>, vehicle: &mut V, commit: &Commit) -> Option<(PlanType, MavMissionResult)> {
    PlanType::ALL.into_iter().find_map(|plan| {
        let is_meant = match commit.change {
            Change::Upload { plan: only, .. } => only == plan,
            Change::Clear(only) => only.is_none_or(|only| only == plan) && cx.plans.count(plan) > 0,
        };
        let result = if is_meant { vehicle.may_change(plan, commit.to) } else { Ok(()) };
        result.err().map(|result| (plan, result))
    })
}

/// Whether what is staged can be flown as a whole: by the rules of all vehicles, then by this one's.
pub(super) fn check_plan<V: Plans>(
    cx: &Context<'_, '_>,
    vehicle: &mut V,
    plan: PlanType,
) -> Result<(), Trouble<'static>> {
    let items = cx.plans.staging.as_slice();
    let refused = |fault| Trouble::Refused(plan, fault);
    validate::check_plan(plan, items).map_err(refused)?;
    if plan == PlanType::Mission
        && let Some((from, limit)) = vehicle.first_waypoint_limit()
        && let Some(seq) = first_too_far(items, V::MISSION_COMMANDS, from, limit)
    {
        return Err(Trouble::TooFar(seq, limit));
    }
    vehicle.check_plan(plan, items).map_err(refused)
}

/// What a plan of so many items costs: a token for each quarter of plan memory, and one at least (C-15).
fn tokens(cx: &Context<'_, '_>, count: u16) -> u8 {
    let total = PlanType::ALL.into_iter().fold(0u32, |sum, plan| sum.saturating_add(cx.plans.capacity(plan).into()));
    let quarters = u32::from(count).saturating_mul(4);
    let is_beyond = |part: u32| u8::from(quarters > total.saturating_mul(part));
    [1, 2, 3].into_iter().map(is_beyond).fold(1, u8::saturating_add)
}

/// The half that only storage calls.
#[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "its tests are the engine's own"))]
impl Missions {
    /// Tells the operators that a plan did not come back from storage.
    pub(crate) fn tell_refused(&mut self, cx: &mut Context<'_, '_>, plan: PlanType, fault: PlanFault) {
        cx.tell(&Trouble::Refused(plan, fault));
    }

    /// From now on there is storage.
    pub(crate) fn attach_storage(&mut self, policy: Durability) {
        self.saving.policy = Some(policy);
    }

    /// Sets the time in which one token comes back (C-15).
    pub(crate) fn limit_storage(&mut self, refill: Duration) {
        self.saving.wear.limit(refill);
    }

    /// Records whether storage differs from the live plans, because it could not be read or cannot be flown.
    pub(crate) fn stored_differs(&mut self, differs: bool) {
        self.saving.differs = differs;
    }

    /// Whether an upload uses the staging area.
    pub(crate) fn is_receiving(&self) -> bool {
        self.upload.as_ref().is_some_and(Upload::keeps_out)
    }

    /// Whether somebody waits for storage.
    pub(crate) const fn awaits_storage(&self) -> bool {
        self.commit.is_some()
    }

    /// Whether the storage is left alone for a moment. Whoever waits for an answer gets another attempt.
    pub(crate) fn storage_rests(&self, now: Instant) -> bool {
        self.commit.is_none() && now < self.saving.rests_until
    }

    /// What is to be on the storage, when it is not: a number that changes with the content, and the three plans.
    pub(crate) fn unsaved<'a>(&self, plans: &'a PlansMut<'_>) -> Option<(u32, [PlanView<'a>; 3])> {
        if self.commit.is_none() && !self.saving.owed {
            return None;
        }
        let change = self.commit.as_ref().map(|commit| commit.change);
        let view = |plan| match change {
            Some(Change::Upload { plan: new, id, .. }) if new == plan => plans.staged_as(id),
            Some(Change::Clear(only)) if only.is_none_or(|only| only == plan) => PlanView::EMPTY,
            _ => plans.live(plan),
        };
        Some((self.saving.job, PlanType::ALL.map(view)))
    }

    /// What [`unsaved`](Self::unsaved) gave is durable: it goes live, where it is not. The answer, and where it is owed.
    pub(crate) fn saved<V: Plans>(&mut self, cx: &mut Context<'_, '_>, vehicle: &mut V) -> Option<(LinkId, Reply)> {
        let Saving { policy, job, wear, .. } = self.saving;
        self.saving = Saving { policy, job, wear, rests_until: cx.now.after(GRACE), ..Saving::new() };
        let commit = self.commit.take()?;
        let result = match refusal(cx, vehicle, &commit) {
            None => {
                self.make_live(cx, vehicle, commit.change);
                MavMissionResult::ACCEPTED
            }
            Some((plan, result)) => {
                // The vehicle has refused meanwhile, because it armed for example: the old plan stays live, and is
                // written again (M-45).
                cx.tell(&Trouble::Refused(plan, result.into()));
                self.want_saved();
                result
            }
        };
        Some((commit.to.link, self.ended(cx, &commit, result)))
    }

    /// Ends the change that is being written if the vehicle does not want it any more (M-45): to be asked before each step, so that
    /// its record is never complete. What was written of it is erased. The answer, and where it is owed.
    pub(crate) fn refused<V: Plans>(&mut self, cx: &mut Context<'_, '_>, vehicle: &mut V) -> Option<(LinkId, Reply)> {
        let (plan, result) = refusal(cx, vehicle, self.commit.as_ref()?)?;
        let commit = self.commit.take()?;
        self.saving.next_job();
        cx.tell(&Trouble::Refused(plan, result.into()));
        Some((commit.to.link, self.ended(cx, &commit, result)))
    }

    /// It could not be written, or the room for it not be erased. What was to go live does not; what is live already is
    /// tried again later.
    pub(crate) fn not_saved(&mut self, cx: &mut Context<'_, '_>) -> Option<(LinkId, Reply)> {
        self.counters.not_saved = self.counters.not_saved.wrapping_add(1);
        let was_told = core::mem::replace(&mut self.saving.told, true);
        let Some(commit) = self.commit.take() else {
            self.saving.rests_until = cx.now.after(RETRY);
            if !was_told {
                cx.tell(&Trouble::NotSaved(None));
            }
            return None;
        };
        self.saving.next_job();
        event!("plans: change by {}: not written", commit.to);
        cx.tell(&Trouble::NotSaved(Some(&commit.change)));
        Some((commit.to.link, self.ended(cx, &commit, MavMissionResult::ERROR)))
    }
}
