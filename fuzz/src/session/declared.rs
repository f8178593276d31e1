//! The declarations of the session's vehicles: a script chooses whether there is HIGH_LATENCY2, and whether there is forwarding.

use super::LINKS;
use crate::support::{TestVehicle, Tuning};
use mavstack::__private::{CommandSlots, Declares, Missions, ParamService, SigningStreams, Storage};
use mavstack::high_latency::HighLatencyConfig;
use mavstack::manual_control::ManualInput;
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
        Setpoints = Setpoints,
        Signing = SigningStreams<16>,
        Storage = Storage,
    >
{
    /// Configures what only some of them have.
    fn set_up(stack: &mut Stack<Self, LINKS>);
}

macro_rules! declare {
    ($($name:ident: $($service:ident)*, $set_up:expr;)*) => { $(
        #[derive(mavstack::Stack)]
        #[stack(
            vehicle: TestVehicle,
            links: LINKS,
            plans: { mission: 8, fence: 4, rally: 4 },
            parameters: Tuning,
            streams,
            commands: { slots: 3 },
            signing: { streams: 16 },
            time,
            manual_control,
            setpoints,
            peers: 6,
            texts: 3,
            logs,
            log_streaming,
            storage,
            $($service,)*
        )]
        pub struct $name;

        impl Declared for $name {
            fn set_up(stack: &mut Stack<Self, LINKS>) {
                let set_up: fn(&mut Stack<Self, LINKS>) = $set_up;
                set_up(stack);
            }
        }
    )* };
}

const HIGH_LATENCY: HighLatencyConfig =
    HighLatencyConfig { period: Duration::from_secs(5), announce_once: true, ..HighLatencyConfig::DEFAULT };

declare! {
    Plain:, |_| {};
    Satellite: high_latency, |stack| stack.high_latency_mut().set_config(HIGH_LATENCY);
    Forwarding: forwarding, |_| {};
    Both: high_latency forwarding, |stack| stack.high_latency_mut().set_config(HIGH_LATENCY);
}
