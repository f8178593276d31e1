//! START and STOP: which of them are duplicates, and which are superseded (L-11, L-15).

use core::num::NonZeroU64;

use super::HighLatency;
use crate::message::Address;
use crate::network::Peers;
use crate::service::command::{Duplicates, LATE, SOON, is_well_after};
use crate::time::{Duration, Instant};
use crate::types::{Command, LinkClass, LinkId, LinkMask, Peer, SignedAt};

/// The time after a command during which satellites may deliver older signed commands that it supersedes. No satellite
/// keeps a command for longer. A sender's clock that was set back meanwhile does no harm afterwards.
const SUPERSEDED_WITHIN: Duration = Duration::from_secs(15 * 60);

/// The number of remembered commands: START and STOP of two stations.
pub(super) const ORDERS: usize = 4;

/// The last START or STOP of a sender that was executed: to detect its duplicates, and commands that it supersedes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Order {
    /// Whether there is one.
    is_given: bool,
    from: Peer,
    starts: bool,
    confirmation: u8,
    /// The links that delivered it, and nothing to the opposite effect since: it may be retransmitted there.
    links: LinkMask,
    duplicates: Duplicates,
    at: Instant,
    signed_at: SignedAt,
}

impl Order {
    /// None; all zero bits.
    pub(super) const VACANT: Self = Self {
        is_given: false,
        from: Peer { address: Address::new(0, 0), link: LinkId(0) },
        starts: false,
        confirmation: 0,
        links: LinkMask::NONE,
        duplicates: Duplicates::NONE,
        at: Instant::ZERO,
        signed_at: None,
    };

    /// Returns when it was signed, and when another command from a satellite was signed, if that shows which came
    /// first.
    fn signed(&self, now: Instant, signed_at: SignedAt) -> Option<(NonZeroU64, NonZeroU64)> {
        self.signed_at.zip(signed_at).filter(|_| now - self.at < SUPERSEDED_WITHIN)
    }

    /// Whether `command`, to the same effect, is a duplicate of it, or a retransmission (C-12).
    fn is_copied_by(&self, now: Instant, command: &Command, signed_at: SignedAt) -> bool {
        // Only a satellite delivers a duplicate late.
        let may_be_late = command.class == LinkClass::HighLatency;
        let is_within = now - self.at < if may_be_late { LATE } else { SOON };
        let lacks = self.duplicates.lacks(command.from.link);
        let is_repetition = is_within
            && command.confirmation > self.confirmation
            && self.links.contains(LinkMask::of(command.from.link));
        let is_copy = match self.signed(now, signed_at).filter(|_| may_be_late) {
            Some((known, sent)) => lacks && !is_well_after(sent, known),
            None => lacks && is_within,
        };
        is_copy || is_repetition
    }

    /// Whether its sender, which gave it recently on a normal link, is alive there. Peers on satellite links are never
    /// alive.
    fn is_current(&self, now: Instant, peers: &Peers) -> bool {
        now - self.at < LATE && peers.iter().any(|info| info.peer == self.from && info.is_alive)
    }
}

impl HighLatency {
    /// Whether a command is neither a duplicate nor superseded. If so, it is remembered.
    pub(super) fn obeys(
        &mut self,
        now: Instant,
        command: &Command,
        signed_at: SignedAt,
        starts: bool,
        peers: &Peers,
    ) -> bool {
        let (from, confirmation, link) = (command.from, command.confirmation, command.from.link);
        let known = self.place(from.address, starts).and_then(|place| self.orders.get(place));
        let opposite = self.place(from.address, !starts).and_then(|place| self.orders.get(place));
        // Not if the sender has changed its mind again since.
        let later = opposite.filter(|later| known.is_none_or(|known| known.at <= later.at));
        let signed = opposite.and_then(|opposite| opposite.signed(now, signed_at));
        let is_superseded = command.class == LinkClass::HighLatency
            && match signed {
                Some((opposite, sent)) => sent < opposite,
                None => later.is_some_and(|later| later.is_current(now, peers)),
            };
        let is_newer = later.is_some() && signed.is_some_and(|(opposite, sent)| sent > opposite);
        let is_copy = !is_newer && known.is_some_and(|known| known.is_copied_by(now, command, signed_at));
        // An old command has no more duplicates to come.
        let recent = known.filter(|known| now - known.at < LATE);
        let mut duplicates = recent.map_or(Duplicates::NONE, |known| known.duplicates);
        let is_obeyed = !is_superseded && !is_copy;
        let touched = self.place(from.address, starts != is_obeyed);
        if let Some(order) = touched.and_then(|place| self.orders.get_mut(place)) {
            if is_obeyed {
                // A link keeps the order of its frames.
                order.duplicates.end(link);
                order.links = order.links.without(LinkMask::of(link));
            } else {
                order.duplicates.note(link);
                order.links = order.links.with(LinkMask::of(link));
            }
        }
        if is_obeyed {
            duplicates.run(link);
            let links = LinkMask::of(link);
            // In place of the sender's previous one, in a free place, or in place of the oldest.
            let oldest = || (0..).zip(&self.orders).min_by_key(|(_, order)| order.at).map(|(place, _)| place);
            let place = self.place(from.address, starts).or_else(oldest);
            if let Some(order) = place.and_then(|place| self.orders.get_mut(place)) {
                *order = Order { is_given: true, from, starts, confirmation, links, duplicates, at: now, signed_at };
            }
        }
        is_obeyed
    }

    /// Returns the place of a sender's last START or STOP.
    fn place(&self, from: Address, starts: bool) -> Option<usize> {
        self.orders.iter().position(|order| order.is_given && order.starts == starts && order.from.address == from)
    }
}
