//! Routes from the peer table: the links to which a frame is forwarded, and those to which it must not be.

use super::peers::{PeerInfo, Peers};
use crate::dialect::{ManualControl, SystemTime};
use crate::frame::Frame;
use crate::message::{Address, Message};
use crate::time::{Duration, Instant};
use crate::types::{LinkMask, Peer};

/// How long after a frame of a peer was received on a link, its broadcasts are not forwarded to that link, and
/// the peer counts as reachable on it.
const HEARD: Duration = Duration::from_secs(5);

/// The routes of a frame, from the peer table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Routes {
    /// The frame's target.
    pub(crate) target: Address,
    /// Links on which its source was heard [recently](HEARD).
    pub(crate) seen: LinkMask,
    /// Links that reach a component of its target; all links for a broadcast.
    pub(crate) to: LinkMask,
}

/// Learns the route to the sender of a frame.
pub(crate) fn learn_route(peers: &mut Peers, sender: Peer) {
    if let Some(info) = peers.iter_mut().find(|info| info.peer == sender) {
        info.is_route = true;
    }
}

/// Returns the routes of a frame from `from` to `target`. `free` are the links on which the frame costs
/// nothing: a
/// component that one of them reaches needs no other link.
pub(crate) fn routes(peers: &Peers, now: Instant, from: Peer, target: Address, free: LinkMask) -> Routes {
    let to = if target.system.is_all() { LinkMask::ALL } else { LinkMask::NONE };
    let mut routes = Routes { target, seen: LinkMask::NONE, to };
    let is_heard = |info: &PeerInfo| now - info.last_heard() < HEARD;
    for info in peers.iter().filter(|info| info.is_route) {
        let address = info.peer.address;
        let link = LinkMask::of(info.peer.link);
        if address == from.address {
            routes.seen = if is_heard(info) { routes.seen.with(link) } else { routes.seen };
        } else if address.system == target.system
            && (target.component.is_all() || address.component == target.component)
        {
            let is_free = |other: &&PeerInfo| {
                other.peer.address == address
                    && other.is_route
                    && free.contains(other.peer.link)
                    && (other.is_alive || is_heard(other))
            };
            if free.intersects(link) || !peers.iter().any(|other| is_free(&other)) {
                routes.to = routes.to.with(link);
            }
        }
    }
    routes
}

/// Forgets the routes to `from` on other links if it has rebooted, that is, if its SYSTEM_TIME went backwards.
/// The frame's checksum was verified. Anyone can claim a reboot, so a route on which the component is still heard stays
/// it is forgotten by a later SYSTEM_TIME, once the component has been silent there for [`HEARD`].
pub(crate) fn forget_rebooted(peers: &mut Peers, now: Instant, from: Peer, frame: &Frame<'_>) {
    if frame.id() != SystemTime::ID {
        return;
    }
    // It follows `time_unix_usec`.
    let time_boot_ms = u32::from_le_bytes([8, 9, 10, 11].map(|offset| frame.byte(offset)));
    let is_elsewhere = |info: &PeerInfo| info.peer.address == from.address && info.peer != from;
    let is_heard_elsewhere = peers.iter().any(|info| is_elsewhere(info) && now - info.last_heard() < HEARD);
    let Some(info) = peers.iter_mut().find(|info| info.peer == from) else { return };
    // A wrap at 2^32 ms is not a reboot (D-1).
    let last = info.time_boot_ms;
    let has_rebooted = time_boot_ms < last && time_boot_ms.wrapping_sub(last) >= HOUR_MS;
    if !has_rebooted || !is_heard_elsewhere {
        info.time_boot_ms = time_boot_ms;
    }
    if !has_rebooted {
        return;
    }
    event!("{} has rebooted: its routes are forgotten", from);
    for info in peers.iter_mut().filter(|info| is_elsewhere(info) && now - info.last_heard() >= HEARD) {
        info.is_route = false;
    }
}

const HOUR_MS: u32 = 3_600_000;

/// Returns the address to which a frame is sent; a broadcast if the message is unknown.
pub(crate) fn target_of(frame: &Frame<'_>) -> Address {
    let Some(info) = frame.info() else { return Address::default() };
    // MANUAL_CONTROL is the only message whose target field is not named `target_system`.
    let system = if info.id() == ManualControl::ID { Some(MANUAL_CONTROL_TARGET) } else { info.target_system() };
    // A field that was trimmed, or does not exist, reads as 0: a broadcast.
    let byte = |offset: Option<u8>| offset.map_or(0, |offset| frame.byte(offset));
    Address::new(byte(system), byte(info.target_component()))
}

/// The offset of MANUAL_CONTROL.target.
const MANUAL_CONTROL_TARGET: u8 = 10;
