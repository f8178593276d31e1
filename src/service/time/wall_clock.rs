//! SYSTEM_TIME: the time of day, once the vehicle knows it.
//!
//! Rule T-4. A vehicle learns the time from its satellite receiver, from a clock of its own, or from another
//! component's SYSTEM_TIME, some time after the start. Until then `time_unix_usec` is 0.

use crate::dialect::SystemTime;
use crate::time::{Clock, Instant};

/// Converts the time since boot to the time of day (T-4). It never goes back by itself: if the firmware's clock is set
/// back by a second or more, the time of day continues from where it was, and is right again when it is next
/// [set](Self::set) (X-7).
///
/// ```
/// use mavstack::dialect::SystemTime;
/// use mavstack::clock::WallClock;
/// use mavstack::{Duration, Fill, Instant, Message, Stream, Telemetry};
///
/// struct Rover { clock: WallClock }
///
/// impl Rover {
///     /// The satellite receiver has reported the time.
///     fn on_fix(&mut self, now: Instant, unix_usec: u64) {
///         self.clock.set(now, unix_usec);
///     }
/// }
///
/// impl Telemetry for Rover {
///     const STREAMS: &'static [Stream] = &[Stream::of::<SystemTime>().every(Duration::from_secs(1))];
///
///     fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
///         let now = out.now();
///         match id {
///             SystemTime::ID => out.put(&self.clock.message(out.now())),
///             _ => false,
///         }
///     }
/// }
/// # let mut rover = Rover { clock: WallClock::new() };
/// # rover.on_fix(Instant::from_millis(2_000), 1_700_000_000_000_000);
/// # assert_eq!(rover.clock.unix_usec(Instant::from_millis(2_001)), Some(1_700_000_000_001_000));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WallClock {
    /// Unix time at boot (µs), modulo 2^64; meaningless until it is known.
    boot: u64,
    is_known: bool,
    clock: Clock,
}

impl WallClock {
    /// Returns a clock whose time is not known yet.
    pub const fn new() -> Self {
        Self { boot: 0, is_known: false, clock: Clock::NEW }
    }

    /// Sets the time: at `now` it is `unix_usec` µs since 1970-01-01 00:00 UTC, as in SYSTEM_TIME.time_unix_usec. 0 is
    /// ignored.
    pub const fn set(&mut self, now: Instant, unix_usec: u64) {
        if unix_usec != 0 {
            self.clock.follow(now);
            self.boot = unix_usec.wrapping_sub(self.clock.now().as_micros());
            self.is_known = true;
        }
    }

    /// Returns the time at `now` (µs since 1970-01-01 00:00 UTC), if it is known. `now` is the present: an earlier
    /// moment would look like a clock that was set back.
    pub const fn unix_usec(&mut self, now: Instant) -> Option<u64> {
        self.clock.follow(now);
        if self.is_known { Some(self.boot.wrapping_add(self.clock.now().as_micros())) } else { None }
    }

    /// Returns SYSTEM_TIME at `now`. Its time since boot wraps after 49 days (D-1).
    pub fn message(&mut self, now: Instant) -> SystemTime {
        SystemTime { time_unix_usec: self.unix_usec(now).unwrap_or(0), time_boot_ms: now.time_boot_ms() }
    }
}
