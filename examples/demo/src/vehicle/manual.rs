//! Manual flight: sticks or radio channels command a velocity. Centred sticks hold the position.
//!
//! - MANUAL_CONTROL has axes as QGroundControl and MAVSDK send them. Forward, right and yaw to the right are positive. The
//!   throttle is 0 to 1000; in the middle the vehicle keeps its height.
//! - Radio channels are in ArduPilot's order: 1 roll, 2 pitch (low is forward), 3 throttle, 4 yaw.
//! - The pilot's receiver is ExpressLRS or mLRS in MAVLink mode, on the companion's UART: see the guide to RC over MAVLink.

use mavstack::dialect::{MavResult, MavSeverity, RcChannels};
use mavstack::manual_control::{ControlSource, ManualControlInput, ManualInput, RcOverride};
use mavstack::message::SystemId;
use mavstack::{Address, Context, ControlInput, Duration, Instant, Peer, StackOf};

use super::commands::refuse;
use super::{Mode, Quadrotor};
use crate::app::{COMPANION, Mavlink};
use crate::plan::Maneuver;
use crate::tuning::Tuning;

/// Stick positions: forward, right, up and yaw to the right, each from -1 to 1.
pub type Sticks = [f32; 4];

/// Deflection below which a stick counts as centred.
const DEAD_BAND: f32 = 0.05;

/// The pilot's receiver: ExpressLRS, and mLRS if it sends RC_CHANNELS_OVERRIDE; and mLRS if it sends RADIO_RC_CHANNELS.
const RECEIVERS: [Peer; 2] =
    [Peer { address: Address::new(255, 68), link: COMPANION }, Peer { address: Address::new(51, 68), link: COMPANION }];

impl Quadrotor {
    /// Configures the accepted source and the timeout of manual control from the parameters, and reads the current input.
    #[inline(never)]
    pub(crate) fn take_sticks(&mut self, now: Instant, stack: &mut StackOf<Mavlink>) {
        let tuning = stack.parameters();
        let system = tuning.get(Tuning::MAV_GCS_SYSID);
        let timeout = tuning.get(Tuning::COM_RC_LOSS_T);
        let input = stack.manual_input_mut();
        input.set_receivers(&RECEIVERS);
        input.set_source(source(system));
        input.set_timeout(Duration::from_micros((timeout * 1e6) as u64));
        self.sticks = sticks(input, now);
        self.channels = input.rc_channels(now).unwrap_or_default();
    }

    /// Takes input that has just arrived: a request for a mode may be right behind it (C-17). The next pass of the flight loop
    /// reads it again, and learns of what has expired.
    pub(super) fn take_input(&mut self, input: &ControlInput) {
        match input {
            ControlInput::Sticks(input) => self.sticks = Some(of_axes(input)),
            // Sticks take precedence.
            ControlInput::Channels(input) => self.sticks = self.sticks.or(of_channels(input)),
            ControlInput::Setpoint(setpoint) => self.course = self.course_to(&setpoint.target),
            _ => {}
        }
    }

    /// Enters [`Mode::Position`]. Refused without manual control input.
    pub(super) fn fly_manually(&mut self, cx: &mut Context<'_>) -> MavResult {
        if self.sticks.is_none() {
            return refuse(cx, MavResult::TEMPORARILY_REJECTED, "Position mode refused: no manual control");
        }
        self.enter(Mode::Position, Maneuver::Stay(self.body.rest()));
        self.intended = Mode::Position;
        MavResult::ACCEPTED
    }

    /// Holds the position when manual control has timed out.
    #[inline(never)]
    pub(super) fn watch_sticks(&mut self, cx: &mut Context<'_>) {
        if self.mode == Mode::Position && self.sticks.is_none() {
            self.stop();
            cx.text(MavSeverity::WARNING, "Manual control lost: holding");
        }
    }

    /// Flies one step as the sticks command.
    #[inline(never)]
    pub(super) fn follow_sticks(&mut self, cx: &mut Context<'_>) {
        let Some(sticks) = self.sticks else { return };
        let [forward, right, up, turn] = sticks.map(|stick| if stick.abs() < DEAD_BAND { 0.0 } else { stick });
        let speed = cx.parameter(Tuning::MPC_VEL_MANUAL);
        let vertical =
            if up > 0.0 { cx.parameter(Tuning::MPC_Z_VEL_MAX_UP) } else { cx.parameter(Tuning::MPC_Z_VEL_MAX_DN) };
        let rate = cx.parameter(Tuning::MPC_MAN_Y_MAX).to_radians();
        let mut next = self.body;
        next.steer([forward * speed, right * speed, -up * vertical], turn * rate, super::DT);
        self.advance(cx, next);
    }

    /// Returns RC_CHANNELS: the channels of RC_CHANNELS_OVERRIDE or RADIO_RC_CHANNELS.
    pub(crate) fn rc_channels(&self, now: Instant) -> RcChannels {
        self.channels.to_message(now, &[])
    }
}

/// Returns the source of manual control and setpoints for [`Tuning::MAV_GCS_SYSID`].
pub(super) fn source(system: i32) -> ControlSource {
    match system {
        0 => ControlSource::GroundStation,
        _ => ControlSource::System(SystemId::new(system as u8)),
    }
}

/// Returns the stick positions; `None` when the input has timed out (J-3).
fn sticks(input: &ManualInput, now: Instant) -> Option<Sticks> {
    match input.manual_control(now) {
        Some(input) => Some(of_axes(&input)),
        None => of_channels(&input.rc_channels(now)?),
    }
}

fn of_axes(input: &ManualControlInput) -> Sticks {
    let axis = |axis: Option<i16>| f32::from(axis.unwrap_or(0)) / 1e3;
    let throttle = f32::from(input.z.unwrap_or(500).max(0)) / 500.0 - 1.0;
    [axis(input.x), axis(input.y), throttle, axis(input.r)]
}

fn of_channels(input: &RcOverride) -> Option<Sticks> {
    let channel = |number| input.channel(number).map(|pulse| ((f32::from(pulse) - 1_500.0) / 500.0).clamp(-1.0, 1.0));
    // A missing channel must not count as its minimum: a missing throttle would mean descent.
    Some([-channel(2)?, channel(1)?, channel(3)?, channel(4)?])
}
