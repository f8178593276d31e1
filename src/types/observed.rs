//! Observations of the vehicle: the pulse of its flight loop, and the state that it reported last.

use super::vehicle::VehicleState;
use crate::pulse::Pulse;
use crate::time::{Duration, Instant};

/// The pulse of the flight loop and the state of the vehicle, as last observed.
#[derive(Debug)]
pub(crate) struct ObservedVehicle {
    pub(crate) pulse: PulseMonitor,
    /// The state that was reported last.
    pub(crate) state: VehicleState,
    /// Whether the vehicle had a state when it was last asked. It has none in a fault.
    pub(crate) has_state: bool,
}

impl ObservedVehicle {
    pub(crate) const fn new() -> Self {
        Self { pulse: PulseMonitor::new(), state: VehicleState::ZERO, has_state: false }
    }
}

/// Judges by samples of the pulse whether the flight loop runs.
#[derive(Clone, Debug)]
pub(crate) struct PulseMonitor {
    ticks: u32,
    observed: Option<Instant>,
    /// The last observed tick came after this moment.
    renewed: Option<Instant>,
    is_faulted: bool,
    was_good: bool,
}

impl PulseMonitor {
    pub(crate) const fn new() -> Self {
        Self { ticks: 0, observed: None, renewed: None, is_faulted: false, was_good: false }
    }

    /// Samples the pulse, and returns whether heartbeats may be sent.
    pub(crate) fn sample(&mut self, now: Instant, pulse: &Pulse, max_loop_gap: Duration) -> bool {
        let ticks = pulse.ticks();
        if ticks != self.ticks {
            self.ticks = ticks;
            // The time of the tick is unknown, except that it came after the previous sample.
            self.renewed = self.observed.or(Some(now));
        }
        self.observed = Some(now);
        self.is_faulted |= pulse.is_faulted();
        let is_good = self.is_good(now, max_loop_gap);
        if is_good != core::mem::replace(&mut self.was_good, is_good) {
            event!(
                "heartbeats: {=str}",
                if is_good { "the flight loop ticks" } else { "the flight loop has stopped or faulted" }
            );
        }
        is_good
    }

    /// Returns when the stack must sample the pulse, so that a heartbeat due at `due` finds the sample fresh.
    pub(crate) fn look_for(&self, due: Instant, max_loop_gap: Duration) -> Instant {
        let sample_at = Instant::from_micros(due.as_micros().saturating_sub(max_loop_gap.as_micros() / 2));
        if self.observed.is_none_or(|observed| observed < sample_at) { sample_at } else { due }
    }

    /// Whether heartbeats may be sent, as of the last sample.
    pub(crate) fn is_good(&self, now: Instant, max_loop_gap: Duration) -> bool {
        !self.is_faulted && self.renewed.is_some_and(|renewed| now - renewed <= max_loop_gap)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAP: Duration = Duration::from_millis(500);

    #[test]
    fn heartbeats_follow_the_pulse() {
        // H-5
        let pulse = Pulse::new();
        let mut monitor = PulseMonitor::new();
        let at = Instant::from_millis;
        assert!(!monitor.sample(at(0), &pulse, GAP), "no tick yet");
        pulse.tick();
        assert!(monitor.sample(at(10), &pulse, GAP));
        assert!(monitor.sample(at(500), &pulse, GAP), "the tick came after the sample at 0 ms");
        assert!(!monitor.sample(at(501), &pulse, GAP), "the loop is late");
        pulse.tick();
        assert!(monitor.sample(at(900), &pulse, GAP), "the loop ticks again");
        pulse.fault();
        pulse.tick();
        assert!(!monitor.sample(at(901), &pulse, GAP), "a fault is permanent");
    }
}
