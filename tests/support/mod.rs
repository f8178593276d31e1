//! Code shared by the protocol tests: a vehicle and its ground stations in simulated time, connected by unreliable lines.
//!
//! - [`Line`], of `mavstack-station`: a serial line whose two ends implement embedded-io. It loses, flips and duplicates bytes or frames, stalls, and
//!   transfers a few bytes at a time. All faults are drawn from a seed.
//! - [`Tested`]: the declaration of a stack, composed of types: `World::<1, Tested<plan_memory!(mission: 9)>>`.
//! - [`TestVehicle`]: implements the stack's traits, records every call, and returns configured answers. [`pilot`] is a vehicle with
//!   flight modes.
//! - [`Gcs`]: the far end of a line. It sends any message from any address, and stores received frames with their times.
//! - [`Upload`], [`Download`], [`Clear`]: plan transfers as real clients do them, with retries.
//! - [`files`]: the files of the vehicle.
//! - [`logs`]: the flight logs of the vehicle.
//! - [`Talk`]: any dialogue of `mavstack-station`, as one of the real clients.
//! - [`Receiver`], [`stream`], [`damage`] and [`reference`]: a decoder alone, telemetry for it, damaged streams, and a reference
//!   decoder to compare with.
//! - [`Network`]: several stacks that forward, and the lines between them.
//! - [`radio`]: receivers for radio control, ExpressLRS and mLRS.
//! - [`World`]: one stack with its lines and ground stations, in steps of a millisecond.
//!
//! A typical test:
//!
//! ```ignore
//! let mut world = World::new(Setup::<1>::new());
//! world.run_for(secs(1));
//! world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
//! let ack: CommandAck = world.expect(0, millis(100));
//! assert_eq!(ack.result, MavResult::ACCEPTED);
//! ```
//!
//! Everything is deterministic: there are no clocks, no threads and no randomness without a seed. Lines panic instead of blocking,
//! so every test also proves that the stack never blocks.

#![allow(dead_code, unused_imports, unused_macros, reason = "each test binary uses its own part")]

/// Returns counters that are zero except those that `set` changes.
pub fn counted<C: Default>(set: impl FnOnce(&mut C)) -> C {
    let mut counters = C::default();
    set(&mut counters);
    counters
}

pub mod damage;
pub mod files;
#[cfg(feature = "storage")]
pub mod flash;
mod gcs;
pub mod logs;
mod network;
pub mod pilot;
pub mod plan_file;
pub mod pymavlink;
pub mod radio;
mod receiver;
pub mod reference;
#[cfg(feature = "signing")]
pub mod signer;
pub mod stream;
mod talk;
mod telemetry;
pub mod tested;
mod transfer;
mod vehicle;
mod world;

pub use files::MemoryFiles;
pub use gcs::{Gcs, Received};
pub use logs::MemoryLogs;
pub use mavstack_station::kit::{Clock, Faults, Line, LineConfig, LineError, Port, Random as Rng, Wire};
pub use network::Network;
pub use receiver::{Receiver, decode};
pub use talk::Talk;
pub use tested::{
    Everything, Forwarded, ForwardedSatellite, Plain, Satellite, Signed, SignedForwarded, SignedSatellite, Steered,
    Tested, Timed, Unsigned, begun,
};
pub use transfer::{Clear, Download, TransferError, Upload, plan};
pub use vehicle::{Call, TestVehicle, Tuning};
pub use world::{Setup, World};

use mavstack::{Address, Duration};
use proptest::test_runner::{Config, RngSeed};

/// The vehicle's address.
pub const VEHICLE: Address = Address::new(1, 1);
/// The ground station's address, which most ground stations use.
pub const STATION: Address = Address::new(255, 190);
/// The address of a second ground station.
pub const OTHER_STATION: Address = Address::new(254, 190);

/// Returns a duration of `n` milliseconds.
pub const fn millis(n: u64) -> Duration {
    Duration::from_millis(n)
}

/// Returns a duration of `n` seconds.
pub const fn secs(n: u64) -> Duration {
    Duration::from_secs(n)
}

/// Returns a configuration with `count` cases per property, the same in every run. The environment variables `PROPTEST_CASES` and
/// `PROPTEST_RNG_SEED` select more or other cases.
pub fn cases(count: u32) -> Config {
    let default = Config::default();
    let rng_seed = if default.rng_seed == RngSeed::Random { RngSeed::Fixed(1) } else { default.rng_seed };
    let cases = if std::env::var_os("PROPTEST_CASES").is_some() { default.cases } else { count };
    Config { cases, rng_seed, failure_persistence: None, ..default }
}

/// Implements the hooks of plans and parameters for a type that wraps a [`TestVehicle`].
macro_rules! wrap_plans {
    ($Vehicle:ty) => {
        impl mavstack::Parameters for $Vehicle {
            type Table = Tuning;
        }

        impl mavstack::Plans for $Vehicle {
            const MISSION_COMMANDS: &'static [mavstack::CommandRule] =
                <TestVehicle as mavstack::Plans>::MISSION_COMMANDS;

            fn plan_changed(&mut self, cx: &mut mavstack::Context<'_>, change: mavstack::PlanChange<'_>) {
                mavstack::Plans::plan_changed(&mut self.0, cx, change);
            }

            fn progress(&self) -> mavstack::Progress {
                mavstack::Plans::progress(&self.0)
            }
        }
    };
}
pub(crate) use wrap_plans;

/// Implements the hooks that every vehicle has: it is disarmed, and supports no command.
macro_rules! plain_vehicle {
    ($Vehicle:ty) => {
        impl mavstack::Vehicle for $Vehicle {
            fn state(&self) -> Option<mavstack::VehicleState> {
                Some(mavstack::VehicleState::new(false))
            }
        }

        $crate::support::without_commands!($Vehicle);
    };
}
pub(crate) use plain_vehicle;

/// Supports no command.
macro_rules! without_commands {
    ($Vehicle:ty) => {
        impl mavstack::Commands for $Vehicle {
            fn command(&mut self, _: &mut mavstack::Context<'_>, _: &mavstack::Command) -> mavstack::Outcome {
                mavstack::dialect::MavResult::UNSUPPORTED.into()
            }
        }
    };
}
pub(crate) use without_commands;
