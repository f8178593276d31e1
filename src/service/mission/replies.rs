//! The pending answers of one link: a short queue, ordered as the requests.
//!
//! Each link has its own queue, so a stalled link does not block the others. A slot holds the request, not the answer's
//! content. The content is looked up when the answer is sent, so it is always up to date.

use core::num::Wrapping;

use heapless::Vec;

use crate::dialect::{MavMissionResult, MavMissionType, MissionAck};
use crate::link::Outbox;
use crate::list::take_first;
use crate::message::Address;
use crate::time::Instant;
use crate::types::{LinkId, Peer, Trust};

/// Capacity of the queue: MAVProxy keeps five requests of a download in transit, and repeats a dropped one only after
/// two seconds. The sixth slot is for another client.
const SLOTS: usize = 6;

/// Minimum time between answers to items that belong to no upload (M-31, M-36): one second, in units of 1,024 µs.
const STRAY_PAUSE: Wrapping<u32> = Wrapping(977);

/// A pending answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reply {
    pub(super) to: Address,
    /// As received, even if it names no plan (M-25, M-26).
    pub(super) mission_type: MavMissionType,
    pub(super) content: ReplyContent,
}

/// The content of a pending answer. Numbers are little-endian bytes: without alignment, a reply takes 8 bytes of each
/// slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ReplyContent {
    /// There is no answer. The first variant, so that a free slot is all zero bits.
    None,
    /// MISSION_ACK: ACCEPTED, with the live plan's id.
    Accepted { id: [u8; 4] },
    /// MISSION_ACK with another result.
    Refused(MavMissionResult),
    /// MISSION_COUNT. `trust` is what has proved the client.
    Count { trust: Trust },
    /// MISSION_ITEM_INT. MISSION_ITEM, if it was requested with the old MISSION_REQUEST and the configuration says so.
    Item { seq: [u8; 2], is_old_request: bool, trust: Trust },
}

/// The final answer to a client, and the link on which to send it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FinalAnswer {
    pub(crate) link: LinkId,
    pub(crate) reply: Reply,
}

impl FinalAnswer {
    pub(super) fn new(client: Peer, mission_type: MavMissionType, content: ReplyContent) -> Self {
        Self { link: client.link, reply: Reply { to: client.address, mission_type, content } }
    }
}

impl ReplyContent {
    /// A MISSION_ACK. `id` is the plan's id if `result` is ACCEPTED.
    pub(super) fn of_result(result: MavMissionResult, id: u32) -> Self {
        match result {
            MavMissionResult::ACCEPTED => Self::Accepted { id: id.to_le_bytes() },
            refusal => Self::Refused(refusal),
        }
    }
}

impl Reply {
    const NONE: Self = Self { to: Address::new(0, 0), mission_type: MavMissionType(0), content: ReplyContent::None };

    pub(super) fn is_accepted(&self) -> bool {
        matches!(self.content, ReplyContent::Accepted { .. })
    }

    fn is_ack(&self) -> bool {
        self.is_accepted() || matches!(self.content, ReplyContent::Refused(_))
    }

    /// Sends the answer as a MISSION_ACK. Returns false if the answer is none, or if the link cannot send it.
    fn send_ack(&self, tx: &mut Outbox) -> bool {
        let (result, id) = match self.content {
            ReplyContent::Accepted { id } => (MavMissionResult::ACCEPTED, u32::from_le_bytes(id)),
            ReplyContent::Refused(result) => (result, 0),
            ReplyContent::None | ReplyContent::Count { .. } | ReplyContent::Item { .. } => return false,
        };
        tx.send(&MissionAck {
            target_system: self.to.system.wire(),
            target_component: self.to.component.wire(),
            r#type: result,
            mission_type: self.mission_type,
            opaque_id: id,
        })
    }

    /// Sends a MISSION_ACK with this result, in place of the requested answer.
    pub(super) fn send_refusal(&self, result: MavMissionResult, tx: &mut Outbox) -> bool {
        Self { content: ReplyContent::Refused(result), ..*self }.send_ack(tx)
    }
}

/// The sender of a message about a plan, and the pending answers of its link.
pub(super) struct Client<'a> {
    pub(super) peer: Peer,
    /// What proves it.
    pub(super) trust: Trust,
    /// The rate of its link (bytes/s); 0 for no limit.
    pub(super) rate: u32,
    /// The plan type that the message names, and so its answer.
    pub(super) mission_type: MavMissionType,
    pub(super) replies: &'a mut Replies,
}

impl Client<'_> {
    /// Queues an answer. Repeated requests share a slot. A slot is free: that is checked before the message changes any
    /// state.
    pub(super) fn answer(&mut self, content: ReplyContent) {
        self.replies.push(Reply { to: self.peer.address, mission_type: self.mission_type, content });
    }

    /// Queues a refusal.
    pub(super) fn refuse(&mut self, result: MavMissionResult) {
        self.answer(ReplyContent::Refused(result));
    }

    /// Refuses a request with DENIED, because another client is changing plans.
    pub(super) fn refuse_as_busy(&mut self) {
        self.refuse(MavMissionResult::DENIED);
    }
}

/// The pending answers of a link about plans.
#[derive(Clone, Debug)]
pub struct Replies {
    /// Oldest first.
    slots: Vec<Reply, SLOTS, u8>,
    /// The final answer of an upload or clear that a timer or storage ended.
    result: Reply,
    /// Until this time, in [`coarse`](Instant::coarse) time, stray items are not answered, regardless of the sender.
    strays_from: Wrapping<u32>,
}

impl Replies {
    pub(super) const fn new() -> Self {
        Self { slots: Vec::new(), result: Reply::NONE, strays_from: Wrapping(0) }
    }

    /// Whether a MISSION_ACK is pending.
    pub(super) fn has_ack(&self) -> bool {
        self.has_result() || self.slots.iter().any(Reply::is_ack)
    }

    /// Whether anything but a MISSION_ACK is pending.
    pub(super) fn has_part(&self) -> bool {
        !self.slots.iter().all(Reply::is_ack)
    }

    /// Whether the queue is full.
    pub(super) fn is_full(&self) -> bool {
        self.slots.is_full()
    }

    fn push(&mut self, reply: Reply) {
        if !self.slots.contains(&reply) {
            let _ = self.slots.push(reply);
        }
    }

    /// Whether the oldest answer is ACCEPTED.
    pub(super) fn is_accepted(&self) -> bool {
        self.slots.first().is_some_and(Reply::is_accepted)
    }

    /// Takes the oldest answer that is no MISSION_ACK.
    pub(super) fn take_part(&mut self) -> Option<Reply> {
        take_first(&mut self.slots, |reply| !reply.is_ack())
    }

    /// Takes the oldest answer that is a MISSION_ACK.
    fn take_ack(&mut self) -> Option<Reply> {
        take_first(&mut self.slots, Reply::is_ack)
    }

    /// Sends the oldest MISSION_ACK. Returns false if none is pending.
    pub(super) fn send_ack(&mut self, tx: &mut Outbox) -> bool {
        let result = core::mem::replace(&mut self.result, Reply::NONE);
        let reply = if result.is_ack() { Some(result) } else { self.take_ack() };
        reply.is_some_and(|reply| reply.send_ack(tx))
    }

    /// Stores the final answer of an upload or clear. A durable change starts only while this slot is free. So the only
    /// answer that can be overwritten is a timer's OPERATION_CANCELLED, which is a courtesy.
    pub(super) fn set_result(&mut self, reply: Reply) {
        self.result = reply;
    }

    /// Whether a final answer is pending.
    pub(super) fn has_result(&self) -> bool {
        self.result.is_ack()
    }

    /// Drops the final answer for `client`, which would take it for the answer to its new request.
    pub(super) fn forget_result(&mut self, client: Address) {
        if self.result.to == client {
            self.clear_result();
        }
    }

    /// Drops the final answer.
    pub(super) fn clear_result(&mut self) {
        self.result = Reply::NONE;
    }

    /// Begins the answer to a stray item. Returns false if another stray item was answered within the last second: then
    /// this one gets no answer.
    pub(super) fn begin_stray_answer(&mut self, now: Instant) -> bool {
        let now = Wrapping(now.coarse());
        let ahead = self.strays_from - now;
        let is_permitted = ahead.0 == 0 || ahead > STRAY_PAUSE;
        if is_permitted {
            self.strays_from = now + STRAY_PAUSE;
        }
        is_permitted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// M-31, M-36: a second of silence at any time, including where the ticks wrap, and after a pause of any length.
    #[test]
    fn stray_items_are_answered_once_a_second() {
        let mut replies = Replies::new();
        for start in [0u64, 1 << 32, (1 << 32) + 5_000_000, 1 << 42, (1 << 42) + (1 << 32)] {
            let mut may = |after| replies.begin_stray_answer(Instant::from_micros(start + after));
            assert!(may(0), "{start}");
            assert!(!may(1) && !may(999_000), "{start}");
            assert!(may(1_002_000), "{start}");
        }
    }

    #[test]
    fn replies_are_taken_in_order() {
        let result = |result, id| Reply {
            to: Address::new(255, 190),
            mission_type: MavMissionType(9),
            content: ReplyContent::of_result(result, id),
        };
        let other = |content| Reply { to: Address::new(255, 190), mission_type: MavMissionType(9), content };
        let item = |seq: u16, is_old_request| ReplyContent::Item {
            seq: seq.to_le_bytes(),
            is_old_request,
            trust: Trust::Open,
        };
        let queued = [
            result(MavMissionResult::ACCEPTED, u32::MAX),
            result(MavMissionResult::ACCEPTED, 0),
            result(MavMissionResult(255), 0),
            other(ReplyContent::Count { trust: Trust::Open }),
            other(item(u16::MAX, false)),
            other(item(1, true)),
        ];
        let mut replies = Replies::new();
        for reply in queued {
            assert!(!replies.is_full());
            replies.push(reply);
            replies.push(reply);
        }
        assert!(replies.is_full() && replies.has_ack());
        assert_eq!([(); 3].map(|()| replies.take_part().unwrap()), [queued[3], queued[4], queued[5]]);
        assert_eq!([(); 3].map(|()| replies.take_ack().unwrap()), queued[..3]);
        assert!(!replies.has_part() && !replies.has_ack());
    }
}
