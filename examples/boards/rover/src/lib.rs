//! The smallest vehicle that a ground station can work with: it sends heartbeats, can be armed and disarmed, has one parameter,
//! and stores a mission of up to 100 items. All boards share this crate; your firmware has a vehicle of its own instead.
#![no_std]
#![forbid(unsafe_code)]

use mavstack::dialect::command_rules::{NAV_RETURN_TO_LAUNCH, NAV_WAYPOINT};
use mavstack::dialect::commands::ComponentArmDisarm;
use mavstack::dialect::{MavModeFlag, MavResult, MavState, MavType, MissionState};
use mavstack::*;

/// Ticked by the driving loop; when that hangs, the heartbeats stop.
pub static PULSE: Pulse = Pulse::new();

/// System 1, component 1, a rover.
pub const CONFIG: Config = Config { r#type: MavType::GROUND_ROVER, ..Config::new(Address::new(1, 1), &PULSE) };

/// One link, a mission of 100 items of 32 bytes, and the same again while one is being uploaded.
pub type RoverStack = Stack<1, plan_memory!(mission: 100)>;

parameters! {
    /// The parameters. QGroundControl does not consider a vehicle ready unless it has at least one.
    pub struct Tuning {
        /// Maximum speed.
        SPEED_MAX: f32 = 2.0, 0.1..=10.0, "m/s";
    }
}

/// The vehicle.
#[derive(Debug)]
pub struct Rover {
    armed: bool,
    tuning: Tuning,
}

impl Rover {
    /// Standing, disarmed.
    pub const fn new() -> Self {
        Self { armed: false, tuning: Tuning::new() }
    }

    /// Returns the maximum speed that may be commanded to the motors (m/s).
    pub fn highest_speed(&self) -> f32 {
        if self.armed { self.tuning.get(Tuning::SPEED_MAX) } else { 0.0 }
    }

    /// One pass of the driving loop: steers, and says that it is healthy.
    pub fn drive(&mut self) {
        // Drive the motors here, from the mission and the sensors, at `highest_speed` or less.
        PULSE.tick();
    }
}

impl Default for Rover {
    fn default() -> Self {
        Self::new()
    }
}

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        let (base_mode, system_status) = match self.armed {
            true => (MavModeFlag::SAFETY_ARMED, MavState::ACTIVE),
            false => (MavModeFlag::EMPTY, MavState::STANDBY),
        };
        Some(VehicleState { base_mode, custom_mode: 0, system_status })
    }
}

impl Commands for Rover {
    fn command(&mut self, command: &Command) -> Outcome {
        // UNSUPPORTED when it is another command, DENIED when its parameters are not as they may be.
        match command.decode() {
            Ok(ComponentArmDisarm { arm, .. }) if !command.is_broadcast => self.armed = arm,
            Ok(_) => return MavResult::DENIED.into(),
            Err(result) => return result.into(),
        }
        MavResult::ACCEPTED.into()
    }
}

impl Plans for Rover {
    const MISSION_COMMANDS: &'static [CommandRule] = &[NAV_WAYPOINT, NAV_RETURN_TO_LAUNCH];

    fn plan_changed(&mut self, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

// Nothing to tell but the heartbeat.
impl Telemetry for Rover {}

impl Parameters for Rover {
    type Table = Tuning;

    fn parameters_mut(&mut self) -> Option<&mut Tuning> {
        Some(&mut self.tuning)
    }
}
