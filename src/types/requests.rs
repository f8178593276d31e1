//! What the vehicle's hooks ask for: messages and commands to send, and mission items that were reached.

use super::link::{LinkId, LinkMask, Peer};
use crate::dialect::MavType;
use crate::list::take_first;
use crate::log::increment;
use crate::message::Address;
use heapless::Vec;

/// The number of messages and commands that a link has room for.
pub(crate) const PENDING: usize = 8;

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

/// The component to which a command of the vehicle is sent; see [`Context::send_command`](crate::Context::send_command).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Recipient {
    /// A component, on a normal link on which it is alive.
    Address(Address),
    /// A component of our system with this HEARTBEAT.type, such as [`MavType::GIMBAL`]: the first of the peer table that is
    /// alive.
    Type(MavType),
}

impl From<Address> for Recipient {
    fn from(address: Address) -> Self {
        Self::Address(address)
    }
}

impl From<Peer> for Recipient {
    fn from(peer: Peer) -> Self {
        Self::Address(peer.address)
    }
}

/// A request of a hook that waits for room on a link, or for a free slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pending {
    /// The vehicle is to fill this message. `target` is 0/0 unless it is for one peer.
    Message { id: MessageId, index: u16, target: Address },
    /// The vehicle is to make the command of this token.
    Command { to: Recipient, token: u16 },
    /// The command of this token is to be cancelled.
    Cancel { token: u16 },
}

const _: () = assert!(size_of::<Pending>() == 8, "the memory of a link's queue is documented");

/// The id of a message, in three bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MessageId([u8; 3]);

impl MessageId {
    pub(crate) const fn new(id: u32) -> Self {
        let [a, b, c, _] = id.to_le_bytes();
        Self([a, b, c])
    }

    pub(crate) const fn get(self) -> u32 {
        let [a, b, c] = self.0;
        u32::from_le_bytes([a, b, c, 0])
    }
}

/// What is pending on a link, in the order in which it was requested. The queue of the first link also has the commands.
#[derive(Clone, Debug)]
pub struct LinkQueue {
    pending: Vec<Pending, PENDING, u8>,
    refused: u32,
}

impl LinkQueue {
    const EMPTY: Self = Self { pending: Vec::new(), refused: 0 };

    fn push(&mut self, request: Pending) -> bool {
        let is_pending = self.pending.contains(&request) || self.pending.push(request).is_ok();
        if !is_pending {
            increment(&mut self.refused);
        }
        is_pending
    }
}

/// Requests of the hooks that no service has taken up yet. Initially all zero bits. `Q`: a queue for each link, or none if
/// neither `messages` nor `command_client` is declared; each link has its own, so that a stalled one does not block the
/// others. The logic works on the unsized form.
#[derive(Debug)]
pub struct Requests<Q: ?Sized = [LinkQueue]> {
    /// A bit for each of the vehicle's streams: set if it must be sent once on every normal link.
    pub(crate) announced: u32,
    /// Mission items that were reached.
    pub(crate) reached: Vec<u16, 4, u8>,
    /// Whether the next poll is to take up commands.
    has_command: bool,
    queues: Q,
}

impl<const LINKS: usize> Requests<[LinkQueue; LINKS]> {
    pub(crate) const NONE: Self =
        Self { announced: 0, reached: Vec::new(), has_command: false, queues: [const { LinkQueue::EMPTY }; LINKS] };
}

impl Requests {
    /// Whether a request is pending for the next poll.
    pub(crate) fn is_due(&self) -> bool {
        self.announced != 0 || !self.reached.is_empty() || self.has_command
    }

    /// Ends a poll. The remaining requests are for services that are not declared; `next_deadline` must not wait for them.
    pub(crate) fn end_poll(&mut self) {
        self.announced = 0;
        self.reached.clear();
        if self.has_command {
            while self.take_command(|_| true).is_some() {}
            self.has_command = false;
        }
    }

    /// Sets whether the next poll is to take up the commands that are pending, if there are any.
    pub(crate) fn set_due(&mut self, is_due: bool) {
        let is_command = |request: &Pending| !matches!(request, Pending::Message { .. });
        self.has_command = is_due && self.queues.first().is_some_and(|queue| queue.pending.iter().any(is_command));
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
        let message = Pending::Message { id: MessageId::new(id), index, target };
        let mut is_pending = false;
        for (link, queue) in (0..u8::MAX).map(|link| LinkMask::of(LinkId(link))).zip(&mut self.queues) {
            if links.contains(link) && normal.contains(link) {
                is_pending |= queue.push(message);
            }
        }
        is_pending
    }

    /// Queues a command, or its cancellation. Returns false if there is no room.
    pub(crate) fn command(&mut self, request: Pending) -> bool {
        self.has_command = true;
        self.queues.first_mut().is_some_and(|queue| queue.push(request))
    }

    /// Returns whether a message is pending on a link.
    pub(crate) fn has_message(&self, link: LinkId) -> bool {
        let queue = self.queues.get(usize::from(link.0));
        queue.is_some_and(|queue| queue.pending.iter().any(|pending| matches!(pending, Pending::Message { .. })))
    }

    /// Takes the message that has been pending on a link for the longest time.
    pub(crate) fn take_message(&mut self, link: LinkId) -> Option<Pending> {
        let queue = self.queues.get_mut(usize::from(link.0))?;
        take_first(&mut queue.pending, |pending| matches!(pending, Pending::Message { .. }))
    }

    /// Takes the first command or cancellation for which `test` returns true.
    pub(crate) fn take_command(&mut self, mut test: impl FnMut(&Pending) -> bool) -> Option<Pending> {
        let queue = self.queues.first_mut()?;
        take_first(&mut queue.pending, |pending| !matches!(pending, Pending::Message { .. }) && test(pending))
    }

    /// Returns the number of messages and commands that a link had no room for.
    pub(crate) fn refused(&self, link: LinkId) -> u32 {
        self.queues.get(usize::from(link.0)).map_or(0, |queue| queue.refused)
    }
}
