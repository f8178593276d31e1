//! The types of a firmware that every service may use.

use super::command::{Command, Outcome};
use super::component::Component;
use super::context::Context;
use super::credits::CreditMemory;
use super::plans::PlanMemory;
use crate::dialect::MavResult;
use crate::message::ComponentId;

/// A firmware: its vehicle, and the data that several services use. [`derive(Stack)`](macro@crate::Stack) implements
/// it.
pub trait Firmware: Sized + 'static {
    /// The type that implements the hooks.
    type Vehicle;
    /// The memory of the plans.
    type Plans: PlanMemory;
    /// The table of the parameters.
    type Parameters: Values;
    /// What is left of the credits of the high-latency links.
    #[doc(hidden)]
    type Credits: CreditMemory;
    /// Whether the vehicle has flight modes: `modes` is declared.
    const HAS_MODES: bool = false;
    /// Whether there is a queue of texts.
    const HAS_TEXTS: bool = true;
    /// Whether a system can be in control: `operator_control` is declared.
    const HAS_CONTROL: bool = true;
    /// Whether there are streams, and transfers of files that slow them.
    const SLOWS_STREAMS: bool = false;
    /// The components of the firmware besides the autopilot.
    const COMPONENTS: &'static [Component] = &[];
    /// Whether the firmware may run without them.
    const HAS_OPTIONAL_COMPONENTS: bool = false;

    /// Calls the hook for a command to another component of the firmware.
    fn component_command(vehicle: &mut Self::Vehicle, cx: &mut Context<'_>, command: &Command) -> Outcome {
        let _ = (vehicle, cx, command);
        MavResult::UNSUPPORTED.into()
    }

    /// Whether this is the id of a component of the firmware besides the autopilot.
    fn is_component(id: ComponentId) -> bool {
        Self::COMPONENTS.iter().any(|component| component.id == id)
    }
}

/// The values of a table of parameters, each in 32 bits: the bits of a float, or an integer in the low bytes.
#[diagnostic::on_unimplemented(message = "`{Self}` is no table of parameters", note = "declare it with `parameters!`")]
pub trait Values {
    /// Returns the values, in the order of the table.
    fn values(&self) -> &[u32];
}
