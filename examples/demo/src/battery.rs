//! The battery: cells that drain.

use crate::tuning::Tuning;

/// The battery.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Battery {
    /// From 1 (full) to 0.
    pub remaining: f32,
    /// V
    pub voltage: f32,
    /// A
    pub current: f32,
    /// How many cells it has.
    pub(crate) cells: u8,
    /// A·s
    pub(crate) capacity: f32,
    pub(crate) charge: Charge,
    /// What was drawn and is not taken from `remaining` yet, A·s: a step's alone would be rounded away.
    drawn: f32,
}

/// How much is left in it.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) enum Charge {
    Critical,
    Low,
    Good,
}

impl Battery {
    pub(crate) const FULL: Self = Self {
        remaining: 1.0,
        voltage: 12.6,
        current: 0.0,
        cells: 3,
        capacity: 18_000.0,
        charge: Charge::Good,
        drawn: 0.0,
    };

    pub(crate) fn is_low(&self) -> bool {
        self.charge <= Charge::Low
    }

    pub(crate) fn drain(&mut self, tuning: &Tuning, current: f32, dt: f32) {
        self.current = current;
        // 1 mAh is 3.6 A·s.
        self.capacity = 3.6 * tuning.get(Tuning::BAT_CAPACITY);
        self.drawn += current * dt;
        if self.drawn >= 1e-4 * self.capacity {
            self.remaining = (self.remaining - self.drawn / self.capacity).max(0.0);
            self.drawn = 0.0;
        }
        self.cells = tuning.get(Tuning::BAT_N_CELLS).try_into().unwrap_or(u8::MAX);
        let (empty, charged) = (tuning.get(Tuning::BAT_V_EMPTY), tuning.get(Tuning::BAT_V_CHARGED));
        let cells = f32::from(self.cells) * (empty + (charged - empty) * self.remaining);
        self.voltage = (cells - tuning.get(Tuning::BAT_R_INTERNAL) * current).max(0.0);
        self.charge = if self.remaining < tuning.get(Tuning::BAT_CRIT_THR) {
            Charge::Critical
        } else if self.remaining < tuning.get(Tuning::BAT_LOW_THR) {
            Charge::Low
        } else {
            Charge::Good
        };
    }
}
