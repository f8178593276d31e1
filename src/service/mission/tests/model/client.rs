//! The ground station of the model: MAVSDK's rules, as in its `MavlinkMissionTransferClient`.

use super::{Msg, Op};
use crate::dialect::MavMissionResult;
use crate::time::{Duration, Instant};

/// Time before it repeats a message, or counts a try.
const TIMEOUT: Duration = Duration::from_millis(500);

/// Number of tries before it gives up. MAVSDK tries five times; three outlive the faults of the model, and each further try
/// multiplies the states.
const TRIES: u8 = 3;

/// It knows that the vehicle abandons an upload after 6 s at most; by then no frame of it is in transit.
const PATIENCE: Duration = Duration::from_secs(8);

/// When the client begins its next task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Manners {
    /// When the vehicle's timeout for the last task has passed, even if it got a result, and no frame is in transit.
    Patient,
    /// When it got the result of the last task, or the vehicle's timeout has passed, and no frame is in transit.
    Result,
    /// When it got the result of the last task, or the vehicle's timeout has passed.
    Prompt,
    /// At any time.
    Hasty,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Idle until this time.
    Resting(Instant),
    Uploading {
        /// Number of items sent, as MAVSDK counts them: a request for an earlier item sets it back.
        next: u16,
        is_asked: bool,
        tries: u8,
        due: Instant,
    },
    Clearing {
        tries: u8,
        due: Instant,
    },
}

/// A client with a list of tasks.
#[derive(Clone, Debug)]
pub(super) struct Client {
    /// Number of tasks begun; the last one may be in progress.
    pub(super) begun: usize,
    pub(super) phase: Phase,
    /// The result of the last task, if it got one: whether it was accepted.
    pub(super) result: Option<bool>,
    manners: Manners,
}

impl Client {
    pub(super) fn new(now: Instant, manners: Manners) -> Self {
        Self { begun: 0, phase: Phase::Resting(now), result: None, manners }
    }

    pub(super) fn is_resting(&self) -> bool {
        matches!(self.phase, Phase::Resting(_))
    }

    /// When its next timer is due.
    pub(super) fn due(&self) -> Option<Instant> {
        match self.phase {
            Phase::Resting(_) => None,
            Phase::Uploading { due, .. } | Phase::Clearing { due, .. } => Some(due),
        }
    }

    /// Begins the next task.
    pub(super) fn begin(&mut self, now: Instant, op: Op) -> Msg {
        self.begun += 1;
        self.result = None;
        let due = now + TIMEOUT;
        self.phase = match op {
            Op::Upload(_) => Phase::Uploading { next: 0, is_asked: false, tries: 1, due },
            Op::Clear => Phase::Clearing { tries: 1, due },
        };
        self.request(op)
    }

    fn request(&self, op: Op) -> Msg {
        match op {
            Op::Upload(len) => Msg::Count(len),
            Op::Clear => Msg::Clear,
        }
    }

    /// Runs the timer. Returns the message to repeat.
    pub(super) fn timeout(&mut self, now: Instant, op: Op) -> Option<Msg> {
        let request = self.request(op);
        let (Phase::Uploading { tries, due, .. } | Phase::Clearing { tries, due }) = &mut self.phase else {
            return None;
        };
        if *tries >= TRIES {
            self.give_up(now);
            return None;
        }
        *tries += 1;
        *due = now + TIMEOUT;
        if matches!(self.phase, Phase::Uploading { is_asked: true, .. }) { None } else { Some(request) }
    }

    fn give_up(&mut self, now: Instant) {
        self.phase = Phase::Resting(now + PATIENCE);
    }

    /// Handles a request. Returns the item to send.
    pub(super) fn on_request(&mut self, now: Instant, seq: u16, op: Op) -> Option<Msg> {
        let Phase::Uploading { next, is_asked, tries, due } = &mut self.phase else { return None };
        *is_asked = true;
        if seq > *next {
            return None;
        }
        if seq == *next {
            *tries = 0;
        } else if *tries >= TRIES {
            self.give_up(now);
            return None;
        }
        *due = now + TIMEOUT;
        let Op::Upload(len) = op else { return None };
        if seq >= len {
            *next = seq;
            return None;
        }
        *next = seq + 1;
        *tries += 1;
        Some(Msg::Item { op: self.begun - 1, seq })
    }

    /// Handles MISSION_ACK.
    pub(super) fn on_ack(&mut self, now: Instant, result: MavMissionResult, op: Op) {
        let is_complete = match (self.phase, op) {
            (Phase::Resting(_), _) => return,
            (Phase::Uploading { next, .. }, Op::Upload(len)) => next == len,
            _ => true,
        };
        // ACCEPTED before the last item makes no sense: it is no result.
        let is_accepted = result == MavMissionResult::ACCEPTED;
        self.result = (is_complete || !is_accepted).then_some(is_accepted);
        if self.result.is_some() && self.manners != Manners::Patient {
            self.phase = Phase::Resting(now)
        } else {
            self.give_up(now)
        }
    }
}
