//! The declarations of the session's vehicles: a script chooses whether there is HIGH_LATENCY2, and whether there is forwarding.

use super::LINKS;
use crate::support::{TestVehicle, Tuning};
use mavstack::__private::{CommandSlots, Declares, Missions, ParamService, SigningStreams, Storage};
use mavstack::clock::Time;
use mavstack::high_latency::{HighLatency, HighLatencyConfig};
use mavstack::logs::LogStreamer;
use mavstack::manual_control::{ControlSource, ManualInput};
use mavstack::message::SystemId;
use mavstack::setpoints::Setpoints;
use mavstack::{Duration, Stack};

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
    /// Configures the fields.
    fn set_up(stack: &mut Stack<Self, LINKS>);
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
    Both: [forwarding], [HighLatency], |stack| stack.high_latency.set_config(HIGH_LATENCY);
}
