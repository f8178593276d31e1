//! The code that the guides in `docs/` quote. A file for each topic; `tests/api/pages.rs` compares each quote with its file.
//!
//! What a firmware has and the guides do not show, such as a HAL, are stand-ins at the end of each file.
#![no_std]
#![allow(dead_code, reason = "a guide shows more than the tests call")]

#[cfg(test)]
extern crate std;

mod coming_from;
mod rc_over_mavlink;
mod start;
mod storage;
mod tasks;
mod transports;
mod vehicle;
