//! The calls of the stack, passed on to each service.

use super::Declares;
use super::services::{Services, States};
use crate::dialect::{MavCmd, MavResult};
use crate::link::{Link, Pace, Port, Transport};
use crate::message::{ComponentId, SystemId};
use crate::service::ShowCounters;
use crate::service::{
    BULK_PERCENT, Cx, ForwardingGate, Handled, Look, LookAll, MAX_LATENESS, Part, RateLimit, Received, Request,
    Service, Shared, SigningGate, StackEvent, Turn, Verdict, View, Visit, VisitAll, cost, increment, turns,
};
use crate::time::{Duration, Instant};
use crate::types::{Config, Firmware, LinkClass, LinkId, Peer};

/// Returns when bulk data may be sent in a turn. The files, logs and streamed logs of a link take turns. They share 30
/// % of its rate, and the rest that other traffic leaves (D-4, LOG-8, LOG-14). With a share for each of them, all
/// together would leave streams nothing beside the list of parameters, which has 40 %.
fn bulk_due(limit: &RateLimit, turn: Turn) -> Instant {
    if turn == Turn::LateBulk { limit.due() + MAX_LATENESS } else { Instant::ZERO }
}

/// The turns of a service, a bit each.
pub(super) struct Turns<F, S>(F, S);

impl<F: Firmware, S: Service<F>> Turns<F, S> {
    const BITS: u64 = Turn::bits(S::ABOUT.turns);

    /// Those in which it sends on all links what a request on one of them has changed.
    const SHARED: u32 = Turn::shared(Self::BITS & Turn::BY_SERVICES);

    pub(super) const fn has(turn: Turn) -> bool {
        Self::BITS & turn.bit() != 0
    }
}

/// Whether a service gets a frame or a command for this component, or for all. Always true in a firmware of one component.
fn is_addressed<F: Firmware, S: Service<F>>(component: ComponentId) -> bool {
    F::COMPONENTS.is_empty()
        || component.wire() == 0
        || match S::ABOUT.part {
            Part::Autopilot => !F::is_component(component),
            Part::Component(part) => part == component,
            Part::Every => true,
        }
}

/// Whether a service is left out, because the firmware runs without its other components (K-10).
fn is_left_out<F: Firmware, S: Service<F>>(shared: &Shared) -> bool {
    S::ABOUT.is_of_components && shared.leaves_out_components::<F>()
}

struct Poll<'a, 'c, F: Firmware>(&'a mut Cx<'c, F>);

impl<F: Firmware> VisitAll<F> for Poll<'_, '_, F> {
    #[inline(always)]
    fn visit<'l, S: Service<F>>(&mut self, service: &mut S, links: impl Iterator<Item = &'l mut S::Link>)
    where
        S::Link: 'l,
    {
        if !is_left_out::<F, S>(self.0.shared) {
            service.poll(self.0, links);
        }
    }
}

struct Deadline(Instant);

impl<F: Firmware> LookAll<F> for Deadline {
    #[inline(always)]
    fn look<S: Service<F>>(&mut self, service: &S) {
        self.0 = self.0.min(service.deadline());
    }
}

struct OnFrame<'a, 'c, F: Firmware> {
    cx: &'a mut Cx<'c, F>,
    port: &'a mut Port,
    received: &'a Received<'a>,
    handled: Handled,
    /// The shared turns of the service that has handled it.
    asked: u32,
}

impl<F: Firmware> Visit<F> for OnFrame<'_, '_, F> {
    #[inline(always)]
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        if is_addressed::<F, S>(self.received.target.component) && !is_left_out::<F, S>(self.cx.shared) {
            self.handled = service.on_frame(self.cx, self.port, link, self.received);
        }
        let is_handled = self.handled != Handled::No;
        if is_handled {
            self.asked = Turns::<F, S>::SHARED;
        }
        is_handled
    }
}

struct OnCommand<'a, 'c, F: Firmware> {
    cx: &'a mut Cx<'c, F>,
    port: &'a mut Port,
    request: &'a Request,
    /// Only the services that are this other component of the firmware.
    only: Option<ComponentId>,
    verdict: Option<Verdict>,
    /// The shared turns of the service that has carried it out.
    asked: u32,
}

impl<F: Firmware> Visit<F> for OnCommand<'_, '_, F> {
    #[inline(always)]
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        let is_offered = match self.only {
            Some(_) => S::ABOUT.part.component() == self.only,
            None => is_addressed::<F, S>(self.request.command.component) && !is_left_out::<F, S>(self.cx.shared),
        };
        if is_offered {
            self.verdict = service.on_command(self.cx, self.port, link, self.request);
        }
        if self.verdict.is_some()
            && self.only.is_none()
            && let Some(component) = S::ABOUT.part.component()
        {
            self.cx.shared.answerer = component;
        }
        let is_done = self.verdict.is_some();
        if is_done {
            self.asked = Turns::<F, S>::SHARED;
        }
        is_done
    }
}

/// Something that the services learn, and that concerns none of their links.
#[derive(Clone, Copy)]
enum News<'a> {
    Begun(&'a Config),
    Heard { now: Instant, from: Peer },
    NewOwner { own: SystemId, owner: SystemId },
    ClockSetBack(Duration),
}

impl<F: Firmware> VisitAll<F> for News<'_> {
    #[inline(always)]
    fn visit<'l, S: Service<F>>(&mut self, service: &mut S, _: impl Iterator<Item = &'l mut S::Link>)
    where
        S::Link: 'l,
    {
        service.on_event(match *self {
            News::Begun(config) => StackEvent::Begun(config),
            News::Heard { now, from } => StackEvent::Heard { now, from },
            News::NewOwner { own, owner } => StackEvent::NewOwner { own, owner },
            News::ClockSetBack(lead) => StackEvent::ClockSetBack(lead),
        });
    }
}

/// A link was opened again.
struct Opened<'a>(&'a Port);

impl<F: Firmware> Visit<F> for Opened<'_> {
    #[inline(always)]
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        service.on_event(StackEvent::Opened(self.0, link));
        false
    }
}

/// A link takes no bytes.
struct Stalled<'a>(&'a Port);

impl<F: Firmware> Visit<F> for Stalled<'_> {
    #[inline(always)]
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        if S::ABOUT.holds {
            service.on_event(StackEvent::Stalled(self.0, link));
        }
        false
    }
}

/// A frame was put into the link's outbox.
struct Sent<'a>(&'a Port);

impl<F: Firmware> Visit<F> for Sent<'_> {
    #[inline(always)]
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        service.on_event(StackEvent::Sent(self.0, link));
        false
    }
}

/// Asks the services for one frame in one turn.
struct Offer<'a, 'c, F: Firmware> {
    cx: &'a mut Cx<'c, F>,
    port: &'a mut Port,
    turn: Turn,
}

impl<F: Firmware> Offer<'_, '_, F> {
    #[inline(always)]
    fn ask<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        if is_left_out::<F, S>(self.cx.shared) {
            return false;
        }
        let may_send = |shared: &Shared, now| !self.turn.is_sign_of_life() || shared.is_beating(now);
        // A copy, so that the compiler drops the comparison for a reply that is due at `now`.
        let now = self.cx.now;
        let pending = service.pending(&View { now, ..self.cx.view() }, self.port, link, self.turn);
        match pending {
            Some((at, reply)) => {
                at <= now && may_send(self.cx.shared, now) && service.send(self.cx, self.port, link, reply)
            }
            None => false,
        }
    }
}

impl<F: Firmware> Visit<F> for Offer<'_, '_, F> {
    #[inline(always)]
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        Turns::<F, S>::has(self.turn) && self.ask(service, link)
    }
}

/// Asks the services with bulk data, from one number to another.
struct OfferBulk<'a, 'c, F: Firmware> {
    offer: Offer<'a, 'c, F>,
    first: u8,
    last: u8,
    /// The number of the next service, and of the one that has sent.
    number: u8,
    sender: u8,
}

impl<F: Firmware> Visit<F> for OfferBulk<'_, '_, F> {
    #[inline(always)]
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        if !Turns::<F, S>::has(Turn::Bulk) {
            return false;
        }
        self.sender = self.number;
        self.number = self.number.wrapping_add(1);
        (self.first..=self.last).contains(&self.sender) && self.offer.ask(service, link)
    }
}

/// Asks the services when they have something to send in one turn.
struct When<'a> {
    view: &'a View<'a>,
    port: &'a Port,
    turn: Turn,
    due: Instant,
}

impl<F: Firmware> Look<F> for When<'_> {
    #[inline(always)]
    fn look<S: Service<F>>(&mut self, service: &S, link: &S::Link) {
        if !Turns::<F, S>::has(self.turn) || is_left_out::<F, S>(self.view.shared) {
            return;
        }
        let mut at = service.pending(self.view, self.port, link, self.turn).map_or(Instant::NEVER, |(at, _)| at);
        if self.turn.is_sign_of_life() {
            at = self.view.shared.when_beating(self.view.now, at);
        }
        self.due = self.due.min(at);
    }
}

/// Shows the counters to `show`.
struct Count<'a, C>(&'a mut C);

impl<F: Firmware, C: ShowCounters> LookAll<F> for Count<'_, C> {
    fn look<S: Service<F>>(&mut self, service: &S) {
        service.counters(self.0);
    }
}

impl<D: Declares> Services<D> {
    pub(super) fn begin(&mut self, config: &Config) {
        self.visit_all(&mut [], &mut News::Begun(config));
    }

    pub(super) fn poll(&mut self, cx: &mut Cx<'_, D>, states: &mut [States<D>]) {
        self.heartbeat.sample(cx);
        self.visit_all(states, &mut Poll(cx));
    }

    pub(super) fn deadline(&self) -> Instant {
        let mut deadline = Deadline(Instant::NEVER);
        self.look_all(&mut deadline);
        deadline.0
    }

    pub(super) fn on_frame(
        &mut self,
        cx: &mut Cx<'_, D>,
        port: &mut Port,
        states: &mut States<D>,
        received: &Received<'_>,
    ) -> Handled {
        let mut visit = OnFrame { cx: &mut *cx, port, received, handled: Handled::No, asked: 0 };
        self.visit(states, &mut visit);
        let OnFrame { handled, asked, .. } = visit;
        if Self::HAS_SHARES {
            cx.shared.asked |= asked;
        }
        handled
    }

    // Out of line: its locals stay off the call stack of other frames.
    #[inline(never)]
    pub(super) fn on_command(
        &mut self,
        cx: &mut Cx<'_, D>,
        port: &mut Port,
        states: &mut States<D>,
        request: &mut Request,
    ) -> Option<Verdict> {
        let is_of_component = D::is_component(request.command.component);
        let mut visit = OnCommand { cx: &mut *cx, port: &mut *port, request, only: None, verdict: None, asked: 0 };
        if self.visit(states, &mut visit) {
            let OnCommand { verdict, asked, .. } = visit;
            if Self::HAS_SHARES {
                cx.shared.asked |= asked;
            }
            return verdict;
        }
        request.is_unclaimed = true;
        let verdict = self.stream.on_command(cx, port, &mut states.stream, request);
        // A message that no service knows: the command itself is supported.
        let is_refused = request.command.id == MavCmd::REQUEST_MESSAGE && !is_of_component;
        verdict.or_else(|| is_refused.then(|| Verdict::done(MavResult::DENIED)))
    }

    /// Offers a command of the firmware itself to the services that are one of its other components.
    // Out of line: its locals stay off the call stack of a poll without own commands.
    #[inline(never)]
    pub(super) fn on_own_command(
        &mut self,
        cx: &mut Cx<'_, D>,
        port: &mut Port,
        states: &mut States<D>,
        request: &Request,
    ) -> Option<Verdict> {
        let mut visit = OnCommand { cx, port, request, only: Some(request.command.component), verdict: None, asked: 0 };
        self.visit(states, &mut visit);
        visit.verdict
    }

    pub(super) fn on_heard(&mut self, now: Instant, from: Peer) {
        self.visit_all(&mut [], &mut News::Heard { now, from });
    }

    pub(super) fn on_owner(&mut self, own: SystemId, owner: SystemId) {
        self.visit_all(&mut [], &mut News::NewOwner { own, owner });
    }

    pub(super) fn on_clock_step(&mut self, lead: Duration) {
        self.visit_all(&mut [], &mut News::ClockSetBack(lead));
    }

    pub(super) fn on_sent(&mut self, port: &Port, states: &mut States<D>) {
        self.visit(states, &mut Sent(port));
    }

    /// Has the services release what peers on links hold that take no bytes.
    pub(super) fn release_stalled(&mut self, now: Instant, links: &mut [Link], states: &mut [States<D>]) {
        if !Self::HOLDS {
            return;
        }
        for (Link { port, .. }, state) in links.iter_mut().zip(states) {
            if port.has_stalled(now) && !port.config.class.is_high_latency() {
                event!("link {=u8} takes no bytes", port.id.0);
                self.visit(state, &mut Stalled(port));
            }
        }
    }

    pub(super) fn restart(&mut self, port: &Port, states: &mut States<D>) {
        self.visit(states, &mut Opened(port));
    }

    /// Shows the counters of all services.
    pub(super) fn counters(&self, show: &mut impl ShowCounters) {
        self.look_all(&mut Count(show));
    }

    /// Updates the state that decides on the next frame of a link, before the services are asked for it.
    pub(super) fn prepare(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
        port.bucket.drain(cx.now);
        self.signing.prepare(cx.now, port);
        ForwardingGate::<D>::prepare(&mut self.forwarding, port);
        self.heartbeat.prepare(cx, port, &mut state.heartbeat);
    }

    /// Puts the next frame into the link's outbox, and signs it. While frames are held for a HEARTBEAT, only that is sent (H-17).
    pub(super) fn fill(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) {
        self.prepare(cx, port, state);
        if self.send(cx, port, state) {
            self.signing.sign(cx.now, port);
            port.release();
            increment(&mut port.counters.tx_frames);
            self.on_sent(port, state);
        }
    }

    /// Puts the frame of a turn into the link's empty outbox. Returns false if nothing is due.
    #[inline(always)]
    pub(super) fn offer(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, states: &mut States<D>, turn: Turn) -> bool {
        match turn {
            Turn::Bulk | Turn::LateBulk => Self::HAS_BULK && self.offer_bulk(cx, port, states, turn),
            _ => self.visit(states, &mut Offer { cx, port, turn }),
        }
    }

    /// As [`offer`](Self::offer), for bulk data: the services after the one that was last are asked first.
    // Out of line: its locals stay off the call stack of the other turns.
    #[inline(never)]
    fn offer_bulk(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, states: &mut States<D>, turn: Turn) -> bool {
        if cx.now < bulk_due(&states.bulk, turn) {
            return false;
        }
        let last = states.last_bulk;
        for (first, last) in [(last.wrapping_add(1), u8::MAX), (0, last)] {
            let offer = Offer { cx: &mut *cx, port: &mut *port, turn };
            let mut visit = OfferBulk { offer, first, last, number: 0, sender: 0 };
            if self.visit(states, &mut visit) {
                states.last_bulk = visit.sender;
                let cost = cost(port.outbox.len(), BULK_PERCENT);
                states.bulk.spend_idle(cx.now, cost, port.config.bytes_per_second);
                return true;
            }
        }
        false
    }

    /// Returns when [`offer`](Self::offer) has a frame in this turn, if the link has room.
    #[inline(always)]
    pub(super) fn when(&self, view: &View<'_>, port: &Port, states: &States<D>, turn: Turn) -> Instant {
        let mut when = When { view, port, turn, due: Instant::NEVER };
        self.look(states, &mut when);
        when.due.max(bulk_due(&states.bulk, turn))
    }
}

impl<D: Declares> Services<D> {
    /// Whether requests on one link may have another one send, which has streams.
    pub(super) const HAS_SHARES: bool = Self::HAS_STREAMS && D::LINKS > 1;

    /// Marks what requests on one link have given the others to send.
    pub(super) fn mark_others(links: &mut [Link], from: LinkId) {
        let asked = links.get(usize::from(from.0)).map_or(0, |link| link.port.shares.asked);
        if Self::HAS_SHARES && asked != 0 {
            for Link { port, .. } in links.iter_mut().filter(|link| link.port.id != from) {
                port.shares.mark(asked);
            }
        }
    }

    /// The same for all links, after a poll in which services may have taken up what hooks have requested.
    pub(super) fn mark_polled(links: &mut [Link]) {
        if Self::HAS_SHARES {
            for from in (0..).map(LinkId).take(links.len()) {
                Self::mark_others(links, from);
            }
            links.iter_mut().for_each(|link| link.port.shares.asked = 0);
        }
    }

    /// Returns the turns that are asked for a frame, one set after the other.
    fn passes(port: &Port, class: LinkClass, pace: Pace) -> [u64; 3] {
        let all = Turn::allowed(class, pace);
        if !Self::HAS_STREAMS {
            return [all, 0, 0];
        }
        let mut first = 0;
        if pace >= Pace::Room && port.shares.streams_first() {
            // Lists, files and logs keep their shares beside a flood of answers.
            let late = const { Turn::LateParamList.bit() | Turn::LateBulk.bit() };
            let preferred = const { Turn::STREAMS | Turn::UrgentText.bit() } | late;
            first = Turn::allowed(class, Pace::AtOnce) | Turn::allowed(class, Pace::Idle) & preferred;
        }
        let late = if Self::HAS_SHARES { Turn::of_shared(port.shares.deferred()) } else { 0 };
        let last = if pace == Pace::Idle { all & late } else { 0 };
        [first, all & !first & !late, last]
    }

    /// Records that a turn of a pass has sent a frame, and that those before it had none.
    fn note_sent(port: &mut Port, turns: u64, sent: Turn) {
        let len = port.outbox.len();
        if Self::HAS_STREAMS {
            port.shares.note(sent.traffic(), len);
        }
        if Self::HAS_SHARES {
            let before = turns & sent.bit().wrapping_sub(1);
            port.shares.unmark(Turn::shared(before));
            port.shares.charge(Turn::shared(sent.bit()), len);
        }
    }
}

macro_rules! send {
    ($($turn:ident $service:ident $pace:ident $class:ident $messages:literal $when:literal;)*) => {
        impl<D: Declares> Services<D> {
            /// Puts the next frame into the link's empty outbox: the first turn with something to send sends it (D-4). On a busy
            /// link, the turns of streams come first when these are behind their half of it, and what other links have caused waits
            /// when it has had its tenth.
            pub(super) fn send(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, states: &mut States<D>) -> bool {
                let class = port.config.class;
                let pace = if port.is_held() { Pace::Stalled } else { port.bucket.pace() };
                for turns in &Self::passes(port, class, pace) {
                    let turns = *turns;
                    let mut sent = Turn::Heartbeat;
                    if false $(|| (
                        turns & const { Turn::$turn.bit() } != 0
                            && self.offer(cx, port, states, Turn::$turn)
                            && {
                                sent = Turn::$turn;
                                true
                            }
                    ))* {
                        Self::note_sent(port, turns, sent);
                        return true;
                    }
                    if !Self::HAS_STREAMS {
                        return false;
                    }
                    if Self::HAS_SHARES {
                        port.shares.unmark(Turn::shared(turns));
                    }
                }
                if pace == Pace::Idle {
                    port.shares.reset();
                }
                false
            }

            /// Returns when the link has something to send, as far as its transport accepts bytes.
            pub(super) fn due(&self, view: &View<'_>, port: &Port, states: &States<D>) -> Instant {
                // Only the HEARTBEAT, which frames wait for (H-17).
                let is_held = view.shared.holds(port);
                let has_frame = !port.outbox.is_empty();
                let is_stalled = match port.transport {
                    // The rest of a frame waits for the next poll's budget, or for a transport that has failed.
                    Transport::Ready if has_frame => return view.now.max(port.retry_at),
                    // The transport must become ready first, which the stack cannot observe.
                    Transport::Full | Transport::Unknown if has_frame => return Instant::NEVER,
                    transport => transport == Transport::Full,
                };
                let (class, ready_at, idle_at) = (port.config.class, port.bucket.ready_at(), port.bucket.idle_at());
                let deferred = if Self::HAS_SHARES { Turn::of_shared(port.shares.deferred()) } else { 0 };
                let stream_at = if Self::HAS_STREAMS && port.shares.streams_first() { ready_at } else { idle_at };
                let mut due = match is_held {
                    true => port.held_until(),
                    // It was cut off, and is sent again.
                    false if port.outbox.has_frame() => view.now,
                    false => Instant::NEVER,
                };
                $(if Turn::$turn.is_on(class) && (!(is_stalled || is_held) || Turn::$turn.pace() == Pace::Stalled) {
                    let at = self.when(view, port, states, Turn::$turn);
                    due = due.min(at.max(match Turn::$turn.pace() {
                        Pace::Stalled | Pace::AtOnce => Instant::ZERO,
                        Pace::Room if deferred & const { Turn::SHARED & Turn::$turn.bit() } != 0 => idle_at,
                        Pace::Room => ready_at,
                        Pace::Idle if Turn::$turn.is_stream() => stream_at,
                        Pace::Idle => idle_at,
                    }));
                })*
                // A frame that is due already waits for the transport.
                if is_stalled && due <= view.now { Instant::NEVER } else { due.max(port.retry_at) }
            }
        }
    };
}

turns!(send);
