//! What `cargo xtask` and `cargo measure` share.

pub mod emulator;
pub mod firmware;
pub mod python;
pub mod system;
pub mod toolchain;
