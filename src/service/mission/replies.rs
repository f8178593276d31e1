//! What one link owes to those who talk about plans: a few slots, in the order of the questions.
//!
//! Each link has its own, so a link that stalls takes nothing from the others. What is owed is who asked for what; the
//! answer's content is looked up when it is sent, so it is never older than the frame that carries it.

use heapless::Vec;

use crate::dialect::{MavMissionResult, MavMissionType, MissionAck};
use crate::frame::Address;
use crate::link::Outbox;
use crate::list::take_first;
use crate::time::Instant;

/// MAVProxy has five requests of a download on their way, and repeats one that was dropped only after two seconds. And one
/// for somebody else.
const SLOTS: usize = 6;

/// Items that belong to no upload are answered at most once in this time (M-31, M-36): a second, in units of 1,024 µs.
const STRAY_PAUSE: u32 = 977;

/// Something that is owed. Each link has room for some, so it is packed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reply {
    pub(crate) to: Address,
    /// As it came, also when it names no plan (M-25, M-26).
    pub(super) mission_type: MavMissionType,
    kind: Kind,
    /// The plan's id, the result, or the item's number.
    value: u32,
}

/// [`What`], without what it holds.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    None,
    Accepted,
    Refused,
    Count,
    Item,
    LegacyItem,
}

/// What is owed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum What {
    /// MISSION_ACK: ACCEPTED, with the live plan's id.
    Accepted(u32),
    /// MISSION_ACK with another result.
    Refused(MavMissionResult),
    /// How many items there are.
    Count,
    /// The item of this number.
    Item(u16),
    /// The same, asked for with the old MISSION_REQUEST.
    LegacyItem(u16),
}

impl What {
    /// A MISSION_ACK; `id` is of a plan that is accepted.
    pub(super) fn ack(result: MavMissionResult, id: u32) -> Self {
        if result == MavMissionResult::ACCEPTED { Self::Accepted(id) } else { Self::Refused(result) }
    }
}

impl Reply {
    /// Nothing is owed; all zero bits.
    const NONE: Self = Self { to: Address::new(0, 0), mission_type: MavMissionType(0), kind: Kind::None, value: 0 };

    pub(super) fn new(to: Address, mission_type: MavMissionType, what: What) -> Self {
        let (kind, value) = match what {
            What::Accepted(id) => (Kind::Accepted, id),
            What::Refused(result) => (Kind::Refused, u32::from(result.0)),
            What::Count => (Kind::Count, 0),
            What::Item(seq) => (Kind::Item, u32::from(seq)),
            What::LegacyItem(seq) => (Kind::LegacyItem, u32::from(seq)),
        };
        Self { to, mission_type, kind, value }
    }

    pub(super) fn what(&self) -> What {
        let [low, high, ..] = self.value.to_le_bytes();
        let seq = u16::from_le_bytes([low, high]);
        match self.kind {
            Kind::Accepted => What::Accepted(self.value),
            Kind::None | Kind::Refused => What::Refused(MavMissionResult(low)),
            Kind::Count => What::Count,
            Kind::Item => What::Item(seq),
            Kind::LegacyItem => What::LegacyItem(seq),
        }
    }

    fn is_ack(&self) -> bool {
        matches!(self.kind, Kind::Accepted | Kind::Refused)
    }

    /// Sends the MISSION_ACK that this is. False when it is not one.
    pub(super) fn send_ack(&self, tx: &mut Outbox) -> bool {
        match self.what() {
            What::Accepted(id) => self.ack(MavMissionResult::ACCEPTED, id, tx),
            What::Refused(result) => self.ack(result, 0, tx),
            _ => false,
        }
    }

    /// Sends a MISSION_ACK to who asked.
    pub(super) fn ack(&self, result: MavMissionResult, id: u32, tx: &mut Outbox) -> bool {
        tx.send(&MissionAck {
            target_system: self.to.system.0,
            target_component: self.to.component.0,
            r#type: result,
            mission_type: self.mission_type,
            opaque_id: id,
        })
    }
}

/// The answers that a link owes about plans.
#[derive(Clone, Debug)]
pub(crate) struct Replies {
    /// The oldest first.
    slots: Vec<Reply, SLOTS, u8>,
    /// The end of an upload or a clear that did not come of a frame: of a timer, or of storage. No `Option`, of which
    /// "none" would be bits that are not zero, and with it the initial value of every link in flash.
    result: Reply,
    /// Up to this time stray items are not answered, whoever sends them. In [`ticks`](Instant::ticks).
    strays_from: u32,
}

impl Replies {
    pub(crate) const fn new() -> Self {
        Self { slots: Vec::new(), result: Reply::NONE, strays_from: 0 }
    }

    /// Whether a MISSION_ACK is owed.
    pub(crate) fn has_ack(&self) -> bool {
        self.owes_result() || self.slots.iter().any(Reply::is_ack)
    }

    /// Whether anything is owed.
    pub(super) fn has_any(&self) -> bool {
        !self.slots.is_empty()
    }

    /// Whether nothing more can be owed.
    pub(super) fn is_full(&self) -> bool {
        self.slots.is_full()
    }

    /// Owes `reply`, once: a repeated request shares the slot. The caller asked [`is_full`](Self::is_full) before it did
    /// anything.
    pub(super) fn push(&mut self, reply: Reply) {
        if !self.slots.contains(&reply) {
            let _ = self.slots.push(reply);
        }
    }

    /// Takes the oldest MISSION_ACK, or the oldest of the others.
    pub(super) fn pop(&mut self, ack: bool) -> Option<Reply> {
        take_first(&mut self.slots, |reply| reply.is_ack() == ack)
    }

    /// Owes the end of an upload or a clear. What storage answers was given a free place before it began; only a timer's
    /// OPERATION_CANCELLED, which is a courtesy, can be in the way, and goes.
    pub(crate) fn owe_result(&mut self, reply: Reply) {
        self.result = reply;
    }

    /// Whether such an end is owed.
    pub(super) fn owes_result(&self) -> bool {
        self.result.kind != Kind::None
    }

    /// `client` begins anew: what he would hear of before, he would take for the answer to this.
    pub(super) fn forget_result(&mut self, client: Address) {
        if self.result.to == client {
            self.result = Reply::NONE;
        }
    }

    /// The line was opened anew: nobody is there any more to be told how his upload ended.
    pub(crate) fn restart(&mut self) {
        self.result = Reply::NONE;
    }

    /// Sends the oldest MISSION_ACK. False when none is owed.
    pub(crate) fn next_ack(&mut self, tx: &mut Outbox) -> bool {
        if self.owes_result() {
            return core::mem::replace(&mut self.result, Reply::NONE).send_ack(tx);
        }
        self.pop(true).is_some_and(|reply| reply.send_ack(tx))
    }

    /// Whether a stray item may be answered now; then the next one may not for a while.
    pub(super) fn may_answer_stray(&mut self, now: Instant) -> bool {
        let ahead = self.strays_from.wrapping_sub(now.ticks());
        let may = ahead == 0 || ahead > STRAY_PAUSE;
        if may {
            self.strays_from = now.ticks().wrapping_add(STRAY_PAUSE);
        }
        may
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// M-31, M-36: a second of silence, whatever the time is, also where its units wrap, and after a pause of any length.
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
    fn replies_come_out_as_they_went_in() {
        let whats = [
            What::Accepted(u32::MAX),
            What::Accepted(0),
            What::Refused(MavMissionResult(255)),
            What::Count,
            What::Item(u16::MAX),
            What::LegacyItem(1),
        ];
        let mut replies = Replies::new();
        let reply = |what| Reply::new(Address::new(255, 190), MavMissionType(9), what);
        for what in whats {
            assert!(!replies.is_full());
            replies.push(reply(what));
            replies.push(reply(what));
        }
        assert!(replies.is_full() && replies.has_ack());
        let order = [false, false, false, true, true, true].map(|ack| replies.pop(ack).map(|reply| reply.what()));
        assert_eq!(order.map(Option::unwrap), [whats[3], whats[4], whats[5], whats[0], whats[1], whats[2]]);
    }
}
