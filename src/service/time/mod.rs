//! PING and TIMESYNC: round-trip times, and the offset between two clocks.
//!
//! Implements <https://mavlink.io/en/services/ping.html> and <https://mavlink.io/en/services/timesync.html>, rules T-1
//! and T-2. Each request is answered to its sender. A message that is neither a request nor the answer to one of ours
//! is dropped, or two components would answer each other for ever. High-latency links do not carry these messages
//! (T-3).

mod filter;
mod wall_clock;

pub use filter::ClockFilter;
pub use wall_clock::WallClock;

use core::num::Wrapping;

use super::{About, Cx, Handled, Received, Service, Turn, View};
use crate::dialect::{Ping, Timesync};
use crate::link::{Outbox, Port};
use crate::message::{Address, SystemId};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkId, LinkMask, Peer, Sender, Trust};

/// Requests that can be pending on a link.
const REQUESTS: usize = 2;

/// The state of the service on a link: initially zero bits.
#[derive(Clone, Copy, Debug)]
pub struct TimeLink {
    requests: [TimeRequest; REQUESTS],
    /// TIMESYNC.ts1 of the vehicle's own last request (ns); 0 before the first.
    asked: i64,
}

/// A peer's pending request.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct TimeRequest {
    kind: Kind,
    from: Address,
    seq: u32,
    /// The sender's clock: PING.time_usec, or TIMESYNC.ts1.
    time: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Kind {
    None,
    Ping,
    Timesync,
}

/// A message that is pending.
#[derive(Clone, Copy, Debug)]
pub enum TimeReply {
    /// The answer to a peer's request.
    Answer,
    /// The vehicle's own request.
    Request,
}

/// A measurement of a peer's clock against ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TimeSample {
    /// The peer whose clock was measured.
    pub from: Peer,
    /// When the answer was received, by our clock.
    pub at: Instant,
    /// How far the peer's clock is ahead of ours (ns), if the request took as long as the answer. The error is at most
    /// half of [`round_trip_ns`](Self::round_trip_ns).
    pub offset_ns: i64,
    /// The time from the request to the answer (ns). The shorter it is, the better is the sample.
    pub round_trip_ns: i64,
}

/// The peer whose clock is measured.
#[derive(Clone, Copy, Debug)]
struct Source {
    sender: Sender,
    /// A component of our own system, or verified by its signature.
    is_preferred: bool,
    /// Until when others are not the source, unless they are preferred.
    kept_until: Instant,
}

impl Source {
    /// No peer. All zero bits, unlike the `None` of an `Option`, which is a value that `Trust` does not have.
    const NONE: Self = Self {
        sender: Sender { peer: Peer { address: Address::new(0, 0), link: LinkId(0) }, trust: Trust::None },
        is_preferred: false,
        kept_until: Instant::ZERO,
    };
}

/// How long a peer that does not answer keeps others from being the source (T-2).
const SOURCE_TIMEOUT: Duration = Duration::from_secs(10);

/// Answers PING and TIMESYNC, and measures peers' clocks: `time: Time` in the struct of a [stack](macro@crate::Stack).
/// A vehicle without it gets both messages in [`Vehicle::message`](crate::Vehicle::message).
///
/// Each link has room for two requests. Further requests that are received meanwhile are dropped and counted
/// ([`LinkCounters::no_answer_slot`](crate::network::LinkCounters::no_answer_slot)).
///
/// ```
/// # use mavstack::prelude::*;
/// # use mavstack::dialect;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// #[derive(mavstack::Stack)]
/// #[stack(vehicle: Rover, links: 2)]
/// struct Mavlink {
///     time: mavstack::clock::Time,
/// }
///
/// /// Called about once a second by the flight loop.
/// fn ask(stack: &mut StackOf<Mavlink>) {
///     stack.time.ask(LinkId(1));
///     if let Some(sample) = stack.time.take_sample() {
///         let _ = (sample.offset_ns, sample.round_trip_ns);
///     }
/// }
/// ```
#[derive(Clone, Debug)]
pub struct Time {
    sample: Option<TimeSample>,
    source: Source,
    /// Links on which the vehicle's own request is pending.
    asks: LinkMask,
}

impl Time {
    /// Sends a TIMESYNC request on `link`, which every peer there may answer. High-latency links send none (T-2, T-3).
    ///
    /// The samples are those of one peer, as long as it answers within ten seconds: the first one, or a component of the vehicle's
    /// own system, or one whose answers are signed. So an answer of a stranger displaces none.
    pub fn ask(&mut self, link: LinkId) {
        self.asks = self.asks.with(LinkMask::of(link));
    }

    /// Takes the newest answer to [`ask`](Self::ask). A [`ClockFilter`] estimates the peer's clock from many.
    #[must_use = "the sample is taken out"]
    pub fn take_sample(&mut self) -> Option<TimeSample> {
        self.sample.take()
    }

    fn receive(&mut self, now: Instant, own: SystemId, link: &mut TimeLink, received: &Received<'_>) -> Handled {
        let (frame, from) = (received.frame, received.from);
        let request = if let Some(ping) = frame.decode::<Ping>() {
            // A PING with a target is an answer (T-1).
            let is_request = ping.target_system == 0 && ping.target_component == 0;
            is_request.then_some(TimeRequest {
                kind: Kind::Ping,
                from: from.address,
                seq: ping.seq,
                time: ping.time_usec,
            })
        } else if let Some(sync) = frame.decode::<Timesync>() {
            if sync.tc1 != 0 && received.counts {
                self.on_answer(now, own, link, received.sender(), &sync);
            }
            let time = sync.ts1.cast_unsigned();
            (sync.tc1 == 0).then_some(TimeRequest { kind: Kind::Timesync, from: from.address, seq: 0, time })
        } else {
            return Handled::No;
        };
        let Some(request) = request else { return Handled::Yes };
        let Some(place) = link.requests.iter_mut().find(|place| place.kind == Kind::None) else {
            return Handled::NoRoom;
        };
        *place = request;
        Handled::Yes
    }

    /// Handles an answer. It answers our request if it contains the time at which we asked (T-2).
    fn on_answer(&mut self, now: Instant, own: SystemId, link: &TimeLink, sender: Sender, sync: &Timesync) {
        if link.asked == 0 || sync.ts1 != link.asked {
            return;
        }
        let is_preferred = sender.trust == Trust::Signed || sender.peer.address.system == own;
        let is_kept = now < self.source.kept_until && (self.source.is_preferred || !is_preferred);
        if is_kept && !self.source.sender.is_repeated_by(sender) {
            return;
        }
        self.source = Source { sender, is_preferred, kept_until: now + SOURCE_TIMEOUT };
        let from = sender.peer;
        let asked = Wrapping(link.asked);
        let round_trip = Wrapping(nanos(now)) - asked;
        let offset = Wrapping(sync.tc1) - (asked + Wrapping(round_trip.0 / 2));
        self.sample = Some(TimeSample { from, at: now, offset_ns: offset.0, round_trip_ns: round_trip.0 });
    }

    fn send(&mut self, now: Instant, link: &mut TimeLink, tx: &mut Outbox, reply: TimeReply) -> bool {
        match reply {
            TimeReply::Answer => link.answer(now, tx),
            TimeReply::Request => {
                self.asks = self.asks.without(LinkMask::of(tx.link()));
                link.asked = nanos(now);
                tx.send(&Timesync { tc1: 0, ts1: link.asked, target_system: 0, target_component: 0 })
            }
        }
    }
}

impl TimeLink {
    /// Whether a peer's request is pending.
    fn has_request(&self) -> bool {
        self.requests.iter().any(|request| request.kind != Kind::None)
    }

    /// Answers a peer's request.
    fn answer(&mut self, now: Instant, tx: &mut Outbox) -> bool {
        let pending = self.requests.iter_mut().find(|request| request.kind != Kind::None);
        let Some(request) = pending else { return false };
        let TimeRequest { kind, from, seq, time } = *request;
        request.kind = Kind::None;
        let (target_system, target_component) = (from.system.wire(), from.component.wire());
        match kind {
            Kind::Ping => tx.send(&Ping { time_usec: time, seq, target_system, target_component }),
            _ => tx.send(&Timesync { tc1: nanos(now), ts1: time.cast_signed(), target_system, target_component }),
        }
    }
}

/// Returns the nanoseconds since boot, which last 292 years. It is never 0, which would make an answer a request.
fn nanos(now: Instant) -> i64 {
    now.as_micros().wrapping_mul(1_000).cast_signed().max(1)
}

impl<F: Firmware> Service<F> for Time {
    const NEW: Self = Self { sample: None, source: Source::NONE, asks: LinkMask::NONE };
    type Link = TimeLink;
    const VACANT: TimeLink = TimeLink {
        requests: [TimeRequest { kind: Kind::None, from: Address::new(0, 0), seq: 0, time: 0 }; REQUESTS],
        asked: 0,
    };
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::Time]);
    type Reply = TimeReply;

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, link: &mut TimeLink, received: &Received<'_>) -> Handled {
        self.receive(cx.shared.clock.shown(cx.now), cx.address().system, link, received)
    }

    /// Answers, and the vehicle's own requests, are sent at once, because they measure time.
    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &TimeLink, _: Turn) -> Option<(Instant, TimeReply)> {
        let reply = if link.has_request() {
            TimeReply::Answer
        } else if self.asks.contains(port.id) {
            TimeReply::Request
        } else {
            return None;
        };
        Some((view.now, reply))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut TimeLink, reply: TimeReply) -> bool {
        Time::send(self, cx.shared.clock.shown(cx.now), link, &mut port.outbox, reply)
    }
}
