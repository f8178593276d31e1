//! Timers of retries.

use mavstack::{Duration, Instant};

/// A timer of retries: a request is repeated at an interval, a limited number of times.
///
/// ```
/// use mavstack::{Duration, Instant};
/// use mavstack_station::{Due, Retry};
/// let mut retry = Retry::new(Duration::from_millis(500), 2);
/// assert_eq!(retry.due(Instant::ZERO), Due::Send);
/// assert_eq!(retry.due(Instant::from_millis(499)), Due::Wait);
/// assert_eq!(retry.due(Instant::from_millis(500)), Due::Send);
/// assert_eq!(retry.due(Instant::from_millis(1_000)), Due::GiveUp);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Retry {
    /// The time for an answer to the first try.
    first: Duration,
    interval: Duration,
    limit: u32,
    tries: u32,
    due: Instant,
}

/// What a [`Retry`] wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Due {
    /// Nothing yet.
    Wait,
    /// Send the request, for the first time or again.
    Send,
    /// The last try was not answered in time.
    GiveUp,
}

impl Retry {
    /// Creates a timer: `limit` tries, each with `interval` to be answered.
    pub fn new(interval: Duration, limit: u32) -> Self {
        Self { first: interval, interval, limit, tries: 0, due: Instant::ZERO }
    }

    /// Gives the first try another time to be answered.
    #[must_use]
    pub fn with_first(mut self, first: Duration) -> Self {
        self.first = first;
        self
    }

    /// Returns what is due, and counts a try.
    pub fn due(&mut self, now: Instant) -> Due {
        if self.tries > 0 && now < self.due {
            return Due::Wait;
        }
        if self.tries >= self.limit {
            return Due::GiveUp;
        }
        self.tries += 1;
        self.due = now + if self.tries == 1 { self.first } else { self.interval };
        Due::Send
    }

    /// Begins again, for another request: the first try is due now.
    pub fn restart(&mut self) {
        self.tries = 0;
    }

    /// Waits from now on without counting: something was heard.
    pub fn extend(&mut self, now: Instant, by: Duration) {
        self.tries = self.tries.max(1);
        self.due = now + by;
    }

    /// Is due now: the next try does not wait.
    pub fn hurry(&mut self, now: Instant) {
        self.due = now;
    }

    /// Waits for the last time: something was heard, and the request is not repeated.
    pub fn finish(&mut self, now: Instant, within: Duration) {
        self.tries = self.tries.max(1);
        self.limit = self.tries;
        self.due = now + within;
    }

    /// Whether the last try may still be answered.
    pub fn is_waiting(&self, now: Instant) -> bool {
        self.tries > 0 && now < self.due
    }

    /// Returns the tries so far.
    pub fn tries(&self) -> u32 {
        self.tries
    }
}
