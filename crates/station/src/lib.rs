//! A ground station for tests of a vehicle that speaks MAVLink.
//!
//! A [`Station`] takes received bytes and the time, and returns bytes to send. A [`Dialogue`] is one thing that it does with a
//! vehicle: a command, a download of parameters, an upload of a plan. Timers, message forms, retries and times of giving up are
//! those of a real [`Client`], by name, because these are what breaks vehicles.
//!
//! ```text
//!            GroundStation: connect, set, upload_mission, arm, … one word for each dialogue
//!                  │
//!   ┌──────────────▼──────────── Drive: a rig of the kit, a serial port, a socket ───────────────┐
//!   │                                                                                            │
//!   │  Dialogue ── messages ──▶ Station ── bytes ──▶ line or port ── bytes ──▶ vehicle or board  │
//!   │     ▲                      │   ▲                                            │              │
//!   │     └──── frames, time ────┘   └────────────────── bytes ───────────────────┘              │
//!   └────────────────────────────────────────────────────────────────────────────────────────────┘
//!            Seen: vehicles, heartbeats, the last message of each id, texts, lost frames
//! ```
//!
//! Nothing here has a clock or a transport, except what implements [`Drive`]: the [`kit`] has a rig with a virtual clock, in which a
//! firmware's own stack and vehicle run, and a program drives the same dialogues over a serial port.
//!
//! # A test of one's own vehicle
//!
//! ```
//! use mavstack::{Duration, dialect::Attitude};
//! use mavstack_station::command::Place;
//! use mavstack_station::parameters::Value;
//! use mavstack_station::plans::waypoint;
//! use mavstack_station::{Drive, Failure, GroundStation};
//!
//! /// `vehicle` is a rig with your firmware, or a board on a serial port.
//! fn flies(vehicle: &mut impl Drive) -> Result<(), Failure> {
//!     vehicle.connect()?;
//!     vehicle.set("RTL_ALT", 45.0)?;
//!     vehicle.upload_mission(&[waypoint(Place::relative(47.4, 8.5, 30.0))])?;
//!     vehicle.arm()?;
//!     vehicle.set_interval::<Attitude>(Duration::from_millis(100))?;
//!     let attitude = vehicle.expect::<Attitude>(Duration::from_secs(1))?;
//!     assert!(attitude.roll.abs() < 0.1);
//!
//!     // A refusal has its reason, as the pilot reads it.
//!     let failure = vehicle.set("RTL_ALT", 9_999.0).expect_err("higher than allowed");
//!     assert!(matches!(failure, Failure::Param { .. }), "{failure}");
//!     assert_eq!(vehicle.get("RTL_ALT")?, Value::F32(45.0));
//!     Ok(())
//! }
//! ```
//!
//! [`kit::Firmware`] shows how a firmware becomes such a rig.
//!
//! # Dialogues
//!
//! | module | dialogues |
//! |---|---|
//! | [`connect`] | what the client does when it finds a vehicle, in its order |
//! | [`command`] | COMMAND_LONG, COMMAND_INT, progress, COMMAND_CANCEL |
//! | [`parameters`] | the list with its gaps, reads, sets with confirmation, the file `@PARAM/param.pck` |
//! | [`plans`] | missions, fences and rally points: up, down, cleared; the current item |
//! | [`modes`] | the list, and the three ways to set one |
//! | [`streams`] | requested messages, intervals, REQUEST_DATA_STREAM |
//! | [`files`], [`logs`] | MAVLink FTP; flight logs |
//! | [`events`], [`time`] | events without gaps; TIMESYNC, PING, SYSTEM_TIME |
//! | [`sticks`], [`control`] | sticks and setpoints at a rate; operator control |
//! | [`camera`], [`gimbal`] | cameras and gimbals |
//! | [`mod@signing`] | SETUP_SIGNING |
//!
//! The table at the top of each module says what the clients do differently. [`Again`] repeats a dialogue as a user does who presses
//! the button again. [`GroundStation::alongside`] runs one beside all that follow.
//!
//! A program for real boards must not send to an armed vehicle: see [`Station::set_sending`].
#![forbid(unsafe_code)]

mod again;
mod alongside;
pub mod camera;
mod client;
pub mod command;
pub mod connect;
pub mod control;
mod dialogue;
pub mod events;
mod failure;
pub mod files;
pub mod gimbal;
mod ground_station;
mod habits;
pub mod kit;
pub mod logs;
pub mod modes;
pub mod names;
pub mod parameters;
pub mod plans;
mod retry;
mod seen;
pub mod signing;
mod station;
pub mod sticks;
pub mod streams;
pub mod time;

pub use again::Again;
pub use alongside::{Alongside, Wait};
pub use client::Client;
pub use dialogue::{Dialogue, Drive, Io};
pub use failure::Failure;
pub use ground_station::GroundStation;
pub use retry::{Due, Retry};
pub use seen::{Heard, Seen, SeenText, SeenVehicle};
pub use station::{Received, Sending, Station};
