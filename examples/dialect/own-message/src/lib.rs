//! A vehicle with two custom messages, declared by macro. A crane receives the speed of its winch and reports the length of line
//! that is out.
//!
//! 1. Declare the messages: [`message!`](mavstack::message!).
//! 2. Add them to common: [`dialect!`](mavstack::dialect!) and [`Vehicle::MESSAGES`].
//! 3. Handle them: [`Vehicle::message`] receives messages. [`Telemetry::fill`] fills messages to send: in a stream, on request, or
//!    when the vehicle announces them.
#![no_std]

use mavstack::dialect::{Common, MavResult};
use mavstack::message::{Dialect, MessageTable};
use mavstack::{
    Command, Commands, Context, Duration, Fill, Frame, LinkId, Message, Outcome, Stream, Telemetry, Vehicle,
    VehicleState,
};

mavstack::wire_enum! {
    /// State of the hook.
    pub struct CraneHook: u8 {
        CLOSED = 0,
        OPEN = 1,
    }
}

mavstack::message! {
    /// Reports the state of the crane.
    pub struct CraneReport: CRANE_REPORT = 53_000 {
        /// Time since boot (ms).
        time_boot_ms: u32,
        /// Length of line that is out (m).
        line_out: f32,
        /// Tension of the line (N); `i16::MAX` means "not measured".
        tension: i16 = i16::MAX,
        hook: CraneHook,
        /// Result of the last command.
        result: MavResult,
        cargo: mavstack::Text<16>,
    } extensions {
        /// Temperature of the motor (°C).
        temperature: u8,
    }
}

mavstack::message! {
    /// Commands the crane. Because of the target fields the stack passes only messages for this vehicle, and broadcasts.
    pub struct CraneControl: CRANE_CONTROL = 53_001 {
        /// Speed of the winch (m/s), negative to wind up.
        speed: f32,
        target_system: u8,
        target_component: u8,
    }
}

mavstack::dialect! {
    /// The crane's messages and all of common.
    pub struct Known: [CraneReport, CraneControl] + Common;
}

/// What the crane has of MAVLink: one link, and streams.
#[derive(mavstack::Stack)]
#[stack(vehicle: Crane, links: 1, streams)]
pub struct Mavlink;

/// A crane.
#[derive(Debug, Default)]
pub struct Crane {
    /// Speed of the winch (m/s).
    pub speed: f32,
    /// Length of line that is out (m).
    pub line_out: f32,
}

impl Vehicle for Crane {
    const MESSAGES: MessageTable = Known::MESSAGES;

    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }

    fn message(&mut self, cx: &mut Context<'_>, frame: &Frame<'_>, _: LinkId) -> bool {
        let Some(CraneControl { speed, .. }) = frame.decode() else { return false };
        if speed.is_finite() {
            self.speed = speed;
            // Announces a report at once.
            cx.announce::<CraneReport, Self>();
        }
        true
    }
}

impl Telemetry for Crane {
    const STREAMS: &'static [Stream] = &[Stream::of::<CraneReport>().every(Duration::from_millis(500))];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        match id {
            CraneReport::ID => {
                let time_boot_ms = out.now().time_boot_ms();
                out.put(&CraneReport { time_boot_ms, line_out: self.line_out, ..CraneReport::UNKNOWN })
            }
            _ => false,
        }
    }
}

impl Commands for Crane {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}
