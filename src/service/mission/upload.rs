//! Uploads: one at a time, into the staging area, live in one step at the end (M-10 to M-43, M-50 to M-53).
//!
//! The messages' handlers of the state diagram in [the module](super). Whoever may start, restart, or break an upload is
//! decided here; when to ask again is [`Pace`]'s.

use super::arrival::Arrival;
use super::commit::{Change, check_plan};
use super::form::Form;
use super::item::{Digest, Item};
use super::memory::PlanType;
use super::number::{Counts, Number};
use super::pace::Pace;
use super::replies::{Reply, What};
use super::validate::{self, Trouble};
use super::{Caller, CommandRule, Context, Missions};
use crate::dialect::{MavMissionResult, MavMissionType, MissionRequest, MissionRequestInt};
use crate::frame::{Address, Frame};
use crate::link::{LinkId, Outbox, Peer};
use crate::time::{Duration, Instant};
use crate::vehicle::{PlanFault, Plans};

/// A COUNT like that of the upload that was done so short a time ago may be a late copy of it (M-22).
const ECHO: Duration = Duration::from_secs(1);

/// How long a client's transfer stays on its link after the client was last heard there (M-45).
const STAYS: Duration = Duration::from_secs(2);

/// So long the last item of a finished upload is answered again (M-31).
const MEMORY: Duration = Duration::from_secs(10);

/// An upload that is running. What has come so far is in the staging area.
#[derive(Clone, Debug)]
pub(super) struct Upload {
    /// Who uploads, and where it was heard last: the answers go there (M-11).
    partner: Peer,
    plan: PlanType,
    count: u16,
    /// The first item that was marked as current.
    first: Option<u16>,
    digest: Digest,
    pace: Pace,
    /// Whether the request for the next item is to be sent.
    owes_request: bool,
    form: Form,
    /// It began with a COUNT like that of the upload that was done a moment ago: perhaps a late copy of it. Item 0 is asked
    /// for once for each such COUNT then, and not by the timer: were it one, the next plan's item 0 might be the answer.
    /// Until that comes it keeps nobody out, nobody is told how it ends, and what is known and owed of the last upload stays.
    may_be_echo: bool,
    /// The last item that was wanted, or the last upload's where this may be an echo: what came later is none (M-22).
    last: Number,
    pub(super) counts: Counts,
}

/// How the last upload ended, so that a lost final ACK can be sent again (M-31).
#[derive(Clone, Debug)]
pub(super) struct Done {
    pub(super) partner: Address,
    pub(super) plan: PlanType,
    /// The item that was the last.
    pub(super) seq: u16,
    pub(super) result: MavMissionResult,
    pub(super) id: u32,
    pub(super) last: Number,
    pub(super) at: Instant,
}

impl Upload {
    fn is_by(&self, address: Address) -> bool {
        self.partner.address == address
    }

    /// Whether nothing else may change plans meanwhile.
    pub(super) fn keeps_out(&self) -> bool {
        !self.may_be_echo
    }

    /// The link that the next request goes out on.
    pub(super) fn owes_request_on(&self, tx: &Outbox) -> bool {
        self.owes_request && self.partner.link == tx.link()
    }

    /// When [`Missions::poll_upload`] has something to do.
    pub(super) fn deadline(&self) -> Instant {
        self.pace.deadline()
    }

    /// Asks for the next item.
    pub(super) fn request(&mut self, now: Instant, seq: u16, tx: &mut Outbox) -> bool {
        self.owes_request = false;
        self.pace.asked(now);
        let (target_system, target_component) = (self.partner.address.system.0, self.partner.address.component.0);
        let mission_type = self.plan.mission_type();
        if self.form.take() {
            tx.send(&MissionRequest { seq, target_system, target_component, mission_type })
        } else {
            tx.send(&MissionRequestInt { seq, target_system, target_component, mission_type })
        }
    }
}

impl Missions {
    /// MISSION_COUNT: an upload begins, or begins anew.
    #[inline(never)]
    pub(super) fn on_count<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        mission_type: MavMissionType,
        count: u16,
        number: u8,
    ) {
        let plan = match caller.plan(cx, mission_type) {
            Ok(plan) => plan,
            Err(result) => return caller.ack(mission_type, result, 0),
        };
        let number = Number(caller.from.link, number);
        if self.is_elsewhere(cx.now, caller.from) {
            let is_known = self.is_copy_of_count(cx, plan, count, number);
            return if is_known { self.out_of_place() } else { caller.deny(mission_type) };
        }
        if let Some(commit) = self.committing_mut() {
            // Its partner hears the end of it; a client that was restarted asks again (M-23, section 8.3).
            return if commit.is_by(caller) { self.out_of_place() } else { caller.deny(mission_type) };
        }
        if self.is_kept_out(cx.now, caller) {
            // M-23
            return caller.deny(mission_type);
        }
        if let Some(upload) = &mut self.upload
            && upload.is_by(caller.from.address)
            && (upload.plan, upload.count) == (plan, count)
            && !(upload.may_be_echo && number.is_after(upload.last))
        {
            if cx.plans.staged() == 0 {
                // The pending request, or the one that the retry timer will send, is the answer (M-22 a).
                upload.partner = caller.from;
                upload.counts.extend(number);
                upload.owes_request |= upload.may_be_echo;
                self.heard = cx.now;
                return;
            }
            let is_answering = upload.pace.retries() == 0;
            if is_answering && number.0 == upload.partner.link && upload.counts.contains(number.1) {
                // A delayed duplicate (M-22 b). After a silence it may be a new program's, which counts from 0 again.
                return self.out_of_place();
            }
        }
        let is_echo = |done: &&Done| {
            (done.partner, done.plan) == (caller.from.address, plan)
                && done.seq.checked_add(1) == Some(count)
                && cx.now.since(done.at) < ECHO
                && !number.is_after(done.last)
        };
        let echoed = self.done.as_ref().filter(is_echo).map(|done| done.last);
        if echoed.is_none() {
            // Whatever comes of it, an earlier upload of the same partner is over (M-22, M-24), and what was to be said of it;
            // and one that a late copy began. A COUNT behind the first item may be a late copy as well, and then items are asked
            // for twice; but it may be another plan's, whose items would complete the old one, were the request that is out
            // left to stand.
            self.forget_answer(caller);
            self.abandon(cx);
        }
        if count > cx.plans.capacity(plan) {
            event!("{} upload of {=u16} items by {}: no space", plan, count, caller.from);
            return caller.ack(mission_type, MavMissionResult::NO_SPACE, 0);
        }
        // M-52: what is empty may be emptied always.
        let changes_nothing = count == 0 && self.is_clear(cx, Some(plan));
        if !changes_nothing
            && (!self.may_change(cx, vehicle, caller, plan, mission_type)
                || self.is_worn(cx, caller, plan, mission_type, count)
                || self.lacks_result_slot(caller))
        {
            return;
        }
        if echoed.is_none() || count == 1 {
            // An item 0 that comes is the answer to what is asked now, and no repetition of the last one.
            self.done = None;
        }
        if count == 0 {
            return self.clear(cx, vehicle, caller, mission_type, Some(plan));
        }
        event!("{} upload of {=u16} items by {}: started", plan, count, caller.from);
        self.upload = Some(Upload {
            partner: caller.from,
            plan,
            count,
            first: None,
            digest: Digest::new(),
            pace: Pace::new(cx.now),
            owes_request: true,
            form: Form::NEW,
            may_be_echo: echoed.is_some(),
            last: echoed.unwrap_or(number),
            counts: Counts::new(number),
        });
        self.heard = cx.now;
    }

    /// Whether another client's upload is running, not counting one begun by a delayed duplicate.
    fn is_kept_out(&self, now: Instant, caller: &Caller<'_>) -> bool {
        let is_others = |upload: &Upload| upload.keeps_out() && !upload.is_by(caller.from.address);
        self.upload.as_ref().is_some_and(is_others) || self.is_elsewhere(now, caller.from)
    }

    /// Records a frame from `from`. The client that changes plans stays on its link as long as it is heard there
    /// (M-45).
    pub(crate) fn heard(&mut self, now: Instant, from: Peer) {
        if self.client() == Some(from) {
            self.heard = now;
        }
    }

    /// Returns the client whose upload runs or whose change is being written, with its link.
    fn client(&self) -> Option<Peer> {
        let upload = self.upload.as_ref().filter(|upload| upload.keeps_out());
        upload.map(|upload| upload.partner).or_else(|| self.committing().map(|commit| commit.to))
    }

    /// Whether `from` has the ids of the client that changes plans, while that client was recently heard on another link.
    /// If so, the frame is from another station with the same ids, or a duplicate by a second route (M-45).
    pub(super) fn is_elsewhere(&self, now: Instant, from: Peer) -> bool {
        self.client().is_some_and(|client| client.address == from.address && client.link != from.link)
            && now.since(self.heard) < STAYS
    }

    /// Whether a COUNT from another link is a duplicate of one of this upload's COUNTs, or repeats it before the first item.
    /// To refuse it would end the upload of a client that sends everything on two links.
    fn is_copy_of_count(&self, cx: &Context<'_, '_>, plan: PlanType, count: u16, number: Number) -> bool {
        if let Some(upload) = &self.upload {
            let is_alike = (upload.plan, upload.count) == (plan, count);
            return is_alike && (cx.plans.staged() == 0 || upload.counts.contains(number.1));
        }
        self.committing().is_some_and(|commit| commit.is_older(plan, number.1))
    }

    /// MISSION_ITEM_INT or MISSION_ITEM. Its number, when it is the last one and the plan is to be
    /// [completed](Self::complete): apart from here, for the item takes room on the stack that is needed there.
    #[inline(never)]
    pub(super) fn on_item<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        frame: &Frame<'_>,
    ) -> Option<u16> {
        let Arrival { mission_type, seq, current, item, is_float } = Arrival::of(frame);
        let from = caller.from;
        if matches!(current, 2 | 3) {
            self.refuse_guided(cx, caller, mission_type);
            return None;
        }
        if self.is_elsewhere(cx.now, from) {
            // Not denied: most likely it is a duplicate, and a denial would end the client's upload (M-45).
            self.out_of_place();
            return None;
        }
        if let Some(commit) = self.committing_mut() {
            if commit.is_by(caller) {
                self.out_of_place();
            } else {
                caller.deny(mission_type);
            }
            return None;
        }
        if self.upload.as_ref().is_none_or(|upload| upload.may_be_echo && seq > 0) {
            self.on_stray_item(cx, caller, mission_type, seq);
            return None;
        }
        let upload = self.upload.as_mut()?;
        if !upload.is_by(from.address) {
            // M-33
            caller.deny(mission_type);
            return None;
        }
        self.heard = cx.now;
        // Also when it is not the item that is wanted: the partner is heard here now (M-11).
        upload.partner = from;
        let next = cx.plans.staged();
        if PlanType::from_mission_type(mission_type) != Some(upload.plan) || seq != next {
            // M-30, M-32: neither is an error; what is missing is asked for by the timer, at most once in its period.
            if seq.checked_add(1) == Some(next) {
                upload.pace.repeated();
            }
            self.out_of_place();
            return None;
        }
        upload.last = Number(from.link, frame.header().seq);
        if next == 0 {
            upload.form.fix(is_float);
            upload.counts.end(Number(from.link, frame.header().seq));
        }
        let was_echo = core::mem::take(&mut upload.may_be_echo);
        let (plan, is_last) = (upload.plan, next.saturating_add(1) >= upload.count);
        if was_echo {
            self.done = None;
            self.forget_answer(caller);
        }
        if is_last && self.lacks_result_slot(caller) {
            // Asked for again, when there is room to answer for the whole plan.
            return None;
        }
        // The command comes first, as the order of section 8.6 has it: of an unknown one the frame says nothing.
        let rule = validate::rule(plan, V::MISSION_COMMANDS, item.command);
        let checked = rule.and_then(|rule| {
            let item = if is_float { Item::from_float(item)? } else { item };
            rule.check(&item)?;
            vehicle.check_item(plan, seq, &item)?;
            Ok(item)
        });
        let item = match checked {
            Ok(item) => item,
            Err(result) => {
                // 0 in an integer and in a float have the same bits.
                let is_unset = result == MavMissionResult::INVALID_PARAM5_X && (item.x, item.y) == (0, 0);
                let is_located = |rule: &CommandRule| rule.is_located();
                let trouble = if is_unset && rule.is_ok_and(is_located) {
                    Trouble::Unset(plan, seq)
                } else {
                    Trouble::Refused(plan, PlanFault { seq: Some(seq), result })
                };
                cx.tell(&trouble);
                self.finish(cx, caller, seq, result);
                return None;
            }
        };
        let upload = self.upload.as_mut()?;
        // There is room: the count was checked before the first item (M-21).
        let _ = cx.plans.staging.push(item);
        upload.digest.add(&item);
        if current == 1 {
            upload.first.get_or_insert(seq);
        }
        upload.pace.answered(cx.now);
        upload.owes_request = true;
        is_last.then_some(seq)
    }

    /// The last item has come: the plan goes live, or to storage first, unless it is refused as a whole (M-39).
    #[inline(never)]
    pub(super) fn complete<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        seq: u16,
    ) {
        let Some(Upload { plan, digest, first, last, .. }) = &self.upload else { return };
        let (plan, id, first, last) = (*plan, digest.id(), first.unwrap_or(0), *last);
        let change = Change::Upload { plan, seq, first, id, last };
        // The vehicle may have armed since COUNT (M-45).
        let is_stored = self.changes_nothing(cx, change);
        let permission = |vehicle: &mut V| {
            let permission = self.permission(vehicle, plan, caller.from, is_stored);
            permission.map_err(|result| Trouble::Refused(plan, result.into()))
        };
        if let Err(trouble) = check_plan(cx, vehicle, plan).and_then(|()| permission(vehicle)) {
            cx.tell(&trouble);
            return self.finish(cx, caller, seq, trouble.fault().result);
        }
        self.upload = None;
        if let Some(reply) = self.change(cx, vehicle, caller.from, plan.mission_type(), change) {
            caller.replies.push(reply);
        }
    }

    /// The upload is over with item `seq`, which was not good, or the plan was not.
    fn finish(&mut self, cx: &mut Context<'_, '_>, caller: &mut Caller<'_>, seq: u16, result: MavMissionResult) {
        let Some(Upload { plan, last, .. }) = self.upload.take() else { return };
        cx.plans.staging.clear();
        self.finished(cx, Done { partner: caller.from.address, plan, seq, result, id: 0, last, at: cx.now });
        caller.ack(plan.mission_type(), result, 0);
    }

    /// Remembers how an upload ended.
    pub(super) fn finished(&mut self, cx: &Context<'_, '_>, done: Done) {
        event!("{} upload by {}: {=u8} at item {=u16}", done.plan, done.partner, done.result.0, done.seq);
        let _ = cx;
        let counter = match done.result {
            MavMissionResult::ACCEPTED => &mut self.counters.accepted,
            _ => &mut self.counters.refused,
        };
        *counter = counter.wrapping_add(1);
        self.done = Some(done);
    }

    /// Refuses an item that is not part of a plan: "go there now" or "change the altitude", which are commands today
    /// (M-34). Answers at most once a second, as for stray items (M-36).
    fn refuse_guided(&mut self, cx: &mut Context<'_, '_>, caller: &mut Caller<'_>, mission_type: MavMissionType) {
        self.out_of_place();
        if caller.replies.may_answer_stray(cx.now) {
            cx.tell(&Trouble::Guided);
            caller.ack(mission_type, MavMissionResult::UNSUPPORTED, 0);
        }
    }

    /// An item while no upload is running, or what may be none: the last one's final ACK was lost (M-31), or it is nobody's
    /// (M-36).
    fn on_stray_item(&mut self, cx: &Context<'_, '_>, caller: &mut Caller<'_>, mission_type: MavMissionType, seq: u16) {
        let is_last = |done: &&Done| {
            done.partner == caller.from.address
                && done.plan.mission_type() == mission_type
                && done.seq == seq
                && cx.now.since(done.at) < MEMORY
        };
        if let Some(done) = self.done.as_ref().filter(is_last) {
            event!("{} upload by {}: final answer repeated", done.plan, caller.from);
            return caller.ack(mission_type, done.result, done.id);
        }
        self.out_of_place();
        if self.upload.is_none() && caller.replies.may_answer_stray(cx.now) {
            caller.ack(mission_type, MavMissionResult::ERROR, 0);
        }
    }

    /// MISSION_ACK: a download is done, or an upload is given up. Never answered.
    pub(super) fn on_ack(
        &mut self,
        cx: &mut Context<'_, '_>,
        from: Peer,
        mission_type: MavMissionType,
        result: MavMissionResult,
    ) {
        let Some(plan) = PlanType::from_mission_type(mission_type) else { return };
        self.sessions.close(from, plan);
        if self.is_elsewhere(cx.now, from) {
            // It ends another station's download, or is a duplicate (M-45).
            return self.out_of_place();
        }
        let Some(upload) = self.upload.as_mut().filter(|upload| upload.is_by(from.address) && upload.plan == plan)
        else {
            return;
        };
        upload.partner = from;
        self.heard = cx.now;
        match result {
            MavMissionResult::ACCEPTED => {}
            MavMissionResult::UNSUPPORTED if upload.form.explains_unsupported(cx.plans.staged() > 0) => {
                // M-47: not a cancel. If the partner knows neither form, the timer ends the upload.
                event!("upload by {}: asking in the other form", from);
                upload.owes_request |= upload.form.refused();
            }
            _ => {
                event!("{} upload by {}: cancelled by the partner", plan, from);
                self.abandon(cx);
            }
        }
    }

    /// MISSION_CLEAR_ALL.
    #[inline(never)]
    pub(super) fn on_clear<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        mission_type: MavMissionType,
    ) {
        let only = match mission_type {
            MavMissionType::ALL => None,
            _ => match caller.plan(cx, mission_type) {
                Ok(plan) => Some(plan),
                Err(result) => return caller.ack(mission_type, result, 0),
            },
        };
        let is_elsewhere = self.is_elsewhere(cx.now, caller.from);
        if let Some(commit) = self.committing_mut() {
            // The same again is answered when it is done (M-52); anything else comes too late.
            let is_repeated = commit.clears(mission_type) && (is_elsewhere || commit.is_by(caller));
            return if is_repeated { self.out_of_place() } else { caller.deny(mission_type) };
        }
        if self.is_kept_out(cx.now, caller) {
            // M-51
            return caller.deny(mission_type);
        }
        self.forget_answer(caller);
        self.abandon(cx);
        if self.is_clear(cx, only) {
            // M-52: also where nothing may be changed.
            return self.clear(cx, vehicle, caller, mission_type, only);
        }
        // All or none: first everything is asked, then everything is done.
        for plan in PlanType::ALL {
            let is_meant = cx.plans.capacity(plan) > 0 && only.is_none_or(|only| only == plan);
            if is_meant && !self.may_change(cx, vehicle, caller, plan, mission_type) {
                return;
            }
        }
        let named = only.unwrap_or(PlanType::Mission);
        if !self.is_worn(cx, caller, named, mission_type, 0) && !self.lacks_result_slot(caller) {
            self.done = None;
            self.clear(cx, vehicle, caller, mission_type, only);
        }
    }

    /// Empties a plan, or all (M-50, M-53).
    fn clear<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        mission_type: MavMissionType,
        only: Option<PlanType>,
    ) {
        if let Some(reply) = self.change(cx, vehicle, caller.from, mission_type, Change::Clear(only)) {
            caller.replies.push(reply);
        }
    }

    /// What the last request of `caller` came to is not said any more.
    #[inline(never)]
    fn forget_answer(&mut self, caller: &mut Caller<'_>) {
        caller.replies.forget_result(caller.from.address);
        self.again = None;
    }

    /// Forgets the running upload.
    fn abandon(&mut self, cx: &mut Context<'_, '_>) {
        if self.upload.take().is_some() {
            self.counters.abandoned = self.counters.abandoned.wrapping_add(1);
        }
        cx.plans.staging.clear();
    }

    /// The retry timer (M-40) and the end of patience (M-41): what the partner is to be told then, and where.
    pub(super) fn poll_upload(&mut self, cx: &mut Context<'_, '_>) -> Option<(LinkId, Reply)> {
        let upload = self.upload.as_mut()?;
        if cx.now < upload.pace.deadline() {
            return None;
        }
        if !upload.pace.is_over(cx.now) {
            upload.owes_request = !upload.may_be_echo;
            upload.pace.retry(cx.now);
            if cx.plans.staged() == 0 {
                upload.form.repeat(upload.pace.retries());
            }
            return None;
        }
        event!("{} upload by {}: timed out", upload.plan, upload.partner);
        if upload.may_be_echo {
            // Nobody waits for it: who does has sent COUNT again, or given up.
            self.abandon(cx);
            return None;
        }
        let (Peer { address: to, link }, plan) = (upload.partner, upload.plan);
        let what = What::Refused(MavMissionResult::OPERATION_CANCELLED);
        let seq = cx.plans.staged();
        cx.tell(&Trouble::TimedOut(plan, seq));
        self.abandon(cx);
        Some((link, Reply::new(to, plan.mission_type(), what)))
    }

    fn out_of_place(&mut self) {
        self.counters.out_of_place = self.counters.out_of_place.wrapping_add(1);
    }

    /// Whether a change that storage would answer has nowhere to be answered: its request is dropped then, and counted.
    fn lacks_result_slot(&mut self, caller: &Caller<'_>) -> bool {
        let lacks = self.is_durable() && caller.replies.owes_result();
        if lacks {
            self.counters.no_answer_slot = self.counters.no_answer_slot.wrapping_add(1);
        }
        lacks
    }

    /// Whether the token bucket is too empty for a change to `count` items; if so, sends the refusal (C-15).
    fn is_worn(
        &self,
        cx: &mut Context<'_, '_>,
        caller: &mut Caller<'_>,
        plan: PlanType,
        mission_type: MavMissionType,
        count: u16,
    ) -> bool {
        if self.bears(cx, count) {
            return false;
        }
        event!("{} change by {}: storage was written too often", plan, caller.from);
        cx.tell(&Trouble::Worn(plan));
        caller.deny(mission_type);
        true
    }

    /// Asks for [permission](Self::permission); a refusal is answered here (M-27, M-44).
    fn may_change<V: Plans>(
        &self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        plan: PlanType,
        mission_type: MavMissionType,
    ) -> bool {
        let Err(result) = self.permission(vehicle, plan, caller.from, false) else { return true };
        event!("{} change by {}: refused by the vehicle", plan, caller.from);
        cx.tell(&Trouble::Refused(plan, result.into()));
        caller.ack(mission_type, result, 0);
        false
    }
}
