//! The sign of life that the flight loop gives and the heartbeat depends on.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Ticked by the flight loop, watched by the stack: heartbeats go out only while it moves (H-5).
///
/// A counter with one writer; load, add, store, so that it works on processors without compare-and-swap. The stack may
/// run beside the loop or in another task or interrupt: when the loop stops, the heartbeats stop.
///
/// The stack looks at it in every poll. As long as it moved within [`max_loop_gap`](crate::Config::max_loop_gap) there is
/// *credit*, and each link sends a HEARTBEAT a second:
///
/// ```text
///            first tick            no tick for max_loop_gap,
///            ┌────────▶ credit ───── or a latched fault ─────▶ silent
///   silent ──┘             ▲                                     │
///                          └────────────── tick ─────────────────┘   (not after a fault)
/// ```
///
/// ```
/// use mavstack::Pulse;
/// static PULSE: Pulse = Pulse::new();
/// // at the end of each healthy pass of the flight loop, and nowhere else:
/// PULSE.tick();
/// ```
#[derive(Debug)]
pub struct Pulse {
    count: AtomicU32,
    fault: AtomicBool,
}

impl Pulse {
    /// A pulse that has not ticked yet: there is no heartbeat before the first.
    pub const fn new() -> Self {
        Self { count: AtomicU32::new(0), fault: AtomicBool::new(false) }
    }

    /// The flight loop went round once, and is healthy. To be called from one place only.
    #[inline]
    pub fn tick(&self) {
        self.count.store(self.count.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }

    /// Stops the heartbeats for good, whatever ticks: for fault handlers. Only a reset takes it back.
    #[inline]
    pub fn fault(&self) {
        self.fault.store(true, Ordering::Relaxed);
    }

    /// How often it ticked; wraps.
    #[inline]
    pub(crate) fn count(&self) -> u32 {
        self.count.load(Ordering::Relaxed)
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
