//! Latitude and longitude to metres around the start and back, on a sphere that is flat near it; and where home is.

use mavstack::dialect::MavFrame;

use crate::angle::cos;
use crate::body::Vector;

/// Metres in 1e-7 degrees of latitude.
const METRES_PER_UNIT: f32 = 0.011_131_95;

/// Half a turn in 1e-7 degrees.
const HALF_TURN: i64 = 1_800_000_000;

/// Where the vehicle is when it is switched on, which local coordinates count from; and home, which is there at first and
/// can be moved.
#[derive(Clone, Copy, Debug)]
pub struct Home {
    /// deg·1e7
    pub latitude: i32,
    /// deg·1e7
    pub longitude: i32,
    /// m above mean sea level
    pub altitude: f32,
    /// Cosine of the latitude: how much shorter a degree of longitude is.
    cos_latitude: f32,
    /// Home.
    pub spot: Vector,
}

impl Home {
    /// A meadow north of Zürich.
    pub const DEMO: Self = Self {
        latitude: 473_977_420,
        longitude: 85_455_940,
        altitude: 488.0,
        cos_latitude: 0.676_890,
        spot: Vector::ZERO,
    };

    /// At a latitude and longitude (deg·1e7) and an altitude (m above mean sea level).
    pub fn at(latitude: i32, longitude: i32, altitude: f32) -> Self {
        let cos_latitude = cos((latitude as f32 * 1e-7).to_radians());
        Self { latitude, longitude, altitude, cos_latitude, spot: Vector::ZERO }
    }

    /// Metres north and east of the start of a place (deg·1e7), the short way round.
    pub fn to_local(self, latitude: i32, longitude: i32) -> (f32, f32) {
        let north = i64::from(latitude) - i64::from(self.latitude);
        let east = i64::from(longitude) - i64::from(self.longitude);
        (north as f32 * METRES_PER_UNIT, short_way(east) as f32 * METRES_PER_UNIT * self.cos_latitude)
    }

    /// Latitude and longitude (deg·1e7) of a place near the start.
    // Messages are made deep down: what a call takes of the stack is dear there.
    #[inline(always)]
    pub fn to_global(self, north: f32, east: f32) -> (i32, i32) {
        let latitude = i64::from(self.latitude) + round(north / METRES_PER_UNIT);
        let longitude = i64::from(self.longitude) + round(east / (METRES_PER_UNIT * self.cos_latitude));
        (latitude.clamp(-HALF_TURN / 2, HALF_TURN / 2) as i32, short_way(longitude) as i32)
    }

    /// Height above the start (m) of an altitude in `frame`; `None` when the vehicle cannot tell.
    pub fn to_height(self, frame: MavFrame, z: f32) -> Option<f32> {
        match frame {
            _ if !z.is_finite() => None,
            MavFrame::GLOBAL | MavFrame::GLOBAL_INT => Some(z - self.altitude),
            MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT => Some(z - self.spot.down),
            _ => None,
        }
    }

    /// The same with home elsewhere.
    pub fn moved_to(self, spot: Vector) -> Self {
        Self { spot, ..self }
    }

    /// Whether a place is not further from home than `far`, nor higher above it than `high` (m); 0 is no limit.
    pub fn is_near(self, far: f32, high: f32, place: Vector) -> bool {
        (far == 0.0 || place.distance(self.spot) <= far) && (high == 0.0 || self.spot.down - place.down <= high)
    }
}

/// So many 1e-7 degrees of longitude, which are less than one and a half turns, to within half a turn. Without a division: the
/// fence asks for every corner in every step.
fn short_way(longitude: i64) -> i64 {
    if longitude < -HALF_TURN {
        longitude + 2 * HALF_TURN
    } else if longitude >= HALF_TURN {
        longitude - 2 * HALF_TURN
    } else {
        longitude
    }
}

fn round(value: f32) -> i64 {
    (value + if value < 0.0 { -0.5 } else { 0.5 }) as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_near_home_come_back_within_a_centimetre() {
        let home = Home::DEMO;
        for (north, east) in [(0.0, 0.0), (120.5, -80.25), (-2_000.0, 3_000.0)] {
            let (latitude, longitude) = home.to_global(north, east);
            let (back_north, back_east) = home.to_local(latitude, longitude);
            assert!((back_north - north).abs() < 0.02 && (back_east - east).abs() < 0.02, "{north} {east}");
        }
    }

    #[test]
    fn a_degree_of_latitude_is_111_km() {
        let (north, east) = Home::DEMO.to_local(Home::DEMO.latitude + 10_000_000, Home::DEMO.longitude);
        assert!((north - 111_319.5).abs() < 1.0, "{north}");
        assert_eq!(east, 0.0);
    }

    #[test]
    fn the_date_line_is_crossed_the_short_way() {
        let fiji = Home { latitude: 0, longitude: 1_799_999_000, altitude: 0.0, cos_latitude: 1.0, spot: Vector::ZERO };
        let (_, east) = fiji.to_local(0, -1_799_999_000);
        assert!((east - 22.26).abs() < 0.1, "{east}");
        assert_eq!(fiji.to_global(0.0, east).1, -1_799_999_000);
    }
}
