//! A vehicle with two messages of its own, declared by macro: a crane, told how fast to wind, tells how much line is out.
//!
//! Three steps: declare the messages ([`message!`](mavstack::message)), put them beside those of common
//! ([`dialect!`](mavstack::dialect!), [`Vehicle::MESSAGES`]), and handle them: [`Vehicle::message`] gets what comes in,
//! [`Telemetry::fill`] what is to go out, in a stream, on request, or when the firmware announces it.
#![no_std]

use mavstack::dialect::{Common, MavModeFlag, MavResult, MavState, MissionState};
use mavstack::{
    Command, CommandRule, Commands, Dialect, Duration, Fill, Frame, LinkId, Message, MessageTable, NoParams, Outcome,
    Parameters, PlanChange, Plans, Progress, Stream, Telemetry, Vehicle, VehicleState,
};

mavstack::wire_enum! {
    /// What the hook holds on to.
    pub struct CraneHook: u8 {
        CLOSED = 0,
        OPEN = 1,
    }
}

mavstack::message! {
    /// What the crane reports.
    pub struct CraneReport: CRANE_REPORT = 53_000 {
        /// Since boot (ms).
        time_boot_ms: u32,
        /// Length of line that is out (m).
        line_out: f32,
        /// Tension (N), with the value that means "not measured".
        tension: i16 = i16::MAX,
        hook: CraneHook,
        /// What became of the last order.
        result: MavResult,
        cargo: mavstack::Text<16>,
    } extensions {
        /// Of the motor (°C).
        temperature: u8,
    }
}

mavstack::message! {
    /// Tells the crane what to do. With target fields the stack hands over what is for this vehicle or for all, no other.
    pub struct CraneControl: CRANE_CONTROL = 53_001 {
        /// (m/s) Negative: up.
        speed: f32,
        target_system: u8,
        target_component: u8,
    }
}

mavstack::dialect! {
    /// The crane's messages, and all of common.
    pub struct Known: [CraneReport, CraneControl] + Common;
}

/// The vehicle.
#[derive(Debug, Default)]
pub struct Crane {
    /// How fast it winds (m/s).
    pub speed: f32,
    /// Length of line that is out (m).
    pub line_out: f32,
    /// Set by an order; the loop takes it to announce a report at once.
    pub has_order: bool,
}

impl Vehicle for Crane {
    const MESSAGES: MessageTable = Known::MESSAGES;

    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState { base_mode: MavModeFlag::EMPTY, custom_mode: 0, system_status: MavState::ACTIVE })
    }

    fn message(&mut self, frame: &Frame<'_>, _: LinkId) -> bool {
        let Some(CraneControl { speed, .. }) = frame.decode() else { return false };
        if speed.is_finite() {
            self.speed = speed;
            self.has_order = true;
        }
        true
    }
}

impl Telemetry for Crane {
    const STREAMS: &'static [Stream] = &[Stream::of::<CraneReport>().every(Duration::from_millis(500))];

    fn fill(&mut self, id: u32, out: Fill<'_>) -> bool {
        match id {
            CraneReport::ID => {
                let time_boot_ms = u32::try_from(out.now().as_millis()).unwrap_or(u32::MAX);
                out.put(&CraneReport { time_boot_ms, line_out: self.line_out, ..CraneReport::UNKNOWN })
            }
            _ => false,
        }
    }
}

impl Commands for Crane {
    fn command(&mut self, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Plans for Crane {
    const MISSION_COMMANDS: &'static [CommandRule] = &[];

    fn plan_changed(&mut self, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Parameters for Crane {
    type Table = NoParams;
}
