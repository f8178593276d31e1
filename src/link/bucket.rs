//! A token bucket: how many bytes a link may still send.

use crate::time::Instant;

/// Bytes that a link may send at once after a rest, at least: two longest frames.
const BURST: u32 = 560;

/// Counts in byte·µs, so that filling needs no division.
#[derive(Clone, Debug)]
pub(crate) struct Bucket {
    /// Bytes/s: what flows in each µs, in units of 1/`SCALE` byte.
    rate: u32,
    level: i64,
    filled: Instant,
    /// What flowed in from one call to the next, at the last two different times: what the line takes between two polls, for
    /// polls no more than 20 ms apart.
    gap: i64,
}

impl Bucket {
    const SCALE: i64 = 1_000_000;

    /// An empty bucket into which nothing flows.
    pub(crate) const VACANT: Self = Self { rate: 0, level: 0, filled: Instant::ZERO, gap: 0 };

    pub(crate) const fn configure(&mut self, bytes_per_second: u32) {
        self.rate = bytes_per_second;
    }

    /// A tenth of a second's worth, or two longest frames.
    fn capacity(&self) -> i64 {
        Self::scaled((self.rate / 10).max(BURST))
    }

    /// Bytes as the level counts them. None of the sums here overflows: the level is never further from 0 than a tenth of a
    /// second's bytes, or two frames, and what flows or is spent in one step is below 2^56.
    fn scaled(bytes: u32) -> i64 {
        i64::from(bytes).wrapping_mul(Self::SCALE)
    }

    /// Lets the time since the last call flow in.
    pub(crate) fn fill(&mut self, now: Instant) {
        // Ten seconds fill any bucket; so bounded, a product of two u32 needs no check.
        let elapsed = now.since(self.filled).as_micros().min(10_000_000);
        self.filled = now;
        let flown = elapsed.wrapping_mul(u64::from(self.rate)).cast_signed();
        self.level = self.level.wrapping_add(flown).min(self.capacity());
        if elapsed > 0 {
            self.gap = flown.min(Self::scaled(self.rate / 50));
        }
    }

    /// Whether what can wait may be sent now. A rate of 0 is no limit.
    pub(crate) fn has_room(&self) -> bool {
        self.level >= 0 || self.rate == 0
    }

    /// Whether the line will be idle before the next poll: then a frame that is not urgent delays an urgent one by no more
    /// than itself (D-4).
    pub(crate) fn is_idle(&self) -> bool {
        self.level >= self.capacity().wrapping_sub(self.gap) || self.rate == 0
    }

    /// `bytes` went out; the level may fall below zero, for what could not wait.
    pub(crate) fn spend(&mut self, bytes: usize) {
        let cost = Self::scaled(u32::try_from(bytes).unwrap_or(u32::MAX));
        self.level = self.level.wrapping_sub(cost).max(self.capacity().wrapping_neg());
    }

    /// Microseconds until [`has_room`](Self::has_room), rounded up to a millisecond's worth.
    pub(crate) fn ready_at(&self) -> Instant {
        if self.has_room() { self.filled } else { self.at(0) }
    }

    /// When the line [is idle](Self::is_idle).
    pub(crate) fn idle_at(&self) -> Instant {
        if self.is_idle() { self.filled } else { self.at(self.capacity()) }
    }

    /// When the level will be so high. A division only for those who sleep.
    fn at(&self, level: i64) -> Instant {
        let missing = level.saturating_sub(self.level);
        let micros = missing.checked_div(i64::from(self.rate)).unwrap_or(0).saturating_add(1);
        self.filled.after(crate::time::Duration::from_micros(u64::try_from(micros).unwrap_or(0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn average_stays_at_the_rate_after_the_first_burst() {
        let mut bucket = Bucket { rate: 5_760, ..Bucket::VACANT };
        let mut sent = 0;
        for ms in 0..10_000 {
            bucket.fill(Instant::from_millis(ms));
            if bucket.has_room() {
                bucket.spend(50);
                sent += 50;
            }
        }
        assert!((57_500..=57_700).contains(&sent), "{sent} bytes in 10 s");
    }

    /// D-4: what waits for an idle line uses all of it, and never has more under way than the line takes between two polls
    /// and a frame: of twenty milliseconds at most.
    #[test]
    fn line_is_full_and_yet_soon_free() {
        for (rate, gap, frame) in [(5_760, 1, 40), (5_760, 20, 54), (92_160, 1, 40), (92_160, 10, 267), (960, 5, 12)] {
            let mut bucket = Bucket { rate, ..Bucket::VACANT };
            // In thousandths of a byte.
            let per_poll = u64::from(rate) * gap;
            let (mut under_way, mut sent) = (0u64, 0u64);
            for ms in (1_000..21_000).step_by(gap as usize) {
                bucket.fill(Instant::from_millis(ms));
                under_way = under_way.saturating_sub(per_poll);
                while bucket.is_idle() {
                    bucket.spend(frame as usize);
                    under_way += frame * 1_000;
                    sent += frame;
                }
                assert!(under_way <= per_poll.max(u64::from(rate) * 20) + frame * 1_000, "{rate}, {gap}: {under_way}");
                let next = bucket.idle_at().since(Instant::from_millis(ms)).as_micros();
                assert!(next <= (frame * 1_000_000 / u64::from(rate)) + 20_000, "{rate}, {gap}: {next} µs");
            }
            let wanted = u64::from(rate) * 20;
            assert!(sent.abs_diff(wanted) <= wanted / 50 + frame, "{rate}, {gap}: {sent} of {wanted}");
        }
    }

    #[test]
    fn rest_does_not_save_more_than_a_burst() {
        let mut bucket = Bucket { rate: 1_000, ..Bucket::VACANT };
        bucket.fill(Instant::from_millis(3_600_000));
        let mut burst = 0;
        while bucket.has_room() {
            bucket.spend(10);
            burst += 10;
        }
        assert_eq!(burst, 570);
        assert_eq!(bucket.ready_at().since(Instant::from_millis(3_600_000)).as_micros(), 10_001);
    }
}
