//! The dialogues with a vehicle that has every service, as each client leads them, on good and on bad lines.

mod commands;
mod connect;
mod forms;
mod lines;
mod modes;
mod parameters;
mod plans;
mod sending;
mod streams;
mod vehicle;
