//! MISSION_CURRENT: where the vehicle is in its mission, and which plans it has (M-53, M-90, M-94).
//!
//! Sent on every normal link once a second, and at once when anything in it changes.

use super::Progress;
use crate::dialect::{MissionCurrent, MissionState};
use crate::link::Outbox;
use crate::time::{Duration, Instant};
use crate::types::{LinkId, LinkMask};
use crate::types::{PlanType, PlansMut};

const PERIOD: Duration = Duration::from_secs(1);

/// MISSION_CURRENT.total of a vehicle without a mission; 0 would mean "unknown".
const NO_ITEMS: u16 = u16::MAX;

/// MISSION_CURRENT.mission_mode.
const IN_MISSION_MODE: u8 = 1;
const SUSPENDED: u8 = 2;

/// The links on which MISSION_CURRENT is pending.
#[derive(Clone, Debug)]
pub(super) struct Current {
    pending: LinkMask,
    /// When it is sent on all links again, changed or not.
    due: Instant,
    /// The last reported progress.
    reported: Option<Progress>,
}

impl Current {
    /// All zero bits; see [`Missions`](super::Missions).
    pub(super) const VACANT: Self = Self {
        pending: LinkMask::NONE,
        due: Instant::ZERO,
        reported: Some(Progress { current: 0, state: MissionState(0), in_mission_mode: false }),
    };

    /// Sets the field whose initial value is not all zero bits.
    pub(super) fn begin(&mut self) {
        self.reported = None;
    }

    /// Marks MISSION_CURRENT as pending on `links`.
    pub(super) fn announce(&mut self, links: LinkMask) {
        self.pending = self.pending.with(links);
    }

    pub(super) fn poll(&mut self, now: Instant, progress: Progress, links: LinkMask) {
        if now >= self.due {
            let next = self.due + PERIOD;
            self.due = if next > now { next } else { now + PERIOD };
            self.announce(links);
        }
        if self.reported != Some(progress) {
            self.announce_progress(progress, links);
        }
    }

    /// Marks MISSION_CURRENT as pending on `links`, because the progress may have changed.
    pub(super) fn announce_progress(&mut self, progress: Progress, links: LinkMask) {
        self.reported = Some(progress);
        self.announce(links);
    }

    pub(super) fn deadline(&self) -> Instant {
        self.due
    }

    pub(super) fn is_pending(&self, link: LinkId) -> bool {
        self.pending.contains(LinkMask::of(link))
    }

    /// Sends MISSION_CURRENT.
    pub(super) fn next(&mut self, plans: &PlansMut<'_>, progress: &Progress, tx: &mut Outbox) -> bool {
        self.pending = self.pending.without(LinkMask::of(tx.link()));
        let count = plans.count(PlanType::Mission);
        let id = |plan| plans.live(plan).id();
        tx.send(&MissionCurrent {
            // Never beyond the end of the plan, whatever the vehicle reports (M-94).
            seq: progress.current.min(count.saturating_sub(1)),
            total: if count == 0 { NO_ITEMS } else { count },
            mission_state: if count == 0 { MissionState::NO_MISSION } else { progress.state },
            mission_mode: if progress.in_mission_mode { IN_MISSION_MODE } else { SUSPENDED },
            mission_id: id(PlanType::Mission),
            fence_id: id(PlanType::Fence),
            rally_points_id: id(PlanType::Rally),
        })
    }
}
