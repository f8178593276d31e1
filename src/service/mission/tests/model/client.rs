//! The ground station of the model: MAVSDK's rules, as in its `MavlinkMissionTransferClient`.

use super::{Msg, Op};
use crate::dialect::MavMissionResult;
use crate::time::{Duration, Instant};

/// So long it waits before it repeats something, or counts a wait.
const TIMEOUT: Duration = Duration::from_millis(500);

/// How often it sends or waits before it gives up. MAVSDK tries five times; less is enough to outlive the faults of the
/// model, and each try more multiplies the states.
const TRIES: u8 = 3;

/// It knows that the vehicle gives an upload up after 6 s at most; by then no frame of it is on the line any more either.
const PATIENCE: Duration = Duration::from_secs(8);

/// When it begins the next of its tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Manners {
    /// When the vehicle's patience with the last one is over, whatever it was told, and no frame is on the line.
    Patient,
    /// When it was told how the last one ended, or the vehicle's patience is over, and no frame is on the line.
    Told,
    /// When it was told how the last one ended, or the vehicle's patience is over.
    Prompt,
    /// At any time.
    Hasty,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Does nothing before this moment.
    Resting(Instant),
    Uploading {
        /// Items that were sent, as MAVSDK counts them: back again, when an earlier one is asked for.
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
    /// Tasks that it has begun; the last of them may be going on.
    pub(super) begun: usize,
    pub(super) phase: Phase,
    /// Whether the last task that it began was accepted, when it was told.
    pub(super) told: Option<bool>,
    manners: Manners,
}

impl Client {
    pub(super) fn new(now: Instant, manners: Manners) -> Self {
        Self { begun: 0, phase: Phase::Resting(now), told: None, manners }
    }

    pub(super) fn is_resting(&self) -> bool {
        matches!(self.phase, Phase::Resting(_))
    }

    /// When it does something though nothing comes.
    pub(super) fn due(&self) -> Option<Instant> {
        match self.phase {
            Phase::Resting(_) => None,
            Phase::Uploading { due, .. } | Phase::Clearing { due, .. } => Some(due),
        }
    }

    /// Begins the next task.
    pub(super) fn begin(&mut self, now: Instant, op: Op) -> Msg {
        self.begun += 1;
        self.told = None;
        let due = now.after(TIMEOUT);
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

    /// Its time is up: what it repeats.
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
        *due = now.after(TIMEOUT);
        if matches!(self.phase, Phase::Uploading { is_asked: true, .. }) { None } else { Some(request) }
    }

    fn give_up(&mut self, now: Instant) {
        self.phase = Phase::Resting(now.after(PATIENCE));
    }

    /// REQUEST comes: the item to send.
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
        *due = now.after(TIMEOUT);
        let Op::Upload(len) = op else { return None };
        if seq >= len {
            *next = seq;
            return None;
        }
        *next = seq + 1;
        *tries += 1;
        Some(Msg::Item { op: self.begun - 1, seq })
    }

    /// MISSION_ACK comes.
    pub(super) fn on_ack(&mut self, now: Instant, result: MavMissionResult, op: Op) {
        let is_complete = match (self.phase, op) {
            (Phase::Resting(_), _) => return,
            (Phase::Uploading { next, .. }, Op::Upload(len)) => next == len,
            _ => true,
        };
        // ACCEPTED in the middle makes no sense: it knows nothing.
        let is_accepted = result == MavMissionResult::ACCEPTED;
        self.told = (is_complete || !is_accepted).then_some(is_accepted);
        if self.told.is_some() && self.manners != Manners::Patient {
            self.phase = Phase::Resting(now)
        } else {
            self.give_up(now)
        }
    }
}
