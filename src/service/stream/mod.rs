//! Messages on request and streams: what the vehicle tells of itself, how often, on which link.
//!
//! Implements the message requests of <https://mavlink.io/en/services/command.html> (MAV_CMD_REQUEST_MESSAGE,
//! MAV_CMD_SET_MESSAGE_INTERVAL, MAV_CMD_GET_MESSAGE_INTERVAL), MESSAGE_INTERVAL, and REQUEST_DATA_STREAM for the ground
//! stations that still send it: rules. The vehicle declares what it can fill, as a list of [`Stream`]s, and fills
//! it when asked; each link keeps for each of them the interval and when it is due. Nothing is kept as bytes, so a message
//! says how things are when it goes out (D-3). A vehicle with an empty list does not link this.

mod requests;
mod schedule;
#[cfg(test)]
mod tests;

pub(crate) use requests::{Fixed, fill, next_asked, next_interval, on_command, on_frame};
pub(crate) use schedule::{Slot, Streams};

use crate::dialect::{
    AutopilotVersion, AvailableModes, AvailableModesMonitor, Heartbeat, MavDataStream, MessageInterval, MissionCurrent,
    ProtocolVersion,
};
use crate::link::{LinkId, Outbox};
use crate::message::Message;
use crate::time::{Duration, Instant};

/// The most messages that a vehicle can declare.
pub const MAX_STREAMS: usize = 32;

/// Bounds of an interval (µs): what is asked for beyond them is moved to them.
const MIN_INTERVAL: u32 = 1_000;
const MAX_INTERVAL: u32 = 60_000_000;

/// Which of the vehicle's default intervals hold on a link, until somebody asks for others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StreamProfile {
    /// Those of [`Stream::every`]: for a telemetry radio.
    Radio,
    /// Those of [`Stream::onboard`]: for a companion computer, or USB.
    Onboard,
    /// Nothing is streamed until somebody asks for it.
    Off,
}

/// A message that the vehicle can fill, and how often it does so unasked: a row of
/// [`Telemetry::STREAMS`](crate::Telemetry::STREAMS).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stream {
    id: u32,
    /// Default intervals (µs); 0 is off.
    radio: u32,
    onboard: u32,
    /// [`MavDataStream::ALL`] is none.
    group: MavDataStream,
}

impl Stream {
    /// The message `M`, sent only when somebody asks.
    pub const fn of<M: Message>() -> Self {
        Self { id: M::ID, radio: 0, onboard: 0, group: MavDataStream::ALL }
    }

    /// The same, unasked too: every `interval`, on every link with a profile. 1 ms to 60 s; what is beyond is moved there.
    #[must_use]
    pub const fn every(mut self, interval: Duration) -> Self {
        self.radio = clamped(interval.as_micros());
        self.onboard = self.radio;
        self
    }

    /// The same, every `interval` on links with [`StreamProfile::Onboard`].
    #[must_use]
    pub const fn onboard(mut self, interval: Duration) -> Self {
        self.onboard = clamped(interval.as_micros());
        self
    }

    /// The same, as a part of a group of REQUEST_DATA_STREAM. A request for [`MavDataStream::ALL`] is one for all that
    /// are in a group.
    #[must_use]
    pub const fn in_group(mut self, group: MavDataStream) -> Self {
        self.group = group;
        self
    }

    /// The message's id.
    pub const fn id(&self) -> u32 {
        self.id
    }

    /// The default interval (µs); 0 is off.
    const fn default_interval(&self, profile: StreamProfile) -> u32 {
        match profile {
            StreamProfile::Radio => self.radio,
            StreamProfile::Onboard => self.onboard,
            StreamProfile::Off => 0,
        }
    }

    /// Which row of the table `M` has.
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        clippy::as_conversions,
        reason = "const-evaluated; a table has at most 32 rows"
    )]
    pub(crate) const fn number_of<M: Message>(table: &[Self]) -> u8 {
        let mut number = 0;
        while number < table.len() && table[number].id != M::ID {
            number += 1;
        }
        assert!(number < table.len(), "the vehicle does not declare this message in `STREAMS`");
        number as u8
    }

    /// At most [`MAX_STREAMS`], each message once, and none that the stack sends itself, those about modes only where the vehicle
    /// declares modes.
    #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
    pub(crate) const fn check(table: &[Self], has_modes: bool) {
        assert!(table.len() <= MAX_STREAMS, "a vehicle declares at most 32 messages");
        let own = [Heartbeat::ID, MissionCurrent::ID, AutopilotVersion::ID, ProtocolVersion::ID, MessageInterval::ID];
        let mut i = 0;
        while i < table.len() {
            let is_of_modes = AvailableModes::ID <= table[i].id && table[i].id <= AvailableModesMonitor::ID;
            assert!(!(has_modes && is_of_modes), "the stack sends this message by itself: see `MODES`");
            let mut j = 0;
            while j < own.len() {
                assert!(table[i].id != own[j], "the stack sends this message by itself: leave it out of `STREAMS`");
                j += 1;
            }
            j = 0;
            while j < i {
                assert!(table[i].id != table[j].id, "a message stands once in `STREAMS`: leave the other out");
                j += 1;
            }
            i += 1;
        }
    }
}

/// An interval within the bounds. Not inlined: a comparison of 64 bits in each of six places.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; what is cast was bounded")]
#[inline(never)]
const fn clamped(micros: u64) -> u32 {
    if micros < MIN_INTERVAL as u64 {
        MIN_INTERVAL
    } else if micros > MAX_INTERVAL as u64 {
        MAX_INTERVAL
    } else {
        micros as u32
    }
}

/// Where a vehicle puts the message that it was asked for; see [`Telemetry::fill`](crate::Telemetry::fill).
#[derive(Debug)]
pub struct Fill<'a> {
    now: Instant,
    id: u32,
    index: u16,
    outbox: &'a mut Outbox,
    /// Somebody asks whether there is such a message now; it is not sent yet.
    is_probe: bool,
}

impl<'a> Fill<'a> {
    pub(crate) fn new(now: Instant, id: u32, index: u16, outbox: &'a mut Outbox, is_probe: bool) -> Self {
        Self { now, id, index, outbox, is_probe }
    }

    /// When it is asked: for the time fields.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// Parameter 2 of MAV_CMD_REQUEST_MESSAGE, whose meaning is the message's own: which battery, for example. 0 in a
    /// stream.
    pub fn index(&self) -> u16 {
        self.index
    }

    /// The link that it goes to.
    pub fn link(&self) -> LinkId {
        self.outbox.link()
    }

    /// Hands over the message. False when it cannot go out: it is not the one that was asked for, the link sends MAVLink
    /// 1, which has no such id (S-10), or it is HIGH_LATENCY2, which the stack sends by itself where it belongs (L-2).
    #[must_use]
    pub fn put<M: Message>(self, message: &M) -> bool {
        if M::ID != self.id || !self.outbox.takes(M::ID) {
            return false;
        }
        self.is_probe || self.outbox.send(message)
    }
}
