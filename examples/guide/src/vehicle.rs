//! The vehicle: `docs/vehicle.md`.

mod camera;
mod events;
mod modes;
mod runtime_parameters;

use mavstack::dialect::commands::ComponentArmDisarm;
use mavstack::dialect::rules::{NAV_RETURN_TO_LAUNCH, NAV_WAYPOINT};
use mavstack::dialect::{Attitude, MavResult, MissionState};
use mavstack::prelude::*;
use mavstack::telemetry::Motion;

#[derive(Stack)]
#[stack(vehicle: Boat, links: 1, plans: { mission: 100 }, parameters: Tuning, streams)]
pub struct Mavlink;

mavstack::parameters! {
    pub struct Tuning {
        /// Speed between waypoints.
        CRUISE: f32 = 2.0, 0.5..=8.0, "m/s" { decimals: 1, increment: 0.5 };
        /// Action when the last ground station is lost.
        FS_GCS_ACT: i32 = 1, 0..=2, "" { values: { 0 => "None", 1 => "Hold", 2 => "Return" }, category: "Failsafe" };
        /// MAVLink system id.
        SYS_ID: i32 = 1, 1..=254, "" { system_id };
    }
}

pub struct Boat {
    armed: bool,
    yaw: f32,
}

impl Vehicle for Boat {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.armed))
    }
}

impl Commands for Boat {
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        match command.decode() {
            Ok(ComponentArmDisarm { arm, .. }) if !command.is_broadcast => self.armed = arm,
            Ok(_) => return MavResult::DENIED.into(), // a broadcast to all vehicles
            Err(result) => return result.into(),      // another command, or invalid parameters
        }
        MavResult::ACCEPTED.into()
    }
}

impl Plans for Boat {
    const MISSION_COMMANDS: &'static [CommandRule] = &[NAV_WAYPOINT, NAV_RETURN_TO_LAUNCH];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {} // the loop reads `stack.mission().items()`

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Telemetry for Boat {
    const STREAMS: &'static [Stream] = &[Stream::of::<Attitude>().every(Duration::from_millis(250))];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let motion = Motion { attitude: [0.0, 0.0, self.yaw], ..Motion::UNKNOWN }; // rad
        id == Attitude::ID && out.put(&motion.attitude(out.now()))
    }
}

impl Parameters for Boat {
    type Table = Tuning;
}

impl Boat {
    pub fn drive(&mut self, now: Instant, stack: &StackOf<Mavlink>) {
        let speed = stack.parameters().get(Tuning::CRUISE);
        let is_alone = !stack.has_ground_station(now); // on all links
        // … sensors, control, motors
        let _ = (speed, is_alone);
    }
}
