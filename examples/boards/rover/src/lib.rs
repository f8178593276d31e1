//! A minimal vehicle for a ground station. It sends heartbeats, can be armed and disarmed, has one parameter, and stores a mission
//! of up to 100 items. All boards share this crate; replace it by your own vehicle.
#![no_std]
#![forbid(unsafe_code)]

use mavstack::dialect::commands::ComponentArmDisarm;
use mavstack::dialect::rules::{NAV_RETURN_TO_LAUNCH, NAV_WAYPOINT};
use mavstack::dialect::{MavResult, MavType, MissionState};
use mavstack::*;

/// The driving loop ticks it. When the loop hangs, the heartbeats stop.
pub static PULSE: Pulse = Pulse::new();

/// The configuration: a rover with system id 1, component id 1.
pub const CONFIG: Config = Config { r#type: MavType::GROUND_ROVER, ..Config::new(Address::new(1, 1), &PULSE) };

stack! {
    /// A stack with one link and a mission of up to 100 items. An item takes 32 bytes, and uploads need a second copy.
    pub struct Mavlink for Rover {
        links: 1,
        plans: { mission: 100 },
        parameters: Tuning,
    }
}

parameters! {
    /// The parameters. QGroundControl considers a vehicle ready only if it has at least one.
    pub struct Tuning {
        /// Maximum speed.
        SPEED_MAX: f32 = 2.0, 0.1..=10.0, "m/s";
    }
}

/// A rover.
#[derive(Debug, Default)]
pub struct Rover {
    armed: bool,
}

impl Rover {
    /// Creates a disarmed rover at rest.
    pub const fn new() -> Self {
        Self { armed: false }
    }

    /// Returns the current speed limit for the motors (m/s).
    pub fn speed_limit(&self, tuning: &Tuning) -> f32 {
        if self.armed { tuning.get(Tuning::SPEED_MAX) } else { 0.0 }
    }

    /// Runs one pass of the driving loop, and ticks the pulse.
    pub fn drive(&mut self, stack: &Mavlink) {
        // Control the motors here, from `stack.mission()` and the sensors, up to this speed.
        let _ = self.speed_limit(stack.parameters());
        PULSE.tick();
    }
}

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.armed))
    }
}

impl Commands for Rover {
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        // Errors: UNSUPPORTED for another command, DENIED for invalid parameters.
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

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Parameters for Rover {
    type Table = Tuning;
}
