//! The declaration of a stack.

use super::memory::{EventMemory, PeerMemory, RequestMemory, StorageMemory, TextMemory};
use crate::service::command::{CommandMemory, Commands};
#[cfg(feature = "storage")]
use crate::service::param::ExternalService;
use crate::service::param::ParamMemory;
use crate::service::{ControlGate, ForwardingGate, OwnCommands, Service, SigningGate, SticksGate};
use crate::types::{Firmware, Vehicle};

#[cfg(feature = "storage")]
pub use crate::storage::Persistent;

/// A service whose content is stored, if there is storage.
#[cfg(not(feature = "storage"))]
#[doc(hidden)]
pub trait Persistent<F: Firmware>: Service<F> {}

#[cfg(not(feature = "storage"))]
impl<F: Firmware, S: Service<F>> Persistent<F> for S {}

/// The backend stores its parameters itself.
#[cfg(feature = "storage")]
impl<F: Firmware> Persistent<F> for ExternalService where Self: Service<F> {}

/// The services of a firmware, and their memory. [`stack!`](crate::stack) implements it.
#[doc(hidden)]
pub trait Declares: Firmware<Vehicle: Vehicle + Commands, Parameters: ParamMemory> {
    type Peers: PeerMemory;
    type Texts: TextMemory;
    type Requests: RequestMemory;
    type EventLog: EventMemory;
    /// The number of links that have a queue of messages.
    const MESSAGE_QUEUES: usize = 0;
    type Commands: CommandMemory;
    type Components: Service<Self>;
    type Mission: Persistent<Self>;
    type Param: Persistent<Self>;
    type Stream: Service<Self>;
    type Messages: Service<Self>;
    type Client: Service<Self> + OwnCommands<Self>;
    type Camera: Service<Self>;
    type ExtParameters: Service<Self>;
    type Events: Service<Self>;
    type Logs: Service<Self>;
    type LogStreaming: Service<Self>;
    type Mode: Service<Self>;
    type Time: Service<Self>;
    type ManualControl: Service<Self> + SticksGate;
    type Setpoints: Service<Self>;
    type OperatorControl: Service<Self> + ControlGate;
    type GimbalManager: Service<Self>;
    type GimbalDevice: Service<Self>;
    type HighLatency: Service<Self>;
    type Signing: Persistent<Self> + SigningGate<<Self::Signing as Service<Self>>::Link>;
    type Files: Service<Self>;
    type Forwarding: Service<Self> + ForwardingGate<Self>;
    type Records: Persistent<Self>;
    type Storage: StorageMemory;
    /// Fails to compile if the declaration is invalid.
    const CHECKED: ();
}

/// Declares the stack of a vehicle: its services, with all their memory.
///
/// ```
/// # use mavstack::*;
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
/// mavstack::stack! {
///     pub struct Mavlink for Quadrotor {
///         links: 2,
///         plans: { mission: 250, fence: 64, rally: 16 },
///         parameters: Tuning,
///         streams,
///         commands: { slots: 2 },
///         forwarding: { bytes: 512, seen: 256 },
///         time,
///         manual_control,
///         setpoints,
///         operator_control,
///         high_latency,
///     }
/// }
///
/// static PULSE: Pulse = Pulse::new();
/// let mut stack = Mavlink::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600); 2]);
/// stack.poll(Instant::ZERO, &mut Quadrotor);
/// ```
///
/// The vehicle must be as visible as the struct: `pub struct Mavlink for Rover` needs a `pub struct Rover`, or the compiler
/// reports a private type in a public interface (E0446).
///
/// The struct derefs to [`Stack`](crate::Stack), which has the methods. A service that is not declared is not linked
/// and takes no memory, and its hook need not be implemented.
///
/// | entry | what it declares | by default | hook |
/// |---|---|---|---|
/// | `links: N` | links, 1 to 16 | must be given | |
/// | `plans: { mission: N, fence: N, rally: N }` | items of each [plan](crate::Plans); `fence` and `rally` may be left out | none | [`Plans`](crate::Plans) |
/// | `parameters: T` | a table made by [`parameters!`](crate::parameters), or a [`RuntimeTable<N>`](crate::param::RuntimeTable) that is filled at start | none | [`Parameters`](crate::Parameters) |
/// | `parameters: ExternalParams<N>` | up to `N` parameters that [live elsewhere](crate::param::ExternalParams) | none | [`ParamBackend`](crate::ParamBackend) |
/// | `streams` | [telemetry](crate::Telemetry), one slot for each of the vehicle's streams | none | [`Telemetry`](crate::Telemetry) |
/// | `messages` | [messages of the vehicle's own](crate::Context::send): room for eight on each link | none | [`Telemetry`](crate::Telemetry) |
/// | `modes` | [flight modes](crate::Modes) | none | [`Modes`](crate::Modes) |
/// | `commands: { slots: N }` | slots for long-running [commands](crate::command::LongCommands), and for those that must not run twice | none | |
/// | `command_client: { slots: N }` | [requests of the vehicle](crate::CommandClient) to other components, commands and parameters, `N` at a time | none | [`CommandClient`](crate::CommandClient) |
/// | `components` | other [components](crate::Components) of the firmware: a gimbal, a camera | none | [`Components`](crate::Components) |
/// | `camera: { images: N }` | a [camera](crate::Camera) that remembers the last `N` images (48 bytes each); `camera` alone is 16 | none | [`Camera`](crate::Camera) |
/// | `ext_parameters` | [extended parameters](crate::ExtParameters), such as a camera's settings | none | [`ExtParameters`](crate::ExtParameters) |
/// | `events: { history: N }` | [events](mod@crate::events) that ground stations receive without a gap, the last `N` of them kept (36 bytes each) | none | |
/// | `events: { history: N, checks }` | also the checks before arming, reported as events; `N` is at least 8 | none | [`HealthChecks`](crate::HealthChecks) |
/// | `time` | [PING and TIMESYNC](crate::clock::Time) | none | |
/// | `manual_control` | [manual control](crate::manual_control::ManualInput) | none | |
/// | `setpoints` | [setpoints](crate::setpoints::Setpoints) of a companion computer | none | |
/// | `operator_control` | [operator control](crate::operator_control::OperatorControl): which ground station is in control | none | |
/// | `gimbal_manager` | a [gimbal manager](crate::gimbal::ManagerService): who points the gimbal, and where | none | [`GimbalManager`](crate::GimbalManager) |
/// | `gimbal_device` | a [gimbal device](crate::gimbal::DeviceService): the gimbal itself | none | [`GimbalDevice`](crate::GimbalDevice) |
/// | `high_latency` | [HIGH_LATENCY2](crate::high_latency::HighLatency) | none | |
/// | `files: { sessions: N, upload: N }` | [files](crate::Files) by FTP, all parameters in one, and plans as files: files open at a time, and bytes of the largest upload of parameters, at least 276 with plans; without `upload` parameters and plans are not written that way | none | [`Files`](crate::Files) |
/// | `logs` | downloads of [flight logs](crate::Logs) | none | [`Logs`](crate::Logs) |
/// | `log_streaming` | the running log, [streamed](crate::LogStreaming) in flight | none | [`LogStreaming`](crate::LogStreaming) |
/// | `forwarding: { bytes: N, seen: N }` | [forwarding](crate::network::ForwardQueues): bytes of each link's queue, frames remembered for duplicate detection; `forwarding` alone is 512 and 256 | none | |
/// | `signing: { streams: N }` | message signing (feature `signing`): streams of signed frames that are followed at a time; `signing` alone is 16 | none | |
/// | `storage: { records: N }` | storage for all of this (feature `storage`), and for up to 8 small records of the firmware's own; `storage` alone has none | none | `Records`, if there are any |
/// | `peers: N` | entries of the table of [peers](crate::network::PeerInfo) | 8 | |
/// | `texts: N` | pending texts; 0 for no texts at all | 4 | |
///
/// # In a static
///
/// `VACANT` is all zero bits, so a `static` with it is placed in `.bss` and takes no flash. [`begin`](crate::Stack::begin)
/// starts it in place, without a copy on the call stack:
///
/// ```
/// # use mavstack::*;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// use static_cell::ConstStaticCell;
///
/// stack! {
///     struct Mavlink for Rover { links: 1 }
/// }
/// static PULSE: Pulse = Pulse::new();
/// static STACK: ConstStaticCell<Mavlink> = ConstStaticCell::new(Mavlink::VACANT);
///
/// let stack = STACK.take();
/// stack.begin(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600)]);
/// ```
#[macro_export]
macro_rules! stack {
    ($(#[$meta:meta])* $vis:vis struct $name:ident for $vehicle:ty { $($entries:tt)* }) => {
        $(#[$meta])*
        #[derive(Debug)]
        $vis struct $name {
            stack: $crate::Stack<$name, { $crate::__declared!(links $($entries)*,) }>,
        }

        $crate::__declared!(check $($entries)*,);

        #[allow(dead_code, reason = "a firmware uses one of the two")]
        impl $name {
            /// A stack that is not started yet: all zero bits.
            pub const VACANT: Self = Self { stack: $crate::Stack::VACANT };

            /// Returns a stack that is started.
            pub fn new(
                config: $crate::Config,
                links: [$crate::LinkConfig; { $crate::__declared!(links $($entries)*,) }],
            ) -> Self {
                let mut stack = Self::VACANT;
                stack.begin(config, links);
                stack
            }
        }

        impl $crate::__private::Firmware for $name {
            type Vehicle = $vehicle;
            type Plans = $crate::__declared!(plans [{ $crate::__declared!(uploads $($entries)*,) }] $($entries)*,);
            type Parameters = $crate::__declared!(parameters $($entries)*,);
            const HAS_MODES: bool = $crate::__declared!(has_modes $($entries)*,);
            const HAS_TEXTS: bool = $crate::__declared!(texts $($entries)*,) > 0;
            const SLOWS_STREAMS: bool =
                $crate::__declared!(has_files $($entries)*,) && $crate::__declared!(has_streams $($entries)*,);
            const COMPONENTS: &'static [$crate::Component] = $crate::__declared!(component_list [$vehicle] $($entries)*,);
            $crate::__declared!(component_hook [$vehicle] $($entries)*,);
        }

        impl $crate::__private::Declares for $name {
            type Peers = $crate::__private::PeerTable<{ $crate::__declared!(peers $($entries)*,) }>;
            type Texts = $crate::__private::TextQueue<{ $crate::__declared!(texts $($entries)*,) }>;
            type Commands = $crate::__declared!(commands $($entries)*,);
            type Components = $crate::__declared!(components $($entries)*,);
            type Mission = $crate::__declared!(mission $($entries)*,);
            type Param = $crate::__declared!(param $($entries)*,);
            type Stream = $crate::__declared!(stream [$vehicle] $($entries)*,);
            type Messages = $crate::__declared!(messages $($entries)*,);
            type Client = $crate::__declared!(client $($entries)*,);
            type Camera = $crate::__declared!(camera $($entries)*,);
            type ExtParameters = $crate::__declared!(ext_parameters $($entries)*,);
            type Logs = $crate::__declared!(logs $($entries)*,);
            type LogStreaming = $crate::__declared!(log_streaming $($entries)*,);
            type Requests = $crate::__private::Requests<[$crate::__private::RequestQueue; {
                $crate::__declared!(message_queues [{ $crate::__declared!(links $($entries)*,) }] $($entries)*,)
                    + $crate::__declared!(client_queues $($entries)*,)
            }]>;
            const MESSAGE_QUEUES: usize =
                $crate::__declared!(message_queues [{ $crate::__declared!(links $($entries)*,) }] $($entries)*,);
            type Events = $crate::__declared!(events $($entries)*,);
            type EventLog = $crate::__private::EventHistory<{ $crate::__declared!(event_history $($entries)*,) }>;
            type Mode = $crate::__declared!(mode $($entries)*,);
            type Time = $crate::__declared!(time $($entries)*,);
            type ManualControl = $crate::__declared!(manual_control $($entries)*,);
            type Setpoints = $crate::__declared!(setpoints $($entries)*,);
            type OperatorControl = $crate::__declared!(operator_control $($entries)*,);
            type GimbalManager = $crate::__declared!(gimbal_manager $($entries)*,);
            type GimbalDevice = $crate::__declared!(gimbal_device $($entries)*,);
            type HighLatency = $crate::__declared!(high_latency $($entries)*,);
            type Signing = $crate::__declared!(signing $($entries)*,);
            // The services that may have a virtual directory: a line for each.
            type Files = $crate::__declared!(files [$crate::__one_of!({ $crate::__declared!(uploads $($entries)*,) };
                $crate::__declared!(param $($entries)*,),
                $crate::__declared!(mission $($entries)*,),
                $crate::__declared!(logs $($entries)*,),
            )] $($entries)*,);
            type Records = $crate::__declared!(records $($entries)*,);
            type Storage = $crate::__declared!(storage $($entries)*,);
            type Forwarding = $crate::__declared!(forwarding [{ $crate::__declared!(links $($entries)*,) }] $($entries)*,);
            const CHECKED: () = {
                $crate::__declared!(check_modes [$vehicle] $($entries)*,);
                $crate::__declared!(check_streams [$vehicle] [Self] $($entries)*,);
                $crate::__declared!(check_slots [$vehicle] $($entries)*,);
            };
        }

        impl ::core::ops::Deref for $name {
            type Target = $crate::Stack<$name, { $crate::__declared!(links $($entries)*,) }>;

            fn deref(&self) -> &Self::Target {
                &self.stack
            }
        }

        impl ::core::ops::DerefMut for $name {
            fn deref_mut(&mut self) -> &mut Self::Target {
                &mut self.stack
            }
        }
    };
    ($($anything:tt)*) => {
        ::core::compile_error!("write stack! { pub struct Mavlink for Rover { links: 1 } }, with the name of your vehicle's type");
    };
}

/// Finds one entry of a declaration, or its default: goes through the declaration token by token.
#[doc(hidden)]
#[macro_export]
macro_rules! __declared {
    (links links: $n:expr, $($rest:tt)*) => { $n };
    (links) => { ::core::compile_error!("say how many links the vehicle has: `links: 1`") };

    (peers peers: $n:expr, $($rest:tt)*) => { $n };
    (peers) => { 8 };

    (texts texts: $n:expr, $($rest:tt)*) => { $n };
    (texts) => { 4 };

    (plans [$uploads:block] plans: { $($plans:tt)* }, $($rest:tt)*) => {
        <$crate::plan_memory!($($plans)*) as $crate::__private::PlanMemoryOf<$uploads>>::Memory
    };
    (plans [$uploads:block]) => { $crate::__private::NoPlans };
    (plans [$uploads:block] $skipped:tt $($rest:tt)*) => { $crate::__declared!(plans [$uploads] $($rest)*) };

    (mission plans: { $($plans:tt)* }, $($rest:tt)*) => { $crate::__private::Missions };
    (mission) => { $crate::__private::WithoutPlans };

    (parameters parameters: $table:ty, $($rest:tt)*) => { $table };
    (parameters) => { $crate::__private::NoParams };

    (param parameters: $table:ty, $($rest:tt)*) => { <$table as $crate::__private::ParamMemory>::Service };
    (param) => { $crate::__private::Absent };

    (stream [$vehicle:ty] streams, $($rest:tt)*) => {
        $crate::__private::StreamService<{ <$vehicle as $crate::Telemetry>::STREAMS.len() }>
    };
    (stream [$vehicle:ty]) => { $crate::__private::Absent };
    (stream [$vehicle:ty] $skipped:tt $($rest:tt)*) => { $crate::__declared!(stream [$vehicle] $($rest)*) };

    (check_streams [$vehicle:ty] [$stack:ty] streams, $($rest:tt)*) => {
        $crate::Stream::check(
            <$vehicle as $crate::Telemetry>::STREAMS,
            <$stack as $crate::__private::Firmware>::HAS_MODES,
        );
    };
    (check_streams [$vehicle:ty] [$stack:ty]) => {};
    (check_streams [$vehicle:ty] [$stack:ty] $skipped:tt $($rest:tt)*) => {
        $crate::__declared!(check_streams [$vehicle] [$stack] $($rest)*);
    };

    (messages messages, $($rest:tt)*) => { $crate::__private::Messages };
    (messages) => { $crate::__private::Absent };

    (client command_client: { slots: $n:expr $(,)? }, $($rest:tt)*) => { $crate::__private::Client<{ $n }> };
    (client) => { $crate::__private::Absent };

    (camera camera: { images: $n:expr $(,)? }, $($rest:tt)*) => {
        $crate::camera::CameraControl<[$crate::camera::Image; { $n }]>
    };
    (camera camera, $($rest:tt)*) => { $crate::camera::CameraControl<[$crate::camera::Image; 16]> };
    (camera) => { $crate::__private::Absent };

    (ext_parameters ext_parameters, $($rest:tt)*) => { $crate::ext_parameters::ExtParamServer };
    (ext_parameters) => { $crate::__private::Absent };

    (events events: { history: $n:expr, checks $(,)? }, $($rest:tt)*) => {
        $crate::__private::EventService<$crate::__private::Checking<{ $n }>>
    };
    (events events: { history: $n:expr $(,)? }, $($rest:tt)*) => {
        $crate::__private::EventService<$crate::__private::Unchecked<{ $n }>>
    };
    (events) => { $crate::__private::Absent };

    (event_history events: { history: $n:expr $(, checks)? $(,)? }, $($rest:tt)*) => { $n };
    (event_history) => { 0 };

    (logs logs, $($rest:tt)*) => { $crate::logs::LogServer };
    (logs) => { $crate::__private::Absent };

    (log_streaming log_streaming, $($rest:tt)*) => { $crate::logs::LogStreamer };
    (log_streaming) => { $crate::__private::Absent };

    (client_queues command_client: $($rest:tt)*) => { 1 };
    (client_queues) => { 0 };

    (message_queues [$links:expr] messages, $($rest:tt)*) => { $links };
    (message_queues [$links:expr]) => { 0 };
    (message_queues [$links:expr] $skipped:tt $($rest:tt)*) => { $crate::__declared!(message_queues [$links] $($rest)*) };

    (mode modes, $($rest:tt)*) => { $crate::__private::ModeService };
    (mode) => { $crate::__private::Absent };

    (has_modes modes, $($rest:tt)*) => { true };
    (has_modes) => { false };

    (check_modes [$vehicle:ty] modes, $($rest:tt)*) => {
        $crate::FlightMode::check(<$vehicle as $crate::Modes>::MODES);
    };
    (check_modes [$vehicle:ty]) => {};
    (check_modes [$vehicle:ty] $skipped:tt $($rest:tt)*) => { $crate::__declared!(check_modes [$vehicle] $($rest)*); };

    (commands commands: { slots: $n:expr $(,)? }, $($rest:tt)*) => { $crate::__private::CommandSlots<{ $n }> };
    (commands) => { $crate::__private::NoSlots };

    (check_slots [$vehicle:ty] commands: { slots: $n:expr $(,)? }, $($rest:tt)*) => {};
    (check_slots [$vehicle:ty]) => {
        $crate::command::CommandPolicy::check_without_slots(<$vehicle as $crate::Commands>::POLICIES);
    };
    (check_slots [$vehicle:ty] $skipped:tt $($rest:tt)*) => { $crate::__declared!(check_slots [$vehicle] $($rest)*); };

    (time time, $($rest:tt)*) => { $crate::clock::Time };
    (time) => { $crate::__private::Absent };

    (manual_control manual_control, $($rest:tt)*) => { $crate::manual_control::ManualInput };
    (manual_control) => { $crate::__private::Absent };

    (setpoints setpoints, $($rest:tt)*) => { $crate::setpoints::Setpoints };
    (setpoints) => { $crate::__private::Absent };

    (component_list [$vehicle:ty] components, $($rest:tt)*) => {
        <$vehicle as $crate::Components>::COMPONENTS
    };
    (component_list [$vehicle:ty]) => { &[] };
    (component_list [$vehicle:ty] $skipped:tt $($rest:tt)*) => {
        $crate::__declared!(component_list [$vehicle] $($rest)*)
    };

    (component_hook [$vehicle:ty] components, $($rest:tt)*) => {
        const HAS_OPTIONAL_COMPONENTS: bool = <$vehicle as $crate::Components>::OPTIONAL;

        fn component_command(
            vehicle: &mut $vehicle,
            cx: &mut $crate::Context<'_>,
            command: &$crate::Command,
        ) -> $crate::Outcome {
            <$vehicle as $crate::Components>::component_command(vehicle, cx, command.component, command)
        }
    };
    (component_hook [$vehicle:ty]) => {};
    (component_hook [$vehicle:ty] $skipped:tt $($rest:tt)*) => {
        $crate::__declared!(component_hook [$vehicle] $($rest)*);
    };

    (components components, $($rest:tt)*) => { $crate::__private::ComponentService };
    (components) => { $crate::__private::Absent };

    (operator_control operator_control, $($rest:tt)*) => { $crate::operator_control::OperatorControl };
    (operator_control) => { $crate::__private::Absent };

    (gimbal_manager gimbal_manager, $($rest:tt)*) => { $crate::gimbal::ManagerService };
    (gimbal_manager) => { $crate::__private::Absent };

    (gimbal_device gimbal_device, $($rest:tt)*) => { $crate::gimbal::DeviceService };
    (gimbal_device) => { $crate::__private::Absent };

    (high_latency high_latency, $($rest:tt)*) => { $crate::high_latency::HighLatency };
    (high_latency) => { $crate::__private::Absent };

    (signing signing: { streams: $n:expr $(,)? }, $($rest:tt)*) => { $crate::__signing!($n) };
    (signing signing, $($rest:tt)*) => { $crate::__signing!(16) };
    (signing) => { $crate::__private::WithoutSigning };

    (storage storage: { $($sizes:tt)* }, $($rest:tt)*) => { $crate::__storage!() };
    (storage storage, $($rest:tt)*) => { $crate::__storage!() };
    (storage) => { $crate::__private::Absent };

    (records storage: { records: $n:expr $(,)? }, $($rest:tt)*) => { $crate::__storage!($n) };
    (records) => { $crate::__private::Absent };

    (has_files files: $($rest:tt)*) => { true };
    (has_files) => { false };

    (has_streams streams, $($rest:tt)*) => { true };
    (has_streams) => { false };

    (uploads files: { sessions: $n:expr, upload: $upload:expr $(,)? }, $($rest:tt)*) => { ($upload) > 0 };
    (uploads) => { false };

    (files [$virtual:ty] files: { sessions: $n:expr, upload: $upload:expr $(,)? }, $($rest:tt)*) => {
        $crate::__private::FileServer<{ $n }, { ($n) + 2 }, { $upload }, $virtual>
    };
    (files [$virtual:ty] files: { sessions: $n:expr $(,)? }, $($rest:tt)*) => {
        $crate::__private::FileServer<{ $n }, { ($n) + 2 }, 0, $virtual>
    };
    (files [$virtual:ty]) => { $crate::__private::Absent };
    (files [$virtual:ty] $skipped:tt $($rest:tt)*) => { $crate::__declared!(files [$virtual] $($rest)*) };

    (forwarding [$links:expr] forwarding: { bytes: $bytes:expr, seen: $seen:expr $(,)? }, $($rest:tt)*) => {
        $crate::__private::Forwarding<{ $links }, { $bytes }, { $seen }>
    };
    (forwarding [$links:expr] forwarding: { bytes: $bytes:expr $(,)? }, $($rest:tt)*) => {
        $crate::__private::Forwarding<{ $links }, { $bytes }, 256>
    };
    (forwarding [$links:expr] forwarding: { seen: $seen:expr $(,)? }, $($rest:tt)*) => {
        $crate::__private::Forwarding<{ $links }, 512, { $seen }>
    };
    (forwarding [$links:expr] forwarding, $($rest:tt)*) => { $crate::__private::Forwarding<{ $links }, 512, 256> };
    (forwarding [$links:expr]) => { $crate::__private::Absent };
    (forwarding [$links:expr] $skipped:tt $($rest:tt)*) => { $crate::__declared!(forwarding [$links] $($rest)*) };

    (check $(,)*) => {};
    (check links: $n:expr, $($rest:tt)*) => { $crate::__declared!(rest links $($rest)*); };
    (check peers: $n:expr, $($rest:tt)*) => { $crate::__declared!(rest peers $($rest)*); };
    (check texts: $n:expr, $($rest:tt)*) => { $crate::__declared!(rest texts $($rest)*); };
    (check plans: { $($plans:tt)* }, $($rest:tt)*) => { $crate::__declared!(rest plans $($rest)*); };
    (check parameters: $table:ty, $($rest:tt)*) => { $crate::__declared!(rest parameters $($rest)*); };
    (check streams, $($rest:tt)*) => { $crate::__declared!(rest streams $($rest)*); };
    (check messages, $($rest:tt)*) => { $crate::__declared!(rest messages $($rest)*); };
    (check modes, $($rest:tt)*) => { $crate::__declared!(rest modes $($rest)*); };
    (check commands: { slots: $n:expr $(,)? }, $($rest:tt)*) => { $crate::__declared!(rest commands $($rest)*); };
    (check command_client: { slots: $n:expr $(,)? }, $($rest:tt)*) => {
        $crate::__declared!(rest command_client $($rest)*);
    };
    (check components, $($rest:tt)*) => { $crate::__declared!(rest components $($rest)*); };
    (check camera: { images: $n:expr $(,)? }, $($rest:tt)*) => { $crate::__declared!(rest camera $($rest)*); };
    (check camera, $($rest:tt)*) => { $crate::__declared!(rest camera $($rest)*); };
    (check ext_parameters, $($rest:tt)*) => { $crate::__declared!(rest ext_parameters $($rest)*); };
    (check events: { history: $n:expr $(, checks)? $(,)? }, $($rest:tt)*) => {
        $crate::__declared!(rest events $($rest)*);
    };
    (check logs, $($rest:tt)*) => { $crate::__declared!(rest logs $($rest)*); };
    (check log_streaming, $($rest:tt)*) => { $crate::__declared!(rest log_streaming $($rest)*); };
    (check time, $($rest:tt)*) => { $crate::__declared!(rest time $($rest)*); };
    (check manual_control, $($rest:tt)*) => { $crate::__declared!(rest manual_control $($rest)*); };
    (check setpoints, $($rest:tt)*) => { $crate::__declared!(rest setpoints $($rest)*); };
    (check operator_control, $($rest:tt)*) => { $crate::__declared!(rest operator_control $($rest)*); };
    (check gimbal_manager, $($rest:tt)*) => { $crate::__declared!(rest gimbal_manager $($rest)*); };
    (check gimbal_device, $($rest:tt)*) => { $crate::__declared!(rest gimbal_device $($rest)*); };
    (check files: { sessions: $n:expr $(, upload: $upload:expr)? $(,)? }, $($rest:tt)*) => {
        $crate::__declared!(rest files $($rest)*);
    };
    (check high_latency, $($rest:tt)*) => { $crate::__declared!(rest high_latency $($rest)*); };
    (check signing: { streams: $n:expr $(,)? }, $($rest:tt)*) => { $crate::__declared!(rest signing $($rest)*); };
    (check signing, $($rest:tt)*) => { $crate::__declared!(rest signing $($rest)*); };
    (check storage: { records: $n:expr $(,)? }, $($rest:tt)*) => { $crate::__declared!(rest storage $($rest)*); };
    (check storage, $($rest:tt)*) => { $crate::__declared!(rest storage $($rest)*); };
    (check forwarding: { $($sizes:tt)* }, $($rest:tt)*) => { $crate::__declared!(rest forwarding $($rest)*); };
    (check forwarding, $($rest:tt)*) => { $crate::__declared!(rest forwarding $($rest)*); };
    (check $entry:tt $($rest:tt)*) => {
        ::core::compile_error!(::core::concat!(
            "`",
            ::core::stringify!($entry),
            "` is no entry of a stack, or not written like this: see the table at `mavstack::stack!`"
        ));
    };

    (rest $entry:ident $($rest:tt)*) => {
        $crate::__declared!(once $entry $($rest)*);
        $crate::__declared!(check $($rest)*);
    };

    (once links links: $($rest:tt)*) => { $crate::__declared!(twice links); };
    (once peers peers: $($rest:tt)*) => { $crate::__declared!(twice peers); };
    (once texts texts: $($rest:tt)*) => { $crate::__declared!(twice texts); };
    (once plans plans: $($rest:tt)*) => { $crate::__declared!(twice plans); };
    (once parameters parameters: $($rest:tt)*) => { $crate::__declared!(twice parameters); };
    (once streams streams, $($rest:tt)*) => { $crate::__declared!(twice streams); };
    (once messages messages, $($rest:tt)*) => { $crate::__declared!(twice messages); };
    (once modes modes, $($rest:tt)*) => { $crate::__declared!(twice modes); };
    (once commands commands: $($rest:tt)*) => { $crate::__declared!(twice commands); };
    (once command_client command_client: $($rest:tt)*) => { $crate::__declared!(twice command_client); };
    (once components components, $($rest:tt)*) => { $crate::__declared!(twice components); };
    (once camera camera $($rest:tt)*) => { $crate::__declared!(twice camera); };
    (once ext_parameters ext_parameters, $($rest:tt)*) => { $crate::__declared!(twice ext_parameters); };
    (once events events: $($rest:tt)*) => { $crate::__declared!(twice events); };
    (once logs logs, $($rest:tt)*) => { $crate::__declared!(twice logs); };
    (once log_streaming log_streaming, $($rest:tt)*) => { $crate::__declared!(twice log_streaming); };
    (once time time, $($rest:tt)*) => { $crate::__declared!(twice time); };
    (once manual_control manual_control, $($rest:tt)*) => { $crate::__declared!(twice manual_control); };
    (once setpoints setpoints, $($rest:tt)*) => { $crate::__declared!(twice setpoints); };
    (once operator_control operator_control, $($rest:tt)*) => { $crate::__declared!(twice operator_control); };
    (once gimbal_manager gimbal_manager, $($rest:tt)*) => { $crate::__declared!(twice gimbal_manager); };
    (once gimbal_device gimbal_device, $($rest:tt)*) => { $crate::__declared!(twice gimbal_device); };
    (once files files: $($rest:tt)*) => { $crate::__declared!(twice files); };
    (once high_latency high_latency, $($rest:tt)*) => { $crate::__declared!(twice high_latency); };
    (once signing signing $($rest:tt)*) => { $crate::__declared!(twice signing); };
    (once storage storage $($rest:tt)*) => { $crate::__declared!(twice storage); };
    (once forwarding forwarding $($rest:tt)*) => { $crate::__declared!(twice forwarding); };
    (once $entry:ident) => {};
    (once $entry:ident $skipped:tt $($rest:tt)*) => { $crate::__declared!(once $entry $($rest)*); };
    (twice $entry:ident) => {
        ::core::compile_error!(::core::concat!(
            "`",
            ::core::stringify!($entry),
            "` is given twice in `stack!`: remove one of the two"
        ));
    };

    ($key:ident $skipped:tt $($rest:tt)*) => { $crate::__declared!($key $($rest)*) };
}
