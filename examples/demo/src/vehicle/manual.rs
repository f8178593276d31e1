//! Flight by hand: sticks, or radio channels in their place, give a speed; centred sticks hold the position.
//!
//! Axes as QGroundControl and MAVSDK send them: forward, right, turning right are positive, and the throttle of 0 to 1000
//! neither climbs nor sinks in the middle. Radio channels as ArduPilot has them: 1 roll, 2 pitch (low is forward), 3
//! throttle, 4 yaw.

use mavstack::dialect::{MavResult, MavSeverity, RcChannels};
use mavstack::{ControlSource, Duration, Instant, SystemId};

use super::{Live, Mode, Quadrotor};
use crate::plan::Maneuver;
use crate::tuning::Tuning;

/// Sticks: forward, right, up, turning right, each from -1 to 1.
type Sticks = [f32; 4];

/// A stick is centred within so much of it.
const DEAD_BAND: f32 = 0.05;

impl Quadrotor {
    /// Who may steer, and how old what he says may be.
    pub(super) fn tune_sticks(&mut self) {
        let system = self.tuning.get(Tuning::MAV_GCS_SYSID);
        let timeout = self.tuning.get(Tuning::COM_RC_LOSS_T);
        self.input.set_source(if system == 0 {
            ControlSource::GroundStation
        } else {
            ControlSource::System(SystemId(system))
        });
        self.input.set_timeout(Duration::from_micros((timeout * 1e6) as u64));
    }

    /// Where the sticks are; `None` without fresh ones (J-3).
    fn sticks(&self) -> Option<Sticks> {
        if let Some(input) = self.input.manual_control(self.time) {
            let axis = |axis: Option<i16>| f32::from(axis.unwrap_or(0)) / 1e3;
            let throttle = f32::from(input.z.unwrap_or(500).max(0)) / 500.0 - 1.0;
            return Some([axis(input.x), axis(input.y), throttle, axis(input.r)]);
        }
        let input = self.input.rc_channels(self.time)?;
        let channel =
            |number| input.channel(number).map(|pulse| ((f32::from(pulse) - 1_500.0) / 500.0).clamp(-1.0, 1.0));
        // A throttle that is not there is no throttle that is down.
        Some([-channel(2)?, channel(1)?, channel(3)?, channel(4)?])
    }

    /// The mode of flight by hand; not without sticks.
    pub(super) fn fly_by_hand(&mut self) -> MavResult {
        if self.sticks().is_none() {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Position mode refused: no manual control");
        }
        self.enter(Mode::Position, Maneuver::Stay(self.body.rest()));
        self.intended = Mode::Position;
        MavResult::ACCEPTED
    }

    /// Without fresh sticks it holds.
    #[inline(never)]
    pub(super) fn watch_sticks(&mut self) {
        if self.mode == Mode::Position && self.sticks().is_none() {
            self.stop();
            self.say(MavSeverity::WARNING, "Manual control lost: holding");
        }
    }

    /// A step by hand.
    #[inline(never)]
    pub(super) fn follow_sticks(&mut self, live: &Live<'_>) {
        let Some(sticks) = self.sticks() else { return };
        let [forward, right, up, turn] = sticks.map(|stick| if stick.abs() < DEAD_BAND { 0.0 } else { stick });
        let tuning = &self.tuning;
        let speed = tuning.get(Tuning::MPC_VEL_MANUAL);
        let vertical =
            if up > 0.0 { tuning.get(Tuning::MPC_Z_VEL_MAX_UP) } else { tuning.get(Tuning::MPC_Z_VEL_MAX_DN) };
        let rate = tuning.get(Tuning::MPC_MAN_Y_MAX).to_radians();
        let mut next = self.body;
        next.steer([forward * speed, right * speed, -up * vertical], turn * rate, super::DT);
        self.advance(next, live);
    }

    /// RC_CHANNELS: there is no receiver, so what somebody sent in its place.
    pub(crate) fn rc_channels(&self, now: Instant) -> RcChannels {
        self.input.rc_channels(now).unwrap_or_default().to_message(now, &[])
    }
}
