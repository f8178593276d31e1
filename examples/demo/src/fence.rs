//! The geofence: whether the vehicle may fly a straight path.
//!
//! - The vehicle must be inside all inclusion areas of at least one group (parameter 2), as MAVLink defines it.
//! - A fence without groups is one group, 0. Then the vehicle stays inside every inclusion area and outside every exclusion
//!   area, as with PX4 and ArduPilot.
//! - A path must lie within a single group. The vehicle therefore passes from one group to another where they overlap by
//!   more than the length of a path.
//! - A fence has no height.
//! - The return point is stored but not used: the vehicle stops inside its fence.
//!
//! Each check visits every item once, with about thirty floating-point operations per corner. No state is kept between
//! checks.

use mavstack::Item;
use mavstack::dialect::MavCmd;

use crate::body::Vector;
use crate::geo::Home;

/// The number of inclusion groups, numbered from 0.
pub const GROUPS: i32 = 32;

/// A point, in metres north and east.
type Point = (f32, f32);

/// Where a path lies relative to an area.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Side {
    Inside,
    Outside,
    /// The path crosses the border.
    Across,
}

/// Whether every point of the straight path from `from` to `to` is within `fence`, which is a complete and valid plan.
pub fn allows(home: Home, fence: &[Item], from: Vector, to: Vector) -> bool {
    let path = (to.north - from.north, to.east - from.east);
    let relative = |item: &Item| {
        let (north, east) = home.to_local(item.x, item.y);
        (north - from.north, east - from.east)
    };
    // One bit per group.
    let (mut groups, mut exited) = (0_u32, 0_u32);
    let mut rest = fence;
    while let Some(first) = rest.first() {
        let [p1, p2, ..] = first.params;
        let is_polygon = matches!(
            first.command,
            MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION
        );
        let count = if is_polygon { (p1 as usize).clamp(1, rest.len()) } else { 1 };
        let (area, others) = rest.split_at_checked(count).unwrap_or((rest, &[]));
        rest = others;
        let side = || if is_polygon { polygon(area, relative, path) } else { circle(relative(first), p1, path) };
        match first.command {
            MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_CIRCLE_INCLUSION => {
                let group = 1_u32.wrapping_shl(p2 as u32);
                groups |= group;
                if side() != Side::Inside {
                    exited |= group;
                }
            }
            MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION | MavCmd::NAV_FENCE_CIRCLE_EXCLUSION
                if side() != Side::Outside =>
            {
                return false;
            }
            _ => {}
        }
    }
    groups == 0 || groups & !exited != 0
}

/// Classifies the path from the origin to `path` against a polygon. Ray casting decides whether the origin is inside: a ray
/// to the east crosses the border an odd number of times. A corner counts as one side of any line, so a path through a
/// corner crosses the border.
fn polygon(corners: &[Item], relative: impl Fn(&Item) -> Point, path: Point) -> Side {
    let Some(last) = corners.last() else { return Side::Outside };
    let mut a = relative(last);
    let mut is_inside = false;
    for corner in corners {
        let b = relative(corner);
        let edge = (b.0 - a.0, b.1 - a.1);
        let is_right = cross(a, b) < 0.0;
        if (a.0 > 0.0) != (b.0 > 0.0) && is_right == (edge.0 > 0.0) {
            is_inside = !is_inside;
        }
        // Two segments intersect when the ends of each are on different sides of the other.
        let is_end_right = cross(edge, (path.0 - a.0, path.1 - a.1)) < 0.0;
        if (cross(path, a) < 0.0) != (cross(path, b) < 0.0) && (cross(edge, (-a.0, -a.1)) < 0.0) != is_end_right {
            return Side::Across;
        }
        a = b;
    }
    if is_inside { Side::Inside } else { Side::Outside }
}

/// Classifies the path from the origin to `path` against a circle.
fn circle(centre: Point, radius: f32, path: Point) -> Side {
    let square = |(north, east): Point| north * north + east * east;
    let after = |share: f32| square((centre.0 - path.0 * share, centre.1 - path.1 * share));
    let limit = radius * radius;
    if square(centre) <= limit && after(1.0) <= limit {
        return Side::Inside;
    }
    // The point of the path that is nearest to the centre.
    let length = square(path);
    let share = if length > 0.0 { ((centre.0 * path.0 + centre.1 * path.1) / length).clamp(0.0, 1.0) } else { 0.0 };
    if after(share) > limit { Side::Outside } else { Side::Across }
}

/// Returns the cross product: positive when `b` is to the right of `a`.
fn cross(a: Point, b: Point) -> f32 {
    a.0 * b.1 - a.1 * b.0
}

#[cfg(test)]
mod tests {
    use mavstack::dialect::MavFrame;

    use super::*;

    const IN: MavCmd = MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION;
    const OUT: MavCmd = MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION;
    const CIRCLE_IN: MavCmd = MavCmd::NAV_FENCE_CIRCLE_INCLUSION;
    const CIRCLE_OUT: MavCmd = MavCmd::NAV_FENCE_CIRCLE_EXCLUSION;

    fn point(north: f32, east: f32) -> Vector {
        Vector { north, east, down: -10.0 }
    }

    fn item(command: MavCmd, p1: f32, north: f32, east: f32) -> Item {
        let (x, y) = Home::DEMO.to_global(north, east);
        Item { frame: MavFrame::GLOBAL, command, autocontinue: 1, params: [p1, 0.0, 0.0, 0.0], x, y, z: 0.0 }
    }

    fn polygon<const N: usize>(command: MavCmd, corners: [(f32, f32); N]) -> [Item; N] {
        corners.map(|(north, east)| item(command, N as f32, north, east))
    }

    fn is_allowed(fence: &[Item], from: (f32, f32), to: (f32, f32)) -> bool {
        let check =
            |from: (f32, f32), to: (f32, f32)| allows(Home::DEMO, fence, point(from.0, from.1), point(to.0, to.1));
        assert_eq!(check(from, to), check(to, from), "both directions agree: {from:?} {to:?}");
        check(from, to)
    }

    #[test]
    fn without_a_fence_everything_is_allowed() {
        assert!(is_allowed(&[], (0.0, 0.0), (9_000.0, 0.0)));
        assert!(is_allowed(&[item(MavCmd::NAV_FENCE_RETURN_POINT, 0.0, 5.0, 5.0)], (0.0, 0.0), (9_000.0, 0.0)));
    }

    #[test]
    fn paths_inside_and_across_a_concave_polygon() {
        // A U shape that is open to the east.
        let corners =
            [(20.0, -20.0), (20.0, 30.0), (10.0, 30.0), (0.0, 0.0), (-10.0, 30.0), (-20.0, 30.0), (-20.0, -20.0)];
        for (from, to, side) in [
            ((0.0, -10.0), (15.0, -10.0), Side::Inside),
            ((15.0, 20.0), (-15.0, 20.0), Side::Across),
            ((15.0, 20.0), (15.0, 20.0), Side::Inside),
            ((0.0, 15.0), (0.0, 15.0), Side::Outside),
            ((0.0, 15.0), (0.0, 25.0), Side::Outside),
            ((0.0, -10.0), (0.0, 10.0), Side::Across),
            ((30.0, -40.0), (30.0, 40.0), Side::Outside),
            ((30.0, 0.0), (-30.0, 0.0), Side::Across),
            // Through a corner, along the line of an edge, and past its end.
            ((10.0, -10.0), (30.0, -30.0), Side::Across),
            ((20.0, 40.0), (20.0, 31.0), Side::Outside),
            ((25.0, -20.0), (21.0, -20.0), Side::Outside),
        ] {
            assert_eq!(is_allowed(&polygon(IN, corners), from, to), side == Side::Inside, "{from:?} {to:?}");
            assert_eq!(is_allowed(&polygon(OUT, corners), from, to), side == Side::Outside, "{from:?} {to:?}");
        }
    }

    #[test]
    fn paths_inside_and_across_a_circle() {
        for (from, to, side) in [
            ((11.0, 0.0), (29.0, 0.0), Side::Inside),
            ((11.0, 0.0), (31.0, 0.0), Side::Across),
            ((-20.0, 0.0), (40.0, 0.0), Side::Across),
            ((-20.0, 15.0), (40.0, 10.5), Side::Outside),
            ((35.0, 0.0), (40.0, 0.0), Side::Outside),
            ((20.0, 0.0), (20.0, 0.0), Side::Inside),
            ((20.0, 11.0), (20.0, 11.0), Side::Outside),
        ] {
            assert_eq!(
                is_allowed(&[item(CIRCLE_IN, 10.0, 20.0, 0.0)], from, to),
                side == Side::Inside,
                "{from:?} {to:?}"
            );
            assert_eq!(
                is_allowed(&[item(CIRCLE_OUT, 10.0, 20.0, 0.0)], from, to),
                side == Side::Outside,
                "{from:?} {to:?}"
            );
        }
    }

    /// A fence that would fail the stack's checks does not panic either.
    #[test]
    fn invalid_fences_do_not_panic() {
        let square = polygon(IN, [(-9.0, -9.0), (-9.0, 9.0), (9.0, 9.0), (9.0, -9.0)]);
        for p1 in [f32::NAN, -1.0, 0.0, 1e9, f32::INFINITY] {
            for fence in [[square[0]; 3], [item(IN, p1, 0.0, 0.0); 3], [item(CIRCLE_IN, p1, 0.0, 0.0); 3]] {
                let _ = is_allowed(&fence, (1.0, 2.0), (30.0, 40.0));
            }
        }
    }

    /// Compares random triangles and circles with a check of many points along the path.
    #[test]
    fn paths_agree_with_their_points() {
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) as f32 / 655.36 - 50.0
        };
        let (mut allowed, mut refused, mut cut) = (0, 0, 0);
        for _ in 0..3_000 {
            let corners = [(random(), random()), (random(), random()), (random(), random())];
            let [a, b, c] = polygon(if random() > 0.0 { IN } else { OUT }, corners);
            let circle = item(if random() > 0.0 { CIRCLE_IN } else { CIRCLE_OUT }, 60.0 + random(), random(), random());
            let (from, to) = ((random(), random()), (random() / 4.0, random() / 4.0));
            let to = (from.0 + to.0, from.1 + to.1);
            let points = (0..=200).map(|i| i as f32 / 200.0).all(|share| {
                let at = (from.0 + (to.0 - from.0) * share, from.1 + (to.1 - from.1) * share);
                is_allowed(&[a, b, c, circle], at, at)
            });
            match (is_allowed(&[a, b, c, circle], from, to), points) {
                (true, true) => allowed += 1,
                (false, false) => refused += 1,
                // The points missed a corner that the path cuts off.
                (false, true) => cut += 1,
                (true, false) => panic!("{corners:?} {circle:?} {from:?} {to:?}"),
            }
        }
        assert!(allowed > 300 && refused > 300 && cut < 10, "{allowed} {refused} {cut}");
    }
}
