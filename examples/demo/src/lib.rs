//! The demo vehicle and its main loop, shared by the firmware in QEMU and the simulator on the host.
//!
//! [`Quadrotor`] is the vehicle: what a firmware with real sensors and motors would replace. [`App`] is the loop's body:
//! the stack, the vehicle and how they are joined, as in any firmware.
#![no_std]

mod angle;
mod app;
mod battery;
mod body;
pub mod connect;
mod fence;
mod geo;
mod plan;
mod queue;
pub mod status;
mod telemetry;
mod tuning;
mod vehicle;

pub use app::{App, COMPANION, LINKS, SATELLITE, TELEMETRY};
pub use battery::Battery;
pub use body::Vector;
pub use status::Status;
pub use tuning::Tuning;
pub use vehicle::{GlobalPosition, Mode, Quadrotor};
