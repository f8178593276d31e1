//! Persistent storage of plans, parameters and the signing key, in NOR flash or FRAM.
//!
//! [`Store`] works with any [`NorFlash`](embedded_storage::nor_flash::NorFlash): the microcontroller's flash, an external
//! chip, or an FRAM with the driver [`Fram`]. It writes in bounded steps. If power fails at any moment, the restarted
//! vehicle has either the complete old content or the complete new content.

mod fram;
mod params;
mod plans;
mod record;
#[cfg(feature = "signing")]
mod signing;
mod store;

#[cfg(test)]
mod tests;

pub use fram::{Fram, FramError};
pub use record::RestoreError;
pub(crate) use record::Step;
pub(crate) use record::{Format, Record};
pub(crate) use store::{Body, KINDS, persist, read};
pub use store::{Persistent, RestoreErrors, Store};
