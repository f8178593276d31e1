//! When to repeat the request for a missing item, and when to give up (M-40 to M-42, SEC-10).
//!
//! Until the first round trip is measured, each repetition doubles the wait (exponential backoff). Afterwards the wait
//! is one and a half round trips. As in Karn's algorithm, the answer to a repeated request is not a sample: it may
//! belong to any of the requests. The final timeout runs whether or not the link accepts requests, so that neither a
//! vanished client nor a stalled link can occupy the staging area.

use core::num::Saturating;

use crate::time::{Duration, Instant};

/// Bounds of the interval between requests (µs).
const MIN_INTERVAL: u32 = 250_000;
const MAX_INTERVAL: u32 = 1_000_000;

/// The upload times out after this long without an item *and* this many repeated requests.
const TIMEOUT: Duration = Duration::from_secs(5);
const MIN_RETRIES: u8 = 5;

/// The timers of one upload.
#[derive(Clone, Debug)]
pub(super) struct RetryTimer {
    /// Smoothed time from a request to its item (µs); 0 until the first measurement.
    round_trip: Saturating<u32>,
    /// Time from the first request to the last item, if the item was requested more than once (µs): an upper bound of
    /// the round trip, because the item may answer any of the requests. 0 if the item was requested once.
    ambiguous: Saturating<u32>,
    /// When the missing item was first requested.
    requested_at: Option<Instant>,
    /// Number of repeated requests for the missing item.
    retries: Saturating<u8>,
    retry_at: Instant,
    /// When the last item was received, or the upload began.
    progress_at: Instant,
}

impl RetryTimer {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            round_trip: Saturating(0),
            ambiguous: Saturating(0),
            requested_at: None,
            retries: Saturating(0),
            retry_at: now + Duration::from_micros(MIN_INTERVAL.into()),
            progress_at: now,
        }
    }

    /// Returns how long to wait for the item before the next request, within the bounds.
    fn interval(&self) -> Duration {
        let wait = match (self.round_trip.0, self.retries.0) {
            (0, 0) => MIN_INTERVAL,
            (0, 1) => 500_000,
            (0, _) => MAX_INTERVAL,
            (round_trip, _) => (self.round_trip + Saturating(round_trip / 2)).0,
        };
        Duration::from_micros(wait.clamp(MIN_INTERVAL, MAX_INTERVAL).into())
    }

    /// Waits for the item from `start` on.
    fn wait_from(&mut self, start: Instant) {
        self.retry_at = start + self.interval();
    }

    /// Records that a request was sent.
    pub(super) fn on_request(&mut self, now: Instant) {
        self.requested_at.get_or_insert(now);
        self.wait_from(now);
    }

    /// Records that the requested item was received.
    pub(super) fn on_item(&mut self, now: Instant) {
        let elapsed = self.requested_at.take().map_or(0, |at| {
            let elapsed = now - at;
            u32::try_from(elapsed.as_micros()).unwrap_or(u32::MAX)
        });
        let was_requested_once = self.retries.0 == 0;
        if was_requested_once {
            self.add_sample(elapsed);
            self.ambiguous = Saturating(0);
        } else {
            self.ambiguous = Saturating(elapsed);
        }
        self.retries = Saturating(0);
        self.progress_at = now;
        self.wait_from(now);
    }

    /// Records that the last item was received a second time. So the repeated request for it was premature, and the
    /// round trip is the whole time from the first request. The pending request waits for a round trip, too.
    pub(super) fn on_duplicate(&mut self) {
        if self.ambiguous > self.round_trip {
            self.add_sample(self.ambiguous.0);
            if let Some(requested_at) = self.requested_at.filter(|_| self.retries.0 == 0) {
                self.wait_from(requested_at);
            }
        }
        self.ambiguous = Saturating(0);
    }

    /// Adds a sample to the smoothed round trip, with a weight of 1/4.
    fn add_sample(&mut self, elapsed: u32) {
        self.round_trip = match self.round_trip.0 {
            0 => Saturating(elapsed.max(1)),
            average => self.round_trip - Saturating(average / 4) + Saturating(elapsed / 4),
        };
    }

    /// When the next request or the timeout is due.
    pub(super) fn deadline(&self) -> Instant {
        self.retry_at
    }

    /// Whether the upload has timed out: no item was received for a while, in spite of enough repeated requests.
    pub(super) fn has_timed_out(&self, now: Instant) -> bool {
        self.retries.0 >= MIN_RETRIES && now - self.progress_at >= TIMEOUT
    }

    /// Counts a repeated request, whether or not the link accepts it.
    pub(super) fn count_retry(&mut self, now: Instant) {
        self.retries += 1;
        self.wait_from(now);
    }

    /// Returns the number of repeated requests for the item.
    pub(super) fn retries(&self) -> u8 {
        self.retries.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(millis: u64) -> Instant {
        Instant::from_millis(millis)
    }

    /// Receives `items` items, each `millis` ms after its request, from `now` on. Returns when the last one was
    /// received.
    fn answer(timer: &mut RetryTimer, now: u64, items: u64, millis: u64) -> u64 {
        for item in 0..items {
            timer.on_request(at(now + item * millis));
            timer.on_item(at(now + (item + 1) * millis));
        }
        now + items * millis
    }

    /// M-40
    #[test]
    fn interval_follows_the_round_trip_within_its_bounds() {
        let mut timer = RetryTimer::new(at(0));
        for (round_trip, interval) in [(1, 250), (100, 250), (300, 450), (600, 900), (5_000, 1_000), (10, 250)] {
            answer(&mut timer, 0, 40, round_trip);
            let waits = timer.interval().as_millis();
            assert!((interval - 10..=interval).contains(&waits), "{waits} ms for {round_trip} ms");
        }
    }

    /// M-40: until a round trip is measured, the waits are 250, 500, 1000, 1000 ms for every item. The first
    /// measurement is not smoothed.
    #[test]
    fn interval_doubles_until_a_round_trip_is_measured() {
        let mut timer = RetryTimer::new(at(0));
        for _ in 0..2 {
            let mut waits = [0; 5];
            for wait in &mut waits {
                timer.on_request(at(0));
                *wait = (timer.deadline() - at(0)).as_millis();
                timer.count_retry(at(0));
            }
            assert_eq!(waits, [250, 500, 1_000, 1_000, 1_000]);
            timer.on_item(at(1_600));
        }
        timer.on_request(at(1_600));
        assert_eq!(timer.deadline(), at(1_850));
        // The duplicate of the last item shows a round trip of 1.6 s: the pending request waits longer too.
        timer.on_duplicate();
        assert_eq!(timer.deadline(), at(2_600));
    }

    #[test]
    fn an_item_requested_twice_is_a_sample_only_if_it_is_received_twice() {
        // A lost request.
        let mut timer = RetryTimer::new(at(0));
        timer.on_request(at(0));
        timer.count_retry(at(250));
        timer.on_request(at(250));
        timer.on_item(at(260));
        assert_eq!(timer.interval(), Duration::from_millis(250));
        // A slow request: its item is received a second time.
        timer.on_request(at(300));
        timer.count_retry(at(550));
        timer.on_request(at(550));
        timer.on_item(at(700));
        assert_eq!(timer.interval(), Duration::from_millis(250));
        timer.on_duplicate();
        let interval = timer.interval();
        assert!(interval > Duration::from_millis(250));
        timer.on_duplicate();
        assert_eq!(timer.interval(), interval, "once");
    }

    /// M-41: with one request a second, the number of requests decides; with more frequent ones, the five seconds do.
    #[test]
    fn timeout_takes_five_seconds_and_five_retries() {
        for (round_trip, end) in [(1, 5_000), (900, 6_000)] {
            let mut timer = RetryTimer::new(at(0));
            let now = answer(&mut timer, 0, 40, round_trip);
            // The retries of one item do not count for the next one.
            timer.on_request(at(now));
            (0..4).for_each(|_| timer.count_retry(at(now)));
            timer.on_item(at(now));
            timer.on_request(at(now));
            let mut retries = 0;
            while !timer.has_timed_out(timer.deadline()) {
                retries += 1;
                timer.count_retry(timer.deadline());
            }
            let waited = (timer.deadline() - at(now)).as_millis();
            assert!(retries >= 5 && (end - 100..end + 250).contains(&waited), "{retries} retries, {waited} ms");
        }
    }
}
