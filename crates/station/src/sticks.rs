//! Sticks and setpoints: messages without an answer, sent at a rate.
//!
//! [`Sticks`] run beside other dialogues:
//!
//! ```no_run
//! use mavstack::Duration;
//! use mavstack::dialect::{ManualControl, MavCmd};
//! use mavstack_station::{Failure, GroundStation, sticks::Sticks};
//!
//! fn fly_by_hand(station: &mut impl GroundStation) -> Result<(), Failure> {
//!     let forward = ManualControl { x: 500, y: 0, z: 500, r: 0, ..ManualControl::default() };
//!     let mut pilot = station.alongside(Sticks::new(forward));
//!     pilot.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0])?;
//!     pilot.wait(Duration::from_secs(5))
//! }
//! ```

use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{
    AttitudeTargetTypemask, ManualControl, MavFrame, PositionTargetTypemask, RcChannelsOverride, SetAttitudeTarget,
    SetPositionTargetGlobalInt, SetPositionTargetLocalNed,
};
use mavstack::{Duration, Instant};

/// What is sent. The addresses, and the time of a setpoint, are filled in.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "there is one of them")]
pub enum Input {
    /// A joystick: MANUAL_CONTROL.
    Manual(ManualControl),
    /// The channels of a radio control: RC_CHANNELS_OVERRIDE.
    Channels(RcChannelsOverride),
    /// A position, velocity or acceleration in a local frame.
    Local(SetPositionTargetLocalNed),
    /// A position or velocity in the global frame.
    Global(SetPositionTargetGlobalInt),
    /// An attitude.
    Attitude(SetAttitudeTarget),
}

impl Input {
    /// Returns a joystick: pitch, roll, yaw -1 to 1; throttle 0 to 1, where 0.5 keeps the height.
    pub fn joystick(pitch: f32, roll: f32, throttle: f32, yaw: f32) -> Self {
        let axis = |value: f32| (value.clamp(-1.0, 1.0) * 1_000.0).round() as i16;
        Self::Manual(ManualControl {
            x: axis(pitch),
            y: axis(roll),
            z: axis(throttle),
            r: axis(yaw),
            ..ManualControl::default()
        })
    }

    /// Returns channels 1 to 8 of a radio control (µs); channels that are not given are left alone.
    pub fn channels(pulses: &[u16]) -> Self {
        let mut message = RcChannelsOverride::UNKNOWN;
        let channels = [
            &mut message.chan1_raw,
            &mut message.chan2_raw,
            &mut message.chan3_raw,
            &mut message.chan4_raw,
            &mut message.chan5_raw,
            &mut message.chan6_raw,
            &mut message.chan7_raw,
            &mut message.chan8_raw,
        ];
        channels.into_iter().zip(pulses).for_each(|(channel, pulse)| *channel = *pulse);
        Self::Channels(message)
    }

    /// Returns a velocity in the local frame: north, east, down (m/s).
    pub fn velocity([vx, vy, vz]: [f32; 3]) -> Self {
        let type_mask = ignored(&[0, 1, 2, 6, 7, 8, 10, 11]);
        Self::Local(SetPositionTargetLocalNed {
            vx,
            vy,
            vz,
            type_mask,
            coordinate_frame: MavFrame::LOCAL_NED,
            ..SetPositionTargetLocalNed::default()
        })
    }

    /// Returns a position in the local frame: north, east, down (m).
    pub fn position([x, y, z]: [f32; 3]) -> Self {
        let type_mask = ignored(&[3, 4, 5, 6, 7, 8, 10, 11]);
        Self::Local(SetPositionTargetLocalNed {
            x,
            y,
            z,
            type_mask,
            coordinate_frame: MavFrame::LOCAL_NED,
            ..SetPositionTargetLocalNed::default()
        })
    }

    /// Returns an attitude, as a quaternion (w, x, y, z), and a thrust (0 to 1).
    pub fn attitude(q: [f32; 4], thrust: f32) -> Self {
        // The rates of roll, pitch and yaw are ignored.
        let type_mask = AttitudeTargetTypemask(0b111);
        Self::Attitude(SetAttitudeTarget { q, thrust, type_mask, ..SetAttitudeTarget::default() })
    }

    /// Returns the interval at which a client sends it.
    ///
    /// | | QGroundControl | MAVSDK | MAVProxy, pymavlink |
    /// |---|---|---|---|
    /// | MANUAL_CONTROL | 25 Hz | 20 Hz, the application's choice | 10 Hz, the script's choice |
    /// | RC_CHANNELS_OVERRIDE | 25 Hz | 20 Hz | 10 Hz |
    /// | setpoints | 20 Hz | 20 Hz, its plugin `offboard` | 10 Hz |
    pub fn interval(&self, client: Client) -> Duration {
        match (client, self) {
            (Client::QGroundControl, Self::Manual(_) | Self::Channels(_)) => Duration::from_millis(40),
            (Client::QGroundControl | Client::Mavsdk, _) => Duration::from_millis(50),
            (Client::MavProxy | Client::Pymavlink, _) => Duration::from_millis(100),
        }
    }

    fn send(self, io: &mut Io<'_>) {
        let target = io.target();
        let (target_system, target_component) = (target.system.wire(), target.component.wire());
        let time_boot_ms = io.now().time_boot_ms();
        match self {
            Self::Manual(message) => io.send(&ManualControl { target: target_system, ..message }),
            Self::Channels(message) => io.send(&RcChannelsOverride { target_system, target_component, ..message }),
            Self::Local(message) => {
                io.send(&SetPositionTargetLocalNed { time_boot_ms, target_system, target_component, ..message });
            }
            Self::Global(message) => {
                io.send(&SetPositionTargetGlobalInt { time_boot_ms, target_system, target_component, ..message });
            }
            Self::Attitude(message) => {
                io.send(&SetAttitudeTarget { time_boot_ms, target_system, target_component, ..message });
            }
        }
    }
}

/// Returns the mask of a setpoint with these bits: the fields that are ignored.
fn ignored(bits: &[u16]) -> PositionTargetTypemask {
    PositionTargetTypemask(bits.iter().map(|bit| 1 << bit).sum())
}

impl From<ManualControl> for Input {
    fn from(message: ManualControl) -> Self {
        Self::Manual(message)
    }
}

impl From<RcChannelsOverride> for Input {
    fn from(message: RcChannelsOverride) -> Self {
        Self::Channels(message)
    }
}

impl From<SetPositionTargetLocalNed> for Input {
    fn from(message: SetPositionTargetLocalNed) -> Self {
        Self::Local(message)
    }
}

impl From<SetPositionTargetGlobalInt> for Input {
    fn from(message: SetPositionTargetGlobalInt) -> Self {
        Self::Global(message)
    }
}

impl From<SetAttitudeTarget> for Input {
    fn from(message: SetAttitudeTarget) -> Self {
        Self::Attitude(message)
    }
}

/// Sends an [`Input`] at a rate, the client's by default. Never ends by default.
pub struct Sticks {
    input: Box<dyn FnMut(Duration) -> Input>,
    interval: Option<Duration>,
    time: Option<Duration>,
    begin: Option<Instant>,
    due: Instant,
    sent: u32,
}

impl Sticks {
    /// Holds the sticks still.
    pub fn new(input: impl Into<Input>) -> Self {
        let input = input.into();
        Self::moving(move |_| input)
    }

    /// Moves the sticks: `input` gets the time since the first message.
    pub fn moving(input: impl FnMut(Duration) -> Input + 'static) -> Self {
        Self { input: Box::new(input), interval: None, time: None, begin: None, due: Instant::ZERO, sent: 0 }
    }

    /// Sends at another interval.
    #[must_use]
    pub fn every(mut self, interval: Duration) -> Self {
        self.interval = Some(interval);
        self
    }

    /// Ends after this time.
    #[must_use]
    pub fn for_time(mut self, time: Duration) -> Self {
        self.time = Some(time);
        self
    }

    /// Returns the number of messages sent.
    pub fn sent(&self) -> u32 {
        self.sent
    }
}

impl std::fmt::Debug for Sticks {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Sticks").field("interval", &self.interval).field("time", &self.time).finish_non_exhaustive()
    }
}

impl Dialogue for Sticks {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        let elapsed = io.now() - *self.begin.get_or_insert(io.now());
        if self.time.is_some_and(|time| elapsed >= time) {
            return Some(Ok(()));
        }
        if io.now() >= self.due {
            let input = (self.input)(elapsed);
            self.due = io.now() + self.interval.unwrap_or_else(|| input.interval(io.client()));
            self.sent += 1;
            input.send(io);
        }
        None
    }

    fn receive(&mut self, _: &mut Io<'_>, _: &Received) {}
}
