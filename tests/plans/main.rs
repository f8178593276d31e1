//! Missions, fences and rally points: transfers, progress, checks of items, and plan files.

#[path = "../support/mod.rs"]
mod support;

mod mission;
mod mission_lossy;
mod mission_speed;
mod mission_v1;
mod progress;
mod rules;
mod wpl;
mod wpl_pymavlink;
