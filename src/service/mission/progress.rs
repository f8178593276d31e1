//! Where the vehicle is in its mission: reports of it, and changes of the current item (M-53, M-90 to M-95).

use core::num::Saturating;

use heapless::Vec;

use super::Missions;
use super::problem::Problem;
use super::vehicle::{Plans, Progress};
use crate::dialect::{MavCmd, MavResult, MissionCurrent, MissionItemReached, MissionSetCurrent, MissionState};
use crate::link::Outbox;
use crate::list::take_first;
use crate::message::{ComponentId, Message};
use crate::num;
use crate::service::Cx;
use crate::time::{Duration, Instant};
use crate::types::{Command, CommandPosition, Firmware, LinkId, LinkMask, Origin, PlanType, PlansMut};

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

    /// The same, because the progress may have changed.
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
        self.pending.contains(LinkMask::of(link))
    }

    /// Sends MISSION_CURRENT.
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

    fn push(&mut self, item: ReachedItem) {
        if self.0.is_full() {
            // Evict the oldest report: it was sent before, or its link has stalled. MISSION_CURRENT shows the progress
            // too.
            self.remove_first(|_| true);
        }
        let _ = self.0.push(item);
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
        self.0.iter().any(|item| item.pending.contains(link))
    }

    /// Sends the oldest report that is pending on this link.
    pub(super) fn send(&mut self, tx: &mut Outbox) -> bool {
        let link = LinkMask::of(tx.link());
        let Some(item) = self.0.iter_mut().find(|item| item.pending.contains(link)) else { return false };
        item.pending = item.pending.without(link);
        let seq = item.seq;
        while self.remove_first(|item| item.pending == LinkMask::NONE && item.repeats.0 == 0) {}
        tx.send(&MissionItemReached { seq })
    }
}

impl Missions {
    /// Queues MISSION_ITEM_REACHED on `links`: the vehicle has reached item `seq` (M-91).
    pub(crate) fn reached(&mut self, now: Instant, seq: u16, links: LinkMask, repeats: u8) {
        let repeats = Saturating(repeats.min(MAX_REPEATS));
        self.reached.push(ReachedItem { seq, pending: links, repeats, at: now + PERIOD });
    }

    /// Handles MISSION_SET_CURRENT. It has no acknowledgement: MISSION_CURRENT shows success and failure, and a text
    /// reports a failure (M-93).
    pub(super) fn on_set_current<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, seq: u16) {
        let is_there = seq < cx.plans.count(PlanType::Mission);
        if is_there && go_to(cx, seq, false) == MavResult::ACCEPTED {
            self.current.announce_progress(cx.vehicle.progress(), cx.shared.normal);
        } else {
            self.refuse_current(cx, seq);
        }
    }

    /// Refuses to make the item current: sends a text, and the unchanged MISSION_CURRENT (M-93).
    pub(crate) fn refuse_current<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, seq: u16) {
        if let Some(refused) = self.refused.count(cx.now) {
            event!("current item {=u16}: refused; {=u32} refused so far", seq, refused);
        }
        Problem::NotCurrent(seq).report(cx);
        self.current.announce_progress(cx.vehicle.progress(), cx.shared.normal);
    }

    /// Handles a command about the mission's progress; returns `None` for all other commands. `Err` is a refusal by the
    /// stack, not by the vehicle.
    pub(crate) fn command<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        command: &Command,
    ) -> Option<Result<MavResult, MavResult>> {
        let count = cx.plans.count(PlanType::Mission);
        let result = match command.id {
            MavCmd::DO_SET_MISSION_CURRENT => set_current(cx, command, count),
            MavCmd::MISSION_START => start(cx, command, count),
            MavCmd::REQUEST_MESSAGE => return self.request_current(cx.shared.normal, command).map(Ok),
            _ => return None,
        };
        if result == Ok(MavResult::ACCEPTED) {
            self.current.announce_progress(cx.vehicle.progress(), cx.shared.normal);
        }
        Some(result)
    }

    /// Handles REQUEST_MESSAGE for MISSION_CURRENT, on a link that may send it.
    fn request_current(&mut self, links: LinkMask, command: &Command) -> Option<MavResult> {
        let [id, ..] = command.params;
        let link = LinkMask::of(command.from.link);
        if num::integer(id) != Some(MissionCurrent::ID) || !links.contains(link) || !command.has_response_target() {
            return None;
        }
        self.current.announce(link);
        Some(MavResult::ACCEPTED)
    }
}

/// Returns the command that is equivalent to a MISSION_SET_CURRENT (M-46).
pub(crate) fn from_set_current(message: &MissionSetCurrent, origin: Origin) -> Command {
    Command {
        id: MavCmd::DO_SET_MISSION_CURRENT,
        params: [message.seq.into(), 0.0, 0.0, 0.0],
        position: CommandPosition::Long { param5: 0.0, param6: 0.0 },
        z: 0.0,
        from: origin.from,
        class: origin.class,
        age: origin.age,
        component: ComponentId::new(message.target_component),
        is_broadcast: message.target_system == 0,
        confirmation: 0,
    }
}

/// Handles MAV_CMD_DO_SET_MISSION_CURRENT: parameter 1 is the item, or -1 for the current one; parameter 2 is 1 to
/// restart the jump counters (M-92).
fn set_current<F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    command: &Command,
    count: u16,
) -> Result<MavResult, MavResult> {
    let [item, reset, ..] = command.params;
    let reset = match num::integer::<i32>(reset) {
        Some(0) => false,
        Some(1) => true,
        None if reset.is_nan() => false,
        _ => return Err(MavResult::DENIED),
    };
    let seq = match num::integer::<i32>(item) {
        Some(-1) => Some(cx.vehicle.progress().current),
        Some(seq) if seq >= 0 => u16::try_from(seq).ok(),
        // Too large for an i32: an integer, but not an item of any plan.
        None if item > 1e9 && item.is_finite() => None,
        _ => return Err(MavResult::DENIED),
    };
    match seq.filter(|&seq| seq < count) {
        Some(seq) => Ok(go_to(cx, seq, reset)),
        None => Err(MavResult::FAILED),
    }
}

/// Makes item `seq` the current one. While the vehicle flies its mission, item 0 restarts it, and is checked like a
/// start (M-48).
fn go_to<F: Firmware<Vehicle: Plans>>(cx: &mut Cx<'_, F>, seq: u16, reset: bool) -> MavResult {
    let (vehicle, mut context) = cx.hook();
    if seq == 0
        && vehicle.progress().in_mission_mode
        && let Err(result) = vehicle.check_start(&mut context)
    {
        return result;
    }
    vehicle.set_current(&mut context, seq, reset)
}

/// Handles MAV_CMD_MISSION_START: parameters 1 and 2 are the first and the last item. NaN means "not given", and so
/// does 0 for the last item, because clients that leave it out send 0 (M-95).
fn start<F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    command: &Command,
    count: u16,
) -> Result<MavResult, MavResult> {
    if count == 0 {
        return Err(MavResult::FAILED);
    }
    let [first, last, ..] = command.params;
    let (first, last) = (item(first, count)?, item(last, count)?.filter(|&seq| seq > 0));
    if let (Some(first), Some(last)) = (first, last)
        && first > last
    {
        return Err(MavResult::DENIED);
    }
    let (vehicle, mut context) = cx.hook();
    let Progress { current, state, .. } = vehicle.progress();
    let resumed = if state == MissionState::COMPLETE { 0 } else { current };
    if first.unwrap_or(resumed) == 0
        && let Err(result) = vehicle.check_start(&mut context)
    {
        return Ok(result);
    }
    Ok(vehicle.start_mission(&mut context, command, first, last))
}

/// Returns the item that a parameter names; `None` for NaN.
fn item(param: f32, count: u16) -> Result<Option<u16>, MavResult> {
    let item = num::integer::<u16>(param).filter(|&seq| seq < count);
    if item.is_none() && !param.is_nan() { Err(MavResult::DENIED) } else { Ok(item) }
}
