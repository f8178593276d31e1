//! Sine and cosine of the few angles that the vehicle has. Those of `libm` are for any angle and exact to the last bit, and take
//! 900 bytes of stack for that: more than anything else in the firmware.

use core::f32::consts::FRAC_PI_2;

use libm::fabsf;

/// Sine of an angle (rad) of at most a quarter turn, either way. Off by less than 1e-6.
pub fn sin(angle: f32) -> f32 {
    let square = angle * angle;
    // The polynomial of this degree that is off by the least where it is off the most.
    angle * (0.999_996_6 + square * (-0.166_648_24 + square * (0.008_306_29 + square * -0.000_183_63)))
}

/// Cosine of an angle (rad) of at most half a turn, either way. Off by less than 1e-6.
pub fn cos(angle: f32) -> f32 {
    sin(FRAC_PI_2 - fabsf(angle))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_those_of_the_library() {
        for step in -1_000..=1_000 {
            let angle = step as f32 / 1_000.0 * FRAC_PI_2;
            assert!((sin(angle) - angle.sin()).abs() < 1e-6, "{angle}: {}", sin(angle));
            assert!((cos(2.0 * angle) - (2.0 * angle).cos()).abs() < 1e-6, "{angle}: {}", cos(2.0 * angle));
        }
    }
}
