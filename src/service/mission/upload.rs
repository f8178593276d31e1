//! Uploads: one at a time, into the staging area, live in one step at the end (M-1, M-6, M-10 to M-43, M-50 to M-53, SEC-9,
//! SEC-10).
//!
//! This module has the message handlers of the state diagram at [`Plans`]. It decides which client may start, restart or
//! cancel an upload. [`Pace`] decides when a request is repeated.

use super::arrival::Arrival;
use super::commit::{Change, check_plan};
use super::form::Form;
use super::number::{Counts, Number};
use super::pace::Pace;
use super::replies::Reply;
use super::validate::{self, Problem};
use super::{Cx, Missions, Plans, Replies, increment};
use crate::dialect::{MavMissionResult, MavMissionType, MissionCount, MissionRequest, MissionRequestInt};
use crate::frame::Frame;
use crate::link::Outbox;
use crate::message::{Address, Digest, Item, Message};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkId, NO_ITEM, Peer, PlanType, PlansMut, Vehicle};

/// For this long after an upload has ended, a COUNT equal to its COUNT may be a delayed duplicate (M-22).
const DUPLICATE_WINDOW: Duration = Duration::from_secs(1);

/// A client's transfer stays on its link for this long after the client was last heard there (M-45).
const LINK_HOLD: Duration = Duration::from_secs(2);

/// For this long after an upload has ended, its last item is answered again (M-31).
const ANSWER_REPEAT: Duration = Duration::from_secs(10);

/// The upload in progress. The staging area has the items received so far.
#[derive(Clone, Debug)]
pub(super) struct Upload {
    /// The client, and the link on which it was last heard: answers are sent there (M-11).
    client: Peer,
    plan: PlanType,
    count: u16,
    /// The first item marked as current.
    first: Option<u16>,
    digest: Digest,
    pace: Pace,
    /// Whether the request for the next item is pending.
    is_request_pending: bool,
    form: Form,
    /// Whether the upload began with a COUNT that may be a delayed duplicate of the previous upload's COUNT.
    ///
    /// Item 0 is then requested once for each such COUNT, and not by the timer: after a duplicate, the answer might be item 0 of
    /// the client's next plan. Until item 0 is received, other clients may start uploads, a timeout is not reported, and the
    /// state and pending answers of the previous upload are kept.
    may_be_duplicate: bool,
    /// The sequence number of the last expected item. While the COUNT may be a duplicate, that of the previous upload: a COUNT
    /// sent after it is not a duplicate (M-22).
    last: Number,
    /// The sequence numbers of its COUNTs.
    pub(super) counts: Counts,
}

/// The result of the previous upload, so that a lost final ACK can be sent again (M-31).
#[derive(Clone, Debug)]
pub(super) struct Done {
    pub(super) client: Address,
    pub(super) plan: PlanType,
    /// The last item.
    pub(super) seq: u16,
    pub(super) result: MavMissionResult,
    pub(super) id: u32,
    /// The sequence number of the last item's frame.
    pub(super) last: Number,
    pub(super) at: Instant,
}

impl Done {
    /// All zero bits, also as `Some`; `None` is not.
    pub(super) const VACANT: Self = Self {
        client: Address::new(0, 0),
        plan: PlanType::Mission,
        seq: 0,
        result: MavMissionResult(0),
        id: 0,
        last: Number(LinkId(0), 0),
        at: Instant::ZERO,
    };
}

impl Upload {
    /// All zero bits, also as `Some`; `None` is not.
    pub(super) const VACANT: Self = Self {
        client: Peer { address: Address::new(0, 0), link: LinkId(0) },
        plan: PlanType::Mission,
        count: 0,
        first: None,
        digest: Digest::VACANT,
        pace: Pace::VACANT,
        is_request_pending: false,
        form: Form::NEW,
        may_be_duplicate: false,
        last: Number(LinkId(0), 0),
        counts: Counts::VACANT,
    };

    /// The upload of a file: no client of messages owns it, so all of them are refused (F-24), and its timers do not run. The
    /// file's session ends it.
    pub(super) fn of_file(plan: PlanType) -> Self {
        Self { plan, count: NO_ITEM, pace: Pace::new(Instant::NEVER), ..Self::VACANT }
    }

    /// Whether it is the upload of a file.
    pub(super) fn is_of_file(&self) -> bool {
        self.is_by(Self::VACANT.client.address)
    }

    /// Enters what the file has staged.
    pub(super) fn enter(&mut self, items: &[Item], first: Option<u16>) {
        self.digest = Digest::new();
        items.iter().for_each(|item| self.digest.add(item));
        self.first = first;
    }

    fn is_by(&self, address: Address) -> bool {
        self.client.address == address
    }

    /// Whether other clients must wait until this upload has ended.
    pub(super) fn is_exclusive(&self) -> bool {
        !self.may_be_duplicate
    }

    /// Whether a request is pending on this link.
    pub(super) fn has_request_on(&self, link: LinkId) -> bool {
        self.is_request_pending && self.client.link == link
    }

    /// When [`Missions::poll_upload`] is due.
    pub(super) fn deadline(&self) -> Instant {
        self.pace.deadline()
    }

    /// Sends the request for the next item.
    pub(super) fn request(&mut self, now: Instant, seq: u16, tx: &mut Outbox) -> bool {
        self.is_request_pending = false;
        self.pace.requested(now);
        let (target_system, target_component) =
            (self.client.address.system.wire(), self.client.address.component.wire());
        let mission_type = self.plan.mission_type();
        // Both messages have the same fields.
        let info = if self.form.take() { const { &MissionRequest::INFO } } else { const { &MissionRequestInt::INFO } };
        tx.send_like(&MissionRequestInt { seq, target_system, target_component, mission_type }, info)
    }
}

impl Missions {
    /// Handles MISSION_COUNT: starts or restarts an upload.
    pub(super) fn on_count<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        replies: &mut Replies,
        plan: PlanType,
        frame: &Frame<'_>,
    ) {
        let (mission_type, count) = (plan.mission_type(), MissionCount::decode(frame.payload()).count);
        let number = Number(from.link, frame.header().seq);
        if self.is_on_other_link(cx.now, from) {
            let is_known = self.is_duplicate_count(&cx.plans, plan, count, number);
            return if is_known { self.out_of_place() } else { replies.deny(from, mission_type) };
        }
        if let Some(commit) = self.committing_mut() {
            // The result is sent to the client when the write ends; a restarted client repeats its COUNT (M-23).
            return if commit.is_by(from, replies) { self.out_of_place() } else { replies.deny(from, mission_type) };
        }
        if self.is_locked(cx.now, from) {
            // M-23
            return replies.deny(from, mission_type);
        }
        if let Some(upload) = &mut self.upload
            && upload.is_by(from.address)
            && (upload.plan, upload.count) == (plan, count)
            && !(upload.may_be_duplicate && number.is_after(upload.last))
        {
            if cx.plans.staged() == 0 {
                // The pending request, or the one that the retry timer will send, answers this COUNT (M-22 a).
                upload.client = from;
                upload.counts.extend(number);
                upload.is_request_pending |= upload.may_be_duplicate;
                self.heard_at = cx.now;
                return;
            }
            let is_answering = upload.pace.retries() == 0;
            if is_answering && number.0 == upload.client.link && upload.counts.contains(number.1) {
                // A delayed duplicate (M-22 b). After a silence it may come from a restarted client, whose sequence numbers
                // start from 0 again.
                return self.out_of_place();
            }
        }
        let is_duplicate = |done: &&Done| {
            (done.client, done.plan) == (from.address, plan)
                && done.seq.checked_add(1) == Some(count)
                && cx.now - done.at < DUPLICATE_WINDOW
                && !number.is_after(done.last)
        };
        let duplicate_of = self.done.as_ref().filter(is_duplicate).map(|done| done.last);
        if duplicate_of.is_none() {
            // This ends an earlier upload of the same client and cancels its pending answer (M-22, M-24). It also
            // ends an upload that a delayed duplicate began. A COUNT after the first item may be a delayed duplicate too; then items are
            // requested twice. But it may also start another plan: if the old request stayed pending, the new plan's items
            // would complete the old plan.
            self.forget_answer(from, replies);
            self.abandon(&mut cx.plans);
        }
        if count > cx.plans.capacity(plan) {
            if let Some(refused) = self.refused.count(cx.now) {
                event!("{} of {=u16} items by {}: no space; {=u32} refused so far", plan, count, from, refused);
            }
            Problem::Refused(plan, MavMissionResult::NO_SPACE.into()).report(cx);
            return replies.refuse(from, mission_type, MavMissionResult::NO_SPACE);
        }
        // M-52: an empty plan may always be cleared.
        let changes_nothing = count == 0 && self.is_clear(&cx.plans, Some(plan));
        if !changes_nothing {
            let permission = self.may_change(cx, plan, from).and_then(|()| self.may_write(cx, plan, from, count));
            if let Err(result) = permission {
                return replies.refuse(from, mission_type, result);
            }
            if self.lacks_result_slot(replies) {
                return;
            }
        }
        if duplicate_of.is_none() || count == 1 {
            // The next item 0 answers the new request; it does not repeat the last item of the previous upload.
            self.done = None;
        }
        if count == 0 {
            return self.clear(cx, from, replies, Some(plan));
        }
        event!("{} upload of {=u16} items by {}: started", plan, count, from);
        self.upload = Some(Upload {
            client: from,
            plan,
            count,
            first: None,
            digest: Digest::new(),
            pace: Pace::new(cx.now),
            is_request_pending: true,
            form: Form::NEW,
            may_be_duplicate: duplicate_of.is_some(),
            last: duplicate_of.unwrap_or(number),
            counts: Counts::new(number),
        });
        self.heard_at = cx.now;
    }

    /// Whether another client's upload is in progress; an upload that a delayed duplicate may have begun does not count.
    pub(super) fn is_locked(&self, now: Instant, from: Peer) -> bool {
        let is_others = |upload: &Upload| upload.is_exclusive() && !upload.is_by(from.address);
        self.upload.as_ref().is_some_and(is_others) || self.is_on_other_link(now, from)
    }

    /// Records that a frame from `from` was received. The client that changes plans stays on its link while it is heard there
    /// (M-45).
    pub(crate) fn heard(&mut self, now: Instant, from: Peer) {
        if self.client() == Some(from) {
            self.heard_at = now;
        }
    }

    /// Returns the client whose upload is in progress or whose change is being written, with its link.
    fn client(&self) -> Option<Peer> {
        let upload = self.upload.as_ref().filter(|upload| upload.is_exclusive());
        upload.map(|upload| upload.client).or_else(|| self.committing().map(|commit| commit.client))
    }

    /// Whether `from` has the ids of the client that changes plans, while that client was recently heard on another link. The
    /// frame is then from another station with the same ids, or a duplicate by a second route (M-45).
    pub(super) fn is_on_other_link(&self, now: Instant, from: Peer) -> bool {
        self.client().is_some_and(|client| client.address == from.address && client.link != from.link)
            && now - self.heard_at < LINK_HOLD
    }

    /// Whether a COUNT from another link is a duplicate of one of this upload's COUNTs, or repeats it before the first item. A
    /// refusal would end the upload of a client that sends everything on two links.
    fn is_duplicate_count(&self, plans: &PlansMut<'_>, plan: PlanType, count: u16, number: Number) -> bool {
        if let Some(upload) = &self.upload {
            let is_alike = (upload.plan, upload.count) == (plan, count);
            return is_alike && (plans.staged() == 0 || upload.counts.contains(number.1));
        }
        self.committing().is_some_and(|commit| commit.is_older(plan, number.1))
    }

    /// Handles MISSION_ITEM_INT or MISSION_ITEM. Returns the sequence number of the last item, if the upload is to be
    /// [completed](Self::complete). That is a separate call, so that the stack frame with the item is free by then.
    pub(super) fn on_item<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        replies: &mut Replies,
        frame: &Frame<'_>,
    ) -> Option<u16> {
        let Arrival { mission_type, seq, current, item, is_float } = Arrival::of(frame);
        if matches!(current, 2 | 3) {
            self.refuse_guided(cx, from, replies, mission_type);
            return None;
        }
        if self.is_on_other_link(cx.now, from) {
            // Not denied: most likely it is a duplicate, and a denial would end the client's upload (M-45).
            self.out_of_place();
            return None;
        }
        if let Some(commit) = self.committing_mut() {
            if commit.is_by(from, replies) {
                self.out_of_place();
            } else {
                replies.deny(from, mission_type);
            }
            return None;
        }
        if self.upload.as_ref().is_none_or(|upload| upload.may_be_duplicate && seq > 0) {
            self.on_stray_item(cx.now, from, replies, mission_type, seq);
            return None;
        }
        let upload = self.upload.as_mut()?;
        if !upload.is_by(from.address) {
            // M-33
            replies.deny(from, mission_type);
            return None;
        }
        self.heard_at = cx.now;
        // Even if it is not the expected item, the client is on this link now (M-11).
        upload.client = from;
        let next = cx.plans.staged();
        if PlanType::from_mission_type(mission_type) != Some(upload.plan) || seq != next {
            // M-30, M-32: neither is an error. The timer requests the missing item, at most once per period.
            if seq.checked_add(1) == Some(next) {
                upload.pace.duplicated();
            }
            self.out_of_place();
            return None;
        }
        upload.last = Number(from.link, frame.header().seq);
        upload.form.answered();
        if next == 0 {
            upload.counts.end(Number(from.link, frame.header().seq));
        }
        let was_doubtful = core::mem::take(&mut upload.may_be_duplicate);
        let (plan, is_last) = (upload.plan, next.saturating_add(1) >= upload.count);
        if was_doubtful {
            self.done = None;
            self.forget_answer(from, replies);
        }
        if is_last && self.lacks_result_slot(replies) {
            // The timer requests it again, until there is a slot for the final answer.
            return None;
        }
        // The command is checked first, as M-38 orders the checks: without a rule the frame cannot be judged.
        let rule = validate::rule(plan, F::Vehicle::MISSION_COMMANDS, item.command);
        let checked = rule.and_then(|rule| {
            let item = if is_float { Item::from_float(item, rule)? } else { item };
            rule.check_for(&item, F::Vehicle::HAS_TERRAIN_MODEL)?;
            let (vehicle, mut context) = cx.hook();
            vehicle.check_item(&mut context, plan, seq, &item)?;
            Ok(item)
        });
        let item = match checked {
            Ok(item) => item,
            Err(result) => {
                Problem::of_item(plan, seq, &item, rule, result).report(cx);
                self.finish(cx, from, replies, seq, result);
                return None;
            }
        };
        let upload = self.upload.as_mut()?;
        // There is room: the count was checked before the first item (M-21).
        cx.plans.stage(item);
        upload.digest.add(&item);
        if current == 1 {
            upload.first.get_or_insert(seq);
        }
        upload.pace.received(cx.now);
        upload.is_request_pending = true;
        is_last.then_some(seq)
    }

    /// Completes the upload after its last item: the plan goes live, or is stored first, unless it is refused as a whole (M-39).
    pub(super) fn complete<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        replies: &mut Replies,
        seq: u16,
    ) {
        let Some(Upload { plan, digest, first, last, .. }) = &self.upload else { return };
        let (plan, id, first, last) = (*plan, digest.id(), first.unwrap_or(0), *last);
        let change = Change::Upload { plan, seq, first, id, last };
        // The vehicle may have armed since COUNT (M-45).
        let is_stored = self.changes_nothing(&cx.plans, change);
        let checked = check_plan(cx, plan).and_then(|()| {
            let permission = self.permission(cx, plan, from, is_stored);
            permission.map_err(|result| Problem::Refused(plan, result.into()))
        });
        if let Err(problem) = checked {
            problem.report(cx);
            return self.finish(cx, from, replies, seq, problem.fault().result);
        }
        self.upload = None;
        if let Some(reply) = self.change(cx, from, change) {
            replies.push(reply);
        }
    }

    /// Ends the upload at item `seq` with a refusal.
    pub(super) fn finish<F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        replies: &mut Replies,
        seq: u16,
        result: MavMissionResult,
    ) {
        let Some(Upload { plan, last, .. }) = self.upload.take() else { return };
        cx.plans.clear_staging();
        self.record_end(Done { client: from.address, plan, seq, result, id: 0, last, at: cx.now });
        replies.refuse(from, plan.mission_type(), result);
    }

    /// Records how an upload ended.
    pub(super) fn record_end(&mut self, done: Done) {
        let Done { client, plan, seq, result, at, .. } = done;
        let counter = if result == MavMissionResult::ACCEPTED {
            event!("{} upload by {}: accepted, the last item is {=u16}", plan, client, seq);
            &mut self.counters.accepted
        } else {
            if let Some(refused) = self.refused.count(at) {
                event!(
                    "{} upload by {}: {=u8} at item {=u16}; {=u32} refused so far",
                    plan,
                    client,
                    result.0,
                    seq,
                    refused
                );
            }
            &mut self.counters.refused
        };
        increment(counter);
        self.done = Some(done);
    }

    /// Refuses an item that is not part of a plan, but means "go there now" or "change the altitude"; commands have replaced
    /// these (M-34). Sends at most one answer a second, as for stray items (M-36).
    fn refuse_guided<F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        replies: &mut Replies,
        mission_type: MavMissionType,
    ) {
        self.out_of_place();
        if replies.may_answer_stray(cx.now) {
            Problem::Guided.report(cx);
            replies.refuse(from, mission_type, MavMissionResult::UNSUPPORTED);
        }
    }

    /// Handles an item that is not part of an upload: either the final ACK of the previous upload was lost (M-31), or the item is
    /// stray (M-36).
    fn on_stray_item(
        &mut self,
        now: Instant,
        from: Peer,
        replies: &mut Replies,
        mission_type: MavMissionType,
        seq: u16,
    ) {
        let is_last = |done: &&Done| {
            done.client == from.address
                && done.plan.mission_type() == mission_type
                && done.seq == seq
                && now - done.at < ANSWER_REPEAT
        };
        if let Some(done) = self.done.as_ref().filter(is_last) {
            if let Some(repeated) = self.repeated.count(now) {
                event!("{} upload by {}: final answer sent again; {=u32} so far", done.plan, from, repeated);
            }
            return replies.push(Reply::of_result(from.address, mission_type, done.result, done.id));
        }
        self.out_of_place();
        if self.upload.is_none() && replies.may_answer_stray(now) {
            replies.refuse(from, mission_type, MavMissionResult::ERROR);
        }
    }

    /// Handles MISSION_ACK, which ends a download or cancels an upload. It is never answered.
    pub(super) fn on_ack<F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        mission_type: MavMissionType,
        result: MavMissionResult,
    ) {
        let Some(plan) = PlanType::from_mission_type(mission_type) else { return };
        self.sessions.close(from, plan);
        if self.is_on_other_link(cx.now, from) {
            // It ends another station's download, or is a duplicate (M-45).
            return self.out_of_place();
        }
        let Some(upload) = self.upload.as_mut().filter(|upload| upload.is_by(from.address) && upload.plan == plan)
        else {
            return;
        };
        upload.client = from;
        self.heard_at = cx.now;
        match result {
            MavMissionResult::ACCEPTED => {}
            MavMissionResult::UNSUPPORTED if upload.form.explains_unsupported(cx.plans.staged() > 0) => {
                // M-47: this does not cancel the upload. If the client knows neither form, the timer ends it.
                event!("upload by {}: trying the other request form", from);
                upload.is_request_pending |= upload.form.refused();
            }
            _ => {
                event!("{} upload by {}: cancelled by the client", plan, from);
                self.abandon(&mut cx.plans);
            }
        }
    }

    /// Cancels the pending result of the previous request of `client`.
    pub(super) fn forget_answer(&mut self, client: Peer, replies: &mut Replies) {
        replies.forget_result(client.address);
        self.second_answer = None;
    }

    /// Drops the upload in progress.
    pub(super) fn abandon(&mut self, plans: &mut PlansMut<'_>) {
        if self.upload.take().is_some() {
            increment(&mut self.counters.abandoned);
        }
        plans.clear_staging();
    }

    /// Runs the retry timer (M-40) and the timeout (M-41). Returns the final answer after a timeout, and its link.
    pub(super) fn poll_upload<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<(LinkId, Reply)> {
        let upload = self.upload.as_mut()?;
        if cx.now < upload.pace.deadline() {
            return None;
        }
        if !upload.pace.has_timed_out(cx.now) {
            upload.is_request_pending = !upload.may_be_duplicate;
            upload.pace.retry(cx.now);
            upload.form.repeat(upload.pace.retries());
            return None;
        }
        event!("{} upload by {}: timed out", upload.plan, upload.client);
        if upload.may_be_duplicate {
            // No client is waiting: it would have repeated its COUNT, or has given up.
            self.abandon(&mut cx.plans);
            return None;
        }
        let (Peer { address: to, link }, plan) = (upload.client, upload.plan);
        let seq = cx.plans.staged();
        Problem::TimedOut(plan, seq).report(cx);
        self.abandon(&mut cx.plans);
        Some((link, Reply::of_result(to, plan.mission_type(), MavMissionResult::OPERATION_CANCELLED, 0)))
    }

    pub(super) fn out_of_place(&mut self) {
        increment(&mut self.counters.out_of_place);
    }
}
