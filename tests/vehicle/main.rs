//! What a vehicle reports, its parameters, and manual control.

#[path = "../support/mod.rs"]
mod support;

mod heartbeat;
mod manual_control;
mod manual_properties;
mod messages;
#[cfg(feature = "fmt")]
mod metadata;
mod params;
mod statustext;
mod streams;
mod time;
