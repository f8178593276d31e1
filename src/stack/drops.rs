//! Log events for drops: counters by reason, at most once a second for each link.

use super::{Declares, Stack};
use crate::log::Counters;
use crate::service::{ShowCounters, sum};
use crate::time::Instant;
use crate::types::LinkId;

/// Adds up the drop counters of a link, or of all together.
struct Sum(Option<LinkId>, u32);

impl Sum {
    fn add(&mut self, link: Option<LinkId>, counters: &impl Counters) {
        if link == self.0 {
            self.1 = sum([self.1, counters.drops()]);
        }
    }
}

impl ShowCounters for Sum {
    fn counters(&mut self, counters: &impl Counters) {
        self.add(None, counters);
    }

    fn counters_of(&mut self, link: LinkId, counters: &impl Counters) {
        self.add(Some(link), counters);
    }
}

/// Logs the counters of a link that has dropped something, or those of all together.
struct Log(Option<LinkId>);

impl ShowCounters for Log {
    fn counters(&mut self, counters: &impl Counters) {
        if self.0.is_none() {
            counters.log();
        }
    }

    fn counters_of(&mut self, link: LinkId, counters: &impl Counters) {
        if self.0 == Some(link) && counters.drops() != 0 {
            counters.log();
        }
    }
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Logs the drop counters that have changed since they were last logged.
    pub(super) fn log_drops(&mut self, now: Instant) {
        for link in &mut self.links {
            let (rx, counters) = (link.decoder.counters(), link.port.counters);
            let mut drops = Sum(Some(link.port.id), sum([rx.drops(), counters.drops()]));
            self.services.counters(&mut drops);
            if link.port.drops.is_due(now, drops.1) {
                event!("link {=u8}: {} {}", link.port.id.0, rx, counters);
                self.services.counters(&mut Log(Some(link.port.id)));
            }
        }
        let mut drops = Sum(None, 0);
        self.services.counters(&mut drops);
        if self.drops.is_due(now, drops.1) {
            self.services.counters(&mut Log(None));
        }
    }
}
