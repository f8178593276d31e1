//! A leaky bucket: estimates how many queued bytes the link has not transmitted yet.
//!
//! A transport may take many bytes into its own buffer. The bucket bounds the delay of a heartbeat or an answer: they
//! wait for no more bytes than the bucket may hold when the last deferrable frame begins (D-4, H-15, Q-8).

use crate::time::Instant;

/// How busy a link is, or may be for a turn to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Pace {
    /// However busy the link is. `next_deadline` waits for it even if the transport accepts no bytes: the transport may be
    /// ready by then, even if no other wake-up reports it.
    Stalled,
    /// However busy the link is.
    AtOnce,
    /// The link can send all queued bytes within 20 ms.
    Room,
    /// The link can send them before the next poll.
    Idle,
}

impl Pace {
    /// Whether a turn of this pace may send on a link of pace `most`.
    #[allow(clippy::as_conversions, reason = "const fn: the comparison of the enum cannot be called")]
    pub(crate) const fn is_at_most(self, most: Self) -> bool {
        self as u8 <= most as u8
    }
}

/// The bucket. It counts in byte·µs, so that draining needs no division.
#[derive(Clone, Debug)]
pub(crate) struct Bucket {
    queued: i64,
    looked: Instant,
    /// The rate (bytes/s): the outflow in each µs, in units of 1/`SCALE` byte.
    rate: u32,
    /// The time between the last two calls at different times (µs), at most 20 ms: the poll period.
    gap: u16,
}

impl Bucket {
    const SCALE: i64 = 1_000_000;

    /// 20 ms.
    const SHORT: u16 = 20_000;

    /// An empty bucket without outflow. All zero bits.
    pub(crate) const VACANT: Self = Self { queued: 0, looked: Instant::ZERO, rate: 0, gap: 0 };

    pub(crate) const fn configure(&mut self, bytes_per_second: u32) {
        self.rate = bytes_per_second;
    }

    /// Converts bytes to the bucket's unit. No sum here overflows: `spend` bounds the content, and the outflow or the
    /// cost of one step is below 2^56.
    fn scaled(bytes: u32) -> i64 {
        i64::from(bytes).wrapping_mul(Self::SCALE)
    }

    /// Returns the number of bytes that the link transmits in 20 ms.
    fn short(&self) -> i64 {
        self.flown(u64::from(Self::SHORT))
    }

    /// Returns the number of bytes that the link transmits in this many µs, at most ten seconds: a product of two u32
    /// needs no check.
    fn flown(&self, micros: u64) -> i64 {
        micros.wrapping_mul(u64::from(self.rate)).cast_signed()
    }

    /// Subtracts the bytes that the link transmitted since the last call.
    pub(crate) fn drain(&mut self, now: Instant) {
        // Ten seconds empty any bucket.
        let elapsed = (now - self.looked).as_micros().min(10_000_000);
        self.looked = now;
        self.queued = self.queued.wrapping_sub(self.flown(elapsed)).max(0);
        if elapsed > 0 {
            self.gap = u16::try_from(elapsed).unwrap_or(Self::SHORT).min(Self::SHORT);
        }
    }

    /// Whether a transfer may send: the link will have sent everything within 20 ms. Polls that are no further apart
    /// keep it busy. At 57,600 baud that is 115 bytes; with the frame that begins then, it is less than a frame of
    /// maximum length (D-4). A rate of 0 is no limit.
    pub(crate) fn has_room(&self) -> bool {
        self.queued <= self.short() || self.rate == 0
    }

    /// Whether the link will be idle before the next poll. A frame that is not urgent then delays an urgent one only by
    /// its own length (D-4).
    pub(crate) fn is_idle(&self) -> bool {
        self.queued <= self.flown(u64::from(self.gap)) || self.rate == 0
    }

    /// Returns how busy the link is.
    pub(crate) fn pace(&self) -> Pace {
        match (self.has_room(), self.is_idle()) {
            (_, true) => Pace::Idle,
            (true, false) => Pace::Room,
            (false, false) => Pace::AtOnce,
        }
    }

    /// Adds sent bytes. The content is limited to a fifth of a second, or to four frames of maximum length; more is not
    /// counted.
    pub(crate) fn spend(&mut self, bytes: usize) {
        let cost = Self::scaled(u32::try_from(bytes).unwrap_or(u32::MAX));
        self.queued = self.queued.wrapping_add(cost).min(Self::scaled((self.rate / 5).max(1_120)));
    }

    /// Returns when the link [has room](Self::has_room).
    pub(crate) fn ready_at(&self) -> Instant {
        if self.has_room() { self.looked } else { self.at(self.short()) }
    }

    /// Returns when the link [is idle](Self::is_idle).
    pub(crate) fn idle_at(&self) -> Instant {
        if self.is_idle() { self.looked } else { self.at(0) }
    }

    /// Returns when this much is left. Only a caller that sleeps needs this division.
    fn at(&self, left: i64) -> Instant {
        let rate = i64::from(self.rate);
        // Rounded up.
        let more = self.queued.wrapping_sub(left).wrapping_add(rate.wrapping_sub(1));
        let micros = more.checked_div(rate).unwrap_or(0);
        self.looked + crate::time::Duration::from_micros(u64::try_from(micros).unwrap_or(0))
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

    /// D-4: frames that wait for an idle link use all of its rate. No more bytes are queued than the link transmits
    /// between two polls, at most 20 ms, plus one frame.
    #[test]
    fn full_use_leaves_a_bounded_backlog() {
        for (rate, gap, frame) in [(5_760, 1, 40), (5_760, 20, 54), (92_160, 1, 40), (92_160, 10, 267), (960, 5, 12)] {
            let mut bucket = Bucket { rate, ..Bucket::VACANT };
            // In thousandths of a byte.
            let per_poll = u64::from(rate) * gap;
            let (mut queued, mut sent) = (0u64, 0u64);
            for ms in (1_000..21_000).step_by(gap as usize) {
                bucket.drain(Instant::from_millis(ms));
                queued = queued.saturating_sub(per_poll);
                while bucket.is_idle() {
                    bucket.spend(frame as usize);
                    queued += frame * 1_000;
                    sent += frame;
                }
                assert!(queued <= per_poll.max(u64::from(rate) * 20) + frame * 1_000, "{rate}, {gap}: {queued}");
                let next = (bucket.idle_at() - Instant::from_millis(ms)).as_micros();
                assert!(next <= (frame * 1_000_000 / u64::from(rate)) + 20_000, "{rate}, {gap}: {next} µs");
            }
            let wanted = u64::from(rate) * 20;
            assert!(sent.abs_diff(wanted) <= wanted / 50 + frame, "{rate}, {gap}: {sent} of {wanted}");
        }
    }

    #[test]
    fn idle_time_is_not_saved_up() {
        let mut bucket = Bucket { rate: 1_000, ..Bucket::VACANT };
        bucket.drain(Instant::from_millis(3_600_000));
        let mut burst = 0;
        while bucket.has_room() {
            bucket.spend(10);
            burst += 10;
        }
        assert_eq!(burst, 30, "20 ms, and the frame that begins then");
        assert_eq!((bucket.ready_at() - Instant::from_millis(3_600_000)).as_micros(), 10_000);
    }

    /// After a pause of any length, the link is idle.
    #[test]
    fn any_pause_empties_the_bucket() {
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
