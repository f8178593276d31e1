//! Delivers events without gaps. An event carries an id; the ground station has the text.
//!
//! Implements the sender's side of <https://mavlink.io/en/services/events.html>: rules EVT-1 to EVT-7. It serves the
//! receiver of libevents (`libs/cpp/protocol/receive.h`), which QGroundControl and MAVSDK use, and follows PX4
//! (`src/modules/mavlink/mavlink_events.cpp`) except in EVT-3 and EVT-5.
//!
//! ```text
//!   Context::event ─▶ history ─┬─▶ EVENT on each link, from its own cursor ─▶ ground station
//!                              └─▶ EVENT again, or RESPONSE_EVENT_ERROR ◀── REQUEST_EVENT ┘
//! ```
//!
//! Each link sends the events in order, when it has room. CURRENT_EVENT_SEQUENCE has the number of the last sent event,
//! so a receiver notices that the last ones are missing. An event that is overwritten before a link has sent it is
//! counted and reported to the receiver.
//!
//! Left out: events to one component, and the calibration protocol, which a vehicle can build from its own events.

mod checks;
mod declaration;
mod macros;

pub use checks::{Checker, Checking, HealthChecks, HealthReport, Unchecked, summary};
pub use declaration::{
    ArgumentInfo, Check, CheckBits, CheckSet, DeclaredEvent, EntryInfo, EnumInfo, Event, EventArgument, EventGroup,
    EventInfo, EventSet, LogLevel, bit, check_events,
};

use super::rate_limit::{RateLimit, cost};
use super::{About, Cx, Handled, Received, Request, Service, ShowCounters, StackEvent, Turn, Verdict, View};
use crate::dialect::{
    CurrentEventSequence, Event as EventMessage, MavEventCurrentSequenceFlags, MavEventErrorReason, RequestEvent,
    ResponseEventError,
};
use crate::link::{Accepted, Port};
use crate::message::{Address, FieldWriter, Message};
use crate::time::{Duration, Instant};
use crate::types::{Context, EventEntry, EventLog, EventSequence, Firmware, LinkMask};

/// The interval of CURRENT_EVENT_SEQUENCE, as in PX4.
const SEQUENCE_INTERVAL: Duration = Duration::from_secs(3);

/// CURRENT_EVENT_SEQUENCE is recent, while the next one is not due within this time: half a second after it was sent.
const SEQUENCE_RECENT: Duration = Duration::from_millis(2_500);

/// The percentage of a link that the events may use.
const PERCENT: u32 = 50;

counters! {
    /// Counters of the events. They wrap.
    EventCounters {
        /// Events that were overwritten in the history before a link had sent them, summed over the links. The link was
        /// stalled or too slow. RESPONSE_EVENT_ERROR reports this to receivers (EVT-4).
        drop overwritten,
        /// Checks that a report left out because it was longer than the history.
        drop unreported,
    }
}

/// Sends the events: declared by `events` in [`#[stack]`](macro@crate::Stack). Initially all zero bits.
#[derive(Debug)]
pub struct EventService<C> {
    pub(crate) counters: EventCounters,
    /// The links that were opened, and on which no peer was heard since.
    opened: LinkMask,
    checks: C,
}

/// Events that a receiver has requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct RequestedRange {
    first: EventSequence,
    last: EventSequence,
    from: Address,
}

/// The state of the service on a link. Initially all zero bits.
#[derive(Debug)]
pub struct EventLink {
    /// The last event that was sent.
    sent: EventSequence,
    /// The sequence number in the last CURRENT_EVENT_SEQUENCE.
    reported: EventSequence,
    /// Whether any event was sent, to peers that may have received it.
    has_sent: bool,
    /// Whether a peer was heard before the link was opened.
    was_heard: bool,
    /// When CURRENT_EVENT_SEQUENCE is due.
    at: Instant,
    limit: RateLimit,
    /// The requests of two receivers, in order.
    requested: [Option<RequestedRange>; 2],
}

/// A message of this service.
#[derive(Clone, Copy, Debug)]
pub enum EventReply {
    /// CURRENT_EVENT_SEQUENCE.
    Sequence,
    /// An event that a receiver has requested, or RESPONSE_EVENT_ERROR.
    Requested,
    /// The next event.
    Next,
}

impl EventLink {
    /// Sends CURRENT_EVENT_SEQUENCE.
    fn send_sequence(&mut self, now: Instant, port: &mut Port) -> bool {
        self.at = now + SEQUENCE_INTERVAL;
        self.reported = self.sent;
        let flags =
            if self.has_sent { MavEventCurrentSequenceFlags::EMPTY } else { MavEventCurrentSequenceFlags::RESET };
        port.outbox.send(&CurrentEventSequence { sequence: self.sent.wire(), flags })
    }

    /// Sends a requested event. One answer covers all events that are not in the history.
    fn send_requested(&mut self, log: &EventLog, port: &mut Port) -> bool {
        let [pending, second] = &mut self.requested;
        let Some(requested) = pending else { return false };
        let RequestedRange { first, last, from } = *requested;
        let event = log.get(first);
        let next = if event.is_some() { first.next() } else { log.oldest() };
        requested.first = next;
        if next.since(first) > last.since(first) {
            *pending = second.take();
        }
        match event {
            Some(event) => send(port, event, first),
            None => port.outbox.send(&ResponseEventError {
                sequence: first.wire(),
                sequence_oldest_available: log.oldest().wire(),
                target_system: from.system.wire(),
                target_component: from.component.wire(),
                reason: MavEventErrorReason::UNAVAILABLE,
            }),
        }
    }

    /// Sends the next event, or the oldest one that is left.
    fn send_next(&mut self, counters: &mut EventCounters, log: &EventLog, port: &mut Port) -> bool {
        let mut sequence = self.sent.next();
        if log.get(sequence).is_none() {
            let missed = log.oldest().since(sequence);
            counters.overwritten = counters.overwritten.wrapping_add(u32::from(missed));
            sequence = log.oldest();
        }
        let Some(event) = log.get(sequence) else { return false };
        self.sent = sequence;
        self.has_sent = true;
        send(port, event, sequence)
    }
}

/// Broadcasts an event.
fn send(port: &mut Port, event: &EventEntry, sequence: EventSequence) -> bool {
    let EventEntry { id, time_boot_ms, log_levels, arguments } = *event;
    let sequence = sequence.wire();
    let mut message =
        EventMessage { id, event_time_boot_ms: time_boot_ms, sequence, log_levels, ..EventMessage::default() };
    if let Some(place) = message.arguments.first_chunk_mut() {
        *place = arguments;
    }
    port.outbox.send(&message)
}

impl<F: Firmware, C: Checker<F>> Service<F> for EventService<C> {
    const NEW: Self = Self { counters: EventCounters::ZERO, opened: LinkMask::NONE, checks: C::NEW };
    type Link = EventLink;
    const VACANT: EventLink = EventLink {
        sent: EventSequence::NONE,
        reported: EventSequence::NONE,
        has_sent: false,
        was_heard: false,
        at: Instant::ZERO,
        limit: RateLimit::NEW,
        requested: [None; 2],
    };
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::UrgentText, Turn::Event]);
    type Reply = EventReply;

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut EventLink>) {
        let unreported = self.checks.poll(cx);
        self.counters.unreported = self.counters.unreported.wrapping_add(unreported);
    }

    fn deadline(&self) -> Instant {
        self.checks.deadline()
    }

    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut EventLink,
        received: &Received<'_>,
    ) -> Handled {
        let Some(request) = received.frame.decode::<RequestEvent>() else { return Handled::No };
        if !port.outbox.takes(EventMessage::ID) {
            return Handled::OutOfPlace;
        }
        let [first, last] = [request.first_sequence, request.last_sequence].map(EventSequence::new);
        // Events that were not recorded yet get no answer: libevents' receiver would take an error for a loss, and
        // request the whole history again.
        let newest = cx.events.newest();
        if first.is_after(newest) {
            return Handled::Yes;
        }
        let is_range = last == first || last.is_after(first);
        let last = if is_range && !last.is_after(newest) { last } else { newest };
        // libevents' receiver does not remember the newer events that it has dropped: it requests up to the number that
        // was reported last.
        let is_reported = link.reported == link.sent && link.at > cx.now + SEQUENCE_RECENT;
        if link.sent != last && !is_reported {
            link.at = cx.now;
        }
        let requested = RequestedRange { first, last, from: received.from.address };
        for slot in &mut link.requested {
            if *slot.get_or_insert(requested) == requested {
                return Handled::Yes;
            }
        }
        Handled::NoRoom
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        _: &mut Port,
        _: &mut EventLink,
        request: &Request,
    ) -> Option<Verdict> {
        let result = self.checks.on_command(cx, request.command.id);
        // The next poll reports what this link has asked for, on all of them (X-2).
        cx.events.is_new |= result.is_some();
        result.map(Verdict::done)
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &EventLink, turn: Turn) -> Option<(Instant, EventReply)> {
        let is_urgent = view.events.has_urgent(link.sent);
        // The turn of events may wait for what other links cause; emergencies must not (X-10).
        if !port.outbox.takes(EventMessage::ID) || (turn == Turn::UrgentText && !is_urgent) {
            return None;
        }
        let [requested, _] = &link.requested;
        let (at, reply) = match requested {
            // They do not wait for old ones that are requested again (X-10).
            Some(_) if is_urgent => (view.now, EventReply::Next),
            _ if link.at <= view.now => (link.at, EventReply::Sequence),
            Some(_) => (view.now, EventReply::Requested),
            None if link.sent != view.events.newest() => (view.now, EventReply::Next),
            None => (link.at, EventReply::Sequence),
        };
        Some((at.max(link.limit.due()), reply))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut EventLink, reply: EventReply) -> bool {
        let is_sent = match reply {
            EventReply::Sequence => link.send_sequence(cx.now, port),
            EventReply::Requested => link.send_requested(cx.events, port),
            EventReply::Next => link.send_next(&mut self.counters, cx.events, port),
        };
        let cost = cost(port.outbox.len(), PERCENT);
        link.limit.spend(cx.now, cost, port.config.bytes_per_second);
        is_sent
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            // New peers learn the link's last sequence number at once, and the checks soon after the first frame of one
            // is accepted. If none was heard before, no peer has received the events: one that remembers the
            // vehicle before a reboot learns that the numbers start again.
            StackEvent::Opened(port, link) => {
                link.was_heard |= port.accepted != Accepted::Nothing;
                link.has_sent &= link.was_heard;
                link.at = Instant::ZERO;
                link.requested = [None; 2];
                self.opened = self.opened.with(LinkMask::of(port.id));
            }
            StackEvent::Heard { from, .. } if self.opened.contains(from.link) => {
                self.opened = self.opened.without(LinkMask::of(from.link));
                self.checks.repeat();
            }
            _ => {}
        }
    }
}

/// Records an event.
pub(crate) fn record<E: Event>(log: &mut EventLog, now: Instant, event: &E) {
    let (id, levels) = const { (E::INFO.id, E::INFO.log_levels) };
    let mut entry = EventEntry::new(now, id, levels);
    event.write(&mut FieldWriter::new(&mut entry.arguments));
    log.push(&entry);
}

impl Context<'_> {
    /// Records an event that [`events!`](crate::events!) declared. Every normal link sends it when it has room, after
    /// the texts, and again on request while it is in the history (EVT-2). Without `events` in
    /// [`#[stack]`](macro@crate::Stack), nothing is recorded.
    ///
    /// ```
    /// # use mavstack::Context;
    /// mavstack::events! {
    ///     /// The events of this rover.
    ///     pub struct RoverEvents in "rover" {
    ///         events {
    ///             BatteryLow(Warning) { voltage: f32 } = "Battery low: {1:.1} V";
    ///         }
    ///     }
    /// }
    ///
    /// fn on_low_battery(cx: &mut Context<'_>, voltage: f32) {
    ///     cx.event(&BatteryLow { voltage });
    /// }
    /// ```
    pub fn event<E: Event>(&mut self, event: &E) {
        let now = self.now();
        record(self.events, now, event);
    }
}
