//! The camera's messages, made when a link has room (CAM-1 to CAM-3, CAM-5).

use super::commands::device;
use super::{Camera, CameraControl, CameraLink, Image, can_send, seconds};
use crate::dialect::{
    CameraCaptureStatus, CameraImageCaptured, CameraInformation, CameraSettings, MavCmd, StorageInformation,
    VideoStreamInformation, VideoStreamStatus,
};
use crate::link::Port;
use crate::message::Message;
use crate::service::Cx;
use crate::time::{Duration, Instant};
use crate::types::Firmware;

/// A message of the camera that can be requested.
pub(super) struct Row {
    pub(super) id: u32,
    /// The command that MAV_CMD_REQUEST_MESSAGE has replaced.
    pub(super) old: MavCmd,
}

/// The messages, in the order in which they are sent on request.
pub(super) const ROWS: [Row; 7] = [
    Row { id: CameraInformation::ID, old: MavCmd::REQUEST_CAMERA_INFORMATION },
    Row { id: CameraSettings::ID, old: MavCmd::REQUEST_CAMERA_SETTINGS },
    Row { id: StorageInformation::ID, old: MavCmd::REQUEST_STORAGE_INFORMATION },
    Row { id: VideoStreamInformation::ID, old: MavCmd::REQUEST_VIDEO_STREAM_INFORMATION },
    Row { id: VideoStreamStatus::ID, old: MavCmd::REQUEST_VIDEO_STREAM_STATUS },
    Row { id: CameraCaptureStatus::ID, old: MavCmd::REQUEST_CAMERA_CAPTURE_STATUS },
    Row { id: CameraImageCaptured::ID, old: MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE },
];

// Their places in the table.
const INFORMATION: usize = 0;
const SETTINGS: usize = 1;
pub(super) const STORAGE: usize = 2;
const STREAM: usize = 3;
const STREAM_STATE: usize = 4;
const STATUS: usize = 5;
pub(super) const IMAGE: usize = 6;

/// Returns the number of instances of each message, plus 1; 0 for one that has none.
pub(super) const fn counts(storages: u8, streams: u8) -> [u8; ROWS.len()] {
    let (storages, streams) = (storages.saturating_add(1), streams.saturating_add(1));
    [0, 0, storages, streams, streams, 0, 0]
}

/// What the camera sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraReply {
    /// A message that was requested, by its row, and the id of the instance.
    Asked(usize, u8),
    /// CAMERA_IMAGE_CAPTURED, by the number of the image.
    Image(u32),
    /// CAMERA_CAPTURE_STATUS, when it is due.
    Status,
}

impl CameraControl {
    /// Returns the message that is pending on a link, and when it is due.
    pub(super) fn pending(&self, now: Instant, port: &Port, link: &CameraLink) -> Option<(Instant, CameraReply)> {
        if !can_send(port) {
            return None;
        }
        if let Some((row, bits)) = link.asked.iter().enumerate().find(|(_, bits)| **bits != 0) {
            let id = u8::try_from(bits.trailing_zeros()).unwrap_or(0).wrapping_add(1);
            return Some((now, CameraReply::Asked(row, id)));
        }
        if link.settings != self.settings {
            return Some((now, CameraReply::Asked(SETTINGS, 0)));
        }
        let requested = link.requested.iter().find(|entry| self.is_requested(**entry));
        let requested = requested.map(|entry| entry.wrapping_sub(1));
        Some(match requested.or(self.unreported(link).0) {
            Some(number) => (now, CameraReply::Image(number)),
            None => (self.status_due(now, link), CameraReply::Status),
        })
    }

    /// Records that a message is being sent.
    fn sent(&mut self, now: Instant, link: &mut CameraLink, reply: CameraReply) {
        match reply {
            CameraReply::Asked(row, _) => {
                if let Some(bits) = link.asked.get_mut(row) {
                    *bits &= bits.wrapping_sub(1);
                }
                if row == SETTINGS {
                    link.settings = self.settings;
                }
                if row != STATUS {
                    return;
                }
            }
            CameraReply::Image(number) => {
                let entry = number.wrapping_add(1);
                for other in &mut link.requested {
                    *other = if *other == entry { 0 } else { *other };
                }
                let (next, lost) = self.unreported(link);
                if next == Some(number) {
                    self.counters.unsent = self.counters.unsent.wrapping_add(lost);
                    link.next_image = entry;
                }
                return;
            }
            CameraReply::Status => {}
        }
        link.changes = self.changes;
        link.status_at = now + Duration::from_millis(u64::from(self.status_interval(link)));
    }
}

/// Sends a message.
pub(super) fn send<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    link: &mut CameraLink,
    reply: CameraReply,
) -> bool {
    control.sent(cx.now, link, reply);
    match reply {
        CameraReply::Asked(INFORMATION, _) => send_information(cx, port),
        CameraReply::Asked(SETTINGS, _) => send_settings(cx, port),
        CameraReply::Asked(STORAGE, id) if F::Vehicle::STORAGES > 0 => send_storage(cx, port, id),
        CameraReply::Asked(STREAM, id) if F::Vehicle::VIDEO_STREAMS > 0 => send_stream(cx, port, id),
        CameraReply::Asked(STREAM_STATE, id) if F::Vehicle::VIDEO_STREAMS > 0 => send_stream_state(cx, port, id),
        CameraReply::Image(number) => send_image(control, cx, port, number),
        // CAMERA_CAPTURE_STATUS was requested, or is due.
        _ => send_status(control, cx, port),
    }
}

// Each message has a function of its own, so that only one of them takes stack.

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
    information.camera_device_id = device::<F::Vehicle>();
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &information)
}

fn send_settings<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let mut settings = CameraSettings::UNKNOWN;
    cx.vehicle.camera_settings(&mut settings);
    settings.time_boot_ms = cx.now.time_boot_ms();
    settings.camera_device_id = device::<F::Vehicle>();
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &settings)
}

/// Returns the state of a storage.
fn storage<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, id: u8) -> StorageInformation {
    let mut information = StorageInformation::default();
    cx.vehicle.storage_information(id, &mut information);
    information.time_boot_ms = cx.now.time_boot_ms();
    (information.storage_id, information.storage_count) = (id, F::Vehicle::STORAGES);
    information
}

fn send_storage<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port, id: u8) -> bool {
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &storage(cx, id))
}

/// Fills in the description of a stream.
fn describe_stream<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, id: u8, information: &mut VideoStreamInformation) {
    cx.vehicle.video_stream_information(id, information);
    (information.stream_id, information.count) = (id, F::Vehicle::VIDEO_STREAMS);
    information.camera_device_id = device::<F::Vehicle>();
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
    number: u32,
) -> bool {
    let Some(image) = control.image(number) else { return false };
    let Image { time_utc, time_boot_ms, latitude, longitude, altitude, relative_altitude, attitude, is_success } =
        *image;
    let index = number.wrapping_sub(control.base);
    let mut message = CameraImageCaptured {
        time_utc,
        time_boot_ms,
        lat: latitude,
        lon: longitude,
        alt: altitude,
        relative_alt: relative_altitude,
        q: attitude,
        image_index: index.cast_signed(),
        camera_id: device::<F::Vehicle>(),
        capture_result: i8::from(is_success),
        ..CameraImageCaptured::default()
    };
    cx.vehicle.image_url(index, &mut message.file_url);
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &message)
}

fn send_status<F: Firmware<Vehicle: Camera>>(control: &CameraControl, cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let recording = if control.is_recording { cx.now - control.recording_since } else { Duration::ZERO };
    // 1: an image is being taken; 2: images are taken at an interval.
    let image_status = u8::from(control.is_busy || control.is_ordered) | (u8::from(control.left > 0) << 1);
    let message = CameraCaptureStatus {
        time_boot_ms: cx.now.time_boot_ms(),
        image_interval: if control.left > 0 { seconds(control.interval) } else { 0.0 },
        recording_time_ms: u32::try_from(recording.as_millis()).unwrap_or(u32::MAX),
        available_capacity: if F::Vehicle::STORAGES > 0 { storage(cx, 1).available_capacity } else { 0.0 },
        image_status,
        video_status: u8::from(control.is_recording),
        image_count: control.image_count().cast_signed(),
        camera_device_id: device::<F::Vehicle>(),
    };
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &message)
}

const _: () = assert!(size_of::<Image>() == 48, "the memory of an image is documented");
