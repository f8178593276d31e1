//! Plans: missions, geofences and rally points, uploaded, downloaded and cleared.
//!
//! Implements <https://mavlink.io/en/services/mission.html>, rules M-1 to M-95. An upload is received into a staging area and
//! becomes the live plan in one step. Until then, downloads and the vehicle see the old plan.
//!
//! [`Plans`] has the state diagram of an upload.
//!
//! The engine does no I/O. Handlers change state. [`send`](Service::send) writes one message when a link has room. A request is accepted only while its
//! link has a free slot for the answer. Otherwise it is dropped and counted, and nothing is executed: to its sender it looks
//! like a lost frame.

mod admission;
mod arrival;
mod clear;
mod commit;
mod current;
mod directory;
mod distance;
mod download;
mod form;
mod number;
mod pace;
mod progress;
mod refusals;
mod replies;
mod upload;
mod validate;
mod vehicle;
mod whole;

#[cfg(test)]
mod tests;

pub use refusals::Refusals;
pub use replies::Replies;
pub(crate) use replies::Reply;
pub use vehicle::{PlanChange, PlanFault, Plans, Progress};

use self::commit::Commit;
use self::current::Current;
use self::directory::is_writing_file;
use self::download::Sessions;
use self::progress::Reached;
use self::replies::Kind;
use self::upload::{Done, Upload};
use self::validate::Problem;
use super::command::{Commands, is_allowed};
use super::write_schedule::WriteSchedule;
use super::{About, Cx, Handled, Received, Request, Service, ShowCounters, StackEvent, Turn, Verdict, View, increment};
use crate::dialect::{
    MavComponent, MavMissionResult, MavMissionType, MavProtocolCapability, MavSeverity, MissionAck, MissionClearAll,
    MissionCount, MissionItem, MissionItemInt, MissionRequest, MissionRequestInt, MissionRequestList,
    MissionRequestPartialList, MissionSetCurrent, MissionWritePartialList,
};
use crate::frame::{Frame, Version};
use crate::link::Port;
use crate::log::RefusalLog;
use crate::message::{ComponentId, Message, Text};
use crate::time::Instant;
use crate::types::{
    Context, Durability, Firmware, LinkId, LinkMask, ONE_FRAME, PlanMemory, PlanType, PlansMut, StatusTexts, Vehicle,
};

counters! {
    /// Counters of the plan service. They wrap.
    PlanCounters {
        /// Accepted uploads.
        count accepted,
        /// Uploads refused because of an item, or because of the plan as a whole.
        count refused,
        /// Uploads that the client cancelled or restarted, or that timed out.
        count abandoned,
        /// Frames that do not fit the state of an upload: items that are repeated, out of order, "guided", or part of no upload;
        /// delayed duplicates; frames received on another link than the upload's.
        drop out_of_place,
        /// Requests dropped because their link had no free slot for the answer.
        drop no_answer_slot,
        /// Failed attempts to write plans to storage.
        count not_saved,
    }
}

impl Problem<'_> {
    /// Sends a text to the operators.
    fn report<F: Firmware>(&self, cx: &mut Cx<'_, F>) {
        self.push(cx.now, cx.shared.normal, cx.texts);
    }

    /// The same, from a hook.
    fn say(&self, cx: &mut Context<'_>) {
        self.push(cx.now, cx.normal, cx.texts);
    }

    /// Without the feature `plan-texts` this compiles to nothing.
    #[inline(always)]
    fn push(&self, now: Instant, links: LinkMask, texts: &mut StatusTexts) {
        if cfg!(feature = "plan-texts") {
            let mut words = Text::<ONE_FRAME>::EMPTY;
            self.write(&mut words);
            texts.push(now, links, MavSeverity::WARNING, words.as_bytes());
        }
    }
}

/// Returns the plan that a message names, if the vehicle has it (M-25). A link that sends v1 can only name the mission (V-7).
fn served(plans: &PlansMut<'_>, port: &Port, mission_type: MavMissionType) -> Result<PlanType, MavMissionResult> {
    let plan = PlanType::from_mission_type(mission_type).ok_or(MavMissionResult::INVALID)?;
    if can_name(port.outbox.version(), mission_type) && plans.capacity(plan) > 0 {
        Ok(plan)
    } else {
        Err(MavMissionResult::UNSUPPORTED)
    }
}

/// Whether a message of the service is a request, which is answered, even if by UNSUPPORTED: clients repeat an unanswered request
/// for seconds. Items and acknowledgements are not requests.
const fn is_request(id: u32) -> bool {
    !matches!(id, MissionAck::ID | MissionItem::ID | MissionItemInt::ID | MissionSetCurrent::ID)
}

/// Whether a frame of this version can name this type of plan. MAVLink 1 has missions only: a v1 frame that names another type
/// in its extension bytes is refused, not taken as a message about the mission (V-7).
fn can_name(version: Version, mission_type: MavMissionType) -> bool {
    version == Version::V2 || mission_type == MavMissionType::MISSION
}

/// Returns the plan type that a message names: in all messages of this service, the first byte after the base fields. Most v1
/// frames end before that byte; they are about the mission (V-7).
pub(crate) fn mission_type(frame: &Frame<'_>) -> MavMissionType {
    MavMissionType(frame.info().map_or(0, |info| frame.byte(info.base_len())))
}

/// A message that is pending.
#[derive(Clone, Copy, Debug)]
pub enum PlanReply {
    /// MISSION_ACK.
    Ack,
    /// A request for the next item of an upload.
    Request,
    /// The count or an item of a live plan.
    Part,
    /// MISSION_ITEM_REACHED.
    Reached,
    /// MISSION_CURRENT.
    Current,
}

/// The engine: the state of plan transfers. Its size does not depend on the plans' capacities.
#[derive(Clone, Debug)]
pub struct Missions {
    upload: Option<Upload>,
    commit: Option<Commit>,
    /// When a frame of the client of the upload or commit was last received on its link.
    heard_at: Instant,
    /// When plans are written. It is dirty if the live plans must be, though no client waits for it.
    schedule: WriteSchedule,
    durability: Durability,
    is_loading: bool,
    done: Option<Done>,
    /// The second final answer of an upload: when and on which link to send it (M-31).
    second_answer: Option<(Instant, LinkId, Reply)>,
    sessions: Sessions,
    current: Current,
    reached: Reached,
    /// Whether the distance of the live mission's first waypoint is not checked yet, because the position was not known (M-48).
    is_unchecked: bool,
    counters: PlanCounters,
    refused: RefusalLog,
    /// The final answers that are sent again.
    repeated: RefusalLog,
}

impl Missions {
    /// All zero bits: the `Some`s are, `None` is not. [`reset`](Self::reset) sets them to `None`.
    const VACANT: Self = Self {
        upload: Some(Upload::VACANT),
        commit: Some(Commit::VACANT),
        done: Some(Done::VACANT),
        second_answer: Some((Instant::ZERO, LinkId(0), Reply::NONE)),
        schedule: WriteSchedule::NEW,
        durability: Durability::Durable,
        is_loading: false,
        current: Current::VACANT,
        heard_at: Instant::ZERO,
        sessions: Sessions::new(),
        reached: Reached::new(),
        is_unchecked: false,
        counters: PlanCounters::ZERO,
        refused: RefusalLog::NEW,
        repeated: RefusalLog::NEW,
    };

    fn reset(&mut self) {
        (self.upload, self.commit, self.done, self.second_answer) = (None, None, None, None);
        self.current.begin();
    }

    /// Returns the counters.
    pub(crate) const fn counters(&self) -> &PlanCounters {
        &self.counters
    }

    /// Whether the service handles the message with this id.
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

    /// Handles a frame with one of the messages of [`handles`](Self::handles), addressed to exactly our system (M-10).
    fn receive<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &Port,
        replies: &mut Replies,
        received: &Received<'_>,
    ) {
        let (frame, from) = (received.frame, received.from);
        let mission_type = mission_type(frame);
        if let Some(message) = frame.decode::<MissionSetCurrent>() {
            return self.on_set_current(cx, message.seq);
        }
        if !can_name(frame.header().version, mission_type) {
            if !is_request(frame.id()) {
                increment(&mut self.counters.out_of_place);
            } else if replies.is_full() {
                increment(&mut self.counters.no_answer_slot);
            } else {
                replies.refuse(from, mission_type, MavMissionResult::UNSUPPORTED);
            }
            return;
        }
        if let Some(message) = frame.decode::<MissionAck>() {
            return self.on_ack(cx, from, mission_type, message.r#type);
        }
        // The memory for an upload is in use while stored plans are loaded.
        if replies.is_full() || self.is_loading() {
            increment(&mut self.counters.no_answer_slot);
            return;
        }
        match frame.id() {
            MissionItemInt::ID | MissionItem::ID => {
                if let Some(seq) = self.on_item(cx, from, replies, frame) {
                    self.complete(cx, from, replies, seq);
                }
                return;
            }
            MissionClearAll::ID if mission_type == MavMissionType::ALL => {
                return self.on_clear(cx, from, replies, None);
            }
            // Not part of the standard protocol (M-68).
            MissionRequestPartialList::ID | MissionWritePartialList::ID => {
                return replies.refuse(from, mission_type, MavMissionResult::UNSUPPORTED);
            }
            _ => {}
        }
        let plan = match served(&cx.plans, port, mission_type) {
            Ok(plan) => plan,
            Err(result) => return replies.refuse(from, mission_type, result),
        };
        let kind = match frame.id() {
            MissionCount::ID => return self.on_count(cx, from, replies, plan, frame),
            MissionClearAll::ID => return self.on_clear(cx, from, replies, Some(plan)),
            MissionRequestList::ID => Kind::Count,
            MissionRequestInt::ID => Kind::Item,
            _ => Kind::LegacyItem,
        };
        // Both requests for an item have the same fields (M-60).
        let seq = if kind == Kind::Count { 0 } else { MissionRequestInt::decode(frame.payload()).seq };
        replies.push(Reply::new(from.address, mission_type, kind, seq.into()));
    }

    /// Runs the timers: repeated requests, upload timeouts, storage timeouts, MISSION_CURRENT. Returns the final answer of an
    /// upload or clear that this ended, and the link to send it on ([`Replies::set_result`]).
    #[must_use]
    fn run_timers<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) -> Option<(LinkId, Reply)> {
        self.current.poll(cx.now, cx.vehicle.progress(), cx.shared.normal);
        self.reached.poll(cx.now, cx.shared.normal);
        self.poll_distance(cx);
        // At most one of the three is active.
        self.poll_upload(cx).or_else(|| self.poll_commit(cx)).or_else(|| self.poll_second_answer(cx.now))
    }

    /// Queues a final answer on the given link, unless it is that of an upload as a file.
    pub(crate) fn queue_result<'l, F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        mut links: impl Iterator<Item = &'l mut Replies>,
        owed: Option<(LinkId, Reply)>,
    ) {
        let Some((link, reply)) = owed else { return };
        if is_writing_file(cx) && !self.is_committing() {
            self.end_file(&mut cx.plans, reply.kind());
        } else if let Some(replies) = links.nth(usize::from(link.0)) {
            replies.set_result(reply);
        }
    }
}

impl<F: Firmware<Vehicle: Plans + Commands>> Service<F> for Missions {
    const NEW: Self = Self::VACANT;
    type Link = Replies;
    const VACANT: Replies = Replies::new();
    type Reply = PlanReply;
    const ABOUT: About = About {
        turns: &[Turn::MissionAck, Turn::MissionTransfer, Turn::MissionProgress],
        capabilities: capabilities(&F::Plans::CAPACITIES),
        ..About::AUTOPILOT
    };

    /// Runs the timers, and queues MISSION_ITEM_REACHED for the items that the vehicle's hooks reported.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Replies>) {
        let (now, normal, repeats) = (cx.now, cx.shared.normal, cx.shared.config.item_reached_repeats);
        let reached = core::mem::take(&mut cx.requests.reached);
        reached.iter().for_each(|&seq| self.reached(now, seq, normal, repeats));
        let answer = self.run_timers(cx);
        self.queue_result(cx, links, answer);
        if F::Plans::TAKES_FILES {
            self.poll_file(cx);
        }
    }

    fn deadline(&self) -> Instant {
        let upload = self.upload.as_ref().map_or(Instant::NEVER, Upload::deadline);
        let second_answer = self.second_answer.as_ref().map_or(Instant::NEVER, |(at, ..)| *at);
        upload.min(self.commit_deadline()).min(second_answer).min(self.current.deadline()).min(self.reached.deadline())
    }

    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut Replies,
        received: &Received<'_>,
    ) -> Handled {
        if !Self::handles(received.frame.id()) {
            return Handled::No;
        }
        if received.target.system.is_all() {
            // A broadcast COUNT would start an upload on every vehicle in range (M-10).
            return Handled::OutOfPlace;
        }
        match refused_item(cx, port, received) {
            Some(seq) => self.refuse_current(cx, seq),
            None => self.receive(cx, port, link, received),
        }
        Handled::Yes
    }

    fn on_command(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut Replies, request: &Request) -> Option<Verdict> {
        Some(match self.command(cx, &request.command)? {
            Ok(result) => Verdict::done(result),
            Err(result) => Verdict::Refused(result.into()),
        })
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &Replies, turn: Turn) -> Option<(Instant, PlanReply)> {
        let has_request = || self.upload.as_ref().is_some_and(|upload| upload.has_request_on(port.id));
        let reply = match turn {
            Turn::MissionAck if link.has_ack() => PlanReply::Ack,
            Turn::MissionTransfer if has_request() => PlanReply::Request,
            Turn::MissionTransfer if link.has_part() => PlanReply::Part,
            // In this order, so that an item is reported as reached before the next one is current (M-91).
            Turn::MissionProgress if self.reached.is_pending(LinkMask::of(port.id)) => PlanReply::Reached,
            Turn::MissionProgress if self.current.is_pending(port.id) => PlanReply::Current,
            _ => return None,
        };
        Some((view.now, reply))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut Replies, reply: PlanReply) -> bool {
        let (plans, tx) = (&cx.plans, &mut port.outbox);
        match reply {
            PlanReply::Ack => link.next_ack(tx),
            PlanReply::Request => self.upload.as_mut().is_some_and(|upload| upload.request(cx.now, plans.staged(), tx)),
            PlanReply::Part => {
                let Some(part) = link.pop(false) else { return false };
                // The rules of the mission's commands, if MISSION_REQUEST is answered by MISSION_ITEM.
                let floats = cx.shared.config.float_mission_items.then_some(F::Vehicle::MISSION_COMMANDS);
                self.sessions.answer(cx.now, &part, plans, &cx.vehicle.progress(), floats, tx)
            }
            PlanReply::Reached => self.reached.next(tx),
            PlanReply::Current => self.current.next(plans, &cx.vehicle.progress(), tx),
        }
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    #[inline(always)]
    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Begun(_) => self.reset(),
            StackEvent::Opened(_, link) => link.restart(),
            StackEvent::Heard { now, from } => self.heard(now, from),
            _ => {}
        }
    }
}

/// Returns the capability bits for plan memory of these capacities.
const fn capabilities(capacities: &[u16; 3]) -> MavProtocolCapability {
    let mut capabilities = MavProtocolCapability::EMPTY;
    if PlanType::Mission.is_served(capacities) {
        capabilities = capabilities.with(MavProtocolCapability::MISSION_INT).with(MavProtocolCapability::MISSION_FLOAT);
    }
    if PlanType::Fence.is_served(capacities) {
        capabilities = capabilities.with(MavProtocolCapability::MISSION_FENCE);
    }
    if PlanType::Rally.is_served(capacities) {
        capabilities = capabilities.with(MavProtocolCapability::MISSION_RALLY);
    }
    capabilities
}

/// Whether a message about plans is addressed to component 190, as old ground stations do (M-10).
pub(crate) fn is_for_planner(component: ComponentId, id: u32) -> bool {
    component.wire() == MavComponent::MISSIONPLANNER.0 && Missions::handles(id)
}

/// Returns the item of a MISSION_SET_CURRENT whose sender is not authorised to give the equivalent command (M-46).
fn refused_item<F: Firmware<Vehicle: Commands + Vehicle>>(
    cx: &mut Cx<'_, F>,
    port: &Port,
    received: &Received<'_>,
) -> Option<u16> {
    let message = received.frame.decode::<MissionSetCurrent>()?;
    let command = progress::from_set_current(&message, received.origin(port));
    let (vehicle, mut context) = cx.hook();
    (!is_allowed(vehicle, &mut context, &command)).then_some(message.seq)
}

/// The plan service of a firmware without plans. It answers every request with UNSUPPORTED, because a client would repeat an
/// unanswered one for seconds.
#[derive(Debug)]
pub struct WithoutPlans;

impl<F: Firmware> Service<F> for WithoutPlans {
    const NEW: Self = Self;
    type Link = Refusals;
    const VACANT: Refusals = Refusals::new();
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::MissionAck]);
    type Reply = ();

    fn on_frame(&mut self, _: &mut Cx<'_, F>, _: &mut Port, link: &mut Refusals, received: &Received<'_>) -> Handled {
        let Received { frame, from, target, .. } = received;
        match target.system.wire() {
            _ if !Missions::handles(frame.id()) => Handled::No,
            0 => Handled::OutOfPlace,
            _ if !is_request(frame.id()) || link.push(from.address, mission_type(frame)) => Handled::Yes,
            _ => Handled::NoRoom,
        }
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, _: &Port, link: &Refusals, _: Turn) -> Option<(Instant, ())> {
        (!link.is_empty()).then_some((view.now, ()))
    }

    fn send(&mut self, _: &mut Cx<'_, F>, port: &mut Port, link: &mut Refusals, (): ()) -> bool {
        link.next(&mut port.outbox)
    }
}
