//! What a gimbal is to do: commands, items of missions and messages as one type, checked: rules GIM-5 and GIM-8, C-5 to C-9.
//!
//! Angles are in radians here, whatever carried them. The yaw's frame is that of the flags.

use crate::dialect::{
    GimbalManagerFlags, GimbalManagerSetAttitude, GimbalManagerSetManualControl, GimbalManagerSetPitchyaw, MavCmd,
    MavFrame, MavMountMode, MavResult, MavRoi,
};
use crate::frame::Frame;
use crate::message::{Address, Item, LatLon, SystemId};
use crate::num;
use crate::types::{Command, CommandPosition};

/// What somebody in control asks of the gimbal: see [`GimbalManager::point_gimbal`](crate::GimbalManager::point_gimbal).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GimbalSetpoint {
    /// The sender; the vehicle's own address for an item of its mission.
    pub from: Address,
    /// Whether the sender has secondary control only: it nudges what the one in primary control points.
    pub is_secondary: bool,
    /// Which axes are locked to the earth, and the frame of the yaw, which [`is_yaw_in_earth_frame`](Self::is_yaw_in_earth_frame)
    /// reads; empty for a target that is no angle. Of a bit that MAVLink does not define nothing is known.
    pub flags: GimbalManagerFlags,
    /// Where to point.
    pub target: GimbalTarget,
}

impl GimbalSetpoint {
    /// Returns whether the yaw and its rate are relative to north, and not to the front of the vehicle. A sender that names neither
    /// frame means the earth exactly if it locks the yaw.
    pub const fn is_yaw_in_earth_frame(&self) -> bool {
        let flags = self.flags;
        flags.contains(GimbalManagerFlags::YAW_IN_EARTH_FRAME)
            || (flags.contains(GimbalManagerFlags::YAW_LOCK)
                && !flags.contains(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME))
    }
}

/// Where a gimbal is to point. Angles are in radians, rates in rad/s, each positive clockwise seen along the axes forward, right and
/// down: a positive pitch is up. `None` leaves an axis as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GimbalTarget {
    /// Into the retracted position: GIMBAL_MANAGER_FLAGS_RETRACT, MAV_MOUNT_MODE_RETRACT.
    Retract,
    /// Forward and level: GIMBAL_MANAGER_FLAGS_NEUTRAL, MAV_MOUNT_MODE_NEUTRAL.
    Neutral,
    /// To angles, or at rates: MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, GIMBAL_MANAGER_SET_PITCHYAW, MAV_CMD_DO_MOUNT_CONTROL. A
    /// setpoint without any of them only changes the flags.
    Angles {
        /// Roll, pitch, yaw.
        angles: [Option<f32>; 3],
        /// Rates of roll, pitch, yaw.
        rates: [Option<f32>; 3],
    },
    /// To an attitude: GIMBAL_MANAGER_SET_ATTITUDE.
    Attitude {
        /// The attitude (w, x, y, z). Its length is 0.99 to 1.01.
        q: [f32; 4],
        /// Rates of roll, pitch, yaw.
        rates: [Option<f32>; 3],
    },
    /// By hand, without units, each −1 to 1: GIMBAL_MANAGER_SET_MANUAL_CONTROL. The vehicle scales them.
    Manual {
        /// Pitch, yaw.
        angles: [Option<f32>; 2],
        /// Rates of pitch, yaw.
        rates: [Option<f32>; 2],
    },
    /// At a location, while the vehicle moves: MAV_CMD_DO_SET_ROI_LOCATION, MAV_ROI_LOCATION, MAV_MOUNT_MODE_GPS_POINT.
    Location {
        /// Where.
        position: LatLon,
        /// The altitude (m) in `frame`, if it is given.
        altitude: Option<f32>,
        /// [`GLOBAL`](MavFrame::GLOBAL), [`GLOBAL_RELATIVE_ALT`](MavFrame::GLOBAL_RELATIVE_ALT) or
        /// [`GLOBAL_TERRAIN_ALT`](MavFrame::GLOBAL_TERRAIN_ALT). `None` for a COMMAND_LONG, which has no frame field (C-6).
        frame: Option<MavFrame>,
    },
    /// At the next waypoint: MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET, MAV_ROI_WPNEXT, MAV_MOUNT_MODE_WPNEXT_OFFSET.
    NextWaypoint {
        /// What to add to roll, pitch, yaw.
        offsets: [f32; 3],
    },
    /// At another vehicle: MAV_CMD_DO_SET_ROI_SYSID.
    System(SystemId),
    /// At nothing any more: MAV_CMD_DO_SET_ROI_NONE, MAV_ROI_NONE. The gimbal follows manual input if there is any, and is neutral
    /// otherwise.
    Released,
}

/// π / 180.
const RADIANS: f32 = core::f32::consts::PI / 180.0;

/// The square of a quaternion's length: normalised within 1 %.
const NORMALISED: core::ops::RangeInclusive<f32> = 0.99 * 0.99..=1.01 * 1.01;

/// 90° in 1e-7 degrees.
const RIGHT_ANGLE: u32 = 900_000_000;

/// All flags that MAVLink defines.
const FLAGS: u32 = 0x3FF;

/// The flags of an angle from the older protocol, as PX4 reads it: roll and pitch are level, yaw is relative to the vehicle.
const MOUNT: GimbalManagerFlags =
    GimbalManagerFlags::ROLL_LOCK.with(GimbalManagerFlags::PITCH_LOCK).with(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME);

/// A command, or an item of a mission.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Order {
    pub(super) id: MavCmd,
    params: [f32; 4],
    /// Parameters 5 and 6 of a command without a location.
    plain: [f32; 2],
    z: f32,
    /// Latitude and longitude (deg·1e7); `i32::MAX` is not given.
    place: [i32; 2],
    /// `None` for a COMMAND_LONG.
    frame: Option<MavFrame>,
}

impl Order {
    #[inline(never)]
    pub(crate) fn of_command(command: &Command) -> Self {
        let (p5, p6) = command.position.params();
        let (latitude, longitude) = command.position.lat_lon();
        let frame = match command.position {
            CommandPosition::Int { frame, .. } => Some(frame),
            CommandPosition::Long { .. } => None,
        };
        let place = [latitude.unwrap_or(i32::MAX), longitude.unwrap_or(i32::MAX)];
        let mut order = Self { id: command.id, params: command.params, plain: [p5, p6], z: command.z, place, frame };
        // ArduPilot's clients scale the location of this command by 1e7, also in a float. No degree is that large.
        if frame.is_none() && command.id == MavCmd::DO_MOUNT_CONTROL && (p5.abs() > 180.0 || p6.abs() > 180.0) {
            order.place = [p5, p6].map(|param| num::integer(param).unwrap_or(i32::MAX));
        }
        order
    }

    #[inline(never)]
    pub(crate) fn of_item(item: &Item) -> Self {
        let plain = if item.frame == MavFrame::MISSION { num::from_i32 } else { num::from_1e7 };
        Self {
            id: item.command,
            params: item.params,
            plain: [plain(item.x), plain(item.y)],
            z: item.z,
            place: [item.x, item.y],
            frame: Some(item.frame),
        }
    }

    /// Returns the parameter that names a gimbal device; 0 if the command has none. NaN and 0 are every device.
    pub(super) const fn device(&self) -> f32 {
        let [p1, p2, ..] = self.params;
        match self.id {
            MavCmd::DO_GIMBAL_MANAGER_PITCHYAW | MavCmd::DO_GIMBAL_MANAGER_CONFIGURE => self.z,
            MavCmd::DO_SET_ROI_LOCATION | MavCmd::DO_SET_ROI_WPNEXT_OFFSET | MavCmd::DO_SET_ROI_NONE => p1,
            MavCmd::DO_SET_ROI_SYSID => p2,
            _ => 0.0,
        }
    }

    /// Returns the parameters of MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: primary and secondary, each as system and component.
    pub(super) const fn pairs(&self) -> [[f32; 2]; 2] {
        let [a, b, c, d] = self.params;
        [[a, b], [c, d]]
    }

    /// Returns what a command that points asks for; `None` if it only takes control.
    ///
    /// # Errors
    ///
    /// The result for the answer: a parameter is out of range, or the frame is not supported.
    #[inline(never)]
    pub(super) fn read(&self) -> Result<(GimbalManagerFlags, Option<GimbalTarget>), MavResult> {
        let [p1, p2, p3, p4] = self.params;
        let [p5, p6] = self.plain;
        let none = GimbalManagerFlags::EMPTY;
        let target = match self.id {
            MavCmd::DO_GIMBAL_MANAGER_PITCHYAW => {
                let flags = if p5.is_nan() { Some(0) } else { num::integer::<u32>(p5) };
                let flags = flags.filter(|flags| flags & !FLAGS == 0).map(GimbalManagerFlags);
                let is_turn = |angle: f32| angle.is_nan() || (-180.0..=180.0).contains(&angle);
                let flags = flags.filter(|_| is_turn(p1) && is_turn(p2)).ok_or(MavResult::DENIED)?;
                let [pitch, yaw, pitch_rate, yaw_rate] = self.params.map(|param| param * RADIANS);
                let target = angles([f32::NAN, pitch, yaw], [f32::NAN, pitch_rate, yaw_rate]);
                return target
                    .and_then(|target| with_flags(flags, target))
                    .map(|target| (flags, Some(target)))
                    .ok_or(MavResult::DENIED);
            }
            MavCmd::DO_SET_ROI_LOCATION => Some(self.location(self.z)?),
            MavCmd::DO_SET_ROI_NONE => Some(GimbalTarget::Released),
            MavCmd::DO_SET_ROI_WPNEXT_OFFSET => Some(next_waypoint([p6, p5, self.z])?),
            MavCmd::DO_SET_ROI_SYSID => match num::integer::<u8>(p1) {
                Some(system @ 1..) => Some(GimbalTarget::System(SystemId(system))),
                _ => return Err(MavResult::DENIED),
            },
            MavCmd::DO_SET_ROI => match num::integer::<u8>(p1).map(MavRoi) {
                Some(MavRoi::NONE) => Some(GimbalTarget::Released),
                Some(MavRoi::WPNEXT) => Some(next_waypoint([0.0; 3])?),
                Some(MavRoi::LOCATION) => Some(self.location(self.z)?),
                _ => return Err(MavResult::DENIED),
            },
            // The older protocol: MAV_CMD_DO_MOUNT_CONTROL has the mode in parameter 7, MAV_CMD_DO_MOUNT_CONFIGURE in 1.
            id => {
                let is_control = id == MavCmd::DO_MOUNT_CONTROL;
                match num::integer::<u8>(if is_control { self.z } else { p1 }).map(MavMountMode) {
                    Some(MavMountMode::RETRACT) => Some(GimbalTarget::Retract),
                    Some(MavMountMode::NEUTRAL) => Some(GimbalTarget::Neutral),
                    Some(MavMountMode::RC_TARGETING) => {
                        let target = angles([f32::NAN; 3], [f32::NAN; 3]);
                        return Ok((GimbalManagerFlags::RC_EXCLUSIVE, target));
                    }
                    Some(MavMountMode::MAVLINK_TARGETING) if is_control => {
                        // Also from 0° to 360°.
                        let yaw = if p3 > 180.0 { p3 - 360.0 } else { p3 };
                        let target = angles([p2, p1, yaw].map(|angle| angle * RADIANS), [f32::NAN; 3]);
                        return target.map(|target| (MOUNT, Some(target))).ok_or(MavResult::DENIED);
                    }
                    Some(MavMountMode::GPS_POINT) if is_control => Some(self.location(p4)?),
                    Some(MavMountMode::WPNEXT_OFFSET) if is_control => Some(next_waypoint([0.0; 3])?),
                    // What follows says where to point.
                    Some(MavMountMode::MAVLINK_TARGETING | MavMountMode::GPS_POINT) => None,
                    _ => return Err(MavResult::DENIED),
                }
            }
        };
        Ok((none, target))
    }

    fn location(&self, altitude: f32) -> Result<GimbalTarget, MavResult> {
        let [latitude, longitude] = self.place;
        let frame = match self.frame {
            // The older command has no location by its definition, so its frame means nothing (C-7).
            _ if self.id == MavCmd::DO_MOUNT_CONTROL => None,
            None => None,
            Some(MavFrame::GLOBAL | MavFrame::GLOBAL_INT) => Some(MavFrame::GLOBAL),
            Some(MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT) => {
                Some(MavFrame::GLOBAL_RELATIVE_ALT)
            }
            Some(MavFrame::GLOBAL_TERRAIN_ALT | MavFrame::GLOBAL_TERRAIN_ALT_INT) => Some(MavFrame::GLOBAL_TERRAIN_ALT),
            Some(_) => return Err(MavResult::COMMAND_UNSUPPORTED_MAV_FRAME),
        };
        // What is not given is off the globe.
        let is_on_globe = latitude.unsigned_abs() <= RIGHT_ANGLE && longitude.unsigned_abs() <= 2 * RIGHT_ANGLE;
        if !is_on_globe || altitude.is_infinite() {
            return Err(MavResult::DENIED);
        }
        let altitude = given(altitude);
        Ok(GimbalTarget::Location { position: LatLon { latitude, longitude }, altitude, frame })
    }
}

/// Returns a number that is not NaN.
fn given(number: f32) -> Option<f32> {
    Some(number).filter(|number| !number.is_nan())
}

fn is_finite(numbers: &[f32]) -> bool {
    !numbers.iter().any(|number| number.is_infinite())
}

/// Returns angles and rates; `None` if one is infinite.
fn angles(angles: [f32; 3], rates: [f32; 3]) -> Option<GimbalTarget> {
    let is_finite = is_finite(&angles) && is_finite(&rates);
    is_finite.then(|| GimbalTarget::Angles { angles: angles.map(given), rates: rates.map(given) })
}

fn next_waypoint(offsets: [f32; 3]) -> Result<GimbalTarget, MavResult> {
    // Clients leave out what is not offset (C-8).
    let offsets = offsets.map(|offset| if offset.is_nan() { 0.0 } else { offset * RADIANS });
    if is_finite(&offsets) { Ok(GimbalTarget::NextWaypoint { offsets }) } else { Err(MavResult::DENIED) }
}

/// Returns the target under these flags: two of them take precedence. `None` if they contradict each other.
fn with_flags(flags: GimbalManagerFlags, target: GimbalTarget) -> Option<GimbalTarget> {
    let frames = GimbalManagerFlags::YAW_IN_VEHICLE_FRAME.with(GimbalManagerFlags::YAW_IN_EARTH_FRAME);
    if flags.contains(frames) {
        None
    } else if flags.contains(GimbalManagerFlags::RETRACT) {
        Some(GimbalTarget::Retract)
    } else if flags.contains(GimbalManagerFlags::NEUTRAL) {
        Some(GimbalTarget::Neutral)
    } else {
        Some(target)
    }
}

/// Returns whether a frame is a setpoint, and of which device.
#[inline(never)]
pub(super) fn device_of(frame: &Frame<'_>) -> Option<u8> {
    let attitude = frame.decode::<GimbalManagerSetAttitude>().map(|message| message.gimbal_device_id);
    let pitch_yaw = || frame.decode::<GimbalManagerSetPitchyaw>().map(|message| message.gimbal_device_id);
    let manual = || frame.decode::<GimbalManagerSetManualControl>().map(|message| message.gimbal_device_id);
    attitude.or_else(pitch_yaw).or_else(manual)
}

/// Returns what a message asks for; `None` if it is invalid.
#[inline(never)]
pub(super) fn read_message(frame: &Frame<'_>) -> Option<(GimbalManagerFlags, GimbalTarget)> {
    let (flags, target) = if let Some(message) = frame.decode::<GimbalManagerSetAttitude>() {
        let GimbalManagerSetAttitude { angular_velocity_x: x, angular_velocity_y: y, angular_velocity_z: z, .. } =
            message;
        let rotation = rotation(message.q, [x, y, z])?;
        (message.flags, rotation)
    } else if let Some(message) = frame.decode::<GimbalManagerSetPitchyaw>() {
        let GimbalManagerSetPitchyaw { pitch, yaw, pitch_rate, yaw_rate, .. } = message;
        (message.flags, angles([f32::NAN, pitch, yaw], [f32::NAN, pitch_rate, yaw_rate])?)
    } else {
        let message = frame.decode::<GimbalManagerSetManualControl>()?;
        let GimbalManagerSetManualControl { pitch, yaw, pitch_rate, yaw_rate, .. } = message;
        if [pitch, yaw, pitch_rate, yaw_rate].iter().any(|number| number.abs() > 1.0) {
            return None;
        }
        let (angles, rates) = ([pitch, yaw].map(given), [pitch_rate, yaw_rate].map(given));
        (message.flags, GimbalTarget::Manual { angles, rates })
    };
    with_flags(flags, target).map(|target| (flags, target))
}

/// Returns an attitude, or only rates if all of it is NaN; `None` if it is not normalised, or a number is infinite.
fn rotation(q: [f32; 4], rates: [f32; 3]) -> Option<GimbalTarget> {
    let rates = checked_rates(rates)?;
    match checked_attitude(q)? {
        Some(q) => Some(GimbalTarget::Attitude { q, rates }),
        None => Some(GimbalTarget::Angles { angles: [None; 3], rates }),
    }
}

/// Returns rates, of which NaN ones are not given; `None` if one is infinite.
pub(super) fn checked_rates(rates: [f32; 3]) -> Option<[Option<f32>; 3]> {
    is_finite(&rates).then(|| rates.map(given))
}

/// Returns an attitude, which is not given if all of it is NaN; `None` if it is not normalised.
#[inline(never)]
pub(super) fn checked_attitude(q: [f32; 4]) -> Option<Option<[f32; 4]>> {
    if q.iter().all(|number| number.is_nan()) {
        return Some(None);
    }
    let square = q.iter().fold(0.0, |square, number| square + number * number);
    NORMALISED.contains(&square).then_some(Some(q))
}
