//! A demo vehicle and its main loop, shared by the firmware in QEMU and the simulator on the host.
//!
//! [`Quadrotor`] simulates the vehicle; a real firmware replaces it with sensors and motors. [`App`] is the body of the
//! main loop: it connects the stack and the vehicle, as any firmware does.
#![no_std]

#[cfg(test)]
extern crate std;

mod angle;
mod app;
mod battery;
mod body;
pub mod connect;
pub mod events;
mod fence;
pub mod files;
mod geo;
mod logs;
mod plan;
pub mod status;
mod telemetry;
mod tuning;
mod ulog;
mod vehicle;

#[cfg(feature = "network")]
pub use app::STATIONS;
pub use app::{App, COMPANION, FENCE, LINKS, MISSION, Mavlink, PORTS, RALLY, SATELLITE, TELEMETRY};
pub use battery::Battery;
pub use body::Vector;
pub use logs::{LOG_BYTES, LogMemory};
pub use status::Status;
pub use tuning::Tuning;
pub use vehicle::{GlobalPosition, Mode, Quadrotor};
