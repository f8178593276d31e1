//! The payload of the vehicle: gimbals and a camera.

use super::*;

#[cfg(feature = "gimbal-manager")]
impl GimbalManager for Rover {
    const DEVICE: u8 = 154;
    const IS_REMOTE: bool = cfg!(feature = "gimbal-remote");

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation { pitch_min: -1.5, pitch_max: 0.5, ..GimbalManagerInformation::default() }
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        GimbalManagerFlags(self.mode)
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, setpoint: &GimbalSetpoint) -> MavResult {
        match setpoint.target {
            GimbalTarget::Angles { angles, .. } => self.armed = angles.pitch().is_some_and(|pitch| pitch > 0.0),
            GimbalTarget::Attitude { q: [w, ..], .. } => self.armed = w > 0.0,
            GimbalTarget::Manual { rates, .. } => self.armed = rates.yaw().is_some(),
            GimbalTarget::Location { altitude: Some(altitude), .. } => self.armed = altitude > 0.0,
            GimbalTarget::NextWaypoint { offsets } => self.armed = offsets.roll().is_some(),
            GimbalTarget::System(system) => self.mode = u32::from(system.wire()),
            _ => return MavResult::DENIED,
        }
        MavResult::ACCEPTED
    }

    fn device_setpoint(&mut self, _: Instant) -> Option<GimbalDeviceSetAttitude> {
        self.armed.then_some(GimbalDeviceSetAttitude::UNKNOWN)
    }

    fn autopilot_state(&mut self, _: Instant) -> Option<AutopilotStateForGimbalDevice> {
        self.armed.then_some(AutopilotStateForGimbalDevice::UNKNOWN)
    }

    fn device_moved(&mut self, _: &mut Context<'_>, status: &GimbalDeviceAttitudeStatus) {
        self.mode = status.failure_flags.0;
    }

    fn device_found(&mut self, _: &mut Context<'_>, information: &GimbalDeviceInformation) {
        self.mode = u32::from(information.cap_flags);
    }
}

#[cfg(feature = "gimbal-device")]
impl GimbalDevice for Rover {
    fn device_information(&self) -> GimbalDeviceInformation {
        GimbalDeviceInformation { cap_flags: 7, ..GimbalDeviceInformation::UNKNOWN }
    }

    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
        self.armed.then_some(GimbalDeviceAttitudeStatus::UNKNOWN)
    }

    fn set_device_attitude(&mut self, _: &mut Context<'_>, setpoint: &DeviceSetpoint) {
        if let Some([w, ..]) = setpoint.attitude {
            self.armed = w > 0.0;
        }
        self.mode = u32::from(setpoint.flags.0);
    }
}

#[cfg(feature = "camera")]
impl Camera for Rover {
    #[cfg(not(feature = "camera-full"))]
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;
    #[cfg(feature = "camera-full")]
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE
        .with(CameraCapFlags::CAPTURE_VIDEO)
        .with(CameraCapFlags::HAS_MODES)
        .with(CameraCapFlags::HAS_BASIC_ZOOM)
        .with(CameraCapFlags::HAS_BASIC_FOCUS)
        .with(CameraCapFlags::HAS_VIDEO_STREAM);
    const STORAGES: u8 = if cfg!(feature = "camera-full") { 1 } else { 0 };
    const VIDEO_STREAMS: u8 = if cfg!(feature = "camera-full") { 1 } else { 0 };

    fn camera_information(&self, information: &mut CameraInformation) {
        information.vendor_name = *Text::new("Acme").wire();
        information.resolution_h = 4_000;
    }

    fn take_image(&mut self, cx: &mut Context<'_>, _: u32) -> Shot {
        Shot::Taken(Image { latitude: 470_000_000, ..Image::at(cx.now()) })
    }

    #[cfg(feature = "camera-full")]
    fn camera_settings(&self, settings: &mut CameraSettings) {
        settings.mode_id = CameraMode(u8::from(self.armed));
    }

    #[cfg(feature = "camera-full")]
    fn storage_information(&self, _: u8, information: &mut StorageInformation) {
        information.available_capacity = if self.armed { 0.0 } else { 900.0 };
    }

    #[cfg(feature = "camera-full")]
    fn video_stream_information(&self, _: u8, information: &mut VideoStreamInformation) {
        information.framerate = 25.0;
    }

    #[cfg(feature = "camera-full")]
    fn set_camera_mode(&mut self, _: &mut Context<'_>, mode: CameraMode) -> MavResult {
        self.mode = u32::from(mode.0);
        MavResult::ACCEPTED
    }

    #[cfg(feature = "camera-full")]
    fn set_zoom(&mut self, _: &mut Context<'_>, zoom: CameraZoomType, value: f32) -> MavResult {
        self.armed = zoom == CameraZoomType::RANGE && value > 50.0;
        MavResult::ACCEPTED
    }

    #[cfg(feature = "camera-full")]
    fn set_focus(&mut self, _: &mut Context<'_>, _: SetFocusType, value: f32) -> MavResult {
        self.armed = value > 50.0;
        MavResult::ACCEPTED
    }

    #[cfg(feature = "camera-full")]
    fn record_video(&mut self, _: &mut Context<'_>, _: u8, on: bool) -> MavResult {
        self.armed = on;
        MavResult::ACCEPTED
    }

    #[cfg(feature = "camera-full")]
    fn format_storage(&mut self, _: &mut Context<'_>, _: u8) -> MavResult {
        self.mode = 0;
        MavResult::ACCEPTED
    }
}
