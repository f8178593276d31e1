//! The inputs by which a pilot, a companion computer or a ground station steers: sticks, channels, setpoints.

use super::link::{LinkId, Peer};
use crate::dialect::MavFrame;
use crate::message::Address;
use crate::time::{Duration, Instant};

/// The number of radio control channels in RADIO_RC_CHANNELS; the other messages have 18 or fewer.
pub(crate) const CHANNELS: usize = 32;

/// Sticks, channels or a setpoint that the stack has accepted: see
/// [`Vehicle::control_input`](crate::Vehicle::control_input).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ControlInput {
    /// From MANUAL_CONTROL, with `manual_control` in [`#[stack]`](macro@crate::Stack).
    Sticks(ManualControlInput),
    /// The channels that are overridden now, with `manual_control` in [`#[stack]`](macro@crate::Stack).
    Channels(RcOverride),
    /// With [`Setpoints`](crate::setpoints::Setpoints).
    Setpoint(Setpoint),
}

/// The positions of a pilot's sticks, from MANUAL_CONTROL. An axis is −1000 to 1000, or `None` if the sender does not
/// have it or sent a value out of this range (J-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ManualControlInput {
    /// The sender.
    pub from: Peer,
    /// When it was received.
    pub at: Instant,
    /// Forward; for an aircraft, pitch with the nose down.
    pub x: Option<i16>,
    /// Right; for an aircraft, roll.
    pub y: Option<i16>,
    /// Up; thrust. For a vehicle without reverse thrust many senders use only 0 to 1000, with 500 in the middle. The
    /// vehicle and the ground station must agree on it: QGroundControl has a setting, MAVSDK always sends 0 to 1000.
    pub z: Option<i16>,
    /// Yaw. MAVLink defines it as counter-clockwise; the ground stations in use send clockwise as positive.
    pub r: Option<i16>,
    /// Pitch only, for a vehicle that `x` moves forward.
    pub s: Option<i16>,
    /// Roll only, for a vehicle that `y` moves right.
    pub t: Option<i16>,
    /// `aux1` to `aux6`. The vehicle defines their meaning.
    pub aux: [Option<i16>; 6],
    /// The pressed buttons, the first in the lowest bit: `buttons` in the lower half, `buttons2` in the upper.
    /// `buttons2` is 0 if the sender does not have it.
    pub buttons: u32,
}

impl ManualControlInput {
    /// All zero bits.
    pub(crate) const VACANT: Self = Self {
        from: Peer { address: Address::new(0, 0), link: LinkId(0) },
        at: Instant::ZERO,
        x: None,
        y: None,
        z: None,
        r: None,
        s: None,
        t: None,
        aux: [None; 6],
        buttons: 0,
    };
}

/// Radio control channels that replace received ones: the combination of the recent RC_CHANNELS_OVERRIDEs (J-4), or of the
/// recent RADIO_RC_CHANNELS (J-12).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RcOverride {
    /// The channels (µs); 0 for a channel that is not overridden.
    pub(crate) channels: [u16; CHANNELS],
}

/// A setpoint, with its sender and its age.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Setpoint {
    /// The sender, which owns the setpoints until they expire.
    pub from: Peer,
    /// When it was received.
    pub at: Instant,
    /// The sender's clock (ms since its boot), as sent.
    pub time_boot_ms: u32,
    /// The position, velocity or attitude that it asks for.
    pub target: Target,
}

impl Setpoint {
    /// Returns how long ago it was received: less than the timeout.
    pub fn age(&self, now: Instant) -> Duration {
        now - self.at
    }
}

/// The target of a setpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Target {
    /// A position, a velocity or an acceleration: SET_POSITION_TARGET_LOCAL_NED or SET_POSITION_TARGET_GLOBAL_INT.
    Position(PositionSetpoint),
    /// An attitude or rates, and thrust: SET_ATTITUDE_TARGET.
    Attitude(AttitudeSetpoint),
}

/// A position, velocity, acceleration and heading. A field is `None` if the sender's `type_mask` ignores it (J-8): the vehicle
/// decides which combinations it flies.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PositionSetpoint {
    /// The frame of [`place`](Self::place), and of the vectors. It may be any number: a vehicle must not fly a setpoint in a
    /// frame that it does not know.
    pub frame: MavFrame,
    /// Where.
    pub place: Place,
    /// Velocity (m/s): north, east and down, or as [`frame`](Self::frame) says.
    pub velocity: [Option<f32>; 3],
    /// Acceleration (m/s²), or force (N) if [`is_force`](Self::is_force).
    pub acceleration: [Option<f32>; 3],
    /// [`acceleration`](Self::acceleration) is a force.
    pub is_force: bool,
    /// Heading (rad), clockwise from north or as [`frame`](Self::frame) says; any finite number.
    pub yaw: Option<f32>,
    /// Yaw rate (rad/s).
    pub yaw_rate: Option<f32>,
}

/// The position in a [`PositionSetpoint`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Place {
    /// From SET_POSITION_TARGET_LOCAL_NED (m): north, east and down in a NED frame.
    Local([Option<f32>; 3]),
    /// From SET_POSITION_TARGET_GLOBAL_INT.
    Global {
        /// Latitude (1e-7 degrees), −90° to 90°.
        latitude: Option<i32>,
        /// Longitude (1e-7 degrees), −180° to 180°.
        longitude: Option<i32>,
        /// Altitude (m) in the frame of the setpoint.
        altitude: Option<f32>,
    },
}

/// An attitude or body rates, and thrust. A field is `None` if the sender's `type_mask` ignores it (J-8).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AttitudeSetpoint {
    /// The rotation from NED to the body frame as a quaternion (w, x, y, z). Its length is 0.99 to 1.01.
    pub attitude: Option<[f32; 4]>,
    /// Rates of roll, pitch and yaw in the body frame (rad/s).
    pub rates: [Option<f32>; 3],
    /// Collective thrust, 0 to 1; from −1 for a vehicle with reverse thrust.
    pub thrust: Option<f32>,
    /// Thrust in the body frame in place of [`thrust`](Self::thrust): forward, right and down, each −1 to 1.
    pub thrust_body: Option<[f32; 3]>,
}
