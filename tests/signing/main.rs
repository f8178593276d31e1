//! Message signing. Tests of stored keys are in `storage/`.

#![cfg(feature = "signing")]

#[path = "../support/mod.rs"]
mod support;

mod claims;
mod clocks;
mod protocol;
mod pymavlink;
mod replay;
mod setup;
mod vectors;
