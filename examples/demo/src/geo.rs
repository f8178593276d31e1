//! Converts between latitude and longitude and local coordinates (m), with a local tangent plane on a sphere. Also stores
//! the home position.

use mavstack::dialect::MavFrame;

use crate::angle::cos;
use crate::body::Vector;

/// Metres per 1e-7 degrees of latitude.
const METRES_PER_UNIT: f32 = 0.011_131_95;

/// Half a turn in 1e-7 degrees.
const HALF_TURN: i64 = 1_800_000_000;

/// The origin of local coordinates, which is the position at boot, and the home position. Home is the origin by default.
#[derive(Clone, Copy, Debug)]
pub struct Home {
    /// Latitude of the origin (1e-7 degrees).
    pub latitude: i32,
    /// Longitude of the origin (1e-7 degrees).
    pub longitude: i32,
    /// Altitude of the origin above mean sea level (m).
    pub altitude: f32,
    /// Cosine of the latitude: the length of a degree of longitude relative to a degree of latitude.
    cos_latitude: f32,
    /// The home position in local coordinates.
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

    /// Creates an origin from latitude, longitude (1e-7 degrees) and altitude above mean sea level (m).
    pub fn at(latitude: i32, longitude: i32, altitude: f32) -> Self {
        let cos_latitude = cos((latitude as f32 * 1e-7).to_radians());
        Self { latitude, longitude, altitude, cos_latitude, spot: Vector::ZERO }
    }

    /// Converts latitude and longitude (1e-7 degrees) to metres north and east of the origin, along the shorter way around
    /// the globe.
    pub fn to_local(self, latitude: i32, longitude: i32) -> (f32, f32) {
        let north = i64::from(latitude) - i64::from(self.latitude);
        let east = i64::from(longitude) - i64::from(self.longitude);
        (north as f32 * METRES_PER_UNIT, wrap_180(east) as f32 * METRES_PER_UNIT * self.cos_latitude)
    }

    /// Converts metres north and east of the origin to latitude and longitude (1e-7 degrees).
    // Inlined because messages are filled at the deepest point of the call graph, where each frame adds to the maximum.
    #[inline(always)]
    pub fn to_global(self, north: f32, east: f32) -> (i32, i32) {
        let latitude = i64::from(self.latitude) + round(north / METRES_PER_UNIT);
        let longitude = i64::from(self.longitude) + round(east / (METRES_PER_UNIT * self.cos_latitude));
        (latitude.clamp(-HALF_TURN / 2, HALF_TURN / 2) as i32, wrap_180(longitude) as i32)
    }

    /// Converts an altitude in `frame` to the height above the origin (m). Returns `None` for an unsupported frame, NaN or
    /// infinity.
    pub fn to_height(self, frame: MavFrame, z: f32) -> Option<f32> {
        match frame {
            _ if !z.is_finite() => None,
            MavFrame::GLOBAL | MavFrame::GLOBAL_INT => Some(z - self.altitude),
            MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT => Some(z - self.spot.down),
            _ => None,
        }
    }

    /// Returns the same origin with another home position.
    pub fn moved_to(self, spot: Vector) -> Self {
        Self { spot, ..self }
    }

    /// Whether `point` is at most `far` metres from home and at most `high` metres above it; 0 means no limit.
    pub fn is_near(self, far: f32, high: f32, point: Vector) -> bool {
        (far == 0.0 || point.distance(self.spot) <= far) && (high == 0.0 || self.spot.down - point.down <= high)
    }
}

/// Wraps a longitude (1e-7 degrees) to ±180°. The input must be within ±540°. It avoids a division because the fence calls it
/// for every corner in every step.
fn wrap_180(longitude: i64) -> i64 {
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
    fn conversion_round_trips_within_two_centimetres() {
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
    fn distances_cross_the_antimeridian() {
        let fiji = Home { latitude: 0, longitude: 1_799_999_000, altitude: 0.0, cos_latitude: 1.0, spot: Vector::ZERO };
        let (_, east) = fiji.to_local(0, -1_799_999_000);
        assert!((east - 22.26).abs() < 0.1, "{east}");
        assert_eq!(fiji.to_global(0.0, east).1, -1_799_999_000);
    }
}
