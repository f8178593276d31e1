//! mavstack
#![no_std]
#[cfg(test)]
extern crate std;
mod frame;
#[macro_use]
mod message;
#[cfg(feature = "defmt")]
#[doc(hidden)]
pub use defmt as __defmt;
pub use message::*;
