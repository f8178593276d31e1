#![doc = include_str!("../README.md")]
#![no_std]
#![deny(
    clippy::arithmetic_side_effects,
    clippy::as_conversions,
    clippy::indexing_slicing,
    clippy::panic,
    clippy::unwrap_used,
    clippy::expect_used
)]

mod eeprom;
mod error;
mod fram;
mod memory;

pub use eeprom::{Eeprom, PageByPage};
pub use error::Error;
pub use fram::{Fram, Immediate};
pub use memory::SpiMemory;
