//! Logging: one event per protocol transition, and drop counters at most once a second. It compiles to nothing without
//! the feature `defmt`.

#[cfg(any(test, feature = "defmt"))]
use crate::time::{Duration, Instant};

/// Logs an event for a developer at the bench.
#[cfg(feature = "defmt")]
macro_rules! event {
    ($($arg:tt)*) => { defmt::debug!($($arg)*) };
}

/// Without the feature `defmt`, the arguments are type-checked and dropped.
#[cfg(not(feature = "defmt"))]
macro_rules! event {
    ($format:literal $(, $arg:expr)* $(,)?) => { { $( let _ = &$arg; )* } };
}

/// Rate limit for logging a drop counter: at most once a second, and only when it has changed. Logging each drop would
/// take longer than receiving the noise that causes it.
#[cfg(any(test, feature = "defmt"))]
#[derive(Clone, Copy, Debug)]
pub(crate) struct DropLog {
    /// The count that was logged last.
    count: u32,
    /// When the count may be logged again.
    due: Instant,
}

#[cfg(any(test, feature = "defmt"))]
impl DropLog {
    const PERIOD: Duration = Duration::from_secs(1);

    pub(crate) const NEW: Self = Self { count: 0, due: Instant::ZERO };

    /// Returns whether to log `count` now; if so, it counts as logged.
    pub(crate) fn is_due(&mut self, now: Instant, count: u32) -> bool {
        let is_due = count != self.count && now >= self.due;
        if is_due {
            (self.count, self.due) = (count, now.after(Self::PERIOD));
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// SEC-2: however fast a counter grows, it is logged once a second, and its last value is always logged.
    #[test]
    fn counts_are_logged_once_a_second() {
        let mut log = DropLog::NEW;
        let mut logged = Vec::new();
        for ms in 0..4_000 {
            let count = ms.min(2_500);
            if log.is_due(Instant::from_millis(ms), u32::try_from(count).unwrap()) {
                logged.push((ms, count));
            }
        }
        assert_eq!(logged, [(1, 1), (1_001, 1_001), (2_001, 2_001), (3_001, 2_500)]);
    }
}
