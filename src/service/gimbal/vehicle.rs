//! The vehicle's hooks for its gimbal.

use super::setpoint::GimbalSetpoint;
use crate::dialect::{
    AutopilotStateForGimbalDevice, GimbalDeviceAttitudeStatus, GimbalDeviceInformation, GimbalDeviceSetAttitude,
    GimbalManagerFlags, GimbalManagerInformation, MavResult,
};
use crate::message::Address;
use crate::time::{Duration, Instant};
use crate::types::Context;

/// The components that point the gimbal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GimbalControl {
    /// The component in primary control; `None` if nobody is.
    pub primary: Option<Address>,
    /// The component in secondary control; `None` if nobody is.
    pub secondary: Option<Address>,
}

/// A gimbal manager, for a vehicle that has [`ManagerService`](super::ManagerService) in the struct of its
/// [stack](macro@crate::Stack). Without it, the commands reach [`Commands::command`](crate::Commands::command), and the
/// messages [`Vehicle::message`](crate::Vehicle::message).
///
/// ```
/// use mavstack::dialect::{GimbalManagerCapFlags, GimbalManagerFlags, GimbalManagerInformation, MavResult};
/// use mavstack::gimbal::{GimbalSetpoint, GimbalTarget};
/// use mavstack::{Context, GimbalManager};
///
/// /// Two servos: the pitch is level, and the yaw is relative to the vehicle.
/// struct Rover { pitch: f32, yaw: f32 }
///
/// impl GimbalManager for Rover {
///     const DEVICE: u8 = 1;
///
///     fn manager_information(&self) -> GimbalManagerInformation {
///         GimbalManagerInformation {
///             cap_flags: GimbalManagerCapFlags::HAS_NEUTRAL
///                 .with(GimbalManagerCapFlags::HAS_PITCH_AXIS)
///                 .with(GimbalManagerCapFlags::HAS_PITCH_LOCK)
///                 .with(GimbalManagerCapFlags::HAS_YAW_AXIS)
///                 .with(GimbalManagerCapFlags::HAS_YAW_FOLLOW),
///             pitch_min: -1.5,
///             pitch_max: 0.5,
///             yaw_min: -1.5,
///             yaw_max: 1.5,
///             ..GimbalManagerInformation::default()
///         }
///     }
///
///     fn manager_flags(&self) -> GimbalManagerFlags {
///         GimbalManagerFlags::PITCH_LOCK.with(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME)
///     }
///
///     fn point_gimbal(&mut self, _: &mut Context<'_>, setpoint: &GimbalSetpoint) -> MavResult {
///         match setpoint.target {
///             GimbalTarget::Neutral | GimbalTarget::Released => (self.pitch, self.yaw) = (0.0, 0.0),
///             GimbalTarget::Angles { angles, rates } if rates.is_none() && !setpoint.is_yaw_in_earth_frame() => {
///                 self.pitch = angles.pitch().unwrap_or(self.pitch).clamp(-1.5, 0.5);
///                 self.yaw = angles.yaw().unwrap_or(self.yaw).clamp(-1.5, 1.5);
///             }
///             _ => return MavResult::DENIED,
///         }
///         MavResult::ACCEPTED
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `GimbalManager`",
    note = "`ManagerService` in the struct of a stack needs `impl GimbalManager for {Self}`: write it, or leave the field out"
)]
pub trait GimbalManager {
    /// The gimbal device: 1 to 6 for one without MAVLink, which is attached to the autopilot; otherwise its component
    /// id, such as
    /// 154. Ground stations need its GIMBAL_DEVICE_ATTITUDE_STATUS, and ask for its GIMBAL_DEVICE_INFORMATION: a device in this
    /// firmware sends both if [`gimbal_device`](crate::GimbalDevice) is declared.
    const DEVICE: u8;

    /// Whether the device is a MAVLink component on a link. It then gets [`device_setpoint`](Self::device_setpoint) and
    /// [`autopilot_state`](Self::autopilot_state) while it is alive, each on the first link on which it was heard. The
    /// code for it is left out if not.
    const IS_REMOTE: bool = false;

    /// How often [`device_setpoint`](Self::device_setpoint) is sent: 20 Hz by default.
    const SETPOINT_INTERVAL: Duration = Duration::from_millis(50);

    /// How often [`autopilot_state`](Self::autopilot_state) is sent: 20 Hz by default.
    const STATE_INTERVAL: Duration = Duration::from_millis(50);

    /// Returns the capabilities and the limits (rad), for GIMBAL_MANAGER_INFORMATION. The stack sets time and device.
    fn manager_information(&self) -> GimbalManagerInformation;

    /// Returns the flags that hold now, for GIMBAL_MANAGER_STATUS: of the two for the yaw's frame exactly one. Those of
    /// a remote device are in the last [`device_moved`](Self::device_moved).
    fn manager_flags(&self) -> GimbalManagerFlags;

    /// Points the gimbal, or refuses. It is called only for setpoints of the components in control, with finite numbers
    /// (GIM-4, GIM-5). The result answers a command, and is ignored for a message. How primary and secondary control
    /// are mixed is the vehicle's decision.
    ///
    /// A sender of rates that is lost does not stop them. A vehicle that follows rates stops by itself when they are
    /// not repeated: QGroundControl repeats them twice a second.
    fn point_gimbal(&mut self, cx: &mut Context<'_>, setpoint: &GimbalSetpoint) -> MavResult;

    /// Called in the next [`poll`](crate::Stack::poll) after control has changed. A mission whose vehicle has lost
    /// control waits, or continues without the gimbal.
    fn gimbal_control_changed(&mut self, cx: &mut Context<'_>, control: &GimbalControl) {
        let _ = (cx, control);
    }

    /// Returns the setpoint of a remote device. The stack sets the target. `None`: nothing is sent. Start from
    /// [`GimbalDeviceSetAttitude::UNKNOWN`]. The vehicle makes the quaternion, because only it knows its own attitude
    /// and position.
    fn device_setpoint(&mut self, now: Instant) -> Option<GimbalDeviceSetAttitude> {
        let _ = now;
        None
    }

    /// Returns the vehicle's state for a remote device, which keeps its horizon by it. The stack sets the target and
    /// the time. `None`: nothing is sent. Start from [`AutopilotStateForGimbalDevice::UNKNOWN`].
    fn autopilot_state(&mut self, now: Instant) -> Option<AutopilotStateForGimbalDevice> {
        let _ = now;
        None
    }

    /// Called with the attitude and the failures of a remote device. [`Vehicle::peer`](crate::Vehicle::peer) reports
    /// its loss.
    fn device_moved(&mut self, cx: &mut Context<'_>, status: &GimbalDeviceAttitudeStatus) {
        let _ = (cx, status);
    }

    /// Called with the capabilities and the limits of a remote device, each time that they are received. The stack asks
    /// for them when the device appears, every second until they are received.
    fn device_found(&mut self, cx: &mut Context<'_>, information: &GimbalDeviceInformation) {
        let _ = (cx, information);
    }
}
