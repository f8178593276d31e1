//! Peers: who is out there, on which link, and how well we hear them.
//!
//! Implements the receiving half of <https://mavlink.io/en/services/heartbeat.html>, rules H-10 to H-13, and the loss
//! statistics of <https://mavlink.io/en/guide/packet_loss.html> (S-16). The states of
//! a peer are drawn at [`PeerInfo`].

use crate::dialect::{Heartbeat, MavAutopilot, MavType};
use crate::frame::{Address, Frame, Version};
use crate::link::{LinkClass, LinkId, Peer};
use crate::time::{Duration, Instant};
use crate::vehicle::{PeerEvent, Vehicle};

/// What is known of a peer.
///
/// Any checked frame makes an entry; *alive* is only who sends heartbeats. In brackets the [`PeerEvent`] of each step:
///
/// ```text
///   any frame ──▶ heard ── HEARTBEAT (Found) ──▶ alive ── silence for peer_timeout (Lost) ──▶ lost
///                                                  ▲                                            │
///                                                  └──────────── HEARTBEAT (Regained) ──────────┘
/// ```
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PeerInfo {
    /// Who, and on which link. One component that is heard on two links stands here twice.
    pub peer: Peer,
    /// HEARTBEAT.type; [`MavType::GENERIC`] before the first heartbeat.
    pub r#type: MavType,
    /// HEARTBEAT.autopilot; [`MavAutopilot::INVALID`] before the first heartbeat.
    pub autopilot: MavAutopilot,
    /// The version of its last frame.
    pub version: Version,
    /// Whether its heartbeats come. Never so on a high-latency link, where none are expected, and silence means nothing: what
    /// comes there only counts as [heard](Self::last_heard) (L-3).
    pub is_alive: bool,
    /// Frames received. Wraps.
    pub received: u32,
    /// Frames that its sequence numbers say were lost on the way (S-16). Wraps.
    pub lost: u32,
    has_heartbeat: bool,
    /// Whether frames for it go out on this link.
    pub(super) is_route: bool,
    seq: u8,
    /// Its last SYSTEM_TIME.time_boot_ms; 0 before the first, and where nothing is forwarded.
    pub(super) time_boot_ms: u32,
    heartbeat: Instant,
    heard: Instant,
}

impl PeerInfo {
    /// When its last heartbeat came, if any did.
    pub fn last_heartbeat(&self) -> Option<Instant> {
        self.has_heartbeat.then_some(self.heartbeat)
    }

    /// When its last frame came.
    pub const fn last_heard(&self) -> Instant {
        self.heard
    }
}

/// The peer table. The logic works on a view, so its size is compiled once.
pub(crate) type Peers = heapless::vec::VecView<PeerInfo>;

/// Whether frames of `address` were heard before, on any link.
pub(crate) fn is_known(peers: &Peers, address: Address) -> bool {
    peers.iter().any(|info| info.peer.address == address)
}

/// Whether frames of `peer` were heard before.
pub(crate) fn is_heard(peers: &Peers, peer: Peer) -> bool {
    peers.iter().any(|info| info.peer == peer)
}

/// What became of a frame's sender in the table (H-12).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Booking {
    /// It stood there, or there was room.
    Kept,
    /// It took another one's place.
    Evicted,
    /// The table is full of peers that matter more.
    NoRoom,
}

/// A number up to so many behind the one that is due is a late or repeated frame, not the loss of nearly all numbers.
const LATE: u8 = 32;

/// Books a checked frame.
pub(crate) fn on_frame(
    peers: &mut Peers,
    now: Instant,
    (link, class): (LinkId, LinkClass),
    frame: &Frame<'_>,
    vehicle: &mut impl Vehicle,
) -> Booking {
    let heartbeat = frame.decode::<Heartbeat>().filter(|_| class != LinkClass::HighLatency);
    let peer = Peer { address: frame.source(), link };
    let header = frame.header();
    let Some((info, evicted)) = find_or_insert(peers, now, peer, header.seq, heartbeat.as_ref()) else {
        return Booking::NoRoom;
    };
    if let Some(evicted) = evicted.filter(|evicted| evicted.is_alive) {
        // Nobody watches it any longer.
        vehicle.peer(PeerEvent::Lost(evicted.peer));
    }
    let booking = if evicted.is_some() { Booking::Evicted } else { Booking::Kept };
    let gap = header.seq.wrapping_sub(info.seq);
    if gap < LATE.wrapping_neg() {
        info.seq = header.seq.wrapping_add(1);
        info.lost = info.lost.wrapping_add(u32::from(gap));
    }
    info.received = info.received.wrapping_add(1);
    info.version = header.version;
    info.heard = now;
    let Some(heartbeat) = heartbeat else { return booking };
    info.r#type = heartbeat.r#type;
    info.autopilot = heartbeat.autopilot;
    info.heartbeat = now;
    let was_alive = core::mem::replace(&mut info.is_alive, true);
    let is_new = !core::mem::replace(&mut info.has_heartbeat, true);
    if is_new {
        event!("peer {} found", peer);
        vehicle.peer(PeerEvent::Found(peer));
    } else if !was_alive {
        event!("peer {} regained", peer);
        vehicle.peer(PeerEvent::Regained(peer));
    }
    booking
}

/// A frame with an unknown id came from `peer`. It could not be checked, so it is believed only when it bears the number
/// that is due: then it is no loss (S-16).
pub(crate) fn on_unchecked(peers: &mut Peers, peer: Peer, seq: u8) {
    if let Some(info) = peers.iter_mut().find(|info| info.peer == peer && info.seq == seq) {
        info.seq = seq.wrapping_add(1);
    }
}

/// Reports those whose heartbeats stopped (H-11).
pub(crate) fn poll(peers: &mut Peers, now: Instant, timeout: Duration, vehicle: &mut impl Vehicle) {
    for info in peers.iter_mut() {
        if info.is_alive && now.since(info.heartbeat) >= timeout {
            info.is_alive = false;
            event!("peer {} lost", info.peer);
            vehicle.peer(PeerEvent::Lost(info.peer));
        }
    }
}

/// When [`poll`] has something to report.
pub(crate) fn deadline(peers: &Peers, timeout: Duration) -> Instant {
    let alive = peers.iter().filter(|info| info.is_alive);
    alive.map(|info| info.heartbeat.after(timeout)).min().unwrap_or(Instant::NEVER)
}

/// The entry of a peer, and which one had to go for it.
fn find_or_insert<'a>(
    peers: &'a mut Peers,
    now: Instant,
    peer: Peer,
    seq: u8,
    heartbeat: Option<&Heartbeat>,
) -> Option<(&'a mut PeerInfo, Option<PeerInfo>)> {
    if let Some(index) = peers.iter().position(|info| info.peer == peer) {
        return Some((peers.get_mut(index)?, None));
    }
    let info = PeerInfo {
        peer,
        r#type: MavType::GENERIC,
        autopilot: MavAutopilot::INVALID,
        version: Version::V2,
        is_alive: false,
        received: 0,
        lost: 0,
        has_heartbeat: false,
        is_route: true,
        seq,
        time_boot_ms: 0,
        heartbeat: now,
        heard: now,
    };
    if peers.push(info).is_ok() {
        return Some((peers.last_mut()?, None));
    }
    let is_gcs = heartbeat.is_some_and(|heartbeat| heartbeat.r#type == MavType::GCS);
    // The longest silent of those that are not alive goes first (H-12). A ground station may also take the place of a
    // living peer that is none; nobody takes a living ground station's.
    const LOST: u64 = 1 << 63;
    let (mut victim, mut highest) = (None, 0);
    for old in peers.iter_mut() {
        let rank = match now.since(old.heard).as_micros() {
            silence if !old.is_alive => silence | LOST,
            silence if is_gcs && old.r#type != MavType::GCS => silence.max(1),
            _ => 0,
        };
        if rank > 0 && rank >= highest {
            (victim, highest) = (Some(old), rank);
        }
    }
    let victim = victim?;
    let evicted = core::mem::replace(victim, info);
    Some((victim, Some(evicted)))
}
