//! Where the mission goes on from, and which items were reached (M-91 to M-95).

use heapless::Vec;

use super::memory::{PlanType, PlansMut};
use super::validate::Trouble;
use super::{Context, Missions};
use crate::dialect::{MavCmd, MavResult, MissionCurrent, MissionItemReached, MissionSetCurrent};
use crate::link::{LinkMask, Outbox};
use crate::list::take_first;
use crate::message::Message;
use crate::num;
use crate::service::command::Origin;
use crate::time::{Duration, Instant};
use crate::vehicle::{Command, CommandPosition, Plans, Progress};

/// Items that were reached and not yet told of on every link.
const PENDING: usize = 4;
/// How often one is told of again, at most, and when.
const MAX_REPEATS: u8 = 3;
const PERIOD: Duration = Duration::from_secs(1);

/// What is still to be said of items that were reached, the oldest first.
#[derive(Clone, Debug)]
pub(super) struct Reached(Vec<Entry, PENDING, u8>);

#[derive(Clone, Debug)]
struct Entry {
    seq: u16,
    owed: LinkMask,
    /// How many times more it is said, and when next.
    repeats: u8,
    at: Instant,
}

impl Reached {
    pub(super) const fn new() -> Self {
        Self(Vec::new())
    }

    /// The items were those of a plan that is no more.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    fn push(&mut self, entry: Entry) {
        if self.0.is_full() {
            // Of a link that has stalled, or said before: what is missed, MISSION_CURRENT says as well.
            self.0.remove(0);
        }
        let _ = self.0.push(entry);
    }

    /// Says again what is to be said again.
    pub(super) fn poll(&mut self, now: Instant, links: LinkMask) {
        for entry in self.0.iter_mut().filter(|entry| entry.repeats > 0 && now >= entry.at) {
            entry.repeats = entry.repeats.saturating_sub(1);
            entry.at = now.after(PERIOD);
            entry.owed = links;
        }
    }

    /// When [`poll`](Self::poll) has something to do.
    pub(super) fn deadline(&self) -> Instant {
        let repeated = self.0.iter().filter(|entry| entry.repeats > 0);
        repeated.map(|entry| entry.at).min().unwrap_or(Instant::NEVER)
    }

    pub(super) fn is_owed(&self, link: LinkMask) -> bool {
        self.0.iter().any(|entry| entry.owed.contains(link))
    }

    /// Sends the oldest that is owed on this link.
    fn next(&mut self, tx: &mut Outbox) -> bool {
        let link = LinkMask::of(tx.link());
        let Some(entry) = self.0.iter_mut().find(|entry| entry.owed.contains(link)) else { return false };
        entry.owed = entry.owed.without(link);
        let seq = entry.seq;
        while take_first(&mut self.0, |entry| entry.owed == LinkMask::NONE && entry.repeats == 0).is_some() {}
        tx.send(&MissionItemReached { seq })
    }
}

impl Missions {
    /// The vehicle has reached an item (M-91).
    pub(crate) fn reached(&mut self, now: Instant, seq: u16, links: LinkMask, repeats: u8) {
        self.reached.push(Entry { seq, owed: links, repeats: repeats.min(MAX_REPEATS), at: now.after(PERIOD) });
    }

    /// Sends MISSION_ITEM_REACHED, or MISSION_CURRENT: in this order, so that an item was reached before the next one is
    /// current (M-91). False when neither is owed on this link.
    pub(crate) fn next_progress(&mut self, plans: &PlansMut<'_>, progress: &Progress, tx: &mut Outbox) -> bool {
        self.reached.next(tx) || self.current.next(plans, progress, tx)
    }

    /// MISSION_SET_CURRENT, which has no answer of its own: success and failure show in MISSION_CURRENT, failure in a text
    /// too (M-93).
    pub(super) fn on_set_current<V: Plans>(&mut self, cx: &mut Context<'_, '_>, vehicle: &mut V, seq: u16) {
        let is_there = seq < cx.plans.count(PlanType::Mission);
        if is_there && vehicle.set_current(seq, false) == MavResult::ACCEPTED {
            self.current.announce_progress(vehicle.progress(), cx.normal);
        } else {
            self.refuse_current(cx, vehicle, seq);
        }
    }

    /// Refuses to make the item current: sends a text, and the unchanged MISSION_CURRENT (M-93).
    pub(crate) fn refuse_current<V: Plans>(&mut self, cx: &mut Context<'_, '_>, vehicle: &V, seq: u16) {
        event!("current item {=u16}: refused", seq);
        cx.tell(&Trouble::NotCurrent(seq));
        self.current.announce_progress(vehicle.progress(), cx.normal);
    }

    /// Handles a command about the mission's progress; `None` for all others. An error is a refusal by the stack, not by the
    /// vehicle.
    #[inline(never)]
    pub(crate) fn on_command<V: Plans>(
        &mut self,
        cx: &mut Context<'_, '_>,
        vehicle: &mut V,
        command: &Command,
    ) -> Option<Result<MavResult, MavResult>> {
        let count = cx.plans.count(PlanType::Mission);
        let result = match command.id {
            MavCmd::DO_SET_MISSION_CURRENT => set_current(vehicle, command, count),
            MavCmd::MISSION_START => start(vehicle, command, count),
            MavCmd::REQUEST_MESSAGE => return self.request_current(cx.normal, command).map(Ok),
            _ => return None,
        };
        if result == Ok(MavResult::ACCEPTED) {
            self.current.announce_progress(vehicle.progress(), cx.normal);
        }
        Some(result)
    }

    /// MISSION_CURRENT, where it may be sent, and if it is what is asked for.
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
        is_broadcast: message.target_system == 0,
        confirmation: 0,
    }
}

/// MAV_CMD_DO_SET_MISSION_CURRENT: the item, or -1 for the one that is current; 1 to begin its counters anew (M-92).
fn set_current<V: Plans>(vehicle: &mut V, command: &Command, count: u16) -> Result<MavResult, MavResult> {
    let [item, reset, ..] = command.params;
    let reset = match num::integer::<i32>(reset) {
        Some(0) => false,
        Some(1) => true,
        None if reset.is_nan() => false,
        _ => return Err(MavResult::DENIED),
    };
    let seq = match num::integer::<i32>(item) {
        Some(-1) => Some(vehicle.progress().current),
        Some(seq) if seq >= 0 => u16::try_from(seq).ok(),
        // Whole numbers, and no item of any plan.
        None if item > 1e9 && item.is_finite() => None,
        _ => return Err(MavResult::DENIED),
    };
    match seq.filter(|&seq| seq < count) {
        Some(seq) => Ok(vehicle.set_current(seq, reset)),
        None => Err(MavResult::FAILED),
    }
}

/// MAV_CMD_MISSION_START: the first item and the last one; NaN says neither, nor does 0 as the last, which is what clients
/// send that leave it out (M-95).
fn start<V: Plans>(vehicle: &mut V, command: &Command, count: u16) -> Result<MavResult, MavResult> {
    if count == 0 {
        return Err(MavResult::FAILED);
    }
    let [first, last, ..] = command.params;
    let item = |param: f32| num::integer::<u16>(param).filter(|&seq| seq < count);
    let (first_item, last_item) = (item(first), item(last));
    if (first_item.is_none() && !first.is_nan()) || (last_item.is_none() && !last.is_nan()) {
        return Err(MavResult::DENIED);
    }
    let last_item = last_item.filter(|&seq| seq > 0);
    match (first_item, last_item) {
        (Some(first), Some(last)) if first > last => Err(MavResult::DENIED),
        (first, last) => Ok(vehicle.start_mission(command, first, last)),
    }
}
