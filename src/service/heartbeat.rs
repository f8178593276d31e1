//! HEARTBEAT: sent while the flight loop ticks, and only then.
//!
//! Implements <https://mavlink.io/en/services/heartbeat.html>, rules H-1 to H-7 and H-16. The states are drawn at
//! [`Pulse`](crate::Pulse).

use crate::pulse::Pulse;
use crate::time::{Duration, Instant};

/// What of the pulse was seen.
#[derive(Clone, Debug)]
pub(crate) struct Credit {
    count: u32,
    looked: Option<Instant>,
    /// The last tick that was seen came after this moment.
    renewed: Option<Instant>,
    is_faulted: bool,
    was_good: bool,
}

impl Credit {
    pub(crate) const fn new() -> Self {
        Self { count: 0, looked: None, renewed: None, is_faulted: false, was_good: false }
    }

    /// Looks at the pulse and tells whether heartbeats may go out.
    pub(crate) fn sample(&mut self, now: Instant, pulse: &Pulse, max_loop_gap: Duration) -> bool {
        let count = pulse.count();
        if count != self.count {
            self.count = count;
            // When it ticked is not known, only that it was after the last look.
            self.renewed = self.looked.or(Some(now));
        }
        self.looked = Some(now);
        self.is_faulted |= pulse.is_faulted();
        let is_good = self.is_good(now, max_loop_gap);
        if is_good != core::mem::replace(&mut self.was_good, is_good) {
            event!(
                "heartbeats: {=str}",
                if is_good { "the flight loop ticks" } else { "the flight loop stands, or faulted" }
            );
        }
        is_good
    }

    /// When somebody who sleeps must look at the pulse, so that a heartbeat which is due at `due` finds it fresh.
    pub(crate) fn look_for(&self, due: Instant, max_loop_gap: Duration) -> Instant {
        let look = Instant::from_micros(due.as_micros().saturating_sub(max_loop_gap.as_micros() / 2));
        if self.looked.is_none_or(|looked| looked < look) { look } else { due }
    }

    /// Whether heartbeats may go out, as of the last look.
    pub(crate) fn is_good(&self, now: Instant, max_loop_gap: Duration) -> bool {
        !self.is_faulted && self.renewed.is_some_and(|renewed| now.since(renewed) <= max_loop_gap)
    }
}

/// A shorter period counts as this: a link must get round to something else.
const MIN_PERIOD: Duration = Duration::from_millis(10);

/// A link sends at most one extra heartbeat in this time (H-16).
const EXTRA_PERIOD: Duration = Duration::from_millis(200);

/// When a link's next heartbeat is due: without drift, and without a burst after a stall (H-6). Extra heartbeats, which report
/// a change, do not shift the schedule (H-16).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Schedule {
    due: Instant,
    /// When an extra heartbeat may be sent.
    extra: Instant,
}

impl Schedule {
    pub(crate) const fn new() -> Self {
        Self { due: Instant::ZERO, extra: Instant::ZERO }
    }

    pub(crate) fn is_due(&self, now: Instant) -> bool {
        now >= self.due
    }

    /// Whether an extra heartbeat may be sent.
    pub(crate) fn may_send_extra(&self, now: Instant) -> bool {
        now >= self.extra
    }

    /// Records that an extra heartbeat was sent.
    pub(crate) fn sent_extra(&mut self, now: Instant) {
        self.extra = now.after(EXTRA_PERIOD);
    }

    /// One was sent: the next follows a period after this one was *due*, or, when that is past too, after now.
    pub(crate) fn sent(&mut self, now: Instant, period: Duration) {
        let period = period.max(MIN_PERIOD);
        let next = self.due.after(period);
        self.due = if next > now { next } else { now.after(period) };
    }

    /// It could not be sent now: looked at again at `due`.
    pub(crate) const fn postpone(&mut self, due: Instant) {
        self.due = due;
    }

    pub(crate) fn due(&self) -> Instant {
        self.due
    }

    /// When the next one is due while an extra one is pending, on a link that has room from `ready_at` on.
    pub(crate) fn due_with_extra(&self, ready_at: Instant) -> Instant {
        self.due.min(self.extra.max(ready_at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAP: Duration = Duration::from_millis(500);

    #[test]
    fn credit_follows_the_pulse() {
        // H-5
        let pulse = Pulse::new();
        let mut credit = Credit::new();
        let at = Instant::from_millis;
        assert!(!credit.sample(at(0), &pulse, GAP), "nothing ticked yet");
        pulse.tick();
        assert!(credit.sample(at(10), &pulse, GAP));
        assert!(credit.sample(at(500), &pulse, GAP), "the tick came after the look at 0 ms");
        assert!(!credit.sample(at(501), &pulse, GAP), "the loop is late");
        pulse.tick();
        assert!(credit.sample(at(900), &pulse, GAP), "it goes on");
        pulse.fault();
        pulse.tick();
        assert!(!credit.sample(at(901), &pulse, GAP), "a fault is for good");
    }

    #[test]
    fn schedule_keeps_its_phase_and_does_not_burst() {
        // H-6
        let period = Duration::from_secs(1);
        let mut schedule = Schedule::new();
        schedule.sent(Instant::from_millis(3), period);
        assert_eq!(schedule.due(), Instant::from_millis(1_000), "a late poll does not move the phase");
        schedule.sent(Instant::from_millis(5_300), period);
        assert_eq!(schedule.due(), Instant::from_millis(6_300), "after a stall it starts from now");
    }
}
