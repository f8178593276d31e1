//! The services that a vehicle offers to its peers.
//!
//! Each service is a type that implements [`Service`]. Received frames and commands change its state.
//! [`pending`](Service::pending) says what is to be sent and when, and [`send`](Service::send) sends it when the link has room. A pending answer is a flag, a cursor or a
//! slot, never bytes, so a full link delays it and never loses it (D-3). The list of the services is in
//! `stack/services.rs`; [`Turn`] is the order in which they send.

mod gate;
mod list;
mod schedule;
mod share;
mod token_bucket;
mod turn;

pub(crate) mod camera;
pub(crate) mod client;
pub(crate) mod command;
pub(crate) mod components;
pub(crate) mod events;
#[cfg(test)]
pub(crate) mod example;
pub(crate) mod ext_parameters;
pub(crate) mod files;
pub(crate) mod forwarding;
pub(crate) mod gimbal;
pub(crate) mod heartbeat;
pub(crate) mod high_latency;
pub(crate) mod identity;
pub(crate) mod log_streaming;
pub(crate) mod logs;
pub(crate) mod manual_control;
pub(crate) mod messages;
pub(crate) mod mission;
pub(crate) mod mode;
pub(crate) mod operator_control;
pub(crate) mod param;
pub(crate) mod periodic;
#[cfg(test)]
pub(crate) mod rest;
pub(crate) mod setpoints;
#[cfg(feature = "signing")]
pub(crate) mod signing;
pub(crate) mod statustext;
pub(crate) mod stream;
pub(crate) mod time;

#[doc(hidden)]
pub use gate::{Absent, ControlGate, ForwardingGate, OwnCommands, SigningGate, SticksGate, WithoutSigning};
pub use list::{Look, LookAll, ServiceList, Visit, VisitAll};
pub(crate) use share::{COST_OF_BYTE, MAX_LATENESS, Share};
#[cfg(test)]
pub(crate) use turn::TABLE;
pub use turn::Turn;
pub(crate) use turn::turns;

use crate::dialect::{MavCmd, MavProtocolCapability, MavResult, MavSeverity};
use crate::frame::Frame;
pub use crate::link::Port;
pub use crate::log::Counters;
pub(crate) use crate::log::increment;
use crate::message::{Address, ComponentId, Message, SystemId};
use crate::network::{PeerInfo, Peers};
use crate::num;
use crate::time::{Clock, Duration, Instant};
pub use crate::types::Firmware;
use crate::types::{
    Command, Config, Context, EventLog, Flight, HookFaults, LinkId, LinkMask, Origin, Outcome, Peer, PlansMut, Refusal,
    Requests, SignedAt, StatusTexts, Values,
};

/// A service of the firmware `F`. It calls the hooks of the firmware's vehicle.
///
/// A call for a link gets the link's port and the service's own state on that link. A service that is not declared
/// keeps the default methods, which compile to nothing.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no service of this vehicle",
    label = "a field of a stack is a service",
    note = "if it is one, the vehicle does not implement its hooks"
)]
pub trait Service<F: Firmware>: Sized {
    /// The service's state on a link.
    type Link: core::fmt::Debug;

    /// The initial state on a link: all zero bits, so it takes no flash.
    const VACANT: Self::Link;

    /// What the stack must know about the service at compile time.
    const ABOUT: About = About::AUTOPILOT;

    /// Fails to compile if the sizes of the service, or the constants of its hooks, are wrong.
    const CHECK: () = ();

    /// The initial service: all zero bits, if the service is part of the stack, so it takes no flash.
    const NEW: Self;

    /// Runs the service's timers. `links`: its state on each link, in order.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>)
    where
        Self::Link: 'l,
    {
        let _ = (cx, links);
    }

    /// Returns when [`poll`](Self::poll) has something to do.
    fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    /// Handles a frame that is addressed to us or to all, if the service handles its message.
    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut Self::Link,
        received: &Received<'_>,
    ) -> Handled {
        let _ = (cx, port, link, received);
        Handled::No
    }

    /// Executes a command, or refuses it. Returns `None` if the service does not handle the command.
    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut Self::Link,
        request: &Request,
    ) -> Option<Verdict> {
        let _ = (cx, port, link, request);
        None
    }

    /// What the service has to send: an enum with a name for each kind of frame.
    type Reply;

    /// Returns what is pending in this turn, and when it is due. It changes nothing, and is called often.
    fn pending(&self, view: &View<'_>, port: &Port, link: &Self::Link, turn: Turn) -> Option<(Instant, Self::Reply)> {
        let _ = (view, port, link, turn);
        None
    }

    /// Puts what [`pending`](Self::pending) has returned into the link's outbox, which is empty. If the vehicle cannot give it, it
    /// returns false, and the same is not pending again at once.
    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut Self::Link, reply: Self::Reply) -> bool {
        let _ = (cx, port, link, reply);
        false
    }

    /// Learns what has happened. Most services need none of it.
    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        let _ = event;
    }

    /// Shows the service's counters.
    fn counters(&self, show: &mut impl ShowCounters) {
        let _ = show;
    }
}

/// What the stack must know about a service at compile time.
#[derive(Clone, Copy, Debug)]
pub struct About {
    /// The places of the service in the sending order of a link.
    pub turns: &'static [Turn],
    /// The capabilities that the service adds to AUTOPILOT_VERSION.
    pub capabilities: MavProtocolCapability,
    /// The component whose frames and commands the service gets, besides those for all components.
    pub part: Part,
    /// Whether the service is left out with the other components of the firmware: it is one of them, or serves only them.
    pub is_of_components: bool,
}

impl About {
    /// A service that is a part of the autopilot, without a capability, and that sends nothing.
    pub const AUTOPILOT: Self =
        Self { turns: &[], capabilities: MavProtocolCapability::EMPTY, part: Part::Autopilot, is_of_components: false };

    /// The same, in these places of the sending order.
    pub const fn in_turns(self, turns: &'static [Turn]) -> Self {
        Self { turns, ..self }
    }

    /// Returns the capabilities of all, or only of those that are left out with the other components.
    pub(crate) const fn capabilities(all: &[Self], of_components: bool) -> MavProtocolCapability {
        let (mut capabilities, mut rest) = (MavProtocolCapability::EMPTY, all);
        while let [about, others @ ..] = rest {
            if !of_components || about.is_of_components {
                capabilities = capabilities.with(about.capabilities);
            }
            rest = others;
        }
        capabilities
    }

    /// A service that is this component of the firmware; a part of the autopilot if it is none.
    pub(crate) const fn of(component: Option<ComponentId>) -> Self {
        match component {
            Some(component) => Self { part: Part::Component(component), is_of_components: true, ..Self::AUTOPILOT },
            None => Self::AUTOPILOT,
        }
    }
}

/// The component that a service is a part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The autopilot itself.
    Autopilot,
    /// Another component of the firmware: the service is this component.
    Component(ComponentId),
    /// The autopilot, and all other components of the firmware.
    Every,
}

impl Part {
    /// Returns the component, if it is not the autopilot.
    pub(crate) const fn component(self) -> Option<ComponentId> {
        match self {
            Self::Component(component) => Some(component),
            Self::Autopilot | Self::Every => None,
        }
    }
}

/// What services learn besides frames and commands. `L` is the state of the service on a link.
#[derive(Debug)]
pub enum StackEvent<'a, L> {
    /// The stack begins: sets the initial values that are not zero bits.
    Begun(&'a Config),
    /// The link was opened again: pending answers that mean nothing to the new peers are discarded.
    Opened(&'a Port, &'a mut L),
    /// A frame was accepted, whatever its message.
    Heard {
        /// The time.
        now: Instant,
        /// The sender.
        from: Peer,
    },
    /// Another system is in control, besides our own: what others have sent ends.
    NewOwner {
        /// The vehicle's system.
        own: SystemId,
        /// The system in control.
        owner: SystemId,
    },
    /// The firmware's clock was set back by a second or more, and the stack's is ahead of it by this time from now on. What the
    /// service has stored by the firmware's clock, instead of the stack's, is no longer of use.
    ClockSetBack(Duration),
    /// Any service has put a frame into the link's outbox.
    Sent(&'a Port, &'a mut L),
}

/// The data that all services share.
#[derive(Debug)]
pub struct Shared {
    pub(crate) config: Config,
    /// All links except the high-latency links.
    pub(crate) normal: LinkMask,
    /// The high-latency links.
    pub(crate) satellites: LinkMask,
    pub(crate) flight: Flight,
    /// The stack's time, which is never set back. All other instants inside the stack are its.
    pub(crate) clock: Clock,
    /// How often the firmware's clock was set back. Wraps.
    pub(crate) clock_steps: u32,
    /// When the stack was last polled (H-18). Before the first time the vehicle's state is not known.
    pub(crate) polled: Instant,
    /// Work may be pending that only the vehicle knows about, on any link, so `next_deadline` returns `now`.
    pub(crate) has_acted: bool,
    /// An operation on the storage is running, so nothing else can be written.
    pub(crate) is_storage_busy: bool,
    /// The component of the firmware that answers a command to all of them; 0 is the autopilot.
    pub(crate) answerer: ComponentId,
    /// The firmware runs without its other components.
    pub(crate) is_alone: bool,
    /// Changes when the numbers of the flight logs may have changed. It wraps.
    pub(crate) log_numbers: u16,
    /// Until when a client is reading the file of a flight log.
    pub(crate) logs_read_until: Instant,
    pub(crate) faults: HookFaults,
}

impl Shared {
    /// All zero bits.
    pub(crate) const VACANT: Self = Self {
        config: Config::VACANT,
        normal: LinkMask::NONE,
        satellites: LinkMask::NONE,
        flight: Flight::new(),
        clock: Clock::NEW,
        clock_steps: 0,
        polled: Instant::ZERO,
        has_acted: false,
        is_storage_busy: false,
        answerer: ComponentId(0),
        is_alone: false,
        log_numbers: 0,
        logs_read_until: Instant::ZERO,
        faults: HookFaults::ZERO,
    };

    /// Whether the other components of the firmware are left out.
    pub(crate) fn leaves_out_components<F: Firmware>(&self) -> bool {
        F::HAS_OPTIONAL_COMPONENTS && self.is_alone
    }

    /// Whether this is another component of the firmware that is not left out.
    pub(crate) fn has_component<F: Firmware>(&self, id: ComponentId) -> bool {
        F::is_component(id) && !self.leaves_out_components::<F>()
    }

    /// Whether the stack was begun: then it has links.
    pub(crate) const fn is_begun(&self) -> bool {
        !self.normal.with(self.satellites).is_empty()
    }

    /// Whether frames of a link wait for a HEARTBEAT (H-17). Nothing waits for one that cannot come: before the first poll, and
    /// while the vehicle is in a fault.
    pub(crate) fn holds(&self, port: &Port) -> bool {
        port.is_held() && self.flight.has_state
    }

    /// Ends a link's wait for a HEARTBEAT that has not come (H-17). Unless frames still wait, makes the frame that was cut off when
    /// the link closed the next one. Returns whether there is one.
    #[inline(never)]
    pub(crate) fn resume(&self, now: Instant, port: &mut Port) -> bool {
        if port.is_held() {
            if self.holds(port) && now < port.bound_hold(now, self.config.max_loop_gap) {
                return false;
            }
            port.release();
        }
        port.outbox.resume()
    }

    /// Whether the vehicle has a state, and the stack was polled within `max_loop_gap`, so that the peers' timeouts and the failsafe run (H-18).
    fn is_polled(&self, now: Instant) -> bool {
        self.flight.has_state && now.since(self.polled) <= self.config.max_loop_gap
    }

    /// Samples the pulse of the flight loop.
    pub(crate) fn sample_pulse(&mut self, now: Instant) {
        let Self { config, flight, .. } = self;
        if let Some(pulse) = config.pulse {
            flight.credit.sample(now, pulse, config.max_loop_gap);
        }
    }

    /// Whether heartbeats may be sent, as of the last sample of the pulse (H-5, H-18).
    pub(crate) fn is_beating(&self, now: Instant) -> bool {
        self.flight.credit.is_good(now, self.config.max_loop_gap) && self.is_polled(now)
    }

    /// Returns when the stack must be polled again at the latest, so that heartbeats may be sent (H-18).
    pub(crate) fn poll_deadline(&self) -> Instant {
        self.polled.after(self.config.max_loop_gap)
    }

    /// Returns when a message that is due at `due` can be sent, if it must not be sent while the flight loop is stopped or the
    /// vehicle is in a fault.
    pub(crate) fn when_beating(&self, now: Instant, due: Instant) -> Instant {
        let (credit, gap) = (&self.flight.credit, self.config.max_loop_gap);
        match due {
            Instant::NEVER => Instant::NEVER,
            due if due > now => credit.look_for(due, gap),
            due if self.is_beating(now) => due,
            // It waits for the flight loop or the vehicle. Only polling shows that they recovered.
            _ => now.after(RETRY),
        }
    }
}

/// How soon to check again whether heartbeats may be sent.
pub(crate) const RETRY: Duration = Duration::from_millis(100);

/// The data that a call of a service uses, besides the service itself and its link.
pub struct Cx<'a, F: Firmware> {
    /// By the stack's clock.
    pub(crate) now: Instant,
    pub(crate) shared: &'a mut Shared,
    pub(crate) peers: &'a mut Peers,
    pub(crate) texts: &'a mut StatusTexts,
    pub(crate) requests: &'a mut Requests,
    pub(crate) events: &'a mut EventLog,
    pub(crate) plans: Option<PlansMut<'a>>,
    pub(crate) parameters: &'a mut F::Parameters,
    pub(crate) vehicle: &'a mut F::Vehicle,
}

impl<F: Firmware> Cx<'_, F> {
    /// Returns what can be seen without the vehicle.
    #[inline(always)]
    pub(crate) fn view(&self) -> View<'_> {
        View {
            now: self.now,
            shared: self.shared,
            peers: self.peers,
            texts: self.texts,
            requests: self.requests,
            events: self.events,
        }
    }

    /// Returns the time, by the stack's clock, which is never set back.
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Returns the vehicle's address.
    pub fn address(&self) -> Address {
        self.shared.config.address.get()
    }

    /// Sends a text on every normal link. Compiled out if there is no queue of texts.
    #[inline(never)]
    pub fn say(&mut self, severity: MavSeverity, text: &[u8]) {
        if F::HAS_TEXTS {
            self.texts.push(self.now, self.shared.normal, severity, text);
        }
    }

    /// Returns the vehicle, and the context for its hooks.
    pub fn hook(&mut self) -> (&mut F::Vehicle, Context<'_>) {
        let context = Context {
            now: self.now,
            texts: self.texts,
            requests: self.requests,
            events: self.events,
            normal: self.shared.normal,
            plans: self.plans.as_ref(),
            values: self.parameters.values(),
            can_start: false,
        };
        (self.vehicle, context)
    }
}

/// The data that is available without the vehicle.
pub struct View<'a> {
    pub(crate) now: Instant,
    pub(crate) shared: &'a Shared,
    pub(crate) peers: &'a [PeerInfo],
    pub(crate) texts: &'a StatusTexts,
    pub(crate) requests: &'a Requests,
    pub(crate) events: &'a EventLog,
}

impl View<'_> {
    /// Returns the time, by the stack's clock.
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Returns the vehicle's address.
    pub fn address(&self) -> Address {
        self.shared.config.address.get()
    }
}

/// A frame that is addressed to us or to all.
pub struct Received<'a> {
    pub(crate) frame: &'a Frame<'a>,
    /// The sender, and the link on which it was received.
    pub(crate) from: Peer,
    /// The address to which it is sent.
    pub(crate) target: Address,
    /// How long ago it was signed, if that is known.
    pub(crate) age: Option<Duration>,
}

/// What a service did with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handled {
    /// The service does not handle its message.
    No,
    /// It was handled.
    Yes,
    /// There is no room for its answer, so it was dropped without effect. Counted.
    NoRoom,
    /// It does not belong on this link, or to this address. Counted.
    OutOfPlace,
}

/// A received command.
#[derive(Debug)]
pub struct Request {
    pub(crate) command: Command,
    /// The id in the answer.
    pub(crate) answer_as: MavCmd,
    /// SET_MODE.custom_mode, if the command was received as SET_MODE: a parameter cannot hold every number.
    pub(crate) set_mode: Option<u32>,
    /// Set by the stack.
    pub(crate) signed_at: SignedAt,
    /// No service has answered it: the streams then answer for a message that nobody knows.
    pub(crate) is_unclaimed: bool,
}

impl Request {
    /// Returns the command.
    pub const fn command(&self) -> &Command {
        &self.command
    }

    /// Whether it is MAV_CMD_REQUEST_MESSAGE for message `M`.
    pub fn asks_for<M: Message>(&self) -> bool {
        let [id, ..] = self.command.params;
        self.command.id == MavCmd::REQUEST_MESSAGE && num::integer(id) == Some(M::ID)
    }

    /// Whether the answer to a request may be sent on the link on which it was received. Otherwise it is DENIED.
    pub fn has_response_target(&self) -> bool {
        self.command.has_response_target()
    }
}

impl From<Command> for Request {
    fn from(command: Command) -> Self {
        Self { answer_as: command.id, command, set_mode: None, signed_at: None, is_unclaimed: false }
    }
}

/// The answer to a command.
#[derive(Clone, Copy, Debug)]
pub enum Verdict {
    /// The vehicle's answer, or one that needs no text.
    Done(Outcome),
    /// The stack refused the command: a text explains why.
    Refused(Refusal),
}

impl From<Outcome> for Verdict {
    fn from(outcome: Outcome) -> Self {
        Self::Done(outcome)
    }
}

impl Verdict {
    /// The vehicle's own answer, or one without a text.
    pub(crate) fn done(result: MavResult) -> Self {
        Self::Done(result.into())
    }

    /// ACCEPTED, or a refusal with a text that explains it.
    pub(crate) fn accepted(result: MavResult) -> Self {
        if result == MavResult::ACCEPTED { Self::done(result) } else { Self::Refused(result.into()) }
    }
}

impl From<MavResult> for Verdict {
    fn from(result: MavResult) -> Self {
        Self::done(result)
    }
}

impl Received<'_> {
    /// Returns the frame.
    pub const fn frame(&self) -> &Frame<'_> {
        self.frame
    }

    /// Returns the sender, and the link on which the frame was received.
    pub const fn from(&self) -> Peer {
        self.from
    }

    /// Returns the address to which the frame is sent: our system and component, or 0 for all.
    pub const fn target(&self) -> Address {
        self.target
    }

    pub(crate) fn origin(&self, port: &Port) -> Origin {
        Origin { from: self.from, class: port.config.class, age: self.age }
    }
}

/// Takes the counters of the services, to add them up or to log them.
pub trait ShowCounters {
    /// Takes counters that all links share.
    fn counters(&mut self, counters: &impl Counters);

    /// Takes counters of one link.
    fn counters_of(&mut self, link: LinkId, counters: &impl Counters);
}

/// Returns the sum of drop counters, which wrap.
#[cfg(feature = "defmt")]
pub(crate) fn sum<const N: usize>(counts: [u32; N]) -> u32 {
    counts.into_iter().fold(0, u32::wrapping_add)
}
