//! Peers: who is out there, on which link, and how well we hear them.
//!
//! Implements the receiving half of <https://mavlink.io/en/services/heartbeat.html>, rules H-10 to H-13, and the loss
//! statistics of <https://mavlink.io/en/guide/packet_loss.html> (S-16). The states of
//! a peer are drawn at [`PeerInfo`].

use crate::dialect::{Heartbeat, MavAutopilot, MavType};
use crate::frame::{Address, Frame, SystemId, Version};
use crate::link::{LinkClass, LinkId, MAX_LINKS, Peer};
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
///
/// # When the table is full
///
/// A new sender evicts a peer of the first row below that has a candidate: the one that has been silent longest (H-12).
///
/// | evicted | by |
/// |---|---|
/// | an unverified peer that is not alive | any frame |
/// | a verified peer that is not alive | a frame of a verified sender |
/// | an unverified peer that is alive | a frame of a verified sender |
/// | a living peer that is not a ground station | a ground station's heartbeat, or any heartbeat on another link |
/// | a living ground station | a heartbeat on another link |
///
/// - A peer is verified when one of its signatures was right, or when it was heard on an open link. Frames that other links
///   accept unsigned, such as RADIO_STATUS, verify no sender.
/// - Links share the table. A sender evicts a peer of another link only if that link holds at least two places more than the
///   sender's own link.
/// - Components of our own system are not evicted by other systems, as long as they hold no more than half of the places.
///   Neither this rule nor the previous one protects an unverified peer from a verified sender.
/// - On a high-latency link, which has no heartbeats, any frame counts as a heartbeat.
///
/// A sender without a place is still served, and its broadcasts are forwarded. Addressed frames from it or to it are not
/// forwarded: see [`no_peer_slot`](crate::ForwardCounters::no_peer_slot).
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
    /// Whether an accepted frame proves that the peer exists: a signed one, or any frame on an open link.
    is_verified: bool,
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

    /// Returns when its last frame was received. On a link that requires signatures, an exempt unsigned frame such as
    /// RADIO_STATUS counts only until a verified frame was received.
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

/// How a frame was received.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reception {
    pub(crate) now: Instant,
    pub(crate) link: LinkId,
    pub(crate) class: LinkClass,
    /// Whether the sender is verified: the frame is signed, or the link is open.
    pub(crate) is_verified: bool,
}

/// Records a checked frame in the peer table. `own` is our own system.
pub(crate) fn on_frame(
    peers: &mut Peers,
    by: Reception,
    own: SystemId,
    frame: &Frame<'_>,
    vehicle: &mut impl Vehicle,
) -> Booking {
    let Reception { now, link, class, is_verified } = by;
    let is_satellite = class == LinkClass::HighLatency;
    let heartbeat = frame.decode::<Heartbeat>().filter(|_| !is_satellite);
    let peer = Peer { address: frame.source(), link };
    let header = frame.header();
    let new = PeerInfo {
        peer,
        r#type: heartbeat.map_or(MavType::GENERIC, |heartbeat| heartbeat.r#type),
        autopilot: MavAutopilot::INVALID,
        version: Version::V2,
        is_alive: false,
        received: 0,
        lost: 0,
        has_heartbeat: false,
        is_verified,
        // An unverified frame must not teach a route.
        is_route: is_verified,
        seq: header.seq,
        time_boot_ms: 0,
        heartbeat: now,
        heard: now,
    };
    let Some((info, evicted)) = find_or_insert(peers, new, own, heartbeat.is_some() || is_satellite) else {
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
    info.is_verified |= is_verified;
    // An unverified frame must not change where a verified peer is heard (R-4, R-7).
    if is_verified || !info.is_verified {
        info.heard = now;
    }
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

/// Returns the entry for the sender of `new`, and the entry that it evicted; `None` when the table is full and nothing can be
/// evicted. `beats`: the frame counts as a heartbeat.
fn find_or_insert(
    peers: &mut Peers,
    new: PeerInfo,
    own: SystemId,
    beats: bool,
) -> Option<(&mut PeerInfo, Option<PeerInfo>)> {
    if let Some(index) = peers.iter().position(|info| info.peer == new.peer) {
        return Some((peers.get_mut(index)?, None));
    }
    if peers.push(new).is_ok() {
        return Some((peers.last_mut()?, None));
    }
    let (mut held, mut ours) = ([0_u16; MAX_LINKS], 0_usize);
    for old in peers.iter() {
        if let Some(held) = held.get_mut(usize::from(old.peer.link.0)) {
            *held = held.saturating_add(1);
        }
        ours = ours.saturating_add(usize::from(old.peer.address.system == own));
    }
    let held = |info: &PeerInfo| held.get(usize::from(info.peer.link.0)).copied().unwrap_or(0);
    let is_ours = |info: &PeerInfo| info.peer.address.system == own;
    let ours_stay = !is_ours(&new) && ours.saturating_mul(2) <= peers.len();
    // 0: cannot be evicted.
    let rank = |old: &PeerInfo| {
        let is_elsewhere = old.peer.link != new.peer.link;
        let is_poor = is_elsewhere && held(old) <= held(&new).saturating_add(1);
        let (is_lower, is_higher) = (!old.is_verified && new.is_verified, old.is_verified && !new.is_verified);
        match old.is_alive {
            _ if is_higher || (!is_lower && (is_poor || (ours_stay && is_ours(old)))) => 0,
            false if old.is_verified => 4,
            false => 5,
            true if is_lower => 3,
            true if !beats => 0,
            true if old.r#type != MavType::GCS && (new.r#type == MavType::GCS || is_elsewhere) => 2,
            true => u8::from(is_elsewhere),
        }
    };
    let (mut victim, mut highest) = (None, (1, Duration::ZERO));
    for old in peers.iter_mut() {
        let place = (rank(old), new.heard.since(old.heard));
        if place >= highest {
            (victim, highest) = (Some(old), place);
        }
    }
    let victim = victim?;
    let evicted = core::mem::replace(victim, new);
    Some((victim, Some(evicted)))
}
