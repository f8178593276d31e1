//! The distance between two positions, without a library for mathematics.

/// Where something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Position {
    /// Latitude (degE7).
    pub lat: i32,
    /// Longitude (degE7).
    pub lon: i32,
    /// Altitude above mean sea level (mm).
    pub altitude: i32,
}

/// The length of a degE7 of latitude (mm), times 1,000: the Earth's circumference is 40,030 km.
const LENGTH: i64 = 11_119;

impl Position {
    /// Returns the distance to another position (m), for distances of up to some hundred kilometres. It is exact to one percent.
    pub(crate) fn distance_to(&self, other: &Self) -> u32 {
        let [north, mut east] =
            [[self.lat, other.lat], [self.lon, other.lon]].map(|[from, to]| i64::from(to).wrapping_sub(from.into()));
        // The shorter way round the Earth.
        if east > 1_800_000_000 {
            east = east.wrapping_sub(3_600_000_000);
        } else if east < -1_800_000_000 {
            east = east.wrapping_add(3_600_000_000);
        }
        let up = i64::from(other.altitude).wrapping_sub(self.altitude.into());
        let [north, east] = [north, east].map(|angle| angle.wrapping_mul(LENGTH) / 1_000);
        let east = east.wrapping_mul(cosine(self.lat)) / 1_000;
        // In centimetres, the sum of the squares has 64 bits.
        let square = [north, east, up].map(|length| (length / 10).unsigned_abs().saturating_pow(2));
        let sum = square.into_iter().fold(0_u64, u64::saturating_add);
        u32::try_from(sum.isqrt() / 100).unwrap_or(u32::MAX)
    }
}

/// Returns the cosine of a latitude (degE7), times 1,000, by the first terms of its series.
fn cosine(lat: i32) -> i64 {
    // Milliradians, at most 1,571.
    let angle = i64::from(lat).clamp(-900_000_000, 900_000_000).wrapping_mul(1_745) / 1_000_000_000;
    let square = angle.wrapping_mul(angle) / 1_000;
    let fourth = square.wrapping_mul(square) / 1_000;
    let sixth = fourth.wrapping_mul(square) / 1_000;
    1_000_i64.wrapping_sub(square / 2).wrapping_add(fourth / 24).wrapping_sub(sixth / 720)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZURICH: Position = Position { lat: 473_977_420, lon: 85_455_940, altitude: 488_000 };

    /// By the haversine formula.
    #[test]
    fn distances_are_exact_to_one_percent() {
        let near = |expected: u32, other: Position| {
            let distance = ZURICH.distance_to(&other);
            assert!(distance.abs_diff(expected) <= expected / 100, "{distance} m instead of {expected} m");
            assert!(other.distance_to(&ZURICH).abs_diff(expected) <= expected / 50);
        };
        near(11_119, Position { lat: 474_977_420, ..ZURICH });
        near(7_527, Position { lon: 86_455_940, ..ZURICH });
        near(1_000, Position { altitude: 1_488_000, ..ZURICH });
        near(13_427, Position { lat: 474_977_420, lon: 86_455_940, ..ZURICH });
    }

    #[test]
    fn the_shorter_way_crosses_the_date_line() {
        let [west, east] = [1_799_900_000, -1_799_900_000].map(|lon| Position { lat: 0, lon, altitude: 0 });
        assert!(west.distance_to(&east).abs_diff(2_223) < 30);
    }

    #[test]
    fn no_position_overflows() {
        for lat in [i32::MIN, -900_000_000, 0, i32::MAX] {
            for lon in [i32::MIN, 0, i32::MAX] {
                for altitude in [i32::MIN, i32::MAX] {
                    let _ = ZURICH.distance_to(&Position { lat, lon, altitude });
                }
            }
        }
    }
}
