//! Checks of an item that do not depend on the vehicle (M-38, M-73, SEC-14), and the texts of refusals.

use super::PlanFault;
use super::commit::Change;
pub(super) use super::whole::check_plan;
use crate::dialect::rules::{
    NAV_FENCE_CIRCLE_EXCLUSION, NAV_FENCE_CIRCLE_INCLUSION, NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    NAV_FENCE_POLYGON_VERTEX_INCLUSION, NAV_FENCE_RETURN_POINT, NAV_RALLY_POINT,
};
use crate::dialect::{MavCmd, MavFrame, MavMissionResult};
use crate::message::Item;
use crate::message::Text;
use crate::message::{CommandRule, ParamRule};
use crate::types::{MAX_ITEMS, ONE_FRAME, PlanType};

/// Only the return point of a fence has a meaningful altitude, and ground stations send relative ones. Altitudes above terrain
/// are refused (M-80).
const FENCE_FRAMES: &[MavFrame] = &[MavFrame::GLOBAL, MavFrame::GLOBAL_RELATIVE_ALT];
/// A polygon with more vertices than a plan can hold cannot be complete (M-81).
#[allow(clippy::as_conversions, reason = "const-evaluated; less than 65,536")]
const VERTICES: &[ParamRule] = &[ParamRule::integers(1, 3, MAX_ITEMS as i32)];
/// A radius is greater than 0; the definitions do not require that.
const RADIUS: &[ParamRule] = &[ParamRule::at_least(1, f32::MIN_POSITIVE)];

/// The commands of a fence (M-80).
const FENCE: &[CommandRule] = &[
    NAV_FENCE_RETURN_POINT.with_frames(FENCE_FRAMES),
    vertex(NAV_FENCE_POLYGON_VERTEX_INCLUSION),
    vertex(NAV_FENCE_POLYGON_VERTEX_EXCLUSION),
    circle(NAV_FENCE_CIRCLE_INCLUSION),
    circle(NAV_FENCE_CIRCLE_EXCLUSION),
];
/// The commands of rally points (M-84).
const RALLY: &[CommandRule] = &[NAV_RALLY_POINT];

const fn vertex(rule: CommandRule) -> CommandRule {
    rule.with_frames(FENCE_FRAMES).with_params(VERTICES)
}

const fn circle(rule: CommandRule) -> CommandRule {
    rule.with_frames(FENCE_FRAMES).with_params(RADIUS)
}

/// Returns the rule of a command in this plan. `mission` has the rules of the vehicle's missions; fences and rally points have
/// fixed ones.
pub(super) fn rule(
    plan: PlanType,
    mission: &'static [CommandRule],
    command: MavCmd,
) -> Result<&'static CommandRule, MavMissionResult> {
    let rules = match plan {
        PlanType::Mission => mission,
        PlanType::Fence => FENCE,
        PlanType::Rally => RALLY,
    };
    rules.iter().find(|rule| rule.command() == command).ok_or(MavMissionResult::UNSUPPORTED)
}

/// Checks an item against the rule of its command. `has_terrain`: whether the vehicle has a model of the terrain (M-49).
pub(super) fn check_item(
    plan: PlanType,
    mission: &'static [CommandRule],
    item: &Item,
    has_terrain: bool,
) -> Result<(), MavMissionResult> {
    rule(plan, mission, item.command)?.check_for(item, has_terrain)
}

/// A problem with a plan that is reported to the operators by a text (feature `plan-texts`).
pub(super) enum Problem<'a> {
    /// "Mission item 12: parameter 3 out of range", because MISSION_ACK has no field for the item (M-38). "Mission refused:
    /// not consistent" if no item is at fault.
    Refused(PlanType, PlanFault),
    /// "Mission item 2: no position (0, 0)" (M-48).
    NoPosition(PlanType, u16),
    /// "Mission item 0: more than 10000 m away" (M-48).
    TooFar(u16, u32),
    /// "Mission refused: no position yet", because the distance of its first waypoint is not checked (M-48).
    NotChecked,
    /// "Mission refused: stored too often, try later" (C-15).
    RateLimited(PlanType),
    /// "Mission upload timed out at item 12".
    TimedOut(PlanType, u16),
    /// "Mission item 12 cannot be made current" (M-93).
    NotCurrent(u16),
    /// An item with `current` 2 or 3 (M-34).
    Guided,
    /// "Mission not stored: the old one stays" for a durable change; "Plan storage failed" if a live plan could not be stored.
    NotSaved(Option<&'a Change>),
}

impl Problem<'_> {
    /// Returns the problem with an item that is refused with this result. `rule`: that of its command. Inlined, because it is nothing
    /// without texts.
    #[inline]
    pub(super) fn of_item(
        plan: PlanType,
        seq: u16,
        item: &Item,
        rule: Result<&CommandRule, MavMissionResult>,
        result: MavMissionResult,
    ) -> Self {
        // 0 in an integer and in a float have the same bits.
        let is_unset = result == MavMissionResult::INVALID_PARAM5_X && (item.x, item.y) == (0, 0);
        if is_unset && rule.is_ok_and(CommandRule::is_located) {
            Self::NoPosition(plan, seq)
        } else {
            Self::Refused(plan, PlanFault { seq: Some(seq), result })
        }
    }

    /// Returns the fault in the plan; ERROR if the problem is not a fault of the plan.
    pub(super) fn fault(&self) -> PlanFault {
        match *self {
            Self::Refused(_, fault) => fault,
            Self::NoPosition(_, seq) | Self::TooFar(seq, _) => {
                PlanFault { seq: Some(seq), result: MavMissionResult::INVALID_PARAM5_X }
            }
            _ => MavMissionResult::ERROR.into(),
        }
    }

    /// Writes the text into `text`, which is empty, so that only one text is on the stack.
    pub(super) fn write(&self, text: &mut Text<ONE_FRAME>) {
        let name = |plan| match plan {
            PlanType::Mission => "Mission",
            PlanType::Fence => "Fence",
            PlanType::Rally => "Rally",
        };
        let (subject, what, seq) = match self {
            Self::Refused(plan, PlanFault { seq: None, .. }) => (name(*plan), " refused", None),
            Self::Refused(plan, PlanFault { seq, .. }) => (name(*plan), " item ", *seq),
            Self::NoPosition(plan, seq) => (name(*plan), " item ", Some(*seq)),
            Self::TooFar(seq, _) => (name(PlanType::Mission), " item ", Some(*seq)),
            Self::NotChecked => (name(PlanType::Mission), " refused: no position yet", None),
            Self::RateLimited(plan) => (name(*plan), " refused: stored too often, try later", None),
            Self::TimedOut(plan, seq) => (name(*plan), " upload timed out at item ", Some(*seq)),
            Self::NotCurrent(seq) => (name(PlanType::Mission), " item ", Some(*seq)),
            Self::Guided => ("Guided items not supported: send DO_REPOSITION", "", None),
            Self::NotSaved(Some(Change::Upload { plan, .. })) => (name(*plan), " not stored: the old one stays", None),
            Self::NotSaved(Some(Change::Clear(plan))) => {
                (plan.map_or("Plans", name), " not cleared: storage failed", None)
            }
            Self::NotSaved(None) => ("Plan storage failed", "", None),
        };
        text.push_str(subject);
        text.push_str(what);
        if let Some(seq) = seq {
            text.push_number(seq.into());
        }
        match self {
            Self::Refused(_, fault) => push_reason(text, fault.result),
            Self::NotCurrent(_) => text.push_str(" cannot be made current"),
            Self::NoPosition(..) => text.push_str(": no position (0, 0)"),
            Self::TooFar(_, limit) => {
                text.push_str(": more than ");
                text.push_number(*limit);
                text.push_str(" m away");
            }
            Self::TimedOut(..) | Self::Guided | Self::NotSaved(_) | Self::RateLimited(_) | Self::NotChecked => {}
        }
    }
}

fn push_reason(text: &mut Text<ONE_FRAME>, result: MavMissionResult) {
    text.push_str(": ");
    let reason = match result {
        MavMissionResult::UNSUPPORTED_FRAME => "frame not supported",
        MavMissionResult::UNSUPPORTED => "command not supported",
        MavMissionResult::NO_SPACE => "too many items",
        MavMissionResult::INVALID => "not consistent",
        MavMissionResult::DENIED => "not allowed now",
        MavMissionResult(code @ 6..=12) => {
            // INVALID_PARAM1 to INVALID_PARAM7.
            text.push_str("parameter ");
            text.push_number(u32::from(code).saturating_sub(5));
            " out of range"
        }
        _ => "refused by the vehicle",
    };
    text.push_str(reason);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::MavCmd;
    use crate::dialect::rules::{
        CONDITION_CHANGE_ALT, DO_CHANGE_ALTITUDE, DO_CHANGE_SPEED, NAV_CONTINUE_AND_CHANGE_ALT, NAV_LAND, NAV_WAYPOINT,
    };
    use std::vec::Vec;

    const NAN: f32 = f32::NAN;
    const COMMANDS: &[CommandRule] = &[NAV_WAYPOINT, NAV_LAND, DO_CHANGE_SPEED];
    const ON_EARTH: Item = Item {
        frame: MavFrame::GLOBAL,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [0.0; 4],
        x: 473_977_432,
        y: 85_455_942,
        z: 20.0,
    };

    fn mission(item: &Item) -> Result<(), MavMissionResult> {
        check_item(PlanType::Mission, COMMANDS, item, true)
    }

    fn fence(command: MavCmd, p1: f32) -> Item {
        Item { command, params: [p1, 0.0, 0.0, 0.0], ..ON_EARTH }
    }

    /// M-38, SEC-14: for each code an item that is refused, and a similar one that passes.
    #[test]
    fn each_fault_has_its_own_code() {
        let speed = |params| Item {
            command: MavCmd::DO_CHANGE_SPEED,
            frame: MavFrame::MISSION,
            params,
            x: 0,
            y: 0,
            z: NAN,
            ..ON_EARTH
        };
        let land = |params| Item { command: MavCmd::NAV_LAND, params, ..ON_EARTH };
        for (good, bad, code) in [
            (ON_EARTH, Item { command: MavCmd::NAV_SPLINE_WAYPOINT, ..ON_EARTH }, MavMissionResult::UNSUPPORTED),
            (
                Item { frame: MavFrame::GLOBAL_TERRAIN_ALT, ..ON_EARTH },
                Item { frame: MavFrame::LOCAL_NED, ..ON_EARTH },
                MavMissionResult::UNSUPPORTED_FRAME,
            ),
            (speed([3.0, 5.0, -1.0, 0.0]), speed([3.5, 5.0, -1.0, 0.0]), MavMissionResult::INVALID_PARAM1),
            (speed([1.0, -2.0, -1.0, NAN]), speed([1.0, NAN, -1.0, 0.0]), MavMissionResult::INVALID_PARAM2),
            (speed([1.0, 0.0, 50.0, 0.0]), speed([1.0, 0.0, -2.1, 0.0]), MavMissionResult::INVALID_PARAM3),
            (land([0.0, 0.0, 0.0, NAN]), land([0.0, 0.0, 0.0, f32::INFINITY]), MavMissionResult::INVALID_PARAM4),
            (
                Item { x: -900_000_000, ..ON_EARTH },
                Item { x: -900_000_001, ..ON_EARTH },
                MavMissionResult::INVALID_PARAM5_X,
            ),
            (
                Item { y: 1_800_000_000, ..ON_EARTH },
                Item { y: 1_800_000_001, ..ON_EARTH },
                MavMissionResult::INVALID_PARAM6_Y,
            ),
            (Item { z: -400.0, ..ON_EARTH }, Item { z: NAN, ..ON_EARTH }, MavMissionResult::INVALID_PARAM7),
        ] {
            assert_eq!(mission(&good), Ok(()), "{good:?}");
            assert_eq!(mission(&bad), Err(code), "{bad:?}");
        }
    }

    /// M-38: with several faults, the code is that of the first failed check.
    #[test]
    fn the_first_failed_check_gives_the_code() {
        let mut item = Item {
            frame: MavFrame::BODY_FRD,
            command: MavCmd::NAV_RALLY_POINT,
            params: [f32::INFINITY; 4],
            x: i32::MAX,
            y: i32::MAX,
            z: NAN,
            ..ON_EARTH
        };
        let fixes: [fn(&mut Item); 9] = [
            |item| item.command = MavCmd::NAV_WAYPOINT,
            |item| item.frame = MavFrame::GLOBAL_RELATIVE_ALT_INT,
            |item| item.params[0] = 0.0,
            |item| item.params[1] = 0.0,
            |item| item.params[2] = 0.0,
            |item| item.params[3] = 0.0,
            |item| item.x = 1,
            |item| item.y = 0,
            |item| item.z = 0.0,
        ];
        let mut codes = Vec::new();
        for fix in fixes {
            codes.push(mission(&item).unwrap_err().0);
            fix(&mut item);
        }
        assert_eq!(codes, [3, 2, 6, 7, 8, 9, 10, 11, 12]);
        assert_eq!(mission(&item), Ok(()));
    }

    /// M-38, M-80, M-84: each command belongs to one type of plan.
    #[test]
    fn a_plan_refuses_commands_of_other_plans() {
        let items = [ON_EARTH, fence(MavCmd::NAV_FENCE_CIRCLE_EXCLUSION, 5.0), fence(MavCmd::NAV_RALLY_POINT, 0.0)];
        for (own, plan) in [PlanType::Mission, PlanType::Fence, PlanType::Rally].into_iter().enumerate() {
            for (of, item) in items.iter().enumerate() {
                let expected = if of == own { Ok(()) } else { Err(MavMissionResult::UNSUPPORTED) };
                assert_eq!(check_item(plan, COMMANDS, item, false), expected, "{plan:?}: {item:?}");
            }
        }
    }

    /// M-80, M-81
    #[test]
    fn fences_have_rules_of_their_own() {
        const INCLUSION: MavCmd = MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION;
        const EXCLUSION: MavCmd = MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION;
        const CIRCLES: [MavCmd; 2] = [MavCmd::NAV_FENCE_CIRCLE_INCLUSION, MavCmd::NAV_FENCE_CIRCLE_EXCLUSION];
        let check = |item: &Item| check_item(PlanType::Fence, &[], item, true);
        for command in [INCLUSION, EXCLUSION] {
            for p1 in [3.0, 4.0, 65_534.0] {
                assert_eq!(check(&fence(command, p1)), Ok(()), "{p1}");
            }
            for p1 in [2.0, 0.0, -3.0, 3.5, 65_535.0, 1e20, NAN, f32::INFINITY] {
                assert_eq!(check(&fence(command, p1)), Err(MavMissionResult::INVALID_PARAM1), "{p1}");
            }
        }
        for command in CIRCLES {
            for p1 in [f32::MIN_POSITIVE, 0.5, 1e5] {
                assert_eq!(check(&fence(command, p1)), Ok(()), "{p1}");
            }
            for p1 in [0.0, -0.0, -5.0, NAN, f32::INFINITY] {
                assert_eq!(check(&fence(command, p1)), Err(MavMissionResult::INVALID_PARAM1), "{p1}");
            }
        }
        // Only inclusions have a group.
        for (p2, is_group) in [(0.0, true), (7.0, true), (-1.0, false), (0.5, false), (NAN, false)] {
            let of = |command| Item { params: [3.0, p2, 0.0, 0.0], ..fence(command, 0.0) };
            let expected = if is_group { Ok(()) } else { Err(MavMissionResult::INVALID_PARAM2) };
            assert_eq!(check(&of(INCLUSION)), expected, "{p2}");
            assert_eq!(check(&of(CIRCLES[0])), expected, "{p2}");
            assert_eq!(check(&of(EXCLUSION)), Ok(()), "{p2}");
        }
        // Only the return point needs an altitude; every item needs a position.
        let home = fence(MavCmd::NAV_FENCE_RETURN_POINT, 0.0);
        assert_eq!(check(&Item { z: NAN, ..home }), Err(MavMissionResult::INVALID_PARAM7));
        assert_eq!(check(&Item { z: NAN, ..fence(INCLUSION, 3.0) }), Ok(()));
        let circles = CIRCLES.map(|command| fence(command, 9.0));
        for item in [home, fence(INCLUSION, 3.0), fence(EXCLUSION, 3.0), circles[0], circles[1]] {
            for frame in (0..=u8::MAX).map(MavFrame) {
                let is_taken = matches!(frame.0, 0 | 3 | 5 | 6);
                let expected = if is_taken { Ok(()) } else { Err(MavMissionResult::UNSUPPORTED_FRAME) };
                assert_eq!(check(&Item { frame, ..item }), expected, "{frame:?}");
            }
            let nowhere = Item { x: i32::MAX, y: i32::MAX, ..item };
            assert_eq!(check(&nowhere), Err(MavMissionResult::INVALID_PARAM5_X));
        }
    }

    /// M-84
    #[test]
    fn rally_points_need_a_global_position() {
        let check = |item: &Item| check_item(PlanType::Rally, COMMANDS, item, true);
        let point = fence(MavCmd::NAV_RALLY_POINT, 0.0);
        for frame in [0, 3, 5, 6, 10, 11].map(MavFrame) {
            assert_eq!(check(&Item { frame, params: [NAN; 4], ..point }), Ok(()));
        }
        for (item, code) in [
            (Item { frame: MavFrame::MISSION, ..point }, MavMissionResult::UNSUPPORTED_FRAME),
            (Item { x: i32::MAX, ..point }, MavMissionResult::INVALID_PARAM5_X),
            (Item { y: i32::MIN, ..point }, MavMissionResult::INVALID_PARAM6_Y),
            (Item { z: f32::INFINITY, ..point }, MavMissionResult::INVALID_PARAM7),
        ] {
            assert_eq!(check(&item), Err(code), "{item:?}");
        }
    }

    /// M-49: without a model of the terrain, an altitude above it is refused in every plan. The frame of a command without an
    /// altitude means nothing.
    #[test]
    fn altitudes_above_terrain_need_a_model_of_it() {
        const COMMANDS: &[CommandRule] =
            &[NAV_WAYPOINT, DO_CHANGE_SPEED, CONDITION_CHANGE_ALT, NAV_CONTINUE_AND_CHANGE_ALT, DO_CHANGE_ALTITUDE];
        let check = |plan, item: &Item, has_terrain| check_item(plan, COMMANDS, item, has_terrain);
        let of = |command| Item { command, params: [1.0; 4], ..ON_EARTH };
        let refused = Err(MavMissionResult::UNSUPPORTED_FRAME);
        for frame in [0, 3, 5, 6, 10, 11].map(MavFrame) {
            let expected = if frame.0 >= 10 { refused } else { Ok(()) };
            for (plan, item) in [
                (PlanType::Mission, ON_EARTH),
                (PlanType::Rally, of(MavCmd::NAV_RALLY_POINT)),
                (PlanType::Mission, Item { x: 0, y: 0, ..of(MavCmd::CONDITION_CHANGE_ALT) }),
                (PlanType::Mission, Item { x: 0, y: 0, ..of(MavCmd::NAV_CONTINUE_AND_CHANGE_ALT) }),
            ] {
                assert_eq!(check(plan, &Item { frame, ..item }, false), expected, "{frame:?} {item:?}");
                assert_eq!(check(plan, &Item { frame, ..item }, true), Ok(()), "{frame:?} {item:?}");
            }
            assert_eq!(check(PlanType::Fence, &Item { frame, ..of(MavCmd::NAV_FENCE_RETURN_POINT) }, false), expected);
            let speed = Item { frame, x: 0, y: 0, ..of(MavCmd::DO_CHANGE_SPEED) };
            assert_eq!(check(PlanType::Mission, &speed, false), Ok(()));
            // This one has the frame in a parameter.
            let params = [50.0, frame.0.into(), 0.0, 0.0];
            let altitude = Item { params, x: 0, y: 0, ..of(MavCmd::DO_CHANGE_ALTITUDE) };
            assert_eq!(check(PlanType::Mission, &altitude, false), expected);
            assert_eq!(check(PlanType::Mission, &altitude, true), Ok(()));
        }
    }

    /// M-38
    #[test]
    fn texts_name_the_item_and_the_reason() {
        let refused = |plan, seq, result| {
            let mut text = Text::EMPTY;
            Problem::Refused(plan, PlanFault { seq, result }).write(&mut text);
            std::string::String::from(text.as_str().unwrap())
        };
        let item = |result| refused(PlanType::Mission, Some(65_534), result);
        assert_eq!(item(MavMissionResult::UNSUPPORTED), "Mission item 65534: command not supported");
        assert_eq!(item(MavMissionResult::INVALID_PARAM1), "Mission item 65534: parameter 1 out of range");
        assert_eq!(item(MavMissionResult::INVALID_PARAM7), "Mission item 65534: parameter 7 out of range");
        assert_eq!(item(MavMissionResult(200)), "Mission item 65534: refused by the vehicle");
        let whole = |seq| refused(PlanType::Fence, seq, MavMissionResult::INVALID);
        assert_eq!(whole(None), "Fence refused: not consistent");
        assert_eq!(whole(Some(12)), "Fence item 12: not consistent");
        // No text is truncated.
        assert!((0..=u8::MAX).all(|code| item(MavMissionResult(code)).len() < ONE_FRAME));
    }

    /// M-38, T-5: each text fits into one STATUSTEXT, and none is cut off.
    #[test]
    fn each_text_fits_into_one_frame() {
        let change = |plan| Change::Clear(plan);
        let changes = [change(None), change(Some(PlanType::Mission))];
        let mission = PlanType::Mission;
        let mut problems: Vec<_> = (0..=16)
            .flat_map(|result| [None, Some(u16::MAX)].map(|seq| PlanFault { seq, result: MavMissionResult(result) }))
            .map(|fault| Problem::Refused(mission, fault))
            .collect();
        problems.extend([
            Problem::NoPosition(mission, u16::MAX),
            Problem::TooFar(u16::MAX, u32::MAX),
            Problem::NotChecked,
            Problem::RateLimited(mission),
            Problem::TimedOut(mission, u16::MAX),
            Problem::NotCurrent(u16::MAX),
            Problem::Guided,
            Problem::NotSaved(None),
        ]);
        problems.extend(changes.iter().map(|change| Problem::NotSaved(Some(change))));
        for problem in problems {
            let mut text = Text::EMPTY;
            problem.write(&mut text);
            assert!(!text.as_bytes().is_empty() && text.as_bytes().len() < ONE_FRAME, "{:?}", text.as_str());
        }
    }
}
