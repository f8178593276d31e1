//! Checks of an item (M-38, M-73, SEC-14) and of a complete plan (M-39, M-72, M-80, M-81): first the rules for all
//! vehicles, then the vehicle's own.
//!
//! The check of a plan is a single pass over its items. Self-intersecting polygons are not detected: the time for that
//! grows with the square of the number of vertices.

use core::num::Wrapping;

use super::distance::first_too_far;
use super::problem::{PlanFault, Problem};
use super::vehicle::Plans;
use crate::dialect::rules::{
    NAV_FENCE_CIRCLE_EXCLUSION, NAV_FENCE_CIRCLE_INCLUSION, NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    NAV_FENCE_POLYGON_VERTEX_INCLUSION, NAV_FENCE_RETURN_POINT, NAV_RALLY_POINT,
};
use crate::dialect::{MavCmd, MavFrame, MavMissionResult};
use crate::message::{CommandRule, Item, ParamRule};
use crate::num;
use crate::service::Cx;
use crate::types::{Firmware, MAX_ITEMS, PlanType, Vehicle};

/// Only the return point of a fence has a meaningful altitude, and ground stations send relative ones. Altitudes above
/// terrain are refused (M-80).
const FENCE_FRAMES: &[MavFrame] = &[MavFrame::GLOBAL, MavFrame::GLOBAL_RELATIVE_ALT];
/// A polygon with more vertices than a plan can hold cannot be complete (M-81).
#[allow(clippy::as_conversions, reason = "const-evaluated; less than 65,536")]
const VERTICES: &[ParamRule] = &[ParamRule::integers(1, 3, MAX_ITEMS as i32)];
/// A radius is greater than 0; the definitions do not require that.
const RADIUS: &[ParamRule] = &[ParamRule::at_least(1, f32::MIN_POSITIVE)];

/// The commands of a fence (M-80).
const FENCE: &[CommandRule] = &[
    NAV_FENCE_RETURN_POINT.with_frames(FENCE_FRAMES),
    NAV_FENCE_POLYGON_VERTEX_INCLUSION.with_frames(FENCE_FRAMES).with_params(VERTICES),
    NAV_FENCE_POLYGON_VERTEX_EXCLUSION.with_frames(FENCE_FRAMES).with_params(VERTICES),
    NAV_FENCE_CIRCLE_INCLUSION.with_frames(FENCE_FRAMES).with_params(RADIUS),
    NAV_FENCE_CIRCLE_EXCLUSION.with_frames(FENCE_FRAMES).with_params(RADIUS),
];
/// The commands of rally points (M-84).
const RALLY: &[CommandRule] = &[NAV_RALLY_POINT];

/// Returns the rule of a command in this plan. `mission` has the rules of the vehicle's missions; the rules of fences
/// and rally points are fixed.
///
/// # Errors
///
/// UNSUPPORTED if no rule is for the command.
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

/// The message in which an item was received.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum ItemForm {
    /// MISSION_ITEM_INT, or no message: a plan that is loaded.
    Int,
    /// MISSION_ITEM: the position is in floats.
    Float,
}

/// Checks item `seq` of a plan by the rule of its command, then by the vehicle. An item of a MISSION_ITEM is converted
/// first (M-37).
///
/// # Errors
///
/// The first fault of the item.
pub(super) fn check_item<F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    plan: PlanType,
    seq: u16,
    item: &mut Item,
    form: ItemForm,
) -> Result<(), Problem> {
    // The command is checked first (M-38), because the other checks depend on its rule.
    let rule = rule(plan, F::Vehicle::MISSION_COMMANDS, item.command);
    // Before the conversion: 0 in an integer and 0 in a float have the same bits.
    let has_no_position = (item.x, item.y) == (0, 0);
    let checked = rule.and_then(|rule| {
        if form == ItemForm::Float {
            *item = Item::from_float(*item, rule)?;
        }
        // An altitude above terrain needs a model of the terrain (M-49).
        rule.check_for(item, F::Vehicle::HAS_TERRAIN_MODEL)?;
        let (vehicle, mut context) = cx.hook();
        vehicle.check_item(&mut context, plan, seq, item)
    });
    checked.map_err(|result| match rule {
        Ok(rule) if has_no_position && result == MavMissionResult::INVALID_PARAM5_X && rule.is_located() => {
            Problem::NoPosition(plan, seq)
        }
        _ => Problem::Refused(plan, PlanFault { seq: Some(seq), result }),
    })
}

/// Checks the next item of a plan that is loaded, and adds it to the staging area.
///
/// # Errors
///
/// The fault of the item; NO_SPACE if the plan is full.
pub(super) fn stage_item<F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    plan: PlanType,
    mut item: Item,
) -> Result<(), Problem> {
    let seq = cx.plans.staged();
    if seq >= cx.plans.capacity(plan) {
        return Err(Problem::Refused(plan, MavMissionResult::NO_SPACE.into()));
    }
    check_item(cx, plan, seq, &mut item, ItemForm::Int)?;
    cx.plans.stage(item);
    Ok(())
}

/// Checks the staged plan as a whole: its structure, the distance of a mission's first waypoint, then the vehicle's own
/// check.
///
/// # Errors
///
/// The first fault of the plan.
pub(super) fn check_staged_plan<F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    plan: PlanType,
) -> Result<(), Problem> {
    let refused = |fault| Problem::Refused(plan, fault);
    let items = cx.plans.staged_items();
    check_plan(plan, items).map_err(refused)?;
    if plan == PlanType::Mission
        && let Some(limit) = cx.vehicle.first_waypoint_limit()
        && let Some(seq) = first_too_far(items, F::Vehicle::MISSION_COMMANDS, limit)
    {
        return Err(Problem::TooFar { seq, limit: limit.distance });
    }
    let (vehicle, mut context) = cx.hook();
    let items = context.plans.staged_items();
    vehicle.check_plan(&mut context, plan, items).map_err(refused)
}

/// Refuses jumps to missing items, and fences with incomplete polygons. The items have passed [`check_item`]. The error
/// is the faulty item's sequence number, and the result for it.
fn check_plan(plan: PlanType, items: &[Item]) -> Result<(), PlanFault> {
    let checked = match plan {
        PlanType::Mission => check_jumps(items),
        PlanType::Fence => check_fence(items),
        // Rally points are independent of each other (M-84).
        PlanType::Rally => Ok(()),
    };
    checked.map_err(|ItemFault { item, result }| {
        let index = items.iter().position(|other| core::ptr::eq(other, item));
        PlanFault { seq: index.and_then(|index| u16::try_from(index).ok()), result }
    })
}

/// The item of a plan that is at fault.
struct ItemFault<'a> {
    item: &'a Item,
    result: MavMissionResult,
}

/// Checks the jumps of a mission: a jump leads to another item, and its repeat count is −1 (forever), 0, 1, … (M-72).
/// The error is the first faulty jump.
fn check_jumps(items: &[Item]) -> Result<(), ItemFault<'_>> {
    for item in items.iter().filter(|item| item.command == MavCmd::DO_JUMP) {
        let [target, repeat, ..] = item.params;
        let target = num::integer::<u16>(target).and_then(|target| items.get(usize::from(target)));
        let leads_to_other_item = target.is_some_and(|target| !core::ptr::eq(target, item));
        if !leads_to_other_item {
            return Err(ItemFault { item, result: MavMissionResult::INVALID_PARAM1 });
        }
        let is_repeat_count = num::integer::<i32>(repeat).is_some_and(|repeat| repeat >= -1);
        if !is_repeat_count {
            return Err(ItemFault { item, result: MavMissionResult::INVALID_PARAM2 });
        }
    }
    Ok(())
}

/// Checks a fence: its polygons are complete (M-81), and it has at most one return point. The error is the first faulty
/// item.
fn check_fence(items: &[Item]) -> Result<(), ItemFault<'_>> {
    let mut has_return_point = false;
    let mut unchecked = items;
    while let [item, others @ ..] = unchecked {
        unchecked = match item.command {
            MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION => {
                check_polygon(item, unchecked)?
            }
            MavCmd::NAV_FENCE_RETURN_POINT if has_return_point => {
                return Err(ItemFault { item, result: MavMissionResult::INVALID });
            }
            MavCmd::NAV_FENCE_RETURN_POINT => {
                has_return_point = true;
                others
            }
            _ => others,
        };
    }
    Ok(())
}

/// Checks the polygon at the beginning of `items`. Returns the items after the polygon. `first` is the first of
/// `items`.
///
/// The polygon has 3 or more vertices, which follow each other. All have the same command, and each states the number
/// of vertices. Those of an inclusion polygon are in one group. The polygon encloses an area.
///
/// # Errors
///
/// The first vertex that breaks this, or the first vertex of all if the plan ends within the polygon or if the polygon
/// has no area.
fn check_polygon<'a>(first: &'a Item, items: &'a [Item]) -> Result<&'a [Item], ItemFault<'a>> {
    let [count, group, ..] = first.params;
    let Some(stated_len) = num::integer::<u16>(count).filter(|len| *len >= 3) else {
        return Err(ItemFault { item: first, result: MavMissionResult::INVALID_PARAM1 });
    };
    let (vertices, others) = match items.split_at_checked(stated_len.into()) {
        Some(polygon_and_others) => polygon_and_others,
        // The plan ends within the polygon. A fault of its vertices is reported first.
        None => (items, &[][..]),
    };
    // Twice the signed area by the shoelace formula. With the first vertex as the origin, the edges at that vertex add
    // 0. The sum is modulo 2^64, which is more than the double area of the globe (1.3e19, in squares of 1e-7 degrees).
    // So a sum of 0 means that the vertices are collinear, or that parts of the area cancel each other.
    let mut double_area = Wrapping(0);
    let (mut last_x, mut last_y) = (Wrapping(0), Wrapping(0));
    for vertex in vertices {
        let [own_count, own_group, ..] = vertex.params;
        if vertex.command != first.command {
            return Err(ItemFault { item: vertex, result: MavMissionResult::INVALID });
        }
        if own_count != count {
            return Err(ItemFault { item: vertex, result: MavMissionResult::INVALID_PARAM1 });
        }
        // Exclusion polygons have no groups: their parameter 2 is reserved.
        let has_group = vertex.command == MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION;
        if has_group && own_group != group {
            return Err(ItemFault { item: vertex, result: MavMissionResult::INVALID_PARAM2 });
        }
        let x = Wrapping(i64::from(vertex.x)) - Wrapping(i64::from(first.x));
        let y = Wrapping(i64::from(vertex.y)) - Wrapping(i64::from(first.y));
        double_area += last_x * y - last_y * x;
        (last_x, last_y) = (x, y);
    }
    let is_truncated = vertices.len() < usize::from(stated_len);
    if is_truncated || double_area.0 == 0 {
        return Err(ItemFault { item: first, result: MavMissionResult::INVALID });
    }
    Ok(others)
}

#[cfg(test)]
mod tests {
    mod items {
        use super::super::*;
        use crate::dialect::rules::{
            CONDITION_CHANGE_ALT, DO_CHANGE_ALTITUDE, DO_CHANGE_SPEED, NAV_CONTINUE_AND_CHANGE_ALT, NAV_LAND,
            NAV_WAYPOINT,
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

        fn check_rule(
            plan: PlanType,
            mission: &'static [CommandRule],
            item: &Item,
            has_terrain: bool,
        ) -> Result<(), MavMissionResult> {
            rule(plan, mission, item.command)?.check_for(item, has_terrain)
        }

        fn mission(item: &Item) -> Result<(), MavMissionResult> {
            check_rule(PlanType::Mission, COMMANDS, item, true)
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
                    assert_eq!(check_rule(plan, COMMANDS, item, false), expected, "{plan:?}: {item:?}");
                }
            }
        }

        /// M-80, M-81
        #[test]
        fn fences_have_rules_of_their_own() {
            const INCLUSION: MavCmd = MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION;
            const EXCLUSION: MavCmd = MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION;
            const CIRCLES: [MavCmd; 2] = [MavCmd::NAV_FENCE_CIRCLE_INCLUSION, MavCmd::NAV_FENCE_CIRCLE_EXCLUSION];
            let check = |item: &Item| check_rule(PlanType::Fence, &[], item, true);
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
            let check = |item: &Item| check_rule(PlanType::Rally, COMMANDS, item, true);
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

        /// M-49: without a model of the terrain, an altitude above it is refused in every plan. The frame of a command
        /// without an altitude means nothing.
        #[test]
        fn altitudes_above_terrain_need_a_model_of_it() {
            const COMMANDS: &[CommandRule] =
                &[NAV_WAYPOINT, DO_CHANGE_SPEED, CONDITION_CHANGE_ALT, NAV_CONTINUE_AND_CHANGE_ALT, DO_CHANGE_ALTITUDE];
            let check = |plan, item: &Item, has_terrain| check_rule(plan, COMMANDS, item, has_terrain);
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
                assert_eq!(
                    check(PlanType::Fence, &Item { frame, ..of(MavCmd::NAV_FENCE_RETURN_POINT) }, false),
                    expected
                );
                let speed = Item { frame, x: 0, y: 0, ..of(MavCmd::DO_CHANGE_SPEED) };
                assert_eq!(check(PlanType::Mission, &speed, false), Ok(()));
                // This one has the frame in a parameter.
                let params = [50.0, frame.0.into(), 0.0, 0.0];
                let altitude = Item { params, x: 0, y: 0, ..of(MavCmd::DO_CHANGE_ALTITUDE) };
                assert_eq!(check(PlanType::Mission, &altitude, false), expected);
                assert_eq!(check(PlanType::Mission, &altitude, true), Ok(()));
            }
        }
    }

    mod plans {
        use super::super::*;
        use std::vec::Vec;

        const NAN: f32 = f32::NAN;
        const P1: MavMissionResult = MavMissionResult::INVALID_PARAM1;
        const P2: MavMissionResult = MavMissionResult::INVALID_PARAM2;
        const INVALID: MavMissionResult = MavMissionResult::INVALID;

        fn item(command: MavCmd, p1: f32, p2: f32) -> Item {
            Item { frame: MavFrame::GLOBAL, command, params: [p1, p2, 0.0, 0.0], ..Item::default() }
        }

        fn refused(seq: u16, result: MavMissionResult) -> Result<(), PlanFault> {
            Err(PlanFault { seq: Some(seq), result })
        }

        /// M-72. Each pair is the parameters of a DO_JUMP that is item 1 of 4.
        #[test]
        fn jumps_lead_to_another_item() {
            let jump = |p1, p2| {
                let mut items = [item(MavCmd::NAV_WAYPOINT, NAN, NAN); 4];
                items[1] = item(MavCmd::DO_JUMP, p1, p2);
                check_plan(PlanType::Mission, &items)
            };
            for (p1, p2) in [(0.0, -1.0), (0.0, 0.0), (2.0, 1.0), (3.0, 65_536.0), (-0.0, 2_000_000.0)] {
                assert_eq!(jump(p1, p2), Ok(()), "({p1}, {p2})");
            }
            for p1 in [1.0, 4.0, 65_535.0, 65_536.0, -1.0, 0.5, NAN, f32::INFINITY] {
                assert_eq!(jump(p1, 1.0), refused(1, P1), "{p1}");
            }
            for p2 in [-2.0, -1.5, 0.5, NAN, f32::INFINITY, f32::NEG_INFINITY] {
                assert_eq!(jump(0.0, p2), refused(1, P2), "{p2}");
            }
        }

        #[test]
        fn every_jump_is_checked() {
            let mut items = [item(MavCmd::DO_JUMP, 0.0, 1.0); 100];
            items[0] = item(MavCmd::NAV_WAYPOINT, 0.0, 0.0);
            assert_eq!(check_plan(PlanType::Mission, &items), Ok(()));
            items[99].params[0] = 100.0;
            assert_eq!(check_plan(PlanType::Mission, &items), refused(99, P1));
            // Jumps are not checked in other plans.
            assert_eq!(check_plan(PlanType::Rally, &items), Ok(()));
        }

        /// Parses the shorthand for a fence: `i3` and `e3` are vertices of polygons of 3, `j3` one of another group;
        /// `r` is the return point, `o` a circle. No three vertices are collinear.
        fn fence(text: &str) -> Vec<Item> {
            let parse = |(seq, word): (usize, &str)| {
                let (kind, count) = word.split_at(1);
                let count = count.parse().unwrap_or(0.0);
                let item = match kind {
                    "i" => item(MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION, count, 0.0),
                    "j" => item(MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION, count, 1.0),
                    "e" => item(MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION, count, seq as f32),
                    "r" => item(MavCmd::NAV_FENCE_RETURN_POINT, 0.0, 0.0),
                    _ => item(MavCmd::NAV_FENCE_CIRCLE_EXCLUSION, 50.0, 0.0),
                };
                let seq = i32::try_from(seq).unwrap();
                Item { x: 1000 * seq, y: 1000 * seq * seq, ..item }
            };
            text.split_whitespace().enumerate().map(parse).collect()
        }

        /// M-80, M-81
        #[test]
        fn polygons_are_complete_runs_of_vertices() {
            for text in [
                "",
                "r",
                "o o",
                "i3 i3 i3",
                "e4 e4 e4 e4 r",
                "i3 i3 i3 i3 i3 i3",
                "i3 i3 i3 j3 j3 j3",
                "o e3 e3 e3 i4 i4 i4 i4 o r e3 e3 e3",
            ] {
                assert_eq!(check_plan(PlanType::Fence, &fence(text)), Ok(()), "{text}");
            }
            for (text, seq, result) in [
                // Truncated by the end of the plan: the first vertex is at fault.
                ("i3", 0, INVALID),
                ("i3 i3", 0, INVALID),
                ("o i3 i3 i3 e4 e4 e4", 4, INVALID),
                ("i65534 i65534 i65534", 0, INVALID),
                // Interrupted by another item.
                ("i3 i3 o i3", 2, INVALID),
                ("e3 e3 r e3", 2, INVALID),
                ("i4 i4 i4 e4", 3, INVALID),
                // Vertices that disagree.
                ("i3 i4 i3", 1, P1),
                ("i4 i4 i4 i3 i3 i3", 3, P1),
                ("i3 i3 j3", 2, P2),
                // Too few vertices, and values that are not a count.
                ("i2 i2", 0, P1),
                ("r e0", 1, P1),
                ("i-3 i-3 i-3", 0, P1),
                ("i3.5 i3.5 i3.5", 0, P1),
                ("iNaN", 0, P1),
                ("i65536 i65536", 0, P1),
                // M-80: one return point.
                ("r o r", 2, INVALID),
                ("r i3 i3 i3 r r", 4, INVALID),
            ] {
                assert_eq!(check_plan(PlanType::Fence, &fence(text)), refused(seq, result), "{text}");
            }
        }

        /// M-82: a polygon without an area is refused.
        #[test]
        fn polygons_have_an_area() {
            let polygon = |places: &[(i32, i32)]| {
                let vertex = item(MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION, places.len() as f32, 0.0);
                let items: Vec<_> = places.iter().map(|&(x, y)| Item { x, y, ..vertex }).collect();
                check_plan(PlanType::Fence, &items)
            };
            const N: i32 = 900_000_000;
            const E: i32 = 1_800_000_000;
            assert_eq!(polygon(&[(0, 0), (0, 1), (1, 0)]), Ok(()));
            assert_eq!(polygon(&[(-N, -E), (N, -E), (N, E), (-N, E)]), Ok(()), "all of the globe");
            assert_eq!(polygon(&[(N, E), (-N, E), (-N, -E), (N, -E + 1)]), Ok(()));
            assert_eq!(polygon(&[(0, 0), (0, 0), (0, 1), (1, 0)]), Ok(()), "a repeated vertex is harmless");
            for flat in [[(5, 7); 3], [(0, 0), (0, 5), (0, 9)], [(-N, -E), (0, 0), (N, E)], [(0, 0), (3, 3), (0, 0)]] {
                assert_eq!(polygon(&flat), refused(0, INVALID), "{flat:?}");
            }
        }

        proptest::proptest! {
            /// Whether or not a plan passes: no panic, and the item at fault exists.
            #[test]
            fn any_plan_is_checked(
                plan in 0usize..3,
                commands in proptest::collection::vec((5000u16..5005, -1i8..6, proptest::num::f32::ANY, 0i32..4), 0..40),
            ) {
                let command = |plan, command: u16| if plan == 0 { MavCmd::DO_JUMP } else { MavCmd(command) };
                let items: Vec<_> = commands.iter().map(|&(id, p1, p2, x)| Item {
                    x,
                    y: x.wrapping_mul(i32::MAX / 2),
                    ..item(command(plan, id), f32::from(p1), if x == 0 { p2 } else { 0.0 })
                }).collect();
                let plan = [PlanType::Mission, PlanType::Fence, PlanType::Rally][plan];
                if let Err(fault) = check_plan(plan, &items) {
                    proptest::prop_assert!(usize::from(fault.seq.unwrap()) < items.len());
                }
            }
        }
    }
}
