//! What the protocol tests share: a vehicle and its ground stations in simulated time, with a bad line in between.
//!
//! - [`SimSerial`]: a serial line whose two ends implement embedded-io; it loses, flips and repeats bytes or frames, stalls,
//!   and takes and gives a few bytes at a time, all drawn from a seed.
//! - [`TestVehicle`]: implements the stack's traits, records every call, answers as it is told; [`pilot`] is one with modes.
//! - [`Gcs`]: the far end of a line: sends any message as anybody, keeps what it received with the time.
//! - [`Upload`], [`Download`], [`Clear`]: plan transfers as a real client does them, retries included.
//! - [`Receiver`], [`stream`], [`damage`] and [`reference`]: a decoder by itself, telemetry for it, what a bad line makes of it,
//!   and a second decoder to compare with.
//! - [`Network`]: several stacks that forward, and the lines between them.
//! - [`World`]: one stack with its lines and ground stations, stepped a millisecond at a time.
//!
//! A test reads like this:
//!
//! ```ignore
//! let mut world = World::new(Setup::<1>::new());
//! world.run_for(secs(1));
//! world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
//! let ack: CommandAck = world.expect(0, millis(100));
//! assert_eq!(ack.result, MavResult::ACCEPTED);
//! ```
//!
//! Everything is deterministic: no clock, no thread, no randomness without a seed. Lines that would block panic, so every
//! test also proves that the stack never blocks.

#![allow(dead_code, unused_imports, reason = "each test file uses its own part")]

/// Counters that are zero but for what `set` sets.
pub fn counted<C: Default>(set: impl FnOnce(&mut C)) -> C {
    let mut counters = C::default();
    set(&mut counters);
    counters
}

pub mod damage;
mod gcs;
mod network;
pub mod pilot;
mod receiver;
pub mod reference;
mod rng;
mod serial;
pub mod stream;
mod telemetry;
mod transfer;
mod vehicle;
mod world;

pub use gcs::{Gcs, Received};
pub use network::{End, Line, Network};
pub use receiver::{Receiver, decode};
pub use rng::Rng;
pub use serial::{Clock, Faults, LineConfig, SerialEnd, SimError, SimSerial, Wire};
pub use transfer::{Clear, Download, TransferError, Upload, plan};
pub use vehicle::{Call, TestVehicle, Tuning};
pub use world::{Setup, World};

use mavstack::{Address, Duration};
use proptest::test_runner::{Config, RngSeed};

/// The vehicle of the tests.
pub const VEHICLE: Address = Address::new(1, 1);
/// The ground station of the tests, as most of them call themselves.
pub const STATION: Address = Address::new(255, 190);
/// A second ground station.
pub const OTHER_STATION: Address = Address::new(254, 190);

/// `n` milliseconds.
pub const fn millis(n: u64) -> Duration {
    Duration::from_millis(n)
}

/// `n` seconds.
pub const fn secs(n: u64) -> Duration {
    Duration::from_secs(n)
}

/// So many cases of a property, the same ones at every run; the environment's `PROPTEST_CASES` and `PROPTEST_RNG_SEED`
/// give more, or others.
pub fn cases(count: u32) -> Config {
    let default = Config::default();
    let rng_seed = if default.rng_seed == RngSeed::Random { RngSeed::Fixed(1) } else { default.rng_seed };
    let cases = if std::env::var_os("PROPTEST_CASES").is_some() { default.cases } else { count };
    Config { cases, rng_seed, failure_persistence: None, ..default }
}
