//! The types of a firmware that every service may use.

use super::plans::PlanMemory;

/// A firmware: its vehicle, and the data that several services use. [`stack!`](crate::stack) implements it.
#[doc(hidden)]
pub trait Firmware: Sized + 'static {
    /// The type that implements the hooks.
    type Vehicle;
    /// The memory of the plans.
    type Plans: PlanMemory;
    /// The table of the parameters.
    type Parameters: Values;
    /// Whether the vehicle has flight modes: `modes` is declared.
    const HAS_MODES: bool = false;
    /// Whether there is a queue of texts.
    const HAS_TEXTS: bool = true;
}

/// The values of a table of parameters, each in 32 bits: the bits of a float, or an integer in the low bytes.
#[doc(hidden)]
#[diagnostic::on_unimplemented(message = "`{Self}` is no table of parameters", note = "declare it with `parameters!`")]
pub trait Values {
    fn values(&self) -> &[u32];
}
