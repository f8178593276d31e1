//! Uploads: one at a time, into the staging area, live in one step at the end (M-1, M-6, M-10 to M-43, M-50 to M-53,
//! SEC-9, SEC-10).
//!
//! This module handles the messages of the state diagram at [`Plans`]. It decides which client may start, restart or
//! cancel an upload, or clear a plan. [`RetryTimer`](super::retry::RetryTimer) decides when a request is repeated.

use super::check::{ItemForm, check_item, check_staged_plan};
use super::commit::StorageWrite;
use super::engine::Missions;
use super::messages::is_request;
use super::problem::Problem;
use super::replies::{Client, FinalAnswer, ReplyContent};
use super::transfer::{Change, FinishedUpload, FrameNumber, Ousted, Transfer, Upload};
use super::vehicle::Plans;
use crate::dialect::{MavMissionResult, MavMissionType, MissionItem, MissionItemInt};
use crate::frame::Frame;
use crate::message::{Address, Item, Message};
use crate::service::{Cx, increment};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, Peer, PlanMemory, PlanType, PlansMut, Sender, UploadStep};

/// For this long after an upload has ended, a COUNT equal to its COUNT may be a delayed duplicate (M-22).
const DUPLICATE_WINDOW: Duration = Duration::from_secs(1);

/// A client's transfer stays on its link for this long after the client was last heard there (M-45).
const LINK_HOLD: Duration = Duration::from_secs(2);

/// For this long after an upload has ended, its last item is answered again (M-31).
const ANSWER_REPEAT: Duration = Duration::from_secs(10);

/// The time of a client goes on with its next upload, unless it was not heard for this long.
const TIME_HOLD: Duration = Duration::from_secs(10);

/// An upload does not give way to another client before this time.
const SHORTEST_TIME: Duration = Duration::from_secs(15);

/// The most of its time that an upload saves by quick items.
const LONGEST_SAVED: Duration = Duration::from_secs(30);

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
            if self.is_duplicate_from_other_link(staged, received) {
                // A refusal would end the upload of a client that sends every frame on two links.
                return self.count_dropped_frame();
            }
            return client.refuse_as_busy();
        }
        if self.committing().is_some() {
            // A restarted client repeats its COUNT.
            return self.on_frame_during_commit(client);
        }
        if self.is_other_uploading(client) && !self.oust(cx, from) {
            // The other client's upload continues (M-23).
            return client.refuse_as_busy();
        }
        if let Transfer::Upload(upload) = &mut self.transfer
            && upload.is_by(from.address, client.trust)
            && (upload.plan, upload.count) == (plan, count)
        {
            if staged == 0 {
                let is_of_new_upload = !upload.is_confirmed && number.is_after(upload.last);
                if !is_of_new_upload {
                    // A repeated COUNT: the pending request, or the one that the retry timer will send, answers it.
                    upload.client = from;
                    upload.counts.extend(number);
                    upload.is_request_pending |= !upload.is_confirmed;
                    self.heard_at = cx.now;
                    return;
                }
            } else {
                // After a silence, the COUNT may be from a restarted client, whose sequence numbers start from 0 again.
                let is_client_answering = upload.retry.retries() == 0;
                let is_same_link = number.link == upload.client.link;
                if is_client_answering && is_same_link && upload.counts.contains(number.seq) {
                    // A delayed duplicate of the COUNT that began the upload.
                    return self.count_dropped_frame();
                }
            }
        }
        self.start_upload(cx, client, received);
    }

    /// Starts an upload, or clears the plan if the count is 0. Answers with a refusal if the change is not admitted.
    fn start_upload<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        Count { plan, count, number }: Count,
    ) {
        let (from, mission_type) = (client.peer, client.mission_type);
        let may_repeat_count_of = |previous: &&FinishedUpload| {
            (previous.client, previous.mission_type) == (from.address, mission_type)
                && previous.last_seq.checked_add(1) == Some(count)
                && cx.now - previous.at < DUPLICATE_WINDOW
                && !number.is_after(previous.last)
        };
        let last_of_previous = self.finished.as_ref().filter(may_repeat_count_of).map(|previous| previous.last);
        let is_confirmed = last_of_previous.is_none();
        if is_confirmed {
            // This ends an earlier upload of the same client and cancels its pending answer (M-22, M-24). It also ends
            // an upload that a delayed duplicate began. A COUNT after the first item may be a delayed duplicate too;
            // then items are requested twice. But it may also start another plan: if the old request stayed pending,
            // the new plan's items would complete the old plan.
            self.end_previous_request(client, &mut cx.plans);
        }
        if count > cx.plans.capacity(plan) {
            if let Some(refused) = self.refused.count(cx.now) {
                event!("{} of {=u16} items by {}: no space; {=u32} refused so far", plan, count, from, refused);
            }
            Problem::Refused(plan, MavMissionResult::NO_SPACE.into()).report(cx);
            return client.refuse(MavMissionResult::NO_SPACE);
        }
        // A clear that changes nothing needs no permission (M-52).
        if count > 0 || !self.is_already_clear(&cx.plans, Some(plan)) {
            let permission =
                self.ask_permission(cx, plan, from).and_then(|()| self.check_write_rate(cx, plan, from, count));
            if let Err(result) = permission {
                return client.refuse(result);
            }
            if !self.has_result_slot(client.replies) {
                return self.count_missing_slot();
            }
        }
        if is_confirmed || count == 1 {
            // The next item 0 answers the new request; it does not repeat the last item of the previous upload.
            self.finished = None;
        }
        if count == 0 {
            return self.start_change(cx, client, Change::Clear(Some(plan)));
        }
        event!("{} upload of {=u16} items by {}: started", plan, count, from);
        self.begin_time(cx.now, from.address);
        self.transfer = Transfer::Upload(Upload {
            trust: client.trust,
            rate: client.rate,
            is_confirmed,
            last: last_of_previous.unwrap_or(number),
            ..Upload::new(from, plan, count, number, cx.now)
        });
    }

    /// Begins the time of a client's upload. That of one that uploads again goes on: otherwise it would upload the first items
    /// again and again, and others nothing.
    pub(super) fn begin_time(&mut self, now: Instant, client: Address) {
        if self.uploader != client || now - self.heard_at >= TIME_HOLD {
            (self.uploader, self.uploads_since) = (client, now);
        }
        self.heard_at = now;
    }

    /// Whether a COUNT from another link belongs to the upload in progress or to the plan that is being written. That
    /// is a COUNT of the same size that is repeated before the first item, or has the sequence number of an earlier
    /// one. While the plan is being written, it is a COUNT that was sent before the plan's last item.
    fn is_duplicate_from_other_link(&self, staged: u16, Count { plan, count, number }: Count) -> bool {
        if let Transfer::Upload(upload) = &self.transfer {
            let is_same_size = (upload.plan, upload.count) == (plan, count);
            return is_same_size && (staged == 0 || upload.counts.contains(number.seq));
        }
        if let Some(commit) = self.committing()
            && let Change::Upload { plan: written, last, .. } = commit.change
        {
            let is_before_last_item = (last.seq - number.seq).0 <= 127;
            return written == plan && is_before_last_item;
        }
        false
    }
}

/// MISSION_ITEM_INT and MISSION_ITEM.
impl Missions {
    /// Handles an item. Only the next item of the sender's own upload is staged.
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
            // Not refused: the item is most likely a duplicate, and a refusal would end the client's upload (M-45).
            return self.count_dropped_frame();
        }
        if self.committing().is_some() {
            return self.on_frame_during_commit(client);
        }
        let next = cx.plans.staged();
        let upload = match &mut self.transfer {
            // Only item 0 confirms an upload. Later items may repeat those of the previous one.
            Transfer::Upload(upload) if upload.is_confirmed || seq == 0 => upload,
            _ => return self.on_stray_item(cx.now, client, seq),
        };
        if !upload.is_by(from.address, client.trust) {
            // The other client's upload continues (M-33).
            return client.refuse_as_busy();
        }
        self.heard_at = cx.now;
        // Even if it is not the expected item, the client is on this link now (M-11).
        upload.client = from;
        let is_expected = client.mission_type == upload.plan.mission_type() && seq == next;
        if !is_expected {
            // Not an error: the timer requests the missing item, at most once per period (M-32).
            let is_last_received = seq.checked_add(1) == Some(next);
            if is_last_received {
                upload.retry.on_duplicate();
            }
            return self.count_dropped_frame();
        }
        upload.last = number;
        upload.request_form.choose_after_item();
        if next == 0 {
            upload.counts.end(number);
        }
        if !upload.is_confirmed {
            upload.is_confirmed = true;
            // The client sends another plan, so it no longer waits for the answer to the previous one.
            self.finished = None;
            self.cancel_pending_result(client);
        }
        self.on_expected_item(cx, client, frame);
    }

    /// Checks and stages the item that was requested. The last item completes the upload; a faulty item ends it with a
    /// refusal.
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
        if is_last && !self.has_result_slot(client.replies) {
            // The timer requests the item again, until there is a slot for the final answer.
            return self.count_missing_slot();
        }
        let mut item = Item::from_int(&message);
        let form = if frame.id() == MissionItem::ID { ItemForm::Float } else { ItemForm::Int };
        if let Err(problem) = check_item(cx, plan, seq, &mut item, form) {
            problem.report(cx);
            return self.refuse_upload(cx, client, seq, problem.fault().result);
        }
        // The staging area has room, because the count was checked before the first item.
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

    /// Completes the upload after its last item. The plan goes live, or is stored first, unless it is refused as a
    /// whole (M-39).
    pub(super) fn complete<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        last_seq: u16,
    ) {
        let Transfer::Upload(upload) = &self.transfer else { return };
        let Upload { plan, digest, first, last, .. } = upload;
        let spent = self.uploads_since + upload.time_for(cx.plans.staged());
        let (plan, id, first, last) = (*plan, digest.id(), first.unwrap_or(0), *last);
        let change = Change::Upload { plan, id, first, last_seq, last };
        // The vehicle may have armed since COUNT, so it is asked for permission again.
        let write =
            if self.changes_nothing(&cx.plans, &change) { StorageWrite::NotNeeded } else { StorageWrite::Needed };
        let checked = check_staged_plan(cx, plan).and_then(|()| {
            let permission = self.permission(cx, plan, client.peer, write);
            permission.map_err(|result| Problem::Refused(plan, result.into()))
        });
        if let Err(problem) = checked {
            problem.report(cx);
            return self.refuse_upload(cx, client, last_seq, problem.fault().result);
        }
        self.transfer = Transfer::Idle;
        self.uploads_since = spent.min(cx.now);
        self.start_change(cx, client, change);
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
        self.count_dropped_frame();
        if client.replies.begin_stray_answer(cx.now) {
            Problem::Guided.report(cx);
            client.refuse(MavMissionResult::UNSUPPORTED);
        }
    }

    /// Refuses a change by a client that is not in control. A request is answered; items at most once a second, as stray
    /// ones are.
    pub(super) fn refuse_uncontrolled(&mut self, now: Instant, client: &mut Client<'_>, id: u32) {
        self.count_dropped_frame();
        if is_request(id) || client.replies.begin_stray_answer(now) {
            client.refuse(MavMissionResult::DENIED);
        }
    }

    /// Handles an item that is not part of an upload. The last item of the previous upload is answered again, because
    /// its final ACK was lost (M-31). Any other item is stray (M-36).
    fn on_stray_item(&mut self, now: Instant, client: &mut Client<'_>, seq: u16) {
        let (address, mission_type) = (client.peer.address, client.mission_type);
        let is_last_item_of = |previous: &&FinishedUpload| {
            (previous.client, previous.mission_type, previous.last_seq) == (address, mission_type, seq)
                && now - previous.at < ANSWER_REPEAT
        };
        if let Some(previous) = self.finished.as_ref().filter(is_last_item_of) {
            if let Some(repeated) = self.repeated.count(now) {
                event!("{} upload by {}: final answer sent again; {=u32} so far", mission_type, client.peer, repeated);
            }
            return client.answer(ReplyContent::of_result(previous.result, previous.id));
        }
        self.count_dropped_frame();
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
        sender: Sender,
        mission_type: MavMissionType,
        result: MavMissionResult,
    ) {
        let Some(plan) = PlanType::from_mission_type(mission_type) else { return };
        let Sender { peer: from, trust } = sender;
        self.sessions.close(sender, plan);
        if self.is_on_other_link(cx.now, from) {
            // The ACK ended another station's download, or is a duplicate (M-45).
            return self.count_dropped_frame();
        }
        let upload = match &mut self.transfer {
            Transfer::Upload(upload) if upload.is_by(from.address, trust) && upload.plan == plan => upload,
            _ => return,
        };
        upload.client = from;
        self.heard_at = cx.now;
        match result {
            MavMissionResult::ACCEPTED => {}
            MavMissionResult::UNSUPPORTED if upload.request_form.may_be_refused(cx.plans.staged() > 0) => {
                // The client refuses the form of the request, not the upload (M-47). If it knows neither form, the
                // timer ends the upload.
                event!("upload by {}: trying the other request form", from);
                let sends_at_once = upload.request_form.choose_after_refusal();
                upload.is_request_pending |= sends_at_once;
            }
            _ => {
                event!("{} upload by {}: cancelled by the client", plan, from);
                self.abandon_upload(&mut cx.plans);
            }
        }
    }

    /// Handles MISSION_CLEAR_ALL: clears `plan`, or all plans if it is `None` (M-50 to M-53).
    ///
    /// Answers ACCEPTED once the plans are clear, also in storage. Refuses with DENIED while another client changes
    /// plans, and with the vehicle's result if it permits no changes.
    pub(super) fn on_clear<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        plan: Option<PlanType>,
    ) {
        let from = client.peer;
        let change = Change::Clear(plan);
        let is_on_other_link = self.is_on_other_link(cx.now, from);
        if let Some(commit) = self.committing_mut() {
            let is_same_client = commit.is_by(from.address, client.trust);
            let is_same_clear = matches!(commit.change, Change::Clear(cleared) if cleared == plan);
            if !(is_same_client && is_same_clear) {
                return client.refuse_as_busy();
            }
            // A repeated clear: the result of the first one answers both. A frame on another link may be a duplicate,
            // so it does not move the client there.
            if !is_on_other_link {
                commit.move_client(from.link, client.replies);
            }
            return self.count_dropped_frame();
        }
        if is_on_other_link || (self.is_other_uploading(client) && !self.oust(cx, from)) {
            // The upload continues (M-51).
            return client.refuse_as_busy();
        }
        self.end_previous_request(client, &mut cx.plans);
        // A clear that changes nothing is accepted even if the vehicle permits no changes (M-52).
        if !self.is_already_clear(&cx.plans, plan) {
            // All or nothing: the vehicle must permit the change of every plan before one is cleared.
            let permission = PlanType::ALL.into_iter().try_for_each(|plan| {
                let is_affected = change.affects(plan) && cx.plans.capacity(plan) > 0;
                if is_affected { self.ask_permission(cx, plan, from) } else { Ok(()) }
            });
            // The text about a refusal names one plan; for a clear of all plans it names the mission.
            let named_plan = plan.unwrap_or(PlanType::Mission);
            // The write of a clear has no items.
            if let Err(result) = permission.and_then(|()| self.check_write_rate(cx, named_plan, from, 0)) {
                return client.refuse(result);
            }
            if !self.has_result_slot(client.replies) {
                return self.count_missing_slot();
            }
            // The last item of the previous upload is stray from now on: its plan is no longer live.
            self.finished = None;
        }
        self.start_change(cx, client, change);
    }

    /// When [`poll_upload`](Self::poll_upload) is due.
    pub(super) fn upload_deadline(&self) -> Instant {
        match &self.transfer {
            _ if self.ousted.is_pending => Instant::ZERO,
            Transfer::Upload(upload) => upload.retry.deadline(),
            _ => Instant::NEVER,
        }
    }

    /// Repeats the request for the missing item when that is due, or ends an upload that has timed out (M-41). Returns
    /// the final answer of the upload that has ended; `None` if none has ended, or if no client waits for its answer.
    pub(super) fn poll_upload<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        let Transfer::Upload(upload) = &mut self.transfer else { return None };
        if cx.now < upload.retry.deadline() {
            return None;
        }
        let Upload { client, plan, is_confirmed, .. } = *upload;
        if !upload.retry.has_timed_out(cx.now) {
            // In an unconfirmed upload, only a COUNT causes a request.
            upload.is_request_pending = is_confirmed;
            upload.retry.count_retry(cx.now);
            upload.request_form.choose_for_retry(upload.retry.retries());
            return None;
        }
        event!("{} upload by {}: timed out", plan, client);
        let missing_item = cx.plans.staged();
        self.abandon_upload(&mut cx.plans);
        if !is_confirmed {
            // No client waits for an answer: a waiting client would have repeated its COUNT.
            return None;
        }
        Problem::TimedOut(plan, missing_item).report(cx);
        let content = ReplyContent::Refused(MavMissionResult::OPERATION_CANCELLED);
        Some(FinalAnswer::new(client, plan.mission_type(), content))
    }
}

/// Which client changes plans.
impl Missions {
    /// Handles a COUNT or an item while a change is being written. A frame of the change's client is dropped, because
    /// the client gets the result when the write ends. Frames of other clients are refused.
    fn on_frame_during_commit(&mut self, client: &mut Client<'_>) {
        let Some(commit) = self.committing_mut() else { return };
        if commit.is_by(client.peer.address, client.trust) {
            commit.move_client(client.peer.link, client.replies);
            self.count_dropped_frame();
        } else {
            client.refuse_as_busy();
        }
    }

    /// Whether a client other than this one uploads a plan. An unconfirmed upload does not count.
    fn is_other_uploading(&self, client: &Client<'_>) -> bool {
        let (address, trust) = (client.peer.address, client.trust);
        matches!(&self.transfer, Transfer::Upload(upload) if upload.is_confirmed && !upload.is_by(address, trust))
    }

    /// Ends the upload of another client if it is too slow, or if `from` is in control and that client is not. Returns
    /// whether it has ended.
    pub(super) fn oust<F: Firmware>(&mut self, cx: &mut Cx<'_, F>, from: Peer) -> bool {
        let Transfer::Upload(upload) = &self.transfer else { return false };
        let holder = match cx.plans.upload() {
            Some(file) if F::Plans::TAKES_FILES && upload.is_of_file() => file.client,
            _ => upload.client,
        };
        let is_needed = cx.shared.takes_precedence::<F>(from.address.system, holder.address.system);
        let time = upload.time_for(cx.plans.staged()).max(SHORTEST_TIME);
        let gives_way = is_needed || cx.now - self.uploads_since > time;
        // Quick items do not pay for a long pause.
        let saved = time - (cx.now - self.uploads_since);
        self.uploads_since = self.uploads_since - (saved - LONGEST_SAVED);
        if gives_way {
            self.cancel_upload(cx);
        }
        gives_way
    }

    /// Ends an upload, and tells its client. That of a file learns it with its next part.
    fn cancel_upload<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) {
        if let Transfer::Upload(upload) = &self.transfer {
            event!("{} upload by {}: cancelled", upload.plan, upload.client);
            if F::Plans::TAKES_FILES && upload.is_of_file() {
                cx.plans.upload_mut().into_iter().for_each(|file| file.step = UploadStep::Refused);
            } else {
                let (client, mission_type) = (upload.client, upload.plan.mission_type());
                self.ousted = Ousted { is_pending: true, client, mission_type };
            }
            self.abandon_upload(&mut cx.plans);
        }
    }

    /// Ends the upload of a client that may not change the vehicle any more: another system is in control now.
    /// Returns its final answer.
    pub(super) fn poll_control<F: Firmware>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        if let Transfer::Upload(upload) = &self.transfer
            && !upload.is_of_file()
            && !cx.shared.may_change::<F>(upload.client.address.system)
        {
            self.cancel_upload(cx);
        }
        self.ousted.take()
    }

    /// Records that a frame from `from` was received. The client that changes plans stays on its link while it is heard
    /// there (M-45).
    pub(super) fn heard(&mut self, now: Instant, from: Peer) {
        if self.client() == Some(from) {
            self.heard_at = now;
        }
    }

    /// Returns the client whose confirmed upload is in progress or whose change is being written, with its link.
    fn client(&self) -> Option<Peer> {
        match &self.transfer {
            Transfer::Upload(upload) => upload.is_confirmed.then_some(upload.client),
            _ => self.committing().map(|commit| commit.client),
        }
    }

    /// Whether `from` has the ids of the client that changes plans, while that client was recently heard on another
    /// link. The frame is then from another station with the same ids, or a duplicate by a second route (M-45).
    pub(super) fn is_on_other_link(&self, now: Instant, from: Peer) -> bool {
        self.client().is_some_and(|client| client.address == from.address && client.link != from.link)
            && now - self.heard_at < LINK_HOLD
    }

    /// Cancels the pending result of the client's previous request, which the client would take for that of a new one.
    fn cancel_pending_result(&mut self, client: &mut Client<'_>) {
        client.replies.forget_result(client.peer.address);
        self.second_answer = None;
    }

    /// Ends the client's previous request: its upload, or its pending result.
    fn end_previous_request(&mut self, client: &mut Client<'_>, plans: &mut PlansMut<'_>) {
        self.cancel_pending_result(client);
        self.abandon_upload(plans);
    }

    /// Drops the upload in progress, if any, and its items.
    pub(super) fn abandon_upload(&mut self, plans: &mut PlansMut<'_>) {
        if matches!(self.transfer, Transfer::Upload(_)) {
            self.transfer = Transfer::Idle;
            increment(&mut self.counters.abandoned);
        }
        plans.clear_staging();
    }

    /// Counts a frame that the caller drops because it does not fit the state of the transfer.
    pub(super) fn count_dropped_frame(&mut self) {
        increment(&mut self.counters.out_of_place);
    }

    /// Counts a frame that the caller drops because there is no slot for the result. The client repeats it.
    fn count_missing_slot(&mut self) {
        increment(&mut self.counters.no_answer_slot);
    }
}
