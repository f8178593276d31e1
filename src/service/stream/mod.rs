//! Messages on request and streams: the vehicle's telemetry, with an interval for each message on each link.
//!
//! Implements the message requests of <https://mavlink.io/en/services/command.html> (MAV_CMD_REQUEST_MESSAGE,
//! MAV_CMD_SET_MESSAGE_INTERVAL, MAV_CMD_GET_MESSAGE_INTERVAL), MESSAGE_INTERVAL, and REQUEST_DATA_STREAM for the
//! ground stations that still send it: rules Q-1 to Q-8.
//!
//! The vehicle declares the messages that it can fill as a list of [`Stream`]s, and fills one when asked. Each link has
//! an interval and a due time for each of them. Nothing is kept as bytes, so a message reports the state at the time it
//! is sent (D-3). A stack that does not declare `streams` does not link this.

mod own_messages;
mod requests;
mod schedule;
#[cfg(test)]
mod tests;
mod vehicle;

pub use own_messages::Messages;
pub(crate) use own_messages::id_of;
use requests::fill;
pub use schedule::Slot;
pub use vehicle::Telemetry;

use self::requests::Fixed;
use self::schedule::Streams;
use super::{About, Cx, Handled, Part, Received, Request, Service, Shared, Turn, Verdict, View};
use crate::dialect::{
    AutopilotVersion, AvailableModes, AvailableModesMonitor, Heartbeat, MavDataStream, MessageInterval, MissionCurrent,
    ProtocolVersion,
};
use crate::link::{Outbox, Port};
use crate::message::{Address, ComponentId, Message};
use crate::network::PeerInfo;
use crate::time::{Duration, Instant};
use crate::types::{Context, Firmware, LinkId, PlanMemory, StreamProfile};

/// The maximum number of messages that a vehicle declares.
pub const MAX_STREAMS: usize = 32;

/// Bounds of an interval (µs). A request beyond them is clamped (Q-4, Q-5).
const MIN_INTERVAL: u32 = 1_000;
const MAX_INTERVAL: u32 = 60_000_000;

/// A message that the vehicle can fill, and its default intervals: a row of
/// [`Telemetry::STREAMS`](crate::Telemetry::STREAMS).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stream {
    id: u32,
    /// Default intervals (µs); 0 is off.
    radio: u32,
    onboard: u32,
    instance: u16,
    /// The group of REQUEST_DATA_STREAM; [`MavDataStream::ALL`] if it is in none.
    group: MavDataStream,
    /// The component that sends it; 0 is the autopilot.
    component: ComponentId,
}

impl Stream {
    /// Returns the message `M`, which is sent only on request.
    pub const fn of<M: Message>() -> Self {
        Self { id: M::ID, radio: 0, onboard: 0, instance: 0, group: MavDataStream::ALL, component: ComponentId::ALL }
    }

    /// Returns the same message for another instance, such as the second battery: a row of its own, with its own intervals.
    /// `instance` is the index of requests and of [`Fill::index`]; 0 by default (Q-3, Q-4).
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

    /// Returns the same message as one of another [component](crate::Components) of the firmware: it is sent from its address, and
    /// requested and set there (K-10).
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
    const fn is_of(&self, component: Option<ComponentId>) -> bool {
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
    const fn default_interval(&self, profile: StreamProfile) -> u32 {
        match profile {
            StreamProfile::Radio => self.radio,
            StreamProfile::Onboard => self.onboard,
            StreamProfile::Off => 0,
        }
    }

    /// Returns the rows of message `M` in the table: a bit for each.
    pub(crate) const fn rows_of<M: Message>(table: &[Self]) -> u32 {
        let rows = rows(table, None, M::ID, 0);
        assert!(rows != 0, "the vehicle does not declare this message in `STREAMS`");
        rows
    }

    /// Checks a table: at most [`MAX_STREAMS`] rows, each instance of a message once, and none that the stack sends itself.
    /// The messages about modes are among these if the vehicle declares modes.
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

/// Returns the rows of a message in a table, a bit for each: of one component or of all of them, and of one instance, or of all of
/// them if `index` is 0.
pub(crate) const fn rows(mut table: &[Stream], of: Option<ComponentId>, id: u32, index: u16) -> u32 {
    let (mut rows, mut bit) = (0u32, 1u32);
    while let [stream, rest @ ..] = table {
        if stream.id == id && (index == 0 || stream.instance == index) && stream.is_of(of) {
            rows |= bit;
        }
        (table, bit) = (rest, bit.wrapping_shl(1));
    }
    rows
}

/// Clamps an interval to the bounds.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; what is cast was bounded")]
const fn clamped(micros: u64) -> u32 {
    if micros < MIN_INTERVAL as u64 {
        MIN_INTERVAL
    } else if micros > MAX_INTERVAL as u64 {
        MAX_INTERVAL
    } else {
        micros as u32
    }
}

/// Takes the message that a vehicle was asked for; see [`Telemetry::fill`](crate::Telemetry::fill).
#[derive(Debug)]
pub struct Fill<'a> {
    now: Instant,
    id: u32,
    index: u16,
    target: Address,
    outbox: &'a mut Outbox,
    /// Only checks whether the message is available; it is not sent yet.
    is_probe: bool,
}

impl<'a> Fill<'a> {
    pub(crate) fn new(now: Instant, id: u32, index: u16, outbox: &'a mut Outbox, is_probe: bool) -> Self {
        Self { now, id, index, target: Address::new(0, 0), outbox, is_probe }
    }

    /// Sets the address to which the message is sent.
    pub(crate) fn to(mut self, target: Address) -> Self {
        self.target = target;
        self
    }

    /// Returns the time of the call by the firmware's clock, for the time fields.
    pub fn now(&self) -> Instant {
        self.now - self.outbox.lead()
    }

    /// Returns which instance is wanted, such as which battery: parameter 2 of MAV_CMD_REQUEST_MESSAGE, whose meaning each
    /// message defines, the [`instance`](Stream::instance) of a stream, or the index that the vehicle gave to
    /// [`Context::send`] (Q-3).
    pub fn index(&self) -> u16 {
        self.index
    }

    /// Returns the address for the target fields of the message: the peer to which the vehicle [sends](Context::send) it;
    /// 0/0, which is everyone, in a stream or on request.
    pub fn target(&self) -> Address {
        self.target
    }

    /// Returns the component that sends it: the autopilot, or the one of the stream's [row](Stream::of_component).
    pub fn component(&self) -> ComponentId {
        self.outbox.component()
    }

    /// Returns the link on which it is sent.
    pub fn link(&self) -> LinkId {
        self.outbox.link()
    }

    /// Sends the message. Returns false if it cannot be sent: it is not the requested message, the link sends MAVLink
    /// 1, which has no such id (S-10), or it is HIGH_LATENCY2, which the stack sends itself (L-2).
    #[must_use]
    pub fn put<M: Message>(&mut self, message: &M) -> bool {
        if M::ID != self.id || !self.outbox.takes(M::ID) {
            return false;
        }
        self.is_probe || self.outbox.send(message)
    }
}

/// A message that is pending.
#[derive(Clone, Copy, Debug)]
pub enum StreamReply {
    /// MESSAGE_INTERVAL.
    Interval,
    /// The vehicle's message, on request.
    Asked,
    /// The vehicle's message, in its stream.
    Stream,
}

/// The state of the service on a link: `S` is an array of slots, one for each row of the vehicle's streams.
#[derive(Debug)]
pub struct StreamLink<S> {
    streams: Streams,
    slots: S,
}

/// Sends messages on request and in streams. `N` is the number of the vehicle's [`STREAMS`](Telemetry::STREAMS).
#[derive(Debug)]
pub struct StreamService<const N: usize>;

impl<const N: usize> StreamService<N> {
    fn fixed<F: Firmware>(cx: &Cx<'_, F>) -> Fixed {
        let [missions, ..] = F::Plans::CAPACITIES;
        Fixed { heartbeat: cx.shared.config.heartbeat_period, has_missions: missions > 0, has_modes: F::HAS_MODES }
    }

    /// Sends the next stream that is due, and that the vehicle can fill (Q-8).
    fn stream<F: Firmware<Vehicle: Telemetry>>(
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut StreamLink<[Slot; N]>,
    ) -> bool {
        let (profile, is_slowed) = (port.config.streams, F::SLOWS_STREAMS && cx.now < port.facts.transferring_until);
        while let Some(number) = link.streams.next_due(cx.now, F::Vehicle::STREAMS, &mut link.slots, profile, is_slowed)
        {
            let Some(stream) = F::Vehicle::STREAMS.get(number) else { continue };
            let (now, vehicle) = (cx.now, &mut *cx.vehicle);
            if port.outbox.as_component::<F>(Some(stream.component), |outbox| {
                requests::fill(vehicle, &mut Fill::new(now, stream.id, stream.instance, outbox, false))
            }) {
                port.facts.own_was_last = true;
                return true;
            }
        }
        false
    }
}

impl<F: Firmware<Vehicle: Telemetry>, const N: usize> Service<F> for StreamService<N> {
    const NEW: Self = {
        assert!(
            !F::HAS_OPTIONAL_COMPONENTS || are_autopilots(F::Vehicle::STREAMS),
            "a stream of a component that is `Components::OPTIONAL`: send it as the autopilot, or set `OPTIONAL` to false"
        );
        Self
    };
    type Link = StreamLink<[Slot; N]>;
    const ABOUT: About = About { turns: &[Turn::Request, Turn::Stream], part: Part::Every, ..About::AUTOPILOT };
    const VACANT: Self::Link = StreamLink { streams: Streams::new(), slots: [Slot::NEW; N] };
    type Reply = StreamReply;

    /// Takes up the messages that hooks have announced, and pauses the streams that no peer hears.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) {
        let announced = core::mem::take(&mut cx.requests.announced);
        for (id, link) in (0..=u8::MAX).map(LinkId).zip(links) {
            link.streams.ask_all(announced);
            if !is_heard(cx.shared, cx.peers, id) {
                link.streams.pause();
            }
        }
    }

    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut Self::Link,
        received: &Received<'_>,
    ) -> Handled {
        if !has_part::<F>(received.target.component) {
            return Handled::No;
        }
        let StreamLink { streams, slots } = link;
        let of = part::<F>(received.target.component);
        let is_handled = requests::handle_frame(
            cx.now,
            port.config.streams,
            streams,
            F::Vehicle::STREAMS,
            of,
            slots,
            received.frame,
        );
        if is_handled { Handled::Yes } else { Handled::No }
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut Self::Link,
        request: &Request,
    ) -> Option<Verdict> {
        if !has_part::<F>(request.command.component) {
            return None;
        }
        let fixed = Self::fixed(cx);
        let StreamLink { streams, slots } = link;
        requests::handle_command::<F>(cx.now, fixed, port, streams, slots, cx.vehicle, request).map(Verdict::done)
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &Self::Link, turn: Turn) -> Option<(Instant, StreamReply)> {
        let StreamLink { streams, slots } = link;
        match turn {
            Turn::Request if streams.has_interval_request() => Some((view.now, StreamReply::Interval)),
            Turn::Request if streams.is_asked() => Some((view.now, StreamReply::Asked)),
            Turn::Stream if has_listener(view.shared, view.peers, port) => {
                let at = streams.deadline(view.now, F::Vehicle::STREAMS, slots, port.config.streams);
                Some((at, StreamReply::Stream))
            }
            _ => None,
        }
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut Self::Link, reply: StreamReply) -> bool {
        let StreamLink { streams, slots } = link;
        match reply {
            StreamReply::Interval => {
                let fixed = Self::fixed(cx);
                requests::send_interval::<F>(cx.now, fixed, port, streams, F::Vehicle::STREAMS, slots)
            }
            StreamReply::Asked => requests::send_asked::<F>(cx.now, streams, &mut port.outbox, cx.vehicle),
            StreamReply::Stream => Self::stream(cx, port, link),
        }
    }
}

/// Whether all rows are the autopilot's.
#[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
const fn are_autopilots(table: &[Stream]) -> bool {
    let (mut i, mut are_autopilots) = (0, true);
    while i < table.len() {
        are_autopilots &= table[i].component.wire() == 0;
        i += 1;
    }
    are_autopilots
}

/// Whether requests to this component are about streams: it is the autopilot, or has a row.
fn has_part<F: Firmware<Vehicle: Telemetry>>(component: ComponentId) -> bool {
    F::COMPONENTS.is_empty()
        || !F::is_component(component)
        || F::Vehicle::STREAMS.iter().any(|stream| stream.component == component)
}

/// Returns the rows that a request to this component is about: 0 is the autopilot's, and `None` is all.
fn part<F: Firmware>(component: ComponentId) -> Option<ComponentId> {
    match F::COMPONENTS.is_empty() || component.wire() == 0 {
        true => None,
        false => Some(if F::is_component(component) { component } else { ComponentId::ALL }),
    }
}

/// Whether streams are sent on the link: to a peer that is alive there, or to any that may be there (H-8).
pub(crate) fn has_listener(shared: &Shared, peers: &[PeerInfo], port: &Port) -> bool {
    is_heard(shared, peers, port.id)
}

fn is_heard(shared: &Shared, peers: &[PeerInfo], link: LinkId) -> bool {
    !shared.config.streams_wait_for_peer || peers.iter().any(|info| info.is_alive && info.peer.link == link)
}

impl Context<'_> {
    /// Sends message `M`, all its instances, once on every normal link: see [`Stack::announce`](crate::Stack::announce).
    /// `M` must be one of the [`STREAMS`](Telemetry::STREAMS) of the vehicle `V`; otherwise this does not compile.
    pub fn announce<M: Message, V: Telemetry>(&mut self) {
        self.requests.announced |= const { Stream::rows_of::<M>(V::STREAMS) };
    }
}
