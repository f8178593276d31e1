//! Log events for drops: counters by reason, at most once a second for each link.

use super::{Declares, Stack};
use crate::frame::RxCounters;
use crate::link::LinkCounters;
use crate::service::sum;
use crate::time::Instant;

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Logs the drop counters that have changed since they were last logged.
    pub(super) fn log_drops(&mut self, now: Instant) {
        for link in &mut self.links {
            let (rx, counters) = (link.decoder.counters(), link.port.counters);
            let count = sum([of_decoder(&rx), of_link(&counters), self.services.drops_on(link.port.id)]);
            if link.port.drops.is_due(now, count) {
                event!("link {=u8}: {} {}", link.port.id.0, rx, counters);
                self.services.log_drops_on(link.port.id);
            }
        }
        if self.drops.is_due(now, self.services.drops()) {
            self.services.log_drops();
        }
    }
}

// The patterns name every field, so that a new counter does not compile until it is decided here whether it counts drops.

fn of_decoder(counters: &RxCounters) -> u32 {
    let RxCounters {
        frames: _,
        unchecked: _,
        skipped,
        incompat_flags,
        zero_source,
        length,
        checksum,
        unknown_id,
        stale,
    } = *counters;
    sum([skipped, incompat_flags, zero_source, length, checksum, unknown_id, stale])
}

fn of_link(counters: &LinkCounters) -> u32 {
    let LinkCounters {
        tx_frames: _,
        tx_bytes: _,
        not_ours,
        own_address,
        unknown,
        no_peer_slot,
        evicted_peers,
        no_answer_slot,
        out_of_place,
        unhandled,
        read_errors,
        write_errors,
    } = *counters;
    sum([
        not_ours,
        own_address,
        unknown,
        no_peer_slot,
        evicted_peers,
        no_answer_slot,
        out_of_place,
        unhandled,
        read_errors,
        write_errors,
    ])
}
