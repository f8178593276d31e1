//! A ground station for tests of a vehicle that speaks MAVLink.
//!
//! A [`Station`] takes received bytes and the time, and returns bytes to send. A [`Dialogue`] is one thing that it does with a
//! vehicle: a command, a download of parameters, an upload of a plan. Timers, message forms, retries and times of giving up are
//! those of a real [`Client`], by name.
//!
//! ```text
//!              ┌──────────────────────── Drive: a rig, a serial port ───────────────────────┐
//!   test ──▶ Dialogue ── messages ──▶ Station ── bytes ──▶ line ── bytes ──▶ vehicle (or a board)
//!              ▲                        │  ▲                                    │
//!              └──── frames, time ──────┘  └──────────────── bytes ─────────────┘
//! ```
#![forbid(unsafe_code)]

mod again;
mod alongside;
pub mod camera;
mod client;
pub mod command;
pub mod connect;
pub mod control;
pub mod dialogue;
pub mod events;
pub mod files;
pub mod gimbal;
pub mod kit;
pub mod logs;
pub mod modes;
pub mod names;
pub mod parameters;
pub mod plans;
mod seen;
pub mod signing;
mod station;
pub mod sticks;
pub mod streams;
pub mod time;

pub use again::Again;
pub use alongside::{Alongside, Wait};
pub use client::Client;
pub use dialogue::{Beside, Dialogue, Drive, Due, Failure, GroundStation, Io, Retry};
pub use seen::{Heard, Seen, SeenText, SeenVehicle};
pub use station::{Received, Station};
