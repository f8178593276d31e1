//! mavstack
#![no_std]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::arithmetic_side_effects,
        clippy::as_conversions
    )
)]
#[cfg(test)]
extern crate std;

#[macro_use]
mod log;
#[macro_use]
mod message;
pub mod dialect;
mod frame;
mod time;

pub use frame::{
    Address, ComponentId, Decoder, EncodeError, Frame, Header, MAX_FRAME_LEN, RxCounters, Signature, SystemId, Version,
    encode,
};
pub use message::*;
pub use time::{Duration, Instant};

#[cfg(feature = "defmt")]
#[doc(hidden)]
pub use defmt as __defmt;
