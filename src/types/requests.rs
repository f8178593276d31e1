//! What the vehicle's hooks ask for: messages to announce or to send, mission items that were reached.

use super::link::{LinkId, LinkMask, Peer};
use crate::list::take_first;
use crate::log::increment;
use crate::message::Address;
use heapless::Vec;

/// The number of messages that a link has room for.
const MESSAGES: usize = 8;

/// Where a message of the vehicle is sent; see [`Context::send`](crate::Context::send).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Destination {
    /// On every normal link.
    All,
    /// On one link.
    Link(LinkId),
    /// To one peer, on its link. [`Fill::target`](crate::Fill::target) is its address.
    Peer(Peer),
}

impl From<LinkId> for Destination {
    fn from(link: LinkId) -> Self {
        Self::Link(link)
    }
}

impl From<Peer> for Destination {
    fn from(peer: Peer) -> Self {
        Self::Peer(peer)
    }
}

/// A message that the vehicle is to fill when the link has room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Pending {
    pub(crate) id: u32,
    pub(crate) index: u16,
    /// 0/0 unless it is for one peer.
    pub(crate) target: Address,
}

/// The messages that are pending on a link, in the order in which they were requested.
#[derive(Clone, Debug)]
pub struct LinkQueue {
    messages: Vec<Pending, MESSAGES, u8>,
    refused: u32,
}

impl LinkQueue {
    const EMPTY: Self = Self { messages: Vec::new(), refused: 0 };
}

/// Requests of the hooks that no service has taken up yet. Initially all zero bits. `Q`: a queue for each link, or none if
/// `messages` is not declared; each link has its own, so that a stalled one does not block the others. The logic works on
/// the unsized form.
#[derive(Debug)]
pub struct Requests<Q: ?Sized = [LinkQueue]> {
    /// A bit for each of the vehicle's streams: set if it must be sent once on every normal link.
    pub(crate) announced: u32,
    /// Mission items that were reached.
    pub(crate) reached: Vec<u16, 4, u8>,
    queues: Q,
}

impl<const LINKS: usize> Requests<[LinkQueue; LINKS]> {
    pub(crate) const NONE: Self =
        Self { announced: 0, reached: Vec::new(), queues: [const { LinkQueue::EMPTY }; LINKS] };
}

impl Requests {
    /// Whether a request is pending for the next poll.
    pub(crate) fn is_due(&self) -> bool {
        self.announced != 0 || !self.reached.is_empty()
    }

    /// Ends a poll. The remaining requests are for services that are not declared; `next_deadline` must not wait for them.
    pub(crate) fn end_poll(&mut self) {
        self.announced = 0;
        self.reached.clear();
    }

    /// Queues a message on the links of `to` that are `normal`. A message that is pending there already is not queued
    /// again. Returns false if no link has room.
    #[inline(never)]
    pub(crate) fn send(&mut self, normal: LinkMask, id: u32, to: Destination, index: u16) -> bool {
        let (links, target) = match to {
            Destination::All => (LinkMask::ALL, Address::new(0, 0)),
            Destination::Link(link) => (LinkMask::of(link), Address::new(0, 0)),
            Destination::Peer(peer) => (LinkMask::of(peer.link), peer.address),
        };
        let message = Pending { id, index, target };
        let mut is_pending = false;
        for (link, queue) in (0..).map(|link| LinkMask::of(LinkId(link))).zip(&mut self.queues) {
            if !links.contains(link) || !normal.contains(link) {
                continue;
            }
            if queue.messages.contains(&message) || queue.messages.push(message).is_ok() {
                is_pending = true;
            } else {
                increment(&mut queue.refused);
            }
        }
        is_pending
    }

    /// Returns whether a message is pending on a link.
    pub(crate) fn is_pending(&self, link: LinkId) -> bool {
        self.queues.get(usize::from(link.0)).is_some_and(|queue| !queue.messages.is_empty())
    }

    /// Takes the message that has been pending on a link for the longest time.
    pub(crate) fn take(&mut self, link: LinkId) -> Option<Pending> {
        let queue = self.queues.get_mut(usize::from(link.0))?;
        take_first(&mut queue.messages, |_| true)
    }

    /// Returns the number of messages that a link had no room for.
    pub(crate) fn refused(&self, link: LinkId) -> u32 {
        self.queues.get(usize::from(link.0)).map_or(0, |queue| queue.refused)
    }
}
