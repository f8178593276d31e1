//! Finds the recipient of a request, and its link.

use crate::message::{Address, ComponentId};
use crate::network::{PeerInfo, Peers};
use crate::service::Shared;
use crate::types::{Component, LinkId, LinkMask, Peer, Recipient};

/// Returns the recipient, and a normal link on which it is alive: the wanted one, or the one with the next number. If none is wanted,
/// the link of its last answer, or else the one on which it was heard first.
pub(super) fn find(peers: &Peers, shared: &Shared, to: Recipient) -> Option<Peer> {
    let (system, mut component, mut kind, mut first) =
        (shared.config.address.get().system, ComponentId::ALL, None, None);
    let mut wanted = Address { system, component };
    match to {
        Recipient::Type(r#type) => kind = Some(r#type),
        Recipient::Address(address) => (wanted, component) = (address, address.component),
        Recipient::Peer(Peer { address, link }) => {
            (wanted, component, first) = (address, address.component, Some(link.0))
        }
    }
    let (mut found, mut nearest): (Option<Peer>, u8) = (None, 0);
    for PeerInfo { peer, r#type, is_alive, has_answered, .. } in peers.iter() {
        let is_it = *is_alive && overlap(wanted, peer.address) && kind.is_none_or(|kind| kind == *r#type);
        let distance = first.map_or(u8::from(!has_answered), |first| peer.link.0.wrapping_sub(first));
        let is_nearer = found.is_none() || distance < nearest;
        if is_it && is_nearer && shared.normal.contains(LinkMask::of(peer.link)) {
            (found, nearest) = (Some(*peer), distance);
        }
    }
    if kind.is_none()
        && let Some(peer) = &mut found
    {
        peer.address.component = component;
    }
    found
}

/// Returns the recipient if it is another component of this firmware.
pub(super) fn find_inside(components: &[Component], shared: &Shared, to: Recipient) -> Option<Peer> {
    let system = shared.config.address.get().system;
    let is_it = |component: &&Component| match to {
        Recipient::Type(r#type) => component.r#type == r#type,
        Recipient::Address(address) => address == Address { system, component: component.id },
        Recipient::Peer(_) => false,
    };
    let Component { id, .. } = *components.iter().find(is_it)?;
    Some(Peer { address: Address { system, component: id }, link: LinkId::NONE })
}

/// Whether the last answer of a living component was received on this link. Component 0 is any of the system.
pub(super) fn has_answered(peers: &Peers, to: Peer) -> bool {
    let is_it = |info: &PeerInfo| info.peer.link == to.link && overlap(info.peer.address, to.address);
    peers.iter().any(|info| info.is_alive && info.has_answered && is_it(info))
}

/// Records that a component has answered on this link, and on no other one since.
pub(super) fn note_answer(peers: &mut Peers, from: Peer) {
    for info in peers.iter_mut().filter(|info| info.peer.address == from.address) {
        info.has_answered = info.peer.link == from.link;
    }
}

/// Whether two addresses of components overlap: component 0 is every component of a system.
pub(super) fn overlap(a: Address, b: Address) -> bool {
    a.system == b.system && (a.component == b.component || a.component.wire() == 0 || b.component.wire() == 0)
}
