//! The command protocol and the flight modes.

#[path = "../support/mod.rs"]
mod support;

mod checks;
mod every_command;
mod long;
mod mode_requests;
mod modes;
mod once;
mod protocol;
#[cfg(feature = "plan-texts")]
mod refusal_texts;
mod typed;

// What the generated dialect, which `every_command` compiles once more, expects in the root of its crate.
use every_command::{command, dialect, message, wire_bitmask, wire_enum};
mod message {
    pub use mavstack::message::{CommandRule, Location, ParamRule, Secret, Text};
}
