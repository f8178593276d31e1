//! Gimbal manager and gimbal device.
