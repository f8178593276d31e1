//! The camera's messages, made when a link has room (CAM-1 to CAM-3, CAM-5).

use super::control::{CameraControl, millis};
use super::image::{Image, ImageNumber};
use super::link::{CameraLink, CameraReply};
use super::vehicle::{Camera, device_id};
use crate::dialect::{
    CameraCaptureStatus, CameraImageCaptured, CameraInformation, CameraSettings, StorageInformation,
    VideoStreamInformation, VideoStreamStatus,
};
use crate::link::Port;
use crate::message::Message;
use crate::num;
use crate::service::Cx;
use crate::time::Duration;
use crate::types::Firmware;

/// Whether a link can send the camera's messages: MAVLink 1 has no room for their ids (S-10), and high-latency links
/// carry none.
pub(super) fn can_send(port: &Port) -> bool {
    port.outbox.takes(CameraInformation::ID)
}

/// Sends a message. Returns false if the image is no longer in the log, or if the link cannot send the message.
pub(super) fn send<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &Cx<'_, F>,
    port: &mut Port,
    link: &mut CameraLink,
    reply: CameraReply,
) -> bool {
    let (id, instance) = match reply {
        CameraReply::Image(number) => {
            control.record_image(link, number);
            return send_image(control, cx, port, number);
        }
        CameraReply::Message { id, instance } => (id, instance),
    };
    control.record_message(cx.now, link, id);
    match id {
        CameraInformation::ID => send_information(cx, port),
        CameraSettings::ID => send_settings(cx, port),
        StorageInformation::ID if F::Vehicle::STORAGES > 0 => {
            port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &storage(cx, instance))
        }
        VideoStreamInformation::ID if F::Vehicle::VIDEO_STREAMS > 0 => send_stream(cx, port, instance),
        VideoStreamStatus::ID if F::Vehicle::VIDEO_STREAMS > 0 => send_stream_state(cx, port, instance),
        _ => send_status(control, cx, port),
    }
}

// Each message has a function of its own, so that only one of them takes stack. All return false if the link cannot
// send the message.

fn send_information<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port) -> bool {
    // Unknown, without a table of its bytes in flash.
    let mut information = CameraInformation {
        focal_length: f32::NAN,
        sensor_size_h: f32::NAN,
        sensor_size_v: f32::NAN,
        ..CameraInformation::default()
    };
    cx.vehicle.camera_information(&mut information);
    information.time_boot_ms = cx.now.time_boot_ms();
    information.flags = F::Vehicle::FLAGS;
    information.camera_device_id = device_id::<F::Vehicle>();
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &information)
}

fn send_settings<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let mut settings = CameraSettings::UNKNOWN;
    cx.vehicle.camera_settings(&mut settings);
    settings.time_boot_ms = cx.now.time_boot_ms();
    settings.camera_device_id = device_id::<F::Vehicle>();
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &settings)
}

/// Returns the state of a storage.
fn storage<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, id: u8) -> StorageInformation {
    let mut information = StorageInformation::default();
    cx.vehicle.storage_information(id, &mut information);
    information.time_boot_ms = cx.now.time_boot_ms();
    information.storage_id = id;
    information.storage_count = F::Vehicle::STORAGES;
    information
}

/// Fills in the description of a stream.
fn describe_stream<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, id: u8, information: &mut VideoStreamInformation) {
    cx.vehicle.video_stream_information(id, information);
    information.stream_id = id;
    information.count = F::Vehicle::VIDEO_STREAMS;
    information.camera_device_id = device_id::<F::Vehicle>();
}

fn send_stream<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port, id: u8) -> bool {
    let mut information = VideoStreamInformation::default();
    describe_stream(cx, id, &mut information);
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &information)
}

fn send_stream_state<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port, id: u8) -> bool {
    let mut information = VideoStreamInformation::default();
    describe_stream(cx, id, &mut information);
    let state = VideoStreamStatus {
        framerate: information.framerate,
        bitrate: information.bitrate,
        flags: information.flags,
        resolution_h: information.resolution_h,
        resolution_v: information.resolution_v,
        rotation: information.rotation,
        hfov: information.hfov,
        stream_id: id,
        camera_device_id: information.camera_device_id,
    };
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &state)
}

fn send_image<F: Firmware<Vehicle: Camera>>(
    control: &CameraControl,
    cx: &Cx<'_, F>,
    port: &mut Port,
    number: ImageNumber,
) -> bool {
    let Some(image) = control.images.get(number) else { return false };
    let Image { time_utc, time_boot_ms, latitude, longitude, altitude, relative_altitude, attitude, is_success } =
        *image;
    let index = control.images.index(number);
    let mut message = CameraImageCaptured {
        time_utc,
        time_boot_ms,
        lat: latitude,
        lon: longitude,
        alt: altitude,
        relative_alt: relative_altitude,
        q: attitude,
        image_index: index.cast_signed(),
        camera_id: device_id::<F::Vehicle>(),
        capture_result: i8::from(is_success),
        ..CameraImageCaptured::default()
    };
    cx.vehicle.image_url(index, &mut message.file_url);
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &message)
}

fn send_status<F: Firmware<Vehicle: Camera>>(control: &CameraControl, cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let is_at_interval = control.is_at_interval();
    let is_single = control.is_busy || control.is_single_waiting;
    let recording = if control.is_recording { cx.now - control.recording_since } else { Duration::ZERO };
    let message = CameraCaptureStatus {
        time_boot_ms: cx.now.time_boot_ms(),
        image_interval: if is_at_interval { num::f32_from_u32(control.interval) / 1_000.0 } else { 0.0 },
        recording_time_ms: millis(recording),
        available_capacity: if F::Vehicle::STORAGES > 0 { storage(cx, 1).available_capacity } else { 0.0 },
        // 1: an image is being taken; 2: images are taken at an interval.
        image_status: u8::from(is_single) | (u8::from(is_at_interval) << 1),
        video_status: u8::from(control.is_recording),
        image_count: control.image_count().cast_signed(),
        camera_device_id: device_id::<F::Vehicle>(),
    };
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &message)
}
