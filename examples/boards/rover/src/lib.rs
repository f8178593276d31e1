//! A minimal vehicle for a ground station. It sends heartbeats and the state of its battery, can be armed and disarmed, has one
//! parameter, and stores a mission of up to 100 items. It drives only while a ground station is alive. All boards share this crate;
//! replace it by your own vehicle.
#![no_std]
#![forbid(unsafe_code)]

use mavstack::dialect::commands::ComponentArmDisarm;
use mavstack::dialect::rules::{NAV_RETURN_TO_LAUNCH, NAV_WAYPOINT};
use mavstack::dialect::{BatteryStatus, MavResult, MavType, MissionState};
use mavstack::telemetry::Battery;
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
        streams,
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
#[derive(Debug)]
pub struct Rover {
    armed: bool,
    /// The voltage of the battery (V), as measured by your ADC. NaN is sent as "unknown".
    pub battery: f32,
}

impl Default for Rover {
    fn default() -> Self {
        Self::new()
    }
}

impl Rover {
    /// Creates a disarmed rover at rest.
    pub const fn new() -> Self {
        Self { armed: false, battery: f32::NAN }
    }

    /// Returns the current speed limit for the motors (m/s): 0 while the rover is disarmed, or no ground station is alive.
    pub fn speed_limit(&self, tuning: &Tuning, has_ground_station: bool) -> f32 {
        if self.armed && has_ground_station { tuning.get(Tuning::SPEED_MAX) } else { 0.0 }
    }

    /// Runs one pass of the driving loop, and ticks the pulse.
    pub fn drive(&mut self, stack: &Mavlink) {
        // Control the motors here, from `stack.mission()` and the sensors, up to this speed.
        let _ = self.speed_limit(stack.parameters(), stack.has_ground_station());
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

impl Telemetry for Rover {
    const STREAMS: &'static [Stream] = &[Stream::of::<BatteryStatus>().every(Duration::from_secs(2))];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let battery = Battery { voltage: self.battery, ..Battery::UNKNOWN };
        // The rover has one battery.
        id == BatteryStatus::ID && out.index() == 0 && out.put(&battery.battery_status())
    }
}

impl Parameters for Rover {
    type Table = Tuning;
}
