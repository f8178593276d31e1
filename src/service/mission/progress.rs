//! Reports of the vehicle's progress in its mission: MISSION_CURRENT and MISSION_ITEM_REACHED (M-53, M-90, M-91, M-94).

use core::num::Saturating;

use heapless::Vec;

use super::vehicle::Progress;
use crate::dialect::{MissionCurrent, MissionItemReached, MissionState};
use crate::link::Outbox;
use crate::list::take_first;
use crate::time::{Duration, Instant};
use crate::types::{LinkId, LinkMask, PlanType, PlansMut};

/// Interval between MISSION_CURRENT, and between the reports of an item.
const PERIOD: Duration = Duration::from_secs(1);

/// MISSION_CURRENT.total of a vehicle without a mission; 0 would mean "unknown".
const NO_ITEMS: u16 = u16::MAX;

/// MISSION_CURRENT.mission_mode.
const IN_MISSION_MODE: u8 = 1;
const SUSPENDED: u8 = 2;

/// Capacity of the queue of reached items that are not yet reported on every link.
const PENDING: usize = 4;
/// Maximum number of repeated reports of an item.
const MAX_REPEATS: u8 = 3;

/// MISSION_CURRENT, which is sent on every normal link once a second, and at once when anything in it changes.
#[derive(Clone, Debug)]
pub(super) struct Current {
    /// The links on which it is pending.
    pending: LinkMask,
    /// When it is sent on all links again, changed or not.
    due: Instant,
    /// The last reported progress.
    reported: Progress,
}

impl Current {
    pub(super) const fn new() -> Self {
        let reported = Progress { current: 0, state: MissionState(0), in_mission_mode: false };
        Self { pending: LinkMask::NONE, due: Instant::ZERO, reported }
    }

    /// Marks MISSION_CURRENT as pending on `links`.
    pub(super) fn announce(&mut self, links: LinkMask) {
        self.pending = self.pending.with(links);
    }

    /// Marks MISSION_CURRENT as pending on `links`, because the progress may have changed.
    pub(super) fn announce_progress(&mut self, progress: Progress, links: LinkMask) {
        self.reported = progress;
        self.announce(links);
    }

    pub(super) fn poll(&mut self, now: Instant, progress: Progress, links: LinkMask) {
        if now >= self.due {
            let next = self.due + PERIOD;
            self.due = if next > now { next } else { now + PERIOD };
            self.announce(links);
        }
        if self.reported != progress {
            self.announce_progress(progress, links);
        }
    }

    /// When [`poll`](Self::poll) is due.
    pub(super) fn deadline(&self) -> Instant {
        self.due
    }

    pub(super) fn is_pending(&self, link: LinkId) -> bool {
        self.pending.contains(link)
    }

    /// Sends MISSION_CURRENT. Returns false if the link cannot send it.
    pub(super) fn send(&mut self, plans: &PlansMut<'_>, progress: &Progress, tx: &mut Outbox) -> bool {
        self.pending = self.pending.without(LinkMask::of(tx.link()));
        let count = plans.count(PlanType::Mission);
        let (total, last, state) = match count {
            0 => (NO_ITEMS, 0, MissionState::NO_MISSION),
            count => (count, count.saturating_sub(1), progress.state),
        };
        let id = |plan| plans.live(plan).id();
        tx.send(&MissionCurrent {
            // Never beyond the end of the plan, whatever the vehicle reports (M-94).
            seq: progress.current.min(last),
            total,
            mission_state: state,
            mission_mode: if progress.in_mission_mode { IN_MISSION_MODE } else { SUSPENDED },
            mission_id: id(PlanType::Mission),
            fence_id: id(PlanType::Fence),
            rally_points_id: id(PlanType::Rally),
        })
    }
}

/// The pending MISSION_ITEM_REACHED, oldest first.
#[derive(Clone, Debug)]
pub(super) struct Reached(Vec<ReachedItem, PENDING, u8>);

#[derive(Clone, Debug)]
struct ReachedItem {
    seq: u16,
    /// The links on which it is pending.
    pending: LinkMask,
    /// Remaining repetitions.
    repeats: Saturating<u8>,
    /// When the next repetition is due.
    at: Instant,
}

impl Reached {
    pub(super) const fn new() -> Self {
        Self(Vec::new())
    }

    /// Drops all reports: their plan was replaced.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Queues the report on `links`: the vehicle has reached item `seq` (M-91).
    pub(super) fn push(&mut self, now: Instant, seq: u16, links: LinkMask, repeats: u8) {
        if self.0.is_full() {
            // Evict the oldest report: it was sent before, or its link has stalled. MISSION_CURRENT shows the progress
            // too.
            self.remove_first(|_| true);
        }
        let repeats = Saturating(repeats.min(MAX_REPEATS));
        let _ = self.0.push(ReachedItem { seq, pending: links, repeats, at: now + PERIOD });
    }

    /// Removes the oldest report that passes `test`. Returns whether there is one.
    fn remove_first(&mut self, test: fn(&ReachedItem) -> bool) -> bool {
        take_first(&mut self.0, test).is_some()
    }

    /// Makes the due repetitions pending on `links`.
    pub(super) fn poll(&mut self, now: Instant, links: LinkMask) {
        for item in self.0.iter_mut().filter(|item| item.repeats.0 > 0 && now >= item.at) {
            item.repeats -= 1;
            item.at = now + PERIOD;
            item.pending = links;
        }
    }

    /// When [`poll`](Self::poll) is due.
    pub(super) fn deadline(&self) -> Instant {
        let repeated = self.0.iter().filter(|item| item.repeats.0 > 0);
        repeated.map(|item| item.at).min().unwrap_or(Instant::NEVER)
    }

    pub(super) fn is_pending(&self, link: LinkMask) -> bool {
        self.0.iter().any(|item| item.pending.intersects(link))
    }

    /// Sends the oldest report that is pending on this link.
    pub(super) fn send(&mut self, tx: &mut Outbox) -> bool {
        let link = LinkMask::of(tx.link());
        let Some(item) = self.0.iter_mut().find(|item| item.pending.intersects(link)) else { return false };
        item.pending = item.pending.without(link);
        let seq = item.seq;
        while self.remove_first(|item| item.pending == LinkMask::NONE && item.repeats.0 == 0) {}
        tx.send(&MissionItemReached { seq })
    }
}
