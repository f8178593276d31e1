//! START and STOP: which of them are copies, and which were overtaken (L-11, L-15).

use core::num::NonZeroU64;

use super::HighLatency;
use crate::link::{LinkClass, LinkMask, Peer};
use crate::network::Peers;
use crate::service::command::{Copies, LATE, SOON, SignedAt, is_well_after};
use crate::time::{Duration, Instant};
use crate::vehicle::Command;

/// So long after an order others are looked for that come by satellite and were signed before it. Longer than a satellite
/// keeps anything; and a sender's clock that was set back meanwhile does no harm after that.
const OVERTAKEN_WITHIN: Duration = Duration::from_secs(15 * 60);

/// Orders that are remembered: START and STOP of two stations.
pub(super) const ORDERS: usize = 4;

/// The last START, or STOP, of somebody that was carried out: to know its copies by, and what it has overtaken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Order {
    from: Peer,
    starts: bool,
    confirmation: u8,
    /// The links that brought it, and nothing to the opposite effect since: there it may be repeated.
    links: LinkMask,
    copies: Copies,
    at: Instant,
    signed_at: SignedAt,
}

impl Order {
    /// When it was signed and when another one was that came by satellite, where that tells which was said first.
    fn signed(&self, now: Instant, signed_at: SignedAt) -> Option<(NonZeroU64, NonZeroU64)> {
        self.signed_at.zip(signed_at).filter(|_| now.since(self.at) < OVERTAKEN_WITHIN)
    }

    /// Whether `command`, to the same effect, is a copy of it, or a repetition (C-12).
    fn is_copied_by(&self, now: Instant, command: &Command, signed_at: SignedAt) -> bool {
        // Only a satellite brings one late.
        let may_be_late = command.class == LinkClass::HighLatency;
        let is_within = now.since(self.at) < if may_be_late { LATE } else { SOON };
        let lacks = self.copies.lacks(command.from.link);
        let is_repetition = is_within
            && command.confirmation > self.confirmation
            && self.links.contains(LinkMask::of(command.from.link));
        let is_copy = match self.signed(now, signed_at).filter(|_| may_be_late) {
            Some((known, sent)) => lacks && !is_well_after(sent, known),
            None => lacks && is_within,
        };
        is_copy || is_repetition
    }

    /// Whether who gave it, by a normal link, a moment ago is alive there. Nobody is alive by satellite.
    fn is_current(&self, now: Instant, peers: &Peers) -> bool {
        now.since(self.at) < LATE && peers.iter().any(|info| info.peer == self.from && info.is_alive)
    }
}

impl HighLatency {
    /// Whether an order is neither a copy nor overtaken; it is remembered then.
    pub(super) fn obeys(
        &mut self,
        now: Instant,
        command: &Command,
        signed_at: SignedAt,
        starts: bool,
        peers: &Peers,
    ) -> bool {
        let (from, confirmation, link) = (command.from, command.confirmation, command.from.link);
        let is_his = |order: &&Order| order.from.address == from.address;
        let known = self.orders.iter().flatten().filter(is_his).find(|order| order.starts == starts);
        let opposite = self.orders.iter().flatten().filter(is_his).find(|order| order.starts != starts);
        // Not if he has changed his mind once more.
        let later = opposite.filter(|later| known.is_none_or(|known| known.at <= later.at));
        let signed = opposite.and_then(|opposite| opposite.signed(now, signed_at));
        let is_overtaken = command.class == LinkClass::HighLatency
            && match signed {
                Some((opposite, sent)) => sent < opposite,
                None => later.is_some_and(|later| later.is_current(now, peers)),
            };
        let is_newer = later.is_some() && signed.is_some_and(|(opposite, sent)| sent > opposite);
        let is_copy = !is_newer && known.is_some_and(|known| known.is_copied_by(now, command, signed_at));
        // What was long ago has no more copies to come.
        let recent = known.filter(|known| now.since(known.at) < LATE);
        let mut copies = recent.map_or(Copies::NONE, |known| known.copies);
        let is_obeyed = !is_overtaken && !is_copy;
        for order in self.orders.iter_mut().flatten().filter(|order| order.from.address == from.address) {
            if is_obeyed && order.starts != starts {
                // A link keeps the order of what it carries.
                order.copies.end(link);
                order.links = order.links.without(LinkMask::of(link));
            } else if !is_obeyed && order.starts == starts {
                order.copies.count(link);
                order.links = order.links.with(LinkMask::of(link));
            }
        }
        if is_obeyed {
            copies.run(link);
            let order = Order { from, starts, confirmation, links: LinkMask::of(link), copies, at: now, signed_at };
            self.remember(order);
        }
        is_obeyed
    }

    /// In the place of the one before it, or in a free one, or in the oldest one's.
    fn remember(&mut self, order: Order) {
        let is_same = |known: &Order| known.from.address == order.from.address && known.starts == order.starts;
        let place = self.orders.iter_mut().min_by_key(|place| match place {
            Some(known) if is_same(known) => (0, Instant::ZERO),
            None => (1, Instant::ZERO),
            Some(known) => (2, known.at),
        });
        if let Some(place) = place {
            *place = Some(order);
        }
    }
}
