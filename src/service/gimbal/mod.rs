//! The gimbal protocol, version 2: the manager, which decides which component points a gimbal, and the device, which is
//! one.
//!
//! Implements <https://mavlink.io/en/services/gimbal_v2.html>, rules GIM-1 to GIM-12. The two sides are services of
//! their own; a firmware may declare one of them or both:
//!
//! ```text
//!   ground station ─┐   MAV_CMD_DO_GIMBAL_MANAGER_*, MAV_CMD_DO_SET_ROI_*       ┌─▶ a gimbal of the vehicle's own
//!   companion ──────┼─▶ GIMBAL_MANAGER_SET_*  ─▶ manager ─▶ GimbalManager::point_gimbal
//!   mission ────────┘                          (is it allowed?)                 └─▶ GIMBAL_DEVICE_SET_ATTITUDE ─▶ device
//! ```
//!
//! Left out: several gimbals of one manager, tracking of a point or a rectangle in the picture, and the device's side
//! of AUTOPILOT_STATE_FOR_GIMBAL_DEVICE, which reaches [`Vehicle::message`](crate::Vehicle::message).

mod command;
mod device;
mod manager;
mod remote;
mod setpoint;
mod status_stream;
mod vehicle;

pub use device::{DeviceCounters, DeviceService, DeviceSetpoint, GimbalDevice};
pub use manager::{ManagerCounters, ManagerService};
pub use setpoint::{Axes, GimbalSetpoint, GimbalTarget};
pub use vehicle::{GimbalControl, GimbalManager};

use crate::link::Port;
use crate::message::{ComponentId, Message};
use crate::types::Firmware;

/// Sends a message of the autopilot, or of another component of the firmware.
fn send<F: Firmware, M: Message>(port: &mut Port, component: Option<ComponentId>, message: &M) -> bool {
    port.outbox.send_from::<F, M>(component, message)
}
