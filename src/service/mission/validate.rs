//! What can be said of an item without knowing the vehicle (section 8.6 of the rules, SEC-14), and how a refusal reads.

use super::commit::Change;
use super::item::{Item, Position, position};
use super::memory::{MAX_ITEMS, PlanType};
use super::rules::{CommandRule, ParamRule};
pub(super) use super::whole::check_plan;
use crate::dialect::command_rules::{
    NAV_FENCE_CIRCLE_EXCLUSION, NAV_FENCE_CIRCLE_INCLUSION, NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    NAV_FENCE_POLYGON_VERTEX_INCLUSION, NAV_FENCE_RETURN_POINT, NAV_RALLY_POINT,
};
use crate::dialect::{MavFrame, MavMissionResult};
use crate::message::Text;
use crate::service::statustext::MAX_TEXT_LEN;
use crate::vehicle::PlanFault;

/// A fence's altitudes say nothing but the return point's, and ground stations send relative ones; above terrain is
/// nowhere (M-80).
const FENCE_FRAMES: &[MavFrame] = &[MavFrame::GLOBAL, MavFrame::GLOBAL_RELATIVE_ALT];
/// A polygon that has more vertices than any plan can hold is never whole (M-81).
#[allow(clippy::as_conversions, reason = "const-evaluated; less than 65,536")]
const VERTICES: &[ParamRule] = &[ParamRule::integers(1, 3, MAX_ITEMS as i32)];
/// Above 0, which the definitions do not ask for.
const RADIUS: &[ParamRule] = &[ParamRule::at_least(1, f32::MIN_POSITIVE)];

/// What a fence is made of (M-80).
const FENCE: &[CommandRule] = &[
    NAV_FENCE_RETURN_POINT.with_frames(FENCE_FRAMES),
    vertex(NAV_FENCE_POLYGON_VERTEX_INCLUSION),
    vertex(NAV_FENCE_POLYGON_VERTEX_EXCLUSION),
    circle(NAV_FENCE_CIRCLE_INCLUSION),
    circle(NAV_FENCE_CIRCLE_EXCLUSION),
];
/// M-84
const RALLY: &[CommandRule] = &[NAV_RALLY_POINT];

const fn vertex(rule: CommandRule) -> CommandRule {
    rule.with_frames(FENCE_FRAMES).with_params(VERTICES)
}

const fn circle(rule: CommandRule) -> CommandRule {
    rule.with_frames(FENCE_FRAMES).with_params(RADIUS)
}

/// Checks one item: that the plan takes its command, then frame, parameters and position, by the command's rule. `mission`
/// has the commands that the vehicle flies; fences and rally points have their own.
pub(super) fn check_item(plan: PlanType, mission: &[CommandRule], item: &Item) -> Result<(), MavMissionResult> {
    let rules = match plan {
        PlanType::Mission => mission,
        PlanType::Fence => FENCE,
        PlanType::Rally => RALLY,
    };
    let rule = rules.iter().find(|rule| rule.command() == item.command);
    rule.ok_or(MavMissionResult::UNSUPPORTED)?.check(item)
}

const MAX_LATITUDE: u32 = 900_000_000;
const MAX_LONGITUDE: u32 = 1_800_000_000;

/// Refuses frames that we do not know, positions that are not on the globe, and numbers that are none. NaN in parameters
/// and `i32::MAX` in positions pass: they mean "default" (M-70), and whether a command has one is the vehicle's to say.
pub(super) fn check(item: &Item) -> Result<(), MavMissionResult> {
    let position = position(item.frame).ok_or(MavMissionResult::UNSUPPORTED_FRAME)?;
    let [p1, p2, p3, p4] = item.params;
    refuse(p1.is_infinite(), MavMissionResult::INVALID_PARAM1)?;
    refuse(p2.is_infinite(), MavMissionResult::INVALID_PARAM2)?;
    refuse(p3.is_infinite(), MavMissionResult::INVALID_PARAM3)?;
    refuse(p4.is_infinite(), MavMissionResult::INVALID_PARAM4)?;
    let is_global = position == Position::Global;
    let beyond = |value: i32, limit| is_global && value != i32::MAX && value.unsigned_abs() > limit;
    refuse(beyond(item.x, MAX_LATITUDE), MavMissionResult::INVALID_PARAM5_X)?;
    refuse(beyond(item.y, MAX_LONGITUDE), MavMissionResult::INVALID_PARAM6_Y)?;
    // Without a position z is parameter 7, and clients send NaN for one that the command does not use.
    refuse(item.z.is_infinite() || (is_global && item.z.is_nan()), MavMissionResult::INVALID_PARAM7)
}

fn refuse(bad: bool, result: MavMissionResult) -> Result<(), MavMissionResult> {
    if bad { Err(result) } else { Ok(()) }
}

/// A text for the operator.
#[cfg(feature = "plan-texts")]
pub(super) type Words = Text<MAX_TEXT_LEN>;

#[cfg(feature = "plan-texts")]
pub(super) fn text(words: &Words) -> Option<&Text<MAX_TEXT_LEN>> {
    Some(words)
}

/// The place of a text where there are none: nothing of it is left in the firmware.
#[cfg(not(feature = "plan-texts"))]
pub(super) struct Words;

#[cfg(not(feature = "plan-texts"))]
impl Words {
    fn new(_: &str) -> Self {
        Self
    }

    fn push_str(&mut self, _: &str) {}

    pub(super) fn push_number(&mut self, _: u32) {}
}

#[cfg(not(feature = "plan-texts"))]
pub(super) fn text(_: &Words) -> Option<&Text<MAX_TEXT_LEN>> {
    None
}

/// Begins a text about a plan.
pub(super) fn words(plan: PlanType, text: &str) -> Words {
    let mut words = Words::new(match plan {
        PlanType::Mission => "Mission",
        PlanType::Fence => "Fence",
        PlanType::Rally => "Rally",
    });
    words.push_str(text);
    words
}

/// "Mission item 12: parameter 3 out of range": MISSION_ACK itself has no room for the number (M-38).
pub(super) fn item_refused(plan: PlanType, seq: u16, result: MavMissionResult) -> Words {
    let mut words = words(plan, " item ");
    words.push_number(seq.into());
    push_reason(&mut words, result);
    words
}

/// "Mission refused: not consistent", or as [`item_refused`] says it where an item is to blame.
pub(super) fn plan_refused(plan: PlanType, fault: impl Into<PlanFault>) -> Words {
    let PlanFault { seq, result } = fault.into();
    if let Some(seq) = seq {
        return item_refused(plan, seq, result);
    }
    let mut words = words(plan, " refused");
    push_reason(&mut words, result);
    words
}

/// "Mission item 12 cannot be made current" (M-93).
pub(super) fn current_refused(seq: u16) -> Words {
    let mut words = words(PlanType::Mission, " item ");
    words.push_number(seq.into());
    words.push_str(" cannot be made current");
    words
}

/// "Mission not stored: the old one stays": what was to be written first, or what is live without being stored.
pub(super) fn not_saved(change: Option<&Change>) -> Words {
    match change {
        Some(Change::Upload { plan, .. }) => words(*plan, " not stored: the old one stays"),
        Some(Change::Clear(Some(plan))) => words(*plan, " not cleared: storage failed"),
        Some(Change::Clear(None)) => Words::new("Plans not cleared: storage failed"),
        None => Words::new("Plan storage failed"),
    }
}

fn push_reason(words: &mut Words, result: MavMissionResult) {
    words.push_str(": ");
    let reason = match result {
        MavMissionResult::UNSUPPORTED_FRAME => "frame not supported",
        MavMissionResult::UNSUPPORTED => "command not supported",
        MavMissionResult::NO_SPACE => "too many items",
        MavMissionResult::INVALID => "not consistent",
        MavMissionResult::DENIED => "not allowed now",
        MavMissionResult(code @ 6..=12) => {
            // INVALID_PARAM1 and those that follow it.
            words.push_str("parameter ");
            words.push_number(u32::from(code).saturating_sub(5));
            " out of range"
        }
        _ => "refused by the vehicle",
    };
    words.push_str(reason);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::MavFrame;

    const NAN: f32 = f32::NAN;
    const HOME: Item = Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: crate::dialect::MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [0.0, NAN, NAN, NAN],
        x: 473_977_432,
        y: 85_455_942,
        z: 20.0,
    };

    #[test]
    fn a_position_on_the_globe_passes() {
        // M-4, M-70
        for frame in [0, 2, 3, 5, 6, 10, 11].map(MavFrame) {
            for (x, y) in [(900_000_000, -1_800_000_000), (-900_000_000, 1_800_000_000), (i32::MAX, i32::MAX)] {
                assert_eq!(check(&Item { frame, x, y, ..HOME }), Ok(()));
            }
        }
    }

    #[test]
    fn each_fault_has_its_own_code() {
        // Section 8.6, SEC-14
        let infinite = f32::NEG_INFINITY;
        for (item, code) in [
            (Item { frame: MavFrame::BODY_FRD, ..HOME }, MavMissionResult::UNSUPPORTED_FRAME),
            (Item { frame: MavFrame(99), ..HOME }, MavMissionResult::UNSUPPORTED_FRAME),
            (Item { params: [infinite, 0.0, 0.0, 0.0], ..HOME }, MavMissionResult::INVALID_PARAM1),
            (Item { params: [0.0, infinite, 0.0, 0.0], ..HOME }, MavMissionResult::INVALID_PARAM2),
            (Item { params: [0.0, 0.0, infinite, 0.0], ..HOME }, MavMissionResult::INVALID_PARAM3),
            (Item { params: [0.0, 0.0, 0.0, infinite], ..HOME }, MavMissionResult::INVALID_PARAM4),
            (Item { x: 900_000_001, ..HOME }, MavMissionResult::INVALID_PARAM5_X),
            (Item { x: i32::MIN, ..HOME }, MavMissionResult::INVALID_PARAM5_X),
            (Item { y: -1_800_000_001, ..HOME }, MavMissionResult::INVALID_PARAM6_Y),
            (Item { y: i32::MAX - 1, ..HOME }, MavMissionResult::INVALID_PARAM6_Y),
            (Item { z: NAN, ..HOME }, MavMissionResult::INVALID_PARAM7),
            (Item { z: infinite, ..HOME }, MavMissionResult::INVALID_PARAM7),
            (Item { frame: MavFrame::MISSION, z: infinite, ..HOME }, MavMissionResult::INVALID_PARAM7),
        ] {
            assert_eq!(check(&item), Err(code), "{item:?}");
        }
    }

    #[test]
    fn without_a_position_the_numbers_are_free() {
        // MAVSDK's speed and camera items: frame MISSION, parameter 7 NaN.
        let free = Item { frame: MavFrame::MISSION, x: i32::MIN, y: 1_900_000_000, z: NAN, ..HOME };
        assert_eq!(check(&free), Ok(()));
    }

    #[test]
    fn texts_name_the_item_and_the_reason() {
        // M-38
        let text = item_refused(PlanType::Mission, 12, MavMissionResult::INVALID_PARAM5_X);
        assert_eq!(text.as_str(), Some("Mission item 12: parameter 5 out of range"));
        let text = plan_refused(PlanType::Fence, MavMissionResult::INVALID);
        assert_eq!(text.as_str(), Some("Fence refused: not consistent"));
    }
}
