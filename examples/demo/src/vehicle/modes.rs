//! The flight modes.

use mavstack::FlightMode;
use mavstack::dialect::{MavModeProperty, MavResult, MavStandardMode};
use serde::{Deserialize, Serialize};

use super::Quadrotor;
use crate::body::Vector;
use crate::plan::Maneuver;

/// What the vehicle is doing: `HEARTBEAT.custom_mode`. The numbers are PX4's, main mode and sub-mode: MAVSDK sends those to
/// every autopilot that it does not know, and reads them so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u32)]
pub enum Mode {
    /// Flown by hand.
    Position = 3 << 16,
    /// Goes up.
    Takeoff = auto(2),
    /// Stays where it is, or flies where it was sent and stays there.
    Hold = auto(3),
    /// Flies the live plan.
    Mission = auto(4),
    /// Flies home or to a rally point, whichever is nearest, and lands.
    Return = auto(5),
    /// Lands.
    Land = auto(6),
}

/// A sub-mode of PX4's main mode 4, in which the vehicle flies by itself.
const fn auto(sub: u32) -> u32 {
    4 << 16 | sub << 24
}

/// What ground stations are told of the modes.
pub const TABLE: &[FlightMode] = &[
    FlightMode::new(Mode::Position.number(), "Position").with_standard_mode(MavStandardMode::POSITION_HOLD),
    by_itself(Mode::Takeoff, "Takeoff").with_standard_mode(MavStandardMode::TAKEOFF),
    by_itself(Mode::Hold, "Hold"),
    by_itself(Mode::Mission, "Mission").with_standard_mode(MavStandardMode::MISSION),
    by_itself(Mode::Return, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
    by_itself(Mode::Land, "Land").with_standard_mode(MavStandardMode::LAND),
];

const fn by_itself(mode: Mode, name: &'static str) -> FlightMode {
    FlightMode::new(mode.number(), name).with_properties(MavModeProperty::AUTO_MODE)
}

impl Mode {
    pub(super) const ALL: [Self; 6] =
        [Self::Position, Self::Takeoff, Self::Hold, Self::Mission, Self::Return, Self::Land];

    /// Whether it may take off in this mode.
    pub(super) const fn leaves_ground(self) -> bool {
        matches!(self, Self::Position | Self::Takeoff | Self::Mission)
    }

    /// `HEARTBEAT.custom_mode`.
    pub const fn number(self) -> u32 {
        self as u32
    }
}

impl Quadrotor {
    /// Enters a mode that somebody asked for.
    pub(super) fn change_mode(&mut self, mode: Mode) -> MavResult {
        let here = self.body.rest();
        match mode {
            Mode::Hold => {
                self.hold();
                MavResult::ACCEPTED
            }
            Mode::Position => self.fly_by_hand(),
            Mode::Takeoff => {
                let height = self.takeoff_altitude() - self.home.spot.down;
                self.start(mode, Maneuver::Climb(Vector { down: here.down.min(-height), ..here }))
            }
            Mode::Mission => self.fly_on(),
            Mode::Return => self.start(mode, Maneuver::Return),
            Mode::Land => self.start(mode, Maneuver::Land(here)),
        }
    }
}
