//! The demo vehicle: flights through its hooks without a stack, and over simulated links.

mod support;

mod commands;
mod fence;
mod flight;
mod logs;
mod manual;
mod mission;
mod modes;
mod offboard;
mod operators;
mod params;
mod partners;
mod progress;
mod rally;
mod refusals;
mod routing;
mod satellite;
mod signing;
mod survey;
mod table;
mod telemetry;
