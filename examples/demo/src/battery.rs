//! The battery: three cells that drain.

/// The battery: three cells.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Battery {
    /// From 1 (full) to 0.
    pub remaining: f32,
    /// V
    pub voltage: f32,
    /// A
    pub current: f32,
}

impl Battery {
    pub(crate) const FULL: Self = Self { remaining: 1.0, voltage: 12.6, current: 0.0 };
    /// How many cells it has.
    pub(crate) const CELLS: f32 = 3.0;
    /// A·s
    pub(crate) const CAPACITY: f32 = 5.0 * 3_600.0;
    const LOW: f32 = 0.15;

    pub(crate) fn is_low(&self) -> bool {
        self.remaining < Self::LOW
    }

    pub(crate) fn drain(&mut self, current: f32, dt: f32) {
        self.current = current;
        self.remaining = (self.remaining - current * dt / Self::CAPACITY).max(0.0);
        self.voltage = 10.5 + 2.1 * self.remaining - 0.02 * current;
    }
}
