//! The table of the messages that a vehicle can fill, and their default intervals.

use core::num::Wrapping;

use crate::dialect::{
    AutopilotVersion, AvailableModes, AvailableModesMonitor, Heartbeat, MavDataStream, MessageInterval, MissionCurrent,
    ProtocolVersion,
};
use crate::message::{ComponentId, Message};
use crate::time::Duration;
use crate::types::StreamProfile;

/// The maximum number of messages that a vehicle declares.
pub const MAX_STREAMS: usize = 32;

/// The bounds of an interval (µs). A request beyond them is clamped (Q-4, Q-5).
const MIN_INTERVAL: u32 = 1_000;
pub(super) const MAX_INTERVAL: u32 = 60_000_000;

/// A message that the vehicle can fill, and its default intervals: a row of
/// [`Telemetry::STREAMS`](crate::Telemetry::STREAMS).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stream {
    pub(super) id: u32,
    /// Default intervals (µs); 0 is off.
    radio: u32,
    onboard: u32,
    pub(super) instance: u16,
    /// The group of REQUEST_DATA_STREAM; [`MavDataStream::ALL`] if it is in none.
    pub(super) group: MavDataStream,
    /// The component that sends it; 0 is the autopilot.
    pub(super) component: ComponentId,
}

impl Stream {
    /// Returns the message `M`, which is sent only on request.
    pub const fn of<M: Message>() -> Self {
        Self { id: M::ID, radio: 0, onboard: 0, instance: 0, group: MavDataStream::ALL, component: ComponentId::ALL }
    }

    /// Returns the same message for another instance, such as the second battery: a row of its own, with its own
    /// intervals. `instance` is the index of requests and of [`Fill::index`](crate::Fill::index); 0 by default (Q-3,
    /// Q-4).
    ///
    /// ```
    /// use mavstack::dialect::{BatteryStatus, EscStatus};
    /// use mavstack::{Duration, Stream};
    ///
    /// const STREAMS: &[Stream] = &[
    ///     Stream::of::<BatteryStatus>().every(Duration::from_secs(1)),
    ///     Stream::of::<BatteryStatus>().instance(1).every(Duration::from_secs(5)),
    ///     // ESC_STATUS has four ESCs, and the index of the first.
    ///     Stream::of::<EscStatus>().every(Duration::from_millis(100)),
    ///     Stream::of::<EscStatus>().instance(4).every(Duration::from_millis(100)),
    /// ];
    /// ```
    #[must_use]
    pub const fn instance(mut self, instance: u16) -> Self {
        self.instance = instance;
        self
    }

    /// Returns the same message as one of another [component](crate::Components) of the firmware: it is sent from its
    /// address, and requested and set there (K-10).
    #[must_use]
    pub const fn of_component(mut self, component: ComponentId) -> Self {
        self.component = component;
        self
    }

    /// Returns the same message, streamed by default: every `interval`, on every link with a profile. The interval is
    /// clamped to 1 ms to 60 s.
    #[must_use]
    pub const fn every(mut self, interval: Duration) -> Self {
        self.radio = clamped(interval.as_micros());
        self.onboard = self.radio;
        self
    }

    /// Returns the same message, streamed every `interval` on links with [`StreamProfile::Onboard`].
    #[must_use]
    pub const fn onboard(mut self, interval: Duration) -> Self {
        self.onboard = clamped(interval.as_micros());
        self
    }

    /// Returns the same message as a part of a group of REQUEST_DATA_STREAM (Q-7). A request for [`MavDataStream::ALL`]
    /// applies to all messages that are in a group.
    #[must_use]
    pub const fn in_group(mut self, group: MavDataStream) -> Self {
        self.group = group;
        self
    }

    /// Whether this is a message of the component; 0 is the autopilot.
    pub(super) const fn is_of(&self, component: Option<ComponentId>) -> bool {
        match component {
            Some(component) => self.component.wire() == component.wire(),
            None => true,
        }
    }

    /// Returns the id of the message.
    pub const fn id(&self) -> u32 {
        self.id
    }

    /// Returns the default interval (µs); 0 is off.
    pub(super) const fn default_interval(&self, profile: StreamProfile) -> u32 {
        match profile {
            StreamProfile::Radio => self.radio,
            StreamProfile::Onboard => self.onboard,
            StreamProfile::Off => 0,
        }
    }

    /// Returns the rows of message `M` in the table: a bit for each.
    pub(crate) const fn rows_of<M: Message>(table: &[Self]) -> u32 {
        let rows = Rows::of(table, None, M::ID, 0);
        assert!(!rows.is_empty(), "the vehicle does not declare this message in `STREAMS`");
        rows.0
    }

    /// Whether it is a row of a message: of one component, or of all of them if `of` is `None`; and of one instance, or
    /// of all of them if `index` is 0.
    pub(super) const fn is(&self, of: Option<ComponentId>, id: u32, index: u16) -> bool {
        self.id == id && (index == 0 || self.instance == index) && self.is_of(of)
    }

    /// Checks a table: at most [`MAX_STREAMS`] rows, each instance of a message once, and none that the stack sends
    /// itself. The messages about modes are among these if the vehicle declares modes.
    #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
    #[doc(hidden)]
    pub const fn check(table: &[Self], has_modes: bool) {
        assert!(table.len() <= MAX_STREAMS, "a vehicle declares at most 32 messages");
        let mut i = 0;
        while i < table.len() {
            let is_of_modes = AvailableModes::ID <= table[i].id && table[i].id <= AvailableModesMonitor::ID;
            assert!(!(has_modes && is_of_modes), "the stack sends this message by itself: see `MODES`");
            assert!(!is_own(table[i].id), "the stack sends this message by itself: leave it out of `STREAMS`");
            let mut j = 0;
            while j < i {
                let is_twice = table[i].id == table[j].id
                    && table[i].instance == table[j].instance
                    && table[i].component.wire() == table[j].component.wire();
                assert!(!is_twice, "a message is twice in `STREAMS`: remove one of the two, or give it an `instance`");
                j += 1;
            }
            i += 1;
        }
    }
}

/// Whether the stack sends this message by itself.
pub(crate) const fn is_own(id: u32) -> bool {
    matches!(id, Heartbeat::ID | MissionCurrent::ID | AutopilotVersion::ID | ProtocolVersion::ID | MessageInterval::ID)
}

/// A set of rows of a table, a bit for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rows(pub(super) u32);

impl Rows {
    pub(super) const NONE: Self = Self(0);

    /// Returns the rows of a message; see [`Stream::is`].
    pub(super) const fn of(mut table: &[Stream], of: Option<ComponentId>, id: u32, index: u16) -> Self {
        let (mut rows, mut bit) = (0, 1_u32);
        while let [stream, rest @ ..] = table {
            if stream.is(of, id, index) {
                rows |= bit;
            }
            (table, bit) = (rest, bit << 1);
        }
        Self(rows)
    }

    pub(super) const fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(super) const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub(super) const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Returns the set of one row; without rows if there is no such row.
    pub(super) fn row(row: usize) -> Self {
        Self(u32::try_from(row).ok().and_then(|row| 1u32.checked_shl(row)).unwrap_or(0))
    }

    pub(super) const fn len(self) -> u32 {
        self.0.count_ones()
    }

    /// Returns the first row of the set.
    pub(super) fn first(self) -> Option<usize> {
        if self.is_empty() { None } else { usize::try_from(self.0.trailing_zeros()).ok() }
    }

    /// Takes the first row out of the set.
    pub(super) fn take_first(&mut self) -> Option<usize> {
        let first = self.first();
        // Without its lowest bit.
        self.0 &= (Wrapping(self.0) - Wrapping(1)).0;
        first
    }
}

/// Clamps an interval to the bounds.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; the value was bounded")]
pub(super) const fn clamped(micros: u64) -> u32 {
    if micros < MIN_INTERVAL as u64 {
        MIN_INTERVAL
    } else if micros > MAX_INTERVAL as u64 {
        MAX_INTERVAL
    } else {
        micros as u32
    }
}

/// Whether all rows are the autopilot's.
pub(super) const fn are_autopilots(mut table: &[Stream]) -> bool {
    while let [stream, rest @ ..] = table {
        if stream.component.wire() != 0 {
            return false;
        }
        table = rest;
    }
    true
}
