//! Requests of the vehicle's hooks: messages and requests to send, and mission items that were reached (K-7, K-8).

use super::link::{LinkId, LinkMask, Peer};
use crate::dialect::MavType;
use crate::list::take_first;
use crate::log::increment;
use crate::message::Address;
use crate::time::Duration;
use heapless::Vec;

/// The maximum number of messages that are queued for a link, and of requests that wait for a slot.
pub(crate) const MAX_PENDING: usize = 8;

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

/// The component to which a request of the vehicle is sent; see [`Context::send_command`](crate::Context::send_command).
/// It must be alive on a normal link, or be another [component](crate::Components) of this firmware, which takes commands only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Recipient {
    /// A component, first on this link if it is alive there, then on others.
    Peer(Peer),
    /// Another component of this firmware, or one on the links: first on the link on which it has answered last, or else on the one
    /// on which it was heard first. Component 0 is every component of the system on the links.
    Address(Address),
    /// A component of our system with this HEARTBEAT.type, such as [`MavType::GIMBAL`]: another one of this firmware, or else one on
    /// the links.
    Type(MavType),
}

impl From<Address> for Recipient {
    fn from(address: Address) -> Self {
        Self::Address(address)
    }
}

impl From<Peer> for Recipient {
    fn from(peer: Peer) -> Self {
        Self::Peer(peer)
    }
}

/// A request of a hook, until a link sends it or a slot takes it up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pending {
    /// Send this message, which the vehicle fills. `target` is 0/0 unless it is for one peer.
    Message { id: MessageId, index: u16, target: Address },
    /// Send the command of this token, which the vehicle makes.
    Command { to: Recipient, token: u16 },
    /// Read the parameter of this token.
    Param { to: Recipient, token: u16, is_ext: bool },
    /// Cancel the commands of this token.
    Cancel { token: u16 },
}

const _: () = assert!(size_of::<Pending>() <= 10, "the memory of a queue is documented");

/// A cancellation of commands, by their token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cancellation {
    /// It applies to a command that was still queued, and was removed. The cancellation stays queued.
    OfQueued { token: u16 },
    /// It applies to the commands that have a slot.
    OfStarted { token: u16 },
}

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

/// Pending requests, oldest first.
#[derive(Clone, Debug)]
pub struct RequestQueue {
    pending: Vec<Pending, MAX_PENDING, u8>,
    refused: u32,
}

impl RequestQueue {
    const EMPTY: Self = Self { pending: Vec::new(), refused: 0 };

    /// Queues a request, unless it is pending already. Returns false if there is no room.
    fn push(&mut self, request: Pending) -> bool {
        let is_pending = self.pending.contains(&request) || self.pending.push(request).is_ok();
        if !is_pending {
            increment(&mut self.refused);
        }
        is_pending
    }
}

/// Requests of the hooks that no service has taken up yet. Initially all zero bits. `Q`: a queue of messages for each link
/// if `messages` is declared, then a queue of requests if `command_client` is. Each link has its own, so that a stalled one
/// does not block the others. The logic works on the unsized form.
#[derive(Debug)]
pub struct Requests<Q: ?Sized = [RequestQueue]> {
    /// A bit for each of the vehicle's streams: set if it must be sent once on every normal link.
    pub(crate) announced: u32,
    /// Mission items that were reached.
    pub(crate) reached: Vec<u16, 4, u8>,
    /// The number of queues of messages.
    links: u8,
    /// Whether a hook has requested something to send since the stack has looked.
    pub(crate) is_new: bool,
    /// Whether the next poll is to take up requests to other components.
    is_client_due: bool,
    /// How far the stack's clock is ahead of the firmware's. Here because every context has the requests.
    pub(crate) lead: Duration,
    queues: Q,
}

impl<const N: usize> Requests<[RequestQueue; N]> {
    pub(crate) const NONE: Self = Self {
        announced: 0,
        reached: Vec::new(),
        links: 0,
        is_new: false,
        is_client_due: false,
        lead: Duration::ZERO,
        queues: [const { RequestQueue::EMPTY }; N],
    };
}

impl Requests {
    /// Sets the number of queues of messages.
    pub(crate) fn begin(&mut self, links: u8) {
        self.links = links;
    }

    /// Whether a request is pending for the next poll.
    pub(crate) fn is_due(&self) -> bool {
        self.announced != 0 || !self.reached.is_empty() || self.is_client_due
    }

    /// Drops requests that are for streams or plans of a stack without them: `next_deadline` must not wait for them. Other requests
    /// are from hooks that were called after the poll of the streams or of the plans. The next poll handles them.
    pub(crate) fn end_poll(&mut self, has_streams: bool, has_plans: bool) {
        if !has_streams {
            self.announced = 0;
        }
        if !has_plans {
            self.reached.clear();
        }
    }

    /// Queues a message on the links of `to` that are `normal`. A message that is pending there already is not queued
    /// again. Returns false if no link has room.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) fn send(&mut self, normal: LinkMask, id: u32, to: Destination, index: u16) -> bool {
        let (links, target) = match to {
            Destination::All => (LinkMask::ALL, Address::new(0, 0)),
            Destination::Link(link) => (LinkMask::of(link), Address::new(0, 0)),
            Destination::Peer(peer) => (LinkMask::of(peer.link), peer.address),
        };
        let message = Pending::Message { id: MessageId::new(id), index, target };
        self.is_new = true;
        let mut is_pending = false;
        for (link, queue) in (0..self.links).map(|link| LinkMask::of(LinkId(link))).zip(&mut self.queues) {
            if links.intersects(link) && normal.intersects(link) {
                is_pending |= queue.push(message);
            }
        }
        is_pending
    }

    /// Returns whether a message is pending on a link.
    pub(crate) fn has_message(&self, link: LinkId) -> bool {
        self.queue(link).is_some_and(|queue| !queue.pending.is_empty())
    }

    /// Takes the message that has been pending on a link for the longest time.
    pub(crate) fn take_message(&mut self, link: LinkId) -> Option<Pending> {
        let queue = self.queues.get_mut(usize::from(link.0)).filter(|_| link.0 < self.links)?;
        take_first(&mut queue.pending, |_| true)
    }

    fn queue(&self, link: LinkId) -> Option<&RequestQueue> {
        self.queues.get(usize::from(link.0)).filter(|_| link.0 < self.links)
    }

    /// Returns the number of messages that a link had no room for.
    pub(crate) fn refused_on(&self, link: LinkId) -> u32 {
        self.queue(link).map_or(0, |queue| queue.refused)
    }

    fn client_mut(&mut self) -> Option<&mut RequestQueue> {
        self.queues.get_mut(usize::from(self.links))
    }

    /// Queues a request to another component. Returns false if there is no room.
    pub(crate) fn request(&mut self, request: Pending) -> bool {
        let is_pending = self.client_mut().is_some_and(|queue| queue.push(request));
        self.is_client_due |= is_pending;
        self.is_new = true;
        is_pending
    }

    /// Takes the first request that is no cancellation.
    pub(crate) fn take_request(&mut self) -> Option<Pending> {
        take_first(&mut self.client_mut()?.pending, |request| !matches!(request, Pending::Cancel { .. }))
    }

    /// Takes the first command that a cancellation applies to, or the cancellation itself if all commands of its token have slots.
    pub(crate) fn take_cancellation(&mut self) -> Option<Cancellation> {
        let queue = &mut self.client_mut()?.pending;
        let token = queue.iter().find_map(|request| match request {
            Pending::Cancel { token } => Some(*token),
            _ => None,
        })?;
        let is_it = |request: &Pending| match request {
            Pending::Command { token: other, .. } | Pending::Cancel { token: other } => *other == token,
            Pending::Message { .. } | Pending::Param { .. } => false,
        };
        Some(match take_first(queue, is_it)? {
            Pending::Cancel { .. } => Cancellation::OfStarted { token },
            _ => Cancellation::OfQueued { token },
        })
    }

    /// Returns whether a request waits.
    pub(crate) fn has_request(&self) -> bool {
        self.queues.get(usize::from(self.links)).is_some_and(|queue| !queue.pending.is_empty())
    }

    /// Sets whether the next poll is to take up requests to other components.
    pub(crate) fn set_client_due(&mut self, is_due: bool) {
        self.is_client_due = is_due;
    }

    /// Returns the number of requests to other components for which there was no room.
    pub(crate) fn refused_requests(&self) -> u32 {
        self.queues.get(usize::from(self.links)).map_or(0, |queue| queue.refused)
    }
}
