//! Code shared with the tests.

#![allow(dead_code, unused_imports, reason = "each target uses its own part")]

#[path = "../../tests/support/files.rs"]
pub mod files;
#[path = "../../tests/support/logs.rs"]
pub mod logs;
#[path = "../../tests/support/receiver.rs"]
mod receiver;
#[path = "../../tests/support/reference.rs"]
pub mod reference;
#[path = "../../tests/support/telemetry.rs"]
mod telemetry;
#[path = "../../tests/support/tested.rs"]
pub mod tested;
#[path = "../../tests/support/vehicle.rs"]
mod vehicle;

pub use files::MemoryFiles;
pub use logs::MemoryLogs;
pub use receiver::Receiver;
pub use tested::{Signed, Tested, begun};
pub use vehicle::{Call, TestVehicle, Tuning};

use mavstack::{Address, Duration};

/// The vehicle's address.
pub const VEHICLE: Address = Address::new(1, 1);
/// The ground station's address.
pub const STATION: Address = Address::new(255, 190);

/// Returns a duration of `n` milliseconds.
pub const fn millis(n: u64) -> Duration {
    Duration::from_millis(n)
}
