//! Frames and messages, byte by byte.

#[path = "../golden/all.rs"]
mod all;
#[path = "../support/mod.rs"]
mod support;

mod byte_stream;
mod dialect;
mod golden;
mod secrets;
mod single_frame;

// `all` compiles the generated dialect again, which expects these names at the root of its crate.
use all::{command, dialect, message, wire_bitmask, wire_enum};
mod message {
    pub use mavstack::message::{CommandRule, Location, ParamRule, Secret, Text};
}
