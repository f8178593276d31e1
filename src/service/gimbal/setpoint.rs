//! The setpoints of a gimbal, from messages and commands (GIM-5).
//!
//! Angles are in radians here, whatever carried them. The yaw's frame is that of the flags.

use crate::dialect::{
    GimbalManagerFlags, GimbalManagerSetAttitude, GimbalManagerSetManualControl, GimbalManagerSetPitchyaw, MavFrame,
};
use crate::frame::Frame;
use crate::message::{Address, LatLon, Message, SystemId};

/// A setpoint of a component in control: see [`GimbalManager::point_gimbal`](crate::GimbalManager::point_gimbal).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GimbalSetpoint {
    /// The sender; the vehicle's own address for an item of its mission.
    pub from: Address,
    /// Whether the sender has secondary control only: it offsets the primary controller's setpoint.
    pub is_secondary: bool,
    /// Which axes are locked to the earth, and the frame of the yaw, which
    /// [`is_yaw_in_earth_frame`](Self::is_yaw_in_earth_frame) reads; empty for a target that is no angle. Bits that
    /// MAVLink does not define are passed on.
    pub flags: GimbalManagerFlags,
    /// Where to point.
    pub target: GimbalTarget,
}

impl GimbalSetpoint {
    /// Returns whether the yaw and its rate are relative to north, and not to the front of the vehicle. A sender that
    /// names neither frame means the earth exactly if it locks the yaw.
    pub const fn is_yaw_in_earth_frame(&self) -> bool {
        let flags = self.flags;
        flags.contains(GimbalManagerFlags::YAW_IN_EARTH_FRAME)
            || (flags.contains(GimbalManagerFlags::YAW_LOCK)
                && !flags.contains(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME))
    }
}

/// Roll, pitch and yaw: angles in radians or rates in rad/s. Each may be missing. Positive is clockwise seen along the
/// axes forward, right and down, so a positive pitch is up.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Axes(pub(super) [f32; 3]);

impl Axes {
    /// Returns three axes.
    pub fn new(roll: Option<f32>, pitch: Option<f32>, yaw: Option<f32>) -> Self {
        Self([roll, pitch, yaw].map(|axis| axis.unwrap_or(f32::NAN)))
    }

    /// Returns the roll; `None` leaves it as it is.
    pub fn roll(self) -> Option<f32> {
        let [roll, ..] = self.0;
        given(roll)
    }

    /// Returns the pitch; `None` leaves it as it is.
    pub fn pitch(self) -> Option<f32> {
        let [_, pitch, _] = self.0;
        given(pitch)
    }

    /// Returns the yaw; `None` leaves it as it is.
    pub fn yaw(self) -> Option<f32> {
        let [.., yaw] = self.0;
        given(yaw)
    }

    /// Returns whether all are missing.
    pub fn is_none(self) -> bool {
        self.0.iter().all(|axis| axis.is_nan())
    }
}

/// Two missing axes are equal.
impl PartialEq for Axes {
    fn eq(&self, other: &Self) -> bool {
        self.0.map(given) == other.0.map(given)
    }
}

/// Returns a number that is not NaN.
fn given(number: f32) -> Option<f32> {
    if number.is_nan() { None } else { Some(number) }
}

/// Where a gimbal is to point.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GimbalTarget {
    /// Into the retracted position: GIMBAL_MANAGER_FLAGS_RETRACT, MAV_MOUNT_MODE_RETRACT.
    Retract,
    /// Forward and level: GIMBAL_MANAGER_FLAGS_NEUTRAL, MAV_MOUNT_MODE_NEUTRAL.
    Neutral,
    /// To angles, or at rates: MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, GIMBAL_MANAGER_SET_PITCHYAW,
    /// MAV_CMD_DO_MOUNT_CONTROL. A setpoint without any of them only changes the flags.
    Angles {
        /// The angles.
        angles: Axes,
        /// The rates.
        rates: Axes,
    },
    /// To an attitude: GIMBAL_MANAGER_SET_ATTITUDE.
    Attitude {
        /// The attitude (w, x, y, z). Its length is 0.99 to 1.01.
        q: [f32; 4],
        /// The rates.
        rates: Axes,
    },
    /// By hand, without units, each −1 to 1: GIMBAL_MANAGER_SET_MANUAL_CONTROL. The vehicle scales them.
    Manual {
        /// Pitch and yaw.
        angles: Axes,
        /// Rates of pitch and yaw.
        rates: Axes,
    },
    /// At a location, while the vehicle moves: MAV_CMD_DO_SET_ROI_LOCATION, MAV_ROI_LOCATION, MAV_MOUNT_MODE_GPS_POINT.
    Location {
        /// Where.
        position: LatLon,
        /// The altitude (m) in `frame`, if it is given.
        altitude: Option<f32>,
        /// [`GLOBAL`](MavFrame::GLOBAL), [`GLOBAL_RELATIVE_ALT`](MavFrame::GLOBAL_RELATIVE_ALT) or
        /// [`GLOBAL_TERRAIN_ALT`](MavFrame::GLOBAL_TERRAIN_ALT), the last one only for a vehicle with [a model of the
        /// terrain](crate::Vehicle::HAS_TERRAIN_MODEL). `None` for a COMMAND_LONG, which has no frame field (C-6).
        frame: Option<MavFrame>,
    },
    /// At the next waypoint: MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET, MAV_ROI_WPNEXT, MAV_MOUNT_MODE_WPNEXT_OFFSET.
    NextWaypoint {
        /// The offset of roll, pitch and yaw; `None` adds nothing.
        offsets: Axes,
    },
    /// At another vehicle: MAV_CMD_DO_SET_ROI_SYSID.
    System(SystemId),
    /// At nothing any more: MAV_CMD_DO_SET_ROI_NONE, MAV_ROI_NONE. The gimbal follows manual input if there is any, and
    /// is neutral otherwise.
    Released,
}

/// The square of a quaternion's length: normalised within 1 %.
const NORMALISED: core::ops::RangeInclusive<f32> = 0.99 * 0.99..=1.01 * 1.01;

/// 90° in 1e-7 degrees.
const RIGHT_ANGLE: u32 = 900_000_000;

/// The kind of a setpoint as received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SetpointKind {
    /// A command that only takes control.
    None,
    Retract,
    Neutral,
    Angles,
    Attitude,
    Manual,
    Location,
    NextWaypoint,
    System,
    Released,
}

/// A setpoint as received. Fields that its kind does not have are NaN or 0. One type for all kinds takes less flash
/// than to convert each of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct RawSetpoint {
    pub(super) kind: SetpointKind,
    pub(super) flags: GimbalManagerFlags,
    /// Roll, pitch and yaw.
    pub(super) angles: [f32; 3],
    pub(super) rates: [f32; 3],
    q: [f32; 4],
    pub(super) position: LatLon,
    pub(super) altitude: f32,
    pub(super) frame: Option<MavFrame>,
    pub(super) system: u8,
}

impl RawSetpoint {
    pub(super) const NONE: Self = Self {
        kind: SetpointKind::None,
        flags: GimbalManagerFlags::EMPTY,
        angles: [f32::NAN; 3],
        rates: [f32::NAN; 3],
        q: [f32::NAN; 4],
        position: LatLon { latitude: 0, longitude: 0 },
        altitude: f32::NAN,
        frame: None,
        system: 0,
    };

    /// Reads a message. Returns the gimbal device that it is for, 0 for every device; `None` if it is no setpoint.
    pub(super) fn read_message(&mut self, frame: &Frame<'_>) -> Option<u8> {
        self.kind = match frame.id() {
            GimbalManagerSetAttitude::ID => {
                let m = GimbalManagerSetAttitude::decode(frame.payload());
                self.kind = SetpointKind::Attitude;
                self.flags = m.flags;
                self.q = m.q;
                self.rates = [m.angular_velocity_x, m.angular_velocity_y, m.angular_velocity_z];
                return Some(m.gimbal_device_id);
            }
            GimbalManagerSetPitchyaw::ID => SetpointKind::Angles,
            GimbalManagerSetManualControl::ID => SetpointKind::Manual,
            _ => return None,
        };
        // Both messages have the same fields.
        let m = GimbalManagerSetPitchyaw::decode(frame.payload());
        self.flags = m.flags;
        self.angles = [f32::NAN, m.pitch, m.yaw];
        self.rates = [f32::NAN, m.pitch_rate, m.yaw_rate];
        Some(m.gimbal_device_id)
    }

    /// Returns the target, or the one that the flags demand instead; `None` if the setpoint is invalid (GIM-5).
    pub(super) fn check(&self) -> Option<GimbalTarget> {
        let limit = if self.kind == SetpointKind::Manual { 1.0 } else { f32::MAX };
        let both_frames = GimbalManagerFlags::YAW_IN_VEHICLE_FRAME.with(GimbalManagerFlags::YAW_IN_EARTH_FRAME);
        if self.angles.iter().chain(&self.rates).any(|axis| axis.abs() > limit) || self.flags.contains(both_frames) {
            return None;
        }
        let kind = match self.flags {
            flags if flags.contains(GimbalManagerFlags::RETRACT) => SetpointKind::Retract,
            flags if flags.contains(GimbalManagerFlags::NEUTRAL) => SetpointKind::Neutral,
            _ => self.kind,
        };
        let (angles, rates) = (Axes(self.angles), Axes(self.rates));
        Some(match kind {
            SetpointKind::Retract => GimbalTarget::Retract,
            SetpointKind::Neutral => GimbalTarget::Neutral,
            SetpointKind::None | SetpointKind::Released => GimbalTarget::Released,
            SetpointKind::Manual => GimbalTarget::Manual { angles, rates },
            SetpointKind::Angles => GimbalTarget::Angles { angles, rates },
            SetpointKind::Attitude => match attitude(self.q).ok()? {
                Some(q) => GimbalTarget::Attitude { q, rates },
                None => GimbalTarget::Angles { angles, rates },
            },
            SetpointKind::Location => {
                let position @ LatLon { latitude, longitude } = self.position;
                // A coordinate that is not given is off the globe.
                let is_on_globe = latitude.unsigned_abs() <= RIGHT_ANGLE && longitude.unsigned_abs() <= 2 * RIGHT_ANGLE;
                if !is_on_globe || self.altitude.is_infinite() {
                    return None;
                }
                GimbalTarget::Location { position, altitude: given(self.altitude), frame: self.frame }
            }
            SetpointKind::NextWaypoint => GimbalTarget::NextWaypoint { offsets: angles },
            SetpointKind::System if self.system == 0 => return None,
            SetpointKind::System => GimbalTarget::System(SystemId::new(self.system)),
        })
    }
}

/// A quaternion has another length than 1.
pub(super) struct NotNormalised;

/// Returns the attitude in a message; `None` if it is not given.
pub(super) fn attitude(q: [f32; 4]) -> Result<Option<[f32; 4]>, NotNormalised> {
    if q.iter().all(|number| number.is_nan()) {
        return Ok(None);
    }
    let square = q.iter().map(|number| number * number).sum();
    if NORMALISED.contains(&square) { Ok(Some(q)) } else { Err(NotNormalised) }
}
