//! The services that a vehicle offers to its peers, and how to write one.
//!
//! Each service is a type that implements [`Service`]. Received frames and commands change its state.
//! [`pending`](Service::pending) returns the next frame to send and when it is due. [`send`](Service::send) sends it when the link has
//! room. A pending answer is a flag, a cursor or a slot, never bytes, so a full link delays it and never loses it (D-3). [`Turn`] is the
//! order in which the services send.
//!
//! A service is a field of the struct with [`#[derive(Stack)]`](macro@crate::Stack), whichever crate it is from:
//!
//! ```
//! use mavstack::dialect::{MavResult, NamedValueInt, PlayTune};
//! use mavstack::service::{About, Cx, Firmware, Handled, Port, Received, Service, Turn, View};
//! use mavstack::{Instant, Message, Text};
//!
//! /// Counts the tunes that peers send, and answers with the count.
//! #[derive(Debug)]
//! pub struct Tunes {
//!     received: u32,
//! }
//!
//! impl<F: Firmware> Service<F> for Tunes {
//!     /// Whether the link owes an answer.
//!     type Link = bool;
//!     /// There is one kind of frame, so its reply has no name.
//!     type Reply = ();
//!     const NEW: Self = Self { received: 0 };
//!     const VACANT: bool = false;
//!     const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::Answer]);
//!
//!     fn on_frame(&mut self, _: &mut Cx<'_, F>, _: &mut Port, is_owed: &mut bool, received: &Received<'_>) -> Handled {
//!         if received.frame().id() != PlayTune::ID {
//!             return Handled::No;
//!         }
//!         self.received = self.received.wrapping_add(1);
//!         *is_owed = true;
//!         Handled::Yes
//!     }
//!
//!     fn pending(&self, view: &View<'_>, _: &Port, is_owed: &bool, _: Turn) -> Option<(Instant, ())> {
//!         is_owed.then_some((view.now(), ()))
//!     }
//!
//!     fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, is_owed: &mut bool, (): ()) -> bool {
//!         *is_owed = false;
//!         port.send(&NamedValueInt {
//!             time_boot_ms: cx.now().time_boot_ms(),
//!             value: self.received.cast_signed(),
//!             name: Text::new("TUNES"),
//!         })
//!     }
//! }
//! # struct Rover;
//! # impl mavstack::Vehicle for Rover { fn state(&self) -> Option<mavstack::VehicleState> { None } }
//! # impl mavstack::Commands for Rover {
//! #     fn command(&mut self, _: &mut mavstack::Context<'_>, _: &mavstack::Command) -> mavstack::Outcome { MavResult::UNSUPPORTED.into() }
//! # }
//!
//! #[derive(mavstack::Stack)]
//! #[stack(vehicle: Rover, links: 2)]
//! struct Mavlink {
//!     tunes: Tunes,
//! }
//! ```
//!
//! The crate `mavstack-traffic` is a whole one, with hooks of the vehicle, commands, timers, counters and tests.

mod context;
mod gate;
mod list;
mod rate_limit;
mod request;
mod turn;
mod write_schedule;

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
pub(crate) mod holder;
pub(crate) mod identity;
pub(crate) mod log_streaming;
pub(crate) mod logs;
pub(crate) mod manual_control;
pub(crate) mod mission;
pub(crate) mod mode;
pub(crate) mod operator_control;
pub(crate) mod param;
#[cfg(test)]
pub(crate) mod rest;
pub(crate) mod setpoints;
#[cfg(feature = "signing")]
pub(crate) mod signing;
pub(crate) mod statustext;
pub(crate) mod stream;
pub(crate) mod time;

pub(crate) use context::RETRY;
pub(crate) use context::Shared;
pub use context::{Cx, View};
#[doc(hidden)]
pub use gate::{
    Absent, ControlGate, Examined, ForwardingGate, OwnCommands, OwnRequest, SigningGate, SticksGate, WithoutSigning,
};
#[doc(hidden)]
pub use list::{Look, LookAll, ServiceList, Visit, VisitAll};
pub(crate) use rate_limit::{BULK_PERCENT, MAX_LATENESS, RateLimit, cost};
pub use request::{Handled, Received, Request, Verdict};
#[cfg(test)]
pub(crate) use turn::TABLE;
pub use turn::Turn;
pub(crate) use turn::turns;

use crate::dialect::MavProtocolCapability;
pub use crate::link::Port;
pub use crate::log::Counters;
pub(crate) use crate::log::increment;
use crate::message::{ComponentId, SystemId};
use crate::time::{Duration, Instant};
pub use crate::types::Firmware;
use crate::types::{Config, LinkId, Peer};

/// A service of the firmware `F`. It calls the hooks of the firmware's vehicle.
///
/// A call for a link gets the link's port and the service's own state on that link. Methods that are left out compile to nothing.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no service of this vehicle",
    label = "a field of a stack is a service",
    note = "if it is one, the vehicle does not implement its hooks"
)]
pub trait Service<F: Firmware>: Sized {
    /// The service's state on a link.
    type Link: core::fmt::Debug;

    /// The initial state on a link, as [`NEW`](Self::NEW).
    const VACANT: Self::Link;

    /// The compile-time facts about the service.
    const ABOUT: About = About::AUTOPILOT;

    /// Fails to compile if the sizes of the service, or the constants of its hooks, are wrong.
    const CHECK: () = ();

    /// The initial service. Let all its bits be zero: anything else puts the initial value of the whole stack into flash. Other values
    /// are set at [`StackEvent::Begun`].
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

    /// Handles a frame that is addressed to us or to all, if the service handles its message. The first service that handles a frame
    /// gets it alone, and the parts of the stack are asked before the fields: two services must not handle the same message.
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

    /// Executes a command, or refuses it. Returns `None` if the service does not handle the command: then the next service is asked, as
    /// for frames, and at last the vehicle.
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

    /// A frame that the service sends: an enum with a name for each kind.
    type Reply;

    /// Returns the frame that is pending in this turn, which is one of [`ABOUT`](Self::ABOUT)'s, and when it is due:
    /// [`View::now`] or an earlier time if it is due at once, `None` or [`Instant::NEVER`] if none is. It changes
    /// nothing, and is called often.
    fn pending(&self, view: &View<'_>, port: &Port, link: &Self::Link, turn: Turn) -> Option<(Instant, Self::Reply)> {
        let _ = (view, port, link, turn);
        None
    }

    /// Puts the frame that [`pending`](Self::pending) has returned into the link's outbox, which is empty. If the
    /// vehicle cannot give it, it returns false, and changes the state so that the same is not pending at once: a
    /// firmware that sleeps until [`next_deadline`](crate::Stack::next_deadline) would never sleep.
    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut Self::Link, reply: Self::Reply) -> bool {
        let _ = (cx, port, link, reply);
        false
    }

    /// Handles an event of the stack, also while the service's component is left out. Most services ignore all of them.
    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        let _ = event;
    }

    /// Shows the service's counters.
    fn counters(&self, show: &mut impl ShowCounters) {
        let _ = show;
    }
}

/// Compile-time facts about a service.
#[derive(Clone, Copy, Debug)]
pub struct About {
    /// The places of the service in the sending order of a link.
    pub turns: &'static [Turn],
    /// The capabilities that the service adds to AUTOPILOT_VERSION (Q-9).
    pub capabilities: MavProtocolCapability,
    /// The component whose frames and commands the service gets, besides those for all components.
    pub part: Part,
    /// Whether the service is left out with the other components of the firmware: it is one of them, or serves only them.
    pub is_of_components: bool,
    /// Whether peers on one link may hold what peers on others wait for: the service gets [`StackEvent::Stalled`].
    pub holds: bool,
}

impl About {
    /// A service that is a part of the autopilot, without a capability, and that sends nothing.
    pub const AUTOPILOT: Self = Self {
        turns: &[],
        capabilities: MavProtocolCapability::EMPTY,
        part: Part::Autopilot,
        is_of_components: false,
        holds: false,
    };

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
    pub const fn of(component: Option<ComponentId>) -> Self {
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

/// An event for services, besides frames and commands. `L` is the state of the service on a link.
#[derive(Debug)]
pub enum StackEvent<'a, L> {
    /// The stack begins: sets the initial values that are not zero bits.
    Begun(&'a Config),
    /// The link was opened again: pending answers that mean nothing to the new peers are discarded.
    Opened(&'a Port, &'a mut L),
    /// The link has had something to send for ten seconds and has taken no byte: what its peers hold is free for others (X-3).
    /// Only for a service with [`About::holds`], and not for a high-latency link, whose modem may be busy for longer.
    Stalled(&'a Port, &'a mut L),
    /// A frame was accepted, whatever its message.
    Heard {
        /// The time.
        now: Instant,
        /// The sender.
        from: Peer,
    },
    /// Another system is in control, besides our own: setpoints and settings of others end.
    NewOwner {
        /// The vehicle's system.
        own: SystemId,
        /// The system in control.
        owner: SystemId,
    },
    /// The firmware's clock was set back by a second or more (X-7), and the stack's is ahead of it by this time from
    /// now on. Times that the service has stored by the firmware's clock, instead of the stack's, are void.
    ClockSetBack(Duration),
    /// Any service has put a frame into the link's outbox.
    Sent(&'a Port, &'a mut L),
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
