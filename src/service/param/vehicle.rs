//! What the service asks of a vehicle.

use super::{ParamChange, ParamEncoding, ParamTable};
use crate::dialect::MavParamError;

/// Parameters: the vehicle owns their values, and has its say when somebody sets one.
///
/// A vehicle without any writes `impl Parameters for Rover { type Table = NoParams; }`.
///
/// ```
/// use mavstack::dialect::MavParamError;
/// use mavstack::{ParamChange, Parameters, parameters};
///
/// parameters! {
///     /// What can be tuned on this rover.
///     pub struct Tuning {
///         /// Voltage under which it goes home.
///         BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
///         /// System id.
///         SYS_ID: u8 = 1, 1..=254, "", [reboot_required];
///     }
/// }
///
/// struct Rover { armed: bool, tuning: Tuning }
///
/// impl Parameters for Rover {
///     type Table = Tuning;
///
///     fn parameters_mut(&mut self) -> Option<&mut Tuning> {
///         Some(&mut self.tuning)
///     }
///
///     fn may_set(&mut self, change: &ParamChange<Tuning>) -> Result<(), MavParamError> {
///         if self.armed && change.is(Tuning::SYS_ID) { Err(MavParamError::PERMISSION_DENIED) } else { Ok(()) }
///     }
/// }
///
/// let mut rover = Rover { armed: false, tuning: Tuning::new() };
/// assert_eq!(rover.tuning.get(Tuning::BAT_LOW), 10.5);
/// assert!(rover.tuning.set(Tuning::BAT_LOW, 11.0));
/// assert!(!rover.tuning.set(Tuning::BAT_LOW, 20.0));
/// assert_eq!(rover.tuning.get(Tuning::BAT_LOW), 11.0);
/// ```
pub trait Parameters {
    /// The table, made by [`parameters!`](crate::parameters), or [`NoParams`](crate::NoParams).
    type Table: ParamTable;

    /// How integers stand on the wire: the same for all of them, and announced by AUTOPILOT_VERSION (P-2).
    const PARAM_ENCODING: ParamEncoding = ParamEncoding::Bytewise;

    /// When the checksum of all parameters is sent (P-20); only with byte-wise encoding, for a cast would lose the half of it.
    const PARAM_HASH: ParamHash = ParamHash::ByName;

    /// Whether who asks for what cannot be gets PARAM_ERROR (P-30). Without it the message is not linked; a client finds out
    /// by the value that stays as it was, and by a text.
    const PARAM_ERROR: bool = true;

    /// The table, which is also the service's memory. `None`, as at first, for a vehicle without parameters: the service is not linked, and nobody is answered.
    /// QGroundControl never gets ready with such a vehicle (P-18).
    fn parameters_mut(&mut self) -> Option<&mut Self::Table> {
        None
    }

    /// Whether a parameter may be set from outside now, to a value that its type and range allow and that is not the one it
    /// has. Not asked when the stored values are read back or all are reset, which is refused while the vehicle is armed.
    ///
    /// # Errors
    ///
    /// What PARAM_ERROR says (P-14), where it is [sent](Self::PARAM_ERROR); [`MavParamError::PERMISSION_DENIED`] for a matter of policy.
    fn may_set(&mut self, change: &ParamChange<Self::Table>) -> Result<(), MavParamError> {
        let _ = change;
        Ok(())
    }

    /// A parameter has got another value, from outside or from storage. Not called for what the vehicle sets itself.
    fn parameter_changed(&mut self, change: &ParamChange<Self::Table>) {
        let _ = change;
    }
}

/// When `_HASH_CHECK` is sent, the checksum of all parameters, by which a ground station knows whether it has their values from
/// last time (P-20).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ParamHash {
    /// Not at all: it is not linked.
    Never,
    /// To who reads it by its name.
    ByName,
    /// Also at the beginning of every list, as PX4 does. For a vehicle that calls itself PX4: of any other one QGroundControl and
    /// MAVProxy take it for a parameter.
    InList,
}
