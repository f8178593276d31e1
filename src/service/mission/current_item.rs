//! Commands and messages that change the current item, or start the mission (M-46, M-92, M-93, M-95).

use super::engine::Missions;
use super::problem::Problem;
use super::vehicle::{Plans, Progress};
use crate::dialect::{MavCmd, MavResult, MissionCurrent, MissionSetCurrent, MissionState};
use crate::message::{ComponentId, Message};
use crate::num;
use crate::service::Cx;
use crate::types::{Command, CommandPosition, Firmware, LinkMask, Origin, PlanType};

/// Whether the counters of the mission's jumps start again.
#[derive(Clone, Copy, PartialEq, Eq)]
enum JumpCounters {
    Keep,
    Reset,
}

impl Missions {
    /// Handles MISSION_SET_CURRENT. It has no acknowledgement: MISSION_CURRENT shows success and failure, and a text
    /// reports a failure (M-93).
    pub(super) fn on_set_current<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, seq: u16) {
        let exists = seq < cx.plans.count(PlanType::Mission);
        if exists && go_to(cx, seq, JumpCounters::Keep) == MavResult::ACCEPTED {
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

    /// Handles a command about the mission's progress. Returns the vehicle's result, or `Err` with that of a refusal by
    /// the stack. Returns `None` for all other commands.
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

    /// Handles REQUEST_MESSAGE for MISSION_CURRENT, on a link that may send it. Returns `None` for other requests
    /// and on other links.
    fn request_current(&mut self, links: LinkMask, command: &Command) -> Option<MavResult> {
        let [id, ..] = command.params;
        let link = LinkMask::of(command.from.link);
        if num::integer(id) != Some(MissionCurrent::ID) || !links.intersects(link) || !command.has_response_target() {
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
        trust: origin.trust,
        class: origin.class,
        age: origin.age,
        component: ComponentId::new(message.target_component),
        is_broadcast: message.target_system == 0,
        confirmation: 0,
    }
}

/// Handles MAV_CMD_DO_SET_MISSION_CURRENT: parameter 1 is the item, or -1 for the current one; parameter 2 is 1 to
/// restart the jump counters (M-92). Returns the vehicle's result.
///
/// # Errors
///
/// DENIED if a parameter is invalid, and FAILED if the mission has no such item.
fn set_current<F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    command: &Command,
    count: u16,
) -> Result<MavResult, MavResult> {
    let [item, reset, ..] = command.params;
    let jump_counters = match num::integer::<i32>(reset) {
        Some(0) => JumpCounters::Keep,
        Some(1) => JumpCounters::Reset,
        None if reset.is_nan() => JumpCounters::Keep,
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
        Some(seq) => Ok(go_to(cx, seq, jump_counters)),
        None => Err(MavResult::FAILED),
    }
}

/// Makes item `seq` the current one. While the vehicle flies its mission, item 0 restarts it, and is checked like a
/// start (M-48).
fn go_to<F: Firmware<Vehicle: Plans>>(cx: &mut Cx<'_, F>, seq: u16, jump_counters: JumpCounters) -> MavResult {
    let (vehicle, mut context) = cx.hook();
    if seq == 0
        && vehicle.progress().in_mission_mode
        && let Err(result) = vehicle.check_start(&mut context)
    {
        return result;
    }
    vehicle.set_current(&mut context, seq, jump_counters == JumpCounters::Reset)
}

/// Handles MAV_CMD_MISSION_START: parameters 1 and 2 are the first and the last item. NaN means "not given", and so
/// does 0 for the last item, because clients that leave it out send 0 (M-95). Returns the vehicle's result.
///
/// # Errors
///
/// FAILED if there is no mission, and DENIED if a parameter names no item of it, or the first item is after the last.
fn start<F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    command: &Command,
    count: u16,
) -> Result<MavResult, MavResult> {
    if count == 0 {
        return Err(MavResult::FAILED);
    }
    let [first, last, ..] = command.params;
    let is_given = [first, last].map(|param| !param.is_nan());
    let [first, last] = [first, last].map(|param| num::integer(param).filter(|seq: &u16| *seq < count));
    if is_given != [first.is_some(), last.is_some()] {
        return Err(MavResult::DENIED);
    }
    let last = last.filter(|seq| *seq > 0);
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
