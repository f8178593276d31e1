//! The commands to a camera: requests for its messages (CAM-1, CAM-3), and what it is to do (CAM-4 to CAM-8).

use super::messages::{IMAGE, ROWS, Row, STORAGE, counts};
use super::{Camera, CameraControl, CameraLink, can_send, is_accepted, millis};
use crate::dialect::{
    CameraCapFlags, CameraCaptureStatus, CameraMode, CameraSettings, CameraSource, CameraZoomType, MavCmd, MavResult,
    MavSeverity, SetFocusType,
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Start {
    from: Address,
    /// The interval (ms).
    interval: u32,
    /// The number of images; 0 for no end.
    count: u32,
    /// The sequence number; 0 for none.
    sequence: u32,
}

impl Start {
    /// All zero bits: no command, because no sender has this address.
    pub(super) const NONE: Self = Self { from: Address::new(0, 0), interval: 0, count: 0, sequence: 0 };

    /// Reads interval, number and sequence. `None` if they are invalid.
    fn new(from: Address, [interval, count, sequence]: [f32; 3]) -> Option<Self> {
        let given = |param: f32| if param.is_nan() { 0.0 } else { param };
        let interval = Some(given(interval)).filter(|interval| (0.0..=MAX_INTERVAL).contains(interval))?;
        let (count, sequence) = (num::integer(count)?, num::integer(given(sequence))?);
        Some(Self { from, interval: num::saturated(interval * 1_000.0), count, sequence })
    }
}

/// The longest interval of images (s).
const MAX_INTERVAL: f32 = 86_400.0;

/// The camera id in messages and answers (CAM-9): that of a camera of the autopilot.
pub(super) const fn device<V: Camera>() -> u8 {
    if V::COMPONENT.is_none() { 1 } else { 0 }
}

/// Whether a command is for this camera by its parameter for the camera id: 0 is every camera, and NaN is not given. An item of a
/// mission names a component.
fn is_target(component: Option<ComponentId>, param: f32) -> bool {
    let own = component.map_or(1, |component| component.wire());
    param.is_nan() || num::integer::<u8>(param).is_some_and(|id| id == 0 || id == own)
}

/// Handles a command; `None` for one that is not for the camera.
pub(super) fn handle<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    port: &Port,
    link: &mut CameraLink,
    command: &Command,
) -> Option<Verdict> {
    let counts = const { counts(F::Vehicle::STORAGES, F::Vehicle::VIDEO_STREAMS) };
    let result = match request(counts, control, port, link, command) {
        Some(result) => result,
        None if command.id == MavCmd::SET_MESSAGE_INTERVAL => set_interval(cx.now, port, link, command)?,
        None => act(control, cx, link, command)?,
    };
    Some(Outcome { result, result_param2: i32::from(device::<F::Vehicle>()) }.into())
}

/// Handles a request for a message; `None` if it is none, or for no message of the camera. `counts` are the instances of each
/// message.
fn request(
    counts: [u8; ROWS.len()],
    control: &CameraControl,
    port: &Port,
    link: &mut CameraLink,
    command: &Command,
) -> Option<MavResult> {
    let [first, second, ..] = command.params;
    let is_request = command.id == MavCmd::REQUEST_MESSAGE;
    let id = num::integer(first);
    let is_it = |row: &Row| if is_request { id == Some(row.id) } else { row.old == command.id };
    let number = ROWS.iter().position(is_it)?;
    let is_one = |param: f32| num::integer(param) == Some(1);
    let (index, is_valid) = match command.id {
        MavCmd::REQUEST_MESSAGE => (second, command.has_response_target()),
        MavCmd::REQUEST_STORAGE_INFORMATION => (first, is_one(second)),
        MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE
        | MavCmd::REQUEST_VIDEO_STREAM_INFORMATION
        | MavCmd::REQUEST_VIDEO_STREAM_STATUS => (first, true),
        _ => (0.0, is_one(first)),
    };
    if !is_valid || !can_send(port) {
        return Some(MavResult::DENIED);
    }
    if number == IMAGE {
        return Some(control.ask_image(link, index));
    }
    let bits = match counts.get(number) {
        // It has no instances, so that the parameter means nothing.
        Some(0) => 1,
        Some(count) => instances(index, count.wrapping_sub(1)),
        None => 0,
    };
    let pending = link.asked.get_mut(number)?;
    *pending |= bits;
    Some(if bits == 0 { MavResult::DENIED } else { MavResult::ACCEPTED })
}

/// Returns the instances that a parameter names, a bit for each: 0 and NaN are all of them.
fn instances(param: f32, count: u8) -> u8 {
    let all = !u8::MAX.checked_shl(u32::from(count)).unwrap_or(0);
    match num::integer::<u8>(param) {
        Some(0) => all,
        Some(id) => all & 1u8.checked_shl(u32::from(id.wrapping_sub(1))).unwrap_or(0),
        None if param.is_nan() => all,
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
        let entry = number.wrapping_add(1);
        let is_free = |other: &&mut u32| **other == entry || !self.is_requested(**other);
        let Some(place) = link.requested.iter_mut().find(is_free) else { return MavResult::TEMPORARILY_REJECTED };
        *place = entry;
        MavResult::ACCEPTED
    }

    /// Handles MAV_CMD_IMAGE_START_CAPTURE up to the decision whether the camera can. Returns the result if it is decided.
    fn check_start(&self, now: Instant, start: &Start) -> Option<MavResult> {
        let is_repeated = *start == self.started
            && match (start.count, start.sequence) {
                // Without a sequence number, a second press of the button is a second image.
                (1, 0) => false,
                (_, 0) => self.left > 0,
                _ => self.left > 0 || now < self.started_at + REPEATED,
            };
        if is_repeated {
            return Some(MavResult::ACCEPTED);
        }
        self.is_capturing().then_some(MavResult::TEMPORARILY_REJECTED)
    }

    /// Starts what a checked command wants.
    fn start(&mut self, now: Instant, start: Start, min_interval: u32) {
        (self.started, self.started_at) = (start, now);
        if start.count == 1 {
            self.is_ordered = true;
            self.changed();
        } else {
            self.begin(now, start.interval.max(min_interval), start.count);
        }
    }
}

/// Carries out a command; `None` for one that the camera does not have.
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
        return Some(refused(cx, MavResult::DENIED));
    }
    let byte = |param: f32| num::integer::<u8>(param);
    Some(match command.id {
        MavCmd::IMAGE_START_CAPTURE => start_capture(control, cx, command, [second, third, fourth]),
        // Parameter 5: shoot.
        MavCmd::DO_DIGICAM_CONTROL if command.position.params().0 == 1.0 => {
            start_capture(control, cx, command, [0.0, 1.0, 0.0])
        }
        MavCmd::DO_DIGICAM_CONTROL => refused(cx, MavResult::DENIED),
        MavCmd::IMAGE_STOP_CAPTURE => {
            control.stop_capture();
            MavResult::ACCEPTED
        }
        MavCmd::VIDEO_START_CAPTURE => {
            let hertz = if second.is_nan() { 0.0 } else { second };
            match byte(first) {
                Some(stream) if hertz >= 0.0 => start_video(control, cx, stream, hertz),
                _ => refused(cx, MavResult::DENIED),
            }
        }
        MavCmd::VIDEO_STOP_CAPTURE => match byte(first) {
            Some(stream) => record(control, cx, stream, false),
            None => refused(cx, MavResult::DENIED),
        },
        MavCmd::VIDEO_START_STREAMING | MavCmd::VIDEO_STOP_STREAMING => match byte(first) {
            Some(stream) if stream <= F::Vehicle::VIDEO_STREAMS => {
                let (vehicle, mut context) = cx.hook();
                vehicle.stream_video(&mut context, stream, command.id == MavCmd::VIDEO_START_STREAMING)
            }
            _ => refused(cx, MavResult::DENIED),
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

/// Handles a command to take images (CAM-4). `params` are interval, number and sequence.
fn start_capture<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    command: &Command,
    params: [f32; 3],
) -> MavResult {
    let Some(start) = Start::new(command.from.address, params) else { return refused(cx, MavResult::DENIED) };
    if let Some(result) = control.check_start(cx.now, &start) {
        return if result == MavResult::ACCEPTED { result } else { refused(cx, result) };
    }
    if is_wrong_mode(cx, CameraCapFlags::CAN_CAPTURE_IMAGE_IN_VIDEO_MODE, true) {
        return refused(cx, MavResult::TEMPORARILY_REJECTED);
    }
    let (vehicle, mut context) = cx.hook();
    let result = vehicle.may_capture(&mut context);
    if is_accepted(result) {
        control.start(cx.now, start, const { millis(F::Vehicle::MIN_INTERVAL) });
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
fn start_video<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    stream: u8,
    hertz: f32,
) -> MavResult {
    if is_wrong_mode(cx, CameraCapFlags::CAN_CAPTURE_VIDEO_IN_IMAGE_MODE, false) {
        return refused(cx, MavResult::TEMPORARILY_REJECTED);
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
fn format<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    link: &mut CameraLink,
    [storage, formats, resets]: [f32; 3],
) -> MavResult {
    let flag = |param: f32| if param.is_nan() { Some(0) } else { num::integer(param).filter(|flag: &u8| *flag <= 1) };
    let id = num::integer(storage).filter(|id| (1..=F::Vehicle::STORAGES).contains(id));
    let (Some(id), Some(formats), Some(resets)) = (id, flag(formats), flag(resets)) else {
        return refused(cx, MavResult::DENIED);
    };
    if control.is_capturing() || control.is_recording {
        return refused(cx, MavResult::TEMPORARILY_REJECTED);
    }
    if formats == 1 {
        let (vehicle, mut context) = cx.hook();
        let result = vehicle.format_storage(&mut context, id);
        if !is_accepted(result) {
            return result;
        }
        if let Some(asked) = link.asked.get_mut(STORAGE) {
            *asked |= instances(storage, F::Vehicle::STORAGES);
        }
    }
    if resets == 1 {
        control.reset_images();
    }
    MavResult::ACCEPTED
}

/// Handles a command that changes settings (CAM-7). The vehicle decides.
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
    result.unwrap_or_else(|| refused(cx, MavResult::DENIED))
}

/// Explains a refusal of the stack itself by a text, and returns it (C-16). The vehicle explains its own.
fn refused<F: Firmware>(cx: &mut Cx<'_, F>, result: MavResult) -> MavResult {
    if cfg!(feature = "plan-texts") {
        let text: &[u8] = match result {
            MavResult::DENIED => b"Camera: a parameter is out of range",
            _ => b"Camera: busy, or in another mode",
        };
        cx.text(MavSeverity::WARNING, text);
    }
    result
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
