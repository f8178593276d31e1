//! Limits a service to a share of a link's rate, so that later turns are not starved.

use crate::time::{Duration, Instant};

/// Maximum time for which an unused share is made up if polls are late. Older shares are lost.
const CATCH_UP: Duration = Duration::from_millis(100);

/// The percentage of a link that bulk data may use while others have something to send (D-4).
pub(crate) const BULK_PERCENT: u32 = 30;

/// Bulk data that is this far behind its share is sent before streams and forwarded frames, which would starve it
/// otherwise.
pub(crate) const MAX_LATENESS: Duration = Duration::from_millis(20);

/// How soon a storage medium that had no data yet is read again.
pub(crate) const RETRY: Duration = Duration::from_millis(5);

/// Returns the cost of this many bytes (bytes × 10^6 / share) with a share of `percent` of a link.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; a frame has at most 280 bytes")]
pub(crate) const fn cost(bytes: usize, percent: u32) -> u32 {
    let cost_of_byte = match 100_000_000_u32.checked_div(percent) {
        Some(cost) => cost,
        None => 0,
    };
    cost_of_byte.saturating_mul(bytes as u32)
}

/// When the next frame of a service that is limited to a share of a link may be sent. Initially all zero bits.
#[derive(Clone, Debug)]
pub struct RateLimit {
    due: Instant,
}

impl RateLimit {
    pub(crate) const NEW: Self = Self { due: Instant::ZERO };

    /// Returns when the next frame may be sent.
    pub(crate) const fn due(&self) -> Instant {
        self.due
    }

    /// Makes the next frame due no earlier than `now`.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.due = self.due.max(now);
    }

    /// Records a sent frame and its [`cost`]. `bytes_per_second` is the rate of the link; 0 is no limit, so there is no
    /// pause.
    pub(crate) fn spend(&mut self, now: Instant, cost: u32, bytes_per_second: u32) {
        self.due = match pause(cost, bytes_per_second) {
            Some(pause) => self.due.max(now - CATCH_UP) + pause,
            None => now,
        };
    }

    /// As [`spend`](Self::spend), for a service that may exceed its share while the link is idle. The excess is not
    /// deducted later.
    pub(crate) fn spend_idle(&mut self, now: Instant, cost: u32, bytes_per_second: u32) {
        self.due = match pause(cost, bytes_per_second) {
            // The time since it was due is the unused share.
            Some(pause) => now - (now - self.due).min(CATCH_UP) + pause,
            None => now,
        };
    }
}

/// Returns the pause after a frame; `None` on a link without a limit.
fn pause(cost: u32, bytes_per_second: u32) -> Option<Duration> {
    cost.checked_div(bytes_per_second).map(|micros| Duration::from_micros(u64::from(micros)))
}
