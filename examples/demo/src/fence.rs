//! The geofence: whether the vehicle may be somewhere and fly on from there.
//!
//! Inclusion areas of one group (parameter 2) have to contain the vehicle all together, and one group that does is enough:
//! so MAVLink has it. A fence without groups has one, 0, and is then what PX4 and ArduPilot make of it: the vehicle stays
//! inside every inclusion area and outside every exclusion area. A way must stay within a single group as a whole, so from
//! one group to another it goes where they overlap by more than the way is long. A fence has no height, and the return
//! point is kept and not flown to: the vehicle stops inside its fence.
//!
//! Each question looks once at every item, with about thirty operations on floats for a corner; nothing is remembered
//! between two.

use mavstack::Item;
use mavstack::dialect::MavCmd;

use crate::body::Vector;
use crate::geo::Home;

/// How many inclusion groups there are: numbers from 0.
pub const GROUPS: i32 = 32;

/// Metres north and east.
type Point = (f32, f32);

/// Where a way is, seen from an area.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Side {
    Inside,
    Outside,
    /// It crosses the border.
    Across,
}

/// Whether the straight way between two places is within `fence`, a whole and valid plan, at every point.
pub fn allows(home: Home, fence: &[Item], from: Vector, to: Vector) -> bool {
    let way = (to.north - from.north, to.east - from.east);
    let seen_from = |item: &Item| {
        let (north, east) = home.to_local(item.x, item.y);
        (north - from.north, east - from.east)
    };
    // A bit for each group.
    let (mut groups, mut left) = (0_u32, 0_u32);
    let mut rest = fence;
    while let Some(first) = rest.first() {
        let [p1, p2, ..] = first.params;
        let is_polygon = matches!(
            first.command,
            MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_POLYGON_VERTEX_EXCLUSION
        );
        let count = if is_polygon { (p1 as usize).clamp(1, rest.len()) } else { 1 };
        let (area, others) = rest.split_at(count);
        rest = others;
        let side = || if is_polygon { polygon(area, seen_from, way) } else { circle(seen_from(first), p1, way) };
        match first.command {
            MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_CIRCLE_INCLUSION => {
                let group = 1_u32.wrapping_shl(p2 as u32);
                groups |= group;
                if side() != Side::Inside {
                    left |= group;
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
    groups == 0 || groups & !left != 0
}

/// The way from the origin against a polygon. What leaves the origin eastward crosses the border an odd number of times
/// when it begins inside. A corner belongs to one side of any line, so a way through it is seen as crossing.
fn polygon(corners: &[Item], seen_from: impl Fn(&Item) -> Point, way: Point) -> Side {
    let Some(last) = corners.last() else { return Side::Outside };
    let mut a = seen_from(last);
    let mut is_inside = false;
    for corner in corners {
        let b = seen_from(corner);
        let edge = (b.0 - a.0, b.1 - a.1);
        let is_right = cross(a, b) < 0.0;
        if (a.0 > 0.0) != (b.0 > 0.0) && is_right == (edge.0 > 0.0) {
            is_inside = !is_inside;
        }
        // The ends of each are on different sides of the other.
        let is_end_right = cross(edge, (way.0 - a.0, way.1 - a.1)) < 0.0;
        if (cross(way, a) < 0.0) != (cross(way, b) < 0.0) && (cross(edge, (-a.0, -a.1)) < 0.0) != is_end_right {
            return Side::Across;
        }
        a = b;
    }
    if is_inside { Side::Inside } else { Side::Outside }
}

/// The way from the origin against a circle.
fn circle(centre: Point, radius: f32, way: Point) -> Side {
    let square = |(north, east): Point| north * north + east * east;
    let after = |share: f32| square((centre.0 - way.0 * share, centre.1 - way.1 * share));
    let limit = radius * radius;
    if square(centre) <= limit && after(1.0) <= limit {
        return Side::Inside;
    }
    // The nearest that the way comes to the centre.
    let length = square(way);
    let share = if length > 0.0 { ((centre.0 * way.0 + centre.1 * way.1) / length).clamp(0.0, 1.0) } else { 0.0 };
    if after(share) > limit { Side::Outside } else { Side::Across }
}

/// Positive when `b` is to the right of `a`.
fn cross(a: Point, b: Point) -> f32 {
    a.0 * b.1 - a.1 * b.0
}
