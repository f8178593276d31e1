//! Flight modes.

use mavstack::dialect::{MavResult, MavStandardMode};
use mavstack::prelude::*;

const HOLD: u32 = 4 << 16 | 3 << 24;
const RETURN: u32 = 4 << 16 | 5 << 24;

struct Boat {
    mode: u32,
    has_fix: bool,
}

impl Modes for Boat {
    const MODES: &'static [FlightMode] = &[
        FlightMode::new(HOLD, "Hold"),
        FlightMode::new(RETURN, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
    ];
    const CUSTOM_MODE: CustomMode = CustomMode::MainSub; // PX4's numbers, which MAVSDK expects

    fn set_mode(&mut self, _: &mut Context<'_>, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
        if mode.custom_mode == RETURN && !self.has_fix {
            return MavResult::TEMPORARILY_REJECTED.into();
        }
        self.mode = mode.custom_mode; // `Vehicle::state` reports it: `VehicleState::new(armed).with_mode(self.mode)`
        MavResult::ACCEPTED.into()
    }
}

impl Vehicle for Boat {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}
