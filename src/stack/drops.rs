//! Log events for drops: counters by reason, at most once a second for each link.

use super::{Declares, Stack};
use crate::service::sum;
use crate::time::Instant;

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Logs the drop counters that have changed since they were last logged.
    pub(super) fn log_drops(&mut self, now: Instant) {
        for link in &mut self.links {
            let (rx, counters) = (link.decoder.counters(), link.port.counters);
            let count = sum([rx.drops(), counters.drops(), self.services.drops(Some(link.port.id))]);
            if link.port.drops.is_due(now, count) {
                event!("link {=u8}: {} {}", link.port.id.0, rx, counters);
                self.services.log_drops(Some(link.port.id));
            }
        }
        if self.drops.is_due(now, self.services.drops(None)) {
            self.services.log_drops(None);
        }
    }
}
