//! MISSION_CURRENT: where the vehicle is in its mission, and which plans it has (M-90).
//!
//! Sent on every normal link once a second, and at once when anything in it changes.

use super::memory::{PlanType, PlansMut};
use crate::dialect::{MissionCurrent, MissionState};
use crate::link::{LinkId, LinkMask, Outbox};
use crate::time::{Duration, Instant};
use crate::vehicle::Progress;

const PERIOD: Duration = Duration::from_secs(1);

/// MISSION_CURRENT.total of a vehicle without a mission: 0 would mean "cannot tell".
const NO_ITEMS: u16 = u16::MAX;

/// MISSION_CURRENT.mission_mode.
const IN_MISSION_MODE: u8 = 1;
const SUSPENDED: u8 = 2;

/// Who is to be told.
#[derive(Clone, Debug)]
pub(super) struct Current {
    owed: LinkMask,
    /// When everyone is told, changed or not.
    due: Instant,
    /// What was told last.
    told: Option<Progress>,
}

impl Current {
    pub(super) const fn new() -> Self {
        Self { owed: LinkMask::NONE, due: Instant::ZERO, told: None }
    }

    /// Something changed: `links` are to be told.
    pub(super) fn announce(&mut self, links: LinkMask) {
        self.owed = self.owed.with(links);
    }

    pub(super) fn poll(&mut self, now: Instant, progress: Progress, links: LinkMask) {
        if now >= self.due {
            let next = self.due.after(PERIOD);
            self.due = if next > now { next } else { now.after(PERIOD) };
            self.announce(links);
        }
        if self.told != Some(progress) {
            self.announce_progress(progress, links);
        }
    }

    /// The vehicle is, or may be, somewhere else in its mission: `links` are to be told.
    pub(super) fn announce_progress(&mut self, progress: Progress, links: LinkMask) {
        self.told = Some(progress);
        self.announce(links);
    }

    pub(super) fn deadline(&self) -> Instant {
        self.due
    }

    pub(super) fn is_owed(&self, link: LinkId) -> bool {
        self.owed.contains(LinkMask::of(link))
    }

    /// Sends it, when it is owed on this link.
    pub(super) fn next(&mut self, plans: &PlansMut<'_>, progress: &Progress, tx: &mut Outbox) -> bool {
        if !self.is_owed(tx.link()) {
            return false;
        }
        self.owed = self.owed.without(LinkMask::of(tx.link()));
        let count = plans.count(PlanType::Mission);
        let id = |plan| plans.live(plan).id();
        tx.send(&MissionCurrent {
            // Never beyond the plan, whatever the vehicle says (M-94).
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
