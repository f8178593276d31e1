//! Message signing. Keys in storage have their tests in `storage/`.

#![cfg(feature = "signing")]

#[path = "../support/mod.rs"]
mod support;

mod clocks;
mod protocol;
mod pymavlink;
mod replay;
mod setup;
mod vectors;
