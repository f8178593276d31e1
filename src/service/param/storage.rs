//! The action of MAV_CMD_PREFLIGHT_STORAGE (P-17).

use crate::dialect::{MavCmd, MavModeFlag, MavResult};
use crate::num;
use crate::types::{Command, Refusal, RefusalReason, Vehicle};

/// An action of MAV_CMD_PREFLIGHT_STORAGE on the parameters.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum StorageAction {
    Nothing,
    /// Reads the stored values.
    Read,
    /// Stores the values.
    Write,
    /// Resets all values to their defaults, or all but those of read-only parameters, and stores them.
    Reset {
        all: bool,
    },
}

impl StorageAction {
    /// Returns the action of a command; `None` if it is another command. `is_stored`: there is storage.
    ///
    /// # Errors
    ///
    /// The command is invalid, or needs storage and there is none, or the vehicle is armed.
    pub(super) fn of(command: &Command, is_stored: bool, vehicle: &impl Vehicle) -> Option<Result<Self, Refusal>> {
        if command.id != MavCmd::PREFLIGHT_STORAGE {
            return None;
        }
        let is_armed = || vehicle.state().is_some_and(|state| state.base_mode.contains(MavModeFlag::SAFETY_ARMED));
        Some(match Self::parse(&command.params, is_stored) {
            Err(reason) => Err(Refusal::denied(reason)),
            Ok(_) if is_armed() => Err(MavResult::TEMPORARILY_REJECTED.into()),
            Ok(action) => Ok(action),
        })
    }

    fn parse([parameters, missions, ..]: &[f32; 4], is_stored: bool) -> Result<Self, RefusalReason> {
        let action = |param: f32| if param.is_nan() { Some(-1) } else { num::integer(param) };
        // Parameter 2 was an action on missions in definitions before September 2026. Missions are loaded and stored automatically,
        // so to reset them is refused; MISSION_CLEAR_ALL does that.
        if !matches!(action(*missions), Some(-1..=1)) {
            return Err(RefusalReason::Result);
        }
        match action(*parameters) {
            Some(-1) => Ok(Self::Nothing),
            Some(0 | 1) if !is_stored => Err(RefusalReason::NoStorage),
            Some(0) => Ok(Self::Read),
            Some(1) => Ok(Self::Write),
            Some(2) => Ok(Self::Reset { all: false }),
            Some(4) => Ok(Self::Reset { all: true }),
            _ => Err(RefusalReason::Result),
        }
    }
}
