//! When to ask again for an item that does not come, and when to give up (M-40, M-41).
//!
//! Until the first round trip is measured, each repetition doubles the wait; afterwards the wait is one and a half
//! round trips. The final timeout depends on the clock alone, so that neither a vanished partner nor a stuck link can
//! occupy the staging area.

use crate::time::{Duration, Instant};

/// Bounds of the time between requests.
const MIN_INTERVAL: Duration = Duration::from_millis(250);
const MAX_INTERVAL: Duration = Duration::from_secs(1);

/// How often the wait doubles at most before the first measurement: 250, 500, 1000 ms.
const DOUBLINGS: u8 = 2;

/// The upload is over after so long without an item *and* so many requests in vain.
const PATIENCE: Duration = Duration::from_secs(5);
const RETRIES: u8 = 5;

/// The clock of one upload.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    /// From a request to its item (µs), averaged; 0 until the first one is measured.
    round_trip: u32,
    /// The same of the last item that took more than one request (µs): an upper bound, as it may have been any of them.
    doubtful: u32,
    /// When the item that is missing was first asked for.
    asked_at: Option<Instant>,
    /// How often it was asked for again.
    retries: u8,
    retry_at: Instant,
    /// The last item, or the beginning.
    progress_at: Instant,
}

impl Pace {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            round_trip: 0,
            doubtful: 0,
            asked_at: None,
            retries: 0,
            retry_at: now.after(MIN_INTERVAL),
            progress_at: now,
        }
    }

    /// How long to wait for the item before the next request, within the bounds.
    fn interval(&self) -> Duration {
        let wait = match self.round_trip {
            0 => MIN_INTERVAL.as_micros().wrapping_shl(self.retries.min(DOUBLINGS).into()),
            round_trip => u64::from(round_trip).saturating_add(u64::from(round_trip / 2)),
        };
        Duration::from_micros(wait).clamp(MIN_INTERVAL, MAX_INTERVAL)
    }

    /// The request went out.
    pub(super) fn asked(&mut self, now: Instant) {
        self.asked_at.get_or_insert(now);
        self.retry_at = now.after(self.interval());
    }

    /// The item came.
    pub(super) fn answered(&mut self, now: Instant) {
        let taken = self.asked_at.take().map_or(0, |at| micros(now.since(at)));
        if self.retries == 0 {
            self.adapt(taken);
            self.doubtful = 0;
        } else {
            self.doubtful = taken;
        }
        self.retries = 0;
        self.progress_at = now;
        self.retry_at = now.after(self.interval());
    }

    /// The last item was received a second time. So the repeated request was too early, and the round trip is the whole
    /// time since the first request. The pending request waits that long as well.
    pub(super) fn repeated(&mut self) {
        if self.doubtful > self.round_trip {
            self.adapt(self.doubtful);
            if let Some(asked_at) = self.asked_at.filter(|_| self.retries == 0) {
                self.retry_at = asked_at.after(self.interval());
            }
        }
        self.doubtful = 0;
    }

    fn adapt(&mut self, taken: u32) {
        self.round_trip = match self.round_trip {
            0 => taken.max(1),
            average => average.wrapping_sub(average / 4).saturating_add(taken / 4),
        };
    }

    /// When the item is overdue.
    pub(super) fn deadline(&self) -> Instant {
        self.retry_at
    }

    /// How long ago the last item came.
    fn since_progress(&self, now: Instant) -> Duration {
        now.since(self.progress_at)
    }

    /// Whether an overdue item will not come any more.
    pub(super) fn is_over(&self, now: Instant) -> bool {
        self.retries >= RETRIES && self.since_progress(now) >= PATIENCE
    }

    /// The item is to be asked for again. Counted whether or not the link takes the request.
    pub(super) fn retry(&mut self, now: Instant) {
        self.retries = self.retries.saturating_add(1);
        self.retry_at = now.after(self.interval());
    }

    /// Returns how often the item was requested again.
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

    /// `items` items, each `millis` ms after it was asked for, from `now` on. When the last one came.
    fn answer(pace: &mut Pace, now: u64, items: u64, millis: u64) -> u64 {
        for item in 0..items {
            pace.asked(at(now + item * millis));
            pace.answered(at(now + (item + 1) * millis));
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

    /// M-40: the waits are 250, 500, 1000, 1000 ms, for every item, as long as no round trip is measured; the first
    /// measurement counts in full.
    #[test]
    fn interval_doubles_until_a_round_trip_is_measured() {
        let mut pace = Pace::new(at(0));
        for _ in 0..2 {
            let mut waits = [0; 5];
            for wait in &mut waits {
                pace.asked(at(0));
                *wait = pace.deadline().since(at(0)).as_millis();
                pace.retry(at(0));
            }
            assert_eq!(waits, [250, 500, 1_000, 1_000, 1_000]);
            pace.answered(at(1_600));
        }
        pace.asked(at(1_600));
        assert_eq!(pace.deadline(), at(1_850));
        // The duplicate of the last item shows a round trip of 1.6 s: the pending request waits longer as well.
        pace.repeated();
        assert_eq!(pace.deadline(), at(2_600));
    }

    #[test]
    fn an_item_asked_for_twice_tells_the_round_trip_only_when_it_comes_twice() {
        // A request that was lost …
        let mut pace = Pace::new(at(0));
        pace.asked(at(0));
        pace.retry(at(250));
        pace.asked(at(250));
        pace.answered(at(260));
        assert_eq!(pace.interval(), MIN_INTERVAL);
        // … and one that was only slow: its item comes a second time.
        pace.asked(at(300));
        pace.retry(at(550));
        pace.asked(at(550));
        pace.answered(at(700));
        assert_eq!(pace.interval(), MIN_INTERVAL);
        pace.repeated();
        let interval = pace.interval();
        assert!(interval > MIN_INTERVAL);
        pace.repeated();
        assert_eq!(pace.interval(), interval, "once");
    }

    /// M-41: where retries come once a second they last longer than five seconds, elsewhere the seconds do.
    #[test]
    fn patience_ends_after_five_seconds_and_five_retries() {
        for (round_trip, end) in [(1, 5_000), (900, 6_000)] {
            let mut pace = Pace::new(at(0));
            let now = answer(&mut pace, 0, 40, round_trip);
            // An item that took many requests does not use up the next one's.
            pace.asked(at(now));
            (0..4).for_each(|_| pace.retry(at(now)));
            pace.answered(at(now));
            pace.asked(at(now));
            let mut retries = 0;
            while !pace.is_over(pace.deadline()) {
                retries += 1;
                pace.retry(pace.deadline());
            }
            let waited = pace.deadline().since(at(now)).as_millis();
            assert!(retries >= 5 && (end - 100..end + 250).contains(&waited), "{retries} retries, {waited} ms");
        }
    }
}
