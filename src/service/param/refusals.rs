//! Pending PARAM_ERRORs (P-30).

use crate::dialect::{MavParamError, ParamError};
use crate::link::Outbox;
use crate::message::Text;
use crate::types::{LinkId, LinkMask, Peer};

/// Number of refusals that can be pending on all links together.
const SLOTS: usize = 4;

/// A pending refusal.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParamRefusal {
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
pub(super) struct ParamRefusals([Option<ParamRefusal>; SLOTS]);

impl ParamRefusals {
    pub(super) const NEW: Self = Self([None; SLOTS]);

    /// Returns the links on which refusals are pending.
    pub(super) fn links(&self) -> LinkMask {
        self.0.iter().flatten().fold(LinkMask::NONE, |links, refusal| links.with(LinkMask::of(refusal.to.link)))
    }

    /// Returns the slot for another refusal on a link: a free one, or if the link has none yet, the last one, which then belongs to
    /// another link.
    fn slot_for(&mut self, link: LinkId) -> Option<&mut Option<ParamRefusal>> {
        let may_evict = !self.links().contains(link);
        let place = self.0.iter().position(Option::is_none);
        match place {
            Some(place) => self.0.get_mut(place),
            None => self.0.last_mut().filter(|_| may_evict),
        }
    }

    /// Whether there is a slot for another refusal on a link.
    pub(super) fn has_room(&mut self, link: LinkId) -> bool {
        self.slot_for(link).is_some()
    }

    /// Queues a refusal. Returns false if there is no slot for it.
    pub(super) fn push(&mut self, refusal: ParamRefusal) -> bool {
        let slot = self.slot_for(refusal.to.link);
        slot.map(|slot| *slot = Some(refusal)).is_some()
    }

    /// Sends a refusal of the link. Returns false if none is pending.
    pub(super) fn next(&mut self, tx: &mut Outbox) -> bool {
        let link = tx.link();
        for slot in &mut self.0 {
            if let Some(refusal) = slot
                && refusal.to.link == link
            {
                let message = ParamError {
                    param_index: refusal.index,
                    target_system: refusal.to.address.system.wire(),
                    target_component: refusal.to.address.component.wire(),
                    param_id: Text::from_wire(refusal.name),
                    error: refusal.error,
                };
                *slot = None;
                return tx.send(&message);
            }
        }
        false
    }

    /// Drops the refusals of these links.
    pub(super) fn forget(&mut self, links: LinkMask) {
        for slot in &mut self.0 {
            if slot.is_some_and(|refusal| links.contains(refusal.to.link)) {
                *slot = None;
            }
        }
    }

    /// Returns the pending refusals.
    #[cfg(test)]
    pub(super) fn iter(&self) -> impl Iterator<Item = &ParamRefusal> {
        self.0.iter().flatten()
    }
}
