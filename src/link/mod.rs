//! Links: what the stack keeps for each line to the outside.
//!
//! A link is a decoder, one outbound frame, and what its own peers are owed; nothing in it is shared, so a link that
//! stalls holds up no other. What a link *is* stands in its [`LinkConfig`].

mod bucket;
mod outbox;

pub(crate) use bucket::Bucket;
pub(crate) use outbox::Outbox;

use crate::config::Config;
use crate::frame::{Address, Decoder, Version};
#[cfg(feature = "defmt")]
use crate::log::DropLog;
use crate::service::command::Acks;
use crate::service::heartbeat::Schedule;
use crate::service::identity::Owed;
use crate::service::mission::Replies;
use crate::service::param;
#[cfg(feature = "signing")]
use crate::service::signing::{Accept, Answer, LinkSigning};
use crate::service::statustext::TextCursor;
use crate::service::stream::{StreamProfile, Streams};
use crate::time::Instant;

/// A link of a stack: an index into its configuration, 0 first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkId(pub u8);

/// Who sent something, and over which link: where an answer goes (M-11).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Peer {
    /// The sender.
    pub address: Address,
    /// The link it was heard on.
    pub link: LinkId,
}

/// What a link is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LinkClass {
    /// A telemetry radio, a companion computer, USB.
    Normal,
    /// A gimbal, a payload, a camera: like a normal link, but of what is forwarded it gets only what is for a component that
    /// was heard there.
    Private,
    /// A satellite modem, where every byte costs: no heartbeats, and only commands, their answers, and while it is wanted
    /// HIGH_LATENCY2, of a vehicle that has a [`HighLatency`](crate::HighLatency) (L-2 to L-4).
    HighLatency,
}

/// Which version a link sends; it receives both always (V-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TxVersion {
    /// MAVLink 2. For all new designs.
    V2,
    /// MAVLink 1 until the first v2 frame is received, then MAVLink 2 for good (V-1).
    Auto,
    /// MAVLink 1 only: no message above id 255, no extension.
    V1,
}

/// What a link is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkConfig {
    /// What it is for.
    pub class: LinkClass,
    /// Which version it sends.
    pub version: TxVersion,
    /// How fast it is (bytes/s); 0 for a line without a limit. Transfers, texts and streams keep below it on average;
    /// heartbeats and answers go out at once, and are charged.
    pub bytes_per_second: u32,
    /// Which messages it gets unasked, and how often, if it is no high-latency link.
    pub streams: StreamProfile,
    /// Whether frames that come by this link are forwarded, and those of others to it, by a vehicle that
    /// [forwards](crate::Vehicle::forwarding) at all.
    pub forwards: bool,
    /// Whether this link also gets refused frames that it would accept itself; false by default. A frame is refused when
    /// another link did not accept its signature, or required one. It is not forwarded to a link whose
    /// [`accept`](LinkSigning::accept) takes the message unsigned:
    ///
    /// | this link | refused frames that are held back |
    /// |---|---|
    /// | [`Accept::Open`] | all |
    /// | [`Accept::SignedExcept`] | those with a listed message id; all as long as the vehicle has no key |
    /// | [`Accept::Required`] | none |
    /// | [`LinkClass::HighLatency`] | all, even if this is true |
    #[cfg(feature = "signing")]
    pub takes_refused: bool,
    /// Which frames it accepts, and whether it signs.
    #[cfg(feature = "signing")]
    pub signing: LinkSigning,
}

impl LinkConfig {
    /// A normal MAVLink 2 link over a UART of `baud` bit/s: ten bits a byte.
    ///
    /// # Panics
    ///
    /// When `baud` is less than 10: in a `const` a compile error. For a rate that is only known at run time set
    /// [`bytes_per_second`](Self::bytes_per_second).
    pub const fn uart(baud: u32) -> Self {
        assert!(baud >= 10, "a UART has a baud rate; a line without one is `LinkConfig::unlimited()`");
        Self { bytes_per_second: baud / 10, ..Self::unlimited() }
    }

    /// The same over a line that takes whatever it is given, USB for example: whoever carries the bytes away slows it down.
    pub const fn unlimited() -> Self {
        Self {
            class: LinkClass::Normal,
            version: TxVersion::V2,
            bytes_per_second: 0,
            streams: StreamProfile::Radio,
            forwards: true,
            #[cfg(feature = "signing")]
            takes_refused: false,
            #[cfg(feature = "signing")]
            signing: LinkSigning::OPEN,
        }
    }

    /// The same link, with what it does about signatures: [`LinkSigning::OPEN`] at first.
    #[cfg(feature = "signing")]
    #[must_use]
    pub const fn with_signing(mut self, signing: LinkSigning) -> Self {
        self.signing = signing;
        self
    }

    /// The same link, which gets frames that another link refused, or, as by default, does not: see
    /// [`takes_refused`](Self::takes_refused). For a wire whose components all verify signatures themselves.
    #[cfg(feature = "signing")]
    #[must_use]
    pub const fn with_refused_frames(mut self, takes_refused: bool) -> Self {
        self.takes_refused = takes_refused;
        self
    }

    /// Which frames are kept from this link when another one refused them: those that this accepts unsigned.
    #[cfg(feature = "signing")]
    pub(crate) const fn holds_refused(&self) -> Accept {
        match self.class {
            LinkClass::HighLatency => Accept::Open,
            _ if self.takes_refused => Accept::Required,
            // Not what the link accepts while a key is lost (G-18): components behind it go by the configuration.
            _ => self.signing.accept,
        }
    }

    /// The same link, taking part in forwarding, as at first, or not.
    #[must_use]
    pub const fn with_forwarding(mut self, forwards: bool) -> Self {
        self.forwards = forwards;
        self
    }

    /// The same link, of another class.
    #[must_use]
    pub const fn with_class(mut self, class: LinkClass) -> Self {
        self.class = class;
        self
    }

    /// The same link, with another set of default streams.
    #[must_use]
    pub const fn with_streams(mut self, streams: StreamProfile) -> Self {
        self.streams = streams;
        self
    }

    /// The same link, sending another version.
    #[must_use]
    pub const fn with_version(mut self, version: TxVersion) -> Self {
        self.version = version;
        self
    }
}

/// What a link sent, and what it did not take. Numbers wrap. What the decoder dropped is in
/// [`RxCounters`](crate::RxCounters).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct LinkCounters {
    /// Frames sent.
    pub tx_frames: u32,
    /// Bytes handed to the transport.
    pub tx_bytes: u32,
    /// Frames for other systems or components, which are not acted on.
    pub not_ours: u32,
    /// Frames with our own address as sender: an echo, or another vehicle with the same address (R-8, H-14). Three of them that
    /// are not echoes of the last 256 frames of any link are a [conflict](crate::PeerEvent::AddressConflict).
    pub own_address: u32,
    /// Frames whose id is unknown: not acted on (S-12).
    pub unknown: u32,
    /// Frames of peers for whom the peer table had no room (H-12).
    pub no_peer_slot: u32,
    /// Peers that took another one's place in the full peer table (H-12).
    pub evicted_peers: u32,
    /// Commands that were not carried out, and questions about plans that are not served, because their answer had no room;
    /// the sender repeats them. See also [`PlanCounters::no_answer_slot`](crate::PlanCounters::no_answer_slot).
    pub no_answer_slot: u32,
    /// Messages that do not belong on a link of this class (L-4), or to a broadcast address (M-10). Of a vehicle that has no
    /// memory for signing also SETUP_SIGNING (G-11), and all that comes by a link that is not open to frames without a signature.
    pub out_of_place: u32,
    /// Frames addressed to our system that neither the stack nor the [vehicle](crate::Vehicle::message) handles, setpoints for
    /// example. Broadcasts are not counted here, because no component has to handle them.
    pub unhandled: u32,
    /// Errors of the transport while reading, overruns among them (S-20).
    pub read_errors: u32,
    /// Errors of the transport while writing.
    pub write_errors: u32,
}

impl LinkCounters {
    const ZERO: Self = Self {
        tx_frames: 0,
        tx_bytes: 0,
        not_ours: 0,
        own_address: 0,
        unknown: 0,
        no_peer_slot: 0,
        evicted_peers: 0,
        no_answer_slot: 0,
        out_of_place: 0,
        unhandled: 0,
        read_errors: 0,
        write_errors: 0,
    };
}

/// Why a transport failed in [`Stack::poll_link`](crate::Stack::poll_link). The stack goes on: what was lost on the way is found out by the
/// checksum, and what could not be sent is sent later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LinkError<E> {
    /// Reading failed; an overrun of a UART for example (S-20).
    Read(E),
    /// Writing failed.
    Write(E),
    /// The other side closed the line. When it is open again call [`Stack::restart_link`](crate::Stack::restart_link).
    Closed,
    /// The stack has no link of that number.
    NoSuchLink,
}

impl<E: core::fmt::Debug> core::fmt::Display for LinkError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Read(error) => write!(f, "reading failed: {error:?}"),
            Self::Write(error) => write!(f, "writing failed: {error:?}"),
            Self::Closed => f.write_str("the line was closed: restart the link when it is open again"),
            Self::NoSuchLink => f.write_str("the stack has no link of that number: they count from 0"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for LinkError<E> {}

/// All that the stack keeps for one link.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    pub(crate) decoder: Decoder,
    pub(crate) port: Port,
}

/// A link without its decoder, so that a received frame can stay in the decoder's buffer while it is handled.
#[derive(Clone, Debug)]
pub(crate) struct Port {
    pub(crate) id: LinkId,
    pub(crate) config: LinkConfig,
    pub(crate) outbox: Outbox,
    pub(crate) bucket: Bucket,
    /// Of HEARTBEAT; on a high-latency link of HIGH_LATENCY2.
    pub(crate) heartbeat: Schedule,
    pub(crate) acks: Acks,
    pub(crate) owed: Owed,
    pub(crate) plans: Replies,
    /// A bit for each row of the vehicle's modes that is to be told.
    pub(crate) modes: u32,
    pub(crate) params: param::List,
    pub(crate) text: TextCursor,
    pub(crate) streams: Streams,
    pub(crate) counters: LinkCounters,
    /// The pending text about SETUP_SIGNING.
    #[cfg(feature = "signing")]
    pub(crate) setup: Answer,
    /// No hint is sent before this moment to a station that signs with another key.
    #[cfg(feature = "signing")]
    pub(crate) hint_from: Instant,
    /// Number of frames with our address that are not echoes. At [`CONFLICT`](Self::CONFLICT) the vehicle is told
    /// (H-14).
    pub(crate) strangers: u8,
    /// The period in which a refused command was last explained by a text: see `service::command::refusal`.
    pub(crate) refusal: u16,
    /// What the transport said when it was last asked.
    pub(crate) transport: Transport,
    /// Drop counters, as last logged.
    #[cfg(feature = "defmt")]
    pub(crate) drops: DropLog,
}

/// Whether a transport takes bytes, as far as that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transport {
    /// Nobody asked it: the bytes are taken by interrupt or DMA.
    Unknown,
    /// It took what it was offered.
    Ready,
    /// It takes nothing for now.
    Full,
}

impl Link {
    /// A link before it is [configured](Self::configure), so that an array of them can be made in a `const fn`: all zero
    /// bits, which costs no flash.
    pub(crate) const VACANT: Self = Self {
        decoder: Decoder::VACANT,
        port: Port {
            id: LinkId(0),
            config: LinkConfig {
                #[cfg(feature = "signing")]
                signing: LinkSigning { sign_out: false, ..LinkSigning::OPEN },
                ..LinkConfig::unlimited().with_forwarding(false)
            },
            outbox: Outbox::VACANT,
            bucket: Bucket::VACANT,
            heartbeat: Schedule::new(),
            acks: Acks::new(),
            owed: Owed::NONE,
            plans: Replies::new(),
            modes: 0,
            params: param::List::new(),
            text: TextCursor::new(),
            streams: Streams::new(),
            counters: LinkCounters::ZERO,
            #[cfg(feature = "signing")]
            setup: Answer::None,
            #[cfg(feature = "signing")]
            hint_from: Instant::ZERO,
            strangers: 0,
            refusal: 0,
            transport: Transport::Unknown,
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
        if matches!(config.class, LinkClass::HighLatency) {
            // No heartbeats there; until somebody wants it, nothing else in their place (L-3).
            self.port.heartbeat.postpone(Instant::NEVER);
        }
        self.port.bucket.configure(config.bytes_per_second);
    }
}

impl Port {
    /// This many frames with our address, none of which can be an echo, prove another vehicle.
    const CONFLICT: u8 = 3;

    /// Whether a text about SETUP_SIGNING is pending.
    #[cfg_attr(not(feature = "signing"), allow(clippy::unused_self, reason = "nobody ever is"))]
    pub(crate) fn is_told_of_setup(&self) -> bool {
        #[cfg(feature = "signing")]
        return self.setup != Answer::None;
        #[cfg(not(feature = "signing"))]
        false
    }

    /// A frame of version `version` came in (V-1).
    pub(crate) fn heard(&mut self, version: Version) {
        if version == Version::V2 && self.config.version == TxVersion::Auto {
            self.outbox.set_version(Version::V2);
        }
    }

    /// Counts a frame with our own address that no link can have sent. Returns true, once, when another vehicle must have
    /// that address (H-14).
    pub(crate) fn is_conflict(&mut self) -> bool {
        if self.strangers >= Self::CONFLICT {
            return false;
        }
        self.strangers = self.strangers.saturating_add(1);
        self.strangers == Self::CONFLICT
    }
}

/// The most links that a stack can have.
pub const MAX_LINKS: usize = 16;

/// A set of links.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct LinkMask(u16);

impl LinkMask {
    pub(crate) const NONE: Self = Self(0);
    pub(crate) const ALL: Self = Self(u16::MAX);

    /// Only `link`; none when its number is beyond [`MAX_LINKS`].
    #[inline(never)]
    #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; u8 to u32")]
    pub(crate) const fn of(link: LinkId) -> Self {
        match 1u16.checked_shl(link.0 as u32) {
            Some(bit) => Self(bit),
            None => Self::NONE,
        }
    }

    pub(crate) const fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(crate) const fn contains(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// How many they are.
    pub(crate) const fn len(self) -> u32 {
        self.0.count_ones()
    }

    pub(crate) const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub(crate) const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }
}
