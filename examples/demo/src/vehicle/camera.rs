//! The vehicle's own camera, simulated: a component of its own (<https://mavlink.io/en/services/camera.html>).
//!
//! Images are taken by commands to the camera, or by items of the mission: at once, at an interval, or every so many metres
//! (MAV_CMD_DO_SET_CAM_TRIGG_DIST), which is how a survey is flown.

use mavstack::camera::{CameraOrder, Image, Shot};
use mavstack::dialect::{
    CameraCapFlags, CameraInformation, CameraMode, CameraSettings, CameraZoomType, MavCmd, MavResult, ParamAck,
    SetFocusType, StorageInformation, StorageStatus, StorageType,
};
use mavstack::ext_parameters::ExtValue;
use mavstack::message::ComponentId;
use mavstack::{Camera, Context, Duration, ExtParameters, Instant, Item, StackOf, Text};

use super::{Mode, Quadrotor};
use crate::app::Mavlink;
use crate::body::Vector;

/// MAV_COMP_ID_CAMERA.
pub(crate) const CAMERA: ComponentId = ComponentId::new(100);

/// The capacity of the card, the size of an image, and of a second of video (MiB).
const CAPACITY: f32 = 32_000.0;
const IMAGE: f32 = 8.0;
const VIDEO: f32 = 4.0;

/// The camera, and what the mission has it do.
#[derive(Clone, Copy, Debug)]
pub(super) struct Photographer {
    /// Images are taken every so many metres; 0 is off. The last one was taken at `last`.
    distance: f32,
    last: Vector,
    /// The distance is the mission's: it counts only while the mission is flown.
    is_of_mission: bool,
    /// The distance was flown: the next poll takes an image.
    is_due: bool,
    /// Whether it became due in this step.
    has_triggered: bool,
    /// The settings have changed without a command to the camera.
    is_changed: bool,
    /// What an item of the mission wants.
    order: Option<CameraOrder>,
    /// The mission has started to capture images at an interval, and to record.
    has_started: [bool; 2],
    /// What ends because the mission is no longer flown.
    ends: [bool; 2],
    mode: CameraMode,
    /// In percent.
    zoom: f32,
    focus: f32,
    iso: u32,
    /// What is used of the card (MiB).
    used: f32,
    /// Since when a video is recorded.
    recording: Option<Instant>,
}

impl Photographer {
    pub(super) const NEW: Self = Self {
        distance: 0.0,
        last: Vector::ZERO,
        is_of_mission: false,
        is_due: false,
        has_triggered: false,
        is_changed: false,
        order: None,
        has_started: [false; 2],
        ends: [false; 2],
        mode: CameraMode::IMAGE,
        zoom: 0.0,
        focus: 50.0,
        iso: 100,
        used: 0.0,
        recording: None,
    };

    /// Whether an image by distance has become due since the last call.
    pub(super) fn has_triggered(&mut self) -> bool {
        core::mem::take(&mut self.has_triggered)
    }

    fn used(&self, now: Instant) -> f32 {
        let recorded = self.recording.map_or(0.0, |since| VIDEO * (now - since).as_millis() as f32 * 1e-3);
        (self.used + recorded).min(CAPACITY)
    }
}

impl Quadrotor {
    /// Takes images by distance. Called in each step of a flight.
    pub(super) fn survey(&mut self) {
        let is_on = !self.camera.is_of_mission || self.mode == Mode::Mission;
        let (camera, here) = (&mut self.camera, self.body.position);
        if is_on && camera.distance > 0.0 && here.distance(camera.last) >= camera.distance {
            (camera.last, camera.is_due, camera.has_triggered) = (here, true, true);
        }
    }

    /// MAV_CMD_DO_SET_CAM_TRIGG_DIST: `now` is 1 to take an image at once, also when the distance is 0. At the end of each line of a
    /// survey, QGroundControl asks for one so.
    pub(super) fn trigger_by_distance(&mut self, distance: f32, now: f32) {
        let camera = &mut self.camera;
        (camera.distance, camera.last, camera.is_of_mission) = (distance, self.body.position, false);
        camera.is_due |= now == 1.0;
    }

    /// Ends the images by distance that the mission wanted.
    pub(super) fn end_survey(&mut self) {
        if self.camera.is_of_mission {
            self.trigger_by_distance(0.0, 0.0);
        }
    }

    /// Executes an item of the mission that is about the camera. Another item waits until the camera has taken up the one before.
    /// Returns whether it has been executed.
    pub(super) fn operate_camera(&mut self, item: &Item) -> bool {
        let [p1, p2, p3, _] = item.params;
        let order = match item.command {
            MavCmd::DO_SET_CAM_TRIGG_DIST => {
                self.trigger_by_distance(p1, p3);
                self.camera.is_of_mission = true;
                return true;
            }
            MavCmd::SET_CAMERA_MODE => {
                self.camera.mode = CameraMode(p2 as u8);
                self.camera.is_changed = true;
                return true;
            }
            MavCmd::IMAGE_START_CAPTURE if p3 == 1.0 => CameraOrder::TakeImage,
            MavCmd::IMAGE_START_CAPTURE => {
                CameraOrder::StartCapture { interval: Duration::from_millis((p2 * 1e3) as u64), count: p3 as u32 }
            }
            MavCmd::IMAGE_STOP_CAPTURE => CameraOrder::StopCapture,
            MavCmd::VIDEO_START_CAPTURE => CameraOrder::StartVideo,
            _ => CameraOrder::StopVideo,
        };
        let is_done = self.operate_camera_by(order);
        let [captures, records] = &mut self.camera.has_started;
        match order {
            _ if !is_done => {}
            CameraOrder::StartCapture { .. } => *captures = true,
            CameraOrder::StopCapture => *captures = false,
            CameraOrder::StartVideo => *records = true,
            CameraOrder::StopVideo => *records = false,
            CameraOrder::TakeImage => {}
        }
        is_done
    }

    /// Gives the camera an order. Returns false if it has not taken up the one before.
    pub(super) fn operate_camera_by(&mut self, order: CameraOrder) -> bool {
        let is_free = self.camera.order.is_none();
        if is_free {
            self.camera.order = Some(order);
        }
        is_free
    }
}

impl Quadrotor {
    /// Tells ground stations of changed settings.
    pub(crate) fn report_camera(&mut self, stack: &mut StackOf<Mavlink>) {
        if core::mem::take(&mut self.camera.is_changed) {
            stack.camera.settings_changed();
        }
    }

    /// The mission is no longer flown: the images and the video that it has started end, and its control of the gimbal.
    #[inline(never)]
    pub(super) fn leave_payload(&mut self) {
        self.camera.ends = core::mem::take(&mut self.camera.has_started);
        self.release_gimbal();
    }
}

impl Camera for Quadrotor {
    const COMPONENT: Option<ComponentId> = Some(CAMERA);
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE
        .with(CameraCapFlags::CAPTURE_VIDEO)
        .with(CameraCapFlags::CAN_CAPTURE_IMAGE_IN_VIDEO_MODE)
        .with(CameraCapFlags::HAS_MODES)
        .with(CameraCapFlags::HAS_BASIC_ZOOM)
        .with(CameraCapFlags::HAS_BASIC_FOCUS);
    const STORAGES: u8 = 1;

    fn camera_information(&self, information: &mut CameraInformation) {
        information.vendor_name = *Text::new("mavstack").wire();
        information.model_name = *Text::new("Demo camera").wire();
        information.firmware_version = 1;
        information.focal_length = 8.8;
        information.sensor_size_h = 13.2;
        information.sensor_size_v = 8.8;
        information.resolution_h = 5_472;
        information.resolution_v = 3_648;
        information.gimbal_device_id = super::gimbal::GIMBAL.wire();
    }

    fn camera_settings(&self, settings: &mut CameraSettings) {
        settings.mode_id = self.camera.mode;
        settings.zoomLevel = self.camera.zoom;
        settings.focusLevel = self.camera.focus;
    }

    fn storage_information(&self, _: u8, information: &mut StorageInformation) {
        let used = self.camera.used(self.time);
        information.total_capacity = CAPACITY;
        information.used_capacity = used;
        information.available_capacity = CAPACITY - used;
        information.status = StorageStatus::READY;
        information.r#type = StorageType::MICROSD;
        information.name = Text::new("Card");
    }

    fn take_image(&mut self, cx: &mut Context<'_>, _: u32) -> Shot {
        if self.camera.used(self.time) + IMAGE > CAPACITY {
            return Shot::Failed;
        }
        self.camera.used += IMAGE;
        let mut image = Image::at(cx.now());
        image.attitude = self.gimbal_attitude();
        if let Some(position) = self.global_position() {
            (image.latitude, image.longitude) = (position.latitude, position.longitude);
            image.altitude = (position.altitude * 1e3) as i32;
            image.relative_altitude = (-self.body.position.down * 1e3) as i32;
        }
        Shot::Taken(image)
    }

    fn camera_order(&mut self, _: &mut Context<'_>) -> Option<CameraOrder> {
        if core::mem::take(&mut self.camera.is_due) {
            return Some(CameraOrder::TakeImage);
        }
        if let Some(order) = self.camera.order.take() {
            return Some(order);
        }
        let [captures, records] = &mut self.camera.ends;
        if core::mem::take(captures) {
            return Some(CameraOrder::StopCapture);
        }
        core::mem::take(records).then_some(CameraOrder::StopVideo)
    }

    fn may_capture(&mut self, _: &mut Context<'_>) -> MavResult {
        let is_full = self.camera.used(self.time) + IMAGE > CAPACITY;
        if is_full { MavResult::FAILED } else { MavResult::ACCEPTED }
    }

    fn record_video(&mut self, _: &mut Context<'_>, _: u8, on: bool) -> MavResult {
        self.camera.used = self.camera.used(self.time);
        self.camera.recording = on.then_some(self.time);
        MavResult::ACCEPTED
    }

    fn set_camera_mode(&mut self, _: &mut Context<'_>, mode: CameraMode) -> MavResult {
        self.camera.mode = mode;
        MavResult::ACCEPTED
    }

    fn set_zoom(&mut self, _: &mut Context<'_>, zoom: CameraZoomType, value: f32) -> MavResult {
        self.camera.zoom = match zoom {
            CameraZoomType::RANGE => value,
            CameraZoomType::STEP => (self.camera.zoom + 10.0 * value).clamp(0.0, 100.0),
            _ => return MavResult::UNSUPPORTED,
        };
        MavResult::ACCEPTED
    }

    fn set_focus(&mut self, _: &mut Context<'_>, focus: SetFocusType, value: f32) -> MavResult {
        self.camera.focus = match focus {
            SetFocusType::RANGE => value,
            SetFocusType::AUTO | SetFocusType::AUTO_SINGLE | SetFocusType::AUTO_CONTINUOUS => 50.0,
            _ => return MavResult::UNSUPPORTED,
        };
        MavResult::ACCEPTED
    }

    fn reset_camera_settings(&mut self, _: &mut Context<'_>) -> MavResult {
        let Photographer { mode, zoom, focus, iso, .. } = Photographer::NEW;
        self.camera = Photographer { mode, zoom, focus, iso, ..self.camera };
        MavResult::ACCEPTED
    }

    fn format_storage(&mut self, _: &mut Context<'_>, _: u8) -> MavResult {
        self.camera.used = 0.0;
        MavResult::ACCEPTED
    }
}

/// The camera's settings.
impl ExtParameters for Quadrotor {
    const COMPONENT: Option<ComponentId> = Some(CAMERA);

    fn ext_param_count(&self) -> u16 {
        2
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        match index {
            0 => Some(("CAM_MODE", ExtValue::U8(self.camera.mode.0))),
            1 => Some(("CAM_ISO", ExtValue::U32(self.camera.iso))),
            _ => None,
        }
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, index: u16, value: ExtValue<'_>, _: mavstack::Peer) -> ParamAck {
        match (index, value) {
            (0, ExtValue::U8(mode @ 0..=2)) => self.camera.mode = CameraMode(mode),
            (1, ExtValue::U32(iso @ 100..=6_400)) => self.camera.iso = iso,
            _ => return ParamAck::VALUE_UNSUPPORTED,
        }
        self.camera.is_changed = true;
        ParamAck::ACCEPTED
    }
}
