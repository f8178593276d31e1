//! Plans: missions, geofences and rally points, uploaded, downloaded and cleared.
//!
//! Implements <https://mavlink.io/en/services/mission.html>, rules M-1 to M-95. An upload goes into a staging
//! area and becomes the live plan in one step; until then everything that anybody can see is the old plan.
//!
//! The states of an upload are drawn at [`Plans`].
//!
//! The engine does no I/O. Handlers change state; [`next_ack`](Missions::next_ack), [`next`](Missions::next) and
//! [`next_current`](Missions::next_current) write one message each when a link has room. A request is taken only while its
//! link can owe the answer, and is otherwise dropped unexecuted and counted; to its sender it is a lost frame.

mod arrival;
mod commit;
mod current;
mod distance;
mod download;
mod form;
mod item;
mod memory;
mod number;
mod pace;
mod progress;
mod replies;
mod rules;
mod upload;
mod validate;
mod whole;

#[cfg(test)]
mod tests;

pub use commit::Durability;
pub use item::Item;
pub(crate) use memory::PlansMut;
#[doc(hidden)]
pub use memory::largest as __largest;
pub use memory::{MAX_ITEMS, NoPlans, PlanMemory, PlanStorage, PlanType, PlanView};
pub(crate) use progress::from_set_current;
pub(crate) use replies::{Replies, Reply};
pub(crate) use rules::Value;
pub use rules::{CommandRule, ParamRule};

use self::commit::{Commit, Saving};
use self::current::Current;
use self::download::Sessions;
use self::progress::Reached;
use self::replies::What;
use self::upload::{Done, Upload};
use self::validate::Trouble;
use crate::dialect::{
    MavMissionResult, MavMissionType, MavSeverity, MissionAck, MissionClearAll, MissionCount, MissionItem,
    MissionItemInt, MissionRequest, MissionRequestInt, MissionRequestList, MissionRequestPartialList,
    MissionSetCurrent, MissionWritePartialList,
};
use crate::frame::{Frame, Version};
use crate::link::{LinkId, LinkMask, Outbox, Peer};
use crate::message::{Message, Text};
use crate::service::statustext::StatusTexts;
use crate::time::Instant;
use crate::vehicle::{Plans, Progress};

/// What became of plans. Numbers wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct PlanCounters {
    /// Uploads that were accepted.
    pub accepted: u32,
    /// Uploads that ended at an item, or as a whole, that was not good.
    pub refused: u32,
    /// Uploads that the partner cancelled or began anew, or that timed out.
    pub abandoned: u32,
    /// Frames that have no place in an upload: items that are repeated, out of order, "guided", or of no upload; delayed
    /// duplicates; frames received on another link than the upload's.
    pub out_of_place: u32,
    /// Requests that were dropped because their link owes too many answers.
    pub no_answer_slot: u32,
    /// Times that plans could not be written to storage.
    pub not_saved: u32,
}

/// What a handler works with beside the engine and the vehicle.
pub(crate) struct Context<'a, 'p> {
    pub(crate) now: Instant,
    pub(crate) plans: &'a mut PlansMut<'p>,
    pub(crate) texts: &'a mut StatusTexts,
    /// The links for texts and MISSION_CURRENT.
    pub(crate) normal: LinkMask,
    /// [`Config::second_mission_ack`](crate::Config::second_mission_ack).
    pub(crate) second_ack: bool,
}

impl Context<'_, '_> {
    /// Tells the operators; nothing of it is left in a firmware without texts about plans. Not inlined: the text takes 120
    /// bytes of stack, and who tells it is deep down already.
    #[inline(never)]
    fn tell(&mut self, trouble: &Trouble<'_>) {
        if cfg!(feature = "plan-texts") {
            let mut words = Text::EMPTY;
            trouble.write(&mut words);
            self.texts.push(self.now, self.normal, MavSeverity::WARNING, &words);
        }
    }
}

/// Who sent a message, and what its link is owed.
pub(crate) struct Caller<'a> {
    pub(crate) from: Peer,
    /// What the link sends (V-8).
    pub(crate) version: Version,
    pub(crate) replies: &'a mut Replies,
}

impl Caller<'_> {
    /// The plan that a message is about, when we have it (M-25). A link that sends v1 cannot name any but the mission
    /// (V-7).
    fn plan(&self, cx: &Context<'_, '_>, mission_type: MavMissionType) -> Result<PlanType, MavMissionResult> {
        let plan = PlanType::from_mission_type(mission_type).ok_or(MavMissionResult::INVALID)?;
        if is_named_well(self.version, mission_type) && cx.plans.capacity(plan) > 0 {
            Ok(plan)
        } else {
            Err(MavMissionResult::UNSUPPORTED)
        }
    }

    /// Somebody else is at it (M-23, M-33, M-51).
    fn deny(&mut self, mission_type: MavMissionType) {
        self.ack(mission_type, MavMissionResult::DENIED, 0);
    }

    fn owe(&mut self, mission_type: MavMissionType, what: What) {
        self.replies.push(Reply::new(self.from.address, mission_type, what));
    }

    /// Not inlined: there are many who owe one.
    #[inline(never)]
    fn ack(&mut self, mission_type: MavMissionType, result: MavMissionResult, id: u32) {
        self.owe(mission_type, What::ack(result, id));
    }

    /// The answer of a vehicle that does not serve the plan, whatever is asked: clients would repeat an unanswered question
    /// for seconds. Items and acknowledgements ask nothing. False when the link owes too many answers to owe this one.
    pub(crate) fn refuse(&mut self, frame: &Frame<'_>) -> bool {
        if matches!(frame.id(), MissionAck::ID | MissionItem::ID | MissionItemInt::ID | MissionSetCurrent::ID) {
            return true;
        }
        let has_room = !self.replies.is_full();
        if has_room {
            self.ack(mission_type(frame), MavMissionResult::UNSUPPORTED, 0);
        }
        has_room
    }

    /// A part of a live plan is asked for (M-60).
    fn ask(&mut self, cx: &Context<'_, '_>, mission_type: MavMissionType, what: What) {
        match self.plan(cx, mission_type) {
            Ok(_) => self.owe(mission_type, what),
            Err(result) => self.ack(mission_type, result, 0),
        }
    }
}

/// Whether a frame of this version can name such a plan: MAVLink 1 knows only missions. A v1 frame that names another plan
/// in its extension bytes is refused, and never treated as one about the mission (V-7).
fn is_named_well(version: Version, mission_type: MavMissionType) -> bool {
    version == Version::V2 || mission_type == MavMissionType::MISSION
}

/// Returns the plan that a message names. In all messages of this service it is the first byte after the base fields.
/// Most v1 frames end before it, and are about the mission (V-7).
pub(crate) fn mission_type(frame: &Frame<'_>) -> MavMissionType {
    MavMissionType(frame.info().map_or(0, |info| frame.byte(info.base_len())))
}

/// The engine: the state of plan transfer, whatever the plans' capacities.
#[derive(Clone, Debug)]
pub struct Missions {
    upload: Option<Upload>,
    commit: Option<Commit>,
    /// When the client of the upload or the commit was last heard on its link.
    heard: Instant,
    saving: Saving,
    done: Option<Done>,
    /// The final answer of an upload that is to be sent once more, where and when (M-31).
    again: Option<(Instant, LinkId, Reply)>,
    sessions: Sessions,
    current: Current,
    reached: Reached,
    counters: PlanCounters,
}

impl Missions {
    pub(crate) const fn new() -> Self {
        Self {
            upload: None,
            commit: None,
            heard: Instant::ZERO,
            saving: Saving::new(),
            done: None,
            again: None,
            sessions: Sessions::new(),
            current: Current::new(),
            reached: Reached::new(),
            counters: PlanCounters {
                accepted: 0,
                refused: 0,
                abandoned: 0,
                out_of_place: 0,
                no_answer_slot: 0,
                not_saved: 0,
            },
        }
    }

    /// What became of plans.
    pub(crate) const fn counters(&self) -> &PlanCounters {
        &self.counters
    }

    /// Whether a message is one of ours.
    pub(crate) const fn handles(id: u32) -> bool {
        matches!(
            id,
            MissionCount::ID
                | MissionItemInt::ID
                | MissionItem::ID
                | MissionRequestList::ID
                | MissionRequestInt::ID
                | MissionRequest::ID
                | MissionAck::ID
                | MissionClearAll::ID
                | MissionRequestPartialList::ID
                | MissionWritePartialList::ID
                | MissionSetCurrent::ID
        )
    }

    /// A frame whose message [`handles`](Self::handles) names, addressed to exactly our system (M-10).
    #[inline(never)]
    pub(crate) fn on_frame<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        frame: &Frame<'_>,
    ) {
        let mission_type = mission_type(frame);
        let payload = frame.payload();
        if let Some(message) = frame.decode::<MissionSetCurrent>() {
            return self.on_set_current(cx, vehicle, message.seq);
        }
        if !is_named_well(frame.header().version, mission_type) {
            if matches!(frame.id(), MissionAck::ID | MissionItem::ID | MissionItemInt::ID) {
                self.counters.out_of_place = self.counters.out_of_place.wrapping_add(1);
            } else if !caller.refuse(frame) {
                self.counters.no_answer_slot = self.counters.no_answer_slot.wrapping_add(1);
            }
            return;
        }
        if let Some(message) = frame.decode::<MissionAck>() {
            return self.on_ack(cx, caller.from, mission_type, message.r#type);
        }
        if caller.replies.is_full() {
            self.counters.no_answer_slot = self.counters.no_answer_slot.wrapping_add(1);
            return;
        }
        match frame.id() {
            MissionCount::ID => {
                let count = MissionCount::decode(payload).count;
                self.on_count(cx, vehicle, caller, mission_type, count, frame.header().seq);
            }
            MissionItemInt::ID | MissionItem::ID => {
                if let Some(seq) = self.on_item(cx, vehicle, caller, frame) {
                    self.complete(cx, vehicle, caller, seq);
                }
            }
            MissionClearAll::ID => self.on_clear(cx, vehicle, caller, mission_type),
            MissionRequestList::ID => caller.ask(cx, mission_type, What::Count),
            MissionRequestInt::ID => {
                caller.ask(cx, mission_type, What::Item(MissionRequestInt::decode(payload).seq));
            }
            MissionRequest::ID => {
                caller.ask(cx, mission_type, What::LegacyItem(MissionRequest::decode(payload).seq));
            }
            // MISSION_REQUEST_PARTIAL_LIST, MISSION_WRITE_PARTIAL_LIST: not a part of the standard protocol (M-68).
            _ => caller.ack(mission_type, MavMissionResult::UNSUPPORTED, 0),
        }
    }

    /// Runs the timers: requests that are to be repeated, uploads that stopped, storage that takes too long,
    /// MISSION_CURRENT. What somebody is to be told of it, and where it is owed ([`Replies::owe_result`]).
    #[must_use]
    pub(crate) fn poll<V: Plans>(&mut self, cx: &mut Context<'_, '_>, vehicle: &V) -> Option<(LinkId, Reply)> {
        self.current.poll(cx.now, vehicle.progress(), cx.normal);
        self.reached.poll(cx.now, cx.normal);
        // One of them at most is there.
        self.poll_upload(cx).or_else(|| self.poll_commit(cx)).or_else(|| self.poll_again(cx.now))
    }

    /// When [`poll`](Self::poll) has something to do.
    pub(crate) fn deadline(&self) -> Instant {
        let upload = self.upload.as_ref().map_or(Instant::NEVER, Upload::deadline);
        let again = self.again.as_ref().map_or(Instant::NEVER, |(at, ..)| *at);
        upload.min(self.commit_deadline()).min(again).min(self.current.deadline()).min(self.reached.deadline())
    }

    /// Whether [`next`](Self::next) or [`next_progress`](Self::next_progress) has something for this link.
    pub(crate) fn is_pending(&self, replies: &Replies, tx: &Outbox) -> bool {
        replies.has_any()
            || self.upload.as_ref().is_some_and(|upload| upload.owes_request_on(tx))
            || self.reached.is_owed(LinkMask::of(tx.link()))
            || self.current.is_owed(tx.link())
    }

    /// Sends a request for an item, or a part of a plan. False when nothing is owed on this link. `float_form` is
    /// [`Config::float_mission_items`](crate::Config::float_mission_items).
    pub(crate) fn next(
        &mut self,
        now: Instant,
        replies: &mut Replies,
        plans: &PlansMut<'_>,
        progress: &Progress,
        float_form: bool,
        tx: &mut Outbox,
    ) -> bool {
        if let Some(upload) = self.upload.as_mut().filter(|upload| upload.owes_request_on(tx)) {
            return upload.request(now, plans.staged(), tx);
        }
        replies.pop(false).is_some_and(|reply| self.sessions.answer(now, &reply, plans, progress, float_form, tx))
    }
}
