//! The flight modes of a vehicle, and its hook for requests.

use crate::dialect::{MavModeProperty, MavStandardMode};
use crate::time::Duration;
use crate::types::{Context, LinkClass, Outcome, Peer, Vehicle};

/// The maximum number of modes of a vehicle.
pub const MAX_MODES: usize = 32;

/// The maximum length of a name: AVAILABLE_MODES terminates it by a NUL.
const MAX_NAME: usize = 34;

/// A flight mode: a row of [`Modes::MODES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FlightMode {
    /// The value of [`VehicleState::custom_mode`](crate::VehicleState::custom_mode) in this mode. Each mode has a
    /// different one.
    pub custom_mode: u32,
    /// The name that ground stations show: 1 to 34 bytes.
    pub name: &'static str,
    /// The standard mode that it is, if any. No two modes may be the same standard mode.
    pub standard_mode: MavStandardMode,
    /// Properties for the ground station. A request for a mode with
    /// [`NOT_USER_SELECTABLE`](MavModeProperty::NOT_USER_SELECTABLE) is DENIED.
    pub properties: MavModeProperty,
}

impl FlightMode {
    /// Returns a mode that only this vehicle has, and that any peer may request.
    ///
    /// MAV_CMD_DO_SET_MODE cannot request a `custom_mode` of more than 24 significant bits, because its parameters are
    /// `f32`. SET_MODE can.
    pub const fn new(custom_mode: u32, name: &'static str) -> Self {
        let (standard_mode, properties) = (MavStandardMode::NON_STANDARD, MavModeProperty::EMPTY);
        Self { custom_mode, name, standard_mode, properties }
    }

    /// Returns the same mode as a standard mode, which MAV_CMD_DO_SET_STANDARD_MODE requests.
    #[must_use]
    pub const fn with_standard_mode(self, standard_mode: MavStandardMode) -> Self {
        Self { standard_mode, ..self }
    }

    /// Returns the same mode with these properties. `with` combines several.
    #[must_use]
    pub const fn with_properties(self, properties: MavModeProperty) -> Self {
        Self { properties, ..self }
    }

    /// Checks a table: at most [`MAX_MODES`] modes, each number and each standard mode once, names of 1 to 34 bytes.
    #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
    #[doc(hidden)]
    pub const fn check(table: &[Self]) {
        assert!(table.len() <= MAX_MODES, "a vehicle has at most 32 modes");
        let mut i = 0;
        while i < table.len() {
            let FlightMode { custom_mode, name, standard_mode, .. } = table[i];
            assert!(!name.is_empty() && name.len() <= MAX_NAME, "a mode's name has 1 to 34 bytes: shorten it");
            let mut j = 0;
            while j < i {
                assert!(custom_mode != table[j].custom_mode, "two modes with the same custom_mode");
                let is_same = standard_mode.0 == table[j].standard_mode.0;
                assert!(
                    !is_same || standard_mode.0 == MavStandardMode::NON_STANDARD.0,
                    "two modes that are the same standard mode"
                );
                j += 1;
            }
            i += 1;
        }
    }
}

/// How parameters 2 and 3 of MAV_CMD_DO_SET_MODE encode a `custom_mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CustomMode {
    /// Parameter 2 is the `custom_mode`, and parameter 3 is ignored: the encoding of ArduPilot.
    Whole,
    /// Parameter 2 is the main mode and parameter 3 the sub-mode, each 0 to 255: `main << 16 | sub << 24`. This is the
    /// encoding of PX4, which MAVSDK uses with every autopilot except ArduPilot. If there is no sub-mode, a parameter 2
    /// above 255 is the whole `custom_mode`, as with [`Whole`](Self::Whole).
    MainSub,
}

/// The sender of a request for a mode, and the circumstances.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ModeRequest {
    /// The sender, and the link.
    pub from: Peer,
    /// As [`Command::class`](crate::Command::class).
    pub class: LinkClass,
    /// As [`Command::age`](crate::Command::age).
    pub age: Option<Duration>,
    /// Whether the request is addressed to every system (C-1).
    pub is_broadcast: bool,
}

/// Flight modes, for a vehicle that declares `modes` in [`#[stack]`](macro@crate::Stack). Without it, the two
/// commands about
/// modes reach [`Commands::command`](crate::Commands::command), and SET_MODE reaches [`Vehicle::message`].
///
/// ```
/// use mavstack::dialect::{MavModeProperty, MavResult, MavStandardMode};
/// use mavstack::{Context, CustomMode, FlightMode, ModeRequest, Modes, Outcome, Vehicle, VehicleState};
///
/// const HOLD: u32 = 0x0304_0000;
/// const RETURN: u32 = 0x0504_0000;
/// const AFLOAT: u32 = 0x0009_0000;
///
/// struct Copter { mode: u32, has_fix: bool }
///
/// # impl Vehicle for Copter { fn state(&self) -> Option<VehicleState> { None } }
/// impl Modes for Copter {
///     const MODES: &'static [FlightMode] = &[
///         FlightMode::new(HOLD, "Hold"),
///         FlightMode::new(RETURN, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
///         // Reported, but no peer can request it.
///         FlightMode::new(AFLOAT, "Afloat").with_properties(MavModeProperty::NOT_USER_SELECTABLE),
///     ];
///     const CUSTOM_MODE: CustomMode = CustomMode::MainSub;
///
///     fn set_mode(&mut self, _: &mut Context<'_>, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
///         if mode.custom_mode == RETURN && !self.has_fix {
///             return MavResult::TEMPORARILY_REJECTED.into();
///         }
///         self.mode = mode.custom_mode;
///         MavResult::ACCEPTED.into()
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Modes`",
    note = "`modes` in `#[stack]` needs `impl Modes for {Self}`: write it, or leave `modes` out"
)]
pub trait Modes: Vehicle {
    /// The flight modes, including those that the vehicle only enters by itself. At most
    /// [`MAX_MODES`](crate::limits::MAX_MODES), with names of 1 to 34 bytes, and no `custom_mode` or standard mode
    /// twice;
    /// otherwise it does not compile.
    ///
    /// The stack lists them on request (AVAILABLE_MODES). It reports the current mode with every second HEARTBEAT and
    /// at once after a change (CURRENT_MODE, Q-10). It turns MAV_CMD_DO_SET_MODE, the older message SET_MODE, and
    /// MAV_CMD_DO_SET_STANDARD_MODE into [`set_mode`](Self::set_mode).
    ///
    /// [`VehicleState::custom_mode`](crate::VehicleState::custom_mode) is the current mode.
    const MODES: &'static [FlightMode];

    /// How parameters 2 and 3 of MAV_CMD_DO_SET_MODE encode a `custom_mode`.
    const CUSTOM_MODE: CustomMode = CustomMode::Whole;

    /// Enters `mode`, a selectable row of [`MODES`](Self::MODES), or refuses. The outcome is sent at once and is the
    /// only answer, so IN_PROGRESS is answered FAILED. A request for the current mode must do no harm (C-11).
    ///
    /// ACCEPTED means that [`Vehicle::state`] reports the mode within a second (C-18). Refuse a mode that the vehicle
    /// cannot enter now, such as "land" on the ground: after ACCEPTED a ground station waits for the mode. The
    /// stack counts an accepted mode that is not reported
    /// ([`HookFaults::unreported_modes`](crate::command::HookFaults::unreported_modes)), and reports it by a text.
    ///
    /// Base the decision on input that was received: [`Vehicle::control_input`] gets sticks and setpoints before this
    /// is called (C-17).
    ///
    /// The stack has DENIED invalid requests before: a number or a standard mode that is not in the table, NaN, a
    /// fraction, flags without [`CUSTOM_MODE_ENABLED`](crate::dialect::MavModeFlag::CUSTOM_MODE_ENABLED). The armed
    /// flag is ignored, as
    /// in ArduPilot: clients send back the flags of the last heartbeat, and do not mean to arm or disarm.
    ///
    /// If MAV_CMD_DO_SET_MODE is one of [`POLICIES`](crate::Commands::POLICIES), its policy applies to SET_MODE too
    /// (C-5). MAV_CMD_DO_SET_STANDARD_MODE has its own policy. SET_MODE is answered by a COMMAND_ACK for command 11
    /// (C-32); it is not accepted from a high-latency link.
    fn set_mode(&mut self, cx: &mut Context<'_>, mode: &'static FlightMode, request: &ModeRequest) -> Outcome;

    /// Returns the `custom_mode` that was requested last, by any peer, or the mode that followed it, such as hold after
    /// a take-off. It differs from the current mode only after a failsafe. 0, the default, means unknown. It is sent in
    /// CURRENT_MODE.
    fn intended_mode(&self) -> u32 {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLD: FlightMode = FlightMode::new(1, "Hold");
    const LAND: FlightMode = FlightMode::new(2, "Land").with_standard_mode(MavStandardMode::LAND);

    #[test]
    fn valid_tables_are_accepted() {
        FlightMode::check(&[]);
        FlightMode::check(&[HOLD, LAND, FlightMode::new(0, "a mode whose name is 34 bytes long")]);
        let mut most = [HOLD; MAX_MODES];
        (0..).zip(&mut most).for_each(|(number, mode)| mode.custom_mode = number);
        FlightMode::check(&most);
    }

    #[test]
    #[should_panic(expected = "at most 32 modes")]
    fn too_many_modes_are_refused() {
        FlightMode::check(&[HOLD; MAX_MODES + 1]);
    }

    #[test]
    #[should_panic(expected = "same custom_mode")]
    fn a_number_twice_is_refused() {
        FlightMode::check(&[HOLD, LAND, FlightMode { name: "Wait", ..HOLD }]);
    }

    #[test]
    #[should_panic(expected = "same standard mode")]
    fn a_standard_mode_twice_is_refused() {
        FlightMode::check(&[LAND, HOLD, FlightMode { custom_mode: 3, ..LAND }]);
    }

    #[test]
    #[should_panic(expected = "1 to 34 bytes")]
    fn an_empty_name_is_refused() {
        FlightMode::check(&[HOLD, FlightMode { name: "", ..LAND }]);
    }

    #[test]
    #[should_panic(expected = "1 to 34 bytes")]
    fn a_name_without_room_for_the_nul_is_refused() {
        FlightMode::check(&[FlightMode { name: "a mode whose name is 35 bytes long.", ..HOLD }]);
    }
}
