//! Plans: missions, geofences and rally points, uploaded, downloaded and cleared.
//!
//! Implements <https://mavlink.io/en/services/mission.html>, rules M-1 to M-95. An upload is received into a staging
//! area and becomes the live plan in one step. Until then, downloads and the vehicle see the old plan.
//!
//! [`Plans`] has the state diagram of an upload.
//!
//! The engine does no I/O. Handlers change state. [`send`](Service::send) writes one message when a link has room. A
//! request is accepted only while its link has a free slot for the answer. Otherwise it is dropped and counted, and
//! nothing is executed: to its sender it looks like a lost frame.
//!
//! ```text
//!   frame ─▶ mod ─▶ upload ─▶ check ─▶ commit ─▶ replies ─▶ frame
//!                     └──────── transfer ───┘
//! ```

mod check;
mod commit;
mod current_item;
mod distance;
mod download;
mod engine;
mod messages;
mod plan_file;
mod problem;
mod progress;
mod replies;
mod request_form;
mod retry;
mod transfer;
mod upload;
mod vehicle;
mod without_plans;

#[cfg(test)]
mod tests;

pub use distance::FirstWaypointLimit;
pub use engine::{Missions, PlanCounters};
pub(crate) use messages::is_for_planner;
pub use problem::PlanFault;
pub use replies::Replies;
pub use vehicle::{PlanChange, Plans, Progress};
pub use without_plans::WithoutPlans;

use self::current_item::from_set_current;
use self::messages::{can_name, changes_plans, is_handled, is_request, mission_type};
use self::plan_file::is_writing_file;
use self::replies::{Client, FinalAnswer, ReplyContent};
use self::transfer::{FrameNumber, Transfer};
use self::upload::Count;
use super::command::{Commands, is_allowed};
use super::{About, Cx, Handled, Received, Request, Service, ShowCounters, StackEvent, Turn, Verdict, View, increment};
use crate::dialect::{
    MavMissionResult, MavMissionType, MavProtocolCapability, MissionAck, MissionClearAll, MissionCount, MissionItem,
    MissionItemInt, MissionRequest, MissionRequestInt, MissionRequestList, MissionRequestPartialList,
    MissionSetCurrent, MissionWritePartialList,
};
use crate::link::Port;
use crate::message::Message;
use crate::time::Instant;
use crate::types::{Firmware, LinkMask, PlanMemory, PlanType, PlansMut, Vehicle};

/// Returns the plan that a message names, if the vehicle has it.
///
/// # Errors
///
/// INVALID if the message names no plan. UNSUPPORTED if the vehicle does not have the plan, or if the answers cannot
/// name it: a link that sends v1 can only name the mission (V-7).
fn served_plan(plans: &PlansMut<'_>, port: &Port, mission_type: MavMissionType) -> Result<PlanType, MavMissionResult> {
    let plan = PlanType::from_mission_type(mission_type).ok_or(MavMissionResult::INVALID)?;
    if can_name(port.outbox.version(), mission_type) && plans.capacity(plan) > 0 {
        Ok(plan)
    } else {
        Err(MavMissionResult::UNSUPPORTED)
    }
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

impl Missions {
    /// Handles a frame with one of the service's messages, addressed to exactly our system (M-10).
    fn receive<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &Port,
        replies: &mut Replies,
        received: &Received<'_>,
    ) {
        let (frame, from, id) = (received.frame, received.from, received.frame.id());
        let mission_type = mission_type(frame);
        let names_plan = can_name(frame.header().version, mission_type);
        let is_full = replies.is_full();
        let mut client =
            Client { peer: from, trust: received.trust, rate: port.config.bytes_per_second, mission_type, replies };
        match id {
            MissionSetCurrent::ID => return self.on_set_current(cx, MissionSetCurrent::decode(frame.payload()).seq),
            // Only a request is refused with an answer.
            _ if !names_plan && !is_request(id) => return self.count_dropped_frame(),
            MissionAck::ID => {
                return self.on_ack(cx, received.sender(), mission_type, MissionAck::decode(frame.payload()).r#type);
            }
            // The staging area is in use while stored plans are loaded.
            _ if is_full || (names_plan && self.is_loading()) => return increment(&mut self.counters.no_answer_slot),
            _ if !names_plan => return client.refuse(MavMissionResult::UNSUPPORTED),
            _ if F::HAS_CONTROL && !received.may_change && changes_plans(id) => {
                return self.refuse_uncontrolled(cx.now, &mut client, id);
            }
            MissionItemInt::ID | MissionItem::ID => return self.on_item(cx, &mut client, frame),
            MissionClearAll::ID if mission_type == MavMissionType::ALL => return self.on_clear(cx, &mut client, None),
            // Not part of the standard protocol (M-68).
            MissionRequestPartialList::ID | MissionWritePartialList::ID => {
                return client.refuse(MavMissionResult::UNSUPPORTED);
            }
            _ => {}
        }
        let plan = match served_plan(&cx.plans, port, mission_type) {
            Ok(plan) => plan,
            Err(result) => return client.refuse(result),
        };
        let content = match id {
            MissionCount::ID => {
                let (count, number) = (MissionCount::decode(frame.payload()).count, FrameNumber::of(frame, from));
                return self.on_count(cx, &mut client, Count { plan, count, number });
            }
            MissionClearAll::ID => return self.on_clear(cx, &mut client, Some(plan)),
            MissionRequestList::ID => ReplyContent::Count { trust: received.trust },
            // Both requests for an item have the same fields (M-60).
            _ => {
                let seq = MissionRequestInt::decode(frame.payload()).seq.to_le_bytes();
                ReplyContent::Item { seq, is_old_request: id == MissionRequest::ID, trust: received.trust }
            }
        };
        client.answer(content);
    }

    /// Runs the timers: repeated requests, upload timeouts, storage timeouts, MISSION_CURRENT. Returns the final answer
    /// of an upload or clear that this ended ([`Replies::set_result`]).
    #[must_use]
    fn run_timers<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) -> Option<FinalAnswer> {
        self.current.poll(cx.now, cx.vehicle.progress(), cx.shared.normal);
        self.reached.poll(cx.now, cx.shared.normal);
        self.poll_distance(cx);
        let ousted = self.poll_control(cx);
        // At most one of the others is active.
        ousted
            .or_else(|| self.poll_upload(cx))
            .or_else(|| self.poll_commit(cx))
            .or_else(|| self.poll_second_answer(cx.now))
    }

    /// Queues a final answer on its link, unless it is that of an upload as a file.
    pub(crate) fn queue_result<'l, F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        mut links: impl Iterator<Item = &'l mut Replies>,
        answer: Option<FinalAnswer>,
    ) {
        let Some(FinalAnswer { link, reply }) = answer else { return };
        if is_writing_file(cx) && !self.is_committing() {
            self.end_file(&mut cx.plans, reply.is_accepted());
        } else if let Some(replies) = links.nth(usize::from(link.0)) {
            replies.set_result(reply);
        }
    }
}

impl<F: Firmware<Vehicle: Plans + Commands>> Service<F> for Missions {
    const NEW: Self = Self::INITIAL;
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
        reached.iter().for_each(|&seq| self.reached.push(now, seq, normal, repeats));
        let answer = self.run_timers(cx);
        self.queue_result(cx, links, answer);
        if F::Plans::TAKES_FILES {
            self.poll_file(cx);
        }
    }

    fn deadline(&self) -> Instant {
        let second_answer = self.second_answer.as_ref().map_or(Instant::NEVER, |second| second.at);
        let transfer = self.upload_deadline().min(self.commit_deadline());
        transfer.min(second_answer).min(self.current.deadline()).min(self.reached.deadline())
    }

    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut Replies,
        received: &Received<'_>,
    ) -> Handled {
        if !is_handled(received.frame.id()) {
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
        let has_request = || match &self.transfer {
            Transfer::Upload(upload) => upload.is_request_pending && upload.client.link == port.id,
            _ => false,
        };
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
            PlanReply::Ack => link.send_ack(tx),
            PlanReply::Request => match &mut self.transfer {
                Transfer::Upload(upload) => upload.send_request(cx.now, plans.staged(), tx),
                _ => false,
            },
            PlanReply::Part => {
                let Some(part) = link.take_part() else { return false };
                // The rules of the mission's commands, if MISSION_REQUEST is answered by MISSION_ITEM.
                let floats = cx.shared.config.float_mission_items.then_some(F::Vehicle::MISSION_COMMANDS);
                self.sessions.answer(cx.now, &part, plans, &cx.vehicle.progress(), floats, tx)
            }
            PlanReply::Reached => self.reached.send(tx),
            PlanReply::Current => self.current.send(plans, &cx.vehicle.progress(), tx),
        }
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    #[inline(always)]
    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            // The client is gone.
            StackEvent::Opened(_, link) => link.clear_result(),
            StackEvent::Heard { now, from } => self.heard(now, from),
            _ => {}
        }
    }
}

/// Returns the capability bits for plan memory of these capacities (Q-9).
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

/// Returns the item of a MISSION_SET_CURRENT whose sender is not authorised to give the equivalent command (M-46).
fn refused_item<F: Firmware<Vehicle: Commands + Vehicle>>(
    cx: &mut Cx<'_, F>,
    port: &Port,
    received: &Received<'_>,
) -> Option<u16> {
    let message = received.frame.decode::<MissionSetCurrent>()?;
    let command = from_set_current(&message, received.origin(port));
    let (vehicle, mut context) = cx.hook();
    (!is_allowed(vehicle, &mut context, &command)).then_some(message.seq)
}
