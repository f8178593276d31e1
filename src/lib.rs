//! The autopilot's side of MAVLink for microcontrollers: no `std`, no allocation, beside the flight loop.
//!
//! A [`Stack`] owns all its memory and is driven by a few calls that never block and do a bounded amount of work. Time is
//! an argument, bytes come in and go out; there is no clock, no global and no lock inside, so the same input at the same
//! time gives the same output.
//!
//! ```
//! use mavstack::dialect::command_rules::{NAV_RETURN_TO_LAUNCH, NAV_WAYPOINT};
//! use mavstack::dialect::commands::ComponentArmDisarm;
//! use mavstack::dialect::{MavModeFlag, MavResult, MavState, MissionState};
//! use mavstack::*;
//! # use std::convert::Infallible;
//! # struct Uart;
//! # impl embedded_io::ErrorType for Uart { type Error = Infallible; }
//! # impl embedded_io::Read for Uart { fn read(&mut self, _: &mut [u8]) -> Result<usize, Infallible> { Ok(0) } }
//! # impl embedded_io::ReadReady for Uart { fn read_ready(&mut self) -> Result<bool, Infallible> { Ok(false) } }
//! # impl embedded_io::Write for Uart {
//! #     fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> { Ok(bytes.len()) }
//! #     fn flush(&mut self) -> Result<(), Infallible> { Ok(()) }
//! # }
//! # impl embedded_io::WriteReady for Uart { fn write_ready(&mut self) -> Result<bool, Infallible> { Ok(true) } }
//! # let mut uart = Uart;
//! # let clock = || Instant::ZERO;
//! static PULSE: Pulse = Pulse::new();
//! const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
//! const TELEM: LinkId = LinkId(0);
//!
//! struct Rover { armed: bool }
//!
//! impl Vehicle for Rover {
//!     fn state(&self) -> Option<VehicleState> {
//!         let base_mode = if self.armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
//!         Some(VehicleState { base_mode, custom_mode: 0, system_status: MavState::STANDBY })
//!     }
//! }
//!
//! impl Commands for Rover {
//!     fn command(&mut self, command: &Command) -> Outcome {
//!         // UNSUPPORTED when it is another command, DENIED when its parameters are invalid.
//!         match command.decode() {
//!             Ok(ComponentArmDisarm { arm, .. }) if !command.is_broadcast => self.armed = arm,
//!             Ok(_) => return MavResult::DENIED.into(),
//!             Err(result) => return result.into(),
//!         }
//!         MavResult::ACCEPTED.into()
//!     }
//! }
//!
//! impl Plans for Rover {
//!     const MISSION_COMMANDS: &'static [CommandRule] = &[NAV_WAYPOINT, NAV_RETURN_TO_LAUNCH];
//!
//!     fn plan_changed(&mut self, _: PlanChange<'_>) {}
//!     fn progress(&self) -> Progress {
//!         Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
//!     }
//! }
//!
//! // Nothing to tell but the heartbeat.
//! impl Telemetry for Rover {}
//!
//! impl Parameters for Rover {
//!     type Table = NoParams;
//! }
//!
//! let mut vehicle = Rover { armed: false };
//! let mut stack: Stack<1, plan_memory!(mission: 100)> = Stack::new(CONFIG, [LinkConfig::uart(57_600)]);
//! loop {
//!     let now = clock();
//!     // … the flight loop's own work, then its sign of life: no tick, no heartbeat
//!     PULSE.tick();
//!     stack.poll(now, &mut vehicle);
//!     if let Err(error) = stack.poll_link(now, TELEM, &mut uart, &mut vehicle) {
//!         // The link goes on; count it, or show it.
//!         let _ = error;
//!     }
//! #   break;
//! }
//! ```
//!
//! # Layers
//!
//! Data flows in one direction, and each layer is public, to be used without the ones above it:
//!
//! | layer | what it is |
//! |---|---|
//! | [`Decoder`], [`Frame`], [`encode`] | bytes to checked frames and back, v1 and v2 |
//! | [`Message`], [`message!`], [`mod@dialect`] | what a payload means: all of MAVLink's `common`, and your own messages |
//! | [`LinkConfig`], [`PeerInfo`], [`ForwardQueues`] | what is kept of each line and each sender; what goes on from one to the other |
//! | the services | heartbeat, commands, modes, plans, parameters, streams, texts, identity, time, manual control, signing, the high-latency link |
//! | [`Stack`] | all of it behind [`poll`](Stack::poll) and [`poll_link`](Stack::poll_link) |
//! | [`mod@io`] | between the stack and a UART |
//!
//! Beside them stand [`wpl`], plans as files, and with the feature `fmt` `metadata`, what a ground station shows of
//! parameters.
//!
//! A firmware implements [`Vehicle`], [`Commands`], [`Plans`], [`Telemetry`] and [`Parameters`]; each is drawn, or shown by an
//! example, at its trait. What not every vehicle has needs memory of the vehicle's own and costs nothing without:
//! [`CommandMemory`], [`ManualInput`], [`TimeSync`], [`HighLatency`], [`ForwardQueues`], and `Signing`.
//!
//! For UARTs it hands over anything that is `embedded_io::{Read, Write, ReadReady, WriteReady}`. [`mod@io`] has such an end for a
//! UART served by an interrupt, a reader for circular DMA buffers, and adapters for HALs with other traits. The byte-level
//! calls ([`receive`](Stack::receive), [`transmit`](Stack::transmit) and their kin) are for everything else.
//!
//! # Guides
//!
//! - [Porting](https://github.com/mavstack/mavstack/blob/main/docs/porting.md): from a UART and a clock to a vehicle that a
//!   ground station flies, step by step, and which HAL needs what.
//! - [Sizing](https://github.com/mavstack/mavstack/blob/main/docs/sizing.md): bytes of flash and RAM, option by option.
//! - [Coming from rust-mavlink, mavio or the C library](https://github.com/mavstack/mavstack/blob/main/docs/coming-from.md):
//!   what you wrote there, what you write here.
//! - [Architecture](https://github.com/mavstack/mavstack/blob/main/docs/architecture.md) on one page,
//!   [what is proven and what is not](https://github.com/mavstack/mavstack/blob/main/docs/safety.md), and
//!   [each rule with the tests that cite it](https://github.com/mavstack/mavstack/blob/main/docs/conformance.md).
//!
//! # Guarantees
//!
//! - No `unsafe`, no allocation, no recursion. Received bytes cannot cause a panic.
//! - [`poll_link`](Stack::poll_link) calls only what the transport says will not block, and stays within
//!   [`PollBudget`].
//! - What was accepted is answered: a full transmit buffer delays an answer and never loses it. A request whose answer
//!   could not be remembered is not carried out, and is counted.
//! - Heartbeats stop when the flight loop stops ticking its [`Pulse`], whatever else still runs.
//! - A plan is replaced as a whole or not at all.
//!
//! Letters with numbers, as in S-13, name the behaviour rules that the tests cite.
//!
//! # Features
//!
//! - `defmt`: `Format` on the public types, and log events: one per protocol transition, and drop counters at most once a
//!   second.
//! - `embedded-hal-nb`, `embedded-io-06`, `embedded-io-async`: adapters for UARTs with those traits, see [`mod@io`].
//! - `fmt`: what needs `core::fmt`: `write!` into a [`Text`], `Stack::send_fmt`, and the files of component metadata
//!   (`metadata`).
//! - `plan-texts` (default): a STATUSTEXT with the reason for every plan, item, parameter, command and mode that the stack
//!   refuses. Rate limits: one text a second for parameters, and one a second on each link for commands and modes.
//! - `signing`: frames are signed and verified, see `Signing`.
//! - `storage`: plans and parameters that survive power loss, in NOR flash or FRAM; with `signing` also the key.
#![no_std]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::arithmetic_side_effects,
        clippy::as_conversions
    )
)]

#[cfg(test)]
extern crate std;

/// The code of the guides compiles.
#[cfg(doctest)]
mod guides {
    #[doc = include_str!("../docs/coming-from.md")]
    mod coming_from {}
    #[doc = include_str!("../docs/porting.md")]
    mod porting {}
}

#[macro_use]
mod log;
mod config;
mod crc32;
pub mod dialect;
mod frame;
pub mod io;
mod link;
mod list;
mod message;
#[cfg(feature = "fmt")]
pub mod metadata;
mod network;
mod num;
mod pulse;
mod service;
mod stack;
#[cfg(feature = "storage")]
mod storage;
mod time;
mod vehicle;
pub mod wpl;

pub use config::{Config, PollBudget, VehicleAddress};
pub use frame::{
    Address, ComponentId, Decoder, EncodeError, Frame, Header, MAX_FRAME_LEN, RxCounters, Signature, SystemId, Version,
    encode,
};
#[cfg(feature = "signing")]
pub use frame::{SigningKey, encode_signed};
pub use link::{LinkClass, LinkConfig, LinkCounters, LinkError, LinkId, MAX_LINKS, Peer, TxVersion};
pub use message::*;
pub use network::{ForwardCounters, ForwardQueues, Forwarding, PeerInfo};
pub use pulse::Pulse;
#[doc(hidden)]
pub use service::command::CommandParams;
pub use service::command::{
    CommandMemory, CommandParam, CommandPolicy, CommandSlot, CommandSlots, LatLon, Location, TypedCommand,
};
pub use service::high_latency::{
    HighLatency, HighLatencyConfig, HighLatencyCounters, HighLatencyMode, HighLatencySample,
};
pub use service::identity::Identity;
pub use service::manual_control::{ControlSource, ManualControlInput, ManualCounters, ManualInput, RcOverride};
#[doc(hidden)]
pub use service::mission::__largest;
pub use service::mission::{
    CommandRule, Durability, Item, MAX_ITEMS, NoPlans, ParamRule, PlanCounters, PlanMemory, PlanStorage, PlanType,
    PlanView,
};
pub use service::mode::{CustomMode, FlightMode, MAX_MODES, ModeRequest};
pub use service::param::{
    MAX_PARAMS, NoParams, Param, ParamChange, ParamEncoding, ParamHash, ParamInfo, ParamTable, ParamType, Parameters,
};
#[doc(hidden)]
pub use service::param::{ParamMemory as __ParamMemory, TableMut as __ParamTableMut};
#[cfg(feature = "signing")]
pub use service::signing::{Accept, LinkSigning, Signing, SigningCounters, SigningMemory, SigningStream};
pub use service::statustext::MAX_TEXT_LEN;
pub use service::stream::{Fill, MAX_STREAMS, Stream, StreamProfile};
pub use service::time::{ClockFilter, TimeSample, TimeSlot, TimeSlots, TimeSync, WallClock};
pub use stack::Stack;
#[cfg(all(feature = "storage", feature = "signing"))]
pub use storage::SigningStore;
#[cfg(feature = "storage")]
pub use storage::{Fram, FramError, ParamStore, PlanStore, RestoreError};
pub use time::{Duration, Instant};
pub use vehicle::{
    Autopilot, Command, CommandPosition, Commands, Outcome, PeerEvent, PlanChange, PlanFault, Plans, Progress,
    Telemetry, Vehicle, VehicleState,
};

#[cfg(feature = "defmt")]
#[doc(hidden)]
pub use defmt as __defmt;
