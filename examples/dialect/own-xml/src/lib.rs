//! A vehicle whose messages and commands come from an XML of its own, which includes MAVLink's common: the build script
//! makes the module [`crane`] of it.
//!
//! [`crane::Crane`] is the dialect, [`crane::CraneReport`] a message, [`crane::commands::CraneHook`] a command with its
//! parameters checked, [`crane::mav_cmd::CRANE_HOOK`] the number that it has on the wire. What common has is named from
//! `mavstack::dialect`.
#![no_std]

include!(concat!(env!("OUT_DIR"), "/crane.rs"));

use crane::{CraneControl, CraneHook, CraneReport, commands};
use mavstack::dialect::{MavModeFlag, MavResult, MavState, MissionState};
use mavstack::{
    Command, CommandRule, Commands, Dialect, Duration, Fill, Frame, LinkId, Message, MessageTable, NoParams, Outcome,
    Parameters, PlanChange, Plans, Progress, Stream, Telemetry, Vehicle, VehicleState,
};

/// The vehicle.
#[derive(Debug, Default)]
pub struct Vessel {
    /// How fast the crane winds (m/s).
    pub speed: f32,
    /// The hook.
    pub hook: CraneHook,
    /// What became of the last order.
    pub result: MavResult,
}

impl Vehicle for Vessel {
    const MESSAGES: MessageTable = crane::Crane::MESSAGES;

    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState { base_mode: MavModeFlag::EMPTY, custom_mode: 0, system_status: MavState::ACTIVE })
    }

    fn message(&mut self, frame: &Frame<'_>, _: LinkId) -> bool {
        let Some(CraneControl { speed, .. }) = frame.decode() else { return false };
        self.speed = speed;
        true
    }
}

impl Telemetry for Vessel {
    const STREAMS: &'static [Stream] = &[Stream::of::<CraneReport>().every(Duration::from_millis(500))];

    fn fill(&mut self, id: u32, out: Fill<'_>) -> bool {
        id == CraneReport::ID
            && out.put(&CraneReport {
                line_out: 12.5,
                tension: -3,
                hook: self.hook,
                result: self.result,
                cargo: mavstack::Text::new("anchor"),
                temperature: 41,
                ..CraneReport::UNKNOWN
            })
    }
}

impl Commands for Vessel {
    fn command(&mut self, command: &Command) -> Outcome {
        // UNSUPPORTED when it is another one, DENIED when its parameters are not as the XML has them.
        match command.decode() {
            Ok(commands::CraneHook { hook, .. }) => {
                self.hook = hook;
                MavResult::ACCEPTED.into()
            }
            Err(result) => result.into(),
        }
    }
}

impl Plans for Vessel {
    const MISSION_COMMANDS: &'static [CommandRule] = &[crane::command_rules::CRANE_HOOK];

    fn plan_changed(&mut self, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Parameters for Vessel {
    type Table = NoParams;
}
