//! Distance of a mission's first waypoint (M-48), after PX4's check.
//!
//! An equirectangular projection at the mean latitude of both places, with Bhāskara's approximation of the cosine. The
//! result is accurate to 3 % within 100 km and below 80° of latitude. It is never more than 3 % too small, but near the
//! poles it may be too large by half.

use core::num::Saturating;

use crate::dialect::MavCmd;
use crate::message::{CommandRule, Item, LatLon, Position, is_zero_here, position};
use crate::num;

/// Metres per 1e-7 degrees of a great circle.
const METRES_PER_UNIT: f32 = 0.011_131_95;
/// Half a turn and a full turn in 1e-7 degrees.
const HALF_TURN: Saturating<i64> = Saturating(1_800_000_000);
const FULL_TURN: Saturating<i64> = Saturating(3_600_000_000);

/// How far a mission's first waypoint may be away (M-48).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FirstWaypointLimit {
    /// The place from which the distance counts: usually home, or the vehicle's position.
    pub from: LatLon,
    /// The maximum distance, m.
    pub distance: u32,
}

/// Returns the first waypoint of a mission if it is too far away. `rules` are the rules of the mission's commands. An
/// item without a position, or at 0, 0 if its command takes that as "here", is not a waypoint.
pub(super) fn first_too_far(items: &[Item], rules: &[CommandRule], limit: FirstWaypointLimit) -> Option<u16> {
    let is_flown_to = |item: &Item| {
        is_waypoint(item.command)
            && position(item.frame) == Some(Position::Global)
            && item.x != i32::MAX
            && ((item.x, item.y) != (0, 0) || !is_zero_here(item.command))
            && rules.iter().any(|rule| rule.command() == item.command && rule.is_located())
    };
    // Not `(0u16..).zip(items)`: its counter has an overflow check that the compiler cannot remove.
    let index = items.iter().position(is_flown_to)?;
    let (seq, first) = (u16::try_from(index).ok()?, items.get(index)?);
    let to = LatLon { latitude: first.x, longitude: first.y };
    let distance = num::f32_from_u32(limit.distance);
    (square_of_distance(limit.from, to) > distance * distance).then_some(seq)
}

/// Whether the vehicle flies to the command's position: navigation commands, except the one that points a camera.
fn is_waypoint(command: MavCmd) -> bool {
    matches!(command.0, 0..=95 | 31_000..=31_004) && command != MavCmd::NAV_ROI
}

/// Returns the square of the distance (m²).
fn square_of_distance(a: LatLon, b: LatLon) -> f32 {
    let difference = Saturating(a.latitude) - Saturating(b.latitude);
    let north = num::f32_from_i32(difference.0) * METRES_PER_UNIT;
    let east = num::f32_from_i32(short_way(a.longitude, b.longitude)) * METRES_PER_UNIT;
    let mean = Saturating(a.latitude / 2) + Saturating(b.latitude / 2);
    let east = east * cosine(num::f32_from_i32(mean.0) * 1e-7);
    north * north + east * east
}

/// Returns the shorter way from `b` to `a`, also across the date line.
fn short_way(a: i32, b: i32) -> i32 {
    let way = Saturating(i64::from(a)) - Saturating(i64::from(b));
    let shorter = match way {
        _ if way > HALF_TURN => way - FULL_TURN,
        _ if way < -HALF_TURN => way + FULL_TURN,
        _ => way,
    };
    i32::try_from(shorter.0).unwrap_or(i32::MAX)
}

/// Bhāskara's approximation of the cosine of a latitude (deg), with an error of at most 0.002; 0 at the poles.
fn cosine(degrees: f32) -> f32 {
    let square = degrees * degrees;
    ((32_400.0 - 4.0 * square) / (32_400.0 + square)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::MavFrame;
    use crate::dialect::rules::{DO_JUMP, DO_SET_HOME, NAV_LAND, NAV_ROI, NAV_TAKEOFF, NAV_WAYPOINT, WAYPOINT_USER_1};
    use proptest::prelude::*;

    const RULES: &[CommandRule] =
        &[NAV_WAYPOINT, NAV_TAKEOFF.any_frame(), NAV_LAND, NAV_ROI, DO_SET_HOME, DO_JUMP, WAYPOINT_USER_1];

    fn at(latitude: f64, longitude: f64) -> LatLon {
        LatLon { latitude: (latitude * 1e7).round() as i32, longitude: (longitude * 1e7).round() as i32 }
    }

    /// Distance by the haversine formula, on the same sphere (m).
    fn reference(a: LatLon, b: LatLon) -> f64 {
        let radians = |scaled: i32| (f64::from(scaled) / 1e7).to_radians();
        let (north, east) = (radians(a.latitude) - radians(b.latitude), radians(a.longitude) - radians(b.longitude));
        let cosines = radians(a.latitude).cos() * radians(b.latitude).cos();
        let haversine = (north / 2.0).sin().powi(2) + cosines * (east / 2.0).sin().powi(2);
        2.0 * 6_378_137.0 * haversine.min(1.0).sqrt().asin()
    }

    #[test]
    fn distances_match_known_places() {
        for (a, b, metres) in [
            (at(47.397_742, 8.545_594), at(47.397_742, 8.545_594), 0.0),
            (at(47.0, 8.0), at(48.0, 8.0), 111_319.5),
            (at(0.0, 0.0), at(0.0, 1.0), 111_319.5),
            (at(60.0, 20.0), at(60.0, 21.0), 55_660.0),
            // Across the date line, and at a pole.
            (at(-17.0, 179.99), at(-17.0, -179.99), 2_129.0),
            (at(90.0, 0.0), at(90.0, 180.0), 0.0),
        ] {
            let distance = f64::from(square_of_distance(a, b)).sqrt();
            assert!((distance - metres).abs() <= metres * 0.003 + 0.01, "{a:?} {b:?}: {distance}");
        }
        // Around a pole, the result is the distance along the parallel.
        let around = f64::from(square_of_distance(at(89.999, 0.0), at(89.999, 90.0))).sqrt();
        assert!((157.0..180.0).contains(&around), "{around}");
    }

    /// M-48: the first waypoint with a position counts.
    #[test]
    fn the_first_waypoint_is_the_first_item_flown_to() {
        let home = at(47.4, 8.5);
        let item = |command, x, y| Item { frame: MavFrame::GLOBAL_RELATIVE_ALT, command, x, y, ..Item::default() };
        let far = |command| item(command, 484_000_000, 85_000_000);
        let near = |command| item(command, 474_001_000, 85_000_000);
        let check = |items: &[Item]| first_too_far(items, RULES, FirstWaypointLimit { from: home, distance: 10_000 });
        assert_eq!(check(&[]), None);
        assert_eq!(check(&[far(MavCmd::NAV_WAYPOINT)]), Some(0));
        assert_eq!(check(&[near(MavCmd::NAV_WAYPOINT), far(MavCmd::NAV_WAYPOINT)]), None, "only the first counts");
        assert_eq!(check(&[far(MavCmd::WAYPOINT_USER_1)]), Some(0));
        for here in [
            item(MavCmd::NAV_TAKEOFF, i32::MAX, i32::MAX),
            item(MavCmd::NAV_TAKEOFF, 0, 0),
            Item { frame: MavFrame::MISSION, ..far(MavCmd::NAV_TAKEOFF) },
            far(MavCmd::DO_JUMP),
            far(MavCmd::DO_SET_HOME),
            far(MavCmd::NAV_ROI),
            far(MavCmd::NAV_LOITER_UNLIM),
        ] {
            assert_eq!(check(&[here, far(MavCmd::NAV_LAND)]), Some(1), "{here:?}");
            assert_eq!(check(&[here, near(MavCmd::NAV_LAND), far(MavCmd::NAV_LAND)]), None, "{here:?}");
        }
        // A waypoint at 0, 0 passes the rules only if the vehicle allows it; then it means that position.
        assert_eq!(check(&[item(MavCmd::NAV_WAYPOINT, 0, 0), near(MavCmd::NAV_LAND)]), Some(0));
        assert_eq!(
            first_too_far(
                &[item(MavCmd::NAV_WAYPOINT, 0, 0)],
                RULES,
                FirstWaypointLimit { from: at(0.0, 0.05), distance: 10_000 }
            ),
            None
        );
        assert_eq!(
            first_too_far(&[far(MavCmd::NAV_LAND)], RULES, FirstWaypointLimit { from: home, distance: 112_000 }),
            None
        );
        assert_eq!(
            first_too_far(&[far(MavCmd::NAV_LAND)], RULES, FirstWaypointLimit { from: home, distance: u32::MAX }),
            None
        );
        assert_eq!(
            first_too_far(&[near(MavCmd::NAV_LAND)], RULES, FirstWaypointLimit { from: home, distance: 0 }),
            Some(0)
        );
    }

    proptest! {
        /// Below 80° and within 100 km the error is at most 3 %.
        #[test]
        fn distances_are_close_to_the_great_circle(
            latitude in -80.0f64..80.0, longitude in -180.0f64..180.0, north in -0.6f64..0.6, east in -0.6f64..0.6,
        ) {
            let wrapped = |longitude: f64| (longitude + 540.0).rem_euclid(360.0) - 180.0;
            let (a, b) = (at(latitude, longitude), at(latitude + north, wrapped(longitude + east)));
            let (expected, distance) = (reference(a, b), f64::from(square_of_distance(a, b)).sqrt());
            prop_assert!((distance - expected).abs() <= 0.03 * expected + 1.0, "{} instead of {}", distance, expected);
        }

        #[test]
        fn any_two_places_have_a_distance(a: (i32, i32), b: (i32, i32)) {
            let place = |(latitude, longitude)| LatLon { latitude, longitude };
            let square = square_of_distance(place(a), place(b));
            prop_assert!(square.is_finite() && square >= 0.0);
        }

        /// The distance is never more than 3 % too small, wherever the places are.
        #[test]
        fn no_distance_is_far_too_small(
            a in (-90.0f64..=90.0, -180.0f64..=180.0), b in (-90.0f64..=90.0, -180.0f64..=180.0),
        ) {
            let (a, b) = (at(a.0, a.1), at(b.0, b.1));
            let distance = f64::from(square_of_distance(a, b)).sqrt();
            prop_assert!(distance >= 0.97 * reference(a, b), "{} instead of {}", distance, reference(a, b));
        }
    }
}
