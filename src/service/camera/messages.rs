//! The camera's messages, made when a link has room (CAM-1 to CAM-3, CAM-5).

use super::commands::device;
use super::{Camera, CameraControl, CameraLink, Image, can_send, seconds};
use crate::dialect::{
    CameraCaptureStatus, CameraImageCaptured, CameraInformation, CameraSettings, StorageInformation,
    VideoStreamInformation, VideoStreamStatus,
};
use crate::link::Port;
use crate::service::Cx;
use crate::time::{Duration, Instant};
use crate::types::Firmware;

/// A pending message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum What {
    Information,
    Settings,
    /// By its id.
    Storage(u8),
    Stream(u8),
    StreamState(u8),
    /// By its number.
    Image(u32),
    /// Perhaps only at an interval.
    Status,
}

impl CameraControl {
    /// Returns the message that is pending on a link. [`What::Status`] has a time of its own.
    #[inline(never)]
    pub(super) fn pending(&self, port: &Port, link: &CameraLink) -> Option<What> {
        if !can_send(port) {
            return None;
        }
        let requested = || link.requested.iter().copied().find(|number| self.is_remembered(*number));
        Some(if link.is_asked(CameraLink::INFORMATION) {
            What::Information
        } else if link.is_asked(CameraLink::SETTINGS) || link.settings != self.settings {
            What::Settings
        } else if let Some(id) = first(link.storages) {
            What::Storage(id)
        } else if let Some(id) = first(link.streams) {
            What::Stream(id)
        } else if let Some(id) = first(link.stream_states) {
            What::StreamState(id)
        } else if let Some(number) = requested().or_else(|| self.unreported(link).0) {
            What::Image(number)
        } else {
            What::Status
        })
    }

    /// Records that a message is being sent.
    #[inline(never)]
    fn sent(&mut self, now: Instant, link: &mut CameraLink, what: What) {
        match what {
            What::Information => link.asked &= !CameraLink::INFORMATION,
            What::Settings => (link.asked, link.settings) = (link.asked & !CameraLink::SETTINGS, self.settings),
            What::Storage(_) => link.storages &= link.storages.wrapping_sub(1),
            What::Stream(_) => link.streams &= link.streams.wrapping_sub(1),
            What::StreamState(_) => link.stream_states &= link.stream_states.wrapping_sub(1),
            What::Image(number) => {
                link.requested.retain(|other| *other != number && self.is_remembered(*other));
                let (next, lost) = self.unreported(link);
                if next == Some(number) {
                    self.counters.unsent = self.counters.unsent.wrapping_add(lost);
                    link.next_image = number.wrapping_add(1);
                }
            }
            What::Status => {
                link.asked &= !CameraLink::STATUS;
                link.changes = self.changes;
                let interval = self.status_interval(link).unwrap_or(0);
                link.status_at = now.after(Duration::from_millis(u64::from(interval)));
            }
        }
    }
}

/// Returns the id of the first pending instance: they count from 1.
fn first(pending: u8) -> Option<u8> {
    let id = pending.trailing_zeros().wrapping_add(1);
    u8::try_from(id).ok().filter(|id| *id <= 8)
}

/// Sends a message that is pending. Returns false if there is none.
pub(super) fn next<F: Firmware<Vehicle: Camera>>(
    control: &mut CameraControl,
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    link: &mut CameraLink,
) -> bool {
    let Some(what) = control.pending(port, link) else { return false };
    if what == What::Status && control.status_due(cx.now, link) > cx.now {
        return false;
    }
    control.sent(cx.now, link, what);
    match what {
        What::Information => send_information(cx, port),
        What::Settings => send_settings(cx, port),
        What::Storage(id) => F::Vehicle::STORAGES > 0 && send_storage(cx, port, id),
        What::Stream(id) => F::Vehicle::VIDEO_STREAMS > 0 && send_stream(cx, port, id),
        What::StreamState(id) => F::Vehicle::VIDEO_STREAMS > 0 && send_stream_state(cx, port, id),
        What::Image(number) => send_image(control, cx, port, number),
        What::Status => send_status(control, cx, port),
    }
}

// Each message has a function of its own, so that only one of them takes stack.

#[inline(never)]
fn send_information<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let mut information = CameraInformation::UNKNOWN;
    cx.vehicle.camera_information(&mut information);
    information.time_boot_ms = cx.now.time_boot_ms();
    information.flags = F::Vehicle::FLAGS;
    information.camera_device_id = device::<F::Vehicle>();
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &information)
}

#[inline(never)]
fn send_settings<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let mut settings = CameraSettings::UNKNOWN;
    cx.vehicle.camera_settings(&mut settings);
    settings.time_boot_ms = cx.now.time_boot_ms();
    settings.camera_device_id = device::<F::Vehicle>();
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &settings)
}

/// Returns the state of a storage.
fn storage<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, id: u8) -> StorageInformation {
    let mut information = StorageInformation::UNKNOWN;
    cx.vehicle.storage_information(id, &mut information);
    information.time_boot_ms = cx.now.time_boot_ms();
    (information.storage_id, information.storage_count) = (id, F::Vehicle::STORAGES);
    information
}

#[inline(never)]
fn send_storage<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port, id: u8) -> bool {
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &storage(cx, id))
}

/// Fills in the description of a stream.
fn describe_stream<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, id: u8, information: &mut VideoStreamInformation) {
    cx.vehicle.video_stream_information(id, information);
    (information.stream_id, information.count) = (id, F::Vehicle::VIDEO_STREAMS);
    information.camera_device_id = device::<F::Vehicle>();
}

#[inline(never)]
fn send_stream<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port, id: u8) -> bool {
    let mut information = VideoStreamInformation::UNKNOWN;
    describe_stream(cx, id, &mut information);
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &information)
}

#[inline(never)]
fn send_stream_state<F: Firmware<Vehicle: Camera>>(cx: &Cx<'_, F>, port: &mut Port, id: u8) -> bool {
    let mut information = VideoStreamInformation::UNKNOWN;
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

#[inline(never)]
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
        ..CameraImageCaptured::UNKNOWN
    };
    cx.vehicle.image_url(index, &mut message.file_url);
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &message)
}

#[inline(never)]
fn send_status<F: Firmware<Vehicle: Camera>>(control: &CameraControl, cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let recording = if control.is_recording { cx.now.since(control.recording_since) } else { Duration::ZERO };
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
