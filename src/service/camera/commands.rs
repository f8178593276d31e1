//! The commands to a camera: requests for its messages (CAM-1, CAM-3), captures and settings (CAM-4 to CAM-8).

use super::control::{CameraControl, CaptureCommand, millis};
use super::link::{CameraLink, Instances, REQUESTABLE, Requestable};
use super::messages::can_send;
use super::vehicle::{Camera, device_id};
use crate::dialect::{
    CameraCapFlags, CameraCaptureStatus, CameraImageCaptured, CameraMode, CameraSettings, CameraSource, CameraZoomType,
    MavCmd, MavResult, MavSeverity, SetFocusType, StorageInformation, VideoStreamInformation, VideoStreamStatus,
};
use crate::link::Port;
use crate::message::{ComponentId, Message};
use crate::num;
use crate::service::{Cx, Verdict};
use crate::time::Instant;
use crate::types::{Command, Firmware, Outcome};

/// The shortest interval of CAMERA_CAPTURE_STATUS (ms).
const MIN_STATUS_INTERVAL: u32 = 100;

/// The longest interval of images (s).
const MAX_INTERVAL: f32 = 86_400.0;

/// Why the stack itself refuses a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CameraRefusal {
    /// A parameter is out of range: DENIED.
    InvalidParam,
    /// The camera is busy, or in a mode in which it cannot do this: TEMPORARILY_REJECTED.
    NotNow,
}

/// Whether the recording of video starts or stops.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Recording {
    Start,
    Stop,
}

/// The parameters of a command to take images.
struct CaptureParams {
    /// The interval (s).
    interval: f32,
    /// The number of images; 0 for no end.
    count: f32,
    /// The sequence number; 0 for none.
    sequence: f32,
}

/// Handles a command. Returns `None` if it is not for the camera.
pub(super) fn handle<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    port: &Port,
    link: &mut CameraLink,
    command: &Command,
) -> Option<Verdict> {
    let result = if let Some(result) = request_message::<F::Vehicle>(control, port, link, command) {
        result
    } else if command.id == MavCmd::SET_MESSAGE_INTERVAL {
        set_interval(cx.now, port, link, command)?
    } else {
        let camera_id = camera_id_param::<F::Vehicle>(command)?;
        let is_for_this_camera = is_own_id(F::Vehicle::COMPONENT, camera_id);
        let result =
            if is_for_this_camera { execute(control, cx, link, command) } else { Err(CameraRefusal::InvalidParam) };
        result.unwrap_or_else(|refusal| explain(cx, refusal))
    };
    Some(Outcome { result, result_param2: i32::from(device_id::<F::Vehicle>()) }.into())
}

/// Handles a request for a message, in the present form and in the superseded one. Returns `None` if the command
/// requests no message of the camera.
fn request_message<V: Camera>(
    control: &CameraControl,
    port: &Port,
    link: &mut CameraLink,
    command: &Command,
) -> Option<MavResult> {
    let [first, second, ..] = command.params;
    let is_present_form = command.id == MavCmd::REQUEST_MESSAGE;
    let requested_id = num::integer(first);
    let is_requested = |message: &&Requestable| {
        if is_present_form { requested_id == Some(message.id) } else { message.superseded == command.id }
    };
    let message = REQUESTABLE.iter().find(is_requested)?;
    // A superseded command has a parameter that is 1 if the message is requested, or the id of an instance, or both.
    let is_one = |param: f32| num::integer(param) == Some(1);
    let (instance, is_valid) = match command.id {
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
    let instances = match message.id {
        CameraImageCaptured::ID => return Some(control.request_image(link, instance)),
        StorageInformation::ID => Instances::of_param(instance, V::STORAGES),
        VideoStreamInformation::ID | VideoStreamStatus::ID => Instances::of_param(instance, V::VIDEO_STREAMS),
        _ => Instances::FIRST,
    };
    link.request(message.id, instances);
    Some(if instances == Instances::NONE { MavResult::DENIED } else { MavResult::ACCEPTED })
}

/// Handles MAV_CMD_SET_MESSAGE_INTERVAL for CAMERA_CAPTURE_STATUS (CAM-5). Returns `None` if the command is for another
/// message.
fn set_interval(now: Instant, port: &Port, link: &mut CameraLink, command: &Command) -> Option<MavResult> {
    let [id, micros, ..] = command.params;
    if num::integer(id) != Some(CameraCaptureStatus::ID) {
        return None;
    }
    // NaN is no interval. 0 and -1 both stop the message, which is not sent by default.
    let is_interval = micros >= 0.0 || micros == -1.0;
    if !can_send(port) || !command.has_response_target() || !is_interval {
        return Some(MavResult::DENIED);
    }
    link.status_interval = if micros > 0.0 { (num::saturated(micros) / 1_000).max(MIN_STATUS_INTERVAL) } else { 0 };
    link.status_at = now;
    Some(MavResult::ACCEPTED)
}

/// Returns the parameter with the camera id, or 0 for a command without a camera id. Returns `None` for a command that
/// the camera does not have.
fn camera_id_param<V: Camera>(command: &Command) -> Option<f32> {
    let has = |flags: CameraCapFlags| V::FLAGS.contains(flags);
    let [first, second, third, _] = command.params;
    match command.id {
        MavCmd::IMAGE_START_CAPTURE | MavCmd::IMAGE_STOP_CAPTURE if has(CameraCapFlags::CAPTURE_IMAGE) => Some(first),
        MavCmd::DO_DIGICAM_CONTROL if has(CameraCapFlags::CAPTURE_IMAGE) => Some(0.0),
        MavCmd::VIDEO_START_CAPTURE if has(CameraCapFlags::CAPTURE_VIDEO) => Some(third),
        MavCmd::VIDEO_STOP_CAPTURE if has(CameraCapFlags::CAPTURE_VIDEO) => Some(second),
        MavCmd::VIDEO_START_STREAMING | MavCmd::VIDEO_STOP_STREAMING if V::VIDEO_STREAMS > 0 => Some(second),
        MavCmd::SET_CAMERA_MODE if has(CameraCapFlags::HAS_MODES) => Some(first),
        MavCmd::SET_CAMERA_ZOOM if has(CameraCapFlags::HAS_BASIC_ZOOM) => Some(third),
        MavCmd::SET_CAMERA_FOCUS if has(CameraCapFlags::HAS_BASIC_FOCUS) => Some(third),
        MavCmd::SET_CAMERA_SOURCE => Some(first),
        MavCmd::RESET_CAMERA_SETTINGS => Some(second),
        MavCmd::STORAGE_FORMAT if V::STORAGES > 0 => Some(0.0),
        _ => None,
    }
}

/// Whether a camera id means this camera: its own id, 0 for every camera, or NaN for none given. An item of a mission
/// names the camera by its component.
fn is_own_id(component: Option<ComponentId>, id: f32) -> bool {
    let own = component.map_or(1, |component| component.wire());
    id.is_nan() || num::integer::<u8>(id).is_some_and(|id| id == 0 || id == own)
}

/// Executes one of the commands of [`camera_id_param`]. Returns the vehicle's result, or ACCEPTED if no hook decides.
///
/// # Errors
///
/// The reason if the stack itself refuses the command.
fn execute<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    link: &mut CameraLink,
    command: &Command,
) -> Result<MavResult, CameraRefusal> {
    let [first, second, third, fourth] = command.params;
    match command.id {
        MavCmd::IMAGE_START_CAPTURE => {
            start_capture(control, cx, command, CaptureParams { interval: second, count: third, sequence: fourth })
        }
        MavCmd::DO_DIGICAM_CONTROL => {
            let (shoot, _) = command.position.params();
            if shoot != 1.0 {
                return Err(CameraRefusal::InvalidParam);
            }
            start_capture(control, cx, command, CaptureParams { interval: 0.0, count: 1.0, sequence: 0.0 })
        }
        MavCmd::IMAGE_STOP_CAPTURE => {
            control.stop_capture();
            Ok(MavResult::ACCEPTED)
        }
        MavCmd::VIDEO_START_CAPTURE => start_video(control, cx, integer_up_to(first, u8::MAX)?, non_nan(second)),
        MavCmd::VIDEO_STOP_CAPTURE => Ok(record_video(control, cx, integer_up_to(first, u8::MAX)?, Recording::Stop)),
        MavCmd::VIDEO_START_STREAMING | MavCmd::VIDEO_STOP_STREAMING => {
            let stream = integer_up_to(first, F::Vehicle::VIDEO_STREAMS)?;
            let (vehicle, mut context) = cx.hook();
            Ok(vehicle.stream_video(&mut context, stream, command.id == MavCmd::VIDEO_START_STREAMING))
        }
        MavCmd::STORAGE_FORMAT => format_storage(control, cx, link, [first, second, third]),
        // The other commands change settings.
        _ => {
            let result = change_settings(cx, command)?;
            if result == MavResult::ACCEPTED {
                control.settings_changed();
            }
            Ok(result)
        }
    }
}

/// Handles a command to take images (CAM-4). Returns ACCEPTED for a retransmission, which starts nothing, or the
/// vehicle's result.
///
/// # Errors
///
/// The parameters are invalid, images are being taken, or the camera is in a mode without images.
fn start_capture<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    command: &Command,
    params: CaptureParams,
) -> Result<MavResult, CameraRefusal> {
    let seconds = non_nan(params.interval);
    let count = num::integer(params.count).ok_or(CameraRefusal::InvalidParam)?;
    let sequence = num::integer(non_nan(params.sequence)).ok_or(CameraRefusal::InvalidParam)?;
    if !(0.0..=MAX_INTERVAL).contains(&seconds) {
        return Err(CameraRefusal::InvalidParam);
    }
    let interval = num::saturated(seconds * 1_000.0);
    let capture = CaptureCommand { from: command.from.address, interval, count, sequence };
    if control.is_retransmission(cx.now, &capture) {
        return Ok(MavResult::ACCEPTED);
    }
    let is_video_mode = |mode| mode == CameraMode::VIDEO;
    if control.is_capturing() || must_leave_mode(cx, CameraCapFlags::CAN_CAPTURE_IMAGE_IN_VIDEO_MODE, is_video_mode) {
        return Err(CameraRefusal::NotNow);
    }
    let (vehicle, mut context) = cx.hook();
    let result = vehicle.may_capture(&mut context);
    if result == MavResult::ACCEPTED {
        control.start(cx.now, capture, const { millis(F::Vehicle::MIN_INTERVAL) });
    }
    Ok(result)
}

/// Whether the camera must leave its mode first, because the mode `is_unsuitable`. False for a camera without modes,
/// and for one that has the `capability` to do this in every mode.
fn must_leave_mode<F: Firmware<Vehicle: Camera>>(
    cx: &Cx<'_, F>,
    capability: CameraCapFlags,
    is_unsuitable: fn(CameraMode) -> bool,
) -> bool {
    let flags = F::Vehicle::FLAGS;
    if !flags.contains(CameraCapFlags::HAS_MODES) || flags.contains(capability) {
        return false;
    }
    let mut settings = CameraSettings::UNKNOWN;
    cx.vehicle.camera_settings(&mut settings);
    is_unsuitable(settings.mode_id)
}

/// Handles MAV_CMD_VIDEO_START_CAPTURE (CAM-6). `hertz`: the rate of CAMERA_CAPTURE_STATUS. Returns the vehicle's
/// result.
///
/// # Errors
///
/// The rate is negative, or the camera is in a mode without video.
fn start_video<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    stream: u8,
    hertz: f32,
) -> Result<MavResult, CameraRefusal> {
    if hertz < 0.0 {
        return Err(CameraRefusal::InvalidParam);
    }
    let is_image_mode = |mode| mode != CameraMode::VIDEO;
    if must_leave_mode(cx, CameraCapFlags::CAN_CAPTURE_VIDEO_IN_IMAGE_MODE, is_image_mode) {
        return Err(CameraRefusal::NotNow);
    }
    let result = record_video(control, cx, stream, Recording::Start);
    if result == MavResult::ACCEPTED {
        let interval = if hertz > 0.0 { num::saturated(1_000.0 / hertz).max(MIN_STATUS_INTERVAL) } else { 0 };
        control.recording_interval = interval;
        // The change is reported on every link now, and the interval begins with that report.
        control.changes += 1;
    }
    Ok(result)
}

/// Starts or stops the recording of video. Returns the vehicle's result, or ACCEPTED without a call of its hook if that
/// changes nothing, or if the camera has no video.
pub(super) fn record_video<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    stream: u8,
    recording: Recording,
) -> MavResult {
    let starts = recording == Recording::Start;
    if control.is_recording() == starts || !F::Vehicle::FLAGS.contains(CameraCapFlags::CAPTURE_VIDEO) {
        return MavResult::ACCEPTED;
    }
    let (vehicle, mut context) = cx.hook();
    let result = vehicle.record_video(&mut context, stream, starts);
    if result == MavResult::ACCEPTED {
        control.is_recording = starts;
        control.recording_since = cx.now;
        control.recording_interval = 0;
        control.changes += 1;
    }
    result
}

/// Handles MAV_CMD_STORAGE_FORMAT (CAM-8): the id of a storage, 1 to format it, and 1 to reset the image log. Returns
/// the vehicle's result of the format, or ACCEPTED.
///
/// # Errors
///
/// A parameter is invalid, or images or video are being recorded.
fn format_storage<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    link: &mut CameraLink,
    [storage, format, reset]: [f32; 3],
) -> Result<MavResult, CameraRefusal> {
    let id = integer_up_to(storage, F::Vehicle::STORAGES)?;
    let formats_storage = integer_up_to(non_nan(format), 1)? == 1;
    let resets_images = integer_up_to(non_nan(reset), 1)? == 1;
    if id == 0 {
        return Err(CameraRefusal::InvalidParam);
    }
    if control.is_capturing() || control.is_recording() {
        return Err(CameraRefusal::NotNow);
    }
    if formats_storage {
        let (vehicle, mut context) = cx.hook();
        let result = vehicle.format_storage(&mut context, id);
        if result != MavResult::ACCEPTED {
            return Ok(result);
        }
        link.request(StorageInformation::ID, Instances::of_param(storage, F::Vehicle::STORAGES));
    }
    if resets_images {
        control.reset_images();
    }
    Ok(MavResult::ACCEPTED)
}

/// Handles a command that changes mode, zoom, focus or source, or resets all settings (CAM-7). Returns the vehicle's
/// result.
///
/// # Errors
///
/// A parameter is invalid.
fn change_settings<F: Firmware<Vehicle: Camera>>(
    cx: &mut Cx<'_, F>,
    command: &Command,
) -> Result<MavResult, CameraRefusal> {
    let has = |flags: CameraCapFlags| F::Vehicle::FLAGS.contains(flags);
    let [first, second, third, _] = command.params;
    let (vehicle, mut context) = cx.hook();
    Ok(match command.id {
        MavCmd::SET_CAMERA_MODE if has(CameraCapFlags::HAS_MODES) => {
            vehicle.set_camera_mode(&mut context, CameraMode(integer_up_to(second, CameraMode::IMAGE_SURVEY.0)?))
        }
        MavCmd::SET_CAMERA_ZOOM if has(CameraCapFlags::HAS_BASIC_ZOOM) => {
            let zoom = CameraZoomType(integer_up_to(first, CameraZoomType::HORIZONTAL_FOV.0)?);
            let value = if zoom == CameraZoomType::RANGE { percentage(second)? } else { finite(second)? };
            vehicle.set_zoom(&mut context, zoom, value)
        }
        MavCmd::SET_CAMERA_FOCUS if has(CameraCapFlags::HAS_BASIC_FOCUS) => {
            let focus = SetFocusType(integer_up_to(first, SetFocusType::AUTO_CONTINUOUS.0)?);
            let is_auto = focus.0 >= SetFocusType::AUTO.0;
            let value = match focus {
                _ if is_auto => 0.0,
                SetFocusType::RANGE => percentage(second)?,
                _ => finite(second)?,
            };
            vehicle.set_focus(&mut context, focus, value)
        }
        MavCmd::SET_CAMERA_SOURCE => {
            let primary = integer_up_to(second, CameraSource::NDVI.0)?;
            let secondary = integer_up_to(third, CameraSource::NDVI.0)?;
            vehicle.set_source(&mut context, CameraSource(primary), CameraSource(secondary))
        }
        // RESET_CAMERA_SETTINGS.
        _ if first == 1.0 => vehicle.reset_camera_settings(&mut context),
        _ => return Err(CameraRefusal::InvalidParam),
    })
}

/// Explains a refusal by a text, and returns its result (C-16). The vehicle explains its own refusals.
fn explain<F: Firmware>(cx: &mut Cx<'_, F>, refusal: CameraRefusal) -> MavResult {
    let text: &[u8] = match refusal {
        CameraRefusal::InvalidParam => b"Camera: a parameter is out of range",
        CameraRefusal::NotNow => b"Camera: busy, or in another mode",
    };
    if cfg!(feature = "plan-texts") {
        cx.text(MavSeverity::WARNING, text);
    }
    match refusal {
        CameraRefusal::InvalidParam => MavResult::DENIED,
        CameraRefusal::NotNow => MavResult::TEMPORARILY_REJECTED,
    }
}

/// Returns 0 for a parameter that is not given.
fn non_nan(param: f32) -> f32 {
    if param.is_nan() { 0.0 } else { param }
}

/// Returns a parameter that is an integer from 0 to `max`, inclusive (C-9). Any other one is refused.
fn integer_up_to(param: f32, max: u8) -> Result<u8, CameraRefusal> {
    num::integer(param).filter(|number| *number <= max).ok_or(CameraRefusal::InvalidParam)
}

/// Returns a parameter that is from 0 to 100. Any other one is refused.
fn percentage(param: f32) -> Result<f32, CameraRefusal> {
    if (0.0..=100.0).contains(&param) { Ok(param) } else { Err(CameraRefusal::InvalidParam) }
}

/// Returns a parameter that is finite. Any other one is refused.
fn finite(param: f32) -> Result<f32, CameraRefusal> {
    if param.is_finite() { Ok(param) } else { Err(CameraRefusal::InvalidParam) }
}
