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

/// Handles a command; `None` for one that is not for the camera.
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
        let is_for_us = is_own_id(F::Vehicle::COMPONENT, camera_id);
        let result = if is_for_us { execute(control, cx, link, command) } else { Err(MavResult::DENIED) };
        result.unwrap_or_else(|refusal| explain(cx, refusal))
    };
    Some(Outcome { result, result_param2: i32::from(device_id::<F::Vehicle>()) }.into())
}

/// Handles a request for a message; `None` if it is none, or for no message of the camera.
fn request_message<V: Camera>(
    control: &CameraControl,
    port: &Port,
    link: &mut CameraLink,
    command: &Command,
) -> Option<MavResult> {
    let [first, second, ..] = command.params;
    let is_request = command.id == MavCmd::REQUEST_MESSAGE;
    let requested_id = num::integer(first);
    let is_asked_for = |message: &&Requestable| {
        if is_request { requested_id == Some(message.id) } else { message.superseded == command.id }
    };
    let message = REQUESTABLE.iter().find(is_asked_for)?;
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
    link.status_interval = if micros > 0.0 { (num::saturated(micros) / 1_000).max(MIN_STATUS_INTERVAL) } else { 0 };
    link.status_at = now;
    Some(MavResult::ACCEPTED)
}

/// Returns the parameter that has the camera id, 0 for a command without one; `None` for a command that the camera does
/// not have.
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

/// Whether a camera id is ours: 0 is every camera, and NaN is not given. An item of a mission names a component.
fn is_own_id(component: Option<ComponentId>, id: f32) -> bool {
    let own = component.map_or(1, |component| component.wire());
    id.is_nan() || num::integer::<u8>(id).is_some_and(|id| id == 0 || id == own)
}

/// Executes a command that the camera has, and returns the vehicle's result.
///
/// # Errors
///
/// The result if the stack itself refuses the command.
fn execute<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    link: &mut CameraLink,
    command: &Command,
) -> Result<MavResult, MavResult> {
    let [first, second, third, fourth] = command.params;
    let stream = num::integer::<u8>(first).ok_or(MavResult::DENIED);
    match command.id {
        MavCmd::IMAGE_START_CAPTURE => start_capture(control, cx, command, [second, third, fourth]),
        // Parameter 5: shoot.
        MavCmd::DO_DIGICAM_CONTROL if command.position.params().0 == 1.0 => {
            start_capture(control, cx, command, [0.0, 1.0, 0.0])
        }
        MavCmd::DO_DIGICAM_CONTROL => Err(MavResult::DENIED),
        MavCmd::IMAGE_STOP_CAPTURE => {
            control.stop_capture();
            Ok(MavResult::ACCEPTED)
        }
        MavCmd::VIDEO_START_CAPTURE => start_video(control, cx, stream?, non_nan(second)),
        MavCmd::VIDEO_STOP_CAPTURE => Ok(record(control, cx, stream?, false)),
        MavCmd::VIDEO_START_STREAMING | MavCmd::VIDEO_STOP_STREAMING => {
            let stream = up_to(first, F::Vehicle::VIDEO_STREAMS)?;
            let (vehicle, mut context) = cx.hook();
            Ok(vehicle.stream_video(&mut context, stream, command.id == MavCmd::VIDEO_START_STREAMING))
        }
        MavCmd::STORAGE_FORMAT => format_storage(control, cx, link, [first, second, third]),
        _ => {
            let result = change_settings(cx, command)?;
            if result == MavResult::ACCEPTED {
                control.settings_changed();
            }
            Ok(result)
        }
    }
}

/// Handles a command to take images (CAM-4). `params` are interval (s), number and sequence.
fn start_capture<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    command: &Command,
    [interval, count, sequence]: [f32; 3],
) -> Result<MavResult, MavResult> {
    let interval = non_nan(interval);
    let (Some(count), Some(sequence), true) =
        (num::integer(count), num::integer(non_nan(sequence)), (0.0..=MAX_INTERVAL).contains(&interval))
    else {
        return Err(MavResult::DENIED);
    };
    let interval = num::saturated(interval * 1_000.0);
    let capture = CaptureCommand { from: command.from.address, interval, count, sequence };
    if control.is_repeated(cx.now, &capture) {
        return Ok(MavResult::ACCEPTED);
    }
    if control.is_capturing() || is_wrong_mode(cx, CameraCapFlags::CAN_CAPTURE_IMAGE_IN_VIDEO_MODE, true) {
        return Err(MavResult::TEMPORARILY_REJECTED);
    }
    let (vehicle, mut context) = cx.hook();
    let result = vehicle.may_capture(&mut context);
    if result == MavResult::ACCEPTED {
        control.start(cx.now, capture, const { millis(F::Vehicle::MIN_INTERVAL) });
    }
    Ok(result)
}

/// Whether the camera must leave its mode first: it has modes, lacks this capability, and is in the video mode if
/// `is_video`, or in another one if not.
fn is_wrong_mode<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, capability: CameraCapFlags, is_video: bool) -> bool {
    let flags = F::Vehicle::FLAGS;
    if !flags.contains(CameraCapFlags::HAS_MODES) || flags.contains(capability) {
        return false;
    }
    let mut settings = CameraSettings::UNKNOWN;
    cx.vehicle.camera_settings(&mut settings);
    (settings.mode_id == CameraMode::VIDEO) == is_video
}

/// Handles MAV_CMD_VIDEO_START_CAPTURE (CAM-6). `hertz`: the rate of CAMERA_CAPTURE_STATUS.
fn start_video<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    stream: u8,
    hertz: f32,
) -> Result<MavResult, MavResult> {
    if hertz < 0.0 {
        return Err(MavResult::DENIED);
    }
    if is_wrong_mode(cx, CameraCapFlags::CAN_CAPTURE_VIDEO_IN_IMAGE_MODE, false) {
        return Err(MavResult::TEMPORARILY_REJECTED);
    }
    let result = record(control, cx, stream, true);
    if result == MavResult::ACCEPTED {
        let interval = if hertz > 0.0 { num::saturated(1_000.0 / hertz).max(MIN_STATUS_INTERVAL) } else { 0 };
        control.recording_interval = interval;
        // On every link, the interval begins now.
        control.changes += 1;
    }
    Ok(result)
}

/// Starts or stops the recording of video, if that changes something.
pub(super) fn record<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    stream: u8,
    on: bool,
) -> MavResult {
    if control.is_recording() == on || !F::Vehicle::FLAGS.contains(CameraCapFlags::CAPTURE_VIDEO) {
        return MavResult::ACCEPTED;
    }
    let (vehicle, mut context) = cx.hook();
    let result = vehicle.record_video(&mut context, stream, on);
    if result == MavResult::ACCEPTED {
        control.is_recording = on;
        control.recording_since = cx.now;
        control.recording_interval = 0;
        control.changes += 1;
    }
    result
}

/// Handles MAV_CMD_STORAGE_FORMAT (CAM-8): storage, whether to format it, whether to reset the image log.
fn format_storage<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    link: &mut CameraLink,
    [storage, formats, resets]: [f32; 3],
) -> Result<MavResult, MavResult> {
    let id = up_to(storage, F::Vehicle::STORAGES)?;
    let (formats, resets) = (up_to(non_nan(formats), 1)?, up_to(non_nan(resets), 1)?);
    if id == 0 {
        return Err(MavResult::DENIED);
    }
    if control.is_capturing() || control.is_recording() {
        return Err(MavResult::TEMPORARILY_REJECTED);
    }
    if formats == 1 {
        let (vehicle, mut context) = cx.hook();
        let result = vehicle.format_storage(&mut context, id);
        if result != MavResult::ACCEPTED {
            return Ok(result);
        }
        link.request(StorageInformation::ID, Instances::of_param(storage, F::Vehicle::STORAGES));
    }
    if resets == 1 {
        control.reset_images();
    }
    Ok(MavResult::ACCEPTED)
}

/// Handles a command that changes settings (CAM-7). The vehicle decides.
fn change_settings<F: Firmware<Vehicle: Camera>>(
    cx: &mut Cx<'_, F>,
    command: &Command,
) -> Result<MavResult, MavResult> {
    let has = |flags: CameraCapFlags| F::Vehicle::FLAGS.contains(flags);
    let [first, second, third, _] = command.params;
    let (vehicle, mut context) = cx.hook();
    Ok(match command.id {
        MavCmd::SET_CAMERA_MODE if has(CameraCapFlags::HAS_MODES) => {
            vehicle.set_camera_mode(&mut context, CameraMode(up_to(second, CameraMode::IMAGE_SURVEY.0)?))
        }
        MavCmd::SET_CAMERA_ZOOM if has(CameraCapFlags::HAS_BASIC_ZOOM) => {
            let zoom = CameraZoomType(up_to(first, CameraZoomType::HORIZONTAL_FOV.0)?);
            let value = level(second, zoom == CameraZoomType::RANGE)?;
            vehicle.set_zoom(&mut context, zoom, value)
        }
        MavCmd::SET_CAMERA_FOCUS if has(CameraCapFlags::HAS_BASIC_FOCUS) => {
            let focus = SetFocusType(up_to(first, SetFocusType::AUTO_CONTINUOUS.0)?);
            let is_auto = focus.0 >= SetFocusType::AUTO.0;
            let value = if is_auto { 0.0 } else { level(second, focus == SetFocusType::RANGE)? };
            vehicle.set_focus(&mut context, focus, value)
        }
        MavCmd::SET_CAMERA_SOURCE => {
            let [primary, secondary] = [up_to(second, CameraSource::NDVI.0)?, up_to(third, CameraSource::NDVI.0)?];
            vehicle.set_source(&mut context, CameraSource(primary), CameraSource(secondary))
        }
        _ if first == 1.0 => vehicle.reset_camera_settings(&mut context),
        _ => return Err(MavResult::DENIED),
    })
}

/// Explains a refusal of the stack itself by a text, and returns it (C-16). The vehicle explains its own.
fn explain<F: Firmware>(cx: &mut Cx<'_, F>, refusal: MavResult) -> MavResult {
    if cfg!(feature = "plan-texts") {
        let text: &[u8] = match refusal {
            MavResult::DENIED => b"Camera: a parameter is out of range",
            _ => b"Camera: busy, or in another mode",
        };
        cx.text(MavSeverity::WARNING, text);
    }
    refusal
}

/// Returns 0 for a parameter that is not given.
fn non_nan(param: f32) -> f32 {
    if param.is_nan() { 0.0 } else { param }
}

/// Returns a parameter that is an integer up to `max` (C-9), otherwise DENIED.
fn up_to(param: f32, max: u8) -> Result<u8, MavResult> {
    num::integer(param).filter(|number| *number <= max).ok_or(MavResult::DENIED)
}

/// Returns a parameter that is finite, and 0 to 100 if it is a percentage; otherwise DENIED.
fn level(param: f32, is_percentage: bool) -> Result<f32, MavResult> {
    let is_valid = if is_percentage { (0.0..=100.0).contains(&param) } else { param.is_finite() };
    if is_valid { Ok(param) } else { Err(MavResult::DENIED) }
}
