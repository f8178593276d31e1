//! The vehicle at a glance: what a line on a terminal says of it. The simulator asks for it, the firmware logs it once a second.

use mavstack::dialect::MissionState;
use mavstack::{Instant, LinkId, PlanStorage, Plans, Progress, Stack};
use serde::{Deserialize, Serialize};

use crate::app::{LINKS, SATELLITE};
use crate::vehicle::{Mode, Quadrotor};

/// Room for the peers that a line shows: as many as the stack's table has.
const PEERS: usize = 8;

/// Encoded by [`postcard`] it has at most 5 bytes for each of 31 counters, 4 for each peer, and a few more.
const MAX_LEN: usize = 256;

/// The vehicle at one moment. Counters are since it was switched on and wrap.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// ms since it was switched on.
    pub time: u32,
    /// Whether the motors may turn.
    pub is_armed: bool,
    /// What it is doing.
    pub mode: Mode,
    /// How far it is.
    pub mission: Mission,
    /// The links in their order.
    pub links: [LinkStatus; LINKS],
    /// Who is there; the empty places are at the end.
    pub peers: [Option<PeerStatus>; PEERS],
    /// What the links dropped together, for the reasons of [`LINK_DROPS`].
    pub link_drops: [u32; LINK_DROPS.len()],
    /// What else was dropped, for the reasons of [`OTHER_DROPS`].
    pub other_drops: [u32; OTHER_DROPS.len()],
}

/// The mission and where in it the vehicle is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mission {
    /// The item that is being flown, or is next; the number of items when all are flown.
    pub current: u16,
    /// How many items there are.
    pub count: u16,
    /// A `MISSION_STATE`.
    pub state: u8,
}

/// What passed over a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkStatus {
    /// Frames from the others.
    pub received: u32,
    /// Frames to the others.
    pub sent: u32,
}

/// Somebody whose heartbeats come, or, by satellite, who was heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PeerStatus {
    /// On which link.
    pub link: u8,
    /// Its system id.
    pub system: u8,
    /// Its component id.
    pub component: u8,
}

/// Why links drop frames, and bytes that are in none: [`mavstack::RxCounters`], [`mavstack::LinkCounters`],
/// [`mavstack::ForwardCounters`].
pub const LINK_DROPS: [&str; 21] = [
    "checksum",
    "length",
    "unknown flags",
    "source 0",
    "cut short",
    "stray bytes",
    "unknown id",
    "own address",
    "no place for the peer",
    "no place for the answer",
    "out of place",
    "not handled",
    "read errors",
    "write errors",
    "forwarding: queue full",
    "forwarding: too late",
    "forwarding: needs MAVLink 2",
    "forwarding: loop",
    "forwarding: no route",
    "forwarding: refused",
    "forwarding: no place",
];

/// Why else something is dropped: signatures, [`mavstack::SigningCounters`], and texts that found no place.
pub const OTHER_DROPS: [&str; 6] =
    ["unsigned", "bad signature", "replayed", "signed too far ahead", "no place for the signer", "texts"];

impl Status {
    pub(crate) fn of<P: PlanStorage>(now: Instant, stack: &Stack<LINKS, P>, vehicle: &Quadrotor) -> Self {
        let mut status = Self {
            // Wraps after 49 days, and only here.
            time: now.as_millis() as u32,
            is_armed: vehicle.is_armed(),
            mode: vehicle.mode(),
            mission: Mission::of(stack, vehicle),
            links: [LinkStatus::default(); LINKS],
            peers: [None; PEERS],
            link_drops: [0; LINK_DROPS.len()],
            other_drops: [0; OTHER_DROPS.len()],
        };
        for (link, place) in (0..).map(LinkId).zip(&mut status.links) {
            let (Some(rx), Some(port)) = (stack.rx_counters(link), stack.link_counters(link)) else { continue };
            let forward = vehicle.forward_counters(link);
            *place = LinkStatus { received: rx.frames.wrapping_add(rx.unchecked), sent: port.tx_frames };
            let drops = [
                rx.checksum,
                rx.length,
                rx.incompat_flags,
                rx.zero_source,
                rx.stale,
                rx.skipped,
                rx.unknown_id,
                port.own_address,
                port.no_peer_slot,
                port.no_answer_slot,
                port.out_of_place,
                port.unhandled,
                port.read_errors,
                port.write_errors,
                forward.queue_full,
                forward.stale,
                forward.needs_v2,
                forward.duplicates,
                forward.no_route,
                forward.not_accepted,
                forward.no_peer_slot.wrapping_add(forward.not_remembered),
            ];
            for (sum, count) in status.link_drops.iter_mut().zip(drops) {
                *sum = sum.wrapping_add(count);
            }
        }
        let signing = vehicle.signing_counters();
        status.other_drops = [
            signing.unsigned,
            signing.bad_signature,
            signing.replayed.wrapping_add(signing.too_old),
            signing.too_far_ahead,
            signing.no_stream_slot,
            stack.dropped_texts(),
        ];
        // By satellite no heartbeats come.
        let there = stack.peers().iter().filter(|info| info.is_alive || info.peer.link == SATELLITE);
        for (place, info) in status.peers.iter_mut().zip(there) {
            let (LinkId(link), address) = (info.peer.link, info.peer.address);
            *place = Some(PeerStatus { link, system: address.system.0, component: address.component.0 });
        }
        status
    }

    /// One event of the log, whatever level was asked for.
    #[cfg(feature = "defmt")]
    pub(crate) fn log(&self) {
        let mut bytes = [0; MAX_LEN];
        if let Ok(bytes) = postcard::to_slice(self, &mut bytes) {
            defmt::println!("status: {=[u8]}", bytes);
        }
    }

    /// The status in that event as it is printed; `None` in any other message.
    pub fn from_log(message: &str) -> Option<Self> {
        let list = message.strip_prefix("status: [")?.strip_suffix(']')?;
        let mut bytes = [0; MAX_LEN];
        for (index, number) in list.split(", ").enumerate() {
            *bytes.get_mut(index)? = number.parse().ok()?;
        }
        postcard::from_bytes(&bytes).ok()
    }
}

impl Mission {
    fn of<P: PlanStorage>(stack: &Stack<LINKS, P>, vehicle: &Quadrotor) -> Self {
        // A plan has no more items than a sequence number can name.
        let count = stack.mission().items().len() as u16;
        let Progress { current, state, .. } = vehicle.progress();
        match state {
            _ if count == 0 => Self { current: 0, count, state: MissionState::NO_MISSION.0 },
            MissionState::COMPLETE => Self { current: count, count, state: state.0 },
            _ => Self { current, count, state: state.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::format;

    #[test]
    fn a_status_is_read_back_from_the_log_and_nothing_else_is() {
        let status = Status {
            time: u32::MAX,
            is_armed: true,
            mode: Mode::Land,
            mission: Mission { current: u16::MAX, count: u16::MAX, state: 5 },
            links: [LinkStatus { received: u32::MAX, sent: u32::MAX - 1 }; LINKS],
            peers: [Some(PeerStatus { link: 2, system: 255, component: 190 }); PEERS],
            link_drops: [u32::MAX; LINK_DROPS.len()],
            other_drops: [u32::MAX; OTHER_DROPS.len()],
        };
        let mut bytes = [0; MAX_LEN];
        let bytes = postcard::to_slice(&status, &mut bytes).expect("the longest fits");
        assert_eq!(Status::from_log(&format!("status: {bytes:?}")), Some(status));
        for other in ["status: []", "status: [1, 2", "status: [1, 2, x]", "armed"] {
            assert_eq!(Status::from_log(other), None, "{other}");
        }
        assert_eq!(Status::from_log(&format!("status: {:?}", [1; 300])), None);
    }
}
