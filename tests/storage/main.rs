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

use mavstack::Config;
use mavstack::plan::Durability;
use mavstack::storage::{RestoreError, RestoreErrors};
use support::{Setup, TestVehicle};

mavstack::stack! {
    /// The signing key only: a store that is as long as it needs has no room for anything else.
    #[cfg(feature = "signing")]
    struct OnlyKey for TestVehicle { links: 1, signing, commands: { slots: 1 } }
}

/// Returns what was read of the key.
fn of_key<E>(restored: Result<(), RestoreErrors<E>>) -> Result<(), RestoreError<E>> {
    restored.or_else(|errors| errors.signing.map_or(Ok(()), Err))
}

/// Returns what was read of the parameters.
fn of_parameters<E>(restored: Result<(), RestoreErrors<E>>) -> Result<(), RestoreError<E>> {
    restored.or_else(|errors| errors.parameters.map_or(Ok(()), Err))
}

/// Returns what was read of the plans.
fn of_plans<E>(restored: Result<(), RestoreErrors<E>>) -> Result<(), RestoreError<E>> {
    restored.or_else(|errors| errors.plans.map_or(Ok(()), Err))
}

/// A world with this durability.
fn setup(durability: Durability) -> Setup<1> {
    let setup = Setup::new();
    Setup { config: Config { durability, ..setup.config }, ..setup }
}
