//! Log events for drops: counters by reason, at most once a second for each link.

use super::Stack;
use crate::frame::RxCounters;
use crate::link::LinkCounters;
use crate::network::ForwardCounters;
use crate::service::manual_control::ManualCounters;
use crate::service::mission::{PlanCounters, PlanStorage};
#[cfg(feature = "signing")]
use crate::service::signing::SigningCounters;
use crate::time::Instant;
use crate::vehicle::Vehicle;

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// Logs the drop counters that have changed since they were last logged.
    pub(super) fn log_drops<V: Vehicle>(&mut self, now: Instant, vehicle: &mut V) {
        for link in &mut self.links {
            let (rx, counters) = (link.decoder.counters(), link.port.counters);
            let forwarding = vehicle.forwarding().and_then(|forwarding| forwarding.counters(link.port.id));
            let forwarded = forwarding.unwrap_or_default();
            let count = sum([of_decoder(&rx), of_link(&counters), of_forwarding(&forwarded)]);
            if link.port.drops.is_due(now, count) {
                event!("link {=u8}: {} {}", link.port.id.0, rx, counters);
                if of_forwarding(&forwarded) != 0 {
                    event!("link {=u8}: {}", link.port.id.0, forwarded);
                }
            }
        }
        let plans = P::engine(&self.missions).map(|missions| *missions.counters()).unwrap_or_default();
        let manual = vehicle.manual_input().map(|manual| manual.counters()).unwrap_or_default();
        let count = sum([of_plans(&plans), of_manual_control(&manual)]);
        #[cfg(feature = "signing")]
        let signing = vehicle.signing().map(|signing| signing.counters()).unwrap_or_default();
        #[cfg(feature = "signing")]
        let count = sum([count, of_signing(&signing)]);
        if self.core.drops.is_due(now, count) {
            event!("{} {}", plans, manual);
            #[cfg(feature = "signing")]
            event!("{}", signing);
        }
    }
}

fn sum<const N: usize>(counts: [u32; N]) -> u32 {
    counts.into_iter().fold(0, u32::wrapping_add)
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

fn of_forwarding(counters: &ForwardCounters) -> u32 {
    let ForwardCounters {
        sent: _,
        queue_full,
        stale,
        needs_v2,
        // Not a drop: the other side has the frame. Redundant links count each heartbeat here.
        source_heard: _,
        not_accepted,
        duplicates,
        no_route,
        no_peer_slot,
        not_remembered,
    } = *counters;
    sum([queue_full, stale, needs_v2, not_accepted, duplicates, no_route, no_peer_slot, not_remembered])
}

fn of_plans(counters: &PlanCounters) -> u32 {
    // An upload that ended is no dropped frame, nor is a failed write: both are reported otherwise.
    let PlanCounters { accepted: _, refused: _, abandoned: _, out_of_place, no_answer_slot, not_saved: _ } = *counters;
    sum([out_of_place, no_answer_slot])
}

fn of_manual_control(counters: &ManualCounters) -> u32 {
    let ManualCounters { taken: _, broadcast, not_allowed, not_holder, bad_axes } = *counters;
    sum([broadcast, not_allowed, not_holder, bad_axes])
}

#[cfg(feature = "signing")]
fn of_signing(counters: &SigningCounters) -> u32 {
    let SigningCounters {
        verified: _,
        unsigned,
        bad_signature,
        replayed,
        too_old,
        too_far_ahead,
        no_stream_slot,
        refused_times,
        setups: _,
        refused_setups,
    } = *counters;
    sum([unsigned, bad_signature, replayed, too_old, too_far_ahead, no_stream_slot, refused_times, refused_setups])
}
