//! A camera and its settings: the camera protocol, and extended parameters.

#[path = "../support/mod.rs"]
mod support;

mod capture;
mod commands;
mod component;
mod ext_parameters;
mod messages;
mod properties;
mod shooter;
