//! The state of the plan service.

use super::download::Sessions;
use super::progress::{Current, Reached};
use super::transfer::{FinishedUpload, Ousted, SecondAnswer, Transfer};
use crate::log::RefusalLog;
use crate::message::Address;
use crate::service::write_schedule::WriteSchedule;
use crate::time::Instant;
use crate::types::{Durability, LinkMask};

counters! {
    /// Counters of the plan service. They wrap.
    PlanCounters {
        /// Accepted uploads.
        count accepted,
        /// Uploads refused because of an item, or because of the plan as a whole.
        count refused,
        /// Uploads that the client cancelled or restarted, or that timed out.
        count abandoned,
        /// Frames that do not fit the state of an upload: items that are repeated, out of order, "guided", or part of
        /// no upload; delayed duplicates; frames received on another link than the upload's.
        drop out_of_place,
        /// Requests dropped because their link had no free slot for the answer.
        drop no_answer_slot,
        /// Failed attempts to write plans to storage.
        count not_saved,
    }
}

/// The engine: the state of plan transfers. Its size does not depend on the plans' capacities.
#[derive(Clone, Debug)]
pub struct Missions {
    pub(super) transfer: Transfer,
    /// When a frame of the client of the upload or commit was last received on its link.
    pub(super) heard_at: Instant,
    /// When plans are written. It is dirty if the live plans must be, though no client waits for it.
    pub(super) schedule: WriteSchedule,
    pub(super) durability: Durability,
    pub(super) is_loading: bool,
    pub(super) finished: Option<FinishedUpload>,
    pub(super) second_answer: Option<SecondAnswer>,
    pub(super) ousted: Ousted,
    /// The last client that uploads or uploaded, and since when: its next upload does not always begin a new time.
    pub(super) uploader: Address,
    pub(super) uploads_since: Instant,
    pub(super) sessions: Sessions,
    pub(super) current: Current,
    pub(super) reached: Reached,
    /// Whether the distance of the live mission's first waypoint is not checked yet, because the position was not known
    /// (M-48).
    pub(super) is_distance_unchecked: bool,
    pub(super) counters: PlanCounters,
    pub(super) refused: RefusalLog,
    /// The final answers that are sent again.
    pub(super) repeated: RefusalLog,
}

impl Missions {
    /// All zero bits, so that the stack lies in `.bss`.
    pub(super) const INITIAL: Self = Self {
        transfer: Transfer::Idle,
        heard_at: Instant::ZERO,
        schedule: WriteSchedule::NEW,
        durability: Durability::Durable,
        is_loading: false,
        finished: None,
        second_answer: None,
        ousted: Ousted::NONE,
        uploader: Address::new(0, 0),
        uploads_since: Instant::ZERO,
        sessions: Sessions::new(),
        current: Current::new(),
        reached: Reached::new(),
        is_distance_unchecked: false,
        counters: PlanCounters::ZERO,
        refused: RefusalLog::NEW,
        repeated: RefusalLog::NEW,
    };

    /// Returns the counters.
    pub(crate) const fn counters(&self) -> &PlanCounters {
        &self.counters
    }

    /// Reports on `links` that the vehicle has reached item `seq` (M-91).
    pub(crate) fn reached(&mut self, now: Instant, seq: u16, links: LinkMask, repeats: u8) {
        self.reached.push(now, seq, links, repeats);
    }
}
