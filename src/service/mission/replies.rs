//! The pending answers of one link: a short queue, ordered as the requests.
//!
//! Each link has its own queue, so a stalled link does not block the others. A slot holds the request, not the answer's content.
//! The content is looked up when the answer is sent, so it is always up to date.

use heapless::Vec;

use crate::dialect::{MavMissionResult, MavMissionType, MissionAck};
use crate::link::Outbox;
use crate::list::take_first;
use crate::message::Address;
use crate::time::Instant;
use crate::types::Peer;

/// Capacity of the queue: MAVProxy keeps five requests of a download in transit, and repeats a dropped one only after two
/// seconds. The sixth slot is for another client.
const SLOTS: usize = 6;

/// Minimum time between answers to items that belong to no upload (M-31, M-36): one second, in units of 1,024 µs.
const STRAY_PAUSE: u32 = 977;

/// A pending answer. Packed, because each link has several slots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reply {
    pub(crate) to: Address,
    /// As received, even if it names no plan (M-25, M-26).
    pub(super) mission_type: MavMissionType,
    kind: Kind,
    /// The plan's id, the result, or the item's sequence number.
    value: u32,
}

/// The kind of a pending answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    /// There is none.
    None,
    /// MISSION_ACK: ACCEPTED, with the live plan's id.
    Accepted,
    /// MISSION_ACK with another result.
    Refused,
    /// MISSION_COUNT.
    Count,
    /// The item with a sequence number.
    Item,
    /// The same, requested with the old MISSION_REQUEST.
    LegacyItem,
}

impl Reply {
    /// No answer; all zero bits.
    pub(super) const NONE: Self =
        Self { to: Address::new(0, 0), mission_type: MavMissionType(0), kind: Kind::None, value: 0 };

    /// `value`: the item's sequence number, if it is an item.
    pub(super) fn new(to: Address, mission_type: MavMissionType, kind: Kind, value: u32) -> Self {
        Self { to, mission_type, kind, value }
    }

    /// A MISSION_ACK; `id` is the plan's id if `result` is ACCEPTED.
    pub(super) fn of_result(to: Address, mission_type: MavMissionType, result: MavMissionResult, id: u32) -> Self {
        if result == MavMissionResult::ACCEPTED {
            Self::new(to, mission_type, Kind::Accepted, id)
        } else {
            Self::new(to, mission_type, Kind::Refused, result.0.into())
        }
    }

    pub(super) const fn kind(&self) -> Kind {
        self.kind
    }

    /// Returns the item's sequence number, if it is an item.
    pub(super) const fn seq(&self) -> u16 {
        let [low, high, ..] = self.value.to_le_bytes();
        u16::from_le_bytes([low, high])
    }

    fn is_ack(&self) -> bool {
        matches!(self.kind, Kind::Accepted | Kind::Refused)
    }

    /// Sends this answer, a MISSION_ACK.
    fn send_ack(&self, tx: &mut Outbox) -> bool {
        let [result, ..] = self.value.to_le_bytes();
        match self.kind {
            Kind::Accepted => self.ack(MavMissionResult::ACCEPTED, self.value, tx),
            _ => self.ack(MavMissionResult(result), 0, tx),
        }
    }

    /// Sends a MISSION_ACK to the sender of the request.
    pub(super) fn ack(&self, result: MavMissionResult, id: u32, tx: &mut Outbox) -> bool {
        tx.send(&MissionAck {
            target_system: self.to.system.wire(),
            target_component: self.to.component.wire(),
            r#type: result,
            mission_type: self.mission_type,
            opaque_id: id,
        })
    }
}

/// The pending answers of a link about plans.
#[derive(Clone, Debug)]
pub struct Replies {
    /// Oldest first.
    slots: Vec<Reply, SLOTS, u8>,
    /// The final answer of an upload or clear that a timer or storage ended. Not an `Option`: the bits of `None` are not all
    /// zero, so every link would need an initialiser copied from flash.
    result: Reply,
    /// Until this time, in [`coarse`](Instant::coarse) time, stray items are not answered, regardless of the sender.
    strays_from: u32,
}

impl Replies {
    pub(crate) const fn new() -> Self {
        Self { slots: Vec::new(), result: Reply::NONE, strays_from: 0 }
    }

    /// Whether a MISSION_ACK is pending.
    pub(crate) fn has_ack(&self) -> bool {
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

    /// Queues `reply`. Repeated requests share a slot. The caller checks [`is_full`](Self::is_full) before it changes any state.
    pub(super) fn push(&mut self, reply: Reply) {
        if !self.slots.contains(&reply) {
            let _ = self.slots.push(reply);
        }
    }

    /// Queues a refusal.
    pub(super) fn refuse(&mut self, to: Peer, mission_type: MavMissionType, result: MavMissionResult) {
        self.push(Reply::of_result(to.address, mission_type, result, 0));
    }

    /// Answers DENIED, because another client is changing plans (M-23, M-33, M-51).
    pub(super) fn deny(&mut self, to: Peer, mission_type: MavMissionType) {
        self.refuse(to, mission_type, MavMissionResult::DENIED);
    }

    /// Returns the kind of the oldest answer.
    pub(super) fn first(&self) -> Kind {
        self.slots.first().map_or(Kind::None, Reply::kind)
    }

    /// Takes the oldest MISSION_ACK if `ack` is true, otherwise the oldest other answer.
    pub(super) fn pop(&mut self, ack: bool) -> Option<Reply> {
        take_first(&mut self.slots, |reply| reply.is_ack() == ack)
    }

    /// Stores the final answer of an upload or clear. A durable change starts only while this slot is free. So the only answer
    /// that can be overwritten is a timer's OPERATION_CANCELLED, which is a courtesy.
    pub(crate) fn set_result(&mut self, reply: Reply) {
        self.result = reply;
    }

    /// Whether such a final answer is pending.
    pub(super) fn has_result(&self) -> bool {
        self.result.kind != Kind::None
    }

    /// Drops the final answer for `client`, which would take it for the answer to its new request.
    pub(super) fn forget_result(&mut self, client: Address) {
        if self.result.to == client {
            self.result = Reply::NONE;
        }
    }

    /// Drops the final answer, because the link was reopened: its client is gone.
    pub(crate) fn restart(&mut self) {
        self.result = Reply::NONE;
    }

    /// Sends the oldest MISSION_ACK. Returns false if none is pending.
    pub(crate) fn next_ack(&mut self, tx: &mut Outbox) -> bool {
        let result = core::mem::replace(&mut self.result, Reply::NONE);
        let reply = if result.kind == Kind::None { self.pop(true) } else { Some(result) };
        reply.is_some_and(|reply| reply.send_ack(tx))
    }

    /// Whether a stray item may be answered now. If so, the next one may not for a second.
    pub(super) fn may_answer_stray(&mut self, now: Instant) -> bool {
        let ahead = self.strays_from.wrapping_sub(now.coarse());
        let may = ahead == 0 || ahead > STRAY_PAUSE;
        if may {
            self.strays_from = now.coarse().wrapping_add(STRAY_PAUSE);
        }
        may
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
            let mut may = |after| replies.may_answer_stray(Instant::from_micros(start + after));
            assert!(may(0), "{start}");
            assert!(!may(1) && !may(999_000), "{start}");
            assert!(may(1_002_000), "{start}");
        }
    }

    #[test]
    fn replies_are_taken_in_order() {
        let result = |result, id| Reply::of_result(Address::new(255, 190), MavMissionType(9), result, id);
        let other = |kind, seq| Reply::new(Address::new(255, 190), MavMissionType(9), kind, seq);
        let whats = [
            result(MavMissionResult::ACCEPTED, u32::MAX),
            result(MavMissionResult::ACCEPTED, 0),
            result(MavMissionResult(255), 0),
            other(Kind::Count, 0),
            other(Kind::Item, u16::MAX.into()),
            other(Kind::LegacyItem, 1),
        ];
        let mut replies = Replies::new();
        for what in whats {
            assert!(!replies.is_full());
            replies.push(what);
            replies.push(what);
        }
        assert!(replies.is_full() && replies.has_ack());
        let order = [false, false, false, true, true, true].map(|ack| replies.pop(ack));
        assert_eq!(order.map(Option::unwrap), [whats[3], whats[4], whats[5], whats[0], whats[1], whats[2]]);
    }
}
