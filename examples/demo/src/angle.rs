//! Sine and cosine by polynomial approximation, for the limited range of angles that the vehicle uses. The functions of
//! `libm` accept any angle and are exact to the last bit. They need 900 bytes of stack: more than any other function of
//! the firmware.

use core::f32::consts::FRAC_PI_2;

use libm::fabsf;

/// Returns the sine of an angle (rad) from -π/2 to π/2. The error is less than 1e-6.
pub fn sin(angle: f32) -> f32 {
    let square = angle * angle;
    // The minimax polynomial of degree 7.
    angle * (0.999_996_6 + square * (-0.166_648_24 + square * (0.008_306_29 + square * -0.000_183_63)))
}

/// Returns the cosine of an angle (rad) from -π to π. The error is less than 1e-6.
pub fn cos(angle: f32) -> f32 {
    sin(FRAC_PI_2 - fabsf(angle))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_standard_library() {
        for step in -1_000..=1_000 {
            let angle = step as f32 / 1_000.0 * FRAC_PI_2;
            assert!((sin(angle) - angle.sin()).abs() < 1e-6, "{angle}: {}", sin(angle));
            assert!((cos(2.0 * angle) - (2.0 * angle).cos()).abs() < 1e-6, "{angle}: {}", cos(2.0 * angle));
        }
    }
}
