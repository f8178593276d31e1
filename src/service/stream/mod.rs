//! Messages on request and streams: the vehicle's telemetry, with an interval for each message on each link.
//!
//! Implements the message requests of <https://mavlink.io/en/services/command.html> (MAV_CMD_REQUEST_MESSAGE,
//! MAV_CMD_SET_MESSAGE_INTERVAL, MAV_CMD_GET_MESSAGE_INTERVAL), MESSAGE_INTERVAL, and REQUEST_DATA_STREAM for the
//! ground stations that still send it: rules.
//!
//! The vehicle declares the messages that it can fill as a list of [`Stream`]s, and fills one when asked. Each link has
//! an interval and a due time for each of them. Nothing is kept as bytes, so a message reports the state at the time it
//! is sent (D-3). A stack that does not declare `streams` does not link this.

mod own_messages;
mod requests;
mod schedule;
mod table;
#[cfg(test)]
mod tests;
mod vehicle;

pub use own_messages::Messages;
pub(crate) use own_messages::id_of;
pub use schedule::{Slot, StreamLink};
pub use table::{MAX_STREAMS, Stream};
pub use vehicle::{Fill, Telemetry};

use self::table::Rows;
use super::{About, Cx, Handled, Part, Received, Request, Service, Shared, ShowCounters, Turn, Verdict, View};
use crate::link::Port;
use crate::message::{ComponentId, Message};
use crate::network::PeerInfo;
use crate::time::Instant;
use crate::types::{Context, Firmware, LinkId};

/// A message that is pending.
#[derive(Clone, Copy, Debug)]
pub enum StreamReply {
    /// MESSAGE_INTERVAL.
    Interval,
    /// The vehicle's message, on request.
    Requested,
    /// The vehicle's message, in its stream.
    Stream,
}

counters! {
    /// Streams that look declared and are not sent.
    StreamCounters {
        /// Rows of [`STREAMS`](Telemetry::STREAMS) that have been due, and that the vehicle has never [filled](Telemetry::fill) so
        /// far. It does not wrap.
        count never_filled,
    }
}

/// Sends messages on request and in streams. `N` is the number of the vehicle's [`STREAMS`](Telemetry::STREAMS).
#[derive(Debug)]
pub struct StreamService<const N: usize> {
    pub(crate) history: FillHistory,
}

/// Which streams the vehicle has ever filled when they were due.
#[derive(Clone, Copy, Debug)]
pub struct FillHistory {
    declined: Rows,
    filled: Rows,
}

impl FillHistory {
    const NEW: Self = Self { declined: Rows::NONE, filled: Rows::NONE };

    fn record(&mut self, row: usize, is_filled: bool) {
        let rows = if is_filled { &mut self.filled } else { &mut self.declined };
        *rows = rows.with(Rows::row(row));
    }

    const fn never_filled(self) -> Rows {
        self.declined.without(self.filled)
    }

    /// Returns the streams of a table that have been due and were never filled.
    pub(crate) fn streams_never_filled(self, table: &[Stream]) -> impl Iterator<Item = &Stream> {
        let mut rows = self.never_filled();
        core::iter::from_fn(move || rows.take_first()).filter_map(|row| table.get(row))
    }
}

/// Sends the next stream that is due, and that the vehicle can fill.
fn send_stream<F: Firmware<Vehicle: Telemetry>>(
    history: &mut FillHistory,
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    link: &mut StreamLink,
) -> bool {
    let is_slowed = F::SLOWS_STREAMS && cx.now < port.facts.transferring_until;
    let (profile, least_percent) = (port.config.streams, port.config.least_stream_percent);
    while let Some(row) = link.next_due(cx.now, F::Vehicle::STREAMS, profile, least_percent, is_slowed) {
        let Some(stream) = F::Vehicle::STREAMS.get(row) else { continue };
        let is_filled = vehicle::fill_row(cx, &mut port.outbox, stream, stream.instance, false);
        history.record(row, is_filled);
        if is_filled {
            return true;
        }
    }
    false
}

impl<F: Firmware<Vehicle: Telemetry>, const N: usize> Service<F> for StreamService<N> {
    const NEW: Self = {
        assert!(
            !F::HAS_OPTIONAL_COMPONENTS || table::are_autopilots(F::Vehicle::STREAMS),
            "a stream of a component that is `Components::OPTIONAL`: send it as the autopilot, or set `OPTIONAL` to false"
        );
        Self { history: FillHistory::NEW }
    };
    type Link = StreamLink<[Slot; N]>;
    const ABOUT: About = About { turns: &[Turn::Request, Turn::Stream], part: Part::Every, ..About::AUTOPILOT };
    const VACANT: Self::Link = StreamLink::NEW;
    type Reply = StreamReply;

    fn counters(&self, show: &mut impl ShowCounters) {
        let mut counters = StreamCounters::ZERO;
        counters.never_filled = self.history.never_filled().len();
        show.counters(&counters);
    }

    /// Takes up the messages that hooks have announced, and pauses the streams that no peer hears.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) {
        let announced = table::Rows(core::mem::take(&mut cx.requests.announced));
        for (id, link) in (0..).map(LinkId).zip(links) {
            let link: &mut StreamLink = link;
            link.request(announced);
            if !is_heard(cx.shared, cx.peers, id) {
                link.pause();
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
        let of = requests::owner::<F>(received.target.component);
        let is_handled = requests::handle_frame(cx, port, link, of, received.frame);
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
        requests::handle_command(cx, port, link, request).map(Verdict::done)
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &Self::Link, turn: Turn) -> Option<(Instant, StreamReply)> {
        let link: &StreamLink = link;
        match turn {
            Turn::Request if link.has_interval_request() => Some((view.now, StreamReply::Interval)),
            Turn::Request if link.has_requested() => Some((view.now, StreamReply::Requested)),
            Turn::Stream if has_listener(view.shared, view.peers, port) => {
                Some((link.deadline(view.now, F::Vehicle::STREAMS, port.config.streams), StreamReply::Stream))
            }
            _ => None,
        }
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut Self::Link, reply: StreamReply) -> bool {
        match reply {
            StreamReply::Interval => requests::send_interval(cx, port, link),
            StreamReply::Requested => requests::send_requested(cx, port, link),
            StreamReply::Stream => send_stream(&mut self.history, cx, port, link),
        }
    }
}

/// Whether requests to this component are about streams: it is the autopilot, or has a row.
fn has_part<F: Firmware<Vehicle: Telemetry>>(component: ComponentId) -> bool {
    F::COMPONENTS.is_empty()
        || !F::is_component(component)
        || F::Vehicle::STREAMS.iter().any(|stream| stream.component == component)
}

/// Whether streams are sent on the link: to a peer that is alive there, or to any that may be there (H-8).
pub(crate) fn has_listener(shared: &Shared, peers: &[PeerInfo], port: &Port) -> bool {
    is_heard(shared, peers, port.id)
}

fn is_heard(shared: &Shared, peers: &[PeerInfo], link: LinkId) -> bool {
    !shared.config.streams_wait_for_peer || peers.iter().any(|info| info.is_alive && info.peer.link == link)
}

impl Context<'_> {
    /// Sends message `M`, all its instances, once on every normal link: see
    /// [`Stack::announce`](crate::Stack::announce). `M` must be one of the [`STREAMS`](Telemetry::STREAMS) of the
    /// vehicle `V`; otherwise this does not compile.
    pub fn announce<M: Message, V: Telemetry>(&mut self) {
        self.requests.announced |= const { Stream::rows_of::<M>(V::STREAMS) };
        self.requests.is_new = true;
    }
}
