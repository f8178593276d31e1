//! Services: what a vehicle does for those who talk to it.
//!
//! Each is a plain struct with two verbs: `on_…` takes a message and changes state, `next` writes at most one message when
//! a link has room. What is owed is remembered as a flag, a cursor or a slot, never as bytes, so a full link delays an
//! answer and never loses it (D-3).

mod clock;
pub mod command;
pub(crate) mod heartbeat;
pub mod high_latency;
pub(crate) mod identity;
pub mod manual_control;
pub mod mission;
pub mod mode;
pub mod param;
#[cfg(feature = "signing")]
pub mod signing;
pub(crate) mod statustext;
pub(crate) mod stream;
pub mod time;
mod wall_clock;
mod wear;
