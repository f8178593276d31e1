//! START and STOP: which of them are duplicates, and which are superseded (L-11, L-15).

use core::cmp::Ordering;

use crate::message::Address;
use crate::network::Peers;
use crate::service::Request;
use crate::service::command::{Duplicates, LATE, SOON, is_well_after};
use crate::time::{Duration, Instant};
use crate::types::{Command, LinkClass, LinkId, LinkMask, Peer, SignedAt};

/// The time after a command during which satellites may deliver older signed commands that it supersedes. No satellite
/// keeps a command for longer. A sender's clock that was set back meanwhile does no harm afterwards.
const SUPERSEDED_WITHIN: Duration = Duration::from_secs(15 * 60);

/// The action of MAV_CMD_CONTROL_HIGH_LATENCY.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    Start,
    Stop,
}

/// Whether a received command is executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Decision {
    Execute,
    /// It is a duplicate, or its sender has given the opposite command later.
    Ignore,
}

/// The last START or STOP of a sender that was executed: to detect its duplicates, and commands that it supersedes.
#[derive(Clone, Copy, Debug)]
struct Order {
    /// Whether the slot is in use.
    is_given: bool,
    action: Action,
    from: Peer,
    confirmation: u8,
    /// The links that have delivered it, and have not delivered the opposite command since: it may be retransmitted
    /// there.
    links: LinkMask,
    duplicates: Duplicates,
    at: Instant,
    signed_at: SignedAt,
}

impl Order {
    /// A free slot; all zero bits.
    const VACANT: Self = Self {
        is_given: false,
        action: Action::Start,
        from: Peer { address: Address::new(0, 0), link: LinkId(0) },
        confirmation: 0,
        links: LinkMask::NONE,
        duplicates: Duplicates::NONE,
        at: Instant::ZERO,
        signed_at: None,
    };

    /// Whether `command`, with the same action, is a duplicate of it, or a retransmission (C-12).
    fn is_repeated_by(&self, now: Instant, command: &Command, signed_at: SignedAt) -> bool {
        let link = command.from.link;
        let age = now - self.at;
        // Only a satellite delivers a duplicate late.
        let is_from_satellite = command.class == LinkClass::HighLatency;
        let is_recent = age < if is_from_satellite { LATE } else { SOON };
        if is_recent && command.confirmation > self.confirmation && self.links.contains(link) {
            return true;
        }
        let may_be_duplicate = match self.signed_at.zip(signed_at) {
            Some((known, sent)) if is_from_satellite && age < SUPERSEDED_WITHIN => !is_well_after(sent, known),
            _ => is_recent,
        };
        may_be_duplicate && self.duplicates.lacks(link)
    }

    /// Compares when another command was signed with when this one was. `None` if that does not show which came first.
    fn compare_signature(&self, now: Instant, signed_at: SignedAt) -> Option<Ordering> {
        let (known, sent) = self.signed_at.zip(signed_at)?;
        (now - self.at < SUPERSEDED_WITHIN).then_some(sent.cmp(&known))
    }

    /// Whether its sender, which gave it recently on a normal link, is alive there. Peers on satellite links are never
    /// alive.
    fn is_current(&self, now: Instant, peers: &Peers) -> bool {
        now - self.at < LATE && peers.iter().any(|info| info.peer == self.from && info.is_alive)
    }
}

/// The last START and STOP of two stations.
#[derive(Clone, Debug)]
pub(super) struct Orders([Order; 4]);

impl Orders {
    /// All zero bits.
    pub(super) const NEW: Self = Self([Order::VACANT; 4]);

    /// Decides whether a command is executed, and remembers it.
    pub(super) fn decide(&mut self, now: Instant, action: Action, request: &Request, peers: &Peers) -> Decision {
        let Request { command, signed_at, .. } = request;
        let (from, link) = (command.from, command.from.link);
        let (mut known, mut opposite) = (None, None);
        for order in self.0.iter_mut().filter(|order| order.is_given && order.from.address == from.address) {
            if order.action == action {
                known = Some(order);
            } else {
                opposite = Some(order);
            }
        }
        // The sender has not given this command again since the opposite one.
        let later = opposite.as_deref().filter(|later| known.as_deref().is_none_or(|known| known.at <= later.at));
        let signature = opposite.as_deref().and_then(|opposite| opposite.compare_signature(now, *signed_at));
        let is_superseded = match signature {
            Some(order) => order == Ordering::Less,
            None => later.is_some_and(|later| later.is_current(now, peers)),
        };
        let is_superseded = is_superseded && command.class == LinkClass::HighLatency;
        let is_newer = later.is_some() && signature == Some(Ordering::Greater);
        let mut duplicates = Duplicates::NONE;
        if let Some(known) = known.as_deref_mut() {
            if is_superseded || (!is_newer && known.is_repeated_by(now, command, *signed_at)) {
                known.duplicates.note(link);
                known.links = known.links.with(LinkMask::of(link));
                return Decision::Ignore;
            }
            // An old command has no more duplicates to come.
            if now - known.at < LATE {
                duplicates = known.duplicates;
            }
        }
        if is_superseded {
            return Decision::Ignore;
        }
        duplicates.run(link);
        if let Some(opposite) = opposite {
            // A link keeps the order of its frames.
            opposite.duplicates.end(link);
            opposite.links = opposite.links.without(LinkMask::of(link));
        }
        // It replaces the sender's previous one, or else uses a free slot, or replaces the oldest.
        let slot = match known {
            Some(known) => Some(known),
            None => self.0.iter_mut().min_by_key(|order| order.at),
        };
        if let Some(slot) = slot {
            *slot = Order {
                is_given: true,
                action,
                from,
                confirmation: command.confirmation,
                links: LinkMask::of(link),
                duplicates,
                at: now,
                signed_at: *signed_at,
            };
        }
        Decision::Execute
    }
}
