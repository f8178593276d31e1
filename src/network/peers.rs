//! The peer table: the components that were heard, on which links, and how many of their frames were lost.
//!
//! Implements the receiver's side of <https://mavlink.io/en/services/heartbeat.html>, rules H-10 to H-13, and the loss
//! statistics of <https://mavlink.io/en/guide/packet_loss.html> (S-16). [`PeerInfo`] shows the states of a peer.

use core::num::Saturating;

use crate::dialect::{Heartbeat, MavAutopilot, MavType};
use crate::frame::{Frame, Version};
use crate::log::{count, increment};
use crate::message::{Address, Message, SystemId};
use crate::time::{Clock, Duration, Instant};
use crate::types::{LinkClass, LinkId, MAX_LINKS, Peer, PeerEvent, Trust};

/// An entry of the peer table: a component, and the link on which it was heard.
///
/// Any frame with a correct checksum creates an entry. A peer is *alive* while it sends heartbeats. The names in
/// brackets are the [`PeerEvent`]s that the vehicle receives:
///
/// ```text
///   any frame ──▶ heard ── HEARTBEAT (Found) ──▶ alive ── no HEARTBEAT for peer_timeout (Lost) ──▶ timed out
///                                                  ▲                                                   │
///                                                  └─────────────── HEARTBEAT (Regained) ──────────────┘
/// ```
///
/// # Eviction from a full table
///
/// A peer is a newcomer until it has been heard for 30 s without a gap of `peer_timeout`. One that has sent a signed frame is none,
/// nor is a component of the vehicle's own system on a link that [trusts](crate::LinkConfig::trusts_own_system) that system. Other
/// peers are settled, as long as a quarter of the places is left for newcomers (X-9).
///
/// A new sender evicts a peer of the first row below that has a candidate: the peer that has been silent longest
/// (H-12).
///
/// | evicted | by |
/// |---|---|
/// | an unverified peer that is not alive | any frame |
/// | a verified peer that is not alive | a frame of a verified sender |
/// | an unverified peer that is alive | a frame of a verified sender |
/// | a living newcomer that is not a ground station | a ground station's heartbeat, or any heartbeat on another link |
/// | a living newcomer | a heartbeat on another link, or any heartbeat after the newcomer's first 5 s, or a signed one if it does not sign |
///
/// - The stations of the system in control are not evicted while they are alive, settled peers not before they have been silent
///   for 30 s, and settled peers that sign only by one that signs. One that signs is no newcomer for those that do not, even if there
///   was no place left to settle.
/// - A peer is verified once one of its signatures was valid, or once it was heard on an open link. Frames that other
///   links accept unsigned, such as RADIO_STATUS, verify no sender.
/// - Links share the table. A sender evicts a peer of another link only if that link has at least two entries more than
///   the sender's own link.
/// - The last rule does not protect an unverified peer from a verified sender.
/// - On a high-latency link, which has no heartbeats, any frame counts as a heartbeat.
///
/// A sender without an entry is still served, and its broadcasts are forwarded. Addressed frames from it or to it are
/// not forwarded: see [`no_peer_slot`](crate::network::ForwardCounters::no_peer_slot).
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PeerInfo {
    /// The component and the link. A component that is heard on two links has two entries.
    pub peer: Peer,
    /// HEARTBEAT.type; [`MavType::GENERIC`] before the first heartbeat.
    pub r#type: MavType,
    /// HEARTBEAT.autopilot; [`MavAutopilot::INVALID`] before the first heartbeat.
    pub autopilot: MavAutopilot,
    /// The MAVLink version of its last frame.
    pub version: Version,
    /// Whether its last heartbeat was more recent than `peer_timeout` when [`Stack::peers`](crate::Stack::peers) was
    /// called (H-18). Always false on a high-latency link, where no
    /// heartbeats are expected: frames there only count for [`last_heard`](Self::last_heard) (L-3).
    pub is_alive: bool,
    /// Number of frames received. It wraps.
    pub received: u32,
    /// Number of frames lost in transit, from gaps in the sequence numbers (S-16). It wraps.
    pub lost: u32,
    has_heartbeat: bool,
    /// What proves that the peer exists: the best proof of its frames. It is lost by a silence of `peer_timeout`.
    pub(crate) trust: Trust,
    /// No newcomer takes its place (X-9).
    is_settled: bool,
    /// Whether frames for the peer are forwarded to this link (R-3).
    pub(super) is_route: bool,
    /// Whether its last answer to a request of ours was received on this link (K-4).
    pub(crate) has_answered: bool,
    expected: Sequence,
    /// Its last SYSTEM_TIME.time_boot_ms; 0 before the first, and if forwarding is off.
    pub(super) time_boot_ms: u32,
    heartbeat: Instant,
    heard: Instant,
    /// Since when it has been heard without a gap of `peer_timeout`.
    since: Instant,
}

/// How long a peer must have been heard until it is settled, and how long a settled peer may be silent (X-9).
const SETTLED_AFTER: Duration = Duration::from_secs(30);

/// How long a newcomer keeps its place (X-9).
const NEWCOMER_STAYS: Duration = Duration::from_secs(5);

impl PeerInfo {
    /// Returns when its last heartbeat was received; `None` before the first.
    pub fn last_heartbeat(&self) -> Option<Instant> {
        self.has_heartbeat.then_some(self.heartbeat)
    }

    /// Returns the entry as it is at `now`, whether or not [`poll`] has seen the timeout yet (H-18). Its instants are those of
    /// the clock that the firmware sees.
    pub(crate) fn at(&self, now: Instant, timeout: Duration, clock: &Clock) -> Self {
        let (heartbeat, heard) = (clock.shown(self.heartbeat), clock.shown(self.heard));
        Self { is_alive: self.is_alive && !self.is_silent(now, timeout), heartbeat, heard, ..*self }
    }

    /// Whether it is settled, so that `new` cannot take its place (X-9).
    fn keeps_its_place(&self, new: &Self) -> bool {
        let is_recent = self.is_alive || new.heard - self.heard < SETTLED_AFTER;
        let signs_alone = self.trust == Trust::Signed && new.trust < Trust::Signed;
        match self.is_settled {
            true => self.trust > Trust::None && (is_recent || signs_alone),
            // It had no place to settle, because others have settled without a signature.
            false => is_recent && signs_alone,
        }
    }

    /// Whether its last heartbeat is `timeout` ago or longer.
    pub(crate) fn is_silent(&self, now: Instant, timeout: Duration) -> bool {
        now - self.heartbeat >= timeout
    }

    /// Whether it is a ground station that is alive, on this link.
    pub fn is_living_station(&self) -> bool {
        self.r#type == MavType::GCS && self.is_alive
    }

    /// Records a frame. Returns whether it is the peer's as far as is known: no frame within `timeout` has proved its sender
    /// better.
    fn note_frame(&mut self, trust: Trust, now: Instant, timeout: Duration) -> bool {
        let was_silent = now - self.heard >= timeout;
        if trust < self.trust && !was_silent {
            // It must not change where the peer is heard (R-4, R-7).
            return false;
        }
        if was_silent {
            self.since = now;
        }
        self.trust = trust;
        self.heard = now;
        true
    }

    /// Records a heartbeat. Returns the change to report, if it is the first one, or the first after a timeout.
    fn note_heartbeat(&mut self, heartbeat: &Heartbeat, now: Instant) -> Option<PeerEvent> {
        self.r#type = heartbeat.r#type;
        self.autopilot = heartbeat.autopilot;
        self.heartbeat = now;
        let was_alive = core::mem::replace(&mut self.is_alive, true);
        if !core::mem::replace(&mut self.has_heartbeat, true) {
            event!("peer {} found", self.peer);
            Some(PeerEvent::Found(self.peer))
        } else if !was_alive {
            event!("peer {} reconnected", self.peer);
            Some(PeerEvent::Regained(self.peer))
        } else {
            None
        }
    }

    /// Returns when its last frame was received. On a link that requires signatures, an exempt unsigned frame such as
    /// RADIO_STATUS counts only until a verified frame was received.
    pub const fn last_heard(&self) -> Instant {
        self.heard
    }
}

/// The sequence number that is expected next from a peer (S-16).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Sequence(u8);

impl Sequence {
    /// A number up to this much behind the expected one is a duplicate or a delayed frame, not a loss of over 200 frames.
    const MAX_DELAY: u8 = 32;

    /// Expects the number after `received`, unless that is a duplicate or delayed. Returns how many numbers were skipped.
    fn advance_past(&mut self, received: u8) -> u8 {
        let skipped = received.wrapping_sub(self.0);
        if skipped >= Self::MAX_DELAY.wrapping_neg() {
            return 0;
        }
        self.0 = received.wrapping_add(1);
        skipped
    }
}

/// The peer table. The logic works on a view, so it is compiled once for all capacities.
pub type Peers = heapless::vec::VecView<PeerInfo>;

/// Returns whether `address` was heard before, on any link.
pub(crate) fn is_known(peers: &Peers, address: Address) -> bool {
    peers.iter().any(|info| info.peer.address == address)
}

/// Returns whether `peer` was heard before, on its link.
pub(crate) fn is_heard(peers: &Peers, peer: Peer) -> bool {
    peers.iter().any(|info| info.peer == peer)
}

/// The result of recording a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Recorded {
    pub(crate) entry: SenderEntry,
    /// The sender has an entry, and no frame on the link within `peer_timeout` has proved it better than this one (X-1).
    pub(crate) is_proven: bool,
}

/// Whether the table has an entry for the sender of a frame (H-12).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SenderEntry {
    /// The sender had an entry, or there was room for one.
    Present,
    /// The sender evicted another peer.
    Evicted,
    /// The table is full, and the sender may evict no peer.
    NoRoom,
}

/// How a frame was received.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reception {
    pub(crate) now: Instant,
    pub(crate) link: LinkId,
    pub(crate) class: LinkClass,
    /// What proves the sender.
    pub(crate) trust: Trust,
    /// The sender is settled at once: it has signed the frame, or is of the vehicle's system on a link that trusts it (X-9).
    pub(crate) settles: bool,
}

/// The system that has a right to its places, and how long a peer may be silent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Residents {
    /// The system in control.
    pub(crate) owner: Option<SystemId>,
    /// `peer_timeout`.
    pub(crate) timeout: Duration,
}

/// Records a frame with a correct checksum in the peer table.
pub(crate) fn record(
    peers: &mut Peers,
    by: Reception,
    residents: Residents,
    frame: &Frame<'_>,
    mut report: impl FnMut(PeerEvent),
) -> Recorded {
    let Reception { now, link, class, trust, settles } = by;
    let is_satellite = class == LinkClass::HighLatency;
    let heartbeat = frame.decode::<Heartbeat>().filter(|_| !is_satellite);
    let header = frame.header();
    let new = PeerInfo {
        peer: Peer { address: frame.source(), link },
        r#type: heartbeat.map_or(MavType::GENERIC, |heartbeat| heartbeat.r#type),
        autopilot: MavAutopilot::INVALID,
        version: Version::V2,
        is_alive: false,
        received: 0,
        lost: 0,
        has_heartbeat: false,
        trust,
        is_settled: false,
        // An unverified frame must not teach a route.
        is_route: trust > Trust::None,
        has_answered: false,
        expected: Sequence(header.seq),
        time_boot_ms: 0,
        heartbeat: now,
        heard: now,
        since: now,
    };
    let is_heartbeat = heartbeat.is_some() || is_satellite;
    let (index, evicted) = find_or_insert(peers, new, residents.owner, is_heartbeat);
    let Some(info) = peers.get_mut(index) else {
        return Recorded { entry: SenderEntry::NoRoom, is_proven: false };
    };
    if let Some(Evicted { peer, was_alive: true }) = evicted {
        // Its timeout is no longer monitored.
        report(PeerEvent::Lost(peer));
    }
    count(&mut info.lost, info.expected.advance_past(header.seq).into());
    increment(&mut info.received);
    info.version = header.version;
    let is_proven = info.note_frame(trust, now, residents.timeout);
    if is_proven
        && let Some(heartbeat) = heartbeat
        && let Some(event) = info.note_heartbeat(&heartbeat, now)
    {
        report(event);
    }
    let is_due = settles || (trust > Trust::None && now - info.since >= SETTLED_AFTER);
    if is_due && !info.is_settled {
        let settles = has_place_to_settle(peers, now);
        if let Some(info) = peers.get_mut(index) {
            info.is_settled = settles;
        }
    }
    Recorded { entry: if evicted.is_some() { SenderEntry::Evicted } else { SenderEntry::Present }, is_proven }
}

/// Whether a quarter of the places, at least one, is left for newcomers if another peer settles (X-9).
fn has_place_to_settle(peers: &Peers, now: Instant) -> bool {
    // Those that have gone keep no place from others.
    let since = now - SETTLED_AFTER;
    let settled = peers.iter().filter(|info| info.is_settled && (info.is_alive || info.heard >= since));
    // `count` could overflow, as far as the compiler knows.
    let settled = settled.fold(0_usize, |settled, _| settled.saturating_add(1));
    let kept_free = (peers.capacity() / 4).max(1);
    settled.saturating_add(kept_free) < peers.capacity()
}

/// Records a frame with an unknown id, whose checksum could not be verified. It is trusted only if it has the expected
/// sequence number: then it does not count as lost (S-16).
pub(crate) fn record_unchecked(peers: &mut Peers, peer: Peer, seq: u8) {
    if let Some(info) = peers.iter_mut().find(|info| info.peer == peer && info.expected == Sequence(seq)) {
        info.expected.advance_past(seq);
    }
}

/// The maximum number of peers that a poll reports as lost: the next poll continues (X-6).
const REPORTS: usize = 16;

/// Reports the peers whose heartbeats have timed out (H-11).
pub(crate) fn poll(peers: &mut Peers, now: Instant, timeout: Duration, mut report: impl FnMut(PeerEvent)) {
    let lost = peers.iter_mut().filter(|info| info.is_alive && info.is_silent(now, timeout));
    for info in lost.take(REPORTS) {
        info.is_alive = false;
        event!("peer {} timed out", info.peer);
        report(PeerEvent::Lost(info.peer));
    }
}

/// Returns when [`poll`] has something to report.
pub(crate) fn deadline(peers: &[PeerInfo], timeout: Duration) -> Instant {
    let alive = peers.iter().filter(|info| info.is_alive);
    alive.map(|info| info.heartbeat + timeout).min().unwrap_or(Instant::NEVER)
}

/// A peer that left the table.
#[derive(Clone, Copy)]
struct Evicted {
    peer: Peer,
    was_alive: bool,
}

/// Returns the place of the sender of `new`, and the peer that had to leave it. There is none if the table is full and the sender may
/// evict no peer. `is_heartbeat`: the frame counts as a heartbeat.
fn find_or_insert(
    peers: &mut Peers,
    new: PeerInfo,
    owner: Option<SystemId>,
    is_heartbeat: bool,
) -> (usize, Option<Evicted>) {
    let known = peers.iter().position(|info| info.peer == new.peer);
    let place = known.unwrap_or(peers.len());
    if known.is_some() || peers.push(new).is_ok() {
        return (place, None);
    }
    let mut held = [Saturating(0_u8); MAX_LINKS];
    for old in peers.iter() {
        if let Some(held) = held.get_mut(usize::from(old.peer.link.0)) {
            *held += 1;
        }
    }
    let held = |info: &PeerInfo| held.get(usize::from(info.peer.link.0)).copied().unwrap_or_default();
    let room_of_new = held(&new) + Saturating(1);
    // Rank 0 is never evicted, rank 5 first.
    let rank = |old: &PeerInfo| {
        let is_other_link = old.peer.link != new.peer.link;
        let (is_verified, new_is_verified) = (old.trust > Trust::None, new.trust > Trust::None);
        let is_resident = old.keeps_its_place(&new) || (old.is_alive && Some(old.peer.address.system) == owner);
        if is_resident || (is_verified && !new_is_verified) {
            return 0;
        }
        if !is_verified && new_is_verified {
            return if old.is_alive { 3 } else { 5 };
        }
        match old.is_alive {
            _ if is_other_link && held(old) <= room_of_new => 0,
            false if is_verified => 4,
            false => 5,
            true if !is_heartbeat => 0,
            true if old.r#type != MavType::GCS && (new.r#type == MavType::GCS || is_other_link) => 2,
            true => {
                let has_stayed = new.heard - old.since >= NEWCOMER_STAYS;
                u8::from(is_other_link || has_stayed || new.trust > old.trust)
            }
        }
    };
    let (mut victim, mut highest) = (place, (1, Duration::ZERO));
    for index in 0..peers.len() {
        let Some(old) = peers.get(index) else { break };
        let rank = (rank(old), new.heard - old.heard);
        if rank >= highest {
            (victim, highest) = (index, rank);
        }
    }
    let evicted = peers.get_mut(victim).map(|info| {
        let old = core::mem::replace(info, new);
        Evicted { peer: old.peer, was_alive: old.is_alive }
    });
    (victim, evicted)
}

/// Whether a frame is the heartbeat of another vehicle, or of a part of one: not of a ground station or a companion computer.
pub(crate) fn is_of_vehicle(frame: &Frame<'_>) -> bool {
    /// The offset of HEARTBEAT.type.
    const TYPE: usize = 4;
    let of = MavType(frame.payload().get(TYPE).copied().unwrap_or(0));
    frame.id() == Heartbeat::ID && !matches!(of, MavType::GCS | MavType::ONBOARD_CONTROLLER)
}
