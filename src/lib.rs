//! mavstack
#![no_std]
#[cfg(test)]
extern crate std;
mod frame;
#[macro_use]
mod message;
pub use message::*;
#[cfg(feature = "defmt")]
#[doc(hidden)]
pub use defmt as __defmt;
