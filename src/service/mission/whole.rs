//! Checks of a complete plan (M-39, M-72, M-80, M-81).
//!
//! A single pass over the items. Self-intersecting polygons are not detected: the time for that grows with the square of the
//! number of vertices.

use super::PlanFault;
use crate::dialect::{MavCmd, MavMissionResult};
use crate::message::Item;
use crate::num;
use crate::types::PlanType;

type Checked = Result<(), PlanFault>;

/// Refuses jumps to missing items, and fences with incomplete polygons. The items have passed
/// [`check_item`](super::validate::check_item).
pub(super) fn check_plan(plan: PlanType, items: &[Item]) -> Checked {
    match plan {
        PlanType::Mission => check_jumps(items),
        PlanType::Fence => check_fence(items),
        // Rally points are independent of each other (M-84).
        PlanType::Rally => Ok(()),
    }
}

fn fault(seq: usize, result: MavMissionResult) -> Checked {
    Err(PlanFault { seq: u16::try_from(seq).ok(), result })
}

/// M-72: a jump leads to another item; its repeat count is −1 (forever), 0, 1, …
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

/// M-80, M-81: a polygon is a run of vertices, all of which state its length; there is at most one return point.
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

/// Checks the polygon that begins with item `start`, which is `first`. Returns the index after its last vertex.
fn check_polygon(items: &[Item], start: usize, first: &Item) -> Result<usize, PlanFault> {
    let [count, group, ..] = first.params;
    let Some(len) = num::integer::<u16>(count).map(usize::from).filter(|len| *len >= 3) else {
        return fault(start, MavMissionResult::INVALID_PARAM1).map(|()| start);
    };
    let end = start.saturating_add(len);
    // Twice the signed area (shoelace formula, relative to the first vertex), modulo 2^64. That is more than twice the area of
    // the globe, so 0 means that the vertices are collinear or the parts cancel out.
    let mut area = 0i64;
    let mut last = (0i64, 0i64);
    for (seq, item) in (start..end).zip(items.iter().skip(start)) {
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
        area = area.wrapping_add(last.0.wrapping_mul(side.1)).wrapping_sub(last.1.wrapping_mul(side.0));
        last = side;
    }
    // Truncated by the end of the plan, or without an area.
    if end > items.len() || area == 0 {
        return fault(start, MavMissionResult::INVALID).map(|()| end);
    }
    Ok(end)
}

fn difference(a: i32, b: i32) -> i64 {
    i64::from(a).saturating_sub(b.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::MavFrame;
    use std::vec::Vec;

    const NAN: f32 = f32::NAN;
    const P1: MavMissionResult = MavMissionResult::INVALID_PARAM1;
    const P2: MavMissionResult = MavMissionResult::INVALID_PARAM2;
    const INVALID: MavMissionResult = MavMissionResult::INVALID;

    fn item(command: MavCmd, p1: f32, p2: f32) -> Item {
        Item { frame: MavFrame::GLOBAL, command, params: [p1, p2, 0.0, 0.0], ..Item::default() }
    }

    fn refused(seq: u16, result: MavMissionResult) -> Checked {
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

    /// Parses the shorthand for a fence: `i3` and `e3` are vertices of polygons of 3, `j3` one of another group; `r` is the
    /// return point, `o` a circle. No three vertices are collinear.
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
