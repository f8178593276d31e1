//! A leaky bucket: how many bytes a link has sent that its line cannot have carried away yet.
//!
//! However much a transport takes into its own buffer, a heartbeat or an acknowledgement waits behind no more than the bucket
//! was allowed to hold when the last frame began that could wait (D-4).

use crate::time::Instant;

/// Counts in byte·µs, so that time needs no division.
#[derive(Clone, Debug)]
pub(crate) struct Bucket {
    under_way: i64,
    looked: Instant,
    /// Bytes/s: what flows out in each µs, in units of 1/`SCALE` byte.
    rate: u32,
    /// From one call to the next, at the last two different times: how far polls are apart (µs), no more than 20 ms.
    gap: u16,
}

impl Bucket {
    const SCALE: i64 = 1_000_000;

    /// 20 ms.
    const SHORT: u16 = 20_000;

    /// An empty bucket that nothing flows out of. All zero bits.
    pub(crate) const VACANT: Self = Self { under_way: 0, looked: Instant::ZERO, rate: 0, gap: 0 };

    pub(crate) const fn configure(&mut self, bytes_per_second: u32) {
        self.rate = bytes_per_second;
    }

    /// Bytes as they are counted. None of the sums here overflows: what is under way is bounded by `spend`, and what flows or is
    /// spent in one step is below 2^56.
    fn scaled(bytes: u32) -> i64 {
        i64::from(bytes).wrapping_mul(Self::SCALE)
    }

    /// What the line takes in 20 ms.
    fn short(&self) -> i64 {
        self.flown(u64::from(Self::SHORT))
    }

    /// What the line takes in so many µs, ten seconds at most: a product of two u32 needs no check.
    fn flown(&self, micros: u64) -> i64 {
        micros.wrapping_mul(u64::from(self.rate)).cast_signed()
    }

    /// Lets flow out what the line took since the last call.
    pub(crate) fn drain(&mut self, now: Instant) {
        // Ten seconds empty any bucket.
        let elapsed = now.since(self.looked).as_micros().min(10_000_000);
        self.looked = now;
        self.under_way = self.under_way.wrapping_sub(self.flown(elapsed)).max(0);
        if elapsed > 0 {
            self.gap = u16::try_from(elapsed).unwrap_or(Self::SHORT).min(Self::SHORT);
        }
    }

    /// Whether a transfer may go on: the line is free in 20 ms, so that polls which are no further apart keep it busy. On a line
    /// of 57,600 baud that is 115 bytes, and with the frame that begins then less than a longest one (D-4). A rate of 0 is no
    /// limit.
    pub(crate) fn has_room(&self) -> bool {
        self.under_way <= self.short() || self.rate == 0
    }

    /// Whether the line will be idle before the next poll: then a frame that is not urgent delays an urgent one by no more
    /// than itself (D-4).
    pub(crate) fn is_idle(&self) -> bool {
        self.under_way <= self.flown(u64::from(self.gap)) || self.rate == 0
    }

    /// `bytes` went out. What could not wait may add up to a fifth of a second's worth, or four longest frames; what is more
    /// is not counted.
    pub(crate) fn spend(&mut self, bytes: usize) {
        let cost = Self::scaled(u32::try_from(bytes).unwrap_or(u32::MAX));
        self.under_way = self.under_way.wrapping_add(cost).min(Self::scaled((self.rate / 5).max(1_120)));
    }

    /// When it [has room](Self::has_room).
    pub(crate) fn ready_at(&self) -> Instant {
        if self.has_room() { self.looked } else { self.at(self.short()) }
    }

    /// When the line [is idle](Self::is_idle).
    pub(crate) fn idle_at(&self) -> Instant {
        if self.is_idle() { self.looked } else { self.at(0) }
    }

    /// When so much is left. A division only for those who sleep.
    fn at(&self, left: i64) -> Instant {
        let rate = i64::from(self.rate);
        // Rounded up.
        let more = self.under_way.wrapping_sub(left).wrapping_add(rate.wrapping_sub(1));
        let micros = more.checked_div(rate).unwrap_or(0);
        self.looked.after(crate::time::Duration::from_micros(u64::try_from(micros).unwrap_or(0)))
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
            bucket.drain(Instant::from_millis(ms));
            if bucket.has_room() {
                bucket.spend(50);
                sent += 50;
            }
        }
        assert!((57_600..=57_900).contains(&sent), "{sent} bytes in 10 s");
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
                bucket.drain(Instant::from_millis(ms));
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
    fn rest_is_not_made_up_for() {
        let mut bucket = Bucket { rate: 1_000, ..Bucket::VACANT };
        bucket.drain(Instant::from_millis(3_600_000));
        let mut burst = 0;
        while bucket.has_room() {
            bucket.spend(10);
            burst += 10;
        }
        assert_eq!(burst, 30, "20 ms, and what begins then");
        assert_eq!(bucket.ready_at().since(Instant::from_millis(3_600_000)).as_micros(), 10_000);
    }

    /// However long nobody looked, the line is free then.
    #[test]
    fn any_pause_frees_the_line() {
        for pause in [1u64, 4_294, 4_295, 4_296, 1 << 33] {
            let mut bucket = Bucket { rate: 1_000, ..Bucket::VACANT };
            bucket.drain(Instant::from_millis(5_000));
            bucket.spend(1_000);
            assert!(!bucket.has_room());
            bucket.drain(Instant::from_millis(5_000 + pause * 1_000));
            assert!(bucket.has_room() && bucket.is_idle(), "{pause} s");
        }
    }
}
