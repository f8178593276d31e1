//! A vehicle with custom messages and commands from XML, which includes MAVLink's common. The build script generates the module
//! [`crane`]:
//!
//! - [`crane::Crane`] is the dialect.
//! - [`crane::CraneReport`] is a message.
//! - [`crane::commands::CraneHook`] is a command with checked parameters.
//! - [`crane::mav_cmd::CRANE_HOOK`] is the command's id.
//!
//! The definitions of common are in `mavstack::dialect`.
#![no_std]

include!(concat!(env!("OUT_DIR"), "/crane.rs"));

use crane::{CraneControl, CraneHook, CraneReport, commands};
use mavstack::dialect::{MavResult, MissionState};
use mavstack::message::{Dialect, MessageTable};
use mavstack::{
    Command, CommandRule, Commands, Context, Duration, Fill, Frame, LinkId, Message, Outcome, PlanChange, Plans,
    Progress, Stream, Telemetry, Vehicle, VehicleState,
};

/// What the vessel has of MAVLink: one link, streams, and missions.
#[derive(mavstack::Stack)]
#[stack(vehicle: Vessel, links: 1, plans: { mission: 20 }, streams)]
pub struct Mavlink;

/// A vessel with a crane.
#[derive(Debug, Default)]
pub struct Vessel {
    /// Speed of the winch (m/s).
    pub speed: f32,
    /// State of the hook.
    pub hook: CraneHook,
    /// Result of the last command.
    pub result: MavResult,
}

impl Vehicle for Vessel {
    const MESSAGES: MessageTable = crane::Crane::MESSAGES;

    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }

    fn message(&mut self, _: &mut Context<'_>, frame: &Frame<'_>, _: LinkId) -> bool {
        let Some(CraneControl { speed, .. }) = frame.decode() else { return false };
        self.speed = speed;
        true
    }
}

impl Telemetry for Vessel {
    const STREAMS: &'static [Stream] = &[Stream::of::<CraneReport>().every(Duration::from_millis(500))];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
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
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        // Errors: UNSUPPORTED for another command, DENIED for parameters that the XML does not allow.
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
    const MISSION_COMMANDS: &'static [CommandRule] = &[crane::rules::CRANE_HOOK];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}
