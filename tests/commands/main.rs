//! The command protocol and the flight modes.

#[path = "../support/mod.rs"]
mod support;

mod checks;
mod client;
mod client_links;
mod client_lossy;
mod client_params;
mod every_command;
mod long;
mod mode_requests;
mod modes;
mod once;
mod places;
mod promises;
mod protocol;
#[cfg(feature = "plan-texts")]
mod refusal_texts;
mod typed;

// `every_command` compiles the generated dialect again, which expects these names at the root of its crate.
use every_command::{command, dialect, message, wire_bitmask, wire_enum};
mod message {
    pub use mavstack::message::{CommandRule, Location, ParamRule, Secret, Text};
}
