//! The parameters: what may be set when, and what takes effect at a start.

use mavstack::dialect::MavParamError;
use mavstack::{ParamChange, Parameters};

use super::Quadrotor;
use crate::geo::Home;
use crate::tuning::Tuning;

impl Parameters for Quadrotor {
    type Table = Tuning;

    fn parameters_mut(&mut self) -> Option<&mut Tuning> {
        Some(&mut self.tuning)
    }

    /// A critical battery is a low one. While it is armed, what it is built of stays, and no fence leaves it outside.
    fn may_set(&mut self, change: &ParamChange<Tuning>) -> Result<(), MavParamError> {
        let low = change.value(Tuning::BAT_LOW_THR).unwrap_or(self.tuning.get(Tuning::BAT_LOW_THR));
        let critical = change.value(Tuning::BAT_CRIT_THR).unwrap_or(self.tuning.get(Tuning::BAT_CRIT_THR));
        if critical > low {
            return Err(MavParamError::VALUE_OUT_OF_RANGE);
        }
        let is_of_the_frame = change.is(Tuning::BAT_CAPACITY)
            || change.is(Tuning::BAT_N_CELLS)
            || change.is(Tuning::MAV_SYS_ID)
            || change.is(Tuning::SIM_GPS_FIX_TIME);
        let far = change.value(Tuning::GF_MAX_HOR_DIST).unwrap_or(0.0);
        let high = change.value(Tuning::GF_MAX_VER_DIST).unwrap_or(0.0);
        if self.armed && (is_of_the_frame || !self.home.is_near(far, high, self.body.position)) {
            return Err(MavParamError::PERMISSION_DENIED);
        }
        Ok(())
    }

    /// The cruise speed counts from now on, also where a mission asked for another one.
    fn parameter_changed(&mut self, change: &ParamChange<Tuning>) {
        if change.is(Tuning::MPC_XY_CRUISE) {
            self.speed = None;
        }
    }
}

impl Quadrotor {
    /// The parameters.
    pub fn tuning(&self) -> &Tuning {
        &self.tuning
    }

    /// What the parameters say of the start.
    pub(super) fn switch_on(&mut self) {
        let tuning = &self.tuning;
        let [latitude, longitude] = [Tuning::SIH_LOC_LAT0, Tuning::SIH_LOC_LON0].map(|param| tuning.get(param));
        self.home = Home::at(latitude, longitude, tuning.get(Tuning::SIH_LOC_H0));
        self.battery.remaining = f32::from(tuning.get(Tuning::SIM_BAT_START)) / 100.0;
    }
}
