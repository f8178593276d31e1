//! Records that survive power loss, in NOR flash and in FRAM.
//!
//! [`PlanStore`] keeps the plans, [`ParamStore`] the parameters, `SigningStore` the signing key, over anything that is
//! [`NorFlash`](embedded_storage::nor_flash::NorFlash): the microcontroller's own flash, a chip beside it, or an FRAM by
//! [`Fram`]. Writing goes in bounded steps; whatever moment the power goes, the restarted vehicle has exactly what was
//! complete before, or exactly the new.

mod fram;
mod params;
mod plans;
mod record;
#[cfg(feature = "signing")]
mod signing;

#[cfg(test)]
mod tests;

pub use fram::{Fram, FramError};
pub use params::ParamStore;
pub use plans::PlanStore;
pub use record::RestoreError;
pub(crate) use record::Step;
#[cfg(feature = "signing")]
pub use signing::SigningStore;
