//! The commands to a camera: requests for its messages (CAM-1, CAM-3), and what it is to do (CAM-4 to CAM-8).

use super::{Camera, CameraControl, CameraLink, can_send, is_accepted};
use crate::dialect::{
    CameraCapFlags, CameraCaptureStatus, CameraImageCaptured, CameraInformation, CameraMode, CameraSettings,
    CameraSource, CameraZoomType, MavCmd, MavResult, SetFocusType, StorageInformation, VideoStreamInformation,
    VideoStreamStatus,
};
use crate::link::Port;
use crate::message::{Address, ComponentId, Message};
use crate::num;
use crate::service::{Cx, Verdict};
use crate::time::{Duration, Instant};
use crate::types::{Command, Firmware, Outcome};

/// How long a single image with the same sequence number is taken for a retransmission. A client that was started again begins
/// with the same numbers.
const REPEATED: Duration = Duration::from_secs(3);

/// The shortest interval of CAMERA_CAPTURE_STATUS (ms).
const MIN_STATUS_INTERVAL: u32 = 100;

/// A command to take images.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    from: Address,
    /// Interval (s), number of images, sequence number.
    params: [f32; 3],
    at: Instant,
}

impl Start {
    /// All zero bits. A number of images of 0 never equals that of an accepted command while nothing is being taken.
    pub(super) const NONE: Self = Self { from: Address::new(0, 0), params: [0.0; 3], at: Instant::ZERO };
}

/// The camera id in messages and answers: that of a camera of the autopilot.
pub(super) const fn device<V: Camera>() -> u8 {
    if V::COMPONENT.is_none() { 1 } else { 0 }
}

/// Whether a command is for this camera by its parameter for the camera id: 0 is every camera, and NaN is not given. An item of a
/// mission names a component.
fn is_target(component: Option<ComponentId>, param: f32) -> bool {
    let own = component.map_or(1, |component| component.0);
    param.is_nan() || num::integer::<u8>(param).is_some_and(|id| id == 0 || id == own)
}

/// Handles a command; `None` for one that is not for the camera.
#[inline(never)]
pub(super) fn handle<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    port: &Port,
    link: &mut CameraLink,
    command: &Command,
) -> Option<Verdict> {
    let result = match Requested::of(command) {
        Some(requested) => requested.take([F::Vehicle::STORAGES, F::Vehicle::VIDEO_STREAMS], control, port, link)?,
        None if command.id == MavCmd::SET_MESSAGE_INTERVAL => set_interval(cx.now, port, link, command)?,
        None => act(control, cx, link, command)?,
    };
    Some(Outcome { result, result_param2: i32::from(device::<F::Vehicle>()) }.into())
}

/// A request for a message.
#[derive(Clone, Copy)]
struct Requested {
    id: u32,
    /// The instance, or the number of an image.
    index: f32,
    is_valid: bool,
}

impl Requested {
    /// Returns the message that a command requests.
    #[inline(never)]
    fn of(command: &Command) -> Option<Self> {
        let [first, second, ..] = command.params;
        let is_one = |param: f32| num::integer(param) == Some(1);
        let (id, index, is_valid) = match command.id {
            MavCmd::REQUEST_MESSAGE => (num::integer::<u32>(first)?, second, command.has_response_target()),
            // The commands that REQUEST_MESSAGE has replaced.
            MavCmd::REQUEST_CAMERA_INFORMATION => (CameraInformation::ID, 0.0, is_one(first)),
            MavCmd::REQUEST_CAMERA_SETTINGS => (CameraSettings::ID, 0.0, is_one(first)),
            MavCmd::REQUEST_CAMERA_CAPTURE_STATUS => (CameraCaptureStatus::ID, 0.0, is_one(first)),
            MavCmd::REQUEST_STORAGE_INFORMATION => (StorageInformation::ID, first, is_one(second)),
            MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE => (CameraImageCaptured::ID, first, true),
            MavCmd::REQUEST_VIDEO_STREAM_INFORMATION => (VideoStreamInformation::ID, first, true),
            MavCmd::REQUEST_VIDEO_STREAM_STATUS => (VideoStreamStatus::ID, first, true),
            _ => return None,
        };
        Some(Self { id, index, is_valid })
    }

    /// Notes what was requested on a link; `None` if it is no message of the camera.
    #[inline(never)]
    fn take(
        self,
        [storages, streams]: [u8; 2],
        control: &CameraControl,
        port: &Port,
        link: &mut CameraLink,
    ) -> Option<MavResult> {
        let is_refused = !self.is_valid || !can_send(port);
        let (pending, bits) = match self.id {
            CameraInformation::ID => (&mut link.asked, CameraLink::INFORMATION),
            CameraSettings::ID => (&mut link.asked, CameraLink::SETTINGS),
            CameraCaptureStatus::ID => (&mut link.asked, CameraLink::STATUS),
            StorageInformation::ID => (&mut link.storages, instances(self.index, storages)),
            VideoStreamInformation::ID => (&mut link.streams, instances(self.index, streams)),
            VideoStreamStatus::ID => (&mut link.stream_states, instances(self.index, streams)),
            CameraImageCaptured::ID if is_refused => return Some(MavResult::DENIED),
            CameraImageCaptured::ID => return Some(control.ask_image(link, self.index)),
            _ => return None,
        };
        if is_refused || bits == 0 {
            return Some(MavResult::DENIED);
        }
        *pending |= bits;
        Some(MavResult::ACCEPTED)
    }
}

/// Returns the instances that a parameter names, a bit for each: 0 and NaN are all of them.
fn instances(param: f32, count: u8) -> u8 {
    let all = !u8::MAX.checked_shl(u32::from(count)).unwrap_or(0);
    match num::integer::<u8>(param) {
        _ if param.is_nan() => all,
        Some(0) => all,
        Some(id) => all & 1u8.checked_shl(u32::from(id.wrapping_sub(1))).unwrap_or(0),
        None => 0,
    }
}

/// Handles MAV_CMD_SET_MESSAGE_INTERVAL for CAMERA_CAPTURE_STATUS (CAM-5).
fn set_interval(now: Instant, port: &Port, link: &mut CameraLink, command: &Command) -> Option<MavResult> {
    let [id, micros, ..] = command.params;
    if num::integer(id) != Some(CameraCaptureStatus::ID) {
        return None;
    }
    if !can_send(port) || !command.has_response_target() || !(micros >= 0.0 || micros == -1.0) {
        return Some(MavResult::DENIED);
    }
    // By default it is not sent.
    link.interval = if micros > 0.0 { (num::saturated(micros) / 1_000).max(MIN_STATUS_INTERVAL) } else { 0 };
    link.status_at = now;
    Some(MavResult::ACCEPTED)
}

impl CameraControl {
    /// Handles a request for an image by its index. MAVSDK sends MAV_CMD_REQUEST_MESSAGE without it; DENIED makes it use
    /// MAV_CMD_REQUEST_CAMERA_IMAGE_CAPTURE, which has it (`mavlink_request_message.cpp`).
    fn ask_image(&self, link: &mut CameraLink, index: f32) -> MavResult {
        let Some(index) = num::integer::<u32>(index).filter(|index| *index < self.image_count()) else {
            return MavResult::DENIED;
        };
        let number = self.base.wrapping_add(index);
        if !self.is_remembered(number) {
            return MavResult::FAILED;
        }
        link.requested.retain(|number| self.is_remembered(*number));
        let is_pending = link.requested.contains(&number) || link.requested.push(number).is_ok();
        if is_pending { MavResult::ACCEPTED } else { MavResult::TEMPORARILY_REJECTED }
    }

    /// Whether a command to start is a retransmission of the last one.
    fn is_repeated(&self, start: &Start) -> bool {
        let is_same = start.from == self.started.from && start.params == self.started.params;
        match start.params {
            // A single image without a sequence number: whoever presses twice wants two.
            [_, 1.0, 0.0] => false,
            [_, 1.0, _] => is_same && start.at < self.started.at.after(REPEATED),
            _ => is_same && self.left > 0,
        }
    }

    /// Handles MAV_CMD_IMAGE_START_CAPTURE up to the decision whether the camera can. Returns the result if it is decided.
    fn check_start(&self, start: &Start) -> Option<MavResult> {
        let [interval, count, sequence] = start.params;
        let is_valid = (0.0..=86_400.0).contains(&interval)
            && num::integer::<u32>(count).is_some()
            && num::integer::<u32>(sequence).is_some();
        match is_valid {
            false => Some(MavResult::DENIED),
            true if self.is_repeated(start) => Some(MavResult::ACCEPTED),
            true => self.is_capturing().then_some(MavResult::TEMPORARILY_REJECTED),
        }
    }

    /// Starts what a checked command wants.
    fn start(&mut self, start: Start, min_interval: Duration) {
        let [interval, count, _] = start.params;
        self.started = start;
        match num::integer::<u32>(count).unwrap_or(1) {
            1 => {
                self.is_ordered = true;
                self.changed();
            }
            count => {
                let min = u32::try_from(min_interval.as_millis()).unwrap_or(u32::MAX);
                self.begin(start.at, num::saturated(interval * 1_000.0).max(min), count);
            }
        }
    }
}

/// Carries out a command; `None` for one that the camera does not have.
#[inline(never)]
fn act<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    link: &mut CameraLink,
    command: &Command,
) -> Option<MavResult> {
    let has = |flags: CameraCapFlags| F::Vehicle::FLAGS.contains(flags);
    let [first, second, third, fourth] = command.params;
    // Which parameter is the camera id.
    let target = match command.id {
        MavCmd::IMAGE_START_CAPTURE | MavCmd::IMAGE_STOP_CAPTURE if has(CameraCapFlags::CAPTURE_IMAGE) => first,
        MavCmd::DO_DIGICAM_CONTROL if has(CameraCapFlags::CAPTURE_IMAGE) => 0.0,
        MavCmd::VIDEO_START_CAPTURE if has(CameraCapFlags::CAPTURE_VIDEO) => third,
        MavCmd::VIDEO_STOP_CAPTURE if has(CameraCapFlags::CAPTURE_VIDEO) => second,
        MavCmd::VIDEO_START_STREAMING | MavCmd::VIDEO_STOP_STREAMING if F::Vehicle::VIDEO_STREAMS > 0 => second,
        MavCmd::SET_CAMERA_MODE if has(CameraCapFlags::HAS_MODES) => first,
        MavCmd::SET_CAMERA_ZOOM if has(CameraCapFlags::HAS_BASIC_ZOOM) => third,
        MavCmd::SET_CAMERA_FOCUS if has(CameraCapFlags::HAS_BASIC_FOCUS) => third,
        MavCmd::SET_CAMERA_SOURCE => first,
        MavCmd::RESET_CAMERA_SETTINGS => second,
        MavCmd::STORAGE_FORMAT if F::Vehicle::STORAGES > 0 => 0.0,
        _ => return None,
    };
    if !is_target(F::Vehicle::COMPONENT, target) {
        return Some(MavResult::DENIED);
    }
    let byte = |param: f32| num::integer::<u8>(param);
    Some(match command.id {
        MavCmd::IMAGE_START_CAPTURE => {
            let params =
                [if second.is_nan() { 0.0 } else { second }, third, if fourth.is_nan() { 0.0 } else { fourth }];
            start_capture(control, cx, Start { from: command.from.address, params, at: cx.now })
        }
        MavCmd::DO_DIGICAM_CONTROL => match command.position.params() {
            // Parameter 5: shoot.
            (1.0, _) => {
                let params = [0.0, 1.0, 0.0];
                start_capture(control, cx, Start { from: command.from.address, params, at: cx.now })
            }
            _ => MavResult::DENIED,
        },
        MavCmd::IMAGE_STOP_CAPTURE => {
            control.stop_capture();
            MavResult::ACCEPTED
        }
        MavCmd::VIDEO_START_CAPTURE => {
            let hertz = if second.is_nan() { 0.0 } else { second };
            match byte(first) {
                Some(stream) if hertz >= 0.0 => start_video(control, cx, stream, hertz),
                _ => MavResult::DENIED,
            }
        }
        MavCmd::VIDEO_STOP_CAPTURE => {
            byte(first).map_or(MavResult::DENIED, |stream| record(control, cx, stream, false))
        }
        MavCmd::VIDEO_START_STREAMING | MavCmd::VIDEO_STOP_STREAMING => match byte(first) {
            Some(stream) if stream <= F::Vehicle::VIDEO_STREAMS => {
                let (vehicle, mut context) = cx.hook();
                vehicle.stream_video(&mut context, stream, command.id == MavCmd::VIDEO_START_STREAMING)
            }
            _ => MavResult::DENIED,
        },
        MavCmd::STORAGE_FORMAT => format(control, cx, link, [first, second, third]),
        _ => {
            let result = set(cx, command);
            if is_accepted(result) {
                control.settings_changed();
            }
            result
        }
    })
}

/// Handles a command to take images (CAM-4).
#[inline(never)]
fn start_capture<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    start: Start,
) -> MavResult {
    if let Some(result) = control.check_start(&start) {
        return result;
    }
    if is_wrong_mode(cx, CameraCapFlags::CAN_CAPTURE_IMAGE_IN_VIDEO_MODE, true) {
        return MavResult::TEMPORARILY_REJECTED;
    }
    let (vehicle, mut context) = cx.hook();
    let result = vehicle.may_capture(&mut context);
    if is_accepted(result) {
        control.start(start, F::Vehicle::MIN_INTERVAL);
    }
    result
}

/// Whether the camera must leave its mode first: it has modes, lacks this capability, and is in the video mode if `is_video`, or
/// in another one if not.
fn is_wrong_mode<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, capability: CameraCapFlags, is_video: bool) -> bool {
    let flags = F::Vehicle::FLAGS;
    if !flags.contains(CameraCapFlags::HAS_MODES) || flags.contains(capability) {
        return false;
    }
    let mut settings = CameraSettings::UNKNOWN;
    cx.vehicle.camera_settings(&mut settings);
    (settings.mode_id == CameraMode::VIDEO) == is_video
}

/// Handles MAV_CMD_VIDEO_START_CAPTURE (CAM-6).
#[inline(never)]
fn start_video<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    stream: u8,
    hertz: f32,
) -> MavResult {
    if is_wrong_mode(cx, CameraCapFlags::CAN_CAPTURE_VIDEO_IN_IMAGE_MODE, false) {
        return MavResult::TEMPORARILY_REJECTED;
    }
    let result = record(control, cx, stream, true);
    if is_accepted(result) {
        let interval = if hertz > 0.0 { num::saturated(1_000.0 / hertz).max(MIN_STATUS_INTERVAL) } else { 0 };
        control.recording_interval = interval;
        // On every link, the interval begins now.
        control.changed();
    }
    result
}

/// Starts or stops the recording of video, if that changes something.
pub(super) fn record<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    stream: u8,
    on: bool,
) -> MavResult {
    if control.is_recording == on || !F::Vehicle::FLAGS.contains(CameraCapFlags::CAPTURE_VIDEO) {
        return MavResult::ACCEPTED;
    }
    let (vehicle, mut context) = cx.hook();
    let result = vehicle.record_video(&mut context, stream, on);
    if is_accepted(result) {
        (control.is_recording, control.recording_since, control.recording_interval) = (on, cx.now, 0);
        control.changed();
    }
    result
}

/// Handles MAV_CMD_STORAGE_FORMAT (CAM-8): storage, whether to format it, whether to reset the image log.
#[inline(never)]
fn format<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    link: &mut CameraLink,
    [storage, formats, resets]: [f32; 3],
) -> MavResult {
    let flag = |param: f32| if param.is_nan() { Some(0) } else { num::integer(param).filter(|flag: &u8| *flag <= 1) };
    let id = num::integer(storage).filter(|id| (1..=F::Vehicle::STORAGES).contains(id));
    let (Some(id), Some(formats), Some(resets)) = (id, flag(formats), flag(resets)) else {
        return MavResult::DENIED;
    };
    if control.is_capturing() || control.is_recording {
        return MavResult::TEMPORARILY_REJECTED;
    }
    if formats == 1 {
        let (vehicle, mut context) = cx.hook();
        let result = vehicle.format_storage(&mut context, id);
        if !is_accepted(result) {
            return result;
        }
        link.storages |= instances(storage, F::Vehicle::STORAGES);
    }
    if resets == 1 {
        control.reset_images();
    }
    MavResult::ACCEPTED
}

/// Handles a command that changes settings (CAM-7). The vehicle decides.
#[inline(never)]
fn set<F: Firmware<Vehicle: Camera>>(cx: &mut Cx<'_, F>, command: &Command) -> MavResult {
    let has = |flags: CameraCapFlags| F::Vehicle::FLAGS.contains(flags);
    let [first, second, third, _] = command.params;
    let (vehicle, mut context) = cx.hook();
    let result = match command.id {
        MavCmd::SET_CAMERA_MODE if has(CameraCapFlags::HAS_MODES) => {
            within(second, 2).map(|mode| vehicle.set_camera_mode(&mut context, CameraMode(mode)))
        }
        MavCmd::SET_CAMERA_ZOOM if has(CameraCapFlags::HAS_BASIC_ZOOM) => {
            let zoom = within(first, CameraZoomType::HORIZONTAL_FOV.0);
            let zoom = zoom.zip(level(second, zoom == Some(CameraZoomType::RANGE.0)));
            zoom.map(|(zoom, value)| vehicle.set_zoom(&mut context, CameraZoomType(zoom), value))
        }
        MavCmd::SET_CAMERA_FOCUS if has(CameraCapFlags::HAS_BASIC_FOCUS) => {
            let focus = within(first, SetFocusType::AUTO_CONTINUOUS.0);
            let value = match focus {
                Some(kind) if kind >= SetFocusType::AUTO.0 => Some(0.0),
                _ => level(second, focus == Some(SetFocusType::RANGE.0)),
            };
            focus.zip(value).map(|(focus, value)| vehicle.set_focus(&mut context, SetFocusType(focus), value))
        }
        MavCmd::SET_CAMERA_SOURCE => within(second, 3)
            .zip(within(third, 3))
            .map(|(first, second)| vehicle.set_source(&mut context, CameraSource(first), CameraSource(second))),
        _ => (first == 1.0).then(|| vehicle.reset_camera_settings(&mut context)),
    };
    result.unwrap_or(MavResult::DENIED)
}

/// Returns a parameter that is an integer up to `max` (C-9).
fn within(param: f32, max: u8) -> Option<u8> {
    num::integer(param).filter(|number| *number <= max)
}

/// Returns a level that is finite, and 0 to 100 if it is a percentage.
fn level(param: f32, is_percentage: bool) -> Option<f32> {
    let is_valid = if is_percentage { (0.0..=100.0).contains(&param) } else { param.is_finite() };
    is_valid.then_some(param)
}
