//! The whole stack: order and budget of a poll, minimal vehicles, random traffic, and regressions.

#[path = "../support/mod.rs"]
mod support;

mod clock;
#[cfg(feature = "storage")]
mod example_rover;
mod honest;
mod liveness;
mod minimal;
mod no_block;
mod order;
mod properties;
mod regressions;
mod shares;
mod two_hours;
