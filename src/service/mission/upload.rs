//! Uploads: one at a time, into the staging area, live in one step at the end (M-1, M-6, M-10 to M-43, M-50 to M-53,
//! SEC-9, SEC-10).
//!
//! This module handles the messages of the state diagram at [`Plans`]. It decides which client may start, restart or
//! cancel an upload, or clear a plan. [`RetryTimer`](super::retry::RetryTimer) decides when a request is repeated.

use super::check::{check_item, check_staged_plan};
use super::engine::Missions;
use super::problem::Problem;
use super::replies::{Client, FinalAnswer, ReplyContent};
use super::transfer::{Change, Commit, FinishedUpload, FrameNumber, Transfer, Upload};
use super::vehicle::Plans;
use crate::dialect::{MavMissionResult, MavMissionType, MissionItem, MissionItemInt};
use crate::frame::Frame;
use crate::message::{Item, Message};
use crate::service::{Cx, increment};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, Peer, PlanType, PlansMut};

/// For this long after an upload has ended, a COUNT equal to its COUNT may be a delayed duplicate (M-22).
const DUPLICATE_WINDOW: Duration = Duration::from_secs(1);

/// A client's transfer stays on its link for this long after the client was last heard there (M-45).
const LINK_HOLD: Duration = Duration::from_secs(2);

/// For this long after an upload has ended, its last item is answered again (M-31).
const ANSWER_REPEAT: Duration = Duration::from_secs(10);

/// A received MISSION_COUNT.
#[derive(Clone, Copy)]
pub(super) struct Count {
    pub(super) plan: PlanType,
    pub(super) count: u16,
    pub(super) number: FrameNumber,
}

/// MISSION_COUNT.
impl Missions {
    /// Handles MISSION_COUNT: starts or restarts an upload.
    pub(super) fn on_count<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        received: Count,
    ) {
        let Count { plan, count, number } = received;
        let (from, staged) = (client.peer, cx.plans.staged());
        if self.is_on_other_link(cx.now, from) {
            // A refusal would end the upload of a client that sends everything on two links.
            let is_duplicate = self.is_duplicate_from_other_link(staged, received);
            return if is_duplicate { self.drop_out_of_place() } else { client.deny() };
        }
        // A restarted client repeats its COUNT (M-23).
        if self.answer_during_commit(client) {
            return;
        }
        if self.is_locked(from) {
            // M-23
            return client.deny();
        }
        if let Transfer::Upload(upload) = &mut self.transfer
            && upload.is_by(from.address)
            && (upload.plan, upload.count) == (plan, count)
            && !(upload.may_be_duplicate && number.is_after(upload.last))
        {
            if staged == 0 {
                // The pending request, or the one that the retry timer will send, answers this COUNT (M-22 a).
                upload.client = from;
                upload.counts.extend(number);
                upload.is_request_pending |= upload.may_be_duplicate;
                self.heard_at = cx.now;
                return;
            }
            let is_answering = upload.retry.count() == 0;
            if is_answering && number.link == upload.client.link && upload.counts.contains(number.seq) {
                // A delayed duplicate (M-22 b). After a silence it may come from a restarted client, whose sequence
                // numbers start from 0 again.
                return self.drop_out_of_place();
            }
        }
        self.start_upload(cx, client, received);
    }

    /// Starts an upload, if it is admitted.
    fn start_upload<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        Count { plan, count, number }: Count,
    ) {
        let (from, mission_type) = (client.peer, client.mission_type);
        let is_duplicate = |previous: &&FinishedUpload| {
            (previous.client, previous.mission_type) == (from.address, mission_type)
                && previous.last_seq.checked_add(1) == Some(count)
                && cx.now - previous.at < DUPLICATE_WINDOW
                && !number.is_after(previous.last)
        };
        let duplicate_of = self.finished.as_ref().filter(is_duplicate).map(|previous| previous.last);
        if duplicate_of.is_none() {
            // This ends an earlier upload of the same client and cancels its pending answer (M-22, M-24). It also ends
            // an upload that a delayed duplicate began. A COUNT after the first item may be a delayed duplicate too;
            // then items are requested twice. But it may also start another plan: if the old request stayed pending,
            // the new plan's items would complete the old plan.
            self.end_previous(client, &mut cx.plans);
        }
        if count > cx.plans.capacity(plan) {
            if let Some(refused) = self.refused.count(cx.now) {
                event!("{} of {=u16} items by {}: no space; {=u32} refused so far", plan, count, from, refused);
            }
            Problem::Refused(plan, MavMissionResult::NO_SPACE.into()).report(cx);
            return client.refuse(MavMissionResult::NO_SPACE);
        }
        // M-52: an empty plan may always be cleared.
        if count > 0 || !self.is_clear(&cx.plans, Some(plan)) {
            let permission = self.ask_permission(cx, plan, from).and_then(|()| self.limit_rate(cx, plan, from, count));
            if let Err(result) = permission {
                return client.refuse(result);
            }
            if self.drop_without_result_slot(client.replies) {
                return;
            }
        }
        if duplicate_of.is_none() || count == 1 {
            // The next item 0 answers the new request; it does not repeat the last item of the previous upload.
            self.finished = None;
        }
        if count == 0 {
            return self.change(cx, client, Change::Clear(Some(plan)));
        }
        event!("{} upload of {=u16} items by {}: started", plan, count, from);
        self.transfer = Transfer::Upload(Upload {
            may_be_duplicate: duplicate_of.is_some(),
            last: duplicate_of.unwrap_or(number),
            ..Upload::new(from, plan, count, number, cx.now)
        });
        self.heard_at = cx.now;
    }

    /// Whether a COUNT from another link is a duplicate of one of this upload's COUNTs, or repeats it before the first
    /// item.
    fn is_duplicate_from_other_link(&self, staged: u16, Count { plan, count, number }: Count) -> bool {
        if let Transfer::Upload(upload) = &self.transfer {
            return (upload.plan, upload.count) == (plan, count) && (staged == 0 || upload.counts.contains(number.seq));
        }
        match self.committing() {
            // It was sent before the last item of the plan that is being written.
            Some(Commit { change: Change::Upload { plan: own, last, .. }, .. }) => {
                *own == plan && (last.seq - number.seq).0 <= 127
            }
            _ => false,
        }
    }
}

/// MISSION_ITEM_INT and MISSION_ITEM.
impl Missions {
    /// Handles an item.
    pub(super) fn on_item<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        frame: &Frame<'_>,
    ) {
        // Both messages have their fields at the same places.
        let MissionItemInt { seq, current, .. } = MissionItemInt::decode(frame.payload());
        let (from, number) = (client.peer, FrameNumber::of(frame, client.peer));
        if matches!(current, 2 | 3) {
            return self.refuse_guided(cx, client);
        }
        if self.is_on_other_link(cx.now, from) {
            // Not denied: most likely it is a duplicate, and a denial would end the client's upload (M-45).
            return self.drop_out_of_place();
        }
        if self.answer_during_commit(client) {
            return;
        }
        let next = cx.plans.staged();
        let upload = match &mut self.transfer {
            Transfer::Upload(upload) if !upload.may_be_duplicate || seq == 0 => upload,
            _ => return self.on_stray_item(cx.now, client, seq),
        };
        if !upload.is_by(from.address) {
            // M-33
            return client.deny();
        }
        self.heard_at = cx.now;
        // Even if it is not the expected item, the client is on this link now (M-11).
        upload.client = from;
        if client.mission_type != upload.plan.mission_type() || seq != next {
            // M-30, M-32: neither is an error. The timer requests the missing item, at most once per period.
            if seq.checked_add(1) == Some(next) {
                upload.retry.on_duplicate();
            }
            return self.drop_out_of_place();
        }
        upload.last = number;
        upload.form.choose_after_item();
        if next == 0 {
            upload.counts.end(number);
        }
        if core::mem::take(&mut upload.may_be_duplicate) {
            self.finished = None;
            self.forget_answer(client);
        }
        self.on_expected_item(cx, client, frame);
    }

    /// Checks and stages the item that was requested. The last one completes the upload.
    fn on_expected_item<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        frame: &Frame<'_>,
    ) {
        let Transfer::Upload(upload) = &mut self.transfer else { return };
        let message = MissionItemInt::decode(frame.payload());
        let (plan, seq) = (upload.plan, message.seq);
        let is_last = seq.checked_add(1).is_none_or(|received| received >= upload.count);
        if is_last && self.drop_without_result_slot(client.replies) {
            // The timer requests it again, until there is a slot for the final answer.
            return;
        }
        let mut item = Item::from_int(&message);
        if let Err(problem) = check_item(cx, plan, seq, &mut item, frame.id() == MissionItem::ID) {
            problem.report(cx);
            return self.refuse_upload(cx, client, seq, problem.fault().result);
        }
        // There is room: the count was checked before the first item (M-21).
        cx.plans.stage(item);
        let Transfer::Upload(upload) = &mut self.transfer else { return };
        upload.digest.add(&item);
        if message.current == 1 {
            upload.first.get_or_insert(seq);
        }
        upload.retry.on_item(cx.now);
        upload.is_request_pending = true;
        if is_last {
            self.complete(cx, client, seq);
        }
    }

    /// Completes the upload after its last item: the plan goes live, or is stored first, unless it is refused as a
    /// whole (M-39).
    pub(super) fn complete<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        last_seq: u16,
    ) {
        let Transfer::Upload(Upload { plan, digest, first, last, .. }) = &self.transfer else { return };
        let (plan, id, first, last) = (*plan, digest.id(), first.unwrap_or(0), *last);
        let change = Change::Upload { plan, id, first, last_seq, last };
        // The vehicle may have armed since COUNT (M-45).
        let is_stored = self.changes_nothing(&cx.plans, &change);
        let checked = check_staged_plan(cx, plan).and_then(|()| {
            let permission = self.permission(cx, plan, client.peer, is_stored);
            permission.map_err(|result| Problem::Refused(plan, result.into()))
        });
        if let Err(problem) = checked {
            problem.report(cx);
            return self.refuse_upload(cx, client, last_seq, problem.fault().result);
        }
        self.transfer = Transfer::Idle;
        self.change(cx, client, change);
    }

    /// Ends the upload at item `last_seq` with a refusal.
    pub(super) fn refuse_upload<F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        last_seq: u16,
        result: MavMissionResult,
    ) {
        let Transfer::Upload(Upload { plan, last, .. }) = &self.transfer else { return };
        let (mission_type, last) = (plan.mission_type(), *last);
        self.transfer = Transfer::Idle;
        cx.plans.clear_staging();
        let address = client.peer.address;
        self.record_end(FinishedUpload { client: address, mission_type, last_seq, result, id: 0, last, at: cx.now });
        client.refuse(result);
    }

    /// Refuses an item that is not part of a plan, but means "go there now" or "change the altitude"; commands have
    /// replaced these (M-34). Sends at most one answer a second, as for stray items (M-36).
    fn refuse_guided<F: Firmware>(&mut self, cx: &mut Cx<'_, F>, client: &mut Client<'_>) {
        self.drop_out_of_place();
        if client.replies.begin_stray_answer(cx.now) {
            Problem::Guided.report(cx);
            client.refuse(MavMissionResult::UNSUPPORTED);
        }
    }

    /// Handles an item that is not part of an upload: either the final ACK of the previous upload was lost (M-31), or
    /// the item is stray (M-36).
    fn on_stray_item(&mut self, now: Instant, client: &mut Client<'_>, seq: u16) {
        let (address, mission_type) = (client.peer.address, client.mission_type);
        let is_last = |previous: &&FinishedUpload| {
            (previous.client, previous.mission_type, previous.last_seq) == (address, mission_type, seq)
                && now - previous.at < ANSWER_REPEAT
        };
        if let Some(previous) = self.finished.as_ref().filter(is_last) {
            if let Some(repeated) = self.repeated.count(now) {
                event!("{} upload by {}: final answer sent again; {=u32} so far", mission_type, client.peer, repeated);
            }
            return client.answer(ReplyContent::of_result(previous.result, previous.id));
        }
        self.drop_out_of_place();
        if matches!(self.transfer, Transfer::Idle) && client.replies.begin_stray_answer(now) {
            client.refuse(MavMissionResult::ERROR);
        }
    }
}

/// MISSION_ACK, MISSION_CLEAR_ALL, and the timer.
impl Missions {
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
            return self.drop_out_of_place();
        }
        let upload = match &mut self.transfer {
            Transfer::Upload(upload) if upload.is_by(from.address) && upload.plan == plan => upload,
            _ => return,
        };
        upload.client = from;
        self.heard_at = cx.now;
        match result {
            MavMissionResult::ACCEPTED => {}
            MavMissionResult::UNSUPPORTED if upload.form.explains_unsupported(cx.plans.staged() > 0) => {
                // M-47: this does not cancel the upload. If the client knows neither form, the timer ends it.
                event!("upload by {}: trying the other request form", from);
                upload.is_request_pending |= upload.form.choose_after_refusal();
            }
            _ => {
                event!("{} upload by {}: cancelled by the client", plan, from);
                self.abandon(&mut cx.plans);
            }
        }
    }

    /// Handles MISSION_CLEAR_ALL for `only` one plan, or for all (M-50 to M-53).
    pub(super) fn on_clear<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        only: Option<PlanType>,
    ) {
        let from = client.peer;
        let is_on_other_link = self.is_on_other_link(cx.now, from);
        if let Some(commit) = self.committing_mut() {
            let is_own = commit.client.address == from.address;
            if !is_own || !matches!(commit.change, Change::Clear(own) if own == only) {
                return client.deny();
            }
            // A repeated clear is answered when the first one ends (M-52).
            if !is_on_other_link {
                commit.move_client(from.link, client.replies);
            }
            return self.drop_out_of_place();
        }
        if is_on_other_link || self.is_locked(from) {
            // M-51
            return client.deny();
        }
        self.end_previous(client, &mut cx.plans);
        let change = Change::Clear(only);
        // M-52: a clear that changes nothing is accepted even if the vehicle permits no changes.
        if !self.is_clear(&cx.plans, only) {
            // All or nothing: permission for every plan first, then the change.
            let permission = PlanType::ALL.into_iter().try_for_each(|plan| {
                let is_affected = change.affects(plan) && cx.plans.capacity(plan) > 0;
                if is_affected { self.ask_permission(cx, plan, from) } else { Ok(()) }
            });
            let named = only.unwrap_or(PlanType::Mission);
            if let Err(result) = permission.and_then(|()| self.limit_rate(cx, named, from, 0)) {
                return client.refuse(result);
            }
            if self.drop_without_result_slot(client.replies) {
                return;
            }
            self.finished = None;
        }
        self.change(cx, client, change);
    }

    /// When [`poll_upload`](Self::poll_upload) is due.
    pub(super) fn upload_deadline(&self) -> Instant {
        match &self.transfer {
            Transfer::Upload(upload) => upload.retry.deadline(),
            _ => Instant::NEVER,
        }
    }

    /// Runs the retry timer (M-40) and the timeout (M-41). Returns the final answer after a timeout.
    pub(super) fn poll_upload<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        let Transfer::Upload(upload) = &mut self.transfer else { return None };
        if cx.now < upload.retry.deadline() {
            return None;
        }
        if !upload.retry.has_timed_out(cx.now) {
            upload.is_request_pending = !upload.may_be_duplicate;
            upload.retry.retry(cx.now);
            upload.form.choose_for_retry(upload.retry.count());
            return None;
        }
        let (client, plan, is_reported) = (upload.client, upload.plan, upload.is_exclusive());
        event!("{} upload by {}: timed out", plan, client);
        if is_reported {
            Problem::TimedOut(plan, cx.plans.staged()).report(cx);
        }
        self.abandon(&mut cx.plans);
        // Otherwise no client is waiting: it would have repeated its COUNT, or has given up.
        is_reported.then(|| {
            let content = ReplyContent::Refused(MavMissionResult::OPERATION_CANCELLED);
            FinalAnswer::new(client, plan.mission_type(), content)
        })
    }
}

/// Which client changes plans.
impl Missions {
    /// While a change is being written, drops a message of its client, which gets the result when the write ends, and
    /// denies those of others. Returns false if no change is being written.
    fn answer_during_commit(&mut self, client: &mut Client<'_>) -> bool {
        let Some(commit) = self.committing_mut() else { return false };
        if commit.client.address == client.peer.address {
            commit.move_client(client.peer.link, client.replies);
            self.drop_out_of_place();
        } else {
            client.deny();
        }
        true
    }

    /// Whether another client's upload is in progress. An upload that a delayed duplicate may have begun does not count.
    fn is_locked(&self, from: Peer) -> bool {
        matches!(&self.transfer, Transfer::Upload(upload) if upload.is_exclusive() && !upload.is_by(from.address))
    }

    /// Records that a frame from `from` was received. The client that changes plans stays on its link while it is heard
    /// there (M-45).
    pub(super) fn heard(&mut self, now: Instant, from: Peer) {
        if self.client() == Some(from) {
            self.heard_at = now;
        }
    }

    /// Returns the client whose upload is in progress or whose change is being written, with its link.
    fn client(&self) -> Option<Peer> {
        match &self.transfer {
            Transfer::Upload(upload) => upload.is_exclusive().then_some(upload.client),
            _ => self.committing().map(|commit| commit.client),
        }
    }

    /// Whether `from` has the ids of the client that changes plans, while that client was recently heard on another
    /// link. The frame is then from another station with the same ids, or a duplicate by a second route (M-45).
    pub(super) fn is_on_other_link(&self, now: Instant, from: Peer) -> bool {
        self.client().is_some_and(|client| client.address == from.address && client.link != from.link)
            && now - self.heard_at < LINK_HOLD
    }

    /// Cancels the pending result of the client's previous request.
    fn forget_answer(&mut self, client: &mut Client<'_>) {
        client.replies.forget_result(client.peer.address);
        self.second_answer = None;
    }

    /// Ends the client's previous request: its upload, or its pending result.
    fn end_previous(&mut self, client: &mut Client<'_>, plans: &mut PlansMut<'_>) {
        self.forget_answer(client);
        self.abandon(plans);
    }

    /// Drops the upload in progress.
    pub(super) fn abandon(&mut self, plans: &mut PlansMut<'_>) {
        if matches!(self.transfer, Transfer::Upload(_)) {
            self.transfer = Transfer::Idle;
            increment(&mut self.counters.abandoned);
        }
        plans.clear_staging();
    }

    /// Counts a frame that is dropped because it does not fit the state.
    pub(super) fn drop_out_of_place(&mut self) {
        increment(&mut self.counters.out_of_place);
    }
}
