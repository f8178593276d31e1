//! The flight modes.

use mavstack::dialect::{MavModeProperty, MavResult, MavStandardMode};
use mavstack::{Context, CustomMode, FlightMode, ModeRequest, Modes, Outcome};
use serde::{Deserialize, Serialize};

use super::Quadrotor;
use super::commands::{refuse, takeoff_altitude};
use crate::body::Vector;
use crate::plan::Maneuver;

/// A flight mode: `HEARTBEAT.custom_mode`. The numbers are PX4's main mode and sub-mode, because MAVSDK uses them for every
/// autopilot that it does not know.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u32)]
pub enum Mode {
    /// Manual flight.
    Position = 3 << 16,
    /// Flies the setpoints of a companion computer or a ground station.
    Offboard = 6 << 16,
    /// Takeoff.
    Takeoff = auto(2),
    /// Holds the position, or flies to a commanded position and holds there.
    Hold = auto(3),
    /// Flies the live mission.
    Mission = auto(4),
    /// Flies to home or a rally point, whichever is nearest, and lands.
    Return = auto(5),
    /// Lands.
    Land = auto(6),
}

/// Returns a sub-mode of PX4's main mode 4 (AUTO).
const fn auto(sub: u32) -> u32 {
    4 << 16 | sub << 24
}

/// The modes that AVAILABLE_MODES lists.
const TABLE: &[FlightMode] = &[
    FlightMode::new(Mode::Position.number(), "Position").with_standard_mode(MavStandardMode::POSITION_HOLD),
    automatic(Mode::Offboard, "Offboard"),
    automatic(Mode::Takeoff, "Takeoff").with_standard_mode(MavStandardMode::TAKEOFF),
    automatic(Mode::Hold, "Hold"),
    automatic(Mode::Mission, "Mission").with_standard_mode(MavStandardMode::MISSION),
    automatic(Mode::Return, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
    automatic(Mode::Land, "Land").with_standard_mode(MavStandardMode::LAND),
];

const fn automatic(mode: Mode, name: &'static str) -> FlightMode {
    FlightMode::new(mode.number(), name).with_properties(MavModeProperty::AUTO_MODE)
}

impl Mode {
    const ALL: [Self; 7] =
        [Self::Position, Self::Offboard, Self::Takeoff, Self::Hold, Self::Mission, Self::Return, Self::Land];

    /// Whether the vehicle may take off in this mode.
    const fn can_take_off(self) -> bool {
        matches!(self, Self::Position | Self::Offboard | Self::Takeoff | Self::Mission)
    }

    /// Returns the value of `HEARTBEAT.custom_mode`.
    pub const fn number(self) -> u32 {
        self as u32
    }
}

impl Modes for Quadrotor {
    const MODES: &'static [FlightMode] = TABLE;
    const CUSTOM_MODE: CustomMode = CustomMode::MainSub;

    fn set_mode(&mut self, cx: &mut Context<'_>, mode: &'static FlightMode, request: &ModeRequest) -> Outcome {
        let mode = Mode::ALL.into_iter().find(|known| known.number() == mode.custom_mode);
        if mode.is_some_and(Mode::can_take_off) && self.may_be_delayed(request.class) {
            return refuse(cx, MavResult::DENIED, "Mode refused: sent by satellite; use the radio").into();
        }
        mode.map_or(MavResult::UNSUPPORTED, |mode| self.change_mode(cx, mode)).into()
    }

    fn intended_mode(&self) -> u32 {
        self.intended.number()
    }
}

impl Quadrotor {
    /// Enters a requested mode.
    pub(super) fn change_mode(&mut self, cx: &mut Context<'_>, mode: Mode) -> MavResult {
        let here = self.body.rest();
        match mode {
            Mode::Hold => {
                self.hold();
                MavResult::ACCEPTED
            }
            Mode::Position => self.fly_manually(cx),
            Mode::Offboard => self.fly_setpoints(cx),
            Mode::Takeoff => {
                let height = takeoff_altitude(cx) - self.home.spot.down;
                self.start(cx, mode, Maneuver::Climb(Vector { down: here.down.min(-height), ..here }))
            }
            Mode::Mission => self.resume_mission(cx),
            Mode::Return => self.start(cx, mode, Maneuver::Return),
            Mode::Land => self.start(cx, mode, Maneuver::Land(here)),
        }
    }
}
