//! Plans, parameters and the signing key in flash and FRAM, through power cuts, damage and floods.

#![cfg(feature = "storage")]

#[path = "../support/mod.rs"]
mod support;

#[cfg(feature = "signing")]
mod damage;
mod flash_garbage;
mod fram;
#[cfg(feature = "signing")]
mod pace;
mod power_cut;
#[cfg(feature = "signing")]
mod signing_key;
