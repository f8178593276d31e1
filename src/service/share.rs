//! The pace of what may use only a share of a link, so that it does not starve what comes after it in the order.

use crate::time::{Duration, Instant};

/// Maximum time for which unused shares of a link are made up, if polls are late. Older ones are lost.
const CATCH_UP: Duration = Duration::from_millis(100);

/// The cost of a byte of bulk data, which has a share of 30 % of the link (D-4).
pub(crate) const COST_OF_BYTE: u32 = 3_333_333;

/// Bulk data that is this far behind its share is sent before streams and forwarded frames, which would starve it otherwise.
pub(crate) const MAX_LATENESS: Duration = Duration::from_millis(20);

/// How soon a medium is read again that had no data yet.
pub(crate) const RETRY: Duration = Duration::from_millis(5);

/// The share of a link. Initially all zero bits.
#[derive(Clone, Debug)]
pub struct Share {
    due: Instant,
}

impl Share {
    pub(crate) const NEW: Self = Self { due: Instant::ZERO };

    /// Returns when the next frame may be sent.
    pub(crate) const fn due(&self) -> Instant {
        self.due
    }

    /// Makes the next frame due no earlier than this.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.due = self.due.max(now);
    }

    /// Records that a frame was sent. `cost`: its bytes, times 10^6, divided by the share; `bytes_per_second`: the rate of
    /// the link. A rate of 0 is no limit, so there is no pause.
    pub(crate) fn spend(&mut self, now: Instant, cost: u32, bytes_per_second: u32) {
        let Some(pause) = cost.checked_div(bytes_per_second) else {
            self.due = now;
            return;
        };
        let earliest = Instant::from_micros(now.as_micros().saturating_sub(CATCH_UP.as_micros()));
        self.due = self.due.max(earliest) + Duration::from_micros(u64::from(pause));
    }

    /// As [`spend`](Self::spend), for what may use more than its share while the link is idle: that is not made up for later.
    pub(crate) fn spend_all(&mut self, now: Instant, cost: u32, bytes_per_second: u32) {
        let (mut due, pause) = (now.as_micros(), cost.checked_div(bytes_per_second));
        if let Some(pause) = pause {
            // What was not used is the time since it was due.
            let unused = (now - self.due).min(CATCH_UP).as_micros();
            due = due.wrapping_sub(unused).wrapping_add(u64::from(pause));
        }
        self.due = Instant::from_micros(due);
    }
}
