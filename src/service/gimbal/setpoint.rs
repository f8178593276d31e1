//! What a gimbal is to do: commands, items of missions and messages as one type, checked: rules GIM-5 and GIM-8, C-5 to C-9.
//!
//! Angles are in radians here, whatever carried them. The yaw's frame is that of the flags.

use crate::dialect::{
    GimbalManagerFlags, GimbalManagerSetAttitude, GimbalManagerSetManualControl, GimbalManagerSetPitchyaw, MavCmd,
    MavFrame, MavMountMode, MavResult, MavRoi,
};
use crate::frame::Frame;
use crate::message::{Address, Item, LatLon, Message, SystemId, is_above_terrain};
use crate::num;
use crate::types::{Command, CommandPosition};

/// What a component in control asks of the gimbal: see [`GimbalManager::point_gimbal`](crate::GimbalManager::point_gimbal).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GimbalSetpoint {
    /// The sender; the vehicle's own address for an item of its mission.
    pub from: Address,
    /// Whether the sender has secondary control only: it nudges what the one in primary control points.
    pub is_secondary: bool,
    /// Which axes are locked to the earth, and the frame of the yaw, which [`is_yaw_in_earth_frame`](Self::is_yaw_in_earth_frame)
    /// reads; empty for a target that is no angle. Bits that MAVLink does not define are passed on.
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

/// Roll, pitch and yaw: angles in radians or rates in rad/s. Each may be missing. Positive is clockwise seen along the axes forward, right
/// and down, so a positive pitch is up.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Axes(pub(super) [f32; 3]);

impl Axes {
    /// Returns three axes.
    pub fn new(roll: Option<f32>, pitch: Option<f32>, yaw: Option<f32>) -> Self {
        Self([roll, pitch, yaw].map(|axis| axis.unwrap_or(NAN)))
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
    /// To angles, or at rates: MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, GIMBAL_MANAGER_SET_PITCHYAW, MAV_CMD_DO_MOUNT_CONTROL. A
    /// setpoint without any of them only changes the flags.
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
        /// [`GLOBAL_TERRAIN_ALT`](MavFrame::GLOBAL_TERRAIN_ALT), the last one only for a vehicle with
        /// [a model of the terrain](crate::Vehicle::HAS_TERRAIN_MODEL). `None` for a COMMAND_LONG, which has no frame field (C-6).
        frame: Option<MavFrame>,
    },
    /// At the next waypoint: MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET, MAV_ROI_WPNEXT, MAV_MOUNT_MODE_WPNEXT_OFFSET.
    NextWaypoint {
        /// What to add to roll, pitch and yaw; `None` adds nothing.
        offsets: Axes,
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

const NAN: f32 = f32::NAN;

/// No plain number of a command is that large.
const SCALED: f32 = 1e6;

/// A setpoint as read, of whatever kind: it is checked once, by [`target`](Self::target).
#[derive(Clone, Copy, Debug)]
pub(super) struct Raw {
    kind: Kind,
    pub(super) flags: GimbalManagerFlags,
    /// Roll, pitch, yaw; the altitude; or the system. NaN is not given.
    angles: [f32; 3],
    rates: [f32; 3],
    q: [f32; 4],
    place: [i32; 2],
    frame: Option<MavFrame>,
}

/// What a setpoint is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// The order only takes control.
    Nothing,
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

impl Raw {
    pub(super) const NEW: Self = Self {
        kind: Kind::Nothing,
        flags: GimbalManagerFlags::EMPTY,
        angles: [NAN; 3],
        rates: [NAN; 3],
        q: [NAN; 4],
        place: [0; 2],
        frame: None,
    };

    /// Whether there is nothing to point at.
    pub(super) fn only_takes(&self) -> bool {
        self.kind == Kind::Nothing
    }

    /// Reads a message. Returns the gimbal device that it is for; `None` if it is no setpoint.
    pub(super) fn read_message(&mut self, frame: &Frame<'_>) -> Option<u8> {
        self.kind = match frame.id() {
            GimbalManagerSetAttitude::ID => {
                let m = GimbalManagerSetAttitude::decode(frame.payload());
                (self.kind, self.flags, self.q) = (Kind::Attitude, m.flags, m.q);
                self.rates = [m.angular_velocity_x, m.angular_velocity_y, m.angular_velocity_z];
                return Some(m.gimbal_device_id);
            }
            GimbalManagerSetPitchyaw::ID => Kind::Angles,
            GimbalManagerSetManualControl::ID => Kind::Manual,
            _ => return None,
        };
        // Both messages have the same fields.
        let m = GimbalManagerSetPitchyaw::decode(frame.payload());
        self.flags = m.flags;
        (self.angles, self.rates) = ([NAN, m.pitch, m.yaw], [NAN, m.pitch_rate, m.yaw_rate]);
        Some(m.gimbal_device_id)
    }

    /// Checks the setpoint; `None` if it is invalid (GIM-5).
    pub(super) fn target(&self) -> Option<GimbalTarget> {
        let limit = if self.kind == Kind::Manual { 1.0 } else { f32::MAX };
        let is_off = |number: &f32| number.abs() > limit;
        let frames = GimbalManagerFlags::YAW_IN_VEHICLE_FRAME.with(GimbalManagerFlags::YAW_IN_EARTH_FRAME);
        if self.angles.iter().any(is_off) || self.rates.iter().any(is_off) || self.flags.contains(frames) {
            return None;
        }
        let kind = match self.flags {
            flags if flags.contains(GimbalManagerFlags::RETRACT) => Kind::Retract,
            flags if flags.contains(GimbalManagerFlags::NEUTRAL) => Kind::Neutral,
            _ => self.kind,
        };
        let (angles, rates) = (Axes(self.angles), Axes(self.rates));
        Some(match kind {
            Kind::Retract => GimbalTarget::Retract,
            Kind::Neutral => GimbalTarget::Neutral,
            Kind::Nothing | Kind::Released => GimbalTarget::Released,
            Kind::Manual => GimbalTarget::Manual { angles, rates },
            Kind::Angles => GimbalTarget::Angles { angles, rates },
            Kind::Attitude => match attitude(self.q)? {
                Some(q) => GimbalTarget::Attitude { q, rates },
                None => GimbalTarget::Angles { angles, rates },
            },
            Kind::Location => {
                let [latitude, longitude] = self.place;
                // What is not given is off the globe.
                if latitude.unsigned_abs() > RIGHT_ANGLE || longitude.unsigned_abs() > 2 * RIGHT_ANGLE {
                    return None;
                }
                let position = LatLon { latitude, longitude };
                GimbalTarget::Location { position, altitude: angles.roll(), frame: self.frame }
            }
            Kind::NextWaypoint => GimbalTarget::NextWaypoint { offsets: angles },
            Kind::System => {
                let system = num::integer::<u8>(angles.roll()?).filter(|system| *system != 0);
                GimbalTarget::System(SystemId::new(system?))
            }
        })
    }
}

/// A command, or an item of a mission.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Order {
    pub(super) id: MavCmd,
    params: [f32; 4],
    position: CommandPosition,
    z: f32,
}

impl Order {
    pub(crate) const fn of_command(command: &Command) -> Self {
        let Command { id, params, position, z, .. } = *command;
        Self { id, params, position, z }
    }

    pub(crate) fn of_item(item: &Item) -> Self {
        let Item { frame, command, params, x, y, z, .. } = *item;
        let position = CommandPosition::Int { frame, x, y };
        Self { id: command, params, position, z }
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

    /// Reads a command that points. `has_terrain`: whether the vehicle has a model of the terrain (M-49).
    ///
    /// # Errors
    ///
    /// The result for the answer: a parameter is out of range, or the frame is not supported.
    pub(super) fn read(&self, raw: &mut Raw, has_terrain: bool) -> Result<(), MavResult> {
        let [p1, p2, p3, p4] = self.params;
        // The older protocol: MAV_CMD_DO_MOUNT_CONTROL has the mode in parameter 7, all others theirs in parameter 1.
        let is_mount = self.id == MavCmd::DO_MOUNT_CONTROL;
        let mode = num::integer::<u8>(if is_mount { self.z } else { p1 }).unwrap_or(u8::MAX);
        raw.kind = match self.id {
            MavCmd::DO_GIMBAL_MANAGER_PITCHYAW => {
                let (flags, _) = self.position.params();
                let flags = if flags.is_nan() { Some(0) } else { num::unsigned(flags) };
                raw.flags = GimbalManagerFlags(flags.filter(|flags| flags & !FLAGS == 0).ok_or(MavResult::DENIED)?);
                if p1.abs() > 180.0 || p2.abs() > 180.0 {
                    return Err(MavResult::DENIED);
                }
                (raw.angles, raw.rates) = ([NAN, p1, p2], [NAN, p3, p4]);
                Kind::Angles
            }
            MavCmd::DO_SET_ROI_LOCATION => Kind::Location,
            MavCmd::DO_SET_ROI_NONE => Kind::Released,
            MavCmd::DO_SET_ROI_SYSID => {
                raw.angles = [p1; 3];
                Kind::System
            }
            MavCmd::DO_SET_ROI_WPNEXT_OFFSET => {
                let (pitch, roll) = self.position.params();
                // No angle: a sender has scaled it like degrees of a position (M-75).
                if pitch.abs() >= SCALED || roll.abs() >= SCALED {
                    return Err(MavResult::DENIED);
                }
                raw.angles = [roll, pitch, self.z];
                Kind::NextWaypoint
            }
            MavCmd::DO_SET_ROI => match MavRoi(mode) {
                MavRoi::NONE => Kind::Released,
                MavRoi::WPNEXT => Kind::NextWaypoint,
                MavRoi::LOCATION => Kind::Location,
                _ => return Err(MavResult::DENIED),
            },
            _ => match MavMountMode(mode) {
                MavMountMode::RETRACT => Kind::Retract,
                MavMountMode::NEUTRAL => Kind::Neutral,
                MavMountMode::RC_TARGETING => {
                    raw.flags = GimbalManagerFlags::RC_EXCLUSIVE;
                    Kind::Angles
                }
                MavMountMode::MAVLINK_TARGETING if is_mount => {
                    raw.flags = MOUNT;
                    // Also from 0° to 360°.
                    raw.angles = [p2, p1, if p3 > 180.0 { p3 - 360.0 } else { p3 }];
                    Kind::Angles
                }
                MavMountMode::GPS_POINT if is_mount => Kind::Location,
                MavMountMode::WPNEXT_OFFSET if is_mount => Kind::NextWaypoint,
                // The next command says where to point.
                MavMountMode::MAVLINK_TARGETING | MavMountMode::GPS_POINT => Kind::Nothing,
                _ => return Err(MavResult::DENIED),
            },
        };
        match raw.kind {
            Kind::Angles | Kind::NextWaypoint => {
                raw.angles.iter_mut().chain(&mut raw.rates).for_each(|angle| *angle *= RADIANS);
            }
            Kind::Location => {
                raw.angles = [if is_mount { p4 } else { self.z }; 3];
                return self.read_place(is_mount, raw, has_terrain);
            }
            _ => {}
        }
        Ok(())
    }

    /// Reads latitude, longitude and frame.
    fn read_place(&self, is_mount: bool, raw: &mut Raw, has_terrain: bool) -> Result<(), MavResult> {
        match self.position {
            CommandPosition::Int { frame, x, y } if !is_mount => {
                raw.place = [x, y];
                raw.frame = Some(match frame {
                    MavFrame::GLOBAL | MavFrame::GLOBAL_INT => MavFrame::GLOBAL,
                    MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT => MavFrame::GLOBAL_RELATIVE_ALT,
                    frame if has_terrain && is_above_terrain(frame) => MavFrame::GLOBAL_TERRAIN_ALT,
                    _ => return Err(MavResult::COMMAND_UNSUPPORTED_MAV_FRAME),
                });
            }
            // The older command has no location by its definition, so its frame means nothing (C-7, M-75). ArduPilot's clients
            // scale its location by 1e7, also in a float. No degree is that large.
            CommandPosition::Int { x, y, .. } if x.unsigned_abs() > 180 || y.unsigned_abs() > 180 => raw.place = [x, y],
            position => {
                let (param5, param6) = position.params();
                let is_scaled = is_mount && (param5.abs() > 180.0 || param6.abs() > 180.0);
                raw.place = [scaled(param5, is_scaled), scaled(param6, is_scaled)];
            }
        }
        Ok(())
    }
}

/// Returns degrees, or what is scaled already, in 1e-7 degrees; `i32::MAX` if it is none.
fn scaled(param: f32, is_scaled: bool) -> i32 {
    let scaled = if is_scaled { num::integer(param) } else { num::scale_1e7(param) };
    scaled.unwrap_or(i32::MAX)
}

/// Returns an attitude, which is not given if all of it is NaN; `None` if it is not normalised.
pub(super) fn attitude(q: [f32; 4]) -> Option<Option<[f32; 4]>> {
    if q.iter().all(|number| number.is_nan()) {
        return Some(None);
    }
    let square = q.iter().fold(0.0, |square, number| square + number * number);
    NORMALISED.contains(&square).then_some(Some(q))
}
