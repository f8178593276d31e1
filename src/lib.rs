//! The autopilot's side of MAVLink for microcontrollers: no `std`, no allocation, beside the flight loop.
//!
//! A firmware declares its stack with [`#[stack]`](macro@Stack), and calls it from its loop. The [`Stack`](struct@Stack) owns all its memory. Its calls never
//! block, and do a bounded amount of work. Time is an argument. There is no clock, no global state and no lock inside, so the same
//! input at the same time gives the same output.
//!
//! ```
//! use mavstack::dialect::commands::ComponentArmDisarm;
//! use mavstack::dialect::rules::{NAV_RETURN_TO_LAUNCH, NAV_WAYPOINT};
//! use mavstack::dialect::{MavResult, MavSeverity, MissionState};
//! use mavstack::prelude::*;
//! # use std::convert::Infallible;
//! # struct Uart;
//! # impl embedded_io::ErrorType for Uart { type Error = Infallible; }
//! # impl embedded_io::Read for Uart { fn read(&mut self, _: &mut [u8]) -> Result<usize, Infallible> { Ok(0) } }
//! # impl embedded_io::ReadReady for Uart { fn read_ready(&mut self) -> Result<bool, Infallible> { Ok(false) } }
//! # impl embedded_io::Write for Uart {
//! #     fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> { Ok(bytes.len()) }
//! #     fn flush(&mut self) -> Result<(), Infallible> { Ok(()) }
//! # }
//! # impl embedded_io::WriteReady for Uart { fn write_ready(&mut self) -> Result<bool, Infallible> { Ok(true) } }
//! # let mut uart = Uart;
//! # let clock = || Instant::ZERO;
//! static PULSE: Pulse = Pulse::new();
//! const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
//! const TELEM: LinkId = LinkId(0);
//!
//! #[derive(Stack)]
//! #[stack(vehicle: Rover, links: 1, plans: { mission: 100 })]
//! struct Mavlink;
//!
//! struct Rover { armed: bool }
//!
//! impl Vehicle for Rover {
//!     fn state(&self) -> Option<VehicleState> {
//!         Some(VehicleState::new(self.armed))
//!     }
//! }
//!
//! impl Commands for Rover {
//!     fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
//!         // An error is UNSUPPORTED for another command, and DENIED for invalid parameters.
//!         match command.decode() {
//!             Ok(ComponentArmDisarm { arm, .. }) if !command.is_broadcast => self.armed = arm,
//!             Ok(_) => return MavResult::DENIED.into(),
//!             Err(result) => return result.into(),
//!         }
//!         cx.text(MavSeverity::INFO, if self.armed { "Armed" } else { "Disarmed" });
//!         MavResult::ACCEPTED.into()
//!     }
//! }
//!
//! impl Plans for Rover {
//!     const MISSION_COMMANDS: &'static [CommandRule] = &[NAV_WAYPOINT, NAV_RETURN_TO_LAUNCH];
//!
//!     fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}
//!
//!     fn progress(&self) -> Progress {
//!         Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
//!     }
//! }
//!
//! let mut vehicle = Rover { armed: false };
//! let mut stack = StackOf::<Mavlink>::new(CONFIG, [LinkConfig::uart(57_600)]);
//! loop {
//!     let now = clock();
//!     // … sensors, control, motors; `stack.mission().items()` is the live mission
//!     PULSE.tick(); // without ticks, no heartbeats
//!     stack.poll(now, &mut vehicle);
//!     if let Err(error) = stack.poll_link(now, TELEM, &mut uart, &mut vehicle) {
//!         let _ = error; // count or show it: the link keeps working
//!     }
//! #   break;
//! }
//! ```
//!
//! On a microcontroller, put the stack into a `static` and start it in place by [`begin`](Stack::begin): see
//! [`#[stack]`](macro@Stack#in-a-static).
//!
//! # Layers
//!
//! | layer | contents |
//! |---|---|
//! | [`mod@frame`] | bytes to checked frames and back, MAVLink 1 and 2; usable alone |
//! | [`mod@message`], [`mod@dialect`] | payloads: all of MAVLink's `common`, and your own messages; usable alone |
//! | [`mod@config`], [`mod@network`] | the links, the peers on them, and forwarding between links |
//! | [`mod@command`], [`mod@plan`], [`mod@param`], [`mod@clock`], [`mod@manual_control`], [`mod@setpoints`], [`mod@operator_control`], [`mod@camera`], [`mod@ext_parameters`], [`mod@events`], [`mod@gimbal`], [`mod@files`], [`mod@logs`], [`mod@high_latency`], `signing` | the services, besides the traits below |
//! | [`Stack`](struct@Stack) | all of it behind [`poll`](Stack::poll) and [`poll_link`](Stack::poll_link) |
//! | [`mod@io`], `storage` | transports between the stack and a UART; flash and FRAM |
//!
//! [`mod@telemetry`] makes telemetry messages from SI values. [`wpl`] reads and writes plans as files. With the feature `fmt`, `metadata` writes the files from which ground stations take the
//! units and ranges of parameters.
//!
//! # The vehicle
//!
//! A vehicle implements a trait for each part of it that the stack calls: [`Vehicle`] and [`Commands`] always, [`Plans`],
//! [`Telemetry`], [`Modes`], [`Parameters`] and others with their entries. [The list](guides::vehicle#hooks) names all, and the
//! documentation of each trait has an example.
//!
//! [`#[stack]`](macro@Stack) lists all entries of a declaration. Services that a firmware does not declare take neither
//! flash nor RAM. Hooks get a
//! [`Context`]: it has the time, the live plans and the parameters, and it queues texts and events and announces messages.
//!
//! # The transport
//!
//! [`poll_link`](Stack::poll_link) takes any `embedded_io::{Read, Write, ReadReady, WriteReady}`. [`mod@io`] has such a type for a
//! UART with an interrupt, a reader for circular DMA buffers, and adapters for HALs with other traits. The byte-level calls
//! [`receive`](Stack::receive) and [`transmit`](Stack::transmit) are for everything else.
//!
//! # Guides
//!
//! - [Start](guides::start): from a UART and a clock to a vehicle that a ground station shows as ready, step by step.
//! - [Transports](guides::transports): UART interrupts, DMA, USB, UDP and async tasks, and the needs of each HAL.
//! - [The vehicle](guides::vehicle): all hooks, by task; [tasks and safety](guides::tasks): flight in a task of its own, and the
//!   watchdog. [Troubleshooting](guides::troubleshooting) has symptoms and their causes.
//! - [Storage](guides::storage): choosing a region, where the erases run, wear, and recipes for families of flash.
//! - [Testing](guides::testing): tests of your vehicle on your machine, with a ground station, faulty lines and power cuts.
//! - [Ground stations](guides::ground_stations): connecting them to the demo vehicle, and the quirks of each.
//! - [Features](guides::features): supported features, service by service.
//! - [Sizing](guides::sizing): bytes of flash and RAM, option by option; [figures](guides::figures): speed, work, stack, bad lines.
//! - [Coming from rust-mavlink, mavio or the C library](guides::coming_from): what you wrote there, what you write here.
//! - [Architecture](guides::architecture) on one page, [what is proven and what is not](guides::safety), and
//!   [each rule of behaviour](guides::conformance).
//!
//! # Guarantees
//!
//! - No `unsafe`, no allocation, no recursion. Received bytes cannot cause a panic.
//! - [`poll_link`](Stack::poll_link) calls the transport only when it will not block, and stays within its
//!   [budget](config::PollBudget).
//! - A request that is carried out is answered: a full transmit buffer delays the answer, and never loses it. A request is dropped
//!   unexecuted, and counted, when there is no memory for its answer.
//! - Heartbeats stop when the flight loop stops ticking its [`Pulse`], whatever else still runs.
//! - A plan is replaced as a whole or not at all.
//!
//! Ids such as S-13 name the rules of behaviour. [Conformance](guides::conformance) lists them.
//!
//! # Cargo features
//!
//! [The first guide](guides::start#1-the-package) lists them. Without any, there is no storage, no signing, and no `core::fmt`.
#![no_std]
// No received byte causes a panic (SEC-1).
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::arithmetic_side_effects,
        clippy::as_conversions
    )
)]

#[cfg(test)]
extern crate std;

// The derive macro names the crate by its name, also in the tests of the crate itself.
#[cfg(test)]
extern crate self as mavstack;

// The blocks of Rust in the guides are quoted from `examples/guide`, which is compiled and tested.
#[cfg(all(doc, not(doctest)))]
pub mod guides;

#[macro_use]
mod log;
mod crc;
mod crc32;
pub mod dialect;
pub mod frame;
pub mod io;
mod link;
mod list;
pub mod message;
#[cfg(feature = "fmt")]
pub mod metadata;
pub mod network;
mod num;
mod pulse;
pub mod service;
mod stack;
#[cfg(feature = "storage")]
pub mod storage;
pub mod telemetry;
mod time;
mod types;
pub mod wpl;

#[doc(inline)]
pub use frame::Frame;
/// Declares the stack of a vehicle: its services, with all their memory.
///
/// ```
/// # use mavstack::prelude::*;
/// # use mavstack::{clock, high_latency, parameters, setpoints};
/// # use mavstack::dialect::*;
/// # pub struct Quadrotor;
/// # impl Vehicle for Quadrotor { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Quadrotor {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
/// # }
/// # impl Plans for Quadrotor {
/// #     const MISSION_COMMANDS: &'static [CommandRule] = &[];
/// #     fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}
/// #     fn progress(&self) -> Progress {
/// #         Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
/// #     }
/// # }
/// # impl Telemetry for Quadrotor {
/// #     const STREAMS: &'static [Stream] = &[];
/// #     fn fill(&mut self, _: u32, _: &mut Fill<'_>) -> bool { false }
/// # }
/// # impl Parameters for Quadrotor { type Table = Tuning; }
/// # parameters! { pub struct Tuning { A: i32 = 0, 0..=1, ""; } }
/// #[derive(Stack)]
/// #[stack(
///     vehicle: Quadrotor,
///     links: 2,
///     plans: { mission: 250, fence: 64, rally: 16 },
///     parameters: Tuning,
///     streams,
///     commands: { slots: 2 },
///     forwarding: { bytes: 512, seen: 256 },
///     manual_control,
///     operator_control,
/// )]
/// pub struct Mavlink {
///     pub time: clock::Time,
///     pub setpoints: setpoints::Setpoints,
///     pub high_latency: high_latency::HighLatency,
/// }
///
/// static PULSE: Pulse = Pulse::new();
/// let mut stack = StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600); 2]);
/// stack.poll(Instant::ZERO, &mut Quadrotor);
/// ```
///
/// The stack itself is [`StackOf<Mavlink>`](StackOf), which has the methods. A service that is not declared is not
/// linked and takes no memory, and its hook need not be implemented.
///
/// The attribute names the parts of the stack that other parts rely on. The fields of the struct are its other services: those of the
/// library that are listed below, those of other crates (`traffic: Traffic<16>`), and the firmware's own; see [`service`]. A stack derefs
/// to the struct, so `stack.setpoints` is the service.
///
/// The vehicle must be as visible as the struct: a `pub struct Mavlink` needs a `pub struct Rover`, or the compiler reports a private
/// type in a public interface (E0446). A mistake is reported at its entry or field, also by `cargo check`.
///
/// | entry | declares | by default | hook |
/// |---|---|---|---|
/// | `vehicle: T` | the type that implements the hooks | must be given | [`Vehicle`], [`Commands`] |
/// | `links: N` | links, 1 to 16 | must be given | |
/// | `plans: { mission: N, fence: N, rally: N }` | items of each [plan](crate::Plans); `fence` and `rally` may be left out | none | [`Plans`] |
/// | `parameters: T` | a table made by [`parameters!`](crate::parameters), or a [`RuntimeTable<N>`](crate::param::RuntimeTable) that is filled at start | none | [`Parameters`] |
/// | `parameters: ExternalParams<N>` | up to `N` parameters that [live elsewhere](crate::param::ExternalParams) | none | [`ParamBackend`] |
/// | `streams` | [telemetry](crate::Telemetry), one slot for each of the vehicle's streams | none | [`Telemetry`] |
/// | `messages` | [messages of the vehicle's own](crate::Context::send): room for eight on each link | none | [`Telemetry`] |
/// | `modes` | [flight modes](crate::Modes) | none | [`Modes`] |
/// | `commands: { slots: N }` | slots for long-running [commands](crate::command::LongCommands), and for those that must not run twice | none | |
/// | `command_client: { slots: N }` | [requests of the vehicle](crate::CommandClient) to other components, commands and parameters, `N` at a time | none | [`CommandClient`] |
/// | `components` | other [components](crate::Components) of the firmware: a gimbal, a camera | none | [`Components`] |
/// | `events: { history: N }` | [events](mod@crate::events) that ground stations receive without a gap, the last `N` of them kept (36 bytes each) | none | |
/// | `events: { history: N, checks }` | also the checks before arming, reported as events; `N` is at least 8 | none | [`HealthChecks`] |
/// | `manual_control` | [manual control](crate::manual_control::ManualInput) | none | |
/// | `operator_control` | [operator control](crate::operator_control::OperatorControl): which ground station is in control | none | |
/// | `files: { sessions: N, upload: N }` | [files](crate::Files) by FTP, all parameters in one, and plans as files: files open at a time, and bytes of the largest upload of parameters, at least 276 with plans; without `upload` parameters and plans are not written that way | none | [`Files`] |
/// | `logs` | downloads of [flight logs](crate::Logs) | none | [`Logs`] |
/// | `forwarding: { bytes: N, seen: N }` | [forwarding](crate::network::ForwardQueues): bytes of each link's queue, frames remembered for duplicate detection; `forwarding` alone is 512 and 256 | none | |
/// | `signing: { streams: N }` | message signing (feature `signing`): streams of signed frames that are followed at a time; `signing` alone is 16 | none | |
/// | `storage: { records: N }` | storage for all of this (feature `storage`), and for up to 8 small records of the firmware's own; `storage` alone has none | none | `Records`, if there are any |
/// | `peers: N` | entries of the table of [peers](crate::network::PeerInfo) | 8 | |
/// | `texts: N` | pending texts; 0 for no texts at all | 4 | |
/// | `crate: path` | the path of this crate, if the firmware has renamed it | `::mavstack` | |
///
/// | type of a field | service | hook |
/// |---|---|---|
/// | [`clock::Time`] | PING and TIMESYNC | |
/// | [`setpoints::Setpoints`] | setpoints of a companion computer | |
/// | [`camera::CameraControl`]`<[Image; N]>` | a camera that remembers the last `N` images (48 bytes each) | [`Camera`] |
/// | [`ext_parameters::ExtParamServer`] | extended parameters, such as a camera's settings | [`ExtParameters`] |
/// | [`gimbal::ManagerService`] | a gimbal manager: decides which component points the gimbal | [`GimbalManager`] |
/// | [`gimbal::DeviceService`] | a gimbal device: the gimbal itself | [`GimbalDevice`] |
/// | [`high_latency::HighLatency`] | HIGH_LATENCY2 on a satellite link | |
/// | [`logs::LogStreamer`] | the running log, streamed in flight | [`LogStreaming`] |
///
/// # In a static
///
/// `VACANT` is all zero bits, so a `static` with it is placed in `.bss` and takes no flash. [`begin`](crate::Stack::begin)
/// starts it in place, without a copy on the call stack:
///
/// ```
/// # use mavstack::prelude::*;
/// # use mavstack::dialect;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// use static_cell::ConstStaticCell;
///
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 1)]
/// struct Mavlink;
/// static PULSE: Pulse = Pulse::new();
/// static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);
///
/// let stack = STACK.take();
/// stack.begin(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600)]);
/// ```
pub use mavstack_macros::Stack;
#[doc(inline)]
pub use message::{Address, CommandRule, Item, Message, Text};
pub use pulse::Pulse;
pub use service::camera::Camera;
pub use service::client::{CommandClient, CommandReply, OutgoingCommand, ParamAnswer};
pub use service::command::Commands;
pub use service::components::Components;
pub use service::events::HealthChecks;
pub use service::ext_parameters::ExtParameters;
pub use service::files::Files;
pub use service::gimbal::{GimbalDevice, GimbalManager};
pub use service::log_streaming::LogStreaming;
pub use service::logs::Logs;
pub use service::mission::{PlanChange, Plans, Progress};
pub use service::mode::{CustomMode, FlightMode, ModeRequest, Modes};
pub use service::param::{Param, ParamBackend, ParamChange, Parameters};
pub use service::stream::{Fill, Stream, Telemetry};
pub use stack::{Counter, Stack, StackOf};
pub use time::{Duration, Instant};
pub use types::{
    Command, Component, Config, Context, ControlInput, Destination, LinkConfig, LinkId, Outcome, Peer, PeerEvent,
    PlanType, Recipient, Sender, Trust, Vehicle, VehicleState,
};

/// The names that most firmwares need, for `use mavstack::prelude::*`: the stack, its configuration, the traits of the vehicle, and
/// the types in their hooks. It has no modules and no macros, whose names are common words.
pub mod prelude {
    pub use crate::dialect::{MavResult, MavSeverity};
    pub use crate::{
        Address, Camera, Command, CommandClient, CommandReply, CommandRule, Commands, Component, Components, Config,
        Context, ControlInput, CustomMode, Destination, Duration, ExtParameters, Files, Fill, FlightMode, Frame,
        GimbalDevice, GimbalManager, HealthChecks, Instant, Item, LinkConfig, LinkId, LogStreaming, Logs, Message,
        ModeRequest, Modes, Outcome, OutgoingCommand, Param, ParamAnswer, ParamBackend, ParamChange, Parameters, Peer,
        PeerEvent, PlanChange, PlanType, Plans, Progress, Pulse, Recipient, Stack, StackOf, Stream, Telemetry, Text,
        Vehicle, VehicleState,
    };
}

/// The parts of [`Config`] and [`LinkConfig`].
pub mod config {
    pub use crate::types::{CreditConfig, Identity, LinkClass, PollBudget, StreamProfile, TxVersion, VehicleAddress};
}

/// The largest numbers of links, items, parameters, modes and streams, and the longest text.
pub mod limits {
    pub use crate::service::ext_parameters::MAX_EXT_PARAMS;
    pub use crate::service::mode::MAX_MODES;
    pub use crate::service::param::MAX_PARAMS;
    pub use crate::service::stream::MAX_STREAMS;
    pub use crate::types::{MAX_COMPONENTS, MAX_ITEMS, MAX_LINKS, MAX_TEXT_LEN};
}

/// Commands: which ones a vehicle accepts, and those that run for long. [`Commands`] has the hooks.
pub mod command {
    pub use crate::service::command::{CommandPolicy, LongCommands};
    pub use crate::types::{CommandPosition, HookFaults};
}

/// Plans: missions, fences and rally points. [`Plans`] has the hooks.
pub mod plan {
    pub use crate::service::mission::{FirstWaypointLimit, PlanCounters, PlanFault};
    pub use crate::types::{Durability, PlanView};
}

/// Parameters: tables that [`parameters!`](crate::parameters) declares, tables that are filled at run time, and parameters that
/// live elsewhere. [`Parameters`] and [`ParamBackend`] have the hooks.
pub mod param {
    pub use crate::service::client::ExtParamValue;
    pub use crate::service::param::{
        ExternalParams, ParamDetails, ParamEncoding, ParamFault, ParamHash, ParamInfo, ParamTable, ParamType,
        ParamUpdate, ParamWrite, RuntimeTable,
    };
}

/// Message signing: the key, and the frames that each link accepts.
#[cfg(feature = "signing")]
pub mod signing {
    pub use crate::frame::SigningKey;
    pub use crate::service::signing::{Signing, SigningCounters, SigningStream};
    pub use crate::types::{Accept, LinkSigning};
}

/// Satellite modems and other links where each byte costs money: HIGH_LATENCY2.
pub mod high_latency {
    pub use crate::service::high_latency::{
        HighLatency, HighLatencyConfig, HighLatencyCounters, HighLatencyMode, HighLatencySample,
    };
}

/// Manual control: the sticks and channels of a pilot on the ground.
pub mod manual_control {
    pub use crate::service::holder::ControlSource;
    pub use crate::service::manual_control::{ManualCounters, ManualInput};
    pub use crate::types::{ManualControlInput, RcOverride};
}

/// Setpoints: where to fly, how fast, or in which attitude, from a companion computer or a ground station.
pub mod setpoints {
    pub use crate::service::setpoints::{SetpointCounters, Setpoints};
    pub use crate::types::{AttitudeSetpoint, Place, PositionSetpoint, Setpoint, Target};
}

/// Operator control: which ground station controls the vehicle, and how another one takes over.
pub mod operator_control {
    pub use crate::service::operator_control::{OperatorControl, OperatorCounters};
}

/// A camera: images on command and at intervals, video, and a report of each image. [`Camera`] has the hooks.
pub mod camera {
    pub use crate::service::camera::{CameraControl, CameraCounters, CameraOrder, Image, Shot};
}

/// Events, and the checks before arming. [`events!`](crate::events!) declares them, and
/// [`Context::event`] and [`Stack::event`] send them. [`HealthChecks`] has the hooks of the checks.
pub mod events {
    pub use crate::service::events::{
        ArgumentInfo, Check, CheckBits, CheckSet, DeclaredEvent, EntryInfo, EnumInfo, Event, EventArgument,
        EventCounters, EventGroup, EventInfo, EventSet, HealthReport, LogLevel,
    };
}

/// Extended parameters: settings of any type, such as a camera's. [`ExtParameters`] has the hooks.
pub mod ext_parameters {
    pub use crate::service::ext_parameters::{ExtParamServer, ExtValue};
}

/// Gimbals: control of a gimbal, and setpoints for it. [`GimbalManager`] and [`GimbalDevice`] have the hooks.
pub mod gimbal {
    pub use crate::service::gimbal::{
        Axes, DeviceCounters, DeviceService, DeviceSetpoint, GimbalControl, GimbalSetpoint, GimbalTarget,
        ManagerCounters, ManagerService,
    };
}

/// Files, and all parameters in one file, by FTP. [`Files`] has the hooks.
pub mod files {
    pub use crate::dialect::MavFtpErr;
    pub use crate::service::files::{
        FileAccess, FileChange, FileCounters, FileEntry, FileStatus, OpenFile, StaticFile,
    };
}

/// Flight logs, downloaded by ground stations, or streamed in flight. [`Logs`] and [`LogStreaming`] have the hooks.
pub mod logs {
    pub use crate::service::log_streaming::{LogStreamer, StreamingCounters};
    pub use crate::service::logs::{LogCounters, LogInfo, LogRead, LogServer};
}

/// The declaration of a stack, as a type: for functions that take any [`Stack`](struct@Stack).
pub mod declare {
    pub use crate::service::mission::Missions;
    pub use crate::service::param::{ParamMemory, ParamService};
    pub use crate::stack::{Declaration, Declares};
    pub use crate::types::{Firmware, PlanMemory, Values};
}

/// Clocks: those of peers, by PING and TIMESYNC, and the time of day.
pub mod clock {
    pub use crate::service::time::{ClockFilter, Time, TimeSample, WallClock};
}

#[cfg(feature = "defmt")]
#[doc(hidden)]
pub use defmt as __defmt;

/// The names that the crate's macros expand to.
#[doc(hidden)]
pub mod __private {
    pub use crate::logs::LogServer;
    pub use crate::manual_control::ManualInput;
    pub use crate::message::FieldWriter;
    pub use crate::network::PeerInfo;
    pub use crate::operator_control::OperatorControl;
    pub use crate::service::client::Client;
    pub use crate::service::command::{CommandSlots, NoSlots};
    pub use crate::service::components::ComponentService;
    pub use crate::service::events::{Checking, EventService, Unchecked, bit, check_events, summary};
    pub use crate::service::files::{FileServer, HasFiles, NoFile, OneOf, sessions as file_sessions};
    pub use crate::service::forwarding::Forwarding;
    pub use crate::service::mission::{Missions, WithoutPlans};
    pub use crate::service::mode::ModeService;
    pub use crate::service::param::{
        Checked, Detailed, NoParams, ParamAttributes, ParamMemory, ParamService, ParamValues, Row, TableMut,
        attributes_at, details, is_in_order, position, system_id,
    };
    pub use crate::service::stream::Messages;
    pub use crate::service::stream::StreamService;
    pub use crate::service::{About, Look, LookAll, ServiceList, Turn, Visit, VisitAll};
    pub use crate::service::{
        Absent, ControlGate, ForwardingGate, OwnCommands, Service, SigningGate, SticksGate, WithoutSigning,
    };
    pub use crate::stack::{Declaration, Declares, Persistent, credits};
    #[cfg(feature = "storage")]
    pub use crate::storage::{RecordService, Storage};
    pub use crate::types::{
        Credits, EventEntry, EventLog, Firmware, NoPlans, PlanBuffers, PlanMemory, PlanMemoryOf, RequestQueue,
        Requests, StatusTexts, TextEntry, Values, largest, version,
    };

    /// The peer table.
    pub type PeerTable<const N: usize> = heapless::Vec<PeerInfo, N>;
    /// The history of events.
    pub type EventHistory<const N: usize> = EventLog<[EventEntry; N]>;
    /// The queue of texts.
    pub type TextQueue<const N: usize> = StatusTexts<[TextEntry; N]>;
    /// Signing with `N` streams at a time.
    #[cfg(feature = "signing")]
    pub type SigningStreams<const N: usize> = crate::signing::Signing<[crate::signing::SigningStream; N]>;
}
