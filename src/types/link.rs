//! The configuration of links: numbers, classes, rates.

use core::num::Wrapping;

#[cfg(feature = "signing")]
use super::signing::{Accept, LinkSigning};
use crate::dialect::{CommandAck, CommandCancel, CommandInt, CommandLong, Heartbeat, HighLatency2};
use crate::message::{Address, Message};
use crate::time::Instant;

/// The number of a link: its index in the stack's configuration, from 0. [`Stack::link`](crate::Stack::link) returns one that is checked
/// by the compiler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkId(pub u8);

impl LinkId {
    /// Inside the firmware: a component that is not reached by any link.
    pub(crate) const NONE: Self = Self(u8::MAX);
}

/// A sender and its link: where an answer is sent (M-11).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Peer {
    /// The address of the sender.
    pub address: Address,
    /// The link on which it was heard.
    pub link: LinkId,
}

/// The class of a link: its purpose (L-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LinkClass {
    /// A telemetry radio, a companion computer, USB.
    Normal,
    /// A gimbal, a payload, a camera. Like a normal link, but a frame is forwarded to it only if it is addressed to a
    /// component that was heard there.
    Private,
    /// A satellite modem, where every byte costs money. No heartbeats are sent there: only commands, their answers, and
    /// HIGH_LATENCY2 while it is wanted, if the stack has [`HighLatency`](crate::high_latency::HighLatency) (L-2 to L-4).
    HighLatency,
}

impl LinkClass {
    /// Whether a message may be sent on a link of this class. On a high-latency link these are commands, their answers
    /// and HIGH_LATENCY2, which is sent nowhere else (L-2, L-4).
    pub(crate) const fn may_send(self, id: u32) -> bool {
        match id {
            HighLatency2::ID => self.is_high_latency(),
            CommandAck::ID | CommandLong::ID | CommandInt::ID | CommandCancel::ID => true,
            _ => !self.is_high_latency(),
        }
    }

    /// Whether a message is handled that was received on a link of this class. On a high-latency link these are
    /// HEARTBEAT, commands and COMMAND_CANCEL (L-4), but no messages about plans (M-13), no sticks (J-5) and no setpoints (J-6).
    pub(crate) const fn handles_message(self, id: u32) -> bool {
        match id {
            Heartbeat::ID | CommandLong::ID | CommandInt::ID | CommandCancel::ID => true,
            _ => !self.is_high_latency(),
        }
    }

    /// Whether this is a high-latency link, where each byte costs money. Heartbeats, transfers, texts and streams are
    /// not sent there, and messages other than commands are not handled (L-4).
    pub const fn is_high_latency(self) -> bool {
        matches!(self, Self::HighLatency)
    }
}

/// The MAVLink version that a link sends. It always receives both (V-2).
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

/// The configuration of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkConfig {
    /// The class of the link.
    pub class: LinkClass,
    /// The MAVLink version that it sends.
    pub version: TxVersion,
    /// The rate of the link (bytes/s); 0 for no limit. Transfers, texts and streams keep below it on average.
    /// Heartbeats and answers are sent at once, and count towards it.
    pub bytes_per_second: u32,
    /// The default streams on this link. A high-latency link has none.
    pub streams: StreamProfile,
    /// The least percentage of its rate that each stream keeps when a RADIO_STATUS tells of a full buffer: 10 by default, from
    /// 1 to 100. A radio for which that is too much can have less; 100 ignores RADIO_STATUS.
    pub least_stream_percent: u8,
    /// Whether the link takes part in forwarding, if the stack declares `forwarding` in [`#[stack]`](macro@crate::Stack):
    /// frames received on it are forwarded, and frames of other links are forwarded to it.
    pub forwards: bool,
    /// Whether components of the vehicle's own system are believed on this link: an answer of a gimbal, the attitude that it
    /// reports, the setpoints of a gimbal manager. False by default, because on a telemetry radio anyone can send in the
    /// name of such a component; true after [`with_class`](Self::with_class) with [`LinkClass::Private`]. Set it for the wire
    /// of a companion computer. A signed frame is believed on every link.
    pub trusts_own_system: bool,
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
    /// Which frames the link accepts, and whether it signs.
    #[cfg(feature = "signing")]
    pub signing: LinkSigning,
}

impl LinkConfig {
    /// The configuration of a link before it is configured: all zero bits.
    pub(crate) const VACANT: Self = Self {
        #[cfg(feature = "signing")]
        signing: LinkSigning { sign_out: false, ..LinkSigning::OPEN },
        ..Self::unlimited().with_forwarding(false).with_least_streams(0)
    };

    /// Returns the configuration of a normal MAVLink 2 link over a UART of `baud` bit/s, with ten bits per byte.
    ///
    /// # Panics
    ///
    /// Panics if `baud` is less than 10. In a `const` this is a compile error. For a rate that is only known at run
    /// time, set [`bytes_per_second`](Self::bytes_per_second).
    pub const fn uart(baud: u32) -> Self {
        assert!(baud >= 10, "a UART has a baud rate; a link without one is `LinkConfig::unlimited()`");
        Self::limited(baud / 10)
    }

    /// Returns the configuration of a normal MAVLink 2 link with a byte rate, such as a station on a network.
    ///
    /// # Panics
    ///
    /// Panics if the rate is 0. In a `const` this is a compile error.
    pub const fn limited(bytes_per_second: u32) -> Self {
        assert!(bytes_per_second > 0, "a limited link has a rate; a link without one is `LinkConfig::unlimited()`");
        Self { bytes_per_second, ..Self::unlimited() }
    }

    /// Returns the configuration of a normal MAVLink 2 link without a byte rate, such as USB, whose transport applies
    /// backpressure.
    pub const fn unlimited() -> Self {
        Self {
            class: LinkClass::Normal,
            version: TxVersion::V2,
            bytes_per_second: 0,
            streams: StreamProfile::Radio,
            least_stream_percent: 10,
            forwards: true,
            trusts_own_system: false,
            #[cfg(feature = "signing")]
            takes_refused: false,
            #[cfg(feature = "signing")]
            signing: LinkSigning::OPEN,
        }
    }

    /// Returns the same link with this policy for signatures. [`LinkSigning::OPEN`] is the default.
    #[cfg(feature = "signing")]
    #[must_use]
    pub const fn with_signing(mut self, signing: LinkSigning) -> Self {
        self.signing = signing;
        self
    }

    /// Returns the same link, which gets frames that another link refused if `takes_refused` is true; by default it
    /// does not. See [`takes_refused`](Self::takes_refused). For a wire whose components all verify signatures
    /// themselves.
    #[cfg(feature = "signing")]
    #[must_use]
    pub const fn with_refused_frames(mut self, takes_refused: bool) -> Self {
        self.takes_refused = takes_refused;
        self
    }

    /// Returns which frames are not forwarded to this link when another link has refused them: those that this link
    /// accepts unsigned.
    #[cfg(feature = "signing")]
    pub(crate) const fn holds_refused(&self) -> Accept {
        match self.class {
            LinkClass::HighLatency => Accept::Open,
            _ if self.takes_refused => Accept::Required,
            // The setting while the key is present (G-18): the components behind the link follow the
            // configuration.
            _ => self.signing.accept,
        }
    }

    /// Returns the same link, which takes part in forwarding or not. By default it does.
    #[must_use]
    pub const fn with_forwarding(mut self, forwards: bool) -> Self {
        self.forwards = forwards;
        self
    }

    /// Returns the same link with another class. On a [`Private`](LinkClass::Private) link, components of the vehicle's own
    /// system are believed: see [`with_own_system`](Self::with_own_system).
    #[must_use]
    pub const fn with_class(mut self, class: LinkClass) -> Self {
        self.class = class;
        self.trusts_own_system = matches!(class, LinkClass::Private);
        self
    }

    /// Returns the same link, on which components of the vehicle's own system are believed or not. See
    /// [`trusts_own_system`](Self::trusts_own_system).
    #[must_use]
    pub const fn with_own_system(mut self, trusts_own_system: bool) -> Self {
        self.trusts_own_system = trusts_own_system;
        self
    }

    /// Returns the same link with other default streams.
    #[must_use]
    pub const fn with_streams(mut self, streams: StreamProfile) -> Self {
        self.streams = streams;
        self
    }

    /// Returns the same link with another [`least_stream_percent`](Self::least_stream_percent).
    #[must_use]
    pub const fn with_least_streams(mut self, percent: u8) -> Self {
        self.least_stream_percent = percent;
        self
    }

    /// Returns the same link with another MAVLink version.
    #[must_use]
    pub const fn with_version(mut self, version: TxVersion) -> Self {
        self.version = version;
        self
    }
}

/// The default intervals of streams on a link. A client may set others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StreamProfile {
    /// The intervals of [`Stream::every`](crate::Stream::every): for a telemetry radio.
    Radio,
    /// The intervals of [`Stream::onboard`](crate::Stream::onboard): for a companion computer, or USB.
    Onboard,
    /// No streams until a client asks for them.
    Off,
}

/// When polls have last seen that a link takes bytes, or has none to send. In few bytes: both are compared with values of the last
/// ten seconds, in each poll.
#[derive(Clone, Debug)]
pub(crate) struct Progress {
    /// The counter of the sent bytes. Not its low byte alone: a transport with a ring of 256 bytes may take as many in each poll.
    pub(crate) sent: u16,
    /// The time, in units of 262.144 ms.
    pub(crate) at: Wrapping<u8>,
    /// It has taken no byte for ten seconds.
    pub(crate) is_stalled: bool,
}

/// Facts that services on one link share, without naming each other.
#[derive(Clone, Debug)]
pub(crate) struct LinkFacts {
    /// A request: the peers on the link are to hear from the vehicle at once, whatever the schedule.
    pub(crate) is_sign_of_life_due: bool,
    /// The number of periods that have begun with a scheduled sign of life. Wraps.
    pub(crate) periods: u8,
    /// Until when a client on the link is busy with a transfer that streams are slowed for (F-11).
    pub(crate) transferring_until: Instant,
    /// Whether the link takes bytes.
    pub(crate) progress: Progress,
}

impl LinkFacts {
    /// All zero bits.
    pub(crate) const NONE: Self = Self {
        is_sign_of_life_due: false,
        periods: 0,
        transferring_until: Instant::ZERO,
        progress: Progress { sent: 0, at: Wrapping(0), is_stalled: false },
    };
}

/// The maximum number of links of a stack.
pub const MAX_LINKS: usize = 16;

/// A set of links.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct LinkMask(u16);

impl LinkMask {
    pub(crate) const NONE: Self = Self(0);
    pub(crate) const ALL: Self = Self(u16::MAX);

    /// Returns the set of only `link`; the empty set if its number is [`MAX_LINKS`] or more.
    // Out of line: it has several callers.
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

    pub(crate) fn contains(self, link: LinkId) -> bool {
        self.intersects(Self::of(link))
    }

    pub(crate) const fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Returns the number of links.
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
