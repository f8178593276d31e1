//! Persistent storage of plans, parameters and the signing key, in NOR flash or FRAM.
//!
//! [`PlanStore`], [`ParamStore`] and `SigningStore` work with any [`NorFlash`](embedded_storage::nor_flash::NorFlash): the
//! microcontroller's flash, an external chip, or an FRAM with the driver [`Fram`]. They write in bounded steps. If
//! power fails at any moment, the restarted vehicle has either the complete old content or the complete new content.

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
