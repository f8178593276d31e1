//! Counters, and logging: one event per protocol transition, drop counters and refused requests at most once a second. Logging
//! compiles to nothing without the feature `defmt`.

#[cfg(any(test, feature = "defmt"))]
use crate::time::Duration;
use crate::time::Instant;

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

/// Defines the type of some counters, which wrap. Each is marked `drop` or `count`: `drops` is the sum of the former.
macro_rules! counters {
    ($(#[$meta:meta])* $Counters:ident { $($(#[$doc:meta])* $kind:ident $counter:ident,)* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[non_exhaustive]
        pub struct $Counters { $($(#[$doc])* pub $counter: u32,)* }

        impl $Counters {
            pub(crate) const ZERO: Self = Self { $($counter: 0),* };
        }

        impl $crate::log::Counters for $Counters {
            const NAME: &'static str = stringify!($Counters);

            fn each(&self, mut counter: impl FnMut(&'static str, u32)) {
                $(counter(stringify!($counter), self.$counter);)*
            }

            fn drops(&self) -> u32 {
                0u32 $(.wrapping_add(counters!(@$kind self.$counter)))*
            }

            #[cfg(feature = "defmt")]
            fn log(&self) {
                event!("{}", self);
            }
        }
    };
    (@drop $counter:expr) => { $counter };
    (@count $counter:expr) => { 0 };
}

/// The counters of a service, or of a service on one link.
pub trait Counters {
    /// Their name in the log, and in [`Counter::of`](crate::Counter::of).
    const NAME: &'static str;

    /// Passes the name and the value of each counter to `counter`; by default only the sum, as "drops".
    fn each(&self, mut counter: impl FnMut(&'static str, u32)) {
        counter("drops", self.drops());
    }

    /// Returns the sum of the drop counters. Wraps.
    fn drops(&self) -> u32;

    /// Logs all counters; by default their name and their sum.
    #[cfg(feature = "defmt")]
    fn log(&self) {
        event!("{=str}: {=u32} dropped", Self::NAME, self.drops());
    }
}

/// Increments a counter, which wraps.
pub(crate) fn increment(counter: &mut u32) {
    count(counter, 1);
}

/// Adds to a counter, which wraps.
pub(crate) fn count(counter: &mut u32, number: u32) {
    *counter = counter.wrapping_add(number);
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
            (self.count, self.due) = (count, now + Self::PERIOD);
        }
        is_due
    }
}

/// Rate limit for logging refused requests, which a peer can send at the rate of its link: at most one a second. The next
/// one that is logged says how many there were.
#[derive(Clone, Debug)]
pub(crate) struct RefusalLog {
    #[cfg(any(test, feature = "defmt"))]
    log: DropLog,
    #[cfg(any(test, feature = "defmt"))]
    count: u32,
}

impl RefusalLog {
    pub(crate) const NEW: Self = Self {
        #[cfg(any(test, feature = "defmt"))]
        log: DropLog::NEW,
        #[cfg(any(test, feature = "defmt"))]
        count: 0,
    };

    /// Counts a refused request. Returns the count if this one should be logged.
    #[cfg(any(test, feature = "defmt"))]
    pub(crate) fn count(&mut self, now: Instant) -> Option<u32> {
        self.count = self.count.wrapping_add(1);
        self.log.is_due(now, self.count).then_some(self.count)
    }

    /// Returns how many were counted.
    #[cfg(test)]
    pub(crate) const fn total(&self) -> u32 {
        self.count
    }

    /// Without the feature `defmt`, nothing is logged.
    #[cfg(not(any(test, feature = "defmt")))]
    #[allow(clippy::unused_self, clippy::needless_pass_by_ref_mut, reason = "as with the feature")]
    pub(crate) const fn count(&mut self, _: Instant) -> Option<u32> {
        None
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

    /// SEC-2: however fast a peer sends requests that are refused, one is logged a second, the first one at once.
    #[test]
    fn refused_requests_are_logged_once_a_second() {
        let mut log = RefusalLog::NEW;
        let logged: Vec<_> = (5..2_500).filter_map(|ms| Some((ms, log.count(Instant::from_millis(ms))?))).collect();
        assert_eq!(logged, [(5, 1), (1_005, 1_001), (2_005, 2_001)]);
        assert_eq!(log.count(Instant::from_millis(9_000)), Some(2_496), "after a pause");
    }
}
