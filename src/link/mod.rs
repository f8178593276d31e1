//! Links: the stack's state for each transport.
//!
//! A link is a decoder, one outbound frame, a byte budget and counters. It knows no service: the services have their
//! state on a link themselves. Links share nothing, so a stalled link does not delay the others. [`LinkConfig`] configures a link.

mod bucket;
mod outbox;
mod shares;

use core::num::{Saturating, Wrapping};

pub(crate) use bucket::{Bucket, Pace};
pub(crate) use outbox::Outbox;
pub(crate) use shares::{Shares, Traffic};

use crate::frame::{Decoder, Version};
#[cfg(feature = "defmt")]
use crate::log::DropLog;
use crate::log::increment;
use crate::message::{ComponentId, Message};
use crate::time::{Duration, Instant};
use crate::types::{Config, Firmware, LinkClass, LinkConfig, LinkFacts, LinkId, Progress, TxVersion};

counters! {
    /// Counters of sent and dropped frames on a link. They wrap. [`RxCounters`](crate::frame::RxCounters) counts the
    /// frames that the decoder dropped.
    LinkCounters {
        /// Frames sent.
        count tx_frames,
        /// Bytes handed to the transport.
        count tx_bytes,
        /// Frames for other systems or components; they are not handled.
        drop not_ours,
        /// Frames with our own address as source: an echo, or another vehicle with the same address (R-8, H-14). Three of
        /// them that are not echoes of the last 256 frames of any link are a [conflict](crate::PeerEvent::AddressConflict).
        drop own_address,
        /// Frames with an unknown id; they are not handled (S-12).
        drop unknown,
        /// Frames of senders for which the peer table had no room (H-12).
        drop no_peer_slot,
        /// Senders that evicted a peer from the full peer table (H-12).
        drop evicted_peers,
        /// Commands that were not executed, and requests for plans that are not served, because there was no room for their
        /// answer; the sender retransmits them. See also
        /// [`PlanCounters::no_answer_slot`](crate::plan::PlanCounters::no_answer_slot).
        drop no_answer_slot,
        /// Messages that are not allowed on a link of this class (L-4), or not to a broadcast address (M-10). If the stack
        /// does not declare `signing`, also SETUP_SIGNING (G-11), and all frames on a link that is not open to unsigned
        /// ones.
        drop out_of_place,
        /// Frames addressed to our system that neither the stack nor the [vehicle](crate::Vehicle::message) handles, setpoints for
        /// example if it does not declare `setpoints`. Broadcasts are not counted here, because no component has to handle them.
        drop unhandled,
        /// Errors of the transport while reading, including overruns (S-20).
        drop read_errors,
        /// Errors of the transport while writing.
        drop write_errors,
    }
}

/// Why a transport failed in [`Stack::poll_link`](crate::Stack::poll_link). The link stays usable: the checksum detects
/// lost bytes, and bytes that could not be sent are sent later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LinkError<E> {
    /// Reading failed, for example by a UART overrun (S-20).
    Read(E),
    /// Writing failed.
    Write(E),
    /// The other side closed the connection. Call [`Stack::restart_link`](crate::Stack::restart_link) when it is open
    /// again.
    Closed,
    /// The stack has no link with this number.
    NoSuchLink,
    /// The stack was not [begun](crate::Stack::begin): it takes and sends nothing.
    NotBegun,
}

impl<E: core::fmt::Debug> core::fmt::Display for LinkError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Read(error) => write!(f, "reading failed: {error:?}"),
            Self::Write(error) => write!(f, "writing failed: {error:?}"),
            Self::Closed => f.write_str("the transport was closed: restart the link when it is open again"),
            Self::NotBegun => f.write_str("the stack was not started: call `begin` first"),
            Self::NoSuchLink => f.write_str("the stack has no link with that number: they count from 0"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for LinkError<E> {}

/// The stack's state of a link.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    pub(crate) decoder: Decoder,
    pub(crate) port: Port,
}

/// A link without its decoder, so that a received frame can stay in the decoder's buffer while it is handled.
#[derive(Clone, Debug)]
pub struct Port {
    pub(crate) id: LinkId,
    pub(crate) config: LinkConfig,
    pub(crate) outbox: Outbox,
    pub(crate) bucket: Bucket,
    pub(crate) shares: Shares,
    pub(crate) counters: LinkCounters,
    /// The number of frames with our address that are not echoes. At [`CONFLICT`](Self::CONFLICT) the vehicle reports a
    /// conflict (H-14).
    strangers: Saturating<u8>,
    /// Whether a frame of a sender that the link's policy trusts was accepted since the link was restarted.
    pub(crate) accepted: Accepted,
    /// Facts that the services on the link share.
    pub(crate) facts: LinkFacts,
    /// The state of the transport when it was last asked.
    pub(crate) transport: Transport,
    /// When a transport that has failed is asked again.
    pub(crate) retry_at: Instant,
    /// Until when frames wait for a HEARTBEAT, which is the first one on a link that opens (H-17): [`Instant::ZERO`] if they
    /// do not, [`Instant::NEVER`] until the link is asked for a frame.
    held_until: Instant,
    /// Drop counters, as last logged.
    #[cfg(feature = "defmt")]
    pub(crate) drops: DropLog,
}

impl Port {
    /// Returns the id of the link.
    pub const fn id(&self) -> LinkId {
        self.id
    }

    /// Returns the class of the link.
    pub const fn class(&self) -> LinkClass {
        self.config.class
    }

    /// Whether the link can send a message with this id: the link's class allows it, and MAVLink 1 has no ids above 255 (L-4, S-10).
    pub fn takes(&self, id: u32) -> bool {
        self.outbox.takes(id)
    }

    /// Puts a message into the link's outbox, which is empty while a service is asked to send. Returns false if the link cannot
    /// send it.
    pub fn send<M: Message>(&mut self, message: &M) -> bool {
        self.outbox.send(message)
    }

    /// The same, as another component of the firmware, which a [`Part::Component`](crate::service::Part) is.
    pub fn send_from<F: Firmware, M: Message>(&mut self, component: ComponentId, message: &M) -> bool {
        self.outbox.send_from::<F, M>(Some(component), message)
    }
}

/// Whether a link has accepted a frame since it was restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Accepted {
    Nothing,
    /// It has, but not since it was last asked.
    Before,
    /// It has since then.
    Again,
}

/// Whether a transport takes bytes, as far as that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transport {
    /// It was not asked: an interrupt or DMA takes the bytes.
    Unknown,
    /// It accepts bytes.
    Ready,
    /// It accepts no bytes for now: backpressure.
    Full,
}

impl Link {
    /// A link before it is [configured](Self::configure): all zero bits, so it takes no flash and an array of links can
    /// be made in a `const`.
    pub(crate) const VACANT: Self = Self {
        decoder: Decoder::VACANT,
        port: Port {
            id: LinkId(0),
            config: LinkConfig::VACANT,
            outbox: Outbox::VACANT,
            bucket: Bucket::VACANT,
            shares: Shares::NEW,
            counters: LinkCounters::ZERO,
            strangers: Saturating(0),
            accepted: Accepted::Nothing,
            facts: LinkFacts::NONE,
            transport: Transport::Unknown,
            retry_at: Instant::ZERO,
            held_until: Instant::ZERO,
            #[cfg(feature = "defmt")]
            drops: DropLog::NEW,
        },
    };

    pub(crate) const fn configure(&mut self, id: LinkId, config: LinkConfig, stack: &Config) {
        let version = match config.version {
            TxVersion::V2 => Version::V2,
            TxVersion::Auto | TxVersion::V1 => Version::V1,
        };
        self.decoder.configure(stack.stale_after, stack.accepts_component_0);
        self.port.id = id;
        self.port.config = config;
        self.port.outbox.configure(id, stack.address.get(), version);
        self.port.outbox.set_class(config.class);
        self.port.bucket.configure(config.bytes_per_second);
        self.port.hold();
    }
}

impl Port {
    /// This many frames with our address that cannot be echoes prove another vehicle.
    const CONFLICT: u8 = 3;

    /// How soon a transport that has failed is asked again.
    const RETRY: Duration = Duration::from_millis(100);

    /// Has frames wait for a HEARTBEAT: the link opens (H-17). High-latency links have none.
    pub(crate) const fn hold(&mut self) {
        if !self.config.class.is_high_latency() {
            self.held_until = Instant::NEVER;
        }
    }

    /// Frames wait no longer: a HEARTBEAT is sent, or has not come.
    pub(crate) const fn release(&mut self) {
        self.held_until = Instant::ZERO;
    }

    /// Has frames wait for a HEARTBEAT without a bound, or no longer.
    pub(crate) fn hold_without_bound(&mut self, holds: bool) {
        /// No clock reaches it, and it differs from [`Instant::NEVER`], which is bounded later.
        const UNBOUNDED: Instant = Instant::from_micros(u64::MAX - 1);
        if holds {
            self.held_until = UNBOUNDED;
        } else if self.held_until == UNBOUNDED {
            self.release();
        }
    }

    /// Whether frames wait for a HEARTBEAT.
    pub(crate) fn is_held(&self) -> bool {
        self.held_until != Instant::ZERO
    }

    /// Whether the link was not asked for a frame since it opened: its transport may not be ready yet.
    pub(crate) fn is_new(&self) -> bool {
        self.held_until == Instant::NEVER
    }

    /// Returns until when frames wait: at most `most` from when the link was first asked for a frame.
    pub(crate) fn bound_hold(&mut self, now: Instant, most: Duration) -> Instant {
        if self.is_new() {
            self.held_until = now + most;
        }
        self.held_until
    }

    /// Returns until when frames wait; [`Instant::NEVER`] until it is bounded.
    pub(crate) const fn held_until(&self) -> Instant {
        self.held_until
    }

    /// Whether the link has had something to send for ten seconds and has taken no byte, as of the last poll: its peers get
    /// nothing that others wait for.
    pub(crate) const fn is_stalled(&self) -> bool {
        self.facts.progress.is_stalled
    }

    /// Whether the link [is stalled](Self::is_stalled) from now on. Called in each poll.
    pub(crate) fn has_stalled(&mut self, now: Instant) -> bool {
        /// Ten seconds.
        const STALL: Wrapping<u8> = Wrapping(39);
        let [low, high, ..] = self.counters.tx_bytes.to_le_bytes();
        let sent = u16::from_le_bytes([low, high]);
        let [_, at, ..] = now.coarse().to_le_bytes();
        let at = Wrapping(at);
        let has_failed = self.retry_at > now;
        let is_waiting = has_failed || self.transport == Transport::Full || !self.outbox.is_empty();
        let is_stuck = is_waiting && sent == self.facts.progress.sent;
        if !is_stuck {
            self.facts.progress = Progress { sent, at, is_stalled: false };
        }
        let is_late = !self.facts.progress.is_stalled && at - self.facts.progress.at >= STALL;
        self.facts.progress.is_stalled |= is_late;
        is_late
    }

    /// Records an error of the transport, which is asked again later.
    pub(crate) fn failed(&mut self, now: Instant) {
        increment(&mut self.counters.write_errors);
        (self.transport, self.retry_at) = (Transport::Ready, now + Self::RETRY);
    }

    /// Records that a frame of this version was received (V-1).
    pub(crate) fn note_version(&mut self, version: Version) {
        if version == Version::V2 && self.config.version == TxVersion::Auto {
            self.outbox.set_version(Version::V2);
        }
    }

    /// Counts a frame with our own address that no link can have sent. Returns true, once, when another vehicle must have
    /// that address (H-14).
    pub(crate) fn count_stranger(&mut self) -> bool {
        if self.strangers.0 >= Self::CONFLICT {
            return false;
        }
        self.strangers += 1;
        self.strangers.0 == Self::CONFLICT
    }
}
