//! The peer table as route table: which links a frame is for, and which it must not go to.

use super::peers::Peers;
use crate::dialect::SystemTime;
use crate::frame::{Address, Frame};
use crate::link::{LinkMask, Peer};
use crate::message::Message;
use crate::time::{Duration, Instant};

/// For this long after a frame of a peer came by a link, its broadcasts are not forwarded there, and it counts as reachable
/// there.
const HEARD: Duration = Duration::from_secs(5);

/// What the peer table says of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Routes {
    /// Whom the frame is for.
    pub(crate) target: Address,
    /// Links that its source was heard on [lately](HEARD).
    pub(crate) seen: LinkMask,
    /// Links that its target was heard on; all, for a broadcast.
    pub(crate) to: LinkMask,
    /// Links on which its target is alive, or was heard [recently](HEARD).
    pub(crate) alive: LinkMask,
}

/// Finds the routes of a frame of `from` for `target`. `is_learned`: the way to `from` is known from this very frame
///
pub(crate) fn routes(peers: &mut Peers, now: Instant, from: Peer, is_learned: bool, target: Address) -> Routes {
    let to = if target.system.0 == 0 { LinkMask::ALL } else { LinkMask::NONE };
    let mut routes = Routes { target, seen: LinkMask::NONE, to, alive: LinkMask::NONE };
    for info in peers.iter_mut() {
        let Peer { address, link } = info.peer;
        if address.system != from.address.system && address.system != target.system {
            continue;
        }
        info.is_route |= is_learned && info.peer == from;
        if !info.is_route {
            continue;
        }
        let link = LinkMask::of(link);
        let is_heard = now.since(info.last_heard()) < HEARD;
        if address == from.address {
            routes.seen = if is_heard { routes.seen.with(link) } else { routes.seen };
        } else if address.system == target.system && (target.component.0 == 0 || address.component == target.component)
        {
            routes.to = routes.to.with(link);
            routes.alive = if is_heard || info.is_alive { routes.alive.with(link) } else { routes.alive };
        }
    }
    routes
}

/// Forgets the routes to who has rebooted: to `from`, if his SYSTEM_TIME went backwards. The link that told so is known
/// again at once. The frame's checksum was seen to be right.
pub(crate) fn forget_rebooted(peers: &mut Peers, from: Peer, frame: &Frame<'_>) {
    if frame.id() != SystemTime::ID {
        return;
    }
    // Behind `time_unix_usec`.
    let time_boot_ms = u32::from_le_bytes([8, 9, 10, 11].map(|offset| frame.byte(offset)));
    let info = peers.iter_mut().find(|info| info.peer == from);
    let last = info.map_or(0, |info| core::mem::replace(&mut info.time_boot_ms, time_boot_ms));
    // A step over 2^32 ms is none (D-1).
    if time_boot_ms >= last || time_boot_ms.wrapping_sub(last) < HOUR_MS {
        return;
    }
    event!("{} has rebooted: its routes are forgotten", from);
    for info in peers.iter_mut().filter(|info| info.peer.address == from.address && info.peer != from) {
        info.is_route = false;
    }
}

const HOUR_MS: u32 = 3_600_000;
