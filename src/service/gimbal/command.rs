//! Commands and items of missions that point a gimbal (GIM-8, C-5 to C-9).

use super::setpoint::{RawSetpoint, SetpointKind};
use crate::dialect::{GimbalManagerFlags, MavCmd, MavFrame, MavMountMode, MavResult, MavRoi};
use crate::message::{Item, LatLon, is_above_terrain};
use crate::num;
use crate::types::{Command, CommandPosition};

/// All flags that MAVLink defines.
const FLAGS: u32 = 0x3FF;

/// The flags of an angle from the older protocol, as PX4 reads it: roll and pitch are level, yaw is relative to the
/// vehicle.
const MOUNT_FLAGS: GimbalManagerFlags =
    GimbalManagerFlags::ROLL_LOCK.with(GimbalManagerFlags::PITCH_LOCK).with(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME);

/// No angle of a command is that large.
const SCALED: f32 = 1e6;

/// A command about a gimbal, or an item of a mission.
#[derive(Clone, Copy, Debug)]
pub(super) struct GimbalCommand {
    pub(super) id: MavCmd,
    pub(super) params: [f32; 4],
    position: CommandPosition,
    z: f32,
}

impl GimbalCommand {
    pub(super) const fn of_command(command: &Command) -> Self {
        let Command { id, params, position, z, .. } = *command;
        Self { id, params, position, z }
    }

    pub(super) const fn of_item(item: &Item) -> Self {
        let Item { frame, command: id, params, x, y, z, .. } = *item;
        Self { id, params, position: CommandPosition::Int { frame, x, y }, z }
    }

    /// Whether it is for this gimbal device: 0, NaN and a command without the parameter are for every device.
    pub(super) fn is_for_device(&self, device: u8) -> bool {
        let [first, second, ..] = self.params;
        let param = match self.id {
            MavCmd::DO_GIMBAL_MANAGER_PITCHYAW | MavCmd::DO_GIMBAL_MANAGER_CONFIGURE => self.z,
            MavCmd::DO_SET_ROI_LOCATION | MavCmd::DO_SET_ROI_WPNEXT_OFFSET | MavCmd::DO_SET_ROI_NONE => first,
            MavCmd::DO_SET_ROI_SYSID => second,
            _ => 0.0,
        };
        param.is_nan() || param == 0.0 || param == f32::from(device)
    }

    /// Reads a command that points. `has_terrain`: whether the vehicle has a model of the terrain (M-49).
    ///
    /// # Errors
    ///
    /// The result for the answer: a parameter is out of range, or the frame is not supported.
    pub(super) fn read(&self, setpoint: &mut RawSetpoint, has_terrain: bool) -> Result<(), MavResult> {
        let is_mount = matches!(self.id, MavCmd::DO_MOUNT_CONFIGURE | MavCmd::DO_MOUNT_CONTROL);
        setpoint.kind = if is_mount { self.read_mount(setpoint) } else { self.read_target(setpoint) }?;
        if setpoint.kind == SetpointKind::Location {
            let [.., mount_altitude] = self.params;
            setpoint.altitude = if is_mount { mount_altitude } else { self.z };
            self.read_position(setpoint, is_mount, has_terrain)?;
        }
        for angle in setpoint.angles.iter_mut().chain(&mut setpoint.rates) {
            *angle *= core::f32::consts::PI / 180.0;
        }
        Ok(())
    }

    /// Reads angles and flags, in degrees, of a command except the older protocol.
    fn read_target(&self, setpoint: &mut RawSetpoint) -> Result<SetpointKind, MavResult> {
        let [first, second, third, fourth] = self.params;
        Ok(match self.id {
            MavCmd::DO_GIMBAL_MANAGER_PITCHYAW => {
                let (flags, _) = self.position.params();
                let flags = if flags.is_nan() { Some(0) } else { num::unsigned(flags) };
                let flags = flags.filter(|flags| flags & !FLAGS == 0).ok_or(MavResult::DENIED)?;
                if first.abs() > 180.0 || second.abs() > 180.0 {
                    return Err(MavResult::DENIED);
                }
                setpoint.flags = GimbalManagerFlags(flags);
                setpoint.angles = [f32::NAN, first, second];
                setpoint.rates = [f32::NAN, third, fourth];
                SetpointKind::Angles
            }
            MavCmd::DO_SET_ROI_LOCATION => SetpointKind::Location,
            MavCmd::DO_SET_ROI_NONE => SetpointKind::Released,
            MavCmd::DO_SET_ROI_SYSID => {
                setpoint.system = num::integer(first).unwrap_or(0);
                SetpointKind::System
            }
            MavCmd::DO_SET_ROI_WPNEXT_OFFSET => {
                let (pitch, roll) = self.position.params();
                // No angle: a sender has scaled it like degrees of a position (M-75).
                if pitch.abs() >= SCALED || roll.abs() >= SCALED {
                    return Err(MavResult::DENIED);
                }
                setpoint.angles = [roll, pitch, self.z];
                SetpointKind::NextWaypoint
            }
            // MAV_CMD_DO_SET_ROI.
            _ => match MavRoi(num::integer(first).unwrap_or(u8::MAX)) {
                MavRoi::NONE => SetpointKind::Released,
                MavRoi::WPNEXT => SetpointKind::NextWaypoint,
                MavRoi::LOCATION => SetpointKind::Location,
                _ => return Err(MavResult::DENIED),
            },
        })
    }

    /// The same for the older protocol: MAV_CMD_DO_MOUNT_CONFIGURE and MAV_CMD_DO_MOUNT_CONTROL.
    fn read_mount(&self, setpoint: &mut RawSetpoint) -> Result<SetpointKind, MavResult> {
        let [first, second, third, _] = self.params;
        let is_control = self.id == MavCmd::DO_MOUNT_CONTROL;
        let mode = if is_control { self.z } else { first };
        Ok(match MavMountMode(num::integer(mode).unwrap_or(u8::MAX)) {
            MavMountMode::RETRACT => SetpointKind::Retract,
            MavMountMode::NEUTRAL => SetpointKind::Neutral,
            MavMountMode::RC_TARGETING => {
                setpoint.flags = GimbalManagerFlags::RC_EXCLUSIVE;
                SetpointKind::Angles
            }
            MavMountMode::MAVLINK_TARGETING if is_control => {
                setpoint.flags = MOUNT_FLAGS;
                // Also from 0° to 360°.
                setpoint.angles = [second, first, if third > 180.0 { third - 360.0 } else { third }];
                SetpointKind::Angles
            }
            MavMountMode::GPS_POINT if is_control => SetpointKind::Location,
            MavMountMode::WPNEXT_OFFSET if is_control => SetpointKind::NextWaypoint,
            // The next command says where to point.
            MavMountMode::MAVLINK_TARGETING | MavMountMode::GPS_POINT => SetpointKind::None,
            _ => return Err(MavResult::DENIED),
        })
    }

    /// Reads latitude, longitude and frame.
    fn read_position(&self, setpoint: &mut RawSetpoint, is_mount: bool, has_terrain: bool) -> Result<(), MavResult> {
        let (latitude, longitude) = match self.position {
            CommandPosition::Int { frame, x, y } if !is_mount => {
                setpoint.frame = Some(match frame {
                    MavFrame::GLOBAL | MavFrame::GLOBAL_INT => MavFrame::GLOBAL,
                    MavFrame::GLOBAL_RELATIVE_ALT | MavFrame::GLOBAL_RELATIVE_ALT_INT => MavFrame::GLOBAL_RELATIVE_ALT,
                    frame if has_terrain && is_above_terrain(frame) => MavFrame::GLOBAL_TERRAIN_ALT,
                    _ => return Err(MavResult::COMMAND_UNSUPPORTED_MAV_FRAME),
                });
                (x, y)
            }
            // The older command has no location by its definition, so its frame means nothing (C-7, M-75). ArduPilot's
            // clients scale its location by 1e7, also in a float. No degree is that large.
            CommandPosition::Int { x, y, .. } if x.unsigned_abs() > 180 || y.unsigned_abs() > 180 => (x, y),
            position => {
                let (latitude, longitude) = position.params();
                let is_scaled = is_mount && (latitude.abs() > 180.0 || longitude.abs() > 180.0);
                (coordinate(latitude, is_scaled), coordinate(longitude, is_scaled))
            }
        };
        setpoint.position = LatLon { latitude, longitude };
        Ok(())
    }
}

/// Whether a command points or configures a gimbal.
pub(super) const fn is_about_gimbal(command: MavCmd) -> bool {
    matches!(
        command,
        MavCmd::DO_GIMBAL_MANAGER_PITCHYAW
            | MavCmd::DO_GIMBAL_MANAGER_CONFIGURE
            | MavCmd::DO_SET_ROI_LOCATION
            | MavCmd::DO_SET_ROI_WPNEXT_OFFSET
            | MavCmd::DO_SET_ROI_NONE
            | MavCmd::DO_SET_ROI_SYSID
            | MavCmd::DO_SET_ROI
            | MavCmd::DO_MOUNT_CONFIGURE
            | MavCmd::DO_MOUNT_CONTROL
    )
}

/// Converts degrees to 1e-7 degrees, unless they are scaled already. A number that is neither becomes `i32::MAX`.
fn coordinate(degrees: f32, is_scaled: bool) -> i32 {
    let scaled = if is_scaled { num::integer(degrees) } else { num::scale_1e7(degrees) };
    scaled.unwrap_or(i32::MAX)
}
