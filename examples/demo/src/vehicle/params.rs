//! Parameter changes: which are allowed when, and which take effect at boot.

use mavstack::dialect::MavParamError;
use mavstack::{Context, ParamChange, Parameters};

use super::Quadrotor;
use crate::geo::Home;
use crate::tuning::Tuning;

impl Parameters for Quadrotor {
    type Table = Tuning;

    /// Requires that the critical battery threshold is not above the low threshold. While armed it refuses changes of the
    /// hardware configuration, and fences that exclude the vehicle.
    fn may_set(&mut self, cx: &mut Context<'_>, change: &ParamChange<Tuning>) -> Result<(), MavParamError> {
        let low = change.value(Tuning::BAT_LOW_THR).unwrap_or(cx.parameter(Tuning::BAT_LOW_THR));
        let critical = change.value(Tuning::BAT_CRIT_THR).unwrap_or(cx.parameter(Tuning::BAT_CRIT_THR));
        if critical > low {
            return Err(MavParamError::VALUE_OUT_OF_RANGE);
        }
        let is_hardware = change.is(Tuning::BAT_CAPACITY)
            || change.is(Tuning::BAT_N_CELLS)
            || change.is(Tuning::MAV_SYS_ID)
            || change.is(Tuning::SIM_GPS_FIX_TIME);
        let far = change.value(Tuning::GF_MAX_HOR_DIST).unwrap_or(0.0);
        let high = change.value(Tuning::GF_MAX_VER_DIST).unwrap_or(0.0);
        if self.armed && (is_hardware || !self.home.is_near(far, high, self.body.position)) {
            return Err(MavParamError::PERMISSION_DENIED);
        }
        Ok(())
    }

    /// Applies a new cruise speed at once, even if the mission has set another one.
    fn parameter_changed(&mut self, _: &mut Context<'_>, change: &ParamChange<Tuning>) {
        if change.is(Tuning::MPC_XY_CRUISE) {
            self.speed = None;
        }
    }
}

impl Quadrotor {
    /// Applies the parameters that take effect at boot.
    pub(super) fn apply_boot_parameters(&mut self, cx: &Context<'_>) {
        let [latitude, longitude] = [Tuning::SIH_LOC_LAT0, Tuning::SIH_LOC_LON0].map(|param| cx.parameter(param));
        self.home = Home::at(latitude, longitude, cx.parameter(Tuning::SIH_LOC_H0));
        self.battery.remaining = cx.parameter(Tuning::SIM_BAT_START) as f32 / 100.0;
    }
}
