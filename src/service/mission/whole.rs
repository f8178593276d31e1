//! What can be said of a plan only when all its items are there (rules M-72, M-80, M-81; section 8.6).
//!
//! One walk over the items, in the order of flight. That a polygon crosses itself is not looked for: the time for it
//! grows with the square of the corners.

use super::item::Item;
use super::memory::PlanType;
use crate::dialect::{MavCmd, MavMissionResult};
use crate::num;
use crate::vehicle::PlanFault;

type Checked = Result<(), PlanFault>;

/// Refuses jumps that lead nowhere, and fences with polygons that are not whole. The items have passed
/// [`check_item`](super::validate::check_item).
pub(super) fn check_plan(plan: PlanType, items: &[Item]) -> Checked {
    match plan {
        PlanType::Mission => check_jumps(items),
        PlanType::Fence => check_fence(items),
        // Its items do not depend on each other (M-84).
        PlanType::Rally => Ok(()),
    }
}

fn fault(seq: usize, result: MavMissionResult) -> Checked {
    Err(PlanFault { seq: u16::try_from(seq).ok(), result })
}

/// M-72: a jump leads to another item, and repeats −1 (for ever), 0, 1, … times.
fn check_jumps(items: &[Item]) -> Checked {
    for (seq, item) in items.iter().enumerate() {
        if item.command != MavCmd::DO_JUMP {
            continue;
        }
        let [target, repeat, ..] = item.params;
        let target = num::integer::<u16>(target).map(usize::from);
        if target.is_none_or(|target| target >= items.len() || target == seq) {
            return fault(seq, MavMissionResult::INVALID_PARAM1);
        }
        if num::integer::<i32>(repeat).is_none_or(|repeat| repeat < -1) {
            return fault(seq, MavMissionResult::INVALID_PARAM2);
        }
    }
    Ok(())
}

/// M-80, M-81: polygons are runs of vertices, each as long as all its vertices say, and there is one return point at most.
fn check_fence(items: &[Item]) -> Checked {
    let mut has_return = false;
    let mut seq = 0usize;
    while let Some(first) = items.get(seq) {
        if is_vertex(first) {
            seq = check_polygon(items, seq, first)?;
            continue;
        }
        if first.command == MavCmd::NAV_FENCE_RETURN_POINT {
            if has_return {
                return fault(seq, MavMissionResult::INVALID);
            }
            has_return = true;
        }
        seq = seq.saturating_add(1);
    }
    Ok(())
}

fn is_vertex(item: &Item) -> bool {
    matches!(item.command, MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
}

/// The polygon that begins with item `start`, `first`. Where it ends.
fn check_polygon(items: &[Item], start: usize, first: &Item) -> Result<usize, PlanFault> {
    let [count, group, ..] = first.params;
    let Some(len) = num::integer::<u16>(count).map(usize::from).filter(|len| *len >= 3) else {
        return fault(start, MavMissionResult::INVALID_PARAM1).map(|()| start);
    };
    let end = start.saturating_add(len);
    // Twice the area, by the triangles from the first vertex: from 0 when all vertices are on one line.
    let mut area = 0i128;
    let mut last = (0, 0);
    for (seq, item) in items.iter().enumerate().take(end).skip(start) {
        let fault = |result| fault(seq, result).map(|()| seq);
        let [own_count, own_group, ..] = item.params;
        if item.command != first.command {
            return fault(MavMissionResult::INVALID);
        }
        if own_count != count {
            return fault(MavMissionResult::INVALID_PARAM1);
        }
        if item.command == MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION && own_group != group {
            return fault(MavMissionResult::INVALID_PARAM2);
        }
        let side = (difference(item.x, first.x), difference(item.y, first.y));
        area = area.saturating_add(product(last.0, side.1)).saturating_sub(product(last.1, side.0));
        last = side;
    }
    // Cut off by the end of the plan, or nothing to be inside of.
    if end > items.len() || area == 0 {
        return fault(start, MavMissionResult::INVALID).map(|()| end);
    }
    Ok(end)
}

fn difference(a: i32, b: i32) -> i64 {
    i64::from(a).saturating_sub(b.into())
}

fn product(a: i64, b: i64) -> i128 {
    i128::from(a).saturating_mul(b.into())
}
