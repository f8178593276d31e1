//! Plans, parameters and the signing key in flash, through power cuts, damage and floods.

#![cfg(feature = "storage")]

#[path = "../support/mod.rs"]
mod support;

#[cfg(feature = "embedded-storage-async")]
mod async_store;
#[cfg(feature = "signing")]
mod damage;
#[cfg(feature = "signing")]
mod early;
mod flash_garbage;
mod lifetime;
#[cfg(feature = "signing")]
mod pace;
mod pages;
mod partition;
mod plan_files;
mod power_cut;
mod records;
#[cfg(feature = "signing")]
mod signing_key;
mod stall;
mod stm32f4;
mod worn;

use embedded_storage::nor_flash::NorFlash;
use mavstack::__private::{Declares, Storage};
use mavstack::Config;
use mavstack::dialect::{MavMissionResult, MissionItemInt};
use mavstack::plan::Durability;
use mavstack::storage::{RestoreError, RestoreErrors, Store};
use support::{Setup, Upload, World};

#[cfg(feature = "signing")]
/// A stack that stores the signing key and nothing else.
#[derive(mavstack::Stack)]
#[stack(vehicle: support::TestVehicle, links: 1, signing, commands: { slots: 1 }, storage)]
struct OnlyKey;

/// Returns whether the key was restored.
#[cfg(feature = "signing")]
fn of_key(restored: Result<(), RestoreErrors>) -> Result<(), RestoreError> {
    restored.or_else(|errors| errors.signing.map_or(Ok(()), Err))
}

/// Returns whether the parameters were restored.
fn of_parameters(restored: Result<(), RestoreErrors>) -> Result<(), RestoreError> {
    restored.or_else(|errors| errors.parameters.map_or(Ok(()), Err))
}

/// Returns whether the plans were restored.
fn of_plans(restored: Result<(), RestoreErrors>) -> Result<(), RestoreError> {
    restored.or_else(|errors| errors.plans.map_or(Ok(()), Err))
}

/// Returns a setup with this durability.
fn setup(durability: Durability) -> Setup<1> {
    let setup = Setup::new();
    Setup { config: Config { durability, ..setup.config }, ..setup }
}

/// Uploads a plan while storage runs, and returns the answer.
fn upload<const N: usize, D: Declares<Storage = Storage, Vehicle: Default>, F: NorFlash>(
    world: &mut World<N, D>,
    store: &mut Store<F>,
    items: &[MissionItemInt],
) -> MavMissionResult {
    let mut upload = Upload::new(&world.gcs[0], items);
    while upload.result().is_none() {
        world.step();
        world.stack.persist(world.now(), store, &mut world.vehicle);
        upload.poll(world.now(), &mut world.gcs[0]);
    }
    upload.answer()
}
