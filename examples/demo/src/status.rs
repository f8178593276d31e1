//! A summary of the vehicle's state, which the console shows in one line. The simulator reads it directly; the firmware logs
//! it once a second.

use mavstack::dialect::MissionState;
use mavstack::{Instant, LinkId, Plans, Progress, StackOf};
use serde::{Deserialize, Serialize};

use crate::app::{LINKS, Mavlink, PORTS, SATELLITE, TELEMETRY};
use crate::vehicle::{Mode, Quadrotor};

/// The number of peers that are shown: the capacity of the stack's peer table.
const PEERS: usize = 8;

/// Maximum size encoded by [`postcard`]: up to 5 bytes per counter (31 of them), 4 bytes per peer, and a few more.
const MAX_LEN: usize = 256;

/// The vehicle's state at one moment. Counters start at boot and wrap.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Time since boot (ms).
    pub time: u32,
    /// Whether the motors may run.
    pub is_armed: bool,
    /// The flight mode.
    pub mode: Mode,
    /// The mission and its progress.
    pub mission: Mission,
    /// The links, in order of their ids. Those of further stations on a network count with telemetry.
    pub links: [LinkStatus; PORTS],
    /// The peers that are connected. Empty slots are at the end.
    pub peers: [Option<PeerStatus>; PEERS],
    /// Drops on all links, by the reasons in [`LINK_DROPS`].
    pub link_drops: [u32; LINK_DROPS.len()],
    /// Other drops, by the reasons in [`OTHER_DROPS`].
    pub other_drops: [u32; OTHER_DROPS.len()],
}

/// The mission and its progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mission {
    /// The current item, or the number of items when the mission is complete.
    pub current: u16,
    /// The number of items.
    pub count: u16,
    /// A `MISSION_STATE`.
    pub state: u8,
}

/// The traffic of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkStatus {
    /// Frames received.
    pub received: u32,
    /// Frames sent.
    pub sent: u32,
}

/// A peer that sends heartbeats. On the satellite link, which carries none, any peer that has sent a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PeerStatus {
    /// The link that it is on.
    pub link: u8,
    /// Its system id.
    pub system: u8,
    /// Its component id.
    pub component: u8,
}

/// Why links drop frames, or bytes outside of frames. The reasons are counters of [`mavstack::frame::RxCounters`],
/// [`mavstack::network::LinkCounters`] and [`mavstack::network::ForwardCounters`].
pub const LINK_DROPS: [&str; 21] = [
    "checksum",
    "length",
    "unknown flags",
    "source 0",
    "truncated",
    "stray bytes",
    "unknown id",
    "own address",
    "peer table full",
    "no answer slot",
    "not allowed here",
    "not handled",
    "read errors",
    "write errors",
    "forwarding: queue full",
    "forwarding: expired",
    "forwarding: needs MAVLink 2",
    "forwarding: duplicate",
    "forwarding: no route",
    "forwarding: refused",
    "forwarding: table full",
];

/// Other reasons for drops: invalid signatures ([`mavstack::signing::SigningCounters`]), and a full queue of texts.
pub const OTHER_DROPS: [&str; 6] =
    ["unsigned", "bad signature", "replayed", "signed too far ahead", "signing stream table full", "texts"];

impl Status {
    pub(crate) fn of(now: Instant, stack: &StackOf<Mavlink>, vehicle: &Quadrotor) -> Self {
        let mut status = Self {
            // Only this display is affected when it wraps.
            time: now.time_boot_ms(),
            is_armed: vehicle.is_armed(),
            mode: vehicle.mode(),
            mission: Mission::of(stack, vehicle),
            links: [LinkStatus::default(); PORTS],
            peers: [None; PEERS],
            link_drops: [0; LINK_DROPS.len()],
            other_drops: [0; OTHER_DROPS.len()],
        };
        for link in (0..).map(LinkId).take(LINKS) {
            let (Some(rx), Some(port)) = (stack.rx_counters(link), stack.link_counters(link)) else { continue };
            let Some(slot) = status.links.get_mut(usize::from(shown(link).0)) else { continue };
            let forward = stack.forward_counters(link).unwrap_or_default();
            slot.received = slot.received.wrapping_add(rx.frames).wrapping_add(rx.unchecked);
            slot.sent = slot.sent.wrapping_add(port.tx_frames);
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
        let signing = stack.signing().counters();
        status.other_drops = [
            signing.unsigned,
            signing.bad_signature,
            signing.replayed.wrapping_add(signing.too_old),
            signing.too_far_ahead,
            signing.no_stream_slot,
            stack.dropped_texts(),
        ];
        // The satellite link carries no heartbeats.
        let connected = stack.peers(now).filter(|info| info.is_alive || info.peer.link == SATELLITE);
        for (slot, info) in status.peers.iter_mut().zip(connected) {
            let (LinkId(link), address) = (shown(info.peer.link), info.peer.address);
            *slot = Some(PeerStatus { link, system: address.system.wire(), component: address.component.wire() });
        }
        status
    }

    /// Logs the status as one event, at any log level.
    #[cfg(feature = "defmt")]
    pub(crate) fn log(&self) {
        let mut bytes = [0; MAX_LEN];
        if let Ok(bytes) = postcard::to_slice(self, &mut bytes) {
            defmt::println!("status: {=[u8]}", bytes);
        }
    }

    /// Parses the status from a printed log event. Returns `None` for any other message.
    pub fn from_log(message: &str) -> Option<Self> {
        let list = message.strip_prefix("status: [")?.strip_suffix(']')?;
        let mut bytes = [0; MAX_LEN];
        for (index, number) in list.split(", ").enumerate() {
            *bytes.get_mut(index)? = number.parse().ok()?;
        }
        postcard::from_bytes(&bytes).ok()
    }
}

/// Returns the link with which `link` is shown.
fn shown(link: LinkId) -> LinkId {
    if usize::from(link.0) < PORTS { link } else { TELEMETRY }
}

impl Mission {
    fn of(stack: &StackOf<Mavlink>, vehicle: &Quadrotor) -> Self {
        // A plan has at most 65,535 items.
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
    fn from_log_parses_status_events_only() {
        let status = Status {
            time: u32::MAX,
            is_armed: true,
            mode: Mode::Land,
            mission: Mission { current: u16::MAX, count: u16::MAX, state: 5 },
            links: [LinkStatus { received: u32::MAX, sent: u32::MAX - 1 }; PORTS],
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
