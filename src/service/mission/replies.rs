//! What one link owes to those who talk about plans: fixed slots, in the order of the questions.
//!
//! Each link has its own, so a link that stalls takes nothing from the others. What is owed is who asked for what; the
//! answer's content is looked up when it is sent, so it is never older than the frame that carries it.

use heapless::Deque;

use super::memory::PlanType;
use crate::dialect::{MavMissionResult, MavMissionType, MissionAck};
use crate::frame::Address;
use crate::link::Outbox;
use crate::time::{Duration, Instant};

/// Slots of each sort.
const SLOTS: usize = 3;

/// Items that belong to no upload are answered at most once in this time (M-31, M-36).
const STRAY_PAUSE: Duration = Duration::from_secs(1);

/// A MISSION_ACK that is owed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ack {
    pub(super) to: Address,
    /// As it came, also when it names no plan (M-25, M-26).
    pub(super) mission_type: MavMissionType,
    pub(super) result: MavMissionResult,
    /// The live plan's id, with ACCEPTED.
    pub(super) id: u32,
}

impl Ack {
    pub(super) fn send(&self, tx: &mut Outbox) -> bool {
        tx.send(&MissionAck {
            target_system: self.to.system.0,
            target_component: self.to.component.0,
            r#type: self.result,
            mission_type: self.mission_type,
            opaque_id: self.id,
        })
    }
}

/// A part of a live plan that somebody asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Answer {
    pub(super) to: Address,
    pub(super) plan: PlanType,
    pub(super) part: Part,
}

/// What was asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Part {
    /// How many items there are.
    Count,
    /// The item of this number.
    Item(u16),
    /// The same, asked for with the old MISSION_REQUEST.
    LegacyItem(u16),
}

/// The answers that a link owes about plans.
#[derive(Clone, Debug)]
pub(crate) struct Replies {
    acks: Deque<Ack, SLOTS>,
    answers: Deque<Answer, SLOTS>,
    /// Before this moment stray items are not answered.
    strays_from: Instant,
}

impl Replies {
    pub(crate) const fn new() -> Self {
        Self { acks: Deque::new(), answers: Deque::new(), strays_from: Instant::ZERO }
    }

    /// Whether a MISSION_ACK is owed.
    pub(crate) fn has_ack(&self) -> bool {
        !self.acks.is_empty()
    }

    /// Whether a part of a plan is owed.
    pub(crate) fn has_answer(&self) -> bool {
        !self.answers.is_empty()
    }

    /// Whether another MISSION_ACK can be owed.
    pub(super) fn can_ack(&self) -> bool {
        !self.acks.is_full()
    }

    /// Whether another part of a plan can be owed.
    pub(super) fn can_answer(&self) -> bool {
        !self.answers.is_full()
    }

    /// Owes `ack`, once: a repeated request shares the slot. The caller asked [`can_ack`](Self::can_ack) before it did
    /// anything.
    pub(super) fn push_ack(&mut self, ack: Ack) {
        if !self.acks.iter().any(|owed| *owed == ack) {
            let _ = self.acks.push_back(ack);
        }
    }

    /// Owes `answer`, once. The caller asked [`can_answer`](Self::can_answer).
    pub(super) fn push_answer(&mut self, answer: Answer) {
        if !self.answers.iter().any(|owed| *owed == answer) {
            let _ = self.answers.push_back(answer);
        }
    }

    pub(super) fn pop_ack(&mut self) -> Option<Ack> {
        self.acks.pop_front()
    }

    pub(super) fn pop_answer(&mut self) -> Option<Answer> {
        self.answers.pop_front()
    }

    /// Whether a stray item may be answered now; then the next one may not for a while.
    pub(super) fn may_answer_stray(&mut self, now: Instant) -> bool {
        let may = now >= self.strays_from;
        if may {
            self.strays_from = now.after(STRAY_PAUSE);
        }
        may
    }
}
