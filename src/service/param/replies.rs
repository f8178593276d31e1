//! The pending answers besides single values: the active list of each link, and a few refusals.
//!
//! Pending values need no memory here: the table has a mark for each parameter and link (P-12).

use crate::dialect::{MavParamError, ParamError};
use crate::link::Outbox;
use crate::message::Text;
use crate::service::rate_limit::{RateLimit, cost};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, LinkMask, Peer};

/// Number of refusals that can be pending on all links together.
const SLOTS: usize = 4;

/// The cost of a value: the size of a PARAM_VALUE in MAVLink 2, for a share of 40 % of the link (P-11).
const COST: u32 = cost(37, 40);

/// A list value that has waited this long is sent before streams and forwarded frames; otherwise a saturated link would
/// starve the list (D-4, P-11). Less than what a [`RateLimit`] makes up, so that waiting does not reduce the list's share.
const MAX_LATENESS: Duration = Duration::from_millis(20);

/// A pending refusal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refusal {
    pub(super) to: Peer,
    pub(super) error: MavParamError,
    /// As in the request; -1 if it has a name instead (P-30).
    pub(super) index: i16,
    pub(super) name: [u8; 16],
}

/// The pending refusals of all links.
///
/// A link without a pending refusal always gets a slot: if none is free, it evicts a refusal of another link. Otherwise a stalled
/// link would block the others. To its client, an evicted refusal looks like a lost frame; nothing was carried out, and after a
/// PARAM_SET the client gets the value anyway.
#[derive(Clone, Debug)]
pub(super) struct Refusals([Option<Refusal>; SLOTS]);

impl Refusals {
    pub(super) const fn new() -> Self {
        Self([None; SLOTS])
    }

    /// Returns the links on which refusals are pending.
    pub(super) fn links(&self) -> LinkMask {
        self.0.iter().flatten().fold(LinkMask::NONE, |links, refusal| links.with(LinkMask::of(refusal.to.link)))
    }

    /// Whether there is no slot for another refusal on a link.
    pub(super) fn is_full(&self, link: LinkId) -> bool {
        self.0.iter().all(Option::is_some) && self.links().contains(LinkMask::of(link))
    }

    /// Queues a refusal. Returns false if there is no slot for it.
    pub(super) fn push(&mut self, refusal: Refusal) -> bool {
        if self.is_full(refusal.to.link) {
            return false;
        }
        // A free slot, or the last one, which then belongs to another link.
        let place = self.0.iter().position(Option::is_none).unwrap_or(SLOTS.wrapping_sub(1));
        if let Some(slot) = self.0.get_mut(place) {
            *slot = Some(refusal);
        }
        true
    }

    fn slot(&mut self, link: LinkId) -> Option<&mut Option<Refusal>> {
        self.0.iter_mut().find(|slot| slot.is_some_and(|refusal| refusal.to.link == link))
    }

    /// Sends a refusal of the link. Returns false if none is pending.
    pub(super) fn next(&mut self, tx: &mut Outbox) -> bool {
        let Some(refusal) = self.slot(tx.link()).and_then(Option::take) else { return false };
        tx.send(&ParamError {
            param_index: refusal.index,
            target_system: refusal.to.address.system.wire(),
            target_component: refusal.to.address.component.wire(),
            param_id: Text::from_wire(refusal.name),
            error: refusal.error,
        })
    }

    /// Drops the refusals of these links.
    pub(super) fn forget(&mut self, links: LinkMask) {
        for slot in &mut self.0 {
            if slot.is_some_and(|refusal| links.contains(LinkMask::of(refusal.to.link))) {
                *slot = None;
            }
        }
    }

    /// Returns the pending refusals.
    #[cfg(test)]
    pub(super) fn iter(&self) -> impl Iterator<Item = &Refusal> {
        self.0.iter().flatten()
    }
}

/// The state of a link: the progress of its list. Initially all zero bits.
#[derive(Clone, Debug)]
pub struct List {
    /// When the next value is due.
    limit: RateLimit,
    /// The index of that value.
    next: u16,
    /// Where the search for the next pending single value starts, so that each one has its turn (round robin).
    pub(super) from: u16,
    is_active: bool,
}

impl List {
    pub(crate) const fn new() -> Self {
        Self { limit: RateLimit::NEW, next: 0, from: 0, is_active: false }
    }

    /// Starts or restarts the list (P-10). Returns true if no list was active.
    pub(super) fn begin(&mut self, now: Instant) -> bool {
        self.next = 0;
        self.limit.begin(now);
        !core::mem::replace(&mut self.is_active, true)
    }

    /// Ends the list.
    pub(crate) fn end(&mut self) {
        self.is_active = false;
    }

    /// Whether a list is active.
    pub(super) const fn is_active(&self) -> bool {
        self.is_active
    }

    /// Returns when a list could begin: after the pause that its predecessor has left.
    pub(super) const fn begins_at(&self) -> Instant {
        self.limit.due()
    }

    /// Returns the index of the list's next value.
    pub(super) const fn next(&self) -> u16 {
        self.next
    }

    /// Returns when the list falls behind its share unless the next value is sent; [`Instant::NEVER`] without a list.
    pub(crate) fn late_at(&self) -> Instant {
        if self.is_active { self.limit.due() + MAX_LATENESS } else { Instant::NEVER }
    }

    /// Returns when the list's next value is due; [`Instant::NEVER`] without a list.
    pub(crate) const fn due(&self) -> Instant {
        if self.is_active { self.limit.due() } else { Instant::NEVER }
    }

    /// Records that a value of the list was sent. `count` is the length of the list, `bytes_per_second` the rate of the link; 0
    /// means no limit.
    pub(super) fn advance(&mut self, now: Instant, count: u16, bytes_per_second: u32) {
        self.next = self.next.saturating_add(1);
        self.is_active = self.next < count;
        self.limit.spend(now, COST, bytes_per_second);
    }
}
