//! The methods of the peer table, and of single parts: each can be called only if its part is declared.

use super::{Declares, Memory, Stack};
use crate::message::{Message, SystemId};
use crate::network::{ForwardCounters, PeerInfo};
use crate::service::ForwardingGate;
use crate::service::client::{Client, CommandClient, check};
use crate::service::command::{CommandSlots, LongCommands};
use crate::service::events::{Event, EventCounters, EventService, record};
use crate::service::files::{FileServer, FileStatus};
use crate::service::forwarding::Forwarding;
use crate::service::holder::ControlSource;
use crate::service::logs::LogServer;
use crate::service::manual_control::ManualInput;
use crate::service::mission::Missions;
use crate::service::operator_control::OperatorControl;
use crate::service::param::ParamTable;
#[cfg(feature = "signing")]
use crate::service::signing::{Signing, SigningStream};
use crate::service::stream::{FillHistory, Messages, Stream, StreamService, Telemetry, id_of};
#[cfg(feature = "storage")]
use crate::storage::Storage;
use crate::time::Instant;
use crate::types::{Destination, LinkId, Pending, Recipient};

/// Defines a trait for each entry of `#[stack]` that has methods: its service implements it, and gives a firmware access to a part of
/// itself. [`Absent`](crate::service::Absent) does not, and the compiler says which entry is missing.
macro_rules! declared {
    ($($(#[$meta:meta])* $declared:ident [$($generic:tt)*] $service:ty => $part:ty $(, $field:ident)?: $missing:literal;)*) => { $(
        $(#[$meta])*
        #[diagnostic::on_unimplemented(message = $missing, label = "this stack does not declare it")]
        pub trait $declared {
            type Part: ?Sized;
            fn part(&self) -> &Self::Part;
            fn part_mut(&mut self) -> &mut Self::Part;
        }

        $(#[$meta])*
        impl<$($generic)*> $declared for $service {
            type Part = $part;

            fn part(&self) -> &$part {
                &(*self)$(.$field)?
            }

            fn part_mut(&mut self) -> &mut $part {
                &mut (*self)$(.$field)?
            }
        }
    )* };
}

declared! {
    HasCommands [const N: usize] CommandSlots<N> => LongCommands: "`commands: {{ slots: 2 }}` is missing in `#[stack]`";
    HasClient [const N: usize] Client<N> => Self: "`command_client: {{ slots: 2 }}` is missing in `#[stack]`";
    HasEvents [C] EventService<C> => EventCounters, counters: "`events: {{ history: 16 }}` is missing in `#[stack]`";
    HasFiles [const N: usize, const UPLOAD: usize, V] FileServer<N, UPLOAD, V> => FileStatus, status:
        "`files: {{ sessions: 2 }}` is missing in `#[stack]`";
    HasForwarding [const N: usize, const BYTES: usize, const SEEN: usize] Forwarding<N, BYTES, SEEN> => Self:
        "`forwarding` is missing in `#[stack]`";
    HasLogs [] LogServer => Self: "`logs` is missing in `#[stack]`";
    HasManualControl [] ManualInput => Self: "`manual_control` is missing in `#[stack]`";
    HasMessages [] Messages => Self: "`messages` is missing in `#[stack]`";
    HasPlans [] Missions => Self: "`plans: {{ mission: 100 }}` is missing in `#[stack]`";
    #[cfg(feature = "storage")]
    HasStorage [] Storage => Self: "`storage` is missing in `#[stack]`";
    HasOperatorControl [] OperatorControl => Self: "`operator_control` is missing in `#[stack]`";
    #[cfg(feature = "signing")]
    HasSigning [const N: usize] Signing<[SigningStream; N]> => Signing: "`signing` is missing in `#[stack]`";
    HasStreams [const N: usize] StreamService<N> => FillHistory, history: "`streams` is missing in `#[stack]`";
}

/// The peers that were heard, and whether a ground station is alive (H-11, H-18).
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the peers that were heard, as they are at `now`, with their link quality: at most as many as `peers` in
    /// [`#[stack]`](macro@crate::Stack) declares. [`PeerInfo`](PeerInfo#eviction-from-a-full-table) says which peer is evicted
    /// when the table is full.
    pub fn peers(&self, now: Instant) -> impl Iterator<Item = PeerInfo> {
        let (clock, timeout) = (self.shared.clock, self.config().peer_timeout);
        let now = clock.peek(now);
        self.peers.view().iter().map(move |info| info.at(now, timeout, &clock))
    }

    /// Whether any ground station is alive at `now`: it has sent a heartbeat of type GCS within
    /// [`peer_timeout`](crate::Config::peer_timeout), on any link but a high-latency one (H-11). A station with two links is
    /// alive while one of them works. The answer does not depend on the last [`poll`](Self::poll) (H-18).
    ///
    /// Ask in each pass of the loop, after [`poll`](Self::poll), for the failsafe of a vehicle that any station may fly.
    /// [`has_controller`](Self::has_controller) is for one that a certain station flies. [`Vehicle::peer`](crate::Vehicle::peer) is called for each
    /// peer on each link: use it for texts and for a display, because `Lost` there may be only one of two links.
    pub fn has_ground_station(&self, now: Instant) -> bool {
        self.has_controller(now, ControlSource::GroundStation)
    }

    /// Whether a ground station in control is alive at `now`, on any link: as [`has_ground_station`](Self::has_ground_station), but only
    /// the stations of `source` count. Take the source that the vehicle permits to command and to steer, for example the
    /// [source of manual control](crate::manual_control::ManualInput::source). Other components of such a system do not count:
    /// an antenna tracker may outlive its station.
    ///
    /// ```
    /// use mavstack::manual_control::ControlSource;
    /// use mavstack::message::SystemId;
    /// # use mavstack::prelude::*;
    /// # use mavstack::dialect;
    /// # struct Rover { is_stopped: bool }
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
    /// # }
    /// # #[derive(Stack)]
    /// # #[stack(vehicle: Rover, links: 2)]
    /// # struct Mavlink;
    /// /// Called in each pass of the loop.
    /// fn failsafe(stack: &StackOf<Mavlink>, now: Instant, rover: &mut Rover) {
    ///     if !stack.has_controller(now, ControlSource::System(SystemId::new(255))) {
    ///         rover.is_stopped = true;
    ///     }
    /// }
    /// ```
    pub fn has_controller(&self, now: Instant, source: ControlSource) -> bool {
        source.is_alive(self.peers(now))
    }
}

/// Available if `#[stack]` has the entry `commands: { slots: N }`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the long-running commands.
    pub fn long_commands(&self) -> &LongCommands
    where
        D::Commands: HasCommands<Part = LongCommands>,
    {
        self.services.command.slots.part()
    }

    /// Returns the long-running commands, to report their progress and their end.
    pub fn long_commands_mut(&mut self) -> &mut LongCommands
    where
        D::Commands: HasCommands<Part = LongCommands>,
    {
        self.services.command.slots.part_mut()
    }
}

/// Available if `#[stack]` has the entry `parameters: T`.
impl<D: Declares<Parameters: ParamTable>, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the parameters.
    pub fn parameters(&self) -> &D::Parameters {
        &self.parameters
    }

    /// Returns the parameters, for the vehicle to set. Ground stations are informed of each change.
    pub fn parameters_mut(&mut self) -> &mut D::Parameters {
        &mut self.parameters
    }
}

/// Available if `#[stack]` has the entry `manual_control`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns manual control: the sticks and channels of a pilot on the ground.
    pub fn manual_input(&self) -> &ManualInput
    where
        D::ManualControl: HasManualControl<Part = ManualInput>,
    {
        self.services.manual_control.part()
    }

    /// Returns manual control, to set the senders that may steer.
    pub fn manual_input_mut(&mut self) -> &mut ManualInput
    where
        D::ManualControl: HasManualControl<Part = ManualInput>,
    {
        self.services.manual_control.part_mut()
    }
}

/// Available if `#[stack]` has the entry `operator_control`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the system in control at `now`; `None` if nobody is. An owner whose ground stations have all timed out is not in
    /// control, unless [control is kept](OperatorControl::set_release_on_loss). The answer does not depend on the last
    /// [`poll`](Self::poll) (H-18).
    pub fn operator(&self, now: Instant) -> Option<SystemId>
    where
        D::OperatorControl: HasOperatorControl<Part = OperatorControl>,
    {
        self.services.operator_control.part().operator(self.peers(now))
    }

    /// Returns whether a request for control that is received at `now` is granted.
    pub fn allows_takeover(&self, now: Instant) -> bool
    where
        D::OperatorControl: HasOperatorControl<Part = OperatorControl>,
    {
        self.services.operator_control.part().allows_takeover() || self.operator(now).is_none()
    }

    /// Returns the service of operator control: its configuration and its counters.
    pub fn operator_control(&self) -> &OperatorControl
    where
        D::OperatorControl: HasOperatorControl<Part = OperatorControl>,
    {
        self.services.operator_control.part()
    }

    /// Returns the service of operator control, to configure it or to release control.
    pub fn operator_control_mut(&mut self) -> &mut OperatorControl
    where
        D::OperatorControl: HasOperatorControl<Part = OperatorControl>,
    {
        self.services.operator_control.part_mut()
    }
}

/// Available if `#[stack]` has the entry `files: { sessions: N, upload: N }`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the status of the file service, which has its counters.
    pub fn files(&self) -> &FileStatus
    where
        D::Files: HasFiles<Part = FileStatus>,
    {
        self.services.files.part()
    }
}

/// Available if `#[stack]` has the entry `logs`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the service of log downloads, which has its counters.
    pub fn logs(&self) -> &LogServer
    where
        D::Logs: HasLogs<Part = LogServer>,
    {
        self.services.logs.part()
    }
}

/// Available if `#[stack]` has the entry `forwarding`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the counters of forwarding on a link; `None` if there is no such link.
    pub fn forward_counters(&self, link: LinkId) -> Option<ForwardCounters>
    where
        D::Forwarding: HasForwarding,
    {
        self.services.forwarding.link_counters(link)
    }
}

/// Available if `#[stack]` has the entry `signing`.
#[cfg(feature = "signing")]
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the state of signing: the key, the time, and the counters.
    pub fn signing(&self) -> &Signing
    where
        D::Signing: HasSigning<Part = Signing>,
    {
        self.services.signing.part()
    }

    /// Returns the state of signing, to set the key and the time.
    pub fn signing_mut(&mut self) -> &mut Signing
    where
        D::Signing: HasSigning<Part = Signing>,
    {
        self.services.signing.part_mut()
    }
}

/// Available if `#[stack]` has the entry `streams`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Sends message `M`, all its instances, once on every normal link, whatever its interval there: for content that has
    /// changed and must not wait for its turn, such as HOME_POSITION when home is set (O-6). The next [`poll`](Self::poll)
    /// takes it up. It is filled when the link has room, and left out if the vehicle cannot [fill](Telemetry::fill) it
    /// then. A message that is announced again before that is sent once.
    ///
    /// `M` must be one of the vehicle's [`STREAMS`](Telemetry::STREAMS); otherwise this does not compile:
    ///
    /// ```
    /// # use mavstack::dialect::{HomePosition, MavResult};
    /// # use mavstack::prelude::*;
    /// # struct Rover;
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
    /// # }
    /// impl Telemetry for Rover {
    ///     const STREAMS: &'static [Stream] = &[Stream::of::<HomePosition>()];
    /// #   fn fill(&mut self, _: u32, out: &mut Fill<'_>) -> bool { out.put(&HomePosition::default()) }
    /// }
    /// #[derive(Stack)]
    /// #[stack(vehicle: Rover, links: 2, streams)]
    /// struct Mavlink;
    ///
    /// fn on_home_set(stack: &mut StackOf<Mavlink>) {
    ///     stack.announce::<HomePosition>();
    /// }
    /// ```
    pub fn announce<M: Message>(&mut self)
    where
        D::Stream: HasStreams,
        D::Vehicle: Telemetry,
    {
        self.requests.view_mut().announced |= const { Stream::rows_of::<M>(<D::Vehicle as Telemetry>::STREAMS) };
    }

    /// Returns the streams that have been due and were never [filled](Telemetry::fill) so far. On a bench where everything is measured
    /// it is empty: otherwise the vehicle declares a message that `fill` has forgotten, and no ground station gets it.
    /// [`counters`](Self::counters) shows their number, as `never_filled`.
    pub fn streams_never_filled(&self) -> impl Iterator<Item = &'static Stream>
    where
        D::Stream: HasStreams<Part = FillHistory>,
        D::Vehicle: Telemetry,
    {
        self.services.stream.part().streams_never_filled(<D::Vehicle as Telemetry>::STREAMS)
    }
}

/// Available if `#[stack]` has the entry `messages`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Sends message `M` when a link of `to` has room: see [`Context::send`](crate::Context::send).
    #[must_use = "it is not sent if the link has no room"]
    pub fn send<M: Message>(&mut self, to: impl Into<Destination>, index: u16) -> bool
    where
        D::Messages: HasMessages,
        D::Vehicle: Telemetry,
    {
        self.requests.view_mut().send(self.shared.normal, const { id_of::<M>() }, to.into(), index)
    }

    /// Returns the number of the vehicle's messages that a link had no room for. Wraps.
    pub fn refused_messages(&self, link: LinkId) -> u32
    where
        D::Messages: HasMessages,
        D::Vehicle: Telemetry,
    {
        self.requests.view().refused_on(link)
    }
}

/// Available if `#[stack]` has the entry `events: { history: N }`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Records an event that [`events!`](crate::events!) has declared, and sends it on every normal link: see
    /// [`Context::event`](crate::Context::event).
    pub fn event<E: Event>(&mut self, now: Instant, event: &E)
    where
        D::Events: HasEvents<Part = EventCounters>,
    {
        record(self.events.view_mut(), now, event);
    }

    /// Returns the counters of the events.
    pub fn event_counters(&self) -> EventCounters
    where
        D::Events: HasEvents<Part = EventCounters>,
    {
        *self.services.events.part()
    }
}

/// Available if `#[stack]` has the entry `command_client: { slots: N }`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Sends a command to another component: see [`Context::send_command`](crate::Context::send_command).
    #[must_use = "it is not sent if too many commands wait"]
    pub fn send_command(&mut self, to: impl Into<Recipient>, token: u16) -> bool
    where
        D::Client: HasClient,
        D::Vehicle: CommandClient,
    {
        self.requests.view_mut().request(Pending::Command { to: to.into(), token })
    }

    /// Reads a parameter of another component: see [`Context::read_param`](crate::Context::read_param).
    #[must_use = "it is not read if too many requests wait"]
    pub fn read_param(&mut self, to: impl Into<Recipient>, token: u16) -> bool
    where
        D::Client: HasClient,
        D::Vehicle: CommandClient,
    {
        const { check::<D::Vehicle>() };
        self.requests.view_mut().request(Pending::Param { to: to.into(), token, is_ext: false })
    }

    /// Reads an extended parameter of another component: see [`Context::read_ext_param`](crate::Context::read_ext_param).
    #[must_use = "it is not read if too many requests wait"]
    pub fn read_ext_param(&mut self, to: impl Into<Recipient>, token: u16) -> bool
    where
        D::Client: HasClient,
        D::Vehicle: CommandClient,
    {
        const { check::<D::Vehicle>() };
        self.requests.view_mut().request(Pending::Param { to: to.into(), token, is_ext: true })
    }

    /// Cancels a command: see [`Context::cancel_sent_command`](crate::Context::cancel_sent_command).
    #[must_use = "it is not cancelled if too many commands wait"]
    pub fn cancel_sent_command(&mut self, token: u16) -> bool
    where
        D::Client: HasClient,
        D::Vehicle: CommandClient,
    {
        self.requests.view_mut().request(Pending::Cancel { token })
    }

    /// Returns the number of requests to other components for which there was no room. Wraps.
    pub fn refused_requests(&self) -> u32
    where
        D::Client: HasClient,
        D::Vehicle: CommandClient,
    {
        self.requests.view().refused_requests()
    }
}
