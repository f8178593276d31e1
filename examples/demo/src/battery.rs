//! A simulated battery.

use mavstack::Context;

use crate::tuning::Tuning;

/// A battery: its charge, voltage and current.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Battery {
    /// Remaining charge, from 1 (full) to 0 (empty).
    pub remaining: f32,
    /// Voltage (V).
    pub voltage: f32,
    /// Current drawn (A).
    pub current: f32,
    /// The number of cells.
    pub(crate) cells: u8,
    /// Capacity (A·s).
    pub(crate) capacity: f32,
    pub(crate) charge: Charge,
    /// Charge drawn but not yet subtracted from `remaining` (A·s). The charge of a single step is lost to rounding.
    drawn: f32,
}

/// A level of charge, by the thresholds in the parameters.
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

    pub(crate) fn drain(&mut self, cx: &Context<'_>, current: f32, dt: f32) {
        self.current = current;
        // 1 mAh is 3.6 A·s.
        self.capacity = 3.6 * cx.parameter(Tuning::BAT_CAPACITY);
        self.drawn += current * dt;
        if self.drawn >= 1e-4 * self.capacity {
            self.remaining = (self.remaining - self.drawn / self.capacity).max(0.0);
            self.drawn = 0.0;
        }
        self.cells = cx.parameter(Tuning::BAT_N_CELLS).try_into().unwrap_or(u8::MAX);
        let (empty, charged) = (cx.parameter(Tuning::BAT_V_EMPTY), cx.parameter(Tuning::BAT_V_CHARGED));
        let cells = f32::from(self.cells) * (empty + (charged - empty) * self.remaining);
        self.voltage = (cells - cx.parameter(Tuning::BAT_R_INTERNAL) * current).max(0.0);
        self.charge = if self.remaining < cx.parameter(Tuning::BAT_CRIT_THR) {
            Charge::Critical
        } else if self.remaining < cx.parameter(Tuning::BAT_LOW_THR) {
            Charge::Low
        } else {
            Charge::Good
        };
    }
}
