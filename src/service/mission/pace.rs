//! When to repeat the request for a missing item, and when to give up (M-40 to M-42, SEC-10).
//!
//! Until the first round trip is measured, each repetition doubles the wait (exponential backoff). Afterwards the wait is one
//! and a half round trips. As in Karn's algorithm, the answer to a repeated request is not a sample: it may belong to any of the
//! requests. The final timeout runs whether or not the link accepts requests, so that neither a vanished client nor a
//! stalled link can occupy the staging area.

use crate::time::{Duration, Instant};

/// Bounds of the interval between requests.
const MIN_INTERVAL: Duration = Duration::from_millis(250);
const MAX_INTERVAL: Duration = Duration::from_secs(1);

/// Maximum number of doublings before the first measurement: 250, 500, 1000 ms.
const DOUBLINGS: u8 = 2;

/// The upload times out after this long without an item *and* this many repeated requests.
const TIMEOUT: Duration = Duration::from_secs(5);
const MIN_RETRIES: u8 = 5;

/// The timers of one upload.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    /// Smoothed time from a request to its item (µs); 0 until the first measurement.
    round_trip: u32,
    /// Time from the first request to the last item, if that took more than one request (µs): an upper bound, because the item
    /// may answer any of them. Otherwise 0.
    ambiguous: u32,
    /// When the missing item was first requested.
    requested_at: Option<Instant>,
    /// Number of repeated requests for it.
    retries: u8,
    retry_at: Instant,
    /// When the last item was received, or the upload began.
    progress_at: Instant,
}

impl Pace {
    /// All zero bits.
    pub(super) const VACANT: Self = Self {
        round_trip: 0,
        ambiguous: 0,
        requested_at: None,
        retries: 0,
        retry_at: Instant::ZERO,
        progress_at: Instant::ZERO,
    };

    pub(super) fn new(now: Instant) -> Self {
        Self {
            round_trip: 0,
            ambiguous: 0,
            requested_at: None,
            retries: 0,
            retry_at: now + MIN_INTERVAL,
            progress_at: now,
        }
    }

    /// Returns how long to wait for the item before the next request, within the bounds.
    fn interval(&self) -> Duration {
        let wait = match self.round_trip {
            0 => MIN_INTERVAL.as_micros().wrapping_shl(self.retries.min(DOUBLINGS).into()),
            round_trip => u64::from(round_trip).saturating_add(u64::from(round_trip / 2)),
        };
        Duration::from_micros(wait).clamp(MIN_INTERVAL, MAX_INTERVAL)
    }

    /// Records that a request was sent.
    pub(super) fn requested(&mut self, now: Instant) {
        self.requested_at.get_or_insert(now);
        self.retry_at = now + self.interval();
    }

    /// Records that the requested item was received.
    pub(super) fn received(&mut self, now: Instant) {
        let elapsed = self.requested_at.take().map_or(0, |at| micros(now - at));
        if self.retries == 0 {
            self.adapt(elapsed);
            self.ambiguous = 0;
        } else {
            self.ambiguous = elapsed;
        }
        self.retries = 0;
        self.progress_at = now;
        self.retry_at = now + self.interval();
    }

    /// Records that the last item was received a second time. So its repeated request was premature, and the round trip is the
    /// whole time since the first request. The pending request waits that long too.
    pub(super) fn duplicated(&mut self) {
        if self.ambiguous > self.round_trip {
            self.adapt(self.ambiguous);
            if let Some(requested_at) = self.requested_at.filter(|_| self.retries == 0) {
                self.retry_at = requested_at + self.interval();
            }
        }
        self.ambiguous = 0;
    }

    /// Adds a sample to the smoothed round trip, with a weight of 1/4.
    fn adapt(&mut self, elapsed: u32) {
        self.round_trip = match self.round_trip {
            0 => elapsed.max(1),
            average => average.wrapping_sub(average / 4).saturating_add(elapsed / 4),
        };
    }

    /// When the next request or the timeout is due.
    pub(super) fn deadline(&self) -> Instant {
        self.retry_at
    }

    /// Returns the time since the last item.
    fn since_progress(&self, now: Instant) -> Duration {
        now - self.progress_at
    }

    /// Whether the upload has timed out.
    pub(super) fn has_timed_out(&self, now: Instant) -> bool {
        self.retries >= MIN_RETRIES && self.since_progress(now) >= TIMEOUT
    }

    /// Counts a repeated request, whether or not the link accepts it.
    pub(super) fn retry(&mut self, now: Instant) {
        self.retries = self.retries.saturating_add(1);
        self.retry_at = now + self.interval();
    }

    /// Returns the number of repeated requests for the item.
    pub(super) fn retries(&self) -> u8 {
        self.retries
    }
}

fn micros(duration: Duration) -> u32 {
    u32::try_from(duration.as_micros()).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(millis: u64) -> Instant {
        Instant::from_millis(millis)
    }

    /// Receives `items` items, each `millis` ms after its request, from `now` on. Returns when the last one was received.
    fn answer(pace: &mut Pace, now: u64, items: u64, millis: u64) -> u64 {
        for item in 0..items {
            pace.requested(at(now + item * millis));
            pace.received(at(now + (item + 1) * millis));
        }
        now + items * millis
    }

    /// M-40
    #[test]
    fn interval_follows_the_round_trip_within_its_bounds() {
        let mut pace = Pace::new(at(0));
        for (round_trip, interval) in [(1, 250), (100, 250), (300, 450), (600, 900), (5_000, 1_000), (10, 250)] {
            answer(&mut pace, 0, 40, round_trip);
            let waits = pace.interval().as_millis();
            assert!((interval - 10..=interval).contains(&waits), "{waits} ms for {round_trip} ms");
        }
    }

    /// M-40: until a round trip is measured, the waits are 250, 500, 1000, 1000 ms for every item. The first measurement is not
    /// smoothed.
    #[test]
    fn interval_doubles_until_a_round_trip_is_measured() {
        let mut pace = Pace::new(at(0));
        for _ in 0..2 {
            let mut waits = [0; 5];
            for wait in &mut waits {
                pace.requested(at(0));
                *wait = (pace.deadline() - at(0)).as_millis();
                pace.retry(at(0));
            }
            assert_eq!(waits, [250, 500, 1_000, 1_000, 1_000]);
            pace.received(at(1_600));
        }
        pace.requested(at(1_600));
        assert_eq!(pace.deadline(), at(1_850));
        // The duplicate of the last item shows a round trip of 1.6 s: the pending request waits longer too.
        pace.duplicated();
        assert_eq!(pace.deadline(), at(2_600));
    }

    #[test]
    fn an_item_requested_twice_is_a_sample_only_if_it_is_received_twice() {
        // A lost request.
        let mut pace = Pace::new(at(0));
        pace.requested(at(0));
        pace.retry(at(250));
        pace.requested(at(250));
        pace.received(at(260));
        assert_eq!(pace.interval(), MIN_INTERVAL);
        // A slow request: its item is received a second time.
        pace.requested(at(300));
        pace.retry(at(550));
        pace.requested(at(550));
        pace.received(at(700));
        assert_eq!(pace.interval(), MIN_INTERVAL);
        pace.duplicated();
        let interval = pace.interval();
        assert!(interval > MIN_INTERVAL);
        pace.duplicated();
        assert_eq!(pace.interval(), interval, "once");
    }

    /// M-41: with one request a second, the number of requests decides; with more frequent ones, the five seconds do.
    #[test]
    fn timeout_takes_five_seconds_and_five_retries() {
        for (round_trip, end) in [(1, 5_000), (900, 6_000)] {
            let mut pace = Pace::new(at(0));
            let now = answer(&mut pace, 0, 40, round_trip);
            // The retries of one item do not count for the next one.
            pace.requested(at(now));
            (0..4).for_each(|_| pace.retry(at(now)));
            pace.received(at(now));
            pace.requested(at(now));
            let mut retries = 0;
            while !pace.has_timed_out(pace.deadline()) {
                retries += 1;
                pace.retry(pace.deadline());
            }
            let waited = (pace.deadline() - at(now)).as_millis();
            assert!(retries >= 5 && (end - 100..end + 250).contains(&waited), "{retries} retries, {waited} ms");
        }
    }
}
