//! The declarations of the session's vehicles: a script chooses whether there is HIGH_LATENCY2, and whether there is forwarding. The
//! vehicle with both has all that hostile peers may want.

use super::LINKS;
use crate::support::{TestVehicle, Tuning};
use mavstack::__private::{CommandSlots, Declares, Missions, ParamService, SigningStreams, Storage};
use mavstack::camera::{CameraControl, Image};
use mavstack::clock::Time;
use mavstack::ext_parameters::ExtParamServer;
use mavstack::gimbal::ManagerService;
use mavstack::high_latency::{HighLatency, HighLatencyConfig};
use mavstack::logs::LogStreamer;
use mavstack::manual_control::{ControlSource, ManualInput};
use mavstack::message::SystemId;
use mavstack::setpoints::Setpoints;
use mavstack::{Address, Duration, Instant, Stack};

/// A declaration with all that every session has.
pub trait Declared:
    Declares<
        Vehicle = TestVehicle,
        Parameters = Tuning,
        Mission = Missions,
        Param = ParamService,
        Commands = CommandSlots<3>,
        ManualControl = ManualInput,
        Signing = SigningStreams<16>,
        Storage = Storage,
    >
{
    /// Whether it has all services that hostile peers may want.
    const IS_FULL: bool = false;

    /// Configures the fields.
    fn set_up(stack: &mut Stack<Self, LINKS>);

    /// Returns the system in control.
    fn operator(stack: &Stack<Self, LINKS>, now: Instant) -> Option<SystemId> {
        let _ = (stack, now);
        None
    }

    /// Sends a command of the vehicle to another component.
    fn ask(stack: &mut Stack<Self, LINKS>, to: Address, token: u16) {
        let _ = (stack, to, token);
    }
}

/// The vehicle with everything.
#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: LINKS,
    plans: { mission: 8, fence: 4, rally: 4 },
    parameters: Tuning,
    streams,
    messages,
    command_client: { slots: 2 },
    commands: { slots: 3 },
    signing: { streams: 16 },
    manual_control,
    operator_control,
    files: { sessions: 2, upload: 276 },
    peers: 6,
    texts: 3,
    logs,
    storage,
    forwarding,
)]
pub struct Both {
    pub time: Time,
    pub setpoints: Setpoints,
    pub log_streaming: LogStreamer,
    pub high_latency: HighLatency,
    pub gimbal_manager: ManagerService,
    pub camera: CameraControl<[Image; 3]>,
    pub ext_parameters: ExtParamServer,
}

impl Declared for Both {
    const IS_FULL: bool = true;

    fn set_up(stack: &mut Stack<Self, LINKS>) {
        stack.setpoints.set_source(ControlSource::Systems { first: SystemId::new(1), last: SystemId::new(255) });
        stack.high_latency.set_config(HIGH_LATENCY);
    }

    fn operator(stack: &Stack<Self, LINKS>, now: Instant) -> Option<SystemId> {
        stack.operator(now)
    }

    fn ask(stack: &mut Stack<Self, LINKS>, to: Address, token: u16) {
        let _ = stack.send_command(to, token);
    }
}

macro_rules! declare {
    ($($name:ident: [$($part:ident)?], [$($satellite:ty)?], $set_up:expr;)*) => { $(
        #[derive(mavstack::Stack)]
        #[stack(
            vehicle: TestVehicle,
            links: LINKS,
            plans: { mission: 8, fence: 4, rally: 4 },
            parameters: Tuning,
            streams,
            commands: { slots: 3 },
            signing: { streams: 16 },
            manual_control,
            peers: 6,
            texts: 3,
            logs,
            storage,
            $($part,)?
        )]
        pub struct $name {
            pub time: Time,
            pub setpoints: Setpoints,
            pub log_streaming: LogStreamer,
            $(pub high_latency: $satellite,)?
        }

        impl Declared for $name {
            fn set_up(stack: &mut Stack<Self, LINKS>) {
                stack.setpoints.set_source(ControlSource::Systems { first: SystemId::new(1), last: SystemId::new(255) });
                let set_up: fn(&mut Stack<Self, LINKS>) = $set_up;
                set_up(stack);
            }
        }
    )* };
}

const HIGH_LATENCY: HighLatencyConfig =
    HighLatencyConfig { period: Duration::from_secs(5), announce_once: true, ..HighLatencyConfig::DEFAULT };

declare! {
    Plain: [], [], |_| {};
    Satellite: [], [HighLatency], |stack| stack.high_latency.set_config(HIGH_LATENCY);
    Forwarding: [forwarding], [], |_| {};
}
