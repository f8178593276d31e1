//! The flight loop's sign of life, on which heartbeats depend.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// A counter that the flight loop increments, and the stack watches: heartbeats are sent only while it advances (H-5).
///
/// It has a single writer, so it works on processors without compare-and-swap. The stack may run in the flight loop, in
/// another task or in an interrupt: in each case, the heartbeats stop when the flight loop stops.
///
/// The stack reads it in every poll. While it has advanced within [`max_loop_gap`](crate::Config::max_loop_gap) there
/// is *credit*, and each link sends a HEARTBEAT every second:
///
/// ```text
///            first tick            no tick for max_loop_gap,
///            ┌────────▶ credit ───── or a latched fault ─────▶ silent
///   silent ──┘             ▲                                     │
///                          └────────────── tick ─────────────────┘ (never after a fault)
/// ```
///
/// ```
/// use mavstack::Pulse;
/// static PULSE: Pulse = Pulse::new();
/// // At the end of each healthy pass of the flight loop, and nowhere else:
/// PULSE.tick();
/// ```
///
/// Tests run in threads and would share a `static`. Let the function that creates your stack take a `&'static Pulse`: each test then
/// passes its own, a leaked box, as in the guide [`testing`](crate::guides::testing).
#[derive(Debug)]
pub struct Pulse {
    ticks: AtomicU32,
    fault: AtomicBool,
}

impl Pulse {
    /// Returns a pulse without a tick. No heartbeat is sent before the first.
    pub const fn new() -> Self {
        Self { ticks: AtomicU32::new(0), fault: AtomicBool::new(false) }
    }

    /// Reports that the flight loop has completed a pass and is healthy. Call it from one place only.
    #[inline]
    pub fn tick(&self) {
        self.ticks.store(self.ticks.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }

    /// Stops the heartbeats until the next reset, even if ticks follow. For fault handlers.
    #[inline]
    pub fn fault(&self) {
        self.fault.store(true, Ordering::Relaxed);
    }

    /// Returns the number of ticks, which wraps.
    #[inline]
    pub(crate) fn ticks(&self) -> u32 {
        self.ticks.load(Ordering::Relaxed)
    }

    #[inline]
    pub(crate) fn is_faulted(&self) -> bool {
        self.fault.load(Ordering::Relaxed)
    }
}

impl Default for Pulse {
    fn default() -> Self {
        Self::new()
    }
}
